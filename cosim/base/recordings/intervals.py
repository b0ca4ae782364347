"""The interval at which a sensor sends samples, from their times: some are missing, and time stamps jitter."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from bayesftc.cosim.types import Floats

FIRST = 64
"""Number of samples in which the interval is first sought: it is then known to a hundredth, and holds for twice as many."""

SOUGHT = 0.1
"""Relative distance from the median in which it is sought: lost samples and jitter move the median by less."""

CLOCK = 0.45
"""Resultant length (1: no jitter) from which on times are those of a clock: a jitter of 0.3 of its interval has 0.5."""

NEAR = 2.5
"""Multiple of the median up to which an interval is one or two typical ones: a longer one may be a pause."""

PAUSE = 10
"""Number of intervals of a clock up to which samples are lost one by one: after a longer pause it may have been set anew."""

UNCLEAR = 0.4
"""Share of the interval from which on it is hardly visible how many intervals one is."""

IRREGULAR = 0.05
"""Share of unclear intervals from which on none counts as several; of intervals of any length a fifth is unclear."""

OFF = 0.25
"""Share of the interval by which the end of a pause may be away from the time of a regular sample."""

LONG = 100
"""Number of intervals up to which their number in a pause is certain: the typical one is then known to a thousandth."""

COLLIDE = 0.1
"""Share of samples that may belong to the step of a later one: jittering times need short steps."""

SHORT = 1e-4
"""Relative error of a step with few digits: one step in 10,000."""

LOST = 1e-3
"""Share of samples that a step with few digits may lose, beside those of a longer one."""


def typical_interval(time: Floats) -> float:
    """Return the time from one sample to the next if none is missing, in seconds; infinite for a single sample."""
    return _interval(time)[0]


def usual_step(time: Floats) -> Fraction:
    """Return the typical interval of two or more samples, or a part of it if their times jitter, as a short number."""
    interval, error = _interval(time)
    parts = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
    part = next((part for part in parts if _lost(time, part * interval) <= COLLIDE), parts[-1])
    value, within = part * interval, max(SHORT * part * interval, error)
    every = [Fraction(f"{value:.{digits}e}") for digits in range(10)]
    numbers = [number for number in every if abs(float(number) - value) < within] or every[-1:]
    if part < 1.0:
        return numbers[0]
    lost = [_lost(time, float(number)) for number in numbers]
    return next(n for n, share in zip(numbers, lost, strict=True) if share <= min(lost) + LOST)


def first_step(time: Floats, start: float, step: float) -> float:
    """Return the time of the first step: `start`, or half a step from it at most if fewer samples are lost to jitter then."""
    shifted = start + _turn(time - start, step) * step
    return shifted if _collisions(time, shifted, step) < _collisions(time, start, step) else start


def _lost(time: Floats, step: float) -> float:
    """Return the share of samples that belong to the same step as a later one."""
    return _collisions(time, first_step(time, float(time[0]), step), step)


def _collisions(time: Floats, start: float, step: float) -> float:
    return float(np.mean(np.diff(np.rint((time - start) / step)) == 0))


def _turn(time: Floats, interval: float) -> float:
    """Return where in the interval, from -0.5 to 0.5 of it, times are on average."""
    return float(np.angle(np.mean(np.exp(2j * np.pi * time / interval)))) / (2.0 * np.pi)


def _interval(time: Floats) -> tuple[float, float]:
    """Return the typical interval, and its error; an interval over missing samples counts as several.

    Pauses that are no multiple of the typical interval are left out. If intervals are too irregular, it is their mean, or of few
    samples their median.
    """
    if len(time) < 2:
        return float("inf"), 0.0
    intervals = np.diff(time)
    median = float(np.median(intervals))
    clock = _numbers_of_clock(time - time[0], median)
    if clock is None:
        near, counts = intervals < NEAR * median, _counts(intervals, median)
        if np.mean(np.abs(intervals - counts * median)[near] > UNCLEAR * median) > IRREGULAR:
            return float(intervals[near].mean() if len(time) >= FIRST else median), 0.0
    else:
        counts = np.diff(clock)
        near = counts <= PAUSE
    typical = float(intervals[near].sum() / counts[near].sum())
    if clock is None:
        counts = _counts(intervals, typical)
    # Jitter cancels in the sum of intervals that follow each other: each one that is left out adds its own.
    kept = near | ((np.abs(intervals - counts * typical) <= OFF * typical) & (counts <= LONG))
    intervals, counts = intervals[kept], counts[kept]
    typical = float(intervals.sum() / counts.sum())
    off = np.abs(intervals - counts * typical)
    # Errors of a clock's time stamps do not add up; those of intervals do.
    return typical, float((np.linalg.norm(off) if clock is None else off.max()) / counts.sum())


def _counts(intervals: Floats, typical: float) -> Floats:
    """Return how many typical intervals each one is."""
    return np.maximum(np.rint(intervals / typical), 1.0)


def _numbers_of_clock(time: Floats, median: float) -> Floats | None:
    """Return the numbers of samples, counting missing ones, if the times, from 0 on, are those of a clock; else None.

    The interval is sought in the first samples. A straight line through their times then gives the numbers of as many others.
    """
    if len(time) < FIRST:
        return None
    tried = median * np.linspace(1.0 - SOUGHT, 1.0 + SOUGHT, 2 * FIRST + 1)
    interval = float(tried[np.argmax(np.abs(np.exp(2j * np.pi * time[:FIRST] / tried[:, None]).mean(axis=1)))])
    samples = FIRST
    while True:
        part = time[:samples]
        numbers: Floats = np.rint(part / interval - _turn(part, interval))
        interval = float(np.polyfit(numbers, part, 1)[0])
        if samples >= len(time):
            break
        samples *= 2
    return numbers if np.abs(np.mean(np.exp(2j * np.pi * time / interval))) >= CLOCK else None


__all__ = ["first_step", "typical_interval", "usual_step"]
