"""Exponential, logarithm, sine and cosine as step functions: one fixed sequence of operations, so the same bits on every machine.

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

_S1, _S2, _S3, _S4 = (-0.16666666666666666, 0.008333333333333331, -0.00019841269841264821, 2.7557319219150783e-06)
_S5, _S6, _S7 = (-2.5052106167335705e-08, 1.6058521349954986e-10, -7.586094789672621e-13)
"""Coefficients of (sin(r) / r - 1) / r**2 in r**2, for magnitudes of r up to pi / 4."""

_C1, _C2, _C3 = (0.041666666666666664, -0.0013888888888887322, 2.4801587298651292e-05)
_C4, _C5, _C6 = (-2.755731721268659e-07, 2.0876134024090145e-09, -1.1381754653662937e-11)
"""Coefficients of (cos(r) - 1 + r**2 / 2) / r**4 in r**2, for magnitudes of r up to pi / 4."""

# fmt: off
_TWO_OVER_PI = (
    0.0, 0.0, 0.0, 0.0, 10680707.0, 7228996.0, 1387004.0, 2578385.0, 16069853.0, 12639074.0, 9804092.0, 4427841.0,
    16666979.0, 11263675.0, 12935607.0, 2387514.0, 4345298.0, 14681673.0, 3074569.0, 13734428.0, 16653803.0,
    1880361.0, 10960616.0, 8533493.0, 3062596.0, 8710556.0, 7349940.0, 6258241.0, 3772886.0, 3769171.0, 3798172.0,
    8675211.0, 12450088.0, 3874808.0, 9961438.0, 366607.0, 15675153.0, 9132554.0, 7151469.0, 3571407.0, 2607881.0,
    12013382.0, 4155038.0, 6285869.0, 7677882.0, 13102053.0, 15825725.0, 473591.0, 9065106.0, 15363067.0, 6271263.0,
    9264392.0, 5636912.0,
)
# fmt: on
"""Digits of 2 / pi to the base 2**24: four before the point, and those behind it."""


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


def logarithm_of_normal(x, lifted):
    """Return log(x / 2**lifted) of a normal number x > 0, without branches."""
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
        return logarithm_of_normal(x, 0.0)
    if x > 0.0 and x < _INF:  # subnormal
        return logarithm_of_normal(x * 18014398509481984.0, 54.0)
    if x == 0.0:
        return -_INF
    return x if x == _INF else _NAN


def _quadrant(n):
    """Return a whole number modulo 4."""
    rest = n - 4.0 * ((0.25 * n + ROUNDER) - ROUNDER)
    return rest + 4.0 if rest < 0.0 else rest


def _reduced(x):
    """Return n and x - n pi / 2 as the sum of two numbers, for magnitudes of `x` below a million (Cody and Waite)."""
    n = (x * 0.6366197723675814 + ROUNDER) - ROUNDER
    # Products with parts of 33 bits are exact, and so is the first difference. The second part of pi / 2 has all its bits.
    first = x - n * 1.5707963267341256
    part = n * 6.077100506506192e-11
    r = first - part
    least = n * 1.2e-7
    if r * r >= least * least:  # what the second product misses is below 2**-63 of this
        return n, r, (first - r) - part
    part = n * 6.077100506303966e-11
    second = first - part
    back = second - first
    missed = (first - (second - back)) - (part + back)
    part = n * 2.0222662487111665e-21
    third = second - part
    back = third - second
    missed = missed + ((second - (third - back)) - (part + back))
    missed = missed - n * 8.4784276603689e-32
    r = third + missed
    return n, r, (third - r) + missed


def _product(a, b, c, d, j):
    """Return digit `j` of the product of a number with 2 / pi, before carries; 0 is the last before the point."""
    return (a * _TWO_OVER_PI[j + 3] + b * _TWO_OVER_PI[j + 2]) + (c * _TWO_OVER_PI[j + 1] + d * _TWO_OVER_PI[j])


def _reduced_far(x):
    """Return the same for larger magnitudes, with n modulo 4: only some digits of 2 / pi count (Payne and Hanek)."""
    size = x if x > 0.0 else -x
    k = exponent(size)
    e = 0
    while 24.0 * (e + 1.0) <= k:
        e = e + 1
    # `size` in digits to the base 2**24, from 2**(24 e) downwards.
    rest = significand(size) * power_of_two(k - 24.0 * e)
    a = (rest + ROUNDER) - ROUNDER
    rest = (rest - a) * 16777216.0
    b = (rest + ROUNDER) - ROUNDER
    rest = (rest - b) * 16777216.0
    c = (rest + ROUNDER) - ROUNDER
    d = (rest - c) * 16777216.0
    # The first three digits of the product have, modulo 4, no more than 53 bits: their sum is exact.
    n = 0.0
    total = 0.0
    low = 0.0
    unit = 1.0
    for j in range(8):
        if j == 3:
            n = (total + ROUNDER) - ROUNDER
            total = total - n
        part = _product(a, b, c, d, e + j) * unit
        part = part - 4.0 * ((0.25 * part + ROUNDER) - ROUNDER)
        high = total
        total = high + part
        back = total - high
        low = low + ((high - (total - back)) + (part - back))
        unit = unit * 5.960464477539063e-08  # 2**-24
    # Times pi / 2, in parts of 26 and 53 bits; the first factor is split in the same way.
    split = 134217729.0 * total
    front = split - (split - total)
    high = front * 1.5707963109016418
    low = (total - front) * 1.5707963109016418 + (total * 1.5893254773528196e-08 + low * 1.5707963267948966)
    r = high + low
    low = (high - r) + low
    if x < 0.0:
        return _quadrant(-n), -r, -low
    return _quadrant(n), r, low


def _sine_of_part(r, low):
    z = r * r
    v = z * r
    rest = (_S2 + z * _S3) + (z * z) * ((_S4 + z * _S5) + (z * z) * (_S6 + z * _S7))
    return r - ((z * (0.5 * low - v * rest) - low) - v * _S1)


def _cosine_of_part(r, low):
    z = r * r
    half = 0.5 * z
    one = 1.0 - half
    rest = (_C1 + z * _C2) + (z * z) * ((_C3 + z * _C4) + (z * z) * (_C5 + z * _C6))
    return one + (((1.0 - one) - half) + ((z * z) * rest - r * low))


def _turned(x, quarters):
    """Return the sine of `x` plus some quarters of a turn."""
    q, r, low = 0.0, x, 0.0
    if x > -1e6 and x < 1e6:
        if x < -0.785 or x > 0.785:
            q, r, low = _reduced(x)
    elif x > -_INF and x < _INF:
        q, r, low = _reduced_far(x)
    else:
        return _NAN
    q = _quadrant(q + quarters)
    if q == 1.0 or q == 3.0:
        value = _cosine_of_part(r, low)
    else:
        value = _sine_of_part(r, low)
    if q >= 2.0:
        return -value
    return value


def sine(x):
    """Return the sine of `x` in radians."""
    return _turned(x, 0.0)


def cosine(x):
    """Return the cosine of `x` in radians."""
    return _turned(x, 1.0)
