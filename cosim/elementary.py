"""Exponential and logarithm as step functions: one fixed sequence of operations, so the same bits on every machine.

Libraries of C differ in the last place of these functions. Here they consist of sums, products, quotients and comparisons, each
rounded separately as IEEE 754 demands, and of three operations on the bits of a number. Engines and exported C use this text.
Errors are below 1 unit in the last place. Special values are those of C99: infinities, NaN, signed zeros, subnormal numbers.

The polynomials interpolate at the Chebyshev nodes of their interval; their errors are below 0.1 units in the last place. A
step of a controller is one long chain of operations, so terms are grouped such that many can be computed side by side.
"""

import math

_INF = math.inf
_NAN = math.nan

ROUNDER = 6755399441055744.0
"""1.5 * 2**52: a number plus and minus this is the nearest whole number, if its magnitude is below 2**51."""

ROOT_OF_HALF = 0.7071067811865476
LOG2_E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 0.6931471805598903, 5.497923018708371e-14
"""ln 2 in two parts. The first has 42 bits, so that its product with an exponent is exact."""

_E3, _E4, _E5, _E6, _E7 = (
    0.16666666666666669,
    0.041666666666666664,
    0.008333333333330062,
    0.0013888888888886552,
    0.00019841269863053618,
)
_E8, _E9, _E10, _E11, _E12 = (
    2.4801587317144498e-05,
    2.7557268459997064e-06,
    2.755728296954995e-07,
    2.510038549551032e-08,
    2.0911236630261545e-09,
)
"""Coefficients of (exp(r) - 1 - r - r**2 / 2) / r**3 for magnitudes of r up to ln(2) / 2."""

_L1, _L2, _L3, _L4, _L5, _L6, _L7 = (
    0.666666666666667,
    0.39999999999899444,
    0.2857142862600327,
    0.22222211130259878,
    0.18182889455674947,
    0.15331710618210773,
    0.14616585424888623,
)
"""Coefficients of (2 artanh(s) - 2 s) / s**3 in s**2, for magnitudes of s up to 0.1716."""


def power_of_two(k):
    """Return 2**k of a whole number from -1022 to 1023; beyond, any number. An operation of its own in compiled code."""
    return math.ldexp(1.0, int(k)) if -1023.0 < k < 1024.0 else 1.0


def exponent(x):
    """Return the whole number k with x / 2**k from sqrt(1/2) to sqrt(2), of a normal x > 0. An operation of its own."""
    mantissa, power = math.frexp(x)
    return float(power - (mantissa < ROOT_OF_HALF))


def significand(x):
    """Return x / 2**exponent(x) of a normal x > 0. An operation of its own in compiled code."""
    mantissa, _ = math.frexp(x)
    return mantissa * 2.0 if mantissa < ROOT_OF_HALF else mantissa


def exponential(x):
    """Return the exponential of `x`."""
    # exp(x) = 2**k exp(r), exp(r) = 1 + r + r**2 (...). Here r = high - low, and 1 + high - one is what `one` misses.
    k = (x * LOG2_E + ROUNDER) - ROUNDER
    high = x - k * LN2_HIGH
    low = k * LN2_LOW
    r = high - low
    r2 = r * r
    r4 = r2 * r2
    first = (0.5 + r * _E3) + r2 * (_E4 + r * _E5)
    second = (_E6 + r * _E7) + r2 * (_E8 + r * _E9)
    third = (_E10 + r * _E11) + r2 * _E12
    one = 1.0 + high
    missed = (high - (one - 1.0)) - low
    if (
        x > -670.0 and x < 709.0
    ):  # the power of two is a factor of each term, which is exact and sooner done than at last
        power = power_of_two(k)
        p2 = r2 * power
        p6 = p2 * r4
        return one * power + ((missed * power + p2 * first) + (p6 * second + (p6 * r4) * third))
    if x > 709.782712893384:
        return _INF
    if x < -745.14:
        return 0.0
    if x != x:
        return x
    value = one + ((missed + r2 * first) + r4 * (r2 * second + r4 * (r2 * third)))
    if x > 0.0:
        return value * power_of_two(k - 1.0) * 2.0
    return value * power_of_two(k + 64.0) * 5.421010862427522e-20  # 2**-64; a subnormal result is rounded once more


def _logarithm_of_normal(x, lifted):
    # log(x) = k ln 2 + log(1 + f), log(1 + f) = f - s (f - rest), with s = f / (2 + f) and the rest of 2 artanh(s).
    k = exponent(x) - lifted
    m = significand(x)
    f = m - 1.0
    s = f / (m + 1.0)
    z = s * s
    z2 = z * z
    sz = s * z
    sz3 = sz * z2
    rest = (sz * (_L1 + z * _L2) + sz3 * (_L3 + z * _L4)) + (sz3 * z2) * ((_L5 + z * _L6) + z2 * _L7)
    return k * LN2_HIGH + (f - ((s * f - k * LN2_LOW) - rest))


def logarithm(x):
    """Return the natural logarithm of `x`."""
    if x >= 2.2250738585072014e-308 and x < _INF:
        return _logarithm_of_normal(x, 0.0)
    if x > 0.0 and x < _INF:  # subnormal
        return _logarithm_of_normal(x * 18014398509481984.0, 54.0)
    if x == 0.0:
        return -_INF
    return x if x == _INF else _NAN
