"""The disagreement of redundant sensors: the noise and the lasting errors of each, and common errors of two."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import differences, mean, median, window_length, windowed
from bayesftc.monitoring.fit.settings import FIT


@dataclass(frozen=True)
class Noise:
    """The errors of one sensor, or the common errors of a group."""

    white: float  # variance from sample to sample
    lasting: tuple[tuple[float, float], ...]  # variance and time constant in steps of coloured noise, if there is any

    def times(self, factor: float) -> Noise:
        """Return this noise with its variance multiplied by a factor."""
        return Noise(factor * self.white, tuple((factor * variance, constant) for variance, constant in self.lasting))

    def within(self, least: float, factor: float) -> Noise:
        """Return this noise with its variance limited to between `least` and `factor` times `least`."""
        variance = self.variance
        return self.times(float(np.clip(variance, least, factor * least)) / variance) if variance > 0 else self

    @property
    def variance(self) -> float:
        """The total variance."""
        return self.white + sum(variance for variance, _ in self.lasting)


def awake(y: Floats) -> Floats:
    """Return the samples without those of windows in which their sensor does not change: parked car, frozen sensor.

    Such windows do not show the noise. If too few samples would remain, all are kept.
    """
    count = len(y) // FIT.quiet
    kept = y.copy()
    for i, column in enumerate(y.T):
        there = np.flatnonzero(np.isfinite(column))
        changes = np.zeros(len(y), dtype=bool)
        changes[there[1:]] = np.diff(column[there]) != 0
        parts = changes[: count * FIT.quiet].reshape(count, FIT.quiet).any(axis=1)
        asleep = np.append(
            np.repeat(~parts, FIT.quiet), np.full(len(y) - count * FIT.quiet, not changes[count * FIT.quiet :].any())
        )
        if np.isfinite(column[~asleep]).sum() >= FIT.fewest:
            kept[asleep, i] = np.nan
    return kept


def disagreement(y: Floats, lag: int) -> tuple[Floats, Floats]:
    """Return the variance of the disagreement of each pair of sensors over a lag, in each window, and of each sensor.

    For a sensor it is the variance of its differences minus their covariance with the quietest other sensor.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    lag : int
        Lag of the differences in steps.

    Returns
    -------
    apart : ndarray, windows x pairs
    alone : ndarray, windows x sensors
    """
    pairs = list(combinations(range(y.shape[1]), 2))
    apart = differences(np.column_stack([y[:, i] - y[:, j] for i, j in pairs]), lag, 1)
    length = window_length(apart, lag)
    apart, x = windowed(apart, length), windowed(differences(y, lag, 1), length)
    variances = mean(x**2)
    partner = _partners(x, np.argsort(median(variances, 0)))
    return mean(apart**2), np.asarray(variances - mean(x * x[:, :, partner]))


def _partners(x: Floats, quiet: NDArray[np.intp]) -> list[int]:
    """Return for each sensor the first one in the order `quiet` that has samples at its steps; sensors may take turns."""
    there = np.isfinite(x).reshape(-1, x.shape[2]).astype(np.float64)
    shared = there.T @ there
    np.fill_diagonal(shared, -1.0)
    return [int(next(j for j in quiet if j != i and shared[i, j] >= shared[i].max() / 2)) for i in range(len(shared))]


def groups(apart: Floats, sensors: int) -> list[tuple[int, int]]:
    """Return the pairs of sensors that are nearer to each other than to all others; this needs four or more sensors.

    Parameters
    ----------
    apart : ndarray, pairs
        Variance of the difference of each pair.
    sensors : int
        Number of sensors.
    """
    if sensors < 4 or not np.isfinite(apart).all():
        return []
    table = np.full((sensors, sensors), np.nan)
    for (i, j), variance in zip(combinations(range(sensors), 2), apart, strict=True):
        table[i, j] = table[j, i] = variance
    near = []
    for i, j in combinations(range(sensors), 2):
        others = [k for k in range(sensors) if k not in (i, j)]
        if table[i, j] < FIT.alike * min(float(np.median(table[k, others])) for k in (i, j)):
            near.append((i, j))
    return [pair for pair in near if sum(bool(set(pair) & set(other)) for other in near) == 1]


def share_out(apart: Floats, alone: Floats, shared: list[tuple[int, int]]) -> tuple[Floats, Floats]:
    """Return the variances of each sensor and each group that add up to those of the pairs, and the errors of these variances.

    A result is the median over separately solved windows, so a fault affects only the sensor that has it. The equations are
    those of the three-cornered hat (Gray and Allan, 1974), solved by least squares of relative errors. If the quantity moves
    little, a sensor's own differences are more accurate: the estimate that scatters less over the windows is used. Over a lag at
    which few sensors have samples, the pairs may not determine a sensor's variance: only its own differences do. Where nothing
    does, the result is NaN.

    Parameters
    ----------
    apart : ndarray, windows x pairs
        From `disagreement`.
    alone : ndarray, windows x sensors
        From `disagreement`.
    shared : list of tuple of int
        From `groups`.
    """
    sensors = alone.shape[1]
    typical = median(apart, 0)
    valid = np.isfinite(typical) & (typical > 0)
    if not valid.any():
        parts = np.where(np.isfinite(typical).any(), 0.0, np.full(sensors + len(shared), np.nan))
        return parts, np.zeros(len(parts))
    matrix = _equations(sensors, shared)[valid] / typical[valid, None]
    solve = np.linalg.pinv(matrix)
    determined = np.isclose(np.diag(solve @ matrix), 1.0)
    determined[sensors:] = valid.all()  # of two groups, the pairs give only the sum: it is divided evenly
    of_windows = np.where(determined, apart[:, valid] / typical[valid] @ solve.T, np.nan)
    parts, errors = median(of_windows, 0), _error(of_windows)
    if not shared:
        other, errors_alone = median(alone, 0), _error(alone)
        better = (errors_alone < errors) | ~np.isfinite(parts)
        if sensors == 2:  # their motion hides which of them has the noise
            return np.clip(other, FIT.lesser * typical, (1 - FIT.lesser) * typical), errors_alone
        parts, errors = np.where(better, other, parts), np.where(better, errors_alone, errors)
    return np.asarray(np.maximum(parts, 0.0)), errors


def _equations(sensors: int, shared: list[tuple[int, int]]) -> Floats:
    """Return the sum of each pair's variance: which sensors and groups are in it."""
    pairs = combinations(range(sensors), 2)
    return np.array(
        [[float(i in p) for i in range(sensors)] + [float((g[0] in p) != (g[1] in p)) for g in shared] for p in pairs]
    )


