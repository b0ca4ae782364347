"""Constant differences between redundant sensors: what counts as one, and fits of sensors that differ."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim
from bayesftc.cosim.fitting.offsets import constant_offsets, std_of_common
from bayesftc.cosim.fitting.search import Problem
from bayesftc.cosim.fitting.uncertainty import covariance, without_offsets
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


def test_residuals_with_a_common_error_are_those_of_its_covariance():
    """Least squares of them is generalized least squares with the dense covariance of noise and common error."""
    rng = np.random.default_rng(1)
    y, scale, common = rng.standard_normal((30, 3)), rng.uniform(0.5, 2.0, (30, 3)), np.array([0.0, 0.7, 0.7])
    problem = Problem(None, None, None, y, np.array([0, 1, 1]), scale, common)
    residuals = y * scale
    s = (scale * (common > 0)).ravel()
    whole = np.linalg.inv(np.eye(90) + 0.7**2 * np.outer(s, s))
    zero = np.zeros((30, 2))
    assert np.sum(problem.residuals(zero) ** 2) == pytest.approx(residuals.ravel() @ whole @ residuals.ravel())
    expected = 0.7**2 * s @ whole @ residuals.ravel()  # the mean of the error, given the residuals
    np.testing.assert_allclose(problem.common_errors(zero), [0.0, expected, expected])
    np.testing.assert_array_equal(replace(problem, common=np.zeros(3)).residuals(zero), residuals.ravel())


def test_the_covariance_is_that_of_a_fit_of_parameters_and_offsets():
    rng = np.random.default_rng(2)
    jacobian, scale = rng.standard_normal((40, 3, 2)), rng.uniform(0.0, 2.0, (40, 3))
    jacobian *= scale[:, :, None]
    of = np.array([0, 0, 1])
    # The offsets of the two sensors of an output, of which the weighted mean is 0.
    W = (scale**2).sum(axis=0)
    offset = np.zeros((40, 3))
    offset[:, 0], offset[:, 1] = scale[:, 0] / W[0], -scale[:, 1] / W[1]
    joint = np.column_stack([jacobian.reshape(-1, 2), offset.ravel()])
    known = np.linalg.inv(joint.T @ joint)[:2, :2]
    reduced = without_offsets(jacobian, scale, np.array([0.1, -0.1, 0.0]), of)
    np.testing.assert_allclose(covariance(reduced, np.zeros((40, 3)), correlated=False), known)
    assert without_offsets(jacobian, scale, np.zeros(3), of) is jacobian


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
    assert fitted.std["v0"] == pytest.approx(off / 2, rel=0.1)
    assert fitted.std["b"] == pytest.approx(6.0 / speed * off / 2, rel=0.1)
    assert abs(fitted.parameters["v0"] - speed) < 1.5 * fitted.std["v0"]
