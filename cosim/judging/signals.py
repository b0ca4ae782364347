"""The signals of a closed loop by their part in it, as the figures and the figure of a run take them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.types import Floats

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

ALARM = 0.5
"""The fault probability from which on there is an alarm."""


def any_of(flags: list[Flags | None]) -> Flags | None:
    """Return with which samples any of the flags is set; None if not all of them are known."""
    known = [f for f in flags if f is not None]
    return np.any(known, axis=0) if known and len(known) == len(flags) else None


@dataclass(frozen=True, eq=False)
class SensorSignals:
    """One sensor over time; each array has a row for each recorded step, and is None if its signal was not recorded.

    Attributes
    ----------
    index : int
        Its number, from 0.
    samples : array
        What the controller was given (NaN for a missing sample).
    faulty : array of bool or None
        Whether a fault between the sensor and the controller was present; None if that was not recorded.
    precision, beta, probability : array
        The controller's outputs for this sensor.
    detected : array of bool or None
        Whether the controller says that it has detected a fault (`ExplicitDetection` does).
    kind : array or None
        The most probable kind of fault by its number (0: healthy); None if there is none, or if it was not recorded.
    kinds : tuple of str
        Names of the kinds, from number 1 on.
    unit : str or None
        The unit of the samples.
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

    @property
    def missing(self) -> Flags | None:
        """Which samples were missing (NaN); None if the samples were not recorded."""
        return None if self.samples is None else np.isnan(self.samples)

    @property
    def alarm(self) -> Flags | None:
        """With which samples there is an alarm; None if that was not recorded, or if a sample has no finite probability.

        A probability of at least `ALARM` is one; of a controller that gives none, what it says is detected.
        """
        if self.probability is not None:
            known = ~np.isnan(self.probability)
            if known.any() or self.detected is None:
                needed = known if self.missing is None else known | self.missing
                return self.probability >= ALARM if needed.all() else None  # type: ignore[return-value]
        return self.detected


@dataclass(frozen=True, eq=False)
class QuantitySignals:
    """One quantity that sensors measure, over time.

    Attributes
    ----------
    name : str
        The plant's variable, or ``sensor i`` where a sensor measures a mixture of several.
    unit : str or None
        Its unit.
    sensors : tuple of int
        The sensors that measure it.
    truth : array or None
        What an ideal sensor would read: without noise, offset, rounding and fault.
    reference : array or None
        The element of the goal for this very quantity; None if there is none, or if it was not recorded.
    belief : array or None
        The controller's estimate of it: ``C x_hat``; None if that was not recorded, or if there is none.
    has_goal : bool
        Whether there is an element of the goal for it.
    has_belief : bool
        Whether the controller says what linear function of ``x_hat`` it is.
    spread : array or None
        Standard deviation of the belief; None if the controller has no covariance ``P``, or if it was not recorded.
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


@dataclass(frozen=True, eq=False)
class InputSignals:
    """One input of the plant on whose way there is a fault, of an actuator or of the process, over time.

    Attributes
    ----------
    name : str
        The plant's variable.
    unit : str or None
        Its unit.
    sent, received : array or None
        What the controller (or a noise) has sent, and what the plant was given; None if that was not recorded.
    faults : mapping of str to array of bool or None
        For each fault on the way when it was present; None if that was not recorded.
    control : int or None
        The number of the control that is sent; None if it is another signal.
    """

    name: str
    unit: str | None
    sent: Floats | None
    received: Floats | None
    faults: Mapping[str, Flags | None]
    control: int | None = None

    @property
    def faulty(self) -> Flags | None:
        """Whether any of the faults was present; None if not all of that was recorded."""
        return any_of(list(self.faults.values()))


@dataclass(frozen=True, eq=False)
class ActuatorSignals:
    """What a controller that knows of actuators' faults says of one of its controls, over time.

    Attributes
    ----------
    name : str
        The plant's variable that the control goes to; ``control j`` if it goes to none.
    unit : str or None
        Its unit.
    faulty : array of bool or None
        Whether a fault on the way was present; None if that was not recorded.
    probability : array
        That the actuator has a fault.
    kind, size : array or None
        The most probable mode by its number (0: healthy), and the size of its fault; None if that was not recorded.
    kinds : tuple of str
        Names of the modes, from number 1 on.
    """

    name: str
    unit: str | None
    faulty: Flags | None
    probability: Floats
    kind: Floats | None
    size: Floats | None
    kinds: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ControlSignals:
    """One control over time: what was sent to the plant's input of this name, and its limits (None: unlimited)."""

    name: str
    unit: str | None
    sent: Floats
    low: float | None
    high: float | None


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """A run of a closed loop: time in seconds, the measured quantities, the sensors, the inputs with a fault on their way.

    ``faults`` has for each fault of a sensor that was recorded the number of that sensor and when it was present;
    ``actuators`` are those that the controller says something of, ``controls`` those that were recorded.
    """

    time: Floats
    quantities: tuple[QuantitySignals, ...]
    sensors: tuple[SensorSignals, ...]
    faults: Mapping[str, tuple[int, Flags]]
    inputs: tuple[InputSignals, ...] = ()
    actuators: tuple[ActuatorSignals, ...] = ()
    controls: tuple[ControlSignals, ...] = ()

    @property
    def faulty(self) -> Flags | None:
        """Whether any sensor or input had a fault; None if not all of that was recorded."""
        return any_of([*(s.faulty for s in self.sensors), *(i.faulty for i in self.inputs)])


__all__ = [
    "ALARM", "ActuatorSignals", "ControlSignals", "Flags", "InputSignals", "LoopSignals", "QuantitySignals", "SensorSignals",
]  # fmt: skip
