"""Alarms while samples arrive: each is known at its start, and complete at its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

import numpy as np

from bayesftc.controllers.switching.default_time import time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import Alarm, FaultEvent


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

    def __init__(self, sensors: Sequence[str], modes: Sequence[FaultMode], step: Fraction, alarm: Alarm | None = None):
        self._alarm = alarm or Alarm()
        self._sensors, self._modes = tuple(sensors), tuple(modes)
        self._faulty = [k for k, mode in enumerate(modes, start=1) if mode.is_fault]
        self._hold = round(time_at(self._alarm.hold, float(step)) / float(step))
        self._open: dict[int, FaultEvent] = {}
        self._below = np.zeros(len(self._sensors), dtype=np.int64)

    def feed(self, time: float, signals: Mapping[str, Floats]) -> Iterator[tuple[FaultEvent, bool]]:
        """Give the alarms that begin or end at a step, and whether they have ended.

        Parameters
        ----------
        time : float
            Time of the step in seconds.
        signals : mapping of str to ndarray
            The outputs of the estimator or controller at this step: ``fault_probability`` and, with modes,
            ``mode_probability``, ``fault_size`` and ``fault_onset``.
        """
        probability = signals["fault_probability"]
        above = probability >= self._alarm.threshold
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
                yield self._open.pop(i), True

    def close(self) -> Iterator[FaultEvent]:
        """Give the alarms that have not ended, with the last step above the threshold as their end."""
        yield from self._open.values()
        self._open.clear()

    def _event(self, i: int, time: float, signals: Mapping[str, Floats], begun: FaultEvent | None) -> FaultEvent:
        p = float(signals["fault_probability"][i])
        start, largest = (time, p) if begun is None else (begun.start, max(p, begun.probability))
        name = self._sensors[i]
        if not self._modes or "mode_probability" not in signals:
            return FaultEvent(name, start, time, largest)
        modes = signals["mode_probability"].reshape(len(self._sensors), -1)[i]
        kind = self._faulty[int(modes[self._faulty].argmax())]
        size, onset = float(signals["fault_size"][i]), float(signals["fault_onset"][i])
        if modes.argmax() != kind and begun is not None:  # size and onset belong to another mode
            size = np.nan if begun.size is None else begun.size
            onset = np.nan if begun.onset is None else begun.onset
        return FaultEvent(
            name,
            start,
            time,
            largest,
            kind=type(self._modes[kind - 1]).__name__,
            onset=min(onset, start) if np.isfinite(onset) else None,
            size=size if np.isfinite(size) else None,
        )
