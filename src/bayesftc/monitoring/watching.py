"""Alarms while samples arrive: each is known at its start, and complete at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.default_time import time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.judging.findings import OFFSETS, SURE_ONSET, onset_of_alarm
from bayesftc.cosim.judging.parts import plain_kinds, sections
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import (
    ACTUATOR_SIGNALS,
    ActuatorEvent,
    Alarm,
    FaultEvent,
    fault_chances,
    name_of_kind,
)

MOST_STRETCHES = 1000
"""Most stretches with one likeliest kind of fault that are kept of an alarm; of more, neighbours become one."""


class AlarmWatch:
    """Watches fault probabilities step by step.

    An alarm begins at the first step with a probability of at least the threshold. It has ended when the probability has been
    below for longer than `Alarm.hold`; its end is the last step above, as in a recording. If its kind changed for good, it ends
    as several events, its parts. If the kind is another after a shorter pause below the threshold than before it, there are two
    alarms. The second one is known only when both have ended.

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
        self._offsets = {k for k, mode in enumerate(modes) if type(mode).__name__ in OFFSETS}
        self._plain = plain_kinds([type(mode).__name__ for mode in modes])
        self._alarm = alarm or Alarm()
        self._step = float(step)
        self._hold = round(time_at(self._alarm.hold, self._step) / self._step)
        self._open: dict[int, _Open] = {}
        self._ended: dict[int, float] = {}

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
        for i in sorted({*map(int, np.flatnonzero(above)), *self._open}):
            begins = i not in self._open
            alarm = self._open.setdefault(i, _Open())
            alarm.add(self._stretch(i, time, signals, bool(above[i])))
            if begins:
                yield next(self._events(i, alarm)), False
            if alarm.below > self._hold:
                yield from self._end(i)

    def close(self) -> Iterator[Any]:
        """Give the alarms that have not ended, with the last step above the threshold as their end."""
        for i in list(self._open):
            for event, _ in self._end(i):
                yield event

    def _end(self, i: int) -> Iterator[tuple[Any, bool]]:
        events = list(self._events(i, self._open.pop(i)))
        self._ended[i] = events[-1].end
        for event in events:
            yield event, True

    def _stretch(self, i: int, time: float, signals: Mapping[str, Floats], above: bool) -> _Stretch:
        """Return a stretch of one step of a sensor or an actuator."""
        probability, of_modes, *rest = (signals.get(name) for name in self.signals)
        assert probability is not None
        p = float(probability[i])
        if not self._modes or of_modes is None:
            return _Stretch(time, time, 1, p, np.zeros(1), pause=not above)
        modes = of_modes.reshape(len(self._names), -1)[i]
        chances = fault_chances(modes, self._modes)
        # Size and onset belong to the most probable mode of all, which can be another one.
        is_most = modes.argmax() == 1 + chances.argmax()
        numbers = [None if values is None or not np.isfinite(values[i]) else float(values[i]) for values in rest]
        return _Stretch(
            time, time, 1, p, chances, tuple(numbers) if is_most else (), not above, numbers[-1] if is_most else None
        )

    def _events(self, i: int, alarm: _Open) -> Iterator[FaultEvent | ActuatorEvent]:
        """Give the parts of an alarm."""
        listed = alarm.stretches
        samples = sum(each.samples for each in listed)
        sums, pauses = np.array([each.sums for each in listed]), [each.pause for each in listed]
        before = 0
        for a, b, k in sections(sums, pauses, samples, self._step, self._plain):
            if a > before:  # a pause ended an alarm
                self._ended[i] = listed[before - 1].end
            part, continued, before = listed[a:b], 0 < a == before, b
            span = part[0].start, part[-1].end, max(each.probability for each in part)
            kind = name_of_kind(self._modes, k + 1) if any(each.sums[k] for each in part) else ""
            of_kind = [each for each in part if each.numbers and each.kind == k]
            numbers = of_kind[-1].numbers if of_kind else (None,) * (len(self.signals) - 2)
            if kind in SURE_ONSET and of_kind:
                numbers = numbers[0], of_kind[0].onset
            same = self._offsets if k in self._offsets else {k}
            sizes = [each.numbers[0] for each in part if each.numbers and each.kind in same]
            numbers = next((size for size in reversed(sizes) if size is not None), None), *numbers[1:]
            yield self._made(i, span, kind, numbers, continued)

    def _made(
        self, i: int, span: tuple[float, float, float], kind: str, numbers: Sequence[float | None], continued: bool
    ) -> FaultEvent | ActuatorEvent:
        size, onset = numbers
        onset = onset_of_alarm(onset, span[0], self._ended.get(i))
        return FaultEvent(self._names[i], *span, kind=kind or None, onset=onset, size=size, continued=continued)


@dataclass(frozen=True)
class _Stretch:
    """Steps of an alarm with one likeliest kind of fault: times, number of samples, largest fault probability.

    ``sums`` has for each kind the sum of its probability, ``numbers`` the last size and onset of the likeliest kind, and
    ``pause`` says whether the fault probability is below the threshold. ``onset`` is the first one of the likeliest kind.
    """

    start: float
    end: float
    samples: int
    probability: float
    sums: Floats
    numbers: tuple[float | None, ...] = ()
    pause: bool = False
    onset: float | None = None

    @property
    def kind(self) -> int:
        """The index of the likeliest kind."""
        return int(self.sums.argmax())

    def __add__(self, later: _Stretch) -> _Stretch:
        """Return both as one stretch."""
        sums = self.sums + later.sums
        of_kind = [each for each in (self, later) if each.numbers and each.kind == sums.argmax()]
        return _Stretch(
            self.start,
            later.end,
            self.samples + later.samples,
            max(self.probability, later.probability),
            sums,
            of_kind[-1].numbers if of_kind else (),
            self.pause and later.pause,
            of_kind[0].onset if of_kind else None,
        )


class _Open:
    """An alarm that has not ended: its stretches up to the last step above the threshold, and the number of steps since."""

    def __init__(self) -> None:
        self.stretches: list[_Stretch] = []
        self.below = 0
        self._since: list[_Stretch] = []

    def add(self, step: _Stretch) -> None:
        """Add a step."""
        self._since.append(step)
        self.below = self.below + 1 if step.pause else 0
        if step.pause:
            return
        for each in self._since:
            last = self.stretches[-1] if self.stretches else None
            if last is not None and (last.kind, last.pause) == (each.kind, each.pause):
                self.stretches[-1] += each
            else:
                self.stretches.append(each)
        self._since.clear()
        if len(self.stretches) > MOST_STRETCHES:  # an alarm can last for months
            self._make_fewer()

    def _make_fewer(self) -> None:
        """Make one stretch of short neighbours, so that there are at most half as many as allowed."""
        least = 2 * sum(each.samples for each in self.stretches) / MOST_STRETCHES
        listed, self.stretches = self.stretches, []
        for each in listed:
            if self.stretches and self.stretches[-1].samples < least:
                self.stretches[-1] += each
            else:
                self.stretches.append(each)


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
        self, i: int, span: tuple[float, float, float], kind: str, numbers: Sequence[float | None], continued: bool
    ) -> FaultEvent | ActuatorEvent:
        return ActuatorEvent(self._names[i], *span, kind=kind, size=numbers[0], continued=continued)
