"""The functions of `bayesftc.cosim.elementary` against mpmath, over all doubles, and their special values of C99."""

import math

import mpmath
import numpy as np
import pytest

from bayesftc.cosim import ops

RANDOM = np.random.default_rng(11)
MOST, LEAST, TINY = np.finfo(float).max, 5e-324, 2.0**-1022
INF, NAN = math.inf, math.nan

CIRCLE = [(-0.8, 0.8), (-30.0, 30.0), (-1e6, 1e6), (1e6, 1e9), (1e6, MOST)]
RANGES = {
    "cos": CIRCLE,
    "exp": [(-708.0, 709.78), (-745.13, -660.0), (-0.36, 0.36), (-3.0, 3.0), (708.0, 709.782)],
    "log": [(0.5, 2.0), (0.69, 0.72), (1.39, 1.43), (0.99999, 1.00001), (LEAST, 1e-300), (1e300, MOST), (1.0, 1e4)],
    "sin": CIRCLE,
}
SPECIAL = {
    "cos": [(0.0, 1.0), (-0.0, 1.0), (LEAST, 1.0), (INF, NAN), (-INF, NAN), (NAN, NAN), (1e22, 0.5232147853951389)],
    "sin": [
        (0.0, 0.0), (-0.0, -0.0), (LEAST, LEAST), (INF, NAN), (-INF, NAN), (NAN, NAN), (1e22, -0.8522008497671888),
        (math.pi, 1.2246467991473532e-16), (-1e22, 0.8522008497671888),
    ],
    "exp": [
        (0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, 0.0), (NAN, NAN), (MOST, INF), (-MOST, 0.0), (709.7827128933841, INF),
        (709.782712893384, 1.797693134862273e308), (-745.1332191019411, LEAST), (-745.1332191019412, 0.0), (LEAST, 1.0),
    ],
    "log": [
        (0.0, -INF), (-0.0, -INF), (1.0, 0.0), (INF, INF), (-INF, NAN), (NAN, NAN), (-1.0, NAN), (-LEAST, NAN),
        (LEAST, -744.4400719213812), (MOST, 709.782712893384), (TINY, -708.3964185322641),
    ],
}  # fmt: skip


def samples(name, count):
    """Return numbers of each range, all binades, the ends of reductions, and bits at random."""
    numbers = [RANDOM.uniform(*between, count) for between in RANGES[name]]
    numbers.append(RANDOM.uniform(1, 2, count) * 2.0 ** RANDOM.integers(-1074, 1023, count))
    halves = (RANDOM.integers(-1000, 1000, count) + 0.5) * math.log(2)
    numbers.append(np.nextafter(halves if name == "exp" else np.exp(np.clip(halves, -700, 700)), 0))
    if name in {"cos", "sin"}:  # the doubles next to multiples of pi / 2, where the reduction needs most digits
        n = RANDOM.integers(
            1, 2 ** RANDOM.integers(1, 20, count)
        )  # where a shorter reduction just suffices, and just not
        numbers.append(n * (math.pi / 2 + RANDOM.choice([-1.2e-7, 1.2e-7], count) * RANDOM.uniform(0.5, 2.0, count)))
        with mpmath.workprec(1200):
            near = [mpmath.mpf(int(n)) * mpmath.pi / 2 for n in RANDOM.integers(1, 2 ** RANDOM.integers(1, 62, count))]
            numbers.append(np.array([float(number) for number in [*near, mpmath.mpf(2) ** 797 * 6381956970095103]]))
    numbers.append(RANDOM.integers(0, 2**64, count, dtype=np.uint64).view(float))
    x = np.concatenate(numbers)
    x = np.where(RANDOM.uniform(size=len(x)) < 0.5, x, -x) if name != "log" else np.abs(x)
    return x[np.isfinite(x)].tolist()


def units(result, x, function):
    """Return the error of a result in units in the last place of the true value."""
    with mpmath.workprec(200 if abs(x) < 1e6 else 1400):
        true = function(mpmath.mpf(x))
        return float(abs(mpmath.mpf(result) - true) / math.ulp(float(true)))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("count", [150, pytest.param(600, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", RANGES)
def test_the_error_is_below_one_unit_in_the_last_place(name, count):
    function, operation = getattr(mpmath, name), getattr(ops, name)
    results = ((x, float(operation(x))) for x in samples(name, count))
    worst = max((units(y, x, function), x) for x, y in results if math.isfinite(y))
    assert 0.5 < worst[0] < 0.95, worst


@pytest.mark.parametrize(("name", "x", "expected"), [(name, *pair) for name in SPECIAL for pair in SPECIAL[name]])
def test_special_values(name, x, expected):
    with np.errstate(all="raise"):
        y = getattr(ops, name)(np.float64(x))
    assert isinstance(y, np.float64)
    if math.isnan(expected):
        assert math.isnan(y)
    elif math.isinf(expected) or expected in {0.0, 1.0, LEAST}:
        assert y == expected
        assert math.copysign(1.0, y) == math.copysign(1.0, expected)
    else:
        assert abs(y - expected) <= math.ulp(expected)
