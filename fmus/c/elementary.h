/* Sine and cosine as one fixed sequence of operations: the same bits with every compiler and C library.
 *
 * Written by tools/elementary.py, which translates cosim/elementary.py of bayesftc; do not edit.
 */
#ifndef BAYESFTC_ELEMENTARY_H
#define BAYESFTC_ELEMENTARY_H

#include <math.h>
#include <stdint.h>

#if defined __FAST_MATH__ || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__) || defined __ASSOCIATIVE_MATH__ \
    || defined __RECIPROCAL_MATH__ || defined _M_FP_FAST
#error "Compile without -ffast-math or parts of it: a NaN is a missing sample, and the order of sums must stay."
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
/* Every product and sum is rounded separately; and gcc 12 replaces 0.0 - n by -n where n cannot be a negative zero. */
#pragma GCC optimize("fp-contract=off", "rounding-math")
#endif

typedef struct { double v0; double v1; double v2; } Record_fff;

static const double table[53] = { 0.0, 0.0, 0.0, 0.0, 10680707.0, 7228996.0, 1387004.0, 2578385.0, 16069853.0,
    12639074.0, 9804092.0, 4427841.0, 16666979.0, 11263675.0, 12935607.0, 2387514.0, 4345298.0, 14681673.0, 3074569.0,
    13734428.0, 16653803.0, 1880361.0, 10960616.0, 8533493.0, 3062596.0, 8710556.0, 7349940.0, 6258241.0, 3772886.0,
    3769171.0, 3798172.0, 8675211.0, 12450088.0, 3874808.0, 9961438.0, 366607.0, 15675153.0, 9132554.0, 7151469.0,
    3571407.0, 2607881.0, 12013382.0, 4155038.0, 6285869.0, 7677882.0, 13102053.0, 15825725.0, 473591.0, 9065106.0,
    15363067.0, 6271263.0, 9264392.0, 5636912.0 };

static double op_exponent(double x)
{
    union { double number; uint64_t bits; } it;

    it.number = x;
    it.bits = ((it.bits + 2638147582215219) >> 52) | 4841369599423283200;
    return it.number - 4503599627371519.0;
}

static double op_power_of_two(double k)
{
    union { double number; uint64_t bits; } it;

    it.number = k + 6755399441056767.0;
    it.bits <<= 52;
    return it.number;
}

static double op_significand(double x)
{
    union { double number; uint64_t bits; } it;

    it.number = x;
    it.bits = ((it.bits + 2638147582215219) & 4503599627370495) + 4604544271217802189;
    return it.number;
}

/* Return n and x - n pi / 2 as the sum of two numbers, for magnitudes of `x` below a million (Cody and Waite). */
static Record_fff reduced(double x)
{
    double part = 0.0, r = 0.0, back = 0.0, missed = 0.0;

    const double n = x * 0.6366197723675814 + 6755399441055744.0 - 6755399441055744.0;
    const double first = x - n * 1.5707963267341256;
    part = n * 6.077100506506192e-11;
    r = first - part;
    const double least = n * 1.2e-07;
    if (r * r >= least * least) {
        const Record_fff t_1 = { n, r, first - r - part };
        return t_1;
    }
    part = n * 6.077100506303966e-11;
    const double second = first - part;
    back = second - first;
    missed = first - (second - back) - (part + back);
    part = n * 2.0222662487111665e-21;
    const double third = second - part;
    back = third - second;
    missed = missed + (second - (third - back) - (part + back));
    missed = missed - n * 8.4784276603689e-32;
    r = third + missed;
    const Record_fff t_2 = { n, r, third - r + missed };
    return t_2;
}

/* Return digit `j` of the product of a number with 2 / pi, before carries; 0 is the last before the point. */
static double product(double a, double b, double c, double d, int64_t j)
{
    return a * table[j + 3] + b * table[j + 2] + (c * table[j + 1] + d * table[j]);
}

/* Return a whole number modulo 4. */
static double quadrant(double n)
{
    const double rest = n - 4.0 * (0.25 * n + 6755399441055744.0 - 6755399441055744.0);
    return rest < 0.0 ? rest + 4.0 : rest;
}

