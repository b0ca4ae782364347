"""Alarms while samples arrive: each is known at its start, and complete at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.default_time import time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.judging.findings import onset_of_alarm
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import ACTUATOR_SIGNALS, ActuatorEvent, Alarm, FaultEvent


class AlarmWatch:
    """Watches fault probabilities step by step.

    An alarm begins at the first step with a probability of at least the threshold. It has ended when the probability has been
    below for longer than `Alarm.hold`; its end is the last step above, as in a recording.

    Parameters
    ----------
    sensors : sequence of str
        Their names.
    modes : sequence of FaultMode
        The learner's modes; may be empty.
    step : Fraction
        Seconds between two steps.
    alarm : Alarm, optional
        Conditions of an alarm.

    Examples
    --------
    >>> import numpy as np
    >>> from fractions import Fraction
    >>> from bayesftc import monitoring
    >>> watch = monitoring.AlarmWatch(["left", "right"], (), Fraction(1, 10), monitoring.Alarm(hold=0.2))
    >>> for k, p in enumerate([0.1, 0.95, 0.99, 0.1, 0.1, 0.1, 0.1]):
    ...     for event, ended in watch.feed(0.1 * k, {"fault_probability": np.array([p, 0.0])}):
    ...         print(event.sensor, round(event.start, 1), round(event.end, 1), event.probability, ended)
    left 0.1 0.1 0.95 False
    left 0.1 0.2 0.99 True
    """

    signals: ClassVar[tuple[str, ...]] = ("fault_probability", "mode_probability", "fault_size", "fault_onset")
    """Names of the signals of `feed`; all but the first may be missing."""

    def __init__(
        self,
        sensors: Sequence[str],
        modes: Sequence[FaultMode | ActuatorMode],
        step: Fraction,
        alarm: Alarm | None = None,
    ):
        self._names, self._modes = tuple(sensors), tuple(modes)
        self._alarm = alarm or Alarm()
        self._faulty = [k for k, mode in enumerate(modes, start=1) if getattr(mode, "is_fault", True)]
        self._hold = round(time_at(self._alarm.hold, float(step)) / float(step))
        self._open: dict[int, Any] = {}
        self._ended: dict[int, float] = {}
        self._below = np.zeros(len(self._names), dtype=np.int64)

    def feed(self, time: float, signals: Mapping[str, Floats]) -> Iterator[tuple[Any, bool]]:
        """Give the alarms that begin or end at a step, and whether they have ended.

        Parameters
        ----------
        time : float
            Time of the step in seconds.
        signals : mapping of str to ndarray
            The outputs of the estimator or controller at this step: those of `signals`.
        """
        above = signals[self.signals[0]] >= self._alarm.threshold
        if not (above.any() or self._open):
            return
        for i in map(int, np.flatnonzero(above)):
            begun = self._open.get(i)
            self._open[i] = self._event(i, time, signals, begun)
            self._below[i] = 0
            if begun is None:
                yield self._open[i], False
        for i in [i for i in self._open if not above[i]]:
            self._below[i] += 1
            if self._below[i] > self._hold:
                ended = self._open.pop(i)
                self._ended[i] = ended.end
                yield ended, True

    def close(self) -> Iterator[Any]:
        """Give the alarms that have not ended, with the last step above the threshold as their end."""
        yield from self._open.values()
        self._open.clear()

    def _event(self, i: int, time: float, signals: Mapping[str, Floats], begun: Any) -> FaultEvent | ActuatorEvent:
        probability, of_modes, *rest = (signals.get(name) for name in self.signals)
        assert probability is not None
        p = float(probability[i])
        span = (time, time, p) if begun is None else (begun.start, time, max(p, begun.probability))
        if not self._modes or of_modes is None:
            return self._made(i, span, None, ())
        modes = of_modes.reshape(len(self._names), -1)[i]
        kind = self._faulty[int(modes[self._faulty].argmax())]
        numbers = [None if values is None or not np.isfinite(values[i]) else float(values[i]) for values in rest]
        if modes.argmax() != kind and begun is not None:  # size and onset belong to another mode
            numbers = [begun.size, getattr(begun, "onset", None)][: len(numbers)]
        return self._made(i, span, type(self._modes[kind - 1]).__name__, numbers)

    def _made(
        self, i: int, span: tuple[float, float, float], kind: str | None, numbers: Sequence[float | None]
    ) -> FaultEvent | ActuatorEvent:
        size, onset = numbers or (None, None)
        return FaultEvent(
            self._names[i], *span, kind=kind, onset=onset_of_alarm(onset, span[0], self._ended.get(i)), size=size
        )


class ActuatorWatch(AlarmWatch):
    """Watches the fault probabilities of actuators step by step; see `AlarmWatch`.

    Parameters
    ----------
    sensors : sequence of str
        Names of the actuators.
    modes : sequence of ActuatorMode
        The learner's modes.
    step : Fraction
        Sample time in seconds.
    alarm : Alarm, optional
        When an event begins and ends. As for `AlarmWatch`.

    Examples
    --------
    >>> import numpy as np
    >>> from fractions import Fraction
    >>> from bayesftc import controllers, monitoring
    >>> watch = monitoring.ActuatorWatch(["pump"], [controllers.LostEffect()], Fraction(1, 10))
    >>> names = ("actuator_fault_probability", "actuator_mode_probability", "actuator_fault_size")
    >>> signals = dict(zip(names, map(np.array, ([0.95], [[0.05, 0.95]], [0.3])), strict=True))
    >>> next(watch.feed(2.0, signals))
    (ActuatorEvent(actuator='pump', start=2 s, end=2 s, probability=0.95, kind='LostEffect', size=0.3), False)
    """

    signals = tuple(f"actuator_{name}" for name in ACTUATOR_SIGNALS)

    def _made(
        self, i: int, span: tuple[float, float, float], kind: str | None, numbers: Sequence[float | None]
    ) -> FaultEvent | ActuatorEvent:
        return ActuatorEvent(self._names[i], *span, kind=kind or "", size=numbers[0] if numbers else None)
