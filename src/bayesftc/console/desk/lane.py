"""One live run of a scenario, with its recorded rows, saved states and alarms; several lanes are compared side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import takewhile
from math import inf, prod
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.console.desk.history import History, Recorded, SavedStates
from bayesftc.cosim.diagram.roles import LoopRoles, find_roles
from bayesftc.cosim.errors import FMUError, SimulationError
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats
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


@dataclass(frozen=True)
class Alarm:
    """The beginning or the end of an alarm: at step `k`, of a ``"sensor"`` or an ``"actuator"`` with a number."""

    k: int
    device: str
    number: int
    begins: bool


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
        self.step: Fraction = loop.step
        self.stopped: str | None = None
        self.alarms: tuple[Alarm, ...] = ()
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
        self._watched = self._alarm_columns()
        self._groups = [
            slice(min(columns), max(columns) + 1)  # the devices of one output are neighbours
            for device in ("sensor", "actuator")
            if (columns := [column for of, _, column in self._watched if of == device])
        ]
        self._alarmed = np.zeros(len(self._watched), dtype=bool)
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
                self.stopped = str(error)
                if error.result is not None:
                    self._take(error.result, first)
                return
            self._computed += perf_counter() - began
            self._take(result, first)
            self.stopped = result.stopped
            if progress is not None:
                progress(self.k)

    def go_back(self, k: int) -> None:
        """Return to step `k`: to the saved state before it, and on from there. The bits are the same."""
        state = self._states.before(k)
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
        self.alarms = tuple(alarm for alarm in self.alarms if alarm.k <= reached)
        self._alarmed = np.array([self._was_alarmed(device, number) for device, number, _ in self._watched], dtype=bool)
        if self.rows.last != reached:  # the rows of that time were dropped: the step itself has no row any more
            self._reached_without_row(reached)
        self.advance_to(k)

    @property
    def bytes(self) -> int:
        """Memory of the rows and states."""
        return self._history.bytes + self._states.bytes

    def bound(self, memory: int, states: int) -> None:
        """Set other bounds of memory, half for rows and half for states, and of the number of states."""
        self._history.bound(memory // 2)
        self._states.bound(memory // 2, states)

    def alarms_after(self, k: int) -> list[Alarm]:
        """Return the alarms that began or ended after step `k`."""
        return [*takewhile(lambda alarm: alarm.k > k, reversed(self.alarms))][::-1]

    def words_of(self, alarm: Alarm) -> str:
        """Return an alarm in words."""
        number = alarm.number
        device = f"sensor {number}" if alarm.device == "sensor" else f"actuator {self.roles.controls[number].name}"
        return f"{device}: {'alarm' if alarm.begins else 'the alarm ends'}"

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
        values = result.table
        self._history.append(values, first)
        if len(values) and not self._is_quiet(values):
            self._find_alarms(values, first)

    def _is_quiet(self, values: Floats) -> bool:
        """Return whether there is no alarm, in a fraction of the time that it takes to find alarms."""
        return not self._alarmed.any() and all(values[:, columns].max() < ALARM for columns in self._groups)

    def _find_alarms(self, values: Floats, first: int) -> None:
        with np.errstate(invalid="ignore"):
            now = values[:, [column for *_, column in self._watched]] >= ALARM
        changes = np.argwhere(now != np.vstack([self._alarmed, now[:-1]]))
        if len(changes):
            self.alarms += tuple(
                Alarm(first + int(i), self._watched[j][0], self._watched[j][1], bool(now[i, j]))
                for i, j in changes[:1000]
            )
            self.alarms = self.alarms[-1000:]
        self._alarmed = now[-1]

    def _alarm_columns(self) -> list[tuple[str, int, int]]:
        """Return each device with a fault probability, or with the flag of an explicit detection, and its column."""
        found = []
        name = self.roles.controller
        for device, count, outputs in (
            ("sensor", len(self.roles.sensors), ("fault_probability", "detected")),
            ("actuator", len(self.roles.controls), ("actuator_fault_probability",)),
        ):
            for output in outputs:
                if self.shapes.get(f"{name}.{output}") == (count,) and not self._is_empty(
                    f"{name}.{output}[0]", output
                ):
                    found += [(device, i, self.place[f"{name}.{output}[{i}]"]) for i in range(count)]
                    break
        return found

    def _is_empty(self, label: str, output: str) -> bool:
        precision = getattr(self.scenario.controller, "precision", None)
        return output == "fault_probability" and bool(getattr(precision, "why_no_probability", None))

    def _was_alarmed(self, device: str, number: int) -> bool:
        last = [alarm for alarm in self.alarms if (alarm.device, alarm.number) == (device, number)][-1:]
        return bool(last) and last[0].begins


__all__ = ["Alarm", "Lane"]
