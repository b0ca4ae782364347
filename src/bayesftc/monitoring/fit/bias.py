"""Slow differences between redundant sensors: constant biases, wandering biases, and a change that lasts to the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import theilslopes

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.settings import FIT


def biases(y: Floats) -> Floats:
    """Return the constant difference of each sensor from the typical one; their median is 0.

    It is the median of a sensor's differences from all sensors, each over the steps at which both have a sample: which sensors
    are there at a step does not matter. A difference is the median of its medians in many parts of the recording. These scatter
    less than the samples, so that a fault in a few parts moves their median hardly at all.
    """
    parts = _parts(y)
    apart = np.array([median(median(parts[:, :, [i]] - parts, 1), 0) for i in range(y.shape[1])])
    bias = median(apart, 1)
    return np.asarray(bias - np.median(bias))


def _parts(y: Floats) -> Floats:
    """Return many parts of a recording (parts x steps x sensors), all of one length; without its last steps if they are left."""
    length = min(max(len(y) // FIT.blocks, FIT.least_block), len(y))
    return y[: len(y) // length * length].reshape(-1, length, y.shape[1])


def wander(y: Floats, quantile: float) -> tuple[Floats, Floats]:
    """Return the variance of each sensor's wandering bias, 0 if there is none, and its time constant in steps.

    The difference of two sensors has a median in each of many parts of the recording. Each of the two sensors gets half of the
    variance of these medians. A sensor's result is the median over its pairs (the lower one of two), as another sensor may fail.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples without the constant biases.
    quantile : float
        Quantile of the medians' distances: the larger, the more weight has a rare fault or a rare wandering.
    """
    sensors, pairs = y.shape[1], list(combinations(range(y.shape[1]), 2))
    apart = _parts(np.column_stack([y[:, i] - y[:, j] for i, j in pairs]))
    length = apart.shape[1]
    levels = median(apart, 1)
    samples = np.maximum(np.isfinite(apart).sum(axis=1), 1)
    noise = (MAD * median(np.abs(apart - levels[:, None, :]), 1)) ** 2 * (np.pi / 2) / samples
    of_noise = median(noise, 0)
    finite = np.isfinite(levels).any(axis=0)
    far = np.zeros(len(pairs))
    far[finite] = np.nanquantile(np.abs(levels - median(levels, 0))[:, finite], quantile, axis=0)
    total = np.asarray(far / ndtri((1 + quantile) / 2)) ** 2
    steps = (MAD * median(np.abs(np.diff(levels, axis=0)), 0)) ** 2
    variance = np.nan_to_num(np.where(total > FIT.certain * of_noise, total - of_noise, 0.0))
    correlation = 1.0 - (steps / 2 - of_noise) / np.where(variance > 0, variance, np.inf)  # from part to part
    lasting = length / -np.log(np.clip(np.where(variance > 0, correlation, 0.0), 0.3, 0.95))
    of = [[k for k, pair in enumerate(pairs) if i in pair] for i in range(sensors)]
    lower = [float(np.quantile(variance[k], 0.5, method="lower")) / 2 for k in of]
    return np.array(lower), np.array([np.median(lasting[k]) for k in of])


def gains(y: Floats, noise: Sequence[float]) -> dict[int, float]:
    """Return the sensor whose difference from the others is proportional to the quantity, and by which share.

    It is the median slope between all parts of a recording, so that a fault in a few of them has no effect. Of two sensors, it is
    that of the second one against the first.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    noise : sequence of float
        Standard deviation of each sensor's noise: a gain matters if it adds a part of it.
    """
    found = {}
    length = max(len(y) // FIT.parts, FIT.least_block)
    parts = y[: len(y) // length * length].reshape(-1, length, y.shape[1])
    for i in range(y.shape[1]):
        others = median(np.delete(parts, i, axis=2), 2)
        apart, level = median(parts[:, :, i] - others, 1), median(others, 1)
        there = np.isfinite(apart) & np.isfinite(level)
        apart, level = apart[there], level[there]
        if len(level) < 2 * FIT.fewest_windows or not np.ptp(level) > 0:
            continue
        with np.errstate(invalid="ignore"):  # of a parked car all parts are equal: then the limits are NaN
            slope, _, low, high = theilslopes(apart, level, alpha=FIT.gain_sure)
        size = abs(slope) * MAD * float(np.median(np.abs(level - np.median(level))))
        if low * high > 0 and size > FIT.gain_counts * noise[i] and abs(slope) < np.log(FIT.another_factor):
            found[i] = float(slope)
    if y.shape[1] == 2:
        return {1: found[1]} if len(found) == 2 else {}
    largest = sorted(found, key=lambda i: -abs(found[i]))[:2]
    # The gain of one sensor is half of it, and negative, of the others against their mean.
    alone = len(largest) == 1 or (
        len(largest) == 2 and abs(found[largest[1]]) < FIT.gain_alone * abs(found[largest[0]])
    )
    return {largest[0]: found[largest[0]]} if alone else {}


def steady_gains(y: Floats, noise: Sequence[float]) -> dict[int, float]:
    """Return what `gains` finds, if each half of the recording has it as well: a fault can look like a gain in one of them."""
    halves = [gains(half, noise) for half in (y[: len(y) // 2], y[len(y) // 2 :])]
    return {
        i: slope
        for i, slope in gains(y, noise).items()
        if all(abs(half.get(i, 0.0) / slope - 1) < FIT.gain_agrees for half in halves)
    }


class Change(NamedTuple):
    """A change of a sensor against the others that lasts to the end of a recording."""

    size: float
    """Difference at the end from that at the beginning, in the unit of the sensor."""
    begin: int
    """The step at which it begins."""
    sudden: bool
    """Whether it is a step, or stays after it has grown; if not, it grows to the end."""
    reached: int | None = None
    """The step from which a change that stays has its size, if it has grown to it; None of a step."""


class _Course(NamedTuple):
    """The best change in the difference of two sensors, and how much of the difference's motion it explains."""

    change: Change
    explained: float