def _error(of_windows: Floats) -> Floats:
    """Return the error of the median over windows, up to a factor, from their scatter."""
    count = np.maximum(np.isfinite(of_windows).sum(axis=0), 1)
    return np.asarray(scatter(of_windows, median(of_windows, 0)) / np.sqrt(count))


def scatter(of_windows: Floats, typical: Floats) -> Floats:
    """Return the median distance of the windows' values from the typical value."""
    return median(np.abs(of_windows - typical), 0)


def decompose(lags: Floats, variances: Floats, *, white: bool) -> Noise:
    """Return the white noise and lasting errors whose differences have these variances over these lags, in steps.

    Parameters
    ----------
    lags, variances : ndarray
        Lags and variances of the differences.
    white : bool
        Whether there is white noise. If not, a white part gets the shortest time constant.
    """
    finite = np.isfinite(variances)
    lags, variances = lags[finite], variances[finite]
    lags, variances = (of[lags <= FIT.long * lags[:1]] for of in (lags, variances))
    if not len(lags) or not variances.max() > 0:
        return Noise(0.0, ())
    constants = [0.3] * (not white) + [
        float(lags[0] * 2**power) for power in range(int(np.log2(lags[-1] / lags[0])) + 1)
    ]
    columns = [1.0 - np.exp(-lags / constant) for constant in constants]
    matrix = 2.0 * np.column_stack([np.ones(len(lags))] * white + columns)
    weight = 1.0 / np.maximum(variances, 1e-3 * variances.max())
    parts, _ = nnls(matrix * weight[:, None], variances * weight)
    level, of_constants = (float(parts[0]), parts[1:]) if white else (0.0, parts)
    times = np.asarray(constants)
    lasting = []
    variance = float(of_constants.sum())
    if variance > 0:
        lasting.append((variance, float(np.exp(of_constants @ np.log(times) / variance))))
    if not white:
        return Noise(0.0, tuple(lasting))
    kept = [part for part in lasting if part[0] > FIT.counts * level]
    level += sum(part[0] for part in lasting if part not in kept)
    total = level + sum(part[0] for part in kept)
    if level < FIT.white * total:
        factor = (1 - FIT.white) * total / (total - level)
        level, kept = FIT.white * total, [(factor * variance, constant) for variance, constant in kept]
    return Noise(level, tuple(kept))
