"""One live run of a scenario, with its recorded rows, saved states and alarms; several lanes are compared side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from math import inf, prod
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.console.desk.alarms import Alarm, Alarms, sensor_names
from bayesftc.console.desk.history import History, Recorded, SavedStates
from bayesftc.console.desk.inference import Inference
from bayesftc.cosim.diagram.roles import LoopRoles, find_roles
from bayesftc.cosim.errors import FMUError, SimulationError
from bayesftc.cosim.ports import labels
from bayesftc.scenario._scenario import Scenario, scenario_of

if TYPE_CHECKING:
    from bayesftc.cosim.run.result import Result
    from bayesftc.cosim.run.session import Session

PIECE = 2000
"""Most steps in one call of the engine, so that the recording of a piece stays small."""
BETWEEN = 200
"""Fewest steps between two saved states at the beginning."""
SHARE = 200.0
"""Seconds of computing for each second of saving a state. To go back computes so much again."""


class Lane:
    """A live run of one scenario.

    Parameters
    ----------
    name : str
        What the lane shows, such as the kind of its precision learner.
    content : mapping
        The content of the scenario file.
    path : Path
        The file, for messages and relative paths.
    memory : int
        Bound of memory in bytes for rows and states.
    """

    def __init__(self, name: str, content: Mapping[str, Any], path: Path, memory: int):
        self.name, self.content, self.path, self.memory = name, content, path, memory
        self.scenario: Scenario = scenario_of(content, path)
        loop = self.scenario.loop()
        self.roles: LoopRoles = find_roles(loop)
        self.sensors = sensor_names(self.roles)
        self.inference = Inference.of(self.scenario.controller)
        self.step: Fraction = loop.step
        self.stopped: str | None = None
        self._session: Session = loop.start(seed=self.scenario.simulation.seed, engine=self.scenario.simulation.engine)
        first = self._session.advance(0)
        self.shapes = {signal: first[signal].shape[1:] for signal in first}
        self.units = dict(first.units)
        self.plants: Mapping[str, Any] = first.metadata.get("plants", {})
        self.columns = [label for signal, shape in self.shapes.items() for label in labels(signal, shape)]
        self.place = {label: i for i, label in enumerate(self.columns)}
        self._width = sum(prod(shape) for shape in self.shapes.values())
        self._history = History(self._width, memory // 2)
        self._states = SavedStates(BETWEEN, memory // 2)
        self._session.record_into(self._history.room)
        self._can_save = True
        self._computed, self._cost = 0.0, inf
        self.watch = Alarms(self.roles, self.place, self.sensors, self._empty())
        self._take(first, 0)

    @property
    def k(self) -> int:
        """The last complete step."""
        return self.rows.last

    @property
    def rows(self) -> Recorded:
        """The recorded rows."""
        return self._history.rows

    def advance_to(self, k: int, progress: Callable[[int], None] | None = None) -> None:
        """Continue to step `k`. A run that has to stop sets `stopped`, and stays where it is.

        Parameters
        ----------
        k : int
            The last step.
        progress : callable, optional
            Called with the step that is reached, several times a second.
        """
        while self.k < k and self.stopped is None:
            self._save_if_due()
            first = self.k + 1
            steps = min(k - self.k, PIECE)
            began = perf_counter()
            try:
                result = self._session.advance(steps * self.step)
            except SimulationError as error:
                if error.result is not None:
                    self._take(error.result, first)
                self.stopped = str(error)  # after its rows, which a viewer would miss else
                return
            self._computed += perf_counter() - began
            self._take(result, first)
            self.stopped = result.stopped
            if progress is not None:
                progress(self.k)

    def go_back(self, k: int) -> None:
        """Return to step `k`: to the saved state before it, and on from there. The bits are the same."""
        state = self._states.before(k)
        if state is not None and state.k == k and not self.rows.first <= k <= self.rows.last:
            state = self._states.before(k - 1)  # a step makes the row of `k`, which was dropped
        if state is None:
            self._session.reset()
            first = self._session.advance(0)
            self._history.append(first.table, 0)
            reached = 0
        else:
            self._session.restore(state)
            reached = state.k
        self.stopped = None
        rows = self.rows
        if reached <= rows.last:
            self._history.append(np.empty((0, self._width)), reached + 1)
        self.watch.forget_after(reached)
        if (
            not self.rows.blocks or self.rows.last != reached
        ):  # the rows of that time were dropped: the step itself has no row any more
            self._reached_without_row(reached)
        self.advance_to(k)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The last alarms."""
        return self.watch.found

    @property
    def bytes(self) -> int:
        """Memory of the rows and states."""
        return self._history.bytes + self._states.bytes

    def bound(self, memory: int, states: int) -> None:
        """Set other bounds of memory, half for rows and half for states, and of the number of states."""
        self._history.bound(memory // 2)
        self._states.bound(memory // 2, states)

    def close(self) -> None:
        """End the run."""
        if not self._session.closed:
            self._session.close()

    def _reached_without_row(self, reached: int) -> None:
        row = np.full((1, self._width), np.nan)
        self._history.append(row, reached)

    def _save_if_due(self) -> None:
        is_cheap = not len(self._states) or self._computed >= SHARE * self._cost
        if self._can_save and is_cheap and self._states.is_due(self.k):
            began = perf_counter()
            try:
                state = self._session.save_state()
            except FMUError:  # an FMU without states: to go back is to begin again
                self._can_save = False
                return
            self._computed, self._cost = 0.0, min(self._cost, perf_counter() - began)
            self._states.add(state)

    def _take(self, result: Result, first: int) -> None:
        self._history.append(result.table, first)
        self.watch.take(result.table, first)

    def _empty(self) -> tuple[str, ...]:
        """Return the outputs of the controller that never have a value."""
        return () if self.inference.has_probability else ("fault_probability",)


__all__ = ["Lane"]
