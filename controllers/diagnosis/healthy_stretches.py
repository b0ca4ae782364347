"""Stretches of a recording in which the sensors agree with each other, and sensors that never do, whatever the model."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

WINDOW = 25
"""Samples in a comparison of two sensors."""

MEAN_APART = 5.0
"""Standard errors of the mean difference in a window from which on one of the sensors is faulty."""

SPREAD_APART = (0.25, 2.7)
"""Range of the difference's mean square, relative to the usual one, outside of which one of the sensors is faulty."""

LEAST_IN_WINDOW, LEAST_WINDOWS = 5, 4
"""Least number of samples in a window, and of windows in a run, for a comparison."""

LEAST_SHARE = 0.2
"""Share of healthy samples below which nothing is left out, because two sensors disagree all the time."""

MOST_STRETCHES = 6
"""Largest number of stretches, and of gaps, the longest ones."""

LASTING = 0.25
"""Share of a run from which on a sensor that contradicts the others is left out of all of it."""

LEAST_GAP = 25
"""Least length of a gap of a sensor, in its usual distances between samples."""


def healthy_stretches(model: LinearModel, y: Floats) -> NDArray[np.bool_]:
    """Return which samples (T) count: not those where sensors of one quantity disagree, with a window before and after.

    The differences between sensors of one quantity are compared with their own median and spread over the run.
    """
    apart = np.zeros(len(y), dtype=bool)
    for group in model.alike:
        for i, j in combinations(group, 2):
            apart |= _apart(y[:, i] - y[:, j])
    wide = apart.copy()
    for k in np.flatnonzero(apart)[:: WINDOW // 2]:
        wide[max(k - WINDOW, 0) : k + 2 * WINDOW] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[True], wide, [True]]).astype(int)))
    stretches = sorted(zip(edges[::2], edges[1::2], strict=True), key=lambda each: each[0] - each[1])
    healthy = np.zeros(len(y), dtype=bool)
    for start, stop in stretches[:MOST_STRETCHES]:
        healthy[start:stop] = True
    return healthy if healthy.mean() >= LEAST_SHARE else np.ones(len(y), dtype=bool)


def shifted(model: LinearModel, y: Floats) -> tuple[int, ...]:
    """Return the sensors with an unknown offset: for most of the run a pair differs by one that is not there at other times.

    The samples at these other times do not count. Without them, the offset would look like a load.
    """
    pairs = [(i, j) for group in model.alike for i, j in combinations(group, 2) if _jumps(y[:, i] - y[:, j])]
    return tuple(sorted({i for pair in pairs for i in pair}))


def contradicted(model: LinearModel, y: Floats) -> tuple[int, ...]:
    """Return the sensors that at least two others of their quantity contradict for long, where these agree with each other.

    Without all samples of such long stretches, as of a drift, too little of the run would be left.
    """
    return tuple(i for group in model.alike if len(group) > 2 for i in _left_out(y, group))


def _left_out(y: Floats, group: tuple[int, ...]) -> list[int]:
    """Return the contradicted sensors of a group: one by one, the one with which most others disagree."""
    size = len(group)
    apart = np.zeros((size, size, len(y)), dtype=bool)
    for a, b in combinations(range(size), 2):
        apart[a, b] = apart[b, a] = _apart(y[:, group[a]] - y[:, group[b]])
    left = list(range(size))
    while (votes := apart[np.ix_(left, left)].sum(axis=1)).size and (votes > 0).any(axis=0).mean() > LASTING:
        worst = int(np.argmax(votes.sum(axis=1)))
        if len(left) <= 2 or (votes[worst] >= 2).mean() <= LASTING:
            return []
        left.pop(worst)
    return [group[i] for i in range(size) if i not in left]


def after_gaps(y: Floats) -> list[int]:
    """Return the samples at the end of long gaps of a sensor, before which its observer has lost the state."""
    gaps: dict[int, int] = {}
    for column in np.isfinite(y).T:
        at = np.flatnonzero(column)
        distances = np.diff(at)
        for k in np.flatnonzero(distances > LEAST_GAP * np.median(distances)) if len(distances) else ():
            gaps[int(at[k + 1])] = max(int(distances[k]), gaps.get(int(at[k + 1]), 0))
    return sorted(sorted(gaps, key=lambda at: -gaps[at])[:MOST_STRETCHES])


def _apart(difference: Floats) -> NDArray[np.bool_]:
    """Return in which samples two sensors disagree: those of windows with an unusual mean or mean square."""
    flags = np.zeros(len(difference), dtype=bool)
    windows, middle, spread = _windows(difference)
    for start, window in windows:
        far = _distance(window, middle, spread) > MEAN_APART
        square = float((((window - middle) / spread) ** 2).mean())
        flags[start : start + WINDOW] = far or not SPREAD_APART[0] < square < SPREAD_APART[1]
    return flags


def _jumps(difference: Floats) -> bool:
    """Return whether the usual difference of two sensors is not zero, but that in a window is."""
    windows, middle, spread = _windows(difference)
    off = [_distance(window, 0.0, spread) <= MEAN_APART for _, window in windows]
    return any(off) and abs(middle) * WINDOW**0.5 > MEAN_APART * spread


def _distance(window: Floats, level: float, spread: float) -> float:
    """Return the distance of a window's mean from a level, in standard errors."""
    return float(abs(window.mean() - level) / spread * len(window) ** 0.5)


def _windows(difference: Floats) -> tuple[list[tuple[int, Floats]], float, float]:
    """Return the begins and samples of windows, and the usual mean and spread in one; no windows if they are too few."""
    windows = []
    for start in range(0, len(difference), WINDOW):
        window = difference[start : start + WINDOW]
        window = window[np.isfinite(window)]
        if len(window) >= LEAST_IN_WINDOW:
            windows.append((start, window))
    if len(windows) < LEAST_WINDOWS:
        return [], 0.0, 0.0
    middle = float(np.median([window.mean() for _, window in windows]))
    spread = float(np.median([window.std(ddof=1) for _, window in windows]))
    return (windows if spread else []), middle, spread
