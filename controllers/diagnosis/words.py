"""What a wrong model is called, in sentences: what is wrong, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

ALIKE = "All sensors disagree with the model in the same way"
ALONE = " No quantity has a second sensor: a fault of a sensor may look the same."


def sentence(
    kind: str, values: Sequence[float], model: LinearModel, others: Sequence[tuple[str, Sequence[float]]] = ()
) -> str:
    """Return what a finding says: its kind and values as `ModelFinding` has them, and those that fit nearly as well."""
    rows = model.quantities
    alone = len(np.unique(rows, axis=0)) == len(rows)
    also = "".join(f" Or, by this run nearly as likely: {_WORDS[other](its, model)}" for other, its in others)
    return f"{ALIKE}: {_WORDS[kind](values, model)}{also}{ALONE if alone else ''}"


def _named(j: float, model: LinearModel) -> str:
    return f"control {j:.0f}" if model.controls > 1 else "the control"


def _sign(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"{_named(values[1], model)} moves the plant the other way. Is the sign of B right? Its effect is {values[0]:.3g} "
        "times the model's."
    )


def _gain(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"{_named(values[1], model)} moves the plant {values[0]:.3g} times as strongly as the model says. Is B right? Check the "
        "mass or inertia that it moves, and the actuator's gain."
    )


def _dt(values: Sequence[float], model: LinearModel) -> str:
    f, dt = values[0], float(model.step)
    return (
        f"the plant is {f:.3g} times as fast as the model. Is dt right? A and B look like those of a sample time of "
        f"{dt / f:.3g} s, but dt is {dt:.3g} s. If dt is right, check the masses and inertias: {1 / f:.3g} times the "
        "model's would do the same."
    )


def _late(values: Sequence[float], model: LinearModel) -> str:
    seconds = values[0]
    if values[1]:
        how = f"the control arrives late: the actuator follows with a time constant of about {seconds:.2g} s"
    else:
        how = f"the control arrives late, by {seconds:.3g} s ({seconds / float(model.step):.0f} samples)"
    return f"{how}. Make the delay part of the model (states for what is on its way), or weaken the control."


def _limit(values: Sequence[float], model: LinearModel) -> str:
    low, high, j = values
    sides = [f"below {low:.4g}"] * bool(np.isfinite(low)) + [f"above {high:.4g}"] * bool(np.isfinite(high))
    return (
        f"the plant does not get {_named(j, model)} where it is {' or '.join(sides)}. The actuator has a limit that the "
        "controller does not know. Give it as u_min and u_max."
    )


def _load(values: Sequence[float], model: LinearModel) -> str:
    pushed = ", ".join(f"{value:.3g}" for value in values)
    return (
        f"a constant load acts, as large as a control of {pushed}. Estimate it (LinearModel.with_disturbance), or put it "
        "into the model."
    )


def _nonlinear(values: Sequence[float], model: LinearModel) -> str:
    return (
        "how the plant moves depends on where it is: it has been led far from where the model was linearised. Linearise it "
        "nearer to its goals, or take a nonlinear model (NonlinearBayesianController)."
    )


def _dynamics(values: Sequence[float], model: LinearModel) -> str:
    return (
        "the plant moves otherwise than A and B say. Check the masses, inertias, stiffnesses and frictions behind them, and "
        "dt; or identify the model from this recording (LinearModel.identify)."
    )


def _unknown(values: Sequence[float], model: LinearModel) -> str:
    return (
        "what the samples show is not what A, B and C predict. Is B's sign right? Is dt? Does the plant get the control at once "
        "and whole? No single one of these explains the run."
    )


def _suspect(values: Sequence[float], model: LinearModel) -> str:
    return (
        "what the samples show is not what the model predicts. Does the control act the way that it says, at once and whole? "
        "Is dt right? Are the masses, inertias and frictions?"
    )


_WORDS = {
    "sign": _sign,
    "gain": _gain,
    "dt": _dt,
    "late": _late,
    "limit": _limit,
    "load": _load,
    "nonlinear": _nonlinear,
    "dynamics": _dynamics,
    "unknown": _unknown,
    "suspect": _suspect,
}
