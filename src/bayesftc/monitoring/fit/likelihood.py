"""How well a model explains a recording without faults: what its standard deviations and time constants are fitted by."""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.recorded import estimate, innovation_covariances
from bayesftc.controllers.models.checks import Matrix
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import FixedPrecision
from bayesftc.monitoring.recording import Recording


def log_likelihood(
    model: LinearModel,
    recording: Recording,
    *,
    initial_mean: float | tuple[float, ...] = 0.0,
    initial_covariance: Matrix | None = None,
    compiled: bool | None = None,
) -> float:
    """Return the logarithm of the samples' density under a model whose sensors are all healthy.

    It is the sum over the steps of the normal log-densities of the innovations, of which a Kalman filter gives the covariance
    (Schweppe, IEEE Trans. Inf. Theory 11, 1965); the larger, the better the model. Differences between two models count, in nats.

    Parameters
    ----------
    model : LinearModel
        With a row of C for each sensor of the recording.
    recording : Recording
        Without faults.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.
    compiled : bool, optional
        As of `monitor_recording`.
    """
    estimator = StateEstimator(model, FixedPrecision(), initial_mean, initial_covariance)
    found = estimate(estimator, recording.y, recording.u, ("innovation", "P"), compiled)
    e, S = found["innovation"], innovation_covariances(estimator, found["P"])
    present = np.isfinite(e)
    # A missing sample is an independent one of variance 1 and error 0, whose density is then left out of the count.
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(model.sensors))
    e = np.where(present, e, 0.0)
    distance = np.einsum("ki,ki->", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])
    return float(-0.5 * (distance + np.linalg.slogdet(S)[1].sum() + present.sum() * np.log(2 * np.pi)))
