"""The mathematics of step functions. It gives the same bits in plain Python and in compiled code, and never raises.

Step functions take everything beyond ``+ - * /`` and comparisons from here, never from ``math``, ``numpy`` or ``**``. So one
text can run as plain Python, be compiled by numba, and be traced symbolically. The functions return ``numpy.float64``.
Its division by zero gives an infinity or NaN (IEEE 754), where a Python float would raise.

``select`` evaluates both alternatives. It is always computed as ``(a if condition else 0) + (0 if condition else b)``,
because a symbolic engine has no other way. So a negative zero becomes a positive one everywhere.
"""

import math
from typing import Any

from numpy import bool_, float64, floor as _floor

from bayesftc.cosim.elementary import cosine, exponent, exponential, logarithm, power_of_two, significand, sine

_NAN = float64("nan")


def select(condition, a, b):
    """Return `a` where `condition` holds, else `b`; a negative zero becomes a positive one."""
    return (float64(a) if condition else float64(0.0)) + (float64(0.0) if condition else float64(b))


def both(a, b):
    """Return whether both conditions hold."""
    return bool_(bool(a) & bool(b))


def either(a, b):
    """Return whether at least one condition holds."""
    return bool_(bool(a) | bool(b))


def negate(a):
    """Return whether the condition does not hold."""
    return bool_(not a)


def isnan(x):
    """Return whether `x` is not a number (a missing sample)."""
    return bool_(x != x)


def sqrt(x):
    """Return the square root of `x`; NaN for negative numbers."""
    return float64(math.sqrt(x)) if x >= 0.0 else _NAN


def exp(x):
    """Return the exponential of `x`; infinity where it overflows."""
    return float64(exponential(float(x)))


def log(x):
    """Return the natural logarithm of `x`; minus infinity at zero, NaN below."""
    return float64(logarithm(float(x)))


def sin(x):
    """Return the sine of `x` in radians; NaN for infinities."""
    return float64(sine(float(x)))


def cos(x):
    """Return the cosine of `x` in radians; NaN for infinities."""
    return float64(cosine(float(x)))


def floor(x):
    """Return the largest whole number not above `x`, as a float; the sign of a zero is kept."""
    return float64(_floor(x))


def absolute(x):
    """Return the magnitude of `x`."""
    return float64(math.fabs(x))


def minimum(a, b):
    """Return the smaller; `b` where `a` is NaN (as ``select(a < b, a, b)``)."""
    return select(a < b, a, b)


def maximum(a, b):
    """Return the larger; `b` where `a` is NaN (as ``select(a > b, a, b)``)."""
    return select(a > b, a, b)


def square(x):
    """Return the product of `x` with itself (``x**2`` rounds differently in compiled code)."""
    return float64(x) * float64(x)


NAMES = (
    "absolute",
    "both",
    "cos",
    "either",
    "exp",
    "floor",
    "isnan",
    "log",
    "maximum",
    "minimum",
    "negate",
    "select",
    "sin",
    "sqrt",
    "square",
)
"""Names of all operations, in alphabetical order."""

OF_LIBRARY = {
    "absolute": "fabs",
    "floor": "floor",
    "sqrt": "sqrt",
}
"""Operations that C's library has, with their names in C; NumPy has them under the names used here."""

COMPOSED: dict[str, Any] = {
    "cos": cosine,
    "exp": exponential,
    "log": logarithm,
    "maximum": maximum,
    "minimum": minimum,
    "sin": sine,
    "square": square,
}
"""Operations that are composed of others, with the step function of each, which every engine uses."""

BITS: dict[str, Any] = {"exponent": exponent, "power_of_two": power_of_two, "significand": significand}
"""Operations on the bits of a number, for the functions above only."""

independent = range
"""The range of a loop of which no pass reads or writes what another one writes. The compiler may then make several passes at
once, in vectors. Step functions must call it by this name, by which the translation to C finds it: it becomes a comment in C, and
a mark of the loop for LLVM (`bayesftc.cosim.stepping.machine.lowering`)."""

__all__ = list(NAMES)
