"""A transient at the start does not squeeze the rest of a panel, and what is cut off is marked."""

import numpy as np
import pytest

from bayesftc.cosim.judging.figures.limits import limit_axis, limits_with_samples, mark_cut
from bayesftc.cosim.judging.figures.loop_figure import draw_quantity
from bayesftc.cosim.judging.figures.panels import finish, make_panels
from bayesftc.cosim.judging.signals import QuantitySignals

TIME = np.linspace(0.0, 10.0, 1001)
WAVE = np.sin(TIME)


def limits(whole, cut):
    (axis,) = make_panels([2.0])[1]
    for line in (*whole, *cut):
        axis.plot(TIME, line)
    before = axis.get_ylim()
    limit_axis(axis, TIME, whole, cut)
    return before, axis.get_ylim(), [text.get_text() for text in axis.texts]


def test_a_transient_at_the_start_is_cut_off_and_marked():
    _, (low, high), texts = limits([WAVE], [WAVE + 50.0 * (TIME < 0.2) - 80.0 * (TIME == 0.3)])
    assert (low, high) == pytest.approx((-1.16, 1.16), abs=0.05)
    assert texts == ["cut off: up to 50.2", "cut off: down to -79.7"]


@pytest.mark.parametrize(
    ("whole", "cut"),
    [
        ([WAVE + 50.0 * (TIME < 0.2)], [WAVE]),  # the true value is never cut off
        ([WAVE], [WAVE + 50.0 * ((TIME > 3.0) & (TIME < 3.1))]),  # nor is a later transient
        ([WAVE], [WAVE + 1.5 * (TIME < 0.2)]),  # nor a small one
        ([], [np.full_like(TIME, np.nan)]),
        ([], [np.where(TIME < 0.2, 50.0, 1.0)]),  # there would be no range left
        ([], []),
    ],
)
def test_other_axes_stay_as_they_are(whole, cut):
    before, after, texts = limits(whole, cut)
    assert before == after
    assert not texts


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("end", [1.7e308, -1.7e308, np.inf, np.nan])
def test_a_panel_of_a_run_that_overflows_is_drawn(end, tmp_path):
    figure, (axis,) = make_panels([2.0])
    grown = np.where(TIME < 9.9, WAVE, end)
    with np.errstate(over="ignore", invalid="ignore"):
        quantity = QuantitySignals("level", "m", (0,), grown, WAVE, -grown, True, True, np.abs(grown))
        draw_quantity(axis, time=TIME, quantity=quantity)
        limit_axis(axis, TIME, [], [np.where(TIME < 0.2, 50.0, WAVE), grown])
        assert np.isfinite(limits_with_samples([grown], [grown])).all()
    finish([axis], TIME)
    figure.savefig(tmp_path / "figure.png")
    assert np.isfinite(axis.get_ylim()).all()


def test_the_wide_interval_of_the_first_belief_is_cut_off():
    (axis,) = make_panels([2.0])[1]
    spread = np.where(TIME < 0.1, 100.0, 0.1)
    quantity = QuantitySignals("level", "m", (0,), WAVE, WAVE, WAVE, True, True, spread)
    draw_quantity(axis, time=TIME, quantity=quantity)
    assert np.abs(axis.get_ylim()).max() < 1.5
    assert [text.get_text() for text in axis.texts] == [
        "95 % interval cut off: up to 196",
        "95 % interval cut off: down to -196",
    ]


def test_samples_count_for_an_axis_unless_they_would_squeeze_the_lines():
    rng = np.random.default_rng(0)
    samples = WAVE + 0.1 * rng.standard_normal(len(TIME))
    late = TIME > 2.0  # most of the time
    assert limits_with_samples([WAVE], [samples]) == pytest.approx((-1.6, 1.6), abs=0.1)
    low, high = limits_with_samples([WAVE], [samples, samples + 4.0 * late])
    assert low == pytest.approx(-1.6, abs=0.4)
    assert 5.0 < high < 6.0
    for extreme in (samples + 1e6 * late, np.where(late, np.inf, samples), np.full_like(TIME, np.nan)):
        assert limits_with_samples([WAVE], [samples, extreme]) == pytest.approx((-1.6, 1.6), abs=0.1)


def test_an_axis_without_lines_or_without_a_range_has_limits():
    noise = 0.1 * np.random.default_rng(0).standard_normal(len(TIME))
    low, high = limits_with_samples([], [7.0 + noise])
    assert 6.0 < low < 6.8 < 7.2 < high < 8.0
    low, high = limits_with_samples([np.full_like(TIME, 7.0)], [7.0 + noise, 7.5 + noise])  # at rest, with an offset
    assert 6.0 < low < 6.8 < 7.8 < high < 8.2
    for lines in ([], [np.zeros(3)], [np.full(3, 5.0)], [np.full(3, np.nan)]):
        low, high = limits_with_samples(lines, [])
        assert low < high


def test_samples_that_leave_an_axis_are_marked():
    (axis,) = make_panels([2.0])[1]
    mark_cut(axis, TIME, [WAVE, np.where(TIME > 5.0, 1e6, np.nan), np.where(TIME > 6.0, -np.inf, 0.0)], (-2.0, 2.0))
    assert [text.get_text() for text in axis.texts] == ["cut off: up to 1e+06", "cut off: down to -inf"]
