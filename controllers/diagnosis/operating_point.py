"""Goals far from the operating point of a model: beside a wrong model, they are a reason why the plant moves differently."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.judging.signals import LoopSignals

FAR = 10.0
"""A goal is far if its distance from the operating point is so many times the reading there."""
KNOWN = 10.0
"""Readings at an operating point that are below so many standard deviations of the sensor count as 0, which has no far."""
STEADY = 1e-6
"""Largest error of a steady state, relative to the constant part of the model, and smallest effect of a free motion."""


def readings_at_rest(model: LinearModel) -> Floats | None:
    """Return the readings at the operating point of a model of values; NaN for a sensor of which they are unknown.

    The operating point is the steady state with the operating control. A plant that stays wherever it is, such as a vehicle on a
    line, has no single one. None if the model has no operating point, or none at which the plant rests.
    """
    if not model.constant or model.operating_control is None:
        return None
    A, B, C = (model.matrix(name) for name in "ABC")
    plant = model.states - model.disturbances
    moved = A[:plant, -1] + B[:plant] @ np.asarray(model.operating_control, float)
    left, sizes, right = np.linalg.svd(np.eye(plant) - A[:plant, :plant])
    free = sizes <= STEADY * 1e-3 * sizes[0]
    along = left.T @ moved
    if np.abs(along[free]).max(initial=0.0) > STEADY * np.abs(moved).max(initial=0.0):
        return None
    rest = right[~free].T @ (along[~free] / sizes[~free])
    unknown = np.abs(C[:, :plant] @ right[free].T).max(axis=1, initial=0.0) > STEADY
    return np.where(unknown, np.nan, C[:, :plant] @ rest + C[:, -1])


def far_goal(model: LinearModel, signals: LoopSignals) -> str:
    """Return a sentence if a goal is far from the operating point of the model; else nothing.

    Parameters
    ----------
    model : LinearModel
        The model.
    signals : LoopSignals
        The signals of the run by their role.
    """
    readings = readings_at_rest(model)
    if readings is None or len(signals.sensors) != model.sensors:
        return ""
    stds = np.sqrt(np.diag(model.matrix("sensor_covariance")))
    for quantity in signals.quantities:
        if quantity.reference is None or not quantity.sensors or not np.isfinite(quantity.reference).any():
            continue
        sensor = quantity.sensors[0]
        there = float(readings[sensor])
        away = np.nan_to_num(np.abs(quantity.reference - there))
        if abs(there) > KNOWN * stds[sensor] and away.max() > FAR * abs(there):
            unit = behind(quantity.unit)
            goal = float(quantity.reference[away.argmax()])
            return (
                f"The goal of {quantity.name} goes to {goal:.3g}{unit}, but the operating point of the model is "
                f"{there:.3g}{unit}, and the model may not hold so far from it. Look at this first: linearise the plant nearer "
                "to its goals (at=), use a nonlinear model (NonlinearBayesianController), or choose goals nearer to that point. "
            )
    return ""


__all__ = ["far_goal", "readings_at_rest"]
