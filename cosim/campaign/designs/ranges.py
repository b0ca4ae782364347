"""Ranges of factors: two bounds, whole numbers, or a distribution; and the scaling from the unit interval to a range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats

TAKES = "give (low, high), range(low, high) for whole numbers, or a distribution of scipy.stats with its parameters."


def checked(design: str, ranges: Any) -> None:
    """Raise an error if there is no factor, or a wrong range; `design` is the name of the design."""
    if not isinstance(ranges, Mapping) or not ranges:
        raise ModelError(
            f"{design} has ranges={brief(ranges)}; give a mapping from the names of factors to their ranges."
        )
    for name, given in ranges.items():
        if isinstance(given, range):
            if not given:
                raise ModelError(f"Factor {name!r} has the range {given}, which is empty; give at least one number.")
        elif not _is_distribution(given):
            _bounds(name, given)


def scaled(name: str, given: Any, unit: Floats) -> list[Any]:
    """Return the values of a factor at places between 0 and 1 of its range, as plain numbers.

    Parameters
    ----------
    name : str
        The factor.
    given : tuple, range or distribution
        Its range.
    unit : ndarray of shape (points,)
        The places.

    Raises
    ------
    ModelError
        If a distribution has no finite value at one of them.
    """
    if isinstance(given, range):
        count = (given[-1] - given[0]) // given.step + 1  # len() fails for very long ranges
        return [given[min(int(place * count), count - 1)] for place in unit.tolist()]
    if _is_distribution(given):
        values = np.asarray(given.ppf(unit))
        if not np.isfinite(values).all():
            raise ModelError(
                f"The distribution of factor {name!r} is {values[~np.isfinite(values)][0]} at one of the points; give a "
                "distribution with finite quantiles between 0 and 1, or another seed."
            )
        # A distribution over whole numbers has quantiles of type float.
        return [int(v) for v in values] if hasattr(given, "pmf") else values.tolist()
    low, high = _bounds(name, given)
    return np.asarray(low + unit * (high - low)).tolist()  # type: ignore[no-any-return]


def _is_distribution(given: Any) -> bool:
    return callable(getattr(given, "ppf", None))


def _bounds(name: str, given: Any) -> tuple[float, float]:
    try:
        low, high = map(real, given)
    except (TypeError, ValueError):
        raise ModelError(f"Factor {name!r} has the range {brief(given)}; {TAKES}") from None
    if not (np.isfinite([low, high]).all() and low < high):
        raise ModelError(f"Factor {name!r} has the range {brief(given)}; low must be below high, and both finite.")
    return low, high


__all__ = ["checked", "scaled"]
