"""The plant starts elsewhere than the controller believes: the first samples say where, and no sensor is blamed for it."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc.controllers import LinearModel, StateEstimator, SwitchingPrecision
from bayesftc.cosim.errors import ModelError

STEP = 0.1
Q = [[1e-5, 1e-4], [1e-4, 2e-3]]


def model(sensors):
    """Return a vehicle with sensors of its position (p) and speed (v), each with a noise of .02."""
    C = [[1.0, 0.0] if quantity == "p" else [0.0, 1.0] for quantity in sensors]
    return LinearModel([[1.0, STEP], [0.0, 0.95]], [[0.0], [STEP]], C, Q, 4e-4 * np.ones(len(C)), STEP)


def drive(of, position, speed=0.0, offsets=(0.0, 0.0, 0.0), begins=(0, 0, 0), steps=60, seed=0, **settings):
    """Return state, estimate and fault probabilities of each step; the offsets are those of the sensors, from the start on.

    A sensor sends nothing before the step at which it begins.
    """
    rng, x = np.random.default_rng(seed), np.array([position, speed])
    settings = {"loss": 0.05} | settings
    step = StateEstimator(of, SwitchingPrecision(**settings), initial_covariance=1e-3).online(compiled=False)
    A, C, m = of.matrix("A"), of.undelayed.matrix("C"), of.sensors
    late = (0,) * m if of.delays is None else of.delays.sensors
    states, found = [x] * 5, []
    for k in range(steps):
        y = (
            np.array([C[i] @ states[-1 - late[i]] for i in range(m)])
            + 0.02 * rng.normal(size=m)
            + np.resize(offsets, m)
        )
        y[np.resize(begins, m) > k] = np.nan
        out = step(y=list(y), u=[0.0])
        found.append((states[-1][0], out.x_hat[0], out.fault_probability.copy()))
        states.append(A[:2, :2] @ states[-1] + rng.multivariate_normal([0, 0], Q))
    return tuple(np.array(values) for values in zip(*found, strict=True))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("position", [0.3, -5.0, 400.0])
@pytest.mark.parametrize("sensors", ["ppp", "pp", "pv", "ppvv"])
def test_healthy_sensors_are_not_blamed_for_it(sensors, position):
    """The only sensor of a quantity may be faulty with a small probability; the estimate is the mean of both."""
    x, estimate, probability = drive(model(sensors), position)
    assert np.abs(estimate - x).max() < 0.06 + 0.005 * abs(position)
    assert np.abs(estimate - x)[10:].max() < 0.06
    assert probability[:30].max() < 0.1


def test_without_doubt_they_are():
    x, estimate, probability = drive(model("ppp"), -5.0, start_doubt=0.0)
    assert (probability > 0.9).all(axis=1).any()
    assert np.abs(estimate - x).max() > 1.0


def test_the_only_sensor_of_a_quantity_is_believed_unless_the_start_is_certain():
    """A place and an offset from the first sample on look the same."""
    x, estimate, probability = drive(model("pv"), 0.0, offsets=(2.0, 0.0))
    assert (np.abs(estimate - x)[-1] > 1.9, probability[-1, 0] < 0.2) == (True, True)
    x, estimate, probability = drive(model("pv"), 0.0, offsets=(2.0, 0.0), start_doubt=0.0)
    assert (np.abs(estimate - x)[-1] < 0.1, probability[-1, 0] > 0.9) == (True, True)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("faulty", [0, 2, 1])
@pytest.mark.parametrize("position", [0.0, 2.0])
def test_one_faulty_sensor_of_three_does_not_say_where(faulty, position):
    x, estimate, probability = drive(model("ppp"), position, offsets=5.0 * np.eye(3)[faulty])
    assert np.abs(estimate - x).max() < 0.06
    assert probability[-1, faulty] > 0.99
    assert np.delete(probability, faulty, axis=1)[:30].max() < 0.2


@pytest.mark.sampled(1)
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_sensor_that_begins_later_says_it_for_its_quantity(speed):
    """Position and speed are believed to be zero; the position is told by sensors that begin after that of the speed."""
    x, estimate, probability = drive(model("ppv"), 2.0, speed, begins=(3, 5, 0))
    assert np.abs(estimate - x)[3:].max() < 0.06
    assert np.median(probability[6:], axis=0).max() < 0.2


def test_past_readings_are_those_of_the_place():
    x, estimate, probability = drive(model("ppp").with_delays(sensors=[0, 1, 3]), 2.0)
    assert np.abs(estimate - x).max() < 0.06
    assert probability.max() < 0.1


def test_the_belief_is_then_that_of_filterpy_from_the_median_on():
    """It goes to the median sample, with this sensor's variance besides its own, and may move; all samples correct it."""
    of, rng = model("ppp"), np.random.default_rng(5)
    y = 7.0 + 0.02 * rng.normal(size=3)
    precision = SwitchingPrecision(noise_factor=1.0, start_doubt=0.999)
    out = StateEstimator(of, precision, initial_covariance=1e-3).online(compiled=False)(y=list(y), u=[0.0])
    one = KalmanFilter(2, 3)
    one.x, one.P = np.array([[np.median(y)], [0.0]]), np.diag([1e-3 + 4e-4, 0.101])
    one.H, one.R = of.matrix("C"), of.matrix("sensor_covariance")
    one.update(y[:, None])
    np.testing.assert_allclose(out.x_hat, one.x[:, 0], rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(out.P, one.P, rtol=0.02, atol=1e-9)
    assert out.process_mode_probability[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
def test_it_may_move_as_well(seed):
    x, estimate, probability = drive(model("pp"), 2.0, 1.0, seed=seed)
    assert np.abs(estimate - x).max() < 0.06
    assert probability[:30].max() < 0.2


def test_both_engines_give_the_same_bits(same_bits):
    of = model("ppv").with_delays(sensors=[0, 2, 0])
    plain, fast = (
        StateEstimator(of, SwitchingPrecision(), initial_covariance=1e-3).online(compiled=compiled)
        for compiled in (False, True)
    )
    for k in range(8):
        y = [3.0, 3.01 if k > 2 else np.nan, 0.02]
        one, other = plain(y=y, u=[0.0]), fast(y=y, u=[0.0])
        for name in one:
            same_bits(one[name], other[name])


@pytest.mark.parametrize("value", [1.0, -0.1, np.nan, "much"])
def test_the_doubt_is_a_probability_below_one(value):
    with pytest.raises(ModelError, match="start_doubt"):
        SwitchingPrecision(start_doubt=value)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("std", [(0.3, 0.03, 0.8), (0.8, 0.3, 0.03), (0.3, 0.03), (0.3, 0.3, 0.3)])
@pytest.mark.parametrize("position", [0.0, 0.2, 0.5, 1.0, 1.4, 5.0])
def test_sensors_of_different_noise_say_it_together(position, std):
    """Where a start was near for the noisy sensors but not for the precise one, all healthy ones were blamed to the end."""
    C = np.array([[1.0, 0.0]] * len(std) + [[0.0, 1.0]])
    noise = np.array([*std, 0.1])
    of = LinearModel([[1.0, 0.02], [0.0, 0.995]], [[0.0], [0.02]], C, np.diag([1e-8, 1e-5]), noise**2, 0.02)
    for seed in range(3):
        rng, x = np.random.default_rng(seed), np.array([position, 0.0])
        step = StateEstimator(of, SwitchingPrecision(), initial_covariance=1e-3).online()
        blamed = []
        for _ in range(500):
            out = step(y=list(C @ x + noise * rng.normal(size=len(C))), u=[0.0])
            blamed.append(out.fault_probability > 0.5)
            x = of.A @ x + np.sqrt([1e-8, 1e-5]) * rng.normal(size=2)
        assert np.mean(blamed, axis=0).max() < 0.02
        assert abs(out.x_hat[0] - x[0]) < 0.1
