"""Sensors that a Kalman filter does not use, because its model predicts them without error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.estimation.innovation import steady_covariance
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

EXACT = 1e-12
"""Variance of a sensor's prediction, relative to that of its noise, up to which it counts as exact."""


def warn_of_unused(model: LinearModel, remedy: str) -> None:
    """Warn of sensors that measure something, but that no process noise reaches; the message ends with the `remedy`."""
    try:
        P = steady_covariance(model.moving)
    except ModelError:  # of a filter that becomes ever more certain; an estimated constant is one
        return
    C, R = model.moving.matrix("C"), model.matrix("sensor_covariance")
    predicted = np.einsum("ia,ab,ib->i", C, P, C)
    unused = np.flatnonzero((predicted < EXACT * np.diag(R)) & C.any(axis=1)).tolist()
    if not unused:
        return
    names = f" ({', '.join(dict.fromkeys(model.names.sensors[i] for i in unused))})" if model.names is not None else ""
    which = f"sensor {unused[0]}{names}" if len(unused) == 1 else f"sensors {', '.join(map(str, unused))}{names}"
    warn_user(
        f"The model has no process noise on what {which} measure{'s' * (len(unused) == 1)}. The filter takes its prediction for "
        f"exact and does not use the samples. {remedy}"
    )


__all__ = ["warn_of_unused"]
