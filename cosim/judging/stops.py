"""What a run that had to stop shows of the reason: controls at their limits, and the last values."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.lost import loss_of
from bayesftc.cosim.judging.metrics import limited
from bayesftc.cosim.judging.roles import signals_of
from bayesftc.cosim.judging.signals import LoopSignals
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

MOST = 4
"""Most quantities, and most controls, of which the last values are named."""


def at_stop(result: Result) -> str:
    """Return sentences on what a closed loop did before its run had to stop; nothing of another diagram, or without rows.

    Shares of the run are not named of a piece of a live run.
    """
    if result.roles is None or not len(result.time):
        return ""
    signals = signals_of(result.roles, result)
    loss = loss_of(signals)
    notes = [f"The {note}." for note, _ in limited(signals)] if loss is None and not result.before else []
    return " ".join([*([] if loss is None else [loss.sentence]), *notes, *_last(signals)])


def _last(signals: LoopSignals) -> list[str]:
    """Return a sentence on the last values of the quantities with a goal, and of the controls."""
    values = []
    for quantity in [each for each in signals.quantities if each.has_goal][:MOST]:
        value, goal = (_value(each, quantity.unit) for each in (quantity.truth, quantity.reference))
        values += [f"{quantity.name} {value}{f' (goal {goal})' if goal else ''}"] if value else []
    values += [f"control {each.name} {_value(each.sent, each.unit)}" for each in signals.controls[:MOST]]
    return [f"Last values, at t = {signals.time[-1]:g} s: {', '.join(values)}."] if values else []


def _value(values: Floats | None, unit: str | None) -> str:
    """Return the last value with its unit; nothing if it is not recorded."""
    return "" if values is None or not np.isfinite(values[-1]) else f"{values[-1]:.4g}{behind(unit)}"


__all__ = ["at_stop"]
