"""Run one diagram for many seeds, and return the results one after the other."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import closing
from fractions import Fraction
from typing import TYPE_CHECKING

from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.errors import SimulationError
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.run.many import ManyRuns
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.run.result import Result

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram


def repeat(
    diagram: Diagram, duration: float | str | Fraction, seeds: Iterable[int], record: Iterable[str]
) -> Iterator[Result]:
    """Yield the result of ``diagram.simulate(duration, seed=seed, record=record)`` for each seed, with the same bits.

    Parameters
    ----------
    diagram : Diagram
        The diagram.
    duration : float, str or Fraction
        Seconds of each run.
    seeds : iterable of int
        One for each run.
    record : iterable of str
        Names of the signals to keep.

    Raises
    ------
    SimulationError
        If a run has to stop; the message contains its seed.
    """
    schedule, record = diagram.schedule, list(record)
    steps = whole_steps(duration, schedule.step, "The duration")
    selection = select_signals(schedule, record)
    checked = [check_seed(seed) for seed in seeds]
    done = 0
    with closing(ManyRuns(schedule, selection, steps)) as many:
        for block in many.run(checked):
            for rows, reason in zip(block.recording, block.reasons, strict=True):
                if reason:
                    _fail(diagram, duration, checked[done], record, reason)
                done += 1
                yield Result(rows.copy(), selection.columns, schedule.step, units=selection.units)


def _fail(diagram: Diagram, duration: float | str | Fraction, seed: int, record: Iterable[str], reason: str) -> None:
    """Raise the error of a run that has to stop, with its signals so far."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the error below contains the reason
            result = diagram.simulate(duration, seed=seed, record=record)
    except SimulationError as error:
        error.args = (f"With seed {seed}: {error}",)
        raise
    raise SimulationError(f"With seed {seed}: {reason}", result)


__all__ = ["repeat"]