/* Return the same for larger magnitudes, with n modulo 4: only some digits of 2 / pi count (Payne and Hanek). */
static Record_fff reduced_far(double x)
{
    int64_t e = 0;
    double rest = 0.0, n = 0.0, total = 0.0, low = 0.0, unit = 0.0, part = 0.0, high = 0.0;

    const double size = x > 0.0 ? x : -x;
    const double k = op_exponent(size);
    e = 0;
    while (24.0 * ((double)e + 1.0) <= k) {
        e = e + 1;
    }
    rest = op_significand(size) * op_power_of_two(k - 24.0 * (double)e);
    const double a = rest + 6755399441055744.0 - 6755399441055744.0;
    rest = (rest - a) * 16777216.0;
    const double b = rest + 6755399441055744.0 - 6755399441055744.0;
    rest = (rest - b) * 16777216.0;
    const double c = rest + 6755399441055744.0 - 6755399441055744.0;
    const double d = (rest - c) * 16777216.0;
    n = 0.0;
    total = 0.0;
    low = 0.0;
    unit = 1.0;
    for (int64_t j = 0; j < 8; ++j) {
        if (j == 3) {
            n = total + 6755399441055744.0 - 6755399441055744.0;
            total = total - n;
        }
        const double t_1 = product(a, b, c, d, e + j);
        part = t_1 * unit;
        part = part - 4.0 * (0.25 * part + 6755399441055744.0 - 6755399441055744.0);
        high = total;
        total = high + part;
        const double back = total - high;
        low = low + (high - (total - back) + (part - back));
        unit = unit * 5.960464477539063e-08;
    }
    const double split = 134217729.0 * total;
    const double front = split - (split - total);
    high = front * 1.5707963109016418;
    low = (total - front) * 1.5707963109016418 + (total * 1.5893254773528196e-08 + low * 1.5707963267948966);
    const double r = high + low;
    low = high - r + low;
    if (x < 0.0) {
        const double t_2 = quadrant(-n);
        const Record_fff t_3 = { t_2, -r, -low };
        return t_3;
    }
    const double t_4 = quadrant(n);
    const Record_fff t_5 = { t_4, r, low };
    return t_5;
}

static double cosine_of_part(double r, double low)
{
    const double z = r * r;
    const double half = 0.5 * z;
    const double one = 1.0 - half;
    const double rest = 0.041666666666666664 + z * -0.0013888888888887322 + z * z * (2.4801587298651292e-05 + z *
        -2.755731721268659e-07 + z * z * (2.0876134024090145e-09 + z * -1.1381754653662937e-11));
    return one + (1.0 - one - half + (z * z * rest - r * low));
}

static double sine_of_part(double r, double low)
{
    const double z = r * r;
    const double v = z * r;
    const double rest = 0.008333333333333331 + z * -0.00019841269841264821 + z * z * (2.7557319219150783e-06 + z *
        -2.5052106167335705e-08 + z * z * (1.6058521349954986e-10 + z * -7.586094789672621e-13));
    return r - (z * (0.5 * low - v * rest) - low - v * -0.16666666666666666);
}

/* Return the sine of `x` plus some quarters of a turn. */
static double turned(double x, double quarters)
{
    double q = 0.0, r = 0.0, low = 0.0, value = 0.0;

    q = 0.0;
    r = x;
    low = 0.0;
    if (x > -1000000.0 && x < 1000000.0) {
        if (x < -0.785 || x > 0.785) {
            const Record_fff t_1 = reduced(x);
            q = t_1.v0;
            r = t_1.v1;
            low = t_1.v2;
        }
    } else {
        if (x > -HUGE_VAL && x < HUGE_VAL) {
            const Record_fff t_2 = reduced_far(x);
            q = t_2.v0;
            r = t_2.v1;
            low = t_2.v2;
        } else {
            return (double)NAN;
        }
    }
    q = quadrant(q + quarters);
    if (q == 1.0 || q == 3.0) {
        value = cosine_of_part(r, low);
    } else {
        value = sine_of_part(r, low);
    }
    if (q >= 2.0) {
        return -value;
    }
    return value;
}

/* Return the sine of `x` in radians. */
static double sine(double x)
{
    const double t_1 = turned(x, 0.0);
    return t_1;
}

/* Return the cosine of `x` in radians. */
static double cosine(double x)
{
    const double t_1 = turned(x, 1.0);
    return t_1;
}

#endif
