"""How far the measured quantity itself moves, from what redundant sensors have in common."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import differences, mean, median, windowed
from bayesftc.monitoring.fit.settings import FIT


@dataclass(frozen=True)
class Motion:
    """How far the quantity moves over a lag."""

    variance: float  # of the difference, in the livelier windows
    seen: bool = True  # whether it is told from noise; else `variance` is what may hide in it


def common(y: Floats, lag: int, order: int, noise: float) -> Motion:
    """Return what the differences of redundant sensors have in common: no noise, and no fault of a single sensor.

    In each window it is the median over the pairs of sensors of the covariance of their differences. Where no window shows
    it by itself, the median over all windows may.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    lag, order : int
        Of the differences.
    noise : float
        Variance that noise gives to such a difference of one sensor.
    """
    x = windowed(differences(y, lag, order), lag)
    length = x.shape[1]
    own = mean(x**2, 1)
    moments, errors = (median(np.stack(of, axis=1), 1) for of in zip(*_pairs(x, own, noise), strict=True))
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
    # Windows that all move alike scatter as well: the same quantile of a normal variable corrects for it.
    upper = float(np.quantile(moments[moves], FIT.livelier)) / (1.0 + ndtri(FIT.livelier) * scatter)
    return Motion(max(upper, typical))


def _pairs(x: Floats, own: Floats, noise: float) -> Iterator[tuple[Floats, Floats]]:
    """Give for each pair of sensors the covariance of their differences in each window, and its standard error.

    The covariance is no more than the lesser variance: of a sensor that runs away no more counts than what the other shows.
    """
    for i, j in combinations(range(x.shape[2]), 2):
        moment = np.minimum(mean(x[:, :, i] * x[:, :, j], 1), np.minimum(own[:, i], own[:, j]))
        beside = np.maximum(own[:, i] - moment, noise / 2) * np.maximum(own[:, j] - moment, noise / 2)
        yield moment, np.sqrt(beside * 1.5 / x.shape[1])
