"""Weighted sums of chi-squares, ``x = sum_k w_k z_k**2`` with standard normal z_k: both tails to ten digits.

Imhof (Biometrika 48, 1961) and Davies (Applied Statistics 29, 1980) invert the characteristic function along the imaginary axis.
The integrand there oscillates and decays slowly, so that a small probability is lost in the error. Here the path is a parabola
through the saddlepoint, as Rice recommends (SIAM J. Sci. Stat. Comput. 1, 1980). With M(s) = prod_k (1 - 2 w_k s)**(-1/2),

    Pr[x > X] = 1 / (2 pi i) * integral of M(s) exp(-s X) / s ds

along any path from below to above that crosses the real axis between the pole at 0 and the first branch point 1 / (2 max w).
Left of 0 the integral is -Pr[x <= X]. On ``s = c + kappa y**2 + i y`` the integrand decays like a Gaussian, and the trapezoidal
rule converges geometrically: the step is halved until the result is constant.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

PRECISE = 1e-11
"""Relative change at which halving the step ends."""

LEAST_WEIGHT = 1e-6
"""Smallest geometric weight; the rest counts by its mean, because its variance is 1e-12 of the whole."""

MOST_HALVINGS = 12

NODES = 11
"""Number of weights that represent one octave: with Gauss's rule for sums log M has twelve digits."""


class Weights(NamedTuple):
    """Weights, the number of squares of each (not whole for a rule of summation), and the sum's mean."""

    weights: Floats
    counts: Floats
    mean: float


def equal_weights(count: int) -> Weights:
    """Return `count` weights of 1."""
    return Weights(np.ones(1), np.full(1, float(count)), float(count))


def geometric_weights(ratio: float) -> Weights:
    """Return 1, ratio, ratio**2, ... for a ratio in (0, 1); a few dozen represent thousands."""
    octave = int(np.ceil(np.log(0.5) / np.log(ratio)))
    octaves = int(np.ceil(np.log2(1.0 / LEAST_WEIGHT)))
    places, counts = (np.arange(octave), np.ones(octave)) if octave <= NODES else _gauss_sum(octave)
    weights = np.asarray(ratio ** (places + octave * np.arange(octaves)[:, None]).ravel())
    return Weights(weights, np.tile(counts, octaves), 1.0 / (1.0 - ratio))


def _gauss_sum(count: int) -> tuple[Floats, Floats]:
    """Return nodes and counts that sum polynomials up to the degree 2 `NODES` - 1 over 0, 1, ... count - 1 exactly.

    They come from eigenvalues and eigenvectors of the Jacobi matrix of Gram's discrete polynomials.
    """
    k = np.arange(1.0, NODES)
    off = np.sqrt(k**2 * (float(count) ** 2 - k**2) / (4.0 * (4.0 * k**2 - 1.0)))
    places, vectors = np.linalg.eigh(np.diag(np.full(NODES, (count - 1) / 2)) + np.diag(off, 1) + np.diag(off, -1))
    return places, count * vectors[0] ** 2


def tails(x: float, sum_of: Weights) -> tuple[float, float]:
    """Return Pr[sum <= x] and Pr[sum > x]; the smaller of both has a relative error below 1e-9."""
    w, counts, mean = sum_of
    x = x - (mean - float(counts @ w))  # the omitted weights count by their mean
    if x <= 0:
        return 0.0, 1.0
    upper = x >= counts @ w
    c = _saddle(x, w, counts, bool(upper))
    factors = 2.0 * w / (1.0 - 2.0 * w * c)
    second = 0.5 * float(counts @ factors**2) + 1.0 / c**2
    third = float(counts @ factors**3) - 2.0 / c**3
    width = 1.0 / np.sqrt(second)
    # Near steepest descent, but bent enough to decay, and not so much that M grows first.
    kappa = min(max(third / (6.0 * second), 0.01 / width), 0.03 / width)
    level = -0.5 * float(counts @ np.log1p(-2.0 * w * c)) - c * x

    def along(u: Floats) -> Floats:
        y = width * u
        s = c + kappa * y**2 + 1j * y
        real, imaginary = 1.0 - 2.0 * np.outer(s.real, w), -2.0 * np.outer(y, w)
        # The path never crosses the cut beyond the branch point, so that each factor has its principal branch.
        logarithm = -0.25 * np.log(real**2 + imaginary**2) @ counts - 0.5j * (np.arctan2(imaginary, real) @ counts)
        logarithm = logarithm - s * x - level
        return np.asarray(np.imag(np.exp(logarithm) / s * (2.0 * kappa * y + 1j)) * width)

    area = float(np.exp(level)) * _half_line(along) / np.pi
    return (1.0 - area, area) if upper else (-area, 1.0 + area)


def quantile(probability: float, sum_of: Weights, *, upper: bool = True) -> float:
    """Return the value that the sum exceeds (or, with ``upper=False``, does not exceed) with a probability in (0, 1)."""
    from scipy.optimize import brentq

    def gap(x: float) -> float:
        below, above = tails(x, sum_of)
        return float(np.log(max(above if upper else below, 1e-300) / probability))

    deviation = float(np.sqrt(2.0 * sum_of.counts @ sum_of.weights**2))
    low = high = sum_of.mean
    while (gap(low) > 0) != upper:
        low = max(low - deviation, 0.5 * low)
    while (gap(high) < 0) != upper:
        high += deviation
    return float(brentq(gap, low, high, xtol=1e-9 * deviation, rtol=1e-12))


def _saddle(x: float, w: Floats, counts: Floats, upper: bool) -> float:
    """Return the minimum of M(s) exp(-s x) / |s| on the real axis: between 0 and the branch point, or left of 0."""
    from scipy.optimize import brentq

    def slope(s: float) -> float:
        return float(counts @ (w / (1.0 - 2.0 * w * s)) - x - 1.0 / s)

    if upper:
        end = 0.5 / float(w.max())
        return float(brentq(slope, 1e-12 * end, end * (1.0 - 1e-12)))
    left = -1.0 / x
    while slope(left) > 0:
        left *= 2.0
    return float(brentq(slope, left, -1e-12 / x))


def _half_line(integrand: Callable[[Floats], Floats]) -> float:
    """Integrate a decaying even function over the positive half line by the trapezoidal rule."""
    middle, end = float(integrand(np.zeros(1))[0]), 8.0
    while abs(integrand(np.array([end]))[0]) > 1e-15 * abs(middle):
        end *= 1.2
    step = 0.25
    total = 0.5 * middle + float(integrand(step * np.arange(1.0, int(end / step) + 1)).sum())
    for _ in range(MOST_HALVINGS):
        before, step = step * total, step / 2
        total += float(integrand(step * np.arange(1.0, int(end / step) + 1, 2.0)).sum())
        if abs(step * total - before) <= PRECISE * abs(before):
            break
    return step * total
