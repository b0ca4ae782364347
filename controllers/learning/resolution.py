"""The resolution of a sensor, from its samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.models.checks import as_numbers

RANKS = (0.002, 0.01, 0.05, 0.25)
"""Ranks of changes, the smallest first, that are tried as multiples of the resolution."""

MULTIPLES = 12
"""Largest multiple to try."""

FEWEST, FURTHEST = 20, 50
"""Least number of changes, and largest multiple among them, so that an error of the resolution has little effect."""

NEAR, SHARE = 0.1, 0.95
"""Largest distance from a multiple, in resolutions, and share of changes that must be nearer; of random ones a fifth are."""

ROUNDING, USUAL = 1e-9, 0.98
"""Smaller changes are rounding, in units of this quantile of the samples' magnitude, which excludes a few absurd samples."""


def find_resolution(samples: ArrayLike) -> float:
    """Return the resolution of a sensor, of which the changes from sample to sample are whole multiples; 0 if there is none.

    A few other changes, such as at the onset of a fault, and repeated samples have no effect.

    Parameters
    ----------
    samples : array_like
        Samples of one sensor in order of time; NaN where there is none.

    Returns
    -------
    float
        The largest such number, in the sensor's unit; 0 if there is none, or there are too few changes.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> temperature = 20.0 + np.random.default_rng(0).standard_normal(100)
    >>> controllers.find_resolution(0.5 * np.round(temperature / 0.5))
    0.5
    """
    y = as_numbers("The samples", samples, "give the numbers of one sensor").ravel()
    y = y[np.isfinite(y)]
    changes = np.sort(np.abs(np.diff(y)))
    if len(y):
        changes = changes[changes > ROUNDING * np.quantile(np.abs(y), USUAL)]
    if len(changes) < FEWEST:
        return 0.0
    bases = [changes[int(rank * len(changes))] for rank in RANKS]
    candidates = sorted({float(base) / k for base in bases for k in range(1, MULTIPLES + 1)}, reverse=True)
    for candidate in candidates:
        near = changes[: np.searchsorted(changes, (FURTHEST + 0.5) * candidate)]
        few = near[: np.searchsorted(near, 3.5 * candidate)]
        width = _fitted(near, _fitted(few, candidate))
        times = np.rint(near / width)
        fits = (times >= 1) & (np.abs(near / width - times) < NEAR)
        if len(near) >= FEWEST and fits.mean() >= SHARE:
            return width
    return 0.0


def _fitted(changes: np.ndarray, width: float) -> float:
    """Return the width with the least squared errors of its multiples from the changes."""
    times = np.rint(changes / width)
    squares = float(times @ times)
    return float(times @ changes) / squares if squares else width
