"""Diagnosis of runs in which some sensors have samples only now and then."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc import controllers
from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.diagnosis.slow_sensors import pattern_of
from bayesftc.controllers.estimation.observers import observers

STD = np.array([0.02, 0.02, 0.05, 0.05])
MODEL = controllers.LinearModel(
    [[1.0, 0.02], [0.0, 0.96]],
    [[0.0], [0.04]],
    np.eye(2)[[0, 0, 1, 1]],
    [0.0, 4e-4],
    STD**2,
    dt=0.02,
)


def driven(seed, every, *, effect=1.0, steps=2000):
    """Return samples and controls of a vehicle whose positions come at every n-th step, and its model's effect of the control."""
    rng, x = np.random.default_rng(seed), np.zeros((steps, 2))
    u = np.repeat(rng.normal(0.0, 1.0, -(-steps // 40)), 40)[:steps, np.newaxis]
    for k in range(steps - 1):
        noise = np.array([0.0, 0.02]) * rng.standard_normal(2)
        x[k + 1] = MODEL.matrix("A") @ x[k] + effect * MODEL.matrix("B")[:, 0] * u[k, 0] + noise
    y = x[:, [0, 0, 1, 1]] + STD * rng.standard_normal((steps, 4))
    y[np.arange(steps) % every != 0, :2] = np.nan
    return y, u


@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_innovations_are_those_of_a_kalman_filter_with_the_samples_that_are_there(lost):
    """With samples lost at random the filters of a phase are only nearly those of filterpy."""
    y, u = driven(0, 5)
    y[np.random.default_rng(1).random(y.shape) < lost] = np.nan
    bank = observers(MODEL)
    recording = Recording(y, u, np.zeros(2), pattern=pattern_of(y, range(4)))
    (white,), _ = innovations([MODEL], [bank], recording, (u @ MODEL.matrix("B").T)[None, None])
    for k, chosen in enumerate(bank.sensors):
        kalman = KalmanFilter(2, len(chosen), 1)
        kalman.F, kalman.B, kalman.Q = (MODEL.matrix(name) for name in ("A", "B", "process_covariance"))
        kalman.P, expected = 10.0 * np.eye(2), np.zeros((len(y), 4))
        for i, sample in enumerate(y):
            there = [j for j in chosen if np.isfinite(sample[j])]
            if there:
                C, R = MODEL.matrix("C")[there], np.diag(STD[there] ** 2)
                kalman.update(sample[there][:, np.newaxis], R=R, H=C)
                expected[i, there] = np.linalg.solve(np.linalg.cholesky(kalman.S), kalman.y)[:, 0]
            kalman.predict(u[i][:, np.newaxis])
        apart = (white[k, 0] - expected)[1000:, list(chosen)]
        assert np.abs(apart).max() < (1e-8 if not lost else 0.5)
        assert (
            np.mean(white[k, 0][1000:][np.isfinite(y[1000:])[:, list(chosen)].all(axis=1)][:, list(chosen)] ** 2) < 1.15
        )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(12))
def test_a_right_model_is_not_blamed(seed):
    """Noise was named in 10 of 24 healthy runs of a car with slow cameras, and two loads in one."""
    assert controllers.diagnose_recording(MODEL, *driven(seed, 6)) is None


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_effect_is_named(seed):
    finding = controllers.diagnose_recording(MODEL, *driven(seed, 6, effect=0.6))
    assert finding.kind == "gain"
    assert finding.values[0] == pytest.approx(0.6, abs=0.05)


def test_sensors_that_miss_some_samples_are_not_slow():
    y, _ = driven(0, 1)
    y[np.random.default_rng(0).random(y.shape) < 0.3] = np.nan
    assert pattern_of(y, range(4)) is None
    y[:, 0] = np.nan  # silent throughout
    assert pattern_of(y, range(4)) is None
