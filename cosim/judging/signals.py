"""The signals of a closed loop by their role in it, for the metrics and the figure of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.types import Floats

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

ALARM = 0.5
"""The lowest fault probability of an alarm."""
REMEMBERED = 1000
"""Steps within which faults of several sensors count as one after another: the check of the model remembers some hundred samples,
and a slow sensor has one in a few steps."""
SCORES = ("fault_probability", "beta")
"""Outputs of a controller that rank samples by how likely a sensor fault is, in order of preference."""
LONGER, FEWEST = 1.5, 3
"""Factor by which a gap between samples of a slow sensor is longer than usual; fewest samples that show what is usual."""


def any_of(flags: list[Flags | None]) -> Flags | None:
    """Return the samples at which any of the flags is set; None if one of them is None."""
    recorded = [f for f in flags if f is not None]
    return np.any(recorded, axis=0) if recorded and len(recorded) == len(flags) else None


@dataclass(frozen=True, eq=False)
class SensorSignals:
    """One sensor over time; each array has a row for each recorded step, and is None if its signal was not recorded.

    Attributes
    ----------
    index : int
        Its number, from 0.
    samples : array
        The samples that the controller received (NaN for a missing sample).
    faulty : array of bool or None
        Whether a fault between the sensor and the controller was present; None if not recorded.
    precision, beta, probability : array
        The controller's outputs for this sensor.
    detected : array of bool or None
        Whether the controller reports a detected fault (as `ExplicitDetection` does).
    kind : array or None
        The most probable kind of fault by its number (0: healthy); None if there is no such output, or if not recorded.
    kinds : tuple of str
        Names of the kinds, from number 1 on.
    unit : str or None
        The unit of the samples.
    size, onset : array or None
        The size and the begin in seconds of a fault of that kind; None if there is no such output, or if not recorded.
    sizes : tuple of str
        What the size of each kind is in: the ``"unit"`` of the sensor, or multiples of its ``"noise"``; for ``"distance"`` such a
        multiple is the distance of the samples from the belief. Empty for no fault.
    corrected_kinds : tuple of str
        Those of ``kinds`` that the controller estimates and subtracts, so that the sensor is still used.
    chances : array of shape (steps, 1 + kinds) or None
        Probability of each kind, healthy first; None if there is no such output, or if not recorded.
    """

    index: int
    samples: Floats | None
    faulty: Flags | None
    precision: Floats | None
    beta: Floats | None
    probability: Floats | None
    detected: Flags | None = None
    kind: Floats | None = None
    kinds: tuple[str, ...] = ()
    unit: str | None = None
    size: Floats | None = None
    onset: Floats | None = None
    sizes: tuple[str, ...] = ()
    corrected_kinds: tuple[str, ...] = ()
    chances: Floats | None = None

    @property
    def corrected(self) -> Flags:
        """The samples of which the controller subtracts an offset that it infers; none if the kinds were not recorded."""
        numbers = [number for number, kind in enumerate(self.kinds, start=1) if kind in self.corrected_kinds]
        if self.kind is None or self.probability is None:
            return np.zeros(0 if self.precision is None else len(self.precision), dtype=bool)
        return (self.probability >= ALARM) & np.isin(self.kind, numbers)  # type: ignore[no-any-return]

    @property
    def missing(self) -> Flags | None:
        """Which samples were missing (NaN); None if the samples were not recorded."""
        return None if self.samples is None else np.isnan(self.samples)

    @property
    def pauses(self) -> Flags:
        """The steps between two samples of a slow sensor, at which no sample is due; none of most sensors.

        A sensor is slow if nine of ten samples or more come several steps after the one before. In a gap that is longer than
        usual, samples are missing.
        """
        steps, usual = np.arange(0 if self.samples is None else len(self.samples)), self._usual
        if self.missing is None or usual == 1:
            return np.zeros(len(steps), dtype=bool)
        given = np.flatnonzero(~self.missing)
        last = np.searchsorted(given, steps, side="right") - 1
        since = steps - np.append(given, -1)[last]
        gap = np.append(np.diff(given), len(steps))[last]
        return (since > 0) & ((since < usual) | ((last >= 0) & (gap < LONGER * usual)))  # type: ignore[no-any-return]

    @property
    def _usual(self) -> int:
        """The usual number of steps from one sample to the next."""
        if self.missing is None or not self.missing.any():
            return 1
        given = np.flatnonzero(~self.missing)
        return int(np.quantile(np.diff(given), 0.1, method="lower")) if len(given) >= FEWEST else 1

    @property
    def missing_share(self) -> float:
        """The share of the samples that were missing of those that were due; NaN if the samples were not recorded.

        Those of a slow sensor are due at the median distance.
        """
        if self.missing is None or not len(self.missing):
            return np.nan
        given = np.flatnonzero(~self.missing)
        if self._usual == 1:
            return float(self.missing.mean())
        usual = int(np.median(np.diff(given)))
        gaps = np.diff(given) / usual
        within = np.round(gaps[gaps >= LONGER]) - 1.0
        count = given[0] // usual + within.sum() + (len(self.missing) - 1 - given[-1]) // usual
        return float(count / (count + len(given)))

    @property
    def lost(self) -> Flags | None:
        """Which samples were missing that were due; None if the samples were not recorded."""
        return None if self.missing is None else self.missing & ~self.pauses

    @property
    def alarm(self) -> Flags | None:
        """The samples with an alarm; None if not recorded, or if a sample has no finite probability.

        An alarm is a probability of at least `ALARM`, or for a controller without probabilities a detected fault.
        """
        if self.probability is not None:
            finite = ~np.isnan(self.probability)
            if finite.any() or self.detected is None:
                complete = finite if self.missing is None else finite | self.missing
                return self.probability >= ALARM if complete.all() else None  # type: ignore[return-value]
        return self.detected


@dataclass(frozen=True, eq=False)
class QuantitySignals:
    """One quantity that sensors measure, or that has a goal, over time.

    Attributes
    ----------
    name : str
        The plant's variable; of a sensor that reads several their sum, such as ``altitude + wander``, or ``sensor i`` of many.
    unit : str or None
        Its unit.
    sensors : tuple of int
        The sensors that measure it; none where only the goal is for it.
    truth : array or None
        The reading of an ideal sensor: without noise, offset, rounding and fault.
    reference : array or None
        Its element of the goal; None if there is none, or if not recorded.
    belief : array or None
        The controller's estimate of it: ``C x_hat``; None if there is none, or if not recorded.
    has_goal : bool
        Whether there is an element of the goal for it.
    has_belief : bool
        Whether the controller states it as a linear function of ``x_hat``.
    spread : array or None
        Standard deviation of the belief; None if the controller has no covariance ``P``, or if not recorded.
    only_ahead : bool
        Whether only a later value of its goal is a signal, so that there is no reference.
    """

    name: str
    unit: str | None
    sensors: tuple[int, ...]
    truth: Floats | None
    reference: Floats | None
    belief: Floats | None
    has_goal: bool
    has_belief: bool
    spread: Floats | None = None
    only_ahead: bool = False


@dataclass(frozen=True, eq=False)
class InputSignals:
    """One input of the plant with an actuator fault or a process fault, over time.

    Attributes
    ----------
    name : str
        The plant's variable.
    unit : str or None
        Its unit.
    sent, received : array or None
        The signal from the controller (or a noise), and the signal that the plant receives; None if not recorded.
    faults : mapping of str to array of bool or None
        For each fault in between, whether it was present; None if not recorded.
    control : int or None
        The number of the control that is sent; None for another signal.
    """

    name: str
    unit: str | None
    sent: Floats | None
    received: Floats | None
    faults: Mapping[str, Flags | None]
    control: int | None = None

    @property
    def faulty(self) -> Flags | None:
        """Whether any of the faults was present; None if one of them was not recorded."""
        return any_of(list(self.faults.values()))


@dataclass(frozen=True, eq=False)
class ActuatorSignals:
    """The inference about one control, over time, by a controller with actuator modes.

    Attributes
    ----------
    name : str
        The plant's variable that the control feeds; ``control j`` if it feeds none.
    unit : str or None
        Its unit.
    faulty : array of bool or None
        Whether a fault of the actuator was present; None if not recorded.
    probability : array
        Probability that the actuator has a fault.
    kind, size : array or None
        The most probable mode by its number (0: healthy), and the size of its fault; None if not recorded.
    kinds : tuple of str
        Names of the modes, from number 1 on.
    sizes : tuple of str
        What the size of each kind is in: the ``"unit"`` of the control, or a share of its ``"effect"``.
    chances : array of shape (steps, 1 + kinds) or None
        As for `SensorSignals`.
    """

    name: str
    unit: str | None
    faulty: Flags | None
    probability: Floats
    kind: Floats | None
    size: Floats | None
    kinds: tuple[str, ...]
    sizes: tuple[str, ...] = ()
    chances: Floats | None = None


@dataclass(frozen=True, eq=False)
class ControlSignals:
    """One control over time: the signal for the plant's input of this name, and its limits (None: unlimited).

    ``rate`` is the limit of its change per second, ``dt`` the seconds between two of its values (None: not known).
    """

    name: str
    unit: str | None
    sent: Floats
    low: float | None
    high: float | None
    rate: float | None = None
    dt: float | None = None


PROCESS_KINDS = ("NoisierProcess",)
"""The kind of all process modes."""


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """A run of a closed loop: time in seconds, the measured quantities, the sensors, the inputs with faults.

    ``faults`` has for each recorded sensor fault the number of its sensor and whether it was present. ``actuators`` are those
    with an inference of the controller, ``controls`` the recorded ones. ``process`` is the probability of the process modes;
    None if there are none, or if not recorded. ``lag`` is a sentence about how far the controller is behind a moving reference.
    ``unrecorded`` are signals of the loop that were not recorded.
    """

    time: Floats
    quantities: tuple[QuantitySignals, ...]
    sensors: tuple[SensorSignals, ...]
    faults: Mapping[str, tuple[int, Flags]]
    inputs: tuple[InputSignals, ...] = ()
    actuators: tuple[ActuatorSignals, ...] = ()
    controls: tuple[ControlSignals, ...] = ()
    process: Floats | None = None
    lag: str = ""
    unrecorded: tuple[str, ...] = ()

    @property
    def faulty(self) -> Flags | None:
        """Whether any sensor or input had a fault; None if one of them was not recorded."""
        return any_of([*(s.faulty for s in self.sensors), *(i.faulty for i in self.inputs)])

    @property
    def moved(self) -> ActuatorSignals | None:
        """Whether the plant moves more than its model expects, as the one kind of fault of the process; None if not inferred."""
        p = self.process
        return None if p is None else ActuatorSignals("process", None, None, p, np.ones_like(p), None, PROCESS_KINDS)

    def sensor_name(self, index: int) -> str:
        """Return the name of a sensor: its number, and of several quantities the one that it measures."""
        measured = [q for q in self.quantities if q.sensors]
        of = next((f" ({q.name})" for q in measured if index in q.sensors), "") if len(measured) > 1 else ""
        return f"sensor {index}{of}"


__all__ = [
    "ALARM",
    "REMEMBERED",
    "SCORES",
    "ActuatorSignals",
    "ControlSignals",
    "Flags",
    "InputSignals",
    "LoopSignals",
    "QuantitySignals",
    "SensorSignals",
]
