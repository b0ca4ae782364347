"""Run a state estimator over recorded samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.cosim.types import Floats

SHORT = 1000
"""Recordings of up to this many steps run interpreted by default, because compiling takes seconds."""


def estimate(
    estimator: StateEstimator, y: Floats, u: Floats, names: Sequence[str], compiled: bool | None
) -> dict[str, Floats]:
    """Return outputs of the estimator at each step of a recording.

    Parameters
    ----------
    estimator : StateEstimator
        The estimator.
    y, u : ndarray
        Samples and inputs, a row for each step.
    names : sequence of str
        The outputs.
    compiled : bool or None
        Whether to run compiled; None decides by the length of the recording.
    """
    step = estimator.online(compiled=len(y) > SHORT if compiled is None else compiled)
    recorded = {name: np.empty((len(y), *estimator.port(name).shape)) for name in names}
    for k in range(len(y)):
        out = step(y=y[k], u=u[k])
        for name, values in recorded.items():
            values[k] = out[name]
    return recorded


def innovation_covariances(estimator: StateEstimator, P: Floats) -> Floats:
    """Return the covariance of the innovations with healthy sensors at each step (steps x m x m).

    Parameters
    ----------
    estimator : StateEstimator
        The estimator that ran.
    P : ndarray, steps x n x n
        Its output ``P``.
    """
    model = estimator.model
    A, C = model.matrix("A"), model.matrix("C")
    predicted = np.empty_like(P)
    predicted[0] = np.asarray(estimator.initial_covariance)
    predicted[1:] = A @ P[:-1] @ A.T + model.matrix("process_covariance")
    return np.asarray(C @ predicted @ C.T + model.matrix("sensor_covariance"))
