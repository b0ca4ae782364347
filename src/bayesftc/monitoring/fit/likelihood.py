"""The likelihood of a model, given a recording without faults: the criterion for fitting its parameters."""

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

    It is the sum over the steps of the normal log-densities of the innovations, with the covariances from a Kalman filter
    (Schweppe, IEEE Trans. Inf. Theory 11, 1965). A larger value means a better model; differences of two models are in nats.

    Parameters
    ----------
    model : LinearModel
        A model with a row of C for each sensor of the recording.
    recording : Recording
        A recording without faults.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.
    compiled : bool, optional
        As for `monitor_recording`.

    Returns
    -------
    float
        The logarithm, in nats.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(100), 0.1 * np.random.default_rng(0).standard_normal((100, 2))
    >>> recording = monitoring.align({name: monitoring.Signal(t, noise[:, i]) for i, name in enumerate("ab")}, {}, dt=0.1)
    >>> for std in (0.05, 0.1, 0.2):
    ...     model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 2, 1e-6, std**2, dt=0.1)
    ...     print(std, round(monitoring.log_likelihood(model, recording)))
    0.05 41
    0.1 179
    0.2 111
    """
    estimator = StateEstimator(model, FixedPrecision(), initial_mean, initial_covariance)
    signals = estimate(estimator, recording.y, recording.u, ("innovation", "P"), compiled)
    e, S = signals["innovation"], innovation_covariances(estimator, signals["P"])
    present = np.isfinite(e)
    # A missing sample becomes an independent one of variance 1 and error 0, which adds nothing to the sum.
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(model.sensors))
    e = np.where(present, e, 0.0)
    distance = np.einsum("ki,ki->", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])
    return float(-0.5 * (distance + np.linalg.slogdet(S)[1].sum() + present.sum() * np.log(2 * np.pi)))
