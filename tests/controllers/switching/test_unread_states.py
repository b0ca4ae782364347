"""Slow states that no sensor reads: while nothing fails, the belief is that of a Kalman filter (filterpy)."""

import numpy as np
from filterpy.kalman import KalmanFilter

from bayesftc import controllers

A = np.array(  # air, walls, and the temperature outside; 30 s
    [[0.98836, 0.0039744, 0.00079546], [0.00019878, 0.99972, 0.000080078], [0.0, 0.0, 0.998612]]
)


def test_they_are_estimated_as_by_a_kalman_filter():
    Q, R = np.diag([1e-6, 0.0, 0.025]), 0.04 * np.eye(3)
    model = controllers.LinearModel(A, np.zeros((3, 1)), np.eye(3)[[0, 0, 0]], Q, R, dt=30.0)
    random = np.random.default_rng(5)
    x, start = np.zeros(3), np.diag([0.01, 0.01, 9.0])
    step = controllers.StateEstimator(model, initial_covariance=start).online()
    oracle = KalmanFilter(3, 3)
    oracle.F, oracle.H, oracle.Q, oracle.R, oracle.P = A, model.matrix("C"), Q, R, start
    apart, wide = [], []
    for k in range(2880):
        y = x[0] + 0.2 * random.standard_normal(3)
        if k:
            oracle.predict()
        oracle.update(y)
        apart.append(step(y=y).x_hat - oracle.x.ravel())
        wide.append(np.sqrt(np.diag(oracle.P)))
        x = A @ x + np.sqrt(np.diag(Q)) * random.standard_normal(3)
    # A belief that fades without bound is 77 of the filter's standard deviations off for the walls, 15 for the load.
    assert (np.sqrt(np.mean(np.square(apart), axis=0)) < 0.1 * np.mean(wide, axis=0)).all()
