"""Loops that are lost: the plant has left for good, and its samples say nothing of the model and of the noise any more.

This is the one definition for the notes of a run, for the diagnosis of a model, and for the figure.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.roles import signals_of
from bayesftc.cosim.judging.signals import Flags, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.run.result import Result, with_rows
from bayesftc.cosim.types import Floats

GOALS = 1000.0
"""A loop is lost where a quantity stays so many times its largest goal so far, or its start, away from the goal. No plant is
built for such a range, and no model holds there. An overshoot, or a run with a wrong model that has evidence, is far below it."""
DEVIATIONS = 1e6
"""The distance is also so many standard deviations of the sensors or more: goal and start may be near 0."""
SPACING = 0.1
"""Largest distance of neighbouring floating-point numbers, in standard deviations of a sensor. Above it, rounding looks like
noise. It is the limit of quantities without a goal, such as a position that nobody controls."""
SHOWN = 0.01
"""The panels of a figure are scaled to the rows before this share of the distance: else all before would be a flat line."""


@dataclass(frozen=True)
class Loss:
    """A loop that is lost.

    Attributes
    ----------
    row : int
        The first row from which a quantity stays beyond its plausible range.
    shown : int
        The first row to which a figure does not scale its panels.
    note : str
        When, which quantity, and since when controls are at their limits.
    todo : str
        What to do.
    """

    row: int
    shown: int
    note: str
    todo: str

    @property
    def sentence(self) -> str:
        """The note as a sentence."""
        return f"{self.note[0].upper()}{self.note[1:]}."

    @property
    def advice(self) -> str:
        """What follows the note in a summary."""
        return f"No note on the model or the noise uses the samples from there. {self.todo}"


def loss_of(signals: LoopSignals) -> Loss | None:
    """Return from when a loop is lost; None if it is not, or if that is not recorded."""
    rows = {each.name: _beyond(each, signals) for each in signals.quantities if len(signals.time)}
    lost = {name: found for name, found in rows.items() if found is not None}
    if not lost:
        return None
    name = min(lost, key=lambda each: lost[each][0])
    row, shown, words = lost[name]
    limits = list(_at_limits(signals, row))
    note = ", ".join([f"the loop is lost from t = {signals.time[row]:g} s: {name} {words}", *limits])
    todo = (
        "The actuator may be too weak for the plant, the goal too far, or the model wrong, as in the sign of a control: look at "
        "the limits of the control first."
        if limits
        else "Look at the controller first: at its model, its weights and the step."
    )
    return Loss(row, shown, note, todo)


def loss_in(result: Any) -> Loss | None:
    """Return from when the loop of a result is lost, as `loss_of`; None if the result has no loop."""
    roles = getattr(result, "roles", None)
    return None if roles is None else loss_of(signals_of(roles, result, drawn=False))


def rows_before(result: Result, loss: Loss | None) -> Result:
    """Return the rows of a result before the loop was lost: all of them if it was not."""
    if loss is None:
        return result
    return with_rows(result, result.metadata, result.table[: loss.row], result.before, result.stopped)


def _beyond(quantity: QuantitySignals, signals: LoopSignals) -> tuple[int, int, str] | None:
    """Return the row from which a quantity stays beyond its plausible range, that of the figure, and where it is."""
    values = quantity.belief if quantity.truth is None else quantity.truth
    noise = [_deviation(signals.sensors[i]) for i in quantity.sensors]
    if values is None or not any(noise):
        return None  # where nothing says how noisy the sensors are, no distance is too far
    # A piece of a live run begins anywhere.
    start = 0.0 if signals.time[0] > 0.0 else abs(float(_finite(values[0])))
    if quantity.reference is None:
        far, bound = np.abs(values), np.full(len(values), GOALS * start)
        least, words = SPACING / sys.float_info.epsilon, "beyond {}, where numbers are too coarse for its sensors"
    else:
        with np.errstate(over="ignore"):
            far = np.abs(values - quantity.reference)
        # Goals so far, so that the rows before a loss have the same bound if they are judged alone.
        bound = GOALS * np.maximum.accumulate(np.maximum(np.abs(_finite(quantity.reference)), start))
        least, words = DEVIATIONS, "more than {} from its goal"
    bound = _named(np.maximum(bound, least * max(noise)))
    row = _for_good(far > bound)
    if row == len(far):
        return None
    at = f"{bound[row]:g}{behind(quantity.unit)}"
    return row, _for_good(far > SHOWN * bound), f"stays {words.format(at)}"


def _finite(values: Floats) -> Floats:
    """Return values, 0 where they are not finite."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0)


def _named(values: Floats) -> Floats:
    """Return values with the two digits with which they are named."""
    different, which = np.unique(values, return_inverse=True)
    return np.array([float(f"{each:.2g}") for each in different])[which]


def _for_good(flags: Flags) -> int:
    """Return the row from which flags are set to the end; their number if the last one is not."""
    return len(flags) - int(np.argmin(np.append(flags[::-1], False)))


def _deviation(sensor: SensorSignals) -> float:
    """Return the standard deviation that the controller expects of a sensor at the start; 0 if it is not recorded."""
    precision = np.zeros(1) if sensor.precision is None else sensor.precision[:1]
    return float(1.0 / np.sqrt(precision[0])) if len(precision) and precision[0] > 0.0 else 0.0


def _at_limits(signals: LoopSignals, row: int) -> Iterator[str]:
    """Give for each control that is at its limits where the loop is lost, since when."""
    for control in signals.controls:
        sent, unit = control.sent[: row + 1], behind(control.unit)
        for limit, sign in ((control.low, -1.0), (control.high, 1.0)):
            since = row + 1 if limit is None else _for_good(sign * sent >= sign * limit)
            if since <= row:
                yield f"control {control.name} is at its limit of {limit:g}{unit} from t = {signals.time[since]:g} s"


__all__ = ["Loss", "loss_in", "loss_of", "rows_before"]
