"""Diagnosis of runs in which some sensors have samples only now and then."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm, solve_discrete_are

from bayesftc import controllers
from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.diagnosis.slow_sensors import presence_of
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
    y, u = driven(0, 5)
    y[np.random.default_rng(1).random(y.shape) < lost] = np.nan
    bank = observers(MODEL)
    recording = Recording(y, u, np.zeros(2), presence=presence_of(y, range(4)))
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
        assert np.abs(apart).max() < 1e-6
        assert (
            np.mean(white[k, 0][1000:][np.isfinite(y[1000:])[:, list(chosen)].all(axis=1)][:, list(chosen)] ** 2) < 1.15
        )


def every(steps, at, sensors=slice(None)):
    """Return where there are samples (steps x 4): of some sensors at every n-th step, from ``at`` on at every 12th."""
    k, there = np.arange(steps), np.ones((steps, 4), dtype=bool)
    there[:, sensors] = np.where(k < at, k % 4 == 0, k % 12 == 0)[:, np.newaxis]
    return there


def outages(steps, rng):
    """Return where there are samples: at every fourth step, but none for 60 steps now and then."""
    there, k = every(steps, steps), 0
    while k < steps:
        k += int(rng.exponential(500))
        there[k : k + 60] = False
        k += 60
    return there


PATTERNS = {
    "regular": lambda rng: every(2000, 2000, [0, 1]),
    "lost at random": lambda rng: every(3000, 3000) & (rng.random((3000, 4)) > 0.15),
    "outages": lambda rng: outages(3000, rng),
    "another rate": lambda rng: every(2000, 1000),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_right_model_is_not_blamed(pattern, seed):
    """With the steady filter of samples in each step, noise was named in each run with outages or another rate."""
    there = PATTERNS[pattern](np.random.default_rng(seed + 1000))
    y, u = driven(seed, 1, steps=len(there))
    assert controllers.diagnose_recording(MODEL, np.where(there, y, np.nan), u) is None


@pytest.mark.slow
def test_models_whose_filters_are_lost_do_not_spoil_the_others():
    """Of the time scales that are tried for a falling plant with rare samples, two have no filter."""
    true = fallen(0.02 * 1.25)
    gain = np.linalg.solve(
        1.0 + true.B.T @ (P := solve_discrete_are(true.A, true.B, np.eye(2), 1.0)) @ true.B, true.B.T @ P @ true.A
    )
    rng, x, u = np.random.default_rng(0), np.zeros((2000, 2)), np.zeros((2000, 1))
    goal = np.repeat(rng.normal(0.0, 0.3, 20), 100)
    for k in range(1999):
        u[k] = -gain @ (x[k] - [goal[k], 0.0])
        x[k + 1] = true.A @ x[k] + true.B @ u[k] + [0.0, 0.01 * rng.standard_normal()]
    y = x[:, [0, 0, 1, 1]] + np.array([0.01, 0.01, 0.05, 0.05]) * rng.standard_normal((2000, 4))
    y[np.arange(2000) % 40 != 0] = np.nan
    finding = controllers.diagnose_recording(fallen(0.02), y, u)
    assert finding.kind == "dt"
    assert finding.values[0] == pytest.approx(1.25, abs=0.1)


def fallen(dt):
    """Return the model of a plant that falls unless it is held, sampled in a step of 0.02 s as if that were `dt`."""
    held = expm(dt * np.array([[0.0, 1.0, 0.0], [16.0, -0.2, 1.0], [0.0, 0.0, 0.0]]))
    noise = [0.0, 1e-4], np.array([0.01, 0.01, 0.05, 0.05]) ** 2
    return controllers.LinearModel(held[:2, :2], held[:2, 2:], np.eye(2)[[0, 0, 1, 1]], *noise, dt=0.02)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_effect_is_named(seed):
    finding = controllers.diagnose_recording(MODEL, *driven(seed, 6, effect=0.6))
    assert finding.kind == "gain"
    assert finding.values[0] == pytest.approx(0.6, abs=0.05)


def test_sensors_that_miss_some_samples_are_not_slow():
    y, _ = driven(0, 1)
    y[np.random.default_rng(0).random(y.shape) < 0.3] = np.nan
    assert presence_of(y, range(4)) is None
    y[:, 0] = np.nan  # silent throughout
    assert presence_of(y, range(4)) is None
