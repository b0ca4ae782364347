"""Phrases in the sentences about a wrong model: which control, since when, by how much."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from math import isfinite
from typing import TYPE_CHECKING

from bayesftc.cosim.base.numbers import with_and
from bayesftc.cosim.base.recordings.dates import span_text, time_text
from bayesftc.cosim.base.units import behind

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

STUCK_AT = 4
"""Place, in the values of a lost effect, of the control at which the actuator is stuck; of another loss there is none."""

NO_EFFECT = 0.05
"""Effect of a control, relative to the model's, below which it counts as none."""


def named(j: float, model: LinearModel) -> str:
    """Return the control's name in a sentence."""
    if model.controls == 1:
        return "the control"
    return f"control {j:.0f}" if model.names is None else f"the control {model.names.controls[int(j)]}"


def change(values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    """Return by how much each control would have to change: ``the control q1 by 0.02 m3/s``."""
    known = units if len(units) == len(values) else [None] * len(values)
    return " and of ".join(
        f"{named(j, model)} by {value:.3g}" + behind(unit)
        for j, (value, unit) in enumerate(zip(values, known, strict=True))
    )


def since(values: Sequence[float], first: datetime | None = None) -> str:
    """Return from when to when something acts, of which these are the first two values; as dates, if the first sample has one."""
    if first is not None:
        return f"from {span_text(values[0], values[1], first) if isfinite(values[1]) else f'{time_text(values[0], first)} on'}"
    begin, end = map(seconds, values[:2])
    return (
        f"from {begin} to {end} after the first sample"
        if isfinite(values[1])
        else f"from {begin} after the first sample on"
    )


def seconds(time: float) -> str:
    """Return a time with four digits, without an exponent below a year: ``14410 s``."""
    return f"{time:.0f} s" if 1e3 <= time < 1e8 else f"{time:.4g} s"


def beyond(values: Sequence[float]) -> str:
    """Return where a limit is exceeded, of which the first two values are the lowest and the highest control."""
    low, high, *_ = values
    return " or ".join([f"below {low:.4g}"] * isfinite(low) + [f"above {high:.4g}"] * isfinite(high))


def strongly(effect: float) -> str:
    """Return how strongly a control moves the plant."""
    return f"{effect:.2g} times as strongly as in the model" if abs(effect) >= NO_EFFECT else "not at all"


def gains(values: Sequence[float], model: LinearModel, what: str) -> str:
    """Return how strongly each of several controls moves the plant; `what` they are called: a control, or an input."""
    p = model.controls
    names = list(model.names.controls) if model.names else [f"{j}" for j in range(p)]
    called = "" if model.names and what != "control" else f"the {what} " if model.names else f"{what} "
    each = [f"{values[j]:.3g} (standard deviation {values[p + j]:.1g})" for j in range(p)]
    others = [f"{called}{names[j]} {each[j]}" for j in range(1, p)]
    return f"{called}{names[0]} moves the plant {each[0]} times as strongly as in the model, {with_and(others)}"


def rounded(value: float) -> str:
    """Return a number of two digits, without an exponent up to a million: ``100``, not ``1e+02``."""
    return f"{float(f'{value:.2g}'):g}"


__all__ = ["NO_EFFECT", "STUCK_AT", "beyond", "change", "gains", "named", "rounded", "since", "strongly"]
