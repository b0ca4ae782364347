"""Where everything of a bank of hypotheses stands in its memory and its settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.controllers.switching.bank.hypothesis import PROBABILITY, STATE
from bayesftc.controllers.switching.course import COURSE, COURSE_SCRATCH
from bayesftc.controllers.switching.sensor_kernels import FIRST, FIRST_SETTINGS, LEAST
from bayesftc.cosim.types import Floats

ACTUATOR_SETTINGS = 9
BEGIN, END, MEAN, FOLLOWS, VARIANCE, WALK, ABSOLUTE, RELATIVE, TAKES = range(ACTUATOR_SETTINGS)
"""Places in the settings of one mode of one actuator."""

PROCESS_SETTINGS = 4
STARTS, STOPS, MORE, FADES = range(PROCESS_SETTINGS)
"""Places in the settings of a mode of the process: probabilities that it begins and ends, added variance, faded part."""

WORKS, LOAD, STEERS, PUSHES, OF_MODES = range(5)
"""What is kept of an actuator: how much of the control arrives and what is added to it, on average; the same as the control
counts on it; then of each mode probability and size."""

BY_MODES, BY_COURSE = -1, -2
"""How a hypothesis judges a sensor that has no offset there."""


@dataclass(frozen=True)
class Layout:
    """The numbers of a bank.

    The memory begins as that of the per-sensor form (all sensors, the count of samples, their density); then follow what is said
    of the actuators, the hypotheses (no fault; each kind of offset on each sensor; each sensor on a course of its own; each group
    of sensors with the same offset; each mode of each actuator; each of the process, and that one of those has ended), the pool,
    what is kept of the courses, and scratch space. The settings are those of the per-sensor form, then those of each mode of each
    actuator and of the process, then of each group, then how much sooner young faults end, last what the estimate takes over.

    An offset that jumps is a hypothesis of its own for its first sample: merged at once with what is left of earlier ones, which
    nothing has contradicted so far, it would hardly be one that jumps.

    Attributes
    ----------
    n, m, p : int
        Numbers of states, sensors and actuators.
    plant : int
        How many states are the plant's, which is what modes of the process move; the others are estimated disturbances.
    kinds : tuple of int
        Which of the sensors' modes are offsets, those that begin with a jump once more at the end: their first sample.
    becomes : tuple of int
        For each of these, which one it is after its first sample: itself, or the earlier one of the same mode.
    slow : tuple of int
        For each of these, whether other sensors must bear witness (1 or 0).
    lost : tuple of int
        Which of the sensors' modes are courses of their own, of which the state is inferred without that sensor.
    groups : tuple of tuple of int
        The sensors that read the same, of which all may have the same offset.
    common : int
        Which of the sensors' modes such an offset is.
    kick : int
        Which of the process' modes competes with such an offset: as large, and as probable by the odds `alike`; -1: none.
    fades : tuple of int
        For each of the process' modes whether the belief fades in it (1 or 0).
    alone, other : tuple of int
        For each mode how much of its block counts where no sensor has an offset, and of the other sensors where one has; 0 if it
        takes no part.
    faults : tuple of int
        For each mode whether it is a fault (1 or 0).
    actuator_modes : int
        How many modes each actuator has.
    process_modes : int
        How many modes the process has.
    width, width_of_settings : int
        Widths of the blocks of the sensors' modes.
    """

    n: int
    m: int
    p: int
    plant: int
    kinds: tuple[int, ...]
    becomes: tuple[int, ...]
    slow: tuple[int, ...]
    lost: tuple[int, ...]
    groups: tuple[tuple[int, ...], ...]
    common: int
    kick: int
    fades: tuple[int, ...]
    alone: tuple[int, ...]
    other: tuple[int, ...]
    faults: tuple[int, ...]
    actuator_modes: int
    process_modes: int
    width: int
    width_of_settings: int

    @property
    def fresh(self) -> tuple[bool, ...]:
        """For each kind of offset whether it is one's first sample."""
        return tuple(self.becomes[q] != q for q in range(len(self.kinds)))

    @property
    def judged(self) -> tuple[int, ...]:
        """For each hypothesis, for each sensor: by which mode's offset, estimated with the state, the sensor is judged.

        `BY_MODES` if by its own modes, `BY_COURSE` if by a course of its own.
        """
        table = np.full((self.hypotheses, self.m), BY_MODES)
        for i in range(self.m):
            first = 1 + i * len(self.kinds)
            table[first : first + len(self.kinds), i] = self.kinds
            first = self.first_lost + i * len(self.lost)
            table[first : first + len(self.lost), i] = BY_COURSE
        for g, group in enumerate(self.groups):
            table[self.first_common + g, list(group)] = self.common
        return tuple(table.ravel().tolist())

    @property
    def with_offset(self) -> tuple[int, ...]:
        """The hypotheses in which an offset is estimated with the state: of a sensor, a group or an actuator."""
        of_sensors = (*range(1, self.first_lost), *range(self.first_common, self.first_ended))
        return (*of_sensors, *range(self.first_actuator, self.process))

    @property
    def without_offset(self) -> tuple[int, ...]:
        """The hypotheses in which none is."""
        return tuple(h for h in range(self.hypotheses) if h not in self.with_offset)

    @property
    def jumps(self) -> tuple[bool, ...]:
        """For each kind of offset whether it begins with a jump, be it its first sample or a later one."""
        return tuple(self.becomes.count(self.becomes[q]) > 1 for q in range(len(self.kinds)))

    @property
    def begins_here(self) -> tuple[bool, ...]:
        """For each kind of offset whether it begins as this one, and not as its first sample."""
        return tuple(self.fresh[q] or self.becomes.count(q) == 1 for q in range(len(self.kinds)))

    @property
    def modes(self) -> int:
        """How many modes a sensor has."""
        return len(self.faults)

    @property
    def sensor(self) -> int:
        """How many numbers are kept of a sensor."""
        return FIRST + self.modes * self.width

    @property
    def row(self) -> int:
        """How many settings a sensor has."""
        return FIRST_SETTINGS + self.modes * self.width_of_settings

    @property
    def actuator_settings(self) -> int:
        """Where in the settings those of the actuators' modes stand."""
        return self.m * self.row + 1

    @property
    def process_settings(self) -> int:
        """Where in the settings those of the process' modes stand."""
        return self.actuator_settings + self.p * self.actuator_modes * ACTUATOR_SETTINGS

    @property
    def common_settings(self) -> int:
        """Where in the settings it stands how probable it is that all sensors of a group jump, for each group."""
        return self.process_settings + self.process_modes * PROCESS_SETTINGS

    @property
    def haste(self) -> int:
        """Where in the settings it stands how much sooner young faults end."""
        return self.common_settings + len(self.groups)

    @property
    def takes_over(self) -> int:
        """Where in the settings it stands how much of a deviation the estimate takes over with a sample while a belief fades."""
        return self.haste + 1

    @property
    def actuator(self) -> int:
        """How many numbers are kept of an actuator."""
        return OF_MODES + 2 * self.actuator_modes

    @property
    def hypotheses(self) -> int:
        """How many hypotheses there are: the last one, that a mode of the process has ended, if it has any."""
        return self.process + self.process_modes + (self.process_modes > 0)

    @property
    def first_lost(self) -> int:
        """Which hypothesis is the first one that a sensor goes its own course."""
        return 1 + self.m * len(self.kinds)

    @property
    def first_common(self) -> int:
        """Which hypothesis is the first one that all sensors of a group have the same offset."""
        return self.first_lost + self.m * len(self.lost)

    @property
    def first_ended(self) -> int:
        """Which hypothesis is the first one that such an offset has ended with this sample."""
        return self.first_common + len(self.groups)

    @property
    def first_actuator(self) -> int:
        """Which hypothesis is the first one of a mode of an actuator."""
        return self.first_ended + len(self.groups)

    @property
    def process(self) -> int:
        """Which hypothesis is the first one of a mode of the process; those from here on have no offset."""
        return self.first_actuator + self.p * self.actuator_modes

    @property
    def kept(self) -> int:
        """Where in a hypothesis the sensors stand."""
        return STATE + (self.n + 2) * (self.n + 3)

    @property
    def length(self) -> int:
        """How many numbers a hypothesis has."""
        return self.kept + self.m * self.sensor

    @property
    def actuators(self) -> int:
        """Where in the memory the actuators stand."""
        return self.m * self.sensor + 2

    @property
    def first(self) -> int:
        """Where the first hypothesis stands, that nothing has an offset."""
        return self.actuators + self.p * self.actuator

    @property
    def pool(self) -> int:
        """Where the pool stands, of what has ended."""
        return self.first + self.hypotheses * self.length

    @property
    def grow(self) -> int:
        """Where the probabilities stand of what begins, then what each hypothesis says of the samples: logarithm and factor."""
        return self.pool + self.length

    @property
    def couples(self) -> int:
        """Where it stands how an offset moves the state."""
        return self.grow + 3 * self.hypotheses

    @property
    def shift(self) -> int:
        """Where it stands what else moves the state."""
        return self.couples + self.n + 2

    @property
    def courses(self) -> int:
        """Where the courses stand, for each sensor and mode: the share that has just begun, then the regression."""
        return self.shift + self.n + 2

    @property
    def course(self) -> int:
        """How many numbers are kept of a course."""
        return 1 + COURSE

    @property
    def squares(self) -> int:
        """Where it stands for each hypothesis what it makes of the square of each sensor's noise."""
        return self.courses + self.m * len(self.lost) * self.course

    @property
    def repeated(self) -> int:
        """Where it stands for each sensor how surprising a repeated sample is."""
        return self.squares + self.hypotheses * self.m

    @property
    def scratch(self) -> int:
        """Where scratch space begins."""
        return self.repeated + self.m

    def start(self, sensors: Floats) -> Floats:
        """Return what is kept before the first sample besides ``sensors``, what the per-sensor form keeps of all of them."""
        N = self.n + 2
        # Nothing is known of actuators where a controller judges sensor by sensor.
        actuator = np.full(self.actuator, np.nan)
        actuator[[WORKS, LOAD, STEERS, PUSHES]] = 1.0, 0.0, 1.0, 0.0
        hypothesis = np.zeros(self.length)
        hypothesis[self.kept :] = sensors
        hypotheses = np.tile(hypothesis, (self.hypotheses + 1, 1))  # the last one is the pool
        hypotheses[:, PROBABILITY] = [1.0, *[LEAST] * self.hypotheses]
        before = np.zeros(self.scratch - self.grow)
        scratch = np.zeros(max(N * N, COURSE_SCRATCH))
        return np.concatenate([np.tile(actuator, self.p), hypotheses.ravel(), before, scratch])