def changes(y: Floats, noise: Sequence[float]) -> dict[int, Change]:
    """Return the sensors that have moved away from the others, by a step or steadily, and not returned.

    The difference of two sensors has a median in each of many parts of the recording. An error that wanders about a mean is
    explained by a single change only to a small part. A sensor has moved if this explains its differences from most others, while
    those others agree with each other. Two sensors do not show which of them has moved.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    noise : sequence of float
        Standard deviation of each sensor's noise: less than a few of it are no change.
    """
    sensors = y.shape[1]
    courses = {pair: _course(y[:, pair[0]] - y[:, pair[1]]) for pair in combinations(range(sensors), 2)}
    apart = {pair: course for pair, course in courses.items() if course and course.explained > FIT.explained}
    count = [sum(i in pair for pair in apart) for i in range(sensors)]
    moved = [i for i in range(sensors) if count[i] == max(count) and count[i] > (sensors - 1) / 2]
    rest = set(range(sensors)) - set(moved)
    if len(rest) < 2 or any(rest.issuperset(pair) for pair in apart):
        return {}
    found = {}
    for i in moved:
        # Another moved sensor does not tell the size.
        of_rest = [pair for pair in apart if i in pair and rest.intersection(pair)]
        if not of_rest:
            continue
        pair = max(of_rest, key=lambda pair: apart[pair].explained)
        change = apart[pair].change
        change = change._replace(size=change.size * (1 if pair[0] == i else -1))
        if apart[pair].explained > FIT.clearly and abs(change.size) > FIT.outstanding * noise[i]:
            found[i] = change
    return found


def parting(y: Floats, noise: Sequence[float]) -> Change | None:
    """Return how two sensors have moved apart and not returned, as the change of the first; None if they have not.

    Which of them has moved is not known. See `changes`.
    """
    course = _course(y[:, 0] - y[:, 1]) if y.shape[1] == 2 else None
    if course is None or course.explained <= FIT.clearly or abs(course.change.size) <= FIT.outstanding * max(noise):
        return None
    return course.change


def unmoved(y: Floats, changes: Mapping[int, Change], stretch: slice) -> Floats:
    """Return the samples without those of each moved sensor since its change, or before a step if the stretch is after it.

    If too few samples of the stretch would remain, they stay.
    """
    kept = y.copy()
    for i, change in changes.items():
        after = change.sudden and stretch.indices(len(y))[0] >= change.begin
        column = kept[:, i].copy()
        column[slice(0, change.begin) if after else slice(change.begin, None)] = np.nan
        if np.isfinite(column[stretch]).sum() >= FIT.least_before * FIT.least_block:
            kept[:, i] = column
    return kept


def _course(apart: Floats) -> _Course | None:
    """Return the best change in a difference of two sensors; None with too few samples."""
    length = max(len(apart) // FIT.parts, FIT.least_block)
    levels = median(apart[: len(apart) // length * length].reshape(-1, length), 1)
    there = np.flatnonzero(np.isfinite(levels))
    levels = levels[there]
    if len(levels) < 2 * FIT.fewest_windows:
        return None
    best = _Course(Change(0.0, 0, sudden=True), 0.0)
    for k in range(FIT.least_before, int(FIT.rare * len(levels)) + 1):
        before, after = float(np.median(levels[:k])), levels[k:]
        since = np.arange(len(after)) + 0.5
        step, slope = float(np.median(after)) - before, float(np.median((after - before) / since))
        for size, shape, sudden in ((step, step, True), (slope * len(after), slope * since, False)):
            left = np.abs(np.append(levels[:k] - before, after - before - shape))
            kept = ~_passing(left, FIT.outstanding * abs(size))
            total = float(np.abs(levels - np.median(levels))[kept].sum())
            explained = 1 - float(left[kept].sum()) / total if total > 0 else 0.0
            if explained > best.explained:
                best = _Course(Change(size, int(there[k]) * length, sudden), explained)
    return _with_growth(best, levels, there * length)


def _passing(left: Floats, large: float) -> NDArray[np.bool_]:
    """Return the parts in which a difference is far away for a while, by another fault that has ended; none if these are many."""
    far = left > large
    few, ended = far.mean() < 1 - FIT.rare, not far[-FIT.least_before :].any()
    return far if few and ended else np.zeros_like(far)


def _with_growth(best: _Course, levels: Floats, steps: NDArray[np.intp]) -> _Course:
    """Return a sudden change with its beginning and its end, if it has grown: the best step lies in the middle of it."""
    if not best.change.sudden or not best.explained:
        return best
    k = int(np.searchsorted(steps, best.change.begin))
    before, after = levels[:k], levels[k:]
    first, last = k, k
    from_before = np.abs(levels - np.median(before)) > FIT.within * _scatter(before)
    from_after = np.abs(levels - np.median(after)) > FIT.within * _scatter(after)
    while first > FIT.least_before and from_before[first - 1]:
        first -= 1
    while last < len(levels) - FIT.least_before and from_after[last]:
        last += 1
    if last - first < FIT.grown:
        return best
    first = max(first - 1, 0)  # it has begun in this part perhaps, within the noise
    return best._replace(change=best.change._replace(begin=int(steps[first]), reached=int(steps[last])))


def _scatter(levels: Floats) -> float:
    """Return the standard deviation of levels about their median, by the median distance."""
    return MAD * float(np.median(np.abs(levels - np.median(levels))))


__all__ = ["Change", "biases", "changes", "gains", "parting", "steady_gains", "unmoved", "wander"]
