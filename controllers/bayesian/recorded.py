"""Run a state estimator over recorded samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.precision.base import PrecisionLearner
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.types import Floats

SHORT = 250
"""Recordings of up to this many steps run interpreted by default, if sensors are judged together: compiling takes some seconds
once on a machine, and an interpreted step of the joint form with three sensors 12 ms, so that both are equally long at 300."""

QUICK = 10
"""How much longer a recording may be with any other learner, whose interpreted steps take a tenth of that."""


def is_short(steps: int, precision: PrecisionLearner) -> bool:
    """Return whether compiling for a recording would probably take longer than an interpreted run."""
    return steps <= SHORT * (1 if getattr(precision, "joint", False) else QUICK)


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
    step = estimator.online(compiled=not is_short(len(y), estimator.precision) if compiled is None else compiled)
    recorded = {name: np.empty((len(y), *estimator.port(name).shape)) for name in names}
    for k in range(len(y)):
        out = step(y=y[k], u=u[k])
        for name, values in recorded.items():
            values[k] = out[name]
    return recorded


def samples_of(signals: Mapping[str, Any], y: str | None, name: str, reader: str) -> Floats:
    """Return the samples of a run that a controller or estimator got.

    Parameters
    ----------
    signals : Result or mapping
        The signals.
    y : str or None
        Name of the signal with the samples; None for the recorded input, or else for what the result knows about its loop.
    name : str
        Name of the controller or estimator in the diagram.
    reader : str
        What needs the samples, for the error message.
    """
    source = f"{name}.y" if y is None else y
    roles = getattr(signals, "roles", None) if y is None and source not in signals else None
    if roles is not None and roles.controller == name:
        places = [sensor.samples for sensor in roles.sensors]
        if all(place is not None and place[0] in signals for place in places):
            columns = [np.asarray(signals[signal]).reshape(len(signals[signal]), -1)[:, i] for signal, i in places]
            return np.stack(columns, axis=1)
    check_recorded(signals, reader, source)
    return np.asarray(signals[source])


def sampled_rows(signals: Mapping[str, Any], sample_time: Fraction, reader: str) -> slice:
    """Return the rows of a run at which a controller or estimator ran; between them its outputs are held.

    Parameters
    ----------
    signals : Result or mapping
        The signals. A mapping that is no result has a row for each sample.
    sample_time : Fraction
        The seconds between two samples of the controller.
    reader : str
        What needs the samples, for the error message.

    Raises
    ------
    ModelError
        If not every sample is recorded.
    """
    row = getattr(signals, "step", sample_time) * getattr(signals, "decimation", 1)
    rows = sample_time / row
    if rows.denominator != 1:
        raise ModelError(
            f"{reader} needs every sample, one in {show(sample_time)} s by the controller's model, but the run has a row in "
            f"{show(row)} s. Run with decimation=1, and give the controller that ran."
        )
    return slice(-getattr(signals, "before", 0) % int(rows), None, int(rows))


def check_recorded(signals: Mapping[str, Any], reader: str, *names: str) -> None:
    """Raise an error if a signal is not recorded; the reader is what needs it."""
    for needed in names:
        if needed not in signals:
            raise UnknownNameError(
                f"{reader} needs the signal {needed!r}, which is not recorded; add it to record=['*', {needed!r}]."
            )


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
