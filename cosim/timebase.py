"""Time as an integer step count times a rational step."""

from __future__ import annotations

import math
from fractions import Fraction

from bayesftc.cosim.errors import StepSizeError


def rational_step(dt: float | str | Fraction, what: str = "The step size") -> Fraction:
    """Return the step as a fraction of a second: ``0.02``, ``"1/30"`` and ``1/30`` all mean what they say.

    Raises
    ------
    StepSizeError
        If it is not a positive number.
    """
    try:
        exact = Fraction(dt)
    except (ValueError, TypeError, OverflowError, ZeroDivisionError):
        raise StepSizeError(f"{what} {dt!r} is no number; give seconds, as 0.02 or '1/50'.") from None
    if exact <= 0:
        raise StepSizeError(f"{what} is {dt!r} s; it must be positive.")
    if isinstance(dt, float):  # the simplest fraction that rounds to this double
        for limit in (10**3, 10**6, 10**9):
            simple = exact.limit_denominator(limit)
            if simple > 0 and float(simple) == dt:
                return simple
    return exact


def whole_steps(duration: float | str | Fraction, step: Fraction, what: str) -> int:
    """Return how many steps make up `duration` seconds.

    Raises
    ------
    StepSizeError
        If `duration` is no whole number of steps (to one part in a million million).
    """
    if isinstance(duration, float | int) and not (math.isfinite(duration) and duration >= 0):
        raise StepSizeError(f"{what} is {duration!r} s; it must be a finite number and not negative.")
    exact = Fraction(duration)
    ratio = exact / step
    count = round(ratio)
    if abs(ratio - count) > Fraction(1, 10**12) * max(count, 1):
        low, high = float(math.floor(ratio) * step), float(math.ceil(ratio) * step)
        raise StepSizeError(
            f"{what} of {float(exact):g} s is no whole number of steps of {show(step)} s; take {low:g} s or {high:g} s."
        )
    return count


def show(step: Fraction) -> str:
    """Return the step for a message: ``0.02`` or ``1/30``."""
    return f"{float(step):g}" if Fraction(f"{float(step):g}") == step else str(step)
