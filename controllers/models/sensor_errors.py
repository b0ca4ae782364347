"""Errors of sensors that are correlated in time: each is an additional state, estimated with the plant's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.models.checks import as_number, as_vector
from bayesftc.cosim.elementary import exponential
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


def with_sensor_errors(
    model: LinearModel,
    std: float | Sequence[float],
    time_constant: float | Sequence[float],
    sensors: Sequence[int] | None,
    common: bool,
) -> LinearModel:
    """Return the model with the errors as further states; see `LinearModel.with_sensor_errors`."""
    if model.constant:
        raise ModelError(
            "The model has a constant, which must be its last state; apply with_sensor_errors() before about()."
        )
    chosen = _chosen(model, sensors)
    deviations = as_vector("The sensor errors' std", std, len(chosen))
    if common and np.ndim(time_constant):
        raise ModelError(f"time_constant is {time_constant!r}; a common error has one time_constant, a number.")
    times = as_vector("The sensor errors' time_constant", time_constant, len(chosen))
    for name, values in (("std", deviations), ("time_constant", times)):
        for value in values:
            as_number(f"A sensor error has {name}", float(value), above=0)
    reads = np.zeros((model.sensors, len(chosen)))
    reads[chosen, range(len(chosen))] = 1.0
    if common:
        reads = reads @ (deviations / deviations[0])[:, None]
        deviations, times = deviations[:1], times[:1]
    decay = np.array([exponential(-float(model.step) / time) for time in times])
    return replace(
        model,
        A=_beside(model.matrix("A"), np.diag(decay)),
        B=np.vstack([model.matrix("B"), np.zeros((len(decay), model.controls))]),
        C=np.hstack([model.matrix("C"), reads]),
        process_covariance=_beside(model.matrix("process_covariance"), np.diag(deviations**2 * (1 - decay**2))),
        disturbances=model.disturbances + len(decay),
    )


def _chosen(model: LinearModel, sensors: Sequence[int] | None) -> list[int]:
    chosen = list(range(model.sensors)) if sensors is None else list(sensors)
    for sensor in chosen:
        as_number("A sensor error has sensor", sensor, least=0, below=model.sensors, whole=True)
    if not chosen or len(set(chosen)) < len(chosen):
        raise ModelError(f"Sensor errors have sensors={sensors!r}; name each sensor once, at least one.")
    return chosen


def _beside(first: Floats, second: Floats) -> Floats:
    """Return the block-diagonal matrix of both."""
    n, k = len(first), len(second)
    return np.block([[first, np.zeros((n, k))], [np.zeros((k, n)), second]])
