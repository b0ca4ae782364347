"""The signals of a closed loop by their role in it, for the metrics and the figure of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayesftc.cosim.types import Floats

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

ALARM = 0.5
"""The lowest fault probability of an alarm."""

AT_ONCE = 20
"""Number of samples within which an alarm begins with the run."""

AGREE = 1.5
"""Largest root mean square of the difference of two sensors that agree, in multiples of its noise."""

LEAST = 10
"""Least number of samples, one after the other, with an alarm of all sensors."""

MOST = 100
"""Number of samples from the begin of the alarms in which they must agree; one may fail later."""


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
        What the size of each kind is in: the ``"unit"`` of the sensor, or multiples of its ``"noise"``; empty for no fault.
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

    @property
    def missing(self) -> Flags | None:
        """Which samples were missing (NaN); None if the samples were not recorded."""
        return None if self.samples is None else np.isnan(self.samples)

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
    """One quantity that sensors measure, over time.

    Attributes
    ----------
    name : str
        The plant's variable, or ``sensor i`` if a sensor measures a mixture of several.
    unit : str or None
        Its unit.
    sensors : tuple of int
        The sensors that measure it.
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
    """

    name: str
    unit: str | None
    faulty: Flags | None
    probability: Floats
    kind: Floats | None
    size: Floats | None
    kinds: tuple[str, ...]
    sizes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ControlSignals:
    """One control over time: the signal for the plant's input of this name, and its limits (None: unlimited)."""

    name: str
    unit: str | None
    sent: Floats
    low: float | None
    high: float | None


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """A run of a closed loop: time in seconds, the measured quantities, the sensors, the inputs with faults.

    ``faults`` has for each recorded sensor fault the number of its sensor and whether it was present. ``actuators`` are those
    with an inference of the controller, ``controls`` the recorded ones. ``process`` is the probability of the process modes;
    None if there are none, or if not recorded.
    """

    time: Floats
    quantities: tuple[QuantitySignals, ...]
    sensors: tuple[SensorSignals, ...]
    faults: Mapping[str, tuple[int, Flags]]
    inputs: tuple[InputSignals, ...] = ()
    actuators: tuple[ActuatorSignals, ...] = ()
    controls: tuple[ControlSignals, ...] = ()
    process: Floats | None = None

    @property
    def faulty(self) -> Flags | None:
        """Whether any sensor or input had a fault; None if one of them was not recorded."""
        return any_of([*(s.faulty for s in self.sensors), *(i.faulty for i in self.inputs)])

    def sensor_name(self, index: int) -> str:
        """Return the name of a sensor: its number, and of several quantities the one that it measures."""
        measured = [q.name for q in self.quantities if index in q.sensors] if len(self.quantities) > 1 else []
        return f"sensor {index} ({measured[0]})" if measured else f"sensor {index}"


def blamed_together(signals: LoopSignals, decimation: int = 1) -> dict[str, list[str]]:
    """Return notes on quantities of which all sensors have an alarm, without a fault, although they agree.

    The reason is the belief at the start (``"start"``) if the alarms begin with the run, and no fault of an input has begun, or
    else the model (``"model"``).
    """
    notes: dict[str, list[str]] = {"start": [], "model": []}
    begun = [int(i.faulty.argmax()) for i in signals.inputs if i.faulty is not None and i.faulty.any()]
    for quantity in signals.quantities:
        group = [signals.sensors[i] for i in quantity.sensors]
        alarms = [s.alarm & ~s.faulty for s in group if s.alarm is not None and s.faulty is not None]
        samples = [s.samples for s in group if s.samples is not None]
        if len(samples) < len(group) or len(alarms) < len(group):
            continue
        first = alarms_of_all(samples, alarms)
        if first is None:
            continue
        of, wrong = "model", "the plant behaves unlike the controller's model"
        if first * decimation < AT_ONCE and min(begun, default=first + 1) > first:
            of, wrong = "start", "the controller's belief at the start is wrong (initial_mean, initial_spread)"
        sensors, t = "both" if len(group) == 2 else f"all {len(group)}", signals.time[first]
        notes[of].append(f"{sensors} sensors of {quantity.name} agree but are blamed from t = {t:g} s: {wrong}")
    return notes


def alarms_of_all(samples: Sequence[Floats], alarms: Sequence[Flags]) -> int | None:
    """Return the first sample from which on all sensors of a quantity have an alarm for a while although they agree, or None.

    Parameters
    ----------
    samples : sequence of ndarray, shape (steps,)
        The samples of each sensor; NaN is a missing one.
    alarms : sequence of ndarray of bool, shape (steps,)
        Where each sensor counts as faulty, and has no fault.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim.judging.signals import alarms_of_all
    >>> rng = np.random.default_rng(0)
    >>> first, second = 3.0 + 0.1 * rng.standard_normal((2, 100))
    >>> late = np.arange(100) >= 40
    >>> alarms_of_all([first, second], [late, late])
    40
    >>> alarms_of_all([first, second + 0.5 * late], [late, late])  # they do not agree
    """
    blamed = np.all(alarms, axis=0)
    if len(samples) < 2 or not blamed.any():
        return None
    edges = np.flatnonzero(np.diff(np.concatenate([[False], blamed, [False]]).astype(int)))
    differences = [one - other for one, other in combinations(samples, 2)]
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin >= LEAST and all(_agree(d, int(begin), min(int(end), int(begin) + MOST)) for d in differences):
            return int(begin)
    return None


def _agree(difference: Floats, begin: int, end: int) -> bool:
    """Return whether a difference of two sensors is no more than their noise in a stretch.

    Its noise is estimated from its changes, so that offsets and drifts do not count for it.
    """
    finite = difference[np.isfinite(difference)]
    there = difference[begin:end][np.isfinite(difference[begin:end])]
    if len(there) < LEAST:
        return False
    noise = float(np.median(np.abs(np.diff(finite)))) / 0.6745 / 2.0**0.5
    return bool(np.sqrt(np.mean(there * there)) <= AGREE * noise)


__all__ = [
    "ALARM", "ActuatorSignals", "ControlSignals", "Flags", "InputSignals", "LoopSignals", "QuantitySignals", "SensorSignals",
    "blamed_together",
]  # fmt: skip
