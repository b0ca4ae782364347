"""Gaps of a recording: no sensor has a sample, because the logger stood still, and none of them has dropped out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

LEAST = 3
"""Least number of samples in a row that all sensors miss: the learner infers a dropout from about as many."""

CHANCE = 0.01
"""Largest number of gaps in a recording to be expected of samples that are lost one by one."""


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
    there = np.isfinite(y)
    steps = [np.flatnonzero(column) for column in there.T if column.any()]
    usual = [float(np.median(np.diff(own))) if len(own) > 1 else 1.0 for own in steps]
    sampled = np.flatnonzero(there.any(axis=1))
    if len(steps) < 2 or len(sampled) < 2:
        return []
    missed = np.rint(np.diff(sampled) / max(usual)).astype(int) - 1
    share = float(np.mean(missed > 0))  # of samples after which the next one is missing
    gaps = []
    for k in np.flatnonzero(missed >= LEAST):
        before, count = int(sampled[k]), int(missed[k])
        silent = sum(bool(np.any(np.abs(own - before) <= LEAST * each)) for own, each in zip(steps, usual, strict=True))
        if silent > 1 and len(sampled) * share**count < CHANCE:
            gaps.append((before, int(sampled[k + 1]), count))
    return gaps


def in_gaps(y: Floats) -> Flags:
    """Return the steps of all gaps."""
    inside = np.zeros(len(y), dtype=bool)
    for before, after, _ in find_gaps(y):
        inside[before + 1 : after] = True
    return inside
