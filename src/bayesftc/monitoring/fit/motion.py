"""The motion of the measured quantity, from the common part of the changes of redundant sensors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import differences, mean, median, window_length, windowed
from bayesftc.monitoring.fit.settings import FIT


@dataclass(frozen=True)
class Motion:
    """The motion of the quantity over a lag."""

    variance: float  # of the difference, in the windows with more motion
    seen: bool = True  # whether it is visible above the noise; if not, `variance` is the most that noise can hide


def common(y: Floats, lag: int, order: int, noise: float) -> Motion:
    """Return the common part of the differences of redundant sensors, without noise and faults of a single sensor.

    In each window it is the median, over the pairs of sensors, of the covariance of their differences. If no single window shows
    motion, the median over all windows can.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    lag, order : int
        Lag and order of the differences.
    noise : float
        Variance of such a difference of one sensor that noise causes.
    """
    x = differences(y, lag, order)
    length = window_length(x, lag)
    x = windowed(x, length)
    variances = mean(x**2)
    moments, errors = (median(np.stack(of, axis=1), 1) for of in zip(*_pairs(x, variances, noise), strict=True))
    if not np.isfinite(moments).any():
        return Motion(0.0, seen=False)
    moves = moments > np.maximum(FIT.seen * errors, 1e-300)
    count = int(np.isfinite(moments).sum())
    if moves.sum() < max(2, FIT.few * count):
        together = float(np.nanmedian(moments))
        error = float(np.nanmedian(errors)) * np.sqrt(np.pi / 2 / count)
        seen = bool(together > FIT.seen * error)
        return Motion(together if seen else max(together, 0.0) + FIT.hidden * error, seen)
    typical = float(np.median(moments[moves]))
    scatter = np.sqrt((1.0 + (1.0 + noise / typical) ** 2) * lag / (1.5 * length))
    # The estimates scatter even if all windows have the same motion. The same quantile of a normal variable corrects for it.
    upper = float(np.quantile(moments[moves], FIT.livelier)) / (1.0 + ndtri(FIT.livelier) * scatter)
    return Motion(max(upper, typical))


def _pairs(x: Floats, variances: Floats, noise: float) -> Iterator[tuple[Floats, Floats]]:
    """Give for each pair of sensors the covariance of their differences in each window, and its standard error.

    The covariance is limited to the smaller variance, so a sensor that drifts away has no more weight than the other.
    """
    for i, j in combinations(range(x.shape[2]), 2):
        products = x[:, :, i] * x[:, :, j]
        moment = np.minimum(mean(products), np.minimum(variances[:, i], variances[:, j]))
        beside = np.maximum(variances[:, i] - moment, noise / 2) * np.maximum(variances[:, j] - moment, noise / 2)
        yield moment, np.sqrt(beside * 1.5 / np.maximum(np.isfinite(products).sum(axis=1), 1))
