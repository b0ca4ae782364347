"""Gaps of a recording: no sensor has a sample, because the logger stood still, and none of them has dropped out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

LEAST = 3
"""Least number of samples in a row that all sensors miss: the learner infers a dropout from about as many."""

SETTLES = 3
"""Samples of a sensor after a gap in which the learner may still believe in a dropout."""

USUAL = 9
"""Number of intervals between a sensor's samples whose median is its usual one, while samples arrive."""

CHANCE = 0.01
"""Largest number of gaps in a recording to be expected of samples that are lost one by one."""

Indices = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True)
class Gap:
    """A stretch of a recording in which no sensor has a sample.

    Attributes
    ----------
    start, end : float
        Times of the last sample before it and of the first one after it, in seconds of the recording.
    samples : int
        Number of samples that every sensor misses, by the interval of the slowest one.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> t = np.concatenate([0.1 * np.arange(50), 8.0 + 0.1 * np.arange(50)])
    >>> recording = monitoring.align({name: monitoring.Signal(t, np.sin(t)) for name in "ab"}, {}, dt=0.1)
    >>> recording.gaps
    (Gap(start=4.9 s, end=8 s, samples=30),)
    """

    start: float
    end: float
    samples: int

    def __repr__(self) -> str:
        return short(self, start="s", end="s")


def find_gaps(y: Floats) -> list[tuple[int, int, int]]:
    """Return the last step before each gap, the first one after it, and the number of missed samples.

    Two or more sensors must fall silent at once: the silence of one is its dropout, also while another has failed already.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples; NaN where there is none.
    """
    own = [steps for steps in map(np.flatnonzero, np.isfinite(y).T) if len(steps)]
    sampled = np.flatnonzero(np.isfinite(y).any(axis=1))
    if len(own) < 2 or len(sampled) < 2:
        return []
    usual = list(map(_interval, own))
    missed = np.rint(np.diff(sampled) / max(usual)).astype(int) - 1
    share = float(np.mean(missed > 0))  # of samples after which the next one is missing
    gaps = []
    for k in np.flatnonzero(missed >= LEAST):
        before, count = int(sampled[k]), int(missed[k])
        last = [steps[max(int(np.searchsorted(steps, before, side="right")) - 1, 0)] for steps in own]
        silent = sum(abs(step - before) <= LEAST * interval for step, interval in zip(last, usual, strict=True))
        if silent > 1 and len(sampled) * share**count < CHANCE:
            gaps.append((before, int(sampled[k + 1]), count))
    return gaps


def in_gaps(y: Floats) -> Flags:
    """Return the steps of all gaps for each sensor, and those of missing samples soon after them.

    A learner without `outages` takes the next missing sample after a gap for a dropout that goes on.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples; NaN where there is none.

    Returns
    -------
    ndarray, steps x sensors
        Whether a gap explains that the sensor has no sample.
    """
    missing = ~np.isfinite(y)
    inside: Flags = np.zeros(y.shape, dtype=bool)
    gaps = find_gaps(y)
    for before, after, _ in gaps:
        inside[before + 1 : after] = True
    for i, column in enumerate(missing.T if gaps else ()):
        steps = np.flatnonzero(~column)
        patience = round((LEAST + SETTLES) * _interval(steps))
        for _, after, _ in gaps:
            first = int(np.searchsorted(steps, after))
            soon = slice(after, min([after + patience, *map(int, steps[first + SETTLES - 1 : first + SETTLES])]))
            inside[soon, i] = column[soon]
    return inside


class GapWatch:
    """Holds signals in a gap while samples arrive, as `in_gaps` does in a recording.

    A gap is known when two sensors or more, whose usual interval has been seen, have missed some samples and no other sends. The
    signals then go back to their values at the last sample. Unlike a recording, a stream does not show how many samples are lost
    one by one: some of them in a row are a gap here.

    Parameters
    ----------
    sensors : int
        Number of sensors.

    Attributes
    ----------
    since : int or None
        Number of the last step before the gap, during a gap.
    """

    def __init__(self, sensors: int):
        self.since: int | None = None
        self._k, self._last, self._before = -1, np.full(sensors, -1), -1
        self._intervals: list[deque[int]] = [deque(maxlen=USUAL) for _ in range(sensors)]
        self._until = np.full(sensors, -1)
        self._count = np.full(sensors, SETTLES)
        self._kept: dict[str, Floats] = {}

    def feed(self, y: Floats, signals: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return the signals of a step.

        Parameters
        ----------
        y : ndarray, sensors
            Samples.
        signals : mapping of str to ndarray
            By name, with one row per sensor.
        """
        self._k += 1
        there = np.isfinite(y)
        usual = np.array([np.median(each) if each else np.nan for each in self._intervals])
        if there.any() and self.since is not None:
            self.since, self._count = None, np.zeros_like(self._count)
            self._until = self._k + np.rint(np.nan_to_num((LEAST + SETTLES) * usual)).astype(int)
        elif not there.any() and self._kept and self.since is None:
            silent = self._before - self._last <= LEAST * usual
            if silent.sum() > 1 and self._k - self._before >= LEAST * usual[silent].max():
                self.since = self._before
        soon = (self._k < self._until) & (self._count < SETTLES)
        held = np.full(len(y), True) if self.since is not None else ~there & soon
        self._count += there
        for i in map(int, np.flatnonzero(there)):
            if self._last[i] >= 0:
                self._intervals[i].append(self._k - int(self._last[i]))
            self._last[i] = self._k
        given = {name: values.copy() for name, values in signals.items()}
        for name, values in given.items():
            if held.any():
                values[held] = self._kept[name][held]
        if there.any():
            self._before, self._kept = self._k, given
        return given


def _interval(steps: Indices) -> float:
    """Return the usual number of steps between two samples."""
    return float(np.median(np.diff(steps))) if len(steps) > 1 else 1.0
