"""Probabilities that are not to be trusted are named; right ones are not, however few samples there are."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers.detection.calibration import judge
from bayesftc.controllers.detection.doubt import doubt, too_few

MAP = controllers.Calibration(1.0, 0.0)
"""The feature is the logit of the probability."""


def report(wrong=0.0, steps=4000, seed=0):
    """Return the quality of the probabilities of three sensors; the logit of the last one is wrong by a number."""
    rng = np.random.default_rng(seed)
    logit = rng.normal(-2.0, 2.0, (steps, 3))
    faulty = rng.random(logit.shape) < 1.0 / (1.0 + np.exp(-logit))
    return judge(MAP, logit + np.array([0.0, 0.0, wrong]), faulty)


@pytest.mark.parametrize("steps", [100, 4000])
def test_right_probabilities_raise_no_doubt(steps):
    assert doubt(report(steps=steps)) == ""


def test_the_worst_sensor_is_named_with_its_mean():
    judged = report(wrong=5.0)
    words = doubt(judged, ("h2", "h2", "h1"))
    low, high = judged.calibration_error_interval
    assert low < judged.calibration_error < high
    assert judged.brier > judged.brier_of_constant
    assert (
        "Brier score is worse than that of a constant, and they differ from the observed shares of faults by 0."
        in words
    )
    assert f"(95 % interval {low:.3f} to {high:.3f}). The worst are those of sensor 2 (h1): their mean is 0." in words
    assert "those of sensor 2: " in doubt(judged)


def test_an_error_counts_alone():
    words = doubt(report(wrong=2.0))
    assert "Brier" not in words
    assert words.startswith("Do not rely on these probabilities for such faults: they differ from")


def test_the_numbers_of_the_worst_sensor_are_those_of_its_samples():
    judged = report(wrong=5.0)
    sensor = judged.sensors[2]
    share = float(np.nansum(sensor.observed * sensor.samples) / sensor.samples.sum())
    assert sensor.samples.sum() == 4000
    assert f"it is in fault in {share:.1%} of its samples." in doubt(judged)


def test_enough_faults_are_twenty_of_each_sensor_and_more_steps_are_named_than_the_run_had():
    judged = report()
    assert too_few(judged, 5000) == ""
    assert too_few(replace(judged, faults=60), 5000) == ""
    few = replace(judged, faults=59)
    assert "59 begin in it, of at least 60. Give --steps 400000." in too_few(few, 400_000)
    # 4000 steps in the test are a run of 20 000, which had few faults by chance
    assert 30_000 <= int(too_few(few, 5000).split()[-1].strip(".")) <= 31_000
