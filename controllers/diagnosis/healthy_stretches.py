"""Stretches of a recording in which the sensors agree with each other, whatever the model."""

from __future__ import annotations

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
"""Largest number of stretches, the longest ones."""


def healthy_stretches(model: LinearModel, y: Floats) -> NDArray[np.bool_]:
    """Return which samples (T) count: not those where sensors of one quantity disagree, with a window before and after.

    The differences between sensors of one quantity are compared with their own median and spread over the run.
    """
    apart = np.zeros(len(y), dtype=bool)
    rows = model.quantities
    for i in range(len(rows)):
        for j in range(i):
            if np.array_equal(rows[i], rows[j]):
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


def _apart(difference: Floats) -> NDArray[np.bool_]:
    """Return in which samples two sensors disagree: those of windows with an unusual mean or mean square."""
    flags = np.zeros(len(difference), dtype=bool)
    windows = []
    for start in range(0, len(difference), WINDOW):
        window = difference[start : start + WINDOW]
        window = window[np.isfinite(window)]
        if len(window) >= LEAST_IN_WINDOW:
            windows.append((start, window))
    if len(windows) < LEAST_WINDOWS:
        return flags
    middle = float(np.median([window.mean() for _, window in windows]))
    spread = float(np.median([window.std(ddof=1) for _, window in windows]))
    if spread == 0.0:
        return flags
    for start, window in windows:
        apart = (window - middle) / spread
        far = abs(apart.mean()) * np.sqrt(len(apart)) > MEAN_APART
        flags[start : start + WINDOW] = far or not SPREAD_APART[0] < float((apart**2).mean()) < SPREAD_APART[1]
    return flags
