"""Time is a whole number of steps times a fraction."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bayesftc import cosim
from bayesftc.cosim.base.timebase import rational_step, share_of_time, show, spoken, whole_number, whole_steps


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (0.02, Fraction(1, 50)), ("1/30", Fraction(1, 30)), (1 / 30, Fraction(1, 30)), ("0.1", Fraction(1, 10)), (2, Fraction(2)),
        (Fraction(3, 7), Fraction(3, 7)), (np.float64(0.001), Fraction(1, 1000)), (np.float32(0.5), Fraction(1, 2)),
        (np.int64(3), Fraction(3)), (1 / 44100, Fraction(1, 44100)), (1e-10, Fraction(1, 10**10)), (1e-6, Fraction(1, 10**6)),
        (2.5, Fraction(5, 2)), (3 * 0.1, Fraction(3, 10)), (1.1 - 1.0, Fraction(1, 10)), (math.pi / 100, None),
    ],
)  # fmt: skip
def test_a_step_means_what_it_says(given, meant):
    step = rational_step(given)
    assert step == meant or (meant is None and float(step) == given and step.denominator < 10**9)


@given(st.floats(1e-6, 1e6))
def test_a_step_is_what_was_given_and_small_enough_to_count_with(dt):
    step = rational_step(dt)
    assert abs(step / Fraction(dt) - 1) <= Fraction(1, 10**15)
    assert step.denominator < 2**53


@pytest.mark.parametrize(
    "wrong", [0, -0.1, "0", math.nan, math.inf, "nan", "a", None, [1.0], "1/0", 1j, "1e999999999", "1e-999999999"]
)
def test_no_step(wrong):
    with pytest.raises(cosim.StepSizeError, match=r"^The diagram's step size .*(must be positive|is no finite number)"):
        cosim.Diagram(wrong)


@pytest.mark.parametrize(
    ("duration", "step", "steps"),
    [(20.0, "1/50", 1000), (0.3, "1/10", 3), (1.0, "1/30", 30), ("1/3", "1/30", 10), (0, "1/7", 0), (1e6, "1/1000", 10**9),
     (0.1 + 0.2, "1/10", 3), (np.float32(1.5), "1/2", 3), (Fraction(2, 3), "1/3", 2)],
)  # fmt: skip
def test_whole_steps(duration, step, steps):
    assert whole_steps(duration, Fraction(step), "The duration") == steps


def test_no_whole_number_of_steps_names_the_near_durations():
    with pytest.raises(cosim.StepSizeError) as caught:
        cosim.Diagram(0.02).simulate(0.05)
    assert str(caught.value) == "The duration of 0.05 s is no whole number of steps of 0.02 s; use 0.04 s or 0.06 s."
    with pytest.raises(cosim.StepSizeError, match=r"no whole number of steps of 1/30 s"):
        cosim.Diagram("1/30").simulate(1.0001)


@pytest.mark.parametrize("wrong", [-1, -1e-9, "-2", Fraction(-1), math.inf, math.nan, "nan", "long", None])
def test_no_duration(wrong):
    with pytest.raises(cosim.StepSizeError, match=r"The duration .*(must not be negative|is no finite number)"):
        cosim.Diagram(1).simulate(wrong)


def test_too_far_out_to_be_exact():
    step = rational_step(math.pi / 1000)
    with pytest.raises(cosim.StepSizeError, match="times are not exact"):
        whole_steps(10**14 * step, step, "The duration")
    with pytest.raises(cosim.StepSizeError, match="times are not exact"):
        cosim.Diagram(Fraction(1, 2**60)).simulate(0)


def clock(t, k, seconds, count):
    seconds[0] = t
    count[0] = k


class Clock(cosim.Block):
    outputs = (cosim.Port("seconds"), cosim.Port("count"))

    def define(self, step):
        return cosim.Definition(clock)


@pytest.mark.slow
@pytest.mark.parametrize("dt", ["1/30", math.pi / 100, "12345/7"])
def test_a_million_times_are_the_nearest_doubles(dt):
    diagram = cosim.Diagram(dt)
    diagram.add(Clock(), "clock")
    n = 10**6
    result = diagram.simulate(n * diagram.step, engine="compiled")
    step = diagram.step
    exact = np.array(
        [k * step.numerator / step.denominator for k in range(n + 1)]
    )  # Python rounds this quotient correctly
    np.testing.assert_array_equal(result["clock.seconds"], exact)
    np.testing.assert_array_equal(result.time, exact)
    assert (np.diff(result["clock.count"]) == 1).all()


def test_a_slow_block_sees_its_own_count_and_the_true_time(run_both):
    diagram = cosim.Diagram("1/30")
    for every in (1, 2, 3, 5):
        diagram.add(Clock(), f"c{every}", every=every)
    result = run_both(diagram, 2)
    for every in (1, 2, 3, 5):
        np.testing.assert_array_equal(result[f"c{every}.count"], np.arange(61) // every)
        np.testing.assert_array_equal(result[f"c{every}.seconds"], [k // every * every / 30 for k in range(61)])


@pytest.mark.parametrize("wrong", [0, -1, 1.5, math.nan, math.inf, "2", None, 2**60])
def test_whole_number(wrong):
    with pytest.raises(cosim.ModelError, match=r"decimation is .*whole number"):
        cosim.Diagram(1).simulate(1, decimation=wrong)


def test_whole_number_takes_what_is_whole():
    assert [whole_number(n, "") for n in (1, 2.0, np.int8(3), Fraction(4))] == [1, 2, 3, 4]


def test_show():
    assert [show(Fraction(s)) for s in ("1/50", "1/30", "2", "1/1000000")] == ["0.02", "1/30", "2", "1e-06"]


def test_long_times_are_written_in_units_that_one_can_read():
    assert [spoken(t) for t in (0.0252, 1.5, 119, 120, 7199, 7200, 172799, 172800)] == [
        "0.025 s", "1.5 s", "119 s", "2 min", "120 min", "2 h", "48 h", "2 d",
    ]  # fmt: skip
    assert share_of_time(1.35732e6, 2.16e7) == "15.71 of 250 d"
    assert share_of_time(3600.0, 21600.0) == "1 of 6 h"
    assert share_of_time(12.5, 9000.0) == "12.5 of 9000 s"
