"""A sensor's innovation: its variance without a fault, and the steady filter's response to a fault of the sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayesftc.controllers.linalg.riccati import error_transition, predicted_covariance
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

SETTLED = 1e-9
"""A response has settled if it changes by at most this in a step."""

MOST_STEPS = 50_000

SLOWEST = 1.0 - 1e-6
"""A filter with a slower pole counts as one without a steady state."""


class Response(NamedTuple):
    """Response to a fault that begins at step 0; both arrays remain constant after their last step.

    Attributes
    ----------
    mean : ndarray, shape (steps,)
        Mean of the innovation under an offset of 1.
    variance : ndarray, shape (steps,)
        Variance that additional noise of variance 1 on the sensor adds to the innovation.
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
"""Response of a stream whose innovations are its samples less something on which the fault has no effect."""


def steady_covariance(model: LinearModel) -> Floats:
    """Return the covariance of the prediction error, P_t|t-1, of the Kalman filter in steady state.

    Raises
    ------
    ModelError
        If there is no steady state.
    """
    return steady_prediction(*(model.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance")))


def steady_prediction(A: Floats, C: Floats, Q: Floats, R: Floats) -> Floats:
    """Return the result of `steady_covariance`, given the matrices of a model."""
    try:
        P = predicted_covariance(A, C, Q, R)
        size = float(np.abs(np.linalg.eigvals(error_transition(A, C, P, R)[0])).max())
    except (np.linalg.LinAlgError, ValueError):  # also if P is not finite
        size = np.inf
    if not size < SLOWEST:
        raise ModelError(
            "The model's filter has no steady state, so no constant threshold exists. Either a state is neither stable nor seen "
            "by a sensor, or it is a constant without process noise, of which the filter becomes ever more certain. Give that "
            "state a little process_covariance, or leave it out."
        )
    return np.asarray((P + P.T) / 2, dtype=np.float64)


def response(model: LinearModel, sensor: int) -> Response:
    """Return the response of the Kalman filter in steady state to a fault of one sensor.

    The prediction error d = x_t|t-1 - x obeys d <- A (I - K C) d + A K (eta + f) - q, and the innovation is C (-d) + eta + f.
    """
    A, C, R = (model.matrix(name) for name in ("A", "C", "sensor_covariance"))
    F, K = error_transition(A, C, steady_covariance(model), R)
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
    return float(np.abs(np.linalg.eigvals(error_transition(A, C, steady_covariance(model), R)[0])).max())


def _prolonged(values: Floats, steps: int) -> Floats:
    return np.concatenate([values, np.full(max(steps - len(values), 0), values[-1])])[:steps]
