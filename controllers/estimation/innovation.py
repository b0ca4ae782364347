"""What a sensor's innovation is: its variance without a fault, and how a filter of fixed gain answers a fault on the sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

SETTLED = 1e-9
"""A response that changes by no more in a step has settled."""

MOST_STEPS = 50_000

SLOWEST = 1.0 - 1e-6
"""A filter with a slower pole counts as one that never comes to rest."""


class Response(NamedTuple):
    """What becomes of a fault that begins at step 0; after the last step given both stay as they are.

    Attributes
    ----------
    mean : ndarray, shape (steps,)
        Mean of the innovation under an offset of 1.
    variance : ndarray, shape (steps,)
        What further noise of variance 1 on the sensor adds to the variance of the innovation.
    """

    mean: Floats
    variance: Floats

    def offset(self, steps: int) -> Floats:
        """Return the mean under an offset of 1 at the first `steps` samples."""
        return _prolonged(self.mean, steps)

    def drift(self, steps: int) -> Floats:
        """Return the mean under an offset that grows by 1 a step, from 0 at the first faulty sample."""
        return np.concatenate([[0.0], np.cumsum(self.offset(max(steps - 1, 0)))])[:steps]

    def noise(self, steps: int) -> Floats:
        """Return the variance added by noise of variance 1."""
        return _prolonged(self.variance, steps)


ABSENT = Response(np.ones(1), np.ones(1))
"""Of a stream whose innovations are the samples themselves, less something that the fault does not touch."""


def steady_covariance(model: LinearModel) -> Floats:
    """Return the covariance of the prediction error, P_t|t-1, of the Kalman filter in steady state.

    Raises
    ------
    ModelError
        If there is no steady state.
    """
    from scipy.linalg import solve_discrete_are

    A, C, Q, R = (model.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    try:
        P = np.asarray(solve_discrete_are(A.T, C.T, Q, R))
        size = float(np.abs(np.linalg.eigvals(_memory(A, C, P, R)[0])).max())
    except (np.linalg.LinAlgError, ValueError):  # also where P is no number
        size = np.inf
    if not size < SLOWEST:
        raise ModelError(
            "The model's filter has no steady state, so no threshold holds for ever: a state is neither seen by a sensor nor "
            "stable, or is a constant without process noise, of which the filter grows ever more certain; give it a little "
            "process_covariance, or leave it out."
        )
    return np.asarray((P + P.T) / 2, dtype=np.float64)


def response(model: LinearModel, sensor: int) -> Response:
    """Return how the Kalman filter in steady state answers a fault on one sensor.

    The prediction error d = x_t|t-1 - x obeys d <- A (I - K C) d + A K (eta + f) - q, and the innovation is C (-d) + eta + f.
    """
    A, C, R = (model.matrix(name) for name in ("A", "C", "sensor_covariance"))
    F, K = _memory(A, C, steady_covariance(model), R)
    column, row = A @ K[:, sensor], C[sensor]
    d, D = np.zeros(len(A)), np.zeros_like(A)
    means, variances = [], []
    for _ in range(MOST_STEPS):
        means.append(1.0 - row @ d)
        variances.append(1.0 + row @ D @ row)
        following, spread = F @ d + column, F @ D @ F.T + np.outer(column, column)
        change = max(np.abs(following - d).max(), np.abs(spread - D).max())
        d, D = following, spread
        if change <= SETTLED * max(1.0, np.abs(d).max(), np.abs(D).max()):
            break
    return Response(np.array(means), np.array(variances))


def slowest(model: LinearModel) -> float:
    """Return the magnitude of the slowest pole of the filter in steady state."""
    A, C, R = (model.matrix(name) for name in ("A", "C", "sensor_covariance"))
    return float(np.abs(np.linalg.eigvals(_memory(A, C, steady_covariance(model), R)[0])).max())


def _memory(A: Floats, C: Floats, P: Floats, R: Floats) -> tuple[Floats, Floats]:
    """Return what is left of a prediction error a step later, A (I - K C), and the gain K."""
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return np.asarray(A @ (np.eye(len(A)) - K @ C)), np.asarray(K, dtype=np.float64)


def _prolonged(values: Floats, steps: int) -> Floats:
    return np.concatenate([values, np.full(max(steps - len(values), 0), values[-1])])[:steps]
