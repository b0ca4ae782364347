"""The gains in steady state: those of the Riccati equation, and of as many single steps, also where the filter is slow."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, strategies as st

from bayesftc.controllers.bayesian.steady import steady_gains


def problem(seed, noise, decades=3):
    """Return random matrices of a model with three states, and of a goal for the first one."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    A *= rng.uniform(0.9, 1.02) / np.abs(np.linalg.eigvals(A)).max()
    B, C, G = rng.normal(size=(3, 1)), rng.normal(size=(2, 3)), np.eye(1, 3)
    units = 10.0 ** rng.uniform(-decades, decades, 3)
    F = noise * rng.normal(size=(3, 3))
    A, B, C, Q = A * units[:, None] / units, B * units[:, None], C / units, F @ F.T * np.outer(units, units)
    return A, B, C, G, Q, np.diag(rng.uniform(0.1, 10.0, 2)), units[:1, None] ** 2, np.eye(1), np.diag(units**2)


@given(seed=st.integers(0, 10_000), noise=st.sampled_from([1.0, 1e-2, 1e-4]))
def test_the_filter_is_that_of_scipys_riccati_equation(seed, noise):
    A, B, C, G, Q, R, *others = problem(seed, noise)
    gains = steady_gains(A, B, C, G, Q, R, *others, joint=False)
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    np.testing.assert_allclose(gains.K, K, rtol=1e-5, atol=1e-6 * np.abs(K).max())
    np.testing.assert_allclose(gains.T, np.eye(3))


@pytest.mark.slow
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_of_a_slow_filter_they_are_those_of_many_single_steps(seed, joint):
    """Some ten thousand steps, of which a few dozen are taken singly."""
    A, B, C, G, Q, R, goal_covariance, prior, start = problem(seed, 1e-4, decades=0)
    A = A / np.abs(np.linalg.eigvals(A)).max() * 0.9999
    gains = steady_gains(A, B, C, G, Q, R, 1e8 * goal_covariance, prior, start, joint=joint)
    N = G @ Q @ G.T + 1e8 * goal_covariance
    moved = G @ B
    V = np.linalg.inv(N) - np.linalg.inv(N) @ moved @ np.linalg.inv(prior + moved.T @ np.linalg.inv(N) @ moved) @ (
        moved.T @ np.linalg.inv(N)
    )
    information = C.T @ np.linalg.inv(R) @ C
    P = start
    for _ in range(100_000):
        posterior = np.linalg.inv(np.linalg.inv(P) + information)
        seen = np.linalg.inv(np.linalg.inv(posterior) + joint * A.T @ G.T @ V @ G @ A)
        P = A @ seen @ A.T + Q
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    np.testing.assert_allclose(gains.K, K, rtol=1e-6, atol=1e-7 * np.abs(K).max())
    np.testing.assert_allclose(gains.T, seen @ np.linalg.inv(posterior), rtol=1e-6, atol=1e-6)


def test_the_gain_of_a_constant_without_noise_falls_to_nothing_and_one_that_no_sensor_sees_has_none():
    one = np.eye(1)
    quiet = steady_gains(one, one, one, one, 0.0 * one, one, one, one, one, joint=False)
    assert 0.0 < quiet.K[0, 0] < 1e-6
    unseen = steady_gains(
        np.diag([1.2, 0.5]),
        np.ones((2, 1)),
        np.array([[0.0, 1.0]]),
        np.eye(1, 2),
        np.eye(2),
        one,
        one,
        one,
        np.eye(2),
        joint=False,
    )
    assert np.isfinite(unseen.K).all()
    assert unseen.K[1, 0] > 0.0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # the covariance of what no sensor sees grows until it is capped
def test_a_leap_of_a_model_that_no_sensor_sees_whole_may_fail():
    """It is singular or no covariance in these three of 400; they then take single steps, and have gains as before."""
    rng, one = np.random.default_rng(0), np.eye(1)
    for k in range(360):
        n = int(rng.integers(1, 5))
        A = np.diag(rng.choice([0.5, 1.0, 1.2, 1.0 + 1e-9, 0.0, 3.0], n))
        C = rng.normal(size=(1, n)) * (rng.random((1, n)) < 0.6)
        if k % 2:
            A = A + 0.1 * np.triu(rng.normal(size=(n, n)), 1)
        B, Q = rng.normal(size=(n, 1)), np.diag(rng.choice([0, 1e-4, 1.0], n))
        if k in (184, 307, 359):
            gains = steady_gains(A, B, C, np.eye(1, n), Q, one, one, one, np.eye(n), joint=k % 3 == 0)
            assert np.isfinite(gains.K).all()
