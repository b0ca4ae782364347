"""The covariance of the predictions is that of the filter's own recursion, also where scipy's solution is none."""

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from bayesftc import controllers, cosim
from bayesftc.controllers.linalg.riccati import predicted_covariance

TANK = (  # a heated tank every 2 s: level and temperature; the tiny elements, which are rounding, mislead scipy's balancing
    np.array([[0.999000500, -8.18417476e-22], [2.35463589e-17, 0.998001999]]),
    np.array([[0.0, 1.0]] * 3),
    np.outer([7.996e-05, -4.4955e-03], [7.996e-05, -4.4955e-03]),
    0.04 * np.eye(3),
)
SEEN = (np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[1.0, 0.0]]), np.diag([1e-4, 1e-3]), np.array([[0.01]]))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("system", "positive"), [(TANK, False), (SEEN, True)])
def test_it_is_the_limit_of_the_filters_recursion(system, positive):
    A, C, Q, R = system
    P = np.eye(2)
    for _ in range(40_000):  # the slowest mode has decayed by exp(-40)
        P = A @ (P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P)) @ A.T + Q
    theirs = solve_discrete_are(A.T, C.T, Q, R)
    assert (np.linalg.eigvalsh((theirs + theirs.T) / 2)[0] > 0) == positive
    found = predicted_covariance(A, C, Q, R)
    np.testing.assert_allclose(found, P, rtol=1e-6, atol=1e-9 * np.abs(P).max())
    assert np.linalg.eigvalsh(found)[0] >= -1e-15


def test_a_heated_tank_with_a_noisy_inflow_gets_a_controller():
    def change(t, x, u, params):
        level, temperature = x
        inflow = 0.0004 + u[1]
        heat = u[0] / 100 * 120e3 / 4.18e6
        return np.array(
            [
                (inflow - 0.0004 * np.sqrt(max(level, 0) / 0.8)) / 0.5,
                (inflow * (15 - temperature) + heat) / (0.5 * level),
            ]
        )

    tank = control.nlsys(
        change,
        lambda t, x, u, params: x,
        inputs=["valve", "inflow"],
        outputs=["level", "temperature"],
        states=["h", "T"],
    )
    controller = controllers.design(
        cosim.StateSpace(tank, initial=[0.8, 60.0]), measured="temperature", actuated="valve", sensors=3, sensor_std=0.2,
        dt=2.0, at={"valve": 62.7}, noise={"inflow": 2e-5}, u_min=0.0, u_max=100.0,
    )  # fmt: skip
    P = np.array(controller.initial_covariance)[:2, :2]
    assert np.linalg.eigvalsh(P)[0] > 0
    assert np.abs(controller.model.matrix("A") @ np.ones(3)).max() < 1.1


@pytest.mark.sampled(1)
@pytest.mark.parametrize("driven", [1e-30, 1e-28])
def test_the_covariance_of_nanometres_in_si_units_is_the_limit_of_the_recursion(driven):
    """Variances of 1e-20 are lost in scipy's solution: it was up to 40 times too large."""
    A, B, C, R = np.array([[1.0, 0.02], [0.0, 0.98]]), np.array([[0.0], [0.02]]), np.array([[1.0, 0.0]]), 1e-28
    Q, P = driven * B @ B.T, 1e-26 * np.eye(2)
    for _ in range(20000):
        K = P @ C.T / (C @ P @ C.T + R)
        P = A @ (P - K @ C @ P) @ A.T + Q
        P = (P + P.T) / 2
    size = np.sqrt(np.diag(P))
    np.testing.assert_allclose(
        predicted_covariance(A, C, Q, np.array([[R]])) / np.outer(size, size), P / np.outer(size, size), atol=1e-4
    )
