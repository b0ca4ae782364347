"""The resolution of a sensor, from its samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.models.checks import as_numbers

RANKS = (0.002, 0.01, 0.05, 0.25)
"""Among the changes from sample to sample, the smallest first, these are taken for multiples of the resolution ..."""

MULTIPLES = 12
"""... up to this one."""

FEWEST, FURTHEST = 20, 50
"""Changes that are needed, and how many times the resolution they may be, so that it need not be known too well."""

NEAR, SHARE = 0.1, 0.95
"""What share of them must be nearer than this to a whole multiple, in resolutions: of any numbers a fifth are."""

ROUNDING, USUAL = 1e-9, 0.98
"""Smaller changes, in units of this quantile of the samples' magnitude, are rounding. A few absurd samples are beyond it."""


def find_resolution(samples: ArrayLike) -> float:
    """Return the resolution of a sensor: of what the changes from sample to sample are whole multiples, or 0.

    A few changes that are none, as at the onset of a fault, do no harm; nor do samples that repeat themselves.

    Parameters
    ----------
    samples : array_like
        Of one sensor in their order; NaN where there is none.

    Returns
    -------
    float
        The largest such number, in the sensor's unit; 0 if there is none, or too few samples tell.
    """
    y = as_numbers("The samples", samples, "give the numbers that one sensor has sent").ravel()
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
    """Return the width of which the changes are multiples with the least squares of errors."""
    times = np.rint(changes / width)
    squares = float(times @ times)
    return float(times @ changes) / squares if squares else width
