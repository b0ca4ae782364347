"""Places of a bank of hypotheses in memory and settings."""

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
"""Numbers of an actuator: expected effectiveness and offset of the control; the same as used by the control law; then probability
and size of each mode."""

BY_MODES, BY_COURSE = -1, -2
"""How a hypothesis judges a sensor without an offset."""


@dataclass(frozen=True)
class Layout:
    """The sizes and places of a bank.

    The memory begins as in the per-sensor form (all sensors, the number of samples, their log density). Then follow the
    actuators, the hypotheses, the pool, the belief before onsets, the unmodelled courses, and scratch space. The hypotheses are:
    no fault; each kind of offset on each sensor; each sensor on an unmodelled course; each group of sensors with the same offset,
    and its end; each mode of each actuator; each of the process, and the end of such a mode. The settings are those of the
    per-sensor form, then those of each mode of each actuator and of the process, then of each group, then the haste of young
    faults, the estimate's gain, and with modes of the process the doubt of the start and the states at samples.

    An offset that jumps is a separate hypothesis for its first sample. Merged at once with earlier ones, which nothing has
    contradicted so far, it would hardly remain a jump.

    Attributes
    ----------
    n, m, p : int
        Numbers of states, sensors and actuators.
    plant : int
        Number of the plant's states, which modes of the process move; the others are estimated disturbances.
    kinds : tuple of int
        The sensors' modes that are offsets; those that jump appear once more at the end, for their first sample.
    becomes : tuple of int
        For each of these, its successor after the first sample: itself, or the earlier one of the same mode.
    slow : tuple of int
        For each of these, whether it needs another sensor as a witness (1 or 0).
    lost : tuple of int
        The sensors' modes that are unmodelled courses, where the state is inferred without that sensor.
    quantity : tuple of int
        For each sensor, the number of what it measures.
    groups : tuple of tuple of int
        Groups of sensors that measure the same, and may all have the same offset.
    common : int
        The sensors' mode of such an offset.
    kick : int
        The process mode that competes with such an offset, of the same size, with the odds `alike`; -1: none.
    fades : tuple of int
        For each process mode, whether the belief fades in it (1 or 0).
    alone, other : tuple of int
        For each mode, the part of its block that is used where no sensor has an offset, and for the other sensors where one has;
        0 if the mode is not used.
    faults : tuple of int
        For each mode, whether it is a fault (1 or 0).
    actuator_modes : int
        Number of modes of each actuator.
    process_modes : int
        Number of modes of the process.
    width, width_of_settings : int
        Widths of the blocks of the sensors' modes.
    drops : tuple of int
        The sensors' modes without samples.
    outages : bool
        Whether a step without any sample may be an outage.
    repeats : int
        The sensors' mode of a sample that repeats; -1: none.
    """

    n: int
    m: int
    p: int
    plant: int
    kinds: tuple[int, ...]
    becomes: tuple[int, ...]
    slow: tuple[int, ...]
    lost: tuple[int, ...]
    quantity: tuple[int, ...]
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
    drops: tuple[int, ...] = ()
    outages: bool = False
    repeats: int = -1

    @property
    def fresh(self) -> tuple[bool, ...]:
        """For each kind of offset, whether it is a first sample."""
        return tuple(self.becomes[q] != q for q in range(len(self.kinds)))

    @property
    def judged(self) -> tuple[int, ...]:
        """For each hypothesis and each sensor, the mode of its offset that is estimated with the state.

        It is `BY_MODES` for a sensor judged by its modes, `BY_COURSE` for one on an unmodelled course.
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
    def order(self) -> tuple[int, ...]:
        """For each hypothesis, the order in which it is conditioned on the sensors: those with an offset last.

        Otherwise an offset of the first sensor would explain a surprise before the modes of any other sensor are judged, and
        an offset of the last one after those of all others: after a sudden load, healthy sensor 0 would be blamed.
        """
        judged = np.reshape(self.judged, (self.hypotheses, self.m))
        return tuple(int(i) for row in judged for i in np.argsort(row >= 0, kind="stable"))

    @property
    def with_offset(self) -> tuple[int, ...]:
        """The hypotheses with an offset estimated with the state: of a sensor, a group or an actuator."""
        of_sensors = (*range(1, self.first_lost), *range(self.first_common, self.first_ended))
        return (*of_sensors, *range(self.first_actuator, self.process))

    @property
    def without_offset(self) -> tuple[int, ...]:
        """The hypotheses without such an offset."""
        return tuple(h for h in range(self.hypotheses) if h not in self.with_offset)

    @property
    def jumps(self) -> tuple[bool, ...]:
        """For each kind of offset, whether it begins with a jump, in its first sample or later."""
        return tuple(self.becomes.count(self.becomes[q]) > 1 for q in range(len(self.kinds)))

    @property
    def begins_here(self) -> tuple[bool, ...]:
        """For each kind of offset, whether it begins as this kind, not as its first sample."""
        return tuple(self.fresh[q] or self.becomes.count(q) == 1 for q in range(len(self.kinds)))

    @property
    def joined(self) -> tuple[bool, ...]:
        """For each kind of offset, whether an actuator or the process may fail beside it.

        They may if the modes of the sensors in those hypotheses include the offset.
        """
        others = self.p * self.actuator_modes + self.process_modes > 0
        return tuple(
            others and not fresh and self.other[k] > 0 for fresh, k in zip(self.fresh, self.kinds, strict=True)
        )

    @property
    def modes(self) -> int:
        """Number of modes of a sensor."""
        return len(self.faults)

    @property
    def sensor(self) -> int:
        """Number of stored values of a sensor."""
        return FIRST + self.modes * self.width

    @property
    def row(self) -> int:
        """Number of settings of a sensor."""
        return FIRST_SETTINGS + self.modes * self.width_of_settings

    @property
    def actuator_settings(self) -> int:
        """Place of the actuators' modes in the settings."""
        return self.m * self.row + 1

    @property
    def process_settings(self) -> int:
        """Place of the process modes in the settings."""
        return self.actuator_settings + self.p * self.actuator_modes * ACTUATOR_SETTINGS

    @property
    def common_settings(self) -> int:
        """Place in the settings of the probabilities that all sensors of a group jump."""
        return self.process_settings + self.process_modes * PROCESS_SETTINGS

    @property
    def haste(self) -> int:
        """Place in the settings of the haste, by which young faults end sooner."""
        return self.common_settings + len(self.groups)

    @property
    def gain_share(self) -> int:
        """Place in the settings of the estimate's gain on a deviation while a belief fades."""
        return self.haste + 1

    @property
    def doubt(self) -> int:
        """Place in the settings of the probability that the plant starts elsewhere."""
        return self.gain_share + 1

    @property
    def elsewhere(self) -> int:
        """Place in the settings of the state at a sample of each sensor's quantity, a table of states x sensors."""
        return self.doubt + 1

    @property
    def unread(self) -> int:
        """Place in the settings of the share of each state that no sensor reads."""
        return self.elsewhere + self.n * self.m

    @property
    def most(self) -> int:
        """Place in the settings of the variance of each state up to which a belief fades."""
        return self.unread + self.n

    @property
    def actuator(self) -> int:
        """Number of stored values of an actuator."""
        return OF_MODES + 2 * self.actuator_modes

    @property
    def hypotheses(self) -> int:
        """Number of hypotheses; the last one is the end of a process mode, if there are any."""
        return self.process + self.process_modes + (self.process_modes > 0)

    @property
    def first_lost(self) -> int:
        """Number of the first hypothesis of an unmodelled course."""
        return 1 + self.m * len(self.kinds)

    @property
    def first_common(self) -> int:
        """Number of the first hypothesis of a common offset."""
        return self.first_lost + self.m * len(self.lost)

    @property
    def first_ended(self) -> int:
        """Number of the first hypothesis of a common offset's end at this sample."""
        return self.first_common + len(self.groups)

    @property
    def first_actuator(self) -> int:
        """Number of the first hypothesis of an actuator's mode."""
        return self.first_ended + len(self.groups)

    @property
    def process(self) -> int:
        """Number of the first hypothesis of a process mode; those from here on have no offset."""
        return self.first_actuator + self.p * self.actuator_modes

    @property
    def kept(self) -> int:
        """Place of the sensors in a hypothesis."""
        return STATE + (self.n + 2) * (self.n + 3)

    @property
    def length(self) -> int:
        """Number of stored values of a hypothesis."""
        return self.kept + self.m * self.sensor

    @property
    def actuators(self) -> int:
        """Place of the actuators in the memory."""
        return self.m * self.sensor + 2

    @property
    def first(self) -> int:
        """Place of the first hypothesis, without any offset."""
        return self.actuators + self.p * self.actuator

    @property
    def pool(self) -> int:
        """Place of the pool of ended faults."""
        return self.first + self.hypotheses * self.length

    @property
    def before(self) -> int:
        """Place of the belief before a fault of an actuator or the process; see `merges.make_gather`."""
        return self.pool + self.length

    @property
    def grow(self) -> int:
        """Place of the onsets' probabilities, followed by each hypothesis's density of the samples: logarithm and factor."""
        return self.before + self.length

    @property
    def couples(self) -> int:
        """Place of the effect of an offset on the state."""
        return self.grow + 3 * self.hypotheses

    @property
    def shift(self) -> int:
        """Place of the other inputs of the state."""
        return self.couples + self.n + 2

    @property
    def courses(self) -> int:
        """Place of the unmodelled courses, for each sensor and mode: the share that has just begun, then the regression."""
        return self.shift + self.n + 2

    @property
    def course(self) -> int:
        """Number of stored values of an unmodelled course."""
        return 1 + COURSE

    @property
    def squares(self) -> int:
        """Place of each hypothesis's estimate of each sensor's squared noise."""
        return self.courses + self.m * len(self.lost) * self.course

    @property
    def judgements(self) -> int:
        """Place of each sensor's squared error by which each hypothesis judged it, followed by those errors' variances."""
        return self.squares + self.hypotheses * self.m

    @property
    def repeated(self) -> int:
        """Place of each sensor's density factor of a repeated sample, of its `indifferent` error, of a freeze's factor."""
        return self.judgements + 2 * self.hypotheses * self.m

    @property
    def readings(self) -> int:
        """Place of each hypothesis's reading of one sensor: variance without and with noise, error, vectors of `correct`."""
        return self.repeated + 3 * self.m

    @property
    def reading(self) -> int:
        """Number of stored values of a reading."""
        return 3 + 3 * (self.n + 2)

    @property
    def surprise(self) -> int:
        """Place of the mean squared innovation without a fault, in its expected variances."""
        return self.readings + self.hypotheses * self.reading

    @property
    def usual(self) -> int:
        """Place of the sensors' squared errors without a fault, then of their variances, then of the means of the last ones."""
        return self.surprise + 1

    @property
    def saved(self) -> int:
        """Place of the hypotheses before a step, if there may be outages."""
        return self.usual + 3 * self.m

    @property
    def scratch(self) -> int:
        """Place of the scratch space."""
        return self.saved + self.outages * self.hypotheses * self.length

    def start(self, sensors: Floats) -> Floats:
        """Return the values before the first sample that follow ``sensors``, the per-sensor form's values."""
        N = self.n + 2
        # Actuators are NaN where a controller judges sensor by sensor.
        actuator = np.full(self.actuator, np.nan)
        actuator[[WORKS, LOAD, STEERS, PUSHES]] = 1.0, 0.0, 1.0, 0.0
        hypothesis = np.zeros(self.length)
        hypothesis[self.kept :] = sensors
        # Behind the hypotheses are the pool, and the belief before onsets.
        hypotheses = np.tile(hypothesis, (self.hypotheses + 2, 1))
        hypotheses[:, PROBABILITY] = [1.0, *[LEAST] * (self.hypotheses + 1)]
        between = np.zeros(self.scratch - self.grow)
        between[self.surprise - self.grow] = 1.0
        scratch = np.zeros(max(N * N, COURSE_SCRATCH, 2 * self.m))
        return np.concatenate([np.tile(actuator, self.p), hypotheses.ravel(), between, scratch])
