"""Time as an integer step count times a rational step."""

from __future__ import annotations

import math
from fractions import Fraction
from numbers import Rational

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError, StepSizeError, brief

_ROUNDING = Fraction(1, 10**15)
_HALF_UNIT = Fraction(1, 2**54)
_LONGEST = 10**30

EXACT = 2**53
"""Whole numbers up to here are exact doubles, so that the quotient of two of them is the double nearest to the exact one."""


def rational_step(dt: float | str | Fraction, what: str = "The step size") -> Fraction:
    """Return the step as an exact fraction of a second, for ``0.02``, ``"1/30"`` and ``1/30``.

    Raises
    ------
    StepSizeError
        If it is not a positive number.
    """
    exact = _exact(dt, what)
    if exact <= 0:
        raise StepSizeError(f"{what} is {brief(dt)} s; it must be positive.")
    if not 1 <= exact * _LONGEST <= _LONGEST**2:
        raise StepSizeError(
            f"{what} is {brief(dt)} s; it must be between {1 / _LONGEST:g} s and {float(_LONGEST):g} s."
        )
    if not isinstance(dt, str | Rational):
        # The simplest fraction that rounds to this double; 3 * 0.1 becomes 3/10 despite its rounding error.
        for limit in (10**3, 10**6, 10**9, 10**12, EXACT):
            simple = exact.limit_denominator(limit)
            if simple > 0 and abs(simple - exact) <= exact * (_ROUNDING if limit <= 10**6 else _HALF_UNIT):
                return simple
    return exact


def exact_duration(duration: float | str | Fraction, what: str) -> Fraction:
    """Return a duration in seconds as a fraction; `what` begins the error message.

    Raises
    ------
    StepSizeError
        If it is negative, infinite or extremely long.
    """
    exact = _exact(duration, what)
    if exact < 0:
        raise StepSizeError(f"{what} is {brief(duration)} s; it must not be negative.")
    if exact > _LONGEST:
        raise StepSizeError(
            f"{what} is {brief(duration)} s, so long that times cannot be distinguished; use a shorter run."
        )
    return exact


def whole_steps(duration: float | str | Fraction, step: Fraction, what: str) -> int:
    """Return the number of steps in `duration` seconds.

    Raises
    ------
    StepSizeError
        If `duration` is no whole number of steps, with a relative tolerance of 1e-12. If it is so long that t_k would not be the
        double nearest to k steps.
    """
    exact = exact_duration(duration, what)
    ratio = exact / step
    count = round(ratio)
    if abs(ratio - count) > Fraction(1, 10**12) * max(count, 1):
        fewer, more = math.floor(ratio), math.ceil(ratio)
        near = " or ".join(f"{float(steps * step):g} s" for steps in (fewer, more) if steps)
        raise StepSizeError(f"{what} of {float(exact):g} s is no whole number of steps of {show(step)} s; use {near}.")
    if max(count, 1) * step.numerator > EXACT or step.denominator > EXACT:
        raise StepSizeError(
            f"{what} of {float(exact):g} s is {count} steps of {step} s, so long that times are not exact. Use a step that is a "
            "simpler fraction, as '1/50', or a shorter run."
        )
    return count


def step_at(t: float, step: Fraction) -> int:
    """Return the number of the step that begins at, or contains, the time `t`."""
    return math.floor(t * step.denominator / step.numerator + 1e-6)


def whole_number(value: object, what: str) -> int:
    """Return a number of steps as an integer; `what` begins the error message, as ``"decimation="``."""
    number = real(value)
    if 1 <= number <= EXACT and number.is_integer():
        return int(number)
    raise ModelError(f"{what}{value!r}; it must be a whole number of steps, at least 1.")


def _exact(seconds: float | str | Fraction, what: str) -> Fraction:
    try:
        if isinstance(seconds, bool):
            raise TypeError
        if isinstance(seconds, Rational):
            return Fraction(int(seconds.numerator), int(seconds.denominator))  # NumPy's whole numbers overflow
        if isinstance(seconds, str) and "/" in seconds:
            return Fraction(seconds)
        rounded = float(seconds)
        # Numbers out of the range of doubles (1e999999999) would take for ever as exact powers of ten.
        return Fraction(seconds if isinstance(seconds, str) and rounded and math.isfinite(rounded) else rounded)
    except (ValueError, TypeError, OverflowError, ZeroDivisionError):
        raise StepSizeError(f"{what} {brief(seconds)} is no finite number; give seconds, as 0.02 or '1/50'.") from None


def spoken(seconds: float) -> str:
    """Return a duration as a whole number of the largest unit of which it is two or more: ``"40 s"``, ``"12 min"``, ``"3 h"``.

    Below two seconds it has two digits: ``"0.03 s"``.
    """
    if seconds < 2:
        return f"{seconds:.2g} s"
    unit, size = next(((unit, size) for unit, size in _SIZES if seconds >= 2 * size), ("s", 1))
    return f"{seconds / size:.0f} {unit}"


def share_of_time(t: float, last: float) -> str:
    """Return a time and the last one in the same unit, seconds, hours or days: ``"15.7 of 250 d"``."""
    unit, size = next(((unit, size) for unit, size in _SIZES if unit != "min" and last >= 3 * size), ("s", 1))
    return f"{t / size:.4g} of {last / size:.4g} {unit}"


_SIZES = (("d", 86400), ("h", 3600), ("min", 60))
"""Units of long times, and their seconds."""


def show(step: Fraction) -> str:
    """Return the step as text for a message: ``0.02`` or ``1/30``."""
    return f"{float(step):g}" if Fraction(f"{float(step):g}") == step else str(step)
