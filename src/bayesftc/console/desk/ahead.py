"""Compile the kinds of faults before an operator needs them, so that an action is not slower the first time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields
from fractions import Fraction

from bayesftc.cosim.blocks.combining import Switch
from bayesftc.cosim.blocks.faults.kinds import FAULTS, Fault, RandomFaults
from bayesftc.cosim.blocks.sources import Constant, Step, Table
from bayesftc.cosim.diagram.diagram import Diagram

PAUSE = 0.05
"""Seconds between two kinds, for the engine and the page."""


def faults_ahead() -> Iterator[Fault]:
    """Yield a fault of each kind: at a time, with a duration, and on a condition."""
    for kind in FAULTS:
        if kind is RandomFaults:
            continue
        needed = {each.name: 1.0 for each in fields(kind) if each.default is MISSING}
        for window in ({"start": 1.0}, {"start": 1.0, "duration": 1.0}, {"start": "source.y > 1"}):
            yield kind(**needed, **window, channels=1)  # type: ignore[arg-type]


def compile_ahead(step: Fraction, stops: threading.Event, done: Callable[[int], None] | None = None) -> None:
    """Compile the faults one after the other, until `stops` is set.

    Parameters
    ----------
    step : Fraction
        The base step in seconds.
    stops : Event
        Ends the work.
    done : callable, optional
        Called with the number of faults that are ready.
    """
    for number, fault in enumerate(faults_ahead(), 1):
        if stops.wait(PAUSE):
            return
        diagram = Diagram(dt=step)
        source = diagram.add(Constant(0.0), "source")
        block = diagram.add(fault, "fault")
        diagram.connect(source["y"], block["u"])
        diagram.start().close()
        if done is not None:
            done(number)
    if not stops.is_set():
        _goal(step).start().close()


def _goal(step: Fraction) -> Diagram:
    """Return the blocks of a reference that is changed by hand."""
    diagram = Diagram(dt=step)
    switch = diagram.add(Switch(), "switch")
    diagram.connect(diagram.add(Step(time=1.0, after=1.0), "on")["y"], switch["condition"])
    diagram.connect(diagram.add(Table([0.0], [1.0], interpolate=False), "value")["y"], switch["above"])
    diagram.connect(diagram.add(Constant(0.0), "source")["y"], switch["otherwise"])
    return diagram


__all__ = ["compile_ahead", "faults_ahead"]
