"""The true faults of each sensor: kept with the signals, so that a score of the controller can be judged at every point.

The names of the fault blocks may differ from point to point. So these signals are named after their role in the closed loop.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.roles import LoopRoles, known_roles
from bayesftc.cosim.judging.roles import true_faults
from bayesftc.cosim.judging.signals import SCORES
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

FAULTY, MISSING = "sensor_faulty", "sensor_missing"
"""Signals with an element for each sensor: 1 while a fault is present, and 1 at a missing sample; else 0."""


@dataclass(frozen=True)
class SensorTruth:
    """The true faults of the sensors of a closed loop."""

    roles: LoopRoles

    @classmethod
    def of(cls, diagram: Diagram, kept: Container[str]) -> SensorTruth | None:
        """Return the truth of a loop; None if it is no closed loop, or if no score of its controller is kept."""
        roles = known_roles(diagram)
        if roles is None or not any(f"{roles.controller}.{score}" in kept for score in SCORES):
            return None
        return cls(roles)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of each of its signals."""
        return (len(self.roles.sensors),)

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the signals from which it follows."""
        flags = [f"{fault}.active" for sensor in self.roles.sensors for fault in sensor.faults]
        samples = [sensor.samples[0] for sensor in self.roles.sensors if sensor.samples is not None]
        return tuple(dict.fromkeys([*flags, *samples]))

    def signals(self, all_runs: Result, runs: int) -> dict[str, Floats]:
        """Return its signals, of shape (runs, rows, sensors), from a result with the rows of one run after the other."""
        faulty, missing = true_faults(self.roles, all_runs)
        return {
            name: flags.astype(np.float64).reshape(runs, len(flags) // runs, *self.shape)
            for name, flags in ((FAULTY, faulty), (MISSING, missing))
        }


__all__ = ["FAULTY", "MISSING", "SensorTruth"]
