"""Conversion of users' numbers to floats."""

from __future__ import annotations

from math import inf, nan
from numbers import Real

import numpy as np

from bayesftc.cosim.types import Floats


def real(value: object) -> float:
    """Return a number as a float: NaN for anything else (strings, truth values), infinity if it is too large for a float."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return nan
    try:
        return float(value)
    except OverflowError:  # whole numbers and fractions have no limit
        return inf if value > 0 else -inf  # type: ignore[operator]


def reals(value: object) -> Floats:
    """Return numbers as an array of floats; an empty array for anything else, as strings or rows of different lengths."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "US":
            return np.empty(0)
        return np.asarray(value, dtype=np.float64)
    except OverflowError:
        return np.array(np.inf)
    except (TypeError, ValueError):
        return np.empty(0)


__all__ = ["real", "reals"]
