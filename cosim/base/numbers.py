"""Conversion of users' numbers to floats, and of the numbers of results to short texts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from fractions import Fraction
from math import inf, isfinite, nan
from numbers import Real
from typing import Any

import numpy as np

from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats

MAD = 1.4826
"""Standard deviation of normal numbers, relative to the median of their absolute deviations from the middle."""
ROUNDING = 1e-12
"""Half of an interval, relative to its mean, that is 0 but for rounding."""

MOST_DIGITS = 8
"""Most digits of a mean beside its interval."""


def counted(number: int, one: str) -> str:
    """Return a number and a noun in the singular or plural: ``"1 control"``, ``"2 controls"``."""
    return f"{number} {one}" + "s" * (number != 1)


def with_and(words: Sequence[str]) -> str:
    """Return words with commas, and an 'and' before the last of them."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def with_article(noun: str) -> str:
    """Return a noun behind its article: ``"an int"``, ``"a list"``, ``"an FMU"``."""
    spelled = noun[0] in "AEFILMNORSX" and noun[:2].isupper()  # as letters: an FMU, an LQGController
    return ("an " if spelled or noun[0] in "aeiouAEIO" or noun == "ndarray" else "a ") + noun


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


def check_count(owner: object, name: str, most: int | None = None) -> None:
    """Check that a setting of `owner` is a whole number, at least 1 and at most `most`.

    Raises
    ------
    ModelError
        If it is not.
    """
    value = getattr(owner, name)
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= (most or value):
        limits = "a whole number, at least 1" if most is None else f"a whole number from 1 to {most:,}"
        raise ModelError(f"{type(owner).__name__} has {name}={brief(value)}; it must be {limits}.")


def with_half(value: float, half: float) -> str:
    """Return a mean with half of its interval: two digits of the half, and as many decimals of the mean as these have.

    Without a half (NaN, infinity), with one of 0 but for rounding, or without a mean, it is the mean with four digits; a mean
    never has more than eight.
    """
    half = 0.0 if isfinite(value) and half < ROUNDING * abs(value) else half
    if not (isfinite(value) and isfinite(half) and half > 0):
        return f"{value:.4g}" + (" ± 0" if half == 0 else "")
    decimals = 1 - _exponent(half)
    largest = _exponent(max(abs(value), half))
    if largest + decimals >= MOST_DIGITS:
        return f"{value:.{MOST_DIGITS}g} ± {half:.2g}"
    if -4 <= largest < MOST_DIGITS:
        text, of_half = (f"{round(number, decimals):.{max(decimals, 0)}f}" for number in (value, half))
        return f"{text} ± {of_half}"
    return f"{value:.{largest + decimals}e} ± {half:.1e}"


def _exponent(value: float) -> int:
    """Return the power of ten of a positive number that is rounded to two digits."""
    return int(f"{value:.1e}".partition("e")[2])


MOMENTS = ("start", "end", "onset")
"""Attributes that are times: the difference of two of them matters, so that large ones have three decimals as well."""


def short(result: Any, **units: str) -> str:
    """Return the ``repr`` of a result: numbers with four digits and their units, arrays by their shape.

    Parameters
    ----------
    result : dataclass or NamedTuple
        The result; its attributes have all digits.
    **units : str
        Unit of each attribute that has one.
    """
    names = [f.name for f in fields(result) if f.repr] if is_dataclass(result) else result._fields
    values = {name: getattr(result, name) for name in names}
    texts = {name: _moment(value) if name in MOMENTS else _short(value) for name, value in values.items()}
    shown = [f"{name}={text} {units.get(name, '')}".rstrip() for name, text in texts.items()]
    return f"{type(result).__name__}({', '.join(shown)})"


def _moment(value: Any) -> str:
    return f"{round(value, 3):.15g}" if isinstance(value, float) and abs(value) >= 10.0 else _short(value)


def _short(value: Any) -> str:
    if isinstance(value, float | Fraction):
        return f"{float(value):.4g}"
    if isinstance(value, tuple) and type(value) is tuple:
        return f"({', '.join(map(_short, value))}{',' * (len(value) == 1)})"
    if isinstance(value, np.ndarray):
        return f"<{' x '.join(map(str, value.shape))} numbers>"
    return repr(value)


__all__ = ["MAD", "check_count", "counted", "real", "reals", "short", "with_half"]
