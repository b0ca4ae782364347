"""Constant differences between redundant sensors: what counts as one, and fits of sensors that differ."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim
from bayesftc.cosim.fitting.offsets import constant_offsets, std_of_common
from bayesftc.cosim.fitting.search import Problem
from bayesftc.examples.fitted_car.recordings import CAR, NAMES, NOISE, RANGES, TRUE, recording

ROWS = 2000
PAIR = np.zeros(2, dtype=np.int64)


def noise(*offsets, std=1.0):
    """White noise of a sensor for each offset, from which it is that far."""
    return np.random.default_rng(0).standard_normal((ROWS, len(offsets))) * std + np.array(offsets)


def test_two_sensors_without_a_difference_have_no_offsets():
    assert not constant_offsets(noise(0.0, 0.0), PAIR).any()
    assert not constant_offsets(noise(0.0, 3.0), np.arange(2)).any()  # of two outputs


@pytest.mark.parametrize("begin", [0, 700, 1400])
@pytest.mark.parametrize(
    "fault", [lambda y: y + 20.0, lambda y: 0.0 * y - 5.0, lambda y: y + np.linspace(0, 9, len(y))]
)
def test_a_fault_of_a_quarter_hardly_moves_an_offset_and_makes_none(begin, fault):
    for offset in (0.0, 1.0):
        y = noise(0.0, offset)
        y[begin : begin + 500, 1] = fault(y[begin : begin + 500, 1])
        np.testing.assert_allclose(np.diff(constant_offsets(y, PAIR)), offset, atol=0.25)


def test_a_sensor_that_drifts_all_the_time_has_no_constant_offset():
    assert not constant_offsets(noise(0.0, 0.0) + np.outer(np.linspace(0.0, 10.0, ROWS), [0.0, 1.0]), PAIR).any()


@pytest.mark.parametrize("share", [0.2, 0.3, 0.4])
@pytest.mark.parametrize("late", [False, True])
def test_a_fault_for_most_of_the_recording_is_no_offset(share, late):
    y, healthy = noise(0.0, 8.0), int(share * ROWS)
    y[slice(ROWS - healthy, None) if late else slice(healthy), 1] -= 8.0
    assert not constant_offsets(y, PAIR).any()


def test_where_no_majority_agrees_each_sensor_may_be_right():
    assert std_of_common(np.array([0.0, -1.0]), PAIR) == pytest.approx(0.5**0.5)  # the first is precise
    four = np.zeros(4, dtype=np.int64)
    assert std_of_common(np.array([-1.0, -1.0, 0.0, 0.0]), four) == pytest.approx(0.5**0.5)


def test_the_common_reading_is_that_of_the_precise_sensor_or_of_most_sensors():
    few, many = constant_offsets(noise(0.0, 1.0, std=[0.01, 1.0]), PAIR)
    assert abs(few) < 0.001 < 0.8 < many
    three = np.zeros(3, dtype=np.int64)
    for wrong in range(3):
        known = 5.0 * (np.arange(3) == wrong)
        offsets = constant_offsets(noise(*known), three)
        np.testing.assert_allclose(offsets, known, atol=0.2)
        assert not std_of_common(offsets, three).any()
    np.testing.assert_allclose(std_of_common(constant_offsets(noise(0.0, 4.0), PAIR), PAIR), 2.0, atol=0.1)


@pytest.mark.parametrize("free", [False, True])
def test_residuals_are_those_of_the_covariance_of_noise_and_offsets(free):
    """Least squares of them is generalized least squares with the dense covariance."""
    rng, nan = np.random.default_rng(1), np.nan
    y, scale, t = rng.standard_normal((30, 3)), rng.uniform(0.5, 2.0, (30, 3)), 0.7
    problem = Problem(None, None, None, y, np.array([0, 1, 1]), scale, np.array([nan, t, t]), free)
    residuals, weights, zero = (y * scale).ravel(), (scale**2).sum(axis=0), np.zeros((30, 2))
    # A common error, and one that leaves the weighted mean of the two sensors as it is, of which nothing is known before.
    errors = np.zeros((30, 3, 2))
    errors[:, 1:, 0], errors[:, 1, 1], errors[:, 2, 1] = (
        scale[:, 1:],
        scale[:, 1] / weights[1],
        -scale[:, 2] / weights[2],
    )
    errors, prior = errors.reshape(90, 2), np.diag([t**2, 1e8 * free])
    whole = np.linalg.inv(np.eye(90) + errors @ prior @ errors.T)
    assert np.sum(problem.residuals(zero) ** 2) == pytest.approx(residuals @ whole @ residuals, rel=1e-5)
    common, apart = prior @ errors.T @ whole @ residuals  # their means, given the residuals
    expected = [0.0, common + apart / weights[1], common - apart / weights[2]]
    np.testing.assert_allclose(problem.offsets(zero), expected, atol=1e-5)
    np.testing.assert_array_equal(replace(problem, common=np.full(3, nan)).residuals(zero), residuals)


def test_offsets_are_those_of_the_sensors_at_the_same_times_and_not_of_the_fmu():
    """The FMU errs by 3 where one of the sensors does not count: this is no offset of the others."""
    error, weights, true = np.repeat([3.0, -1.0], [500, 1500]), np.ones((ROWS, 3)), np.array([0.0, 1.5, -0.7])
    weights[:500, 1] = 0.0
    y = noise(*true) + error[:, None]
    y[:500, 1] += np.linspace(0.0, 20.0, 500)
    problem = Problem(None, None, None, y, np.zeros(3, dtype=np.int64), np.sqrt(weights), np.ones(3), free=True)
    found = problem.offsets_at_same_times(np.zeros((ROWS, 1)))
    np.testing.assert_allclose(found - found[0], true, atol=0.15)
    least_squares = problem.offsets(np.zeros((ROWS, 1)))
    assert abs((least_squares - least_squares[0])[1] - true[1]) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.5, 1.0, 5.0])
@pytest.mark.parametrize("faulty", [False, True])
def test_healthy_sensors_that_differ_count_and_the_parameters_are_right(offset, faulty):
    """The offset is in standard deviations of the noise; the other sensor fails for a fifth of the time."""
    table = recording(3, 1500)
    table["v1"] += offset * NOISE
    if faulty:
        table.loc[400:700, "v0"] += 8 * NOISE
    fitted = cosim.fit(CAR, table, RANGES, **NAMES)
    for name, value in TRUE.items():
        assert abs(fitted.parameters[name] - value) < 3 * fitted.std[name]
    assert fitted.offsets["v1"] - fitted.offsets["v0"] == pytest.approx(offset * NOISE, abs=0.2 * NOISE)
    healthy = np.ones((1500, 2), dtype=bool)
    healthy[400:701, 0] = not faulty
    assert fitted.weights[healthy].mean() > 0.98
    assert not faulty or fitted.weights[405:695, 0].max() < 0.1
    assert sum("differ by a constant" in sentence for sentence in fitted.sentences) == 1
    assert any("m/s" in sentence and "subtracts them" in sentence for sentence in fitted.sentences)
    assert not any(sentence.startswith("v1: ") for sentence in fitted.sentences)
    assert fitted.rms["v1"] == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["v0", "v1"])
def test_where_the_motion_does_not_show_which_sensor_errs_the_standard_error_has_it(wrong):
    """At a constant speed, drag and initial speed explain any constant error: the speed is known to half of the difference."""
    rng, speed, off = np.random.default_rng(4), 40.0, 1.0
    table = pd.DataFrame({"time": 0.1 * np.arange(1000), "u": 240.0})
    for name in ("v0", "v1"):
        table[name] = speed + 0.1 * rng.standard_normal(1000) + off * (name == wrong)
    fitted = cosim.fit(CAR, table, {"b": (1.0, 20.0), "v0": (30.0, 50.0)}, **NAMES)
    assert not any("does not follow" in sentence for sentence in fitted.sentences)
    assert fitted.std["v0"] == pytest.approx(off / 2, rel=0.1)
    assert fitted.std["b"] == pytest.approx(6.0 / speed * off / 2, rel=0.1)
    assert abs(fitted.parameters["v0"] - speed) < 1.5 * fitted.std["v0"]


@pytest.mark.slow
def test_a_sensor_that_is_there_for_a_part_of_the_time_has_an_honest_offset():
    """One sensor ends soon after the other, which is off, has begun: the overlap alone shows the difference."""
    z = []
    for seed in range(30):
        table = recording(seed, 1000)
        table["v1"] += 2.0 * NOISE
        table.loc[550:, "v0"] = np.nan
        table.loc[:449, "v1"] = np.nan
        fitted = cosim.fit(CAR, table, RANGES, **NAMES, held_out=0.0)
        z += [(fitted.parameters[name] - value) / fitted.std[name] for name, value in TRUE.items()]
    assert np.mean(np.abs(z) < 2) >= 0.9  # of 90 normal numbers 95.4 %, give or take 2.2 %
