"""The speed with which a model's filter follows the sensors."""

from __future__ import annotations

from functools import lru_cache
from math import inf

import numpy as np

from bayesftc.controllers.estimation.innovation import steady_covariance
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.errors import ModelError

STEPS = 2000
"""Largest number of recursions without a steady state; the share of a state without noise decreases for ever."""


@lru_cache(maxsize=512)
def filter_share(model: LinearModel) -> float:
    """Return the share of a deviation of the state that the model's steady Kalman filter corrects with a sample.

    It is the trace of gain times C, the degrees of freedom for signal (Rodgers, Inverse Methods for Atmospheric Sounding, 2000),
    between 0 and the number of states. Estimated disturbances, such as sensors' errors, do not count, because no loop depends on
    them. It is infinite if rounding removes the sensors' noise.
    """
    moving = model.moving
    plant = moving.states - moving.disturbances
    A, C, Q, R = (moving.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    try:
        P, steps = steady_covariance(moving), 1
    except ModelError:
        P, steps = Q + np.trace(Q) / len(Q) * np.eye(len(Q)), STEPS
    share = 0.0
    for _ in range(steps):
        try:
            K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
        except np.linalg.LinAlgError:
            return inf
        before, share = share, float(np.trace(K[:plant] @ C[:, :plant]))
        if abs(share - before) <= 1e-6 * share:
            break
        P = A @ (P - K @ C @ P) @ A.T + Q
        P = (P + P.T) / 2
    return share


__all__ = ["filter_share"]
