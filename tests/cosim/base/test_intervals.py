"""The interval and the step of samples whose time stamps jitter and of which some are lost."""

import numpy as np
import pandas as pd
import pytest

from bayesftc.cosim.base.recordings.intervals import typical_interval, usual_step
from bayesftc.cosim.base.recordings.rows import rows_at_steps
from bayesftc.cosim.errors import StepSizeError


def stamps(rng, n, interval, jitter, loss):
    times = interval * (np.arange(n) + rng.uniform(-jitter, jitter, n))
    return times[rng.random(n) >= loss] + 1e6


def left_out(times, step):
    rows = rows_at_steps(pd.DataFrame({"t": times}), "t", step, ())
    return len(times) - len(np.unique(rows.at))


@pytest.mark.parametrize("jitter", [0.05, 0.2, 0.3])
@pytest.mark.parametrize("loss", [0.0, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("interval", [5.0, 0.04])
def test_the_step_of_a_jittering_clock_loses_no_sample(interval, loss, jitter):
    for seed in range(10):
        times = stamps(np.random.default_rng(seed), 2000, interval, jitter, loss)
        assert float(usual_step(times)) == interval
        assert typical_interval(times) == pytest.approx(interval, rel=1e-3)
        assert left_out(times, interval) == 0


def test_a_round_number_is_no_reason_for_a_wrong_step():
    """An interval of 5.02 s is no 5 s: over a thousand steps the difference is four steps."""
    times = stamps(np.random.default_rng(0), 1000, 5.02, 0.2, 0.05)
    assert float(usual_step(times)) == 5.02


def test_a_logger_that_begins_anew_does_not_change_the_interval():
    rng = np.random.default_rng(1)
    for restart in (7.4, 33.3, 190.7):
        times = stamps(rng, 2000, 5.0, 0.2, 0.02)
        times[1400:] += 5.0 * restart
        assert typical_interval(times) == pytest.approx(5.0, rel=1e-3)


def test_times_without_a_clock_have_a_mean_without_pauses():
    intervals = np.random.default_rng(2).uniform(0.5, 5.5, 3000)
    intervals[1000] = 1e5
    assert typical_interval(np.cumsum(intervals)) == pytest.approx(3.0, rel=0.05)


def test_the_step_that_uneven_rows_need_is_that_of_the_clock():
    times = stamps(np.random.default_rng(3), 2000, 5.0, 0.2, 0.05)
    with pytest.raises(StepSizeError, match=r"Give dt=5, the usual step in seconds"):
        rows_at_steps(pd.DataFrame({"t": times}), "t", None, ())
