"""The alarms of a controller's fault probabilities, found in its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.roles import LoopRoles

MOST = 1000
"""Number of alarms that are kept, and that are taken from one piece."""
OUTPUTS = {"sensor": ("fault_probability", "detected"), "actuator": ("actuator_fault_probability",)}
"""Outputs of a controller that tell of faults; the first one that it has counts."""


@dataclass(frozen=True)
class Alarm:
    """The beginning or the end of an alarm: at step `k`, of a ``"sensor"`` or an ``"actuator"`` with a number."""

    k: int
    device: str
    number: int
    begins: bool


class Alarms:
    """The alarms of one run.

    Parameters
    ----------
    roles : LoopRoles
        The roles of the loop.
    place : mapping of str to int
        The columns of the rows.
    sensors : sequence of str
        The names of the sensors.
    without : sequence of str
        Outputs that are always empty.

    Attributes
    ----------
    found : tuple of Alarm
        The last alarms. It is replaced, so that any thread can read it.
    """

    def __init__(self, roles: LoopRoles, place: Mapping[str, int], sensors: Sequence[str], without: Sequence[str] = ()):
        self._roles, self._sensors = roles, sensors
        self._watched = _watched(roles, place, without)
        self._groups = [
            slice(min(columns), max(columns) + 1)  # the devices of one output are neighbours
            for device in OUTPUTS
            if (columns := [column for of, _, column in self._watched if of == device])
        ]
        self._now = np.zeros(len(self._watched), dtype=bool)
        self.found: tuple[Alarm, ...] = ()

    def take(self, values: Floats, first: int) -> None:
        """Find the alarms in further rows, from step `first` on."""
        if len(values) and not self._is_quiet(values):
            self._find(values, first)

    def forget_after(self, k: int) -> None:
        """Return to step `k`."""
        self.found = tuple(alarm for alarm in self.found if alarm.k <= k)
        last = {(alarm.device, alarm.number): alarm.begins for alarm in self.found}
        self._now = np.array([last.get((device, i), False) for device, i, _ in self._watched], dtype=bool)

    def after(self, k: int) -> list[Alarm]:
        """Return the alarms that began or ended after step `k`."""
        return [*takewhile(lambda alarm: alarm.k > k, reversed(self.found))][::-1]

    def words_of(self, alarm: Alarm) -> str:
        """Return an alarm in words."""
        number = alarm.number
        device = self._sensors[number] if alarm.device == "sensor" else f"actuator {self._roles.controls[number].name}"
        return f"{device}: {'alarm' if alarm.begins else 'the alarm ends'}"

    def _is_quiet(self, values: Floats) -> bool:
        """Return whether there is no alarm, in a fraction of the time that it takes to find alarms."""
        return not self._now.any() and all(values[:, columns].max() < ALARM for columns in self._groups)

    def _find(self, values: Floats, first: int) -> None:
        with np.errstate(invalid="ignore"):
            now = values[:, [column for *_, column in self._watched]] >= ALARM
        changes = np.argwhere(now != np.vstack([self._now, now[:-1]]))[:MOST]
        if len(changes):
            watched = self._watched
            new = [Alarm(first + int(i), watched[j][0], watched[j][1], bool(now[i, j])) for i, j in changes]
            self.found = (*self.found, *new)[-MOST:]
        self._now = now[-1]


def sensor_names(roles: LoopRoles) -> tuple[str, ...]:
    """Return the names of the sensors of a loop, which have only numbers."""
    return tuple(f"sensor {i}" for i in range(len(roles.sensors)))


def _watched(roles: LoopRoles, place: Mapping[str, int], without: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return each device with a fault probability, or with the flag of an explicit detection, and its column."""
    found: list[tuple[str, int, int]] = []
    devices: dict[str, Sequence[Any]] = {"sensor": roles.sensors, "actuator": roles.controls}
    for device, outputs in OUTPUTS.items():
        for output in outputs:
            names = [f"{roles.controller}.{output}[{i}]" for i in range(len(devices[device]))]
            if output not in without and all(name in place for name in names):
                found += [(device, i, place[name]) for i, name in enumerate(names)]
                break
    return found


__all__ = ["Alarm", "Alarms", "sensor_names"]
