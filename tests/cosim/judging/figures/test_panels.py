"""Labels beside panels fit the height of their panels."""

import numpy as np
import pytest

from bayesftc.cosim.judging.figures.panels import PANEL, broken, finish, make_panels, thin, thin_marks


@pytest.mark.parametrize(
    ("label", "lines"),
    [
        ("level (m)", "level (m)"),
        ("belief\nlevel (m)", "belief\nlevel (m)"),
        ("a.actuator_fault_probability", "a.actuator_fault_\nprobability"),
        ("TT-4402 temperature of the outlet (degC)", "TT-4402 temperature of\nthe outlet (degC)"),
        ("W" * 30, "W" * 24 + "\n" + "W" * 6),
        ("", ""),
    ],
)
def test_a_long_label_has_several_lines(label, lines):
    assert broken(label, PANEL) == lines


def test_a_lower_panel_has_shorter_lines_and_small_letters_longer_ones():
    assert broken("LT201 ultrasonic\n(m)", 0.85, 8.0) == "LT201\nultrasonic\n(m)"
    assert broken("LT201 ultrasonic\n(m)", 0.85, 5.0) == "LT201 ultrasonic\n(m)"


@pytest.mark.parametrize(
    ("largest", "texts"),
    [(2e-5, {"0", "1e−05", "2e−05"}), (3e7, {"0", "2e+07"}), (0.2, {"0.0", "0.1", "0.2"})],
)
def test_no_exponent_stands_above_a_panel(largest, texts):
    """There are the names of faults: matplotlib wrote its 1e-5 over them."""
    figure, axes = make_panels([1.5, 1.5])
    time = np.linspace(0.0, 10.0, 50)
    for axis in axes:
        axis.plot(time, largest * np.sin(time))
    axes[1].set_yscale("log")
    finish(axes, time)
    figure.draw_without_rendering()
    assert axes[0].yaxis.get_offset_text().get_text() == ""
    assert texts <= {label.get_text() for label in axes[0].get_yticklabels()}


@pytest.mark.parametrize("count", [100, 20_000, 20_001, 30_001, 86_400, 1_000_003])
def test_a_long_line_keeps_its_peaks_its_order_and_its_end(count):
    """Every second point of a run of 300 s was left out, and with them the alarms that the table had."""
    time, values = np.arange(count, dtype=float), np.random.default_rng(count).normal(size=count)
    values[count // 3], values[count // 2], values[-3] = 99.0, -99.0, 50.0
    values[count // 5 : count // 5 + 2000 * (count > 20_000)] = np.nan
    at, shown = thin(time, values)
    assert len(at) <= 20_000
    assert (np.diff(at) >= 0).all()
    assert np.array_equal(values[at.astype(int)], shown, equal_nan=True)
    assert (np.nanmin(shown), np.nanmax(shown)) == (-99.0, 99.0)
    assert 50.0 in shown
    assert np.isnan(shown).any() == np.isnan(values).any()


def test_marks_of_a_long_run_have_the_spread_of_the_samples():
    """Those of the extremes alone looked like twice the noise."""
    values = np.random.default_rng(0).normal(size=100_000)
    at, shown = thin_marks(np.arange(100_000.0), values)
    assert len(at) <= 20_000
    assert np.std(shown) == pytest.approx(1.0, abs=0.03)


def test_outliers_among_markers_remain_and_no_marker_is_no_error():
    """Of 50 spikes 7 were drawn; a sensor without any sample was an error."""
    values = np.random.default_rng(0).standard_normal(100_000)
    spikes = np.arange(1001, 100_000, 2000)
    values[spikes] = 60.0
    at, shown = thin_marks(np.arange(100_000.0), values)
    assert set(spikes) <= set(at)
    assert len(at) <= 20_050
    assert (shown == values[at.astype(int)]).all()
    for empty in (np.zeros(0), np.full(100_000, np.nan)):
        assert len(thin_marks(np.arange(float(len(empty))), empty)[0]) == min(len(empty), 20_000)
