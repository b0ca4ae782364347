"""Robust moments of differences over many short windows, for the motion of a quantity and the noise of its sensors."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.settings import FIT


def median(values: Floats, axis: int) -> Floats:
    """Return the median along an axis without NaN (NaN if there is nothing else); much faster than numpy's nanmedian."""
    ordered = np.sort(values, axis=axis)  # NaN comes last
    count = np.isfinite(ordered).sum(axis=axis, keepdims=True)
    low, high = (np.take_along_axis(ordered, np.maximum(at, 0), axis) for at in ((count - 1) // 2, count // 2))
    return np.asarray(np.where(count > 0, (low + high) / 2, np.nan).squeeze(axis))


def differences(y: Floats, lag: int, order: int) -> Floats:
    """Return differences of an order over a lag along the first axis; NaN where a sample is missing."""
    for _ in range(order):
        y = y[lag:] - y[:-lag]
    return y


def window_length(x: Floats, lag: int) -> int:
    """Return the length of windows in steps, such that the signal with most differences has enough of them in each.

    Parameters
    ----------
    x : ndarray, steps x signals
        Differences; NaN where a sample is missing.
    lag : int
        Their lag in steps.
    """
    share = max(float(np.isfinite(x).mean(axis=0).max(initial=0.0)), 1 / max(len(x), 1))
    return max(min(max(int(FIT.least_window / share), FIT.window * lag), len(x) // FIT.fewest_windows), 1)


def windowed(x: Floats, length: int) -> Floats:
    """Return differences in windows (windows x samples x signals), with clipped outliers.

    The scale of a window comes only from its nonzero differences, so repeated samples or a coarse resolution do not shrink it.

    Parameters
    ----------
    x : ndarray, steps x signals
        Differences.
    length : int
        Length of a window in steps.
    """
    count = len(x) // length
    x = x[: count * length].reshape(count, length, x.shape[1])
    size = np.abs(x)
    limit = FIT.clip * MAD * median(np.where(size > 0, size, np.nan), 1)[:, None, :]
    limit = np.where(np.isfinite(limit), limit, 0.0)
    return np.asarray(np.clip(x, -limit, limit))


def mean(values: Floats) -> Floats:
    """Return the mean of each window (the second axis) without NaN.

    It is NaN if a window has fewer than three values, or a tenth of those of the fullest window: a sensor may have samples in
    few of the steps.
    """
    finite = np.isfinite(values)
    count = finite.sum(axis=1)
    enough = (count >= 3) & (count >= count.max(axis=0, initial=0) / 10)
    return np.asarray(np.where(enough, np.where(finite, values, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan))


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value with half of the weight below it, between two values in proportion; NaN counts for nothing."""
    there = np.isfinite(values) & (weights > 0)
    if not there.any():
        return float("nan")
    order = np.argsort(values[there])
    values, weights = values[there][order], weights[there][order]
    return float(np.interp(0.5, (np.cumsum(weights) - weights / 2) / weights.sum(), values))
