"""The interval at which a sensor sends samples, from their times: some are missing, and time stamps jitter."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

NEAR = 2.5
"""Multiple of the median up to which an interval is one or two typical ones: a longer one may be a pause."""

OFF = 0.25
"""Share of the interval by which a regular sample may be away from its time."""

IRREGULAR = 0.1
"""Share of intervals that are off by more, from which on none counts as several."""

LONG = 100
"""Number of intervals up to which their number in a pause is certain: the typical one is then known to a thousandth."""


def usual_intervals(time: Floats) -> tuple[Floats, Floats]:
    """Return the usual intervals between samples, and how many typical ones each is: several, over missing samples.

    Pauses that are no multiple of the typical interval are left out. If time stamps jitter much, each interval counts as one.

    Parameters
    ----------
    time : ndarray
        Two or more times, increasing.
    """
    intervals = np.diff(time)
    median = float(np.median(intervals))
    near = intervals < NEAR * median
    counts: Floats = np.maximum(np.rint(intervals[near] / median), 1.0)
    if np.mean(np.abs(intervals[near] - counts * median) > OFF * median) > IRREGULAR:
        return intervals[near], np.ones_like(counts)
    typical = float(intervals[near].sum() / counts.sum())
    # Jitter cancels in the sum of intervals that follow each other: each one that is left out adds its own.
    counts = np.maximum(np.rint(intervals / typical), 1.0)
    kept = near | ((np.abs(intervals - counts * typical) <= OFF * typical) & (counts <= LONG))
    return intervals[kept], counts[kept]


def typical_interval(time: Floats) -> float:
    """Return the time from one sample to the next if none is missing, in seconds; infinite for a single sample."""
    if len(time) < 2:
        return float("inf")
    intervals, counts = usual_intervals(time)
    return float(intervals.sum() / counts.sum())


__all__ = ["typical_interval", "usual_intervals"]
