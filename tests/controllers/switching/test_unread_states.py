"""States that no sensor reads: while nothing fails, the belief is that of a Kalman filter (filterpy)."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc import controllers

A = np.array(  # air, walls, and the temperature outside; 30 s
    [[0.98836, 0.0039744, 0.00079546], [0.00019878, 0.99972, 0.000080078], [0.0, 0.0, 0.998612]]
)


def apart(model, start, samples, seed, learner=controllers.SwitchingPrecision()):  # noqa: B008 - never changed
    """Return how far the belief is from the filter's, root mean square in the filter's mean standard deviations."""
    A, C, Q, R = (model.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    random, x = np.random.default_rng(seed), np.zeros(len(A))
    step = controllers.StateEstimator(model, learner, initial_covariance=start).online()
    oracle = KalmanFilter(len(A), len(C))
    oracle.F, oracle.H, oracle.Q, oracle.R, oracle.P = A, C, Q, R, start
    off, wide = [], []
    for k in range(samples):
        y = C @ x + np.sqrt(np.diag(R)) * random.standard_normal(len(C))
        if k:
            oracle.predict()
        oracle.update(y)
        off.append(step(y=y).x_hat - oracle.x.ravel())
        wide.append(np.sqrt(np.diag(oracle.P)))
        x = A @ x + np.sqrt(np.diag(Q)) * random.standard_normal(len(A))
    return np.sqrt(np.mean(np.square(off), axis=0)) / np.mean(wide, axis=0)


def test_walls_and_the_temperature_outside_are_estimated():
    model = controllers.LinearModel(
        A, np.zeros((3, 1)), np.eye(3)[[0, 0, 0]], np.diag([1e-6, 0.0, 0.025]), 0.04 * np.eye(3), dt=30.0
    )
    # A belief that fades without bound is 77 of the filter's standard deviations off for the walls, 15 for the load.
    assert (apart(model, np.diag([0.01, 0.01, 9.0]), 2880, seed=5) < 0.3).all()


def test_a_constant_without_noise_may_still_jump():
    """Nothing is known of it without samples, so that it has no limit: three healthy sensors are not blamed for its jump."""
    A, C, R = np.array([[0.95, 0.05], [0.0, 1.0]]), np.eye(2)[[0, 0, 0]], 1e-2 * np.eye(3)
    model = controllers.LinearModel(A, np.zeros((2, 1)), C, np.diag([1e-4, 0.0]), R, dt=0.1)
    step = controllers.StateEstimator(model, controllers.SwitchingPrecision(), initial_covariance=np.eye(2)).online()
    random, x, blamed = np.random.default_rng(0), np.zeros(2), []
    for k in range(1200):
        x = A @ x + [0.01 * random.standard_normal(), float(k == 400)]
        blamed.append(step(y=C @ x + 0.1 * random.standard_normal(3)).fault_probability > 0.5)
    assert np.mean(blamed) < 0.01


def random_model(seed):
    """Return a stable model with 1 to 4 states, of which 1 or 2 have sensors, and noise on some states, with its start."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 5))
    read = int(random.integers(1, min(n, 2) + 1))
    decay = np.exp(-1.0 / 10 ** random.uniform(0.3, 4.0, n))  # time constants of 2 to 10,000 samples
    coupled = 0.5 * random.standard_normal((n, n)) * (1 - decay)[:, None] * (random.random((n, n)) < 0.6)
    np.fill_diagonal(coupled, decay)
    coupled *= min(1.0, 0.9999 / np.abs(np.linalg.eigvals(coupled)).max())
    noise = 10 ** random.uniform(-3.0, 0.0, n) * (1 - decay**2)
    counts = random.integers(2, 4, read)
    R = np.diag(np.repeat(10 ** random.uniform(-4.0, 0.0, read), counts))
    C = np.repeat(np.eye(n)[:read], counts, axis=0)
    step = round(10 ** random.uniform(-3.0, 2.0), 6)
    Q = np.diag(noise * (random.random(n) < 0.5)) + np.diag(np.eye(n)[-1] * noise)
    start = np.diag(noise / (1 - decay**2))
    return controllers.LinearModel(coupled, np.zeros((n, 1)), C, Q, R, dt=step), start


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(36))
def test_states_of_random_plants_are_estimated(seed):
    model, start = random_model(seed)
    known = controllers.SwitchingPrecision(noise_factor=1.0)  # what is learned of the sensors' noise is another matter
    assert (apart(model, start, 3000, seed, known) < 0.5).all()
