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


def windowed(x: Floats, lag: int) -> Floats:
    """Return differences in windows (windows x samples x signals), with clipped outliers.

    The scale of a window comes only from its nonzero differences, so repeated samples or a coarse resolution do not shrink it.

    Parameters
    ----------
    x : ndarray, steps x signals
        Differences.
    lag : int
        Lag of the differences in steps.
    """
    length = max(min(max(FIT.least_window, FIT.window * lag), len(x) // FIT.fewest_windows), 1)
    count = len(x) // length
    x = x[: count * length].reshape(count, length, x.shape[1])
    size = np.abs(x)
    limit = FIT.clip * MAD * median(np.where(size > 0, size, np.nan), 1)[:, None, :]
    limit = np.where(np.isfinite(limit), limit, 0.0)
    return np.asarray(np.clip(x, -limit, limit))


def mean(values: Floats, axis: int) -> Floats:
    """Return the mean along an axis without NaN; NaN if fewer than three values, or a tenth of them, remain."""
    finite = np.isfinite(values)
    count = finite.sum(axis=axis)
    enough = (count >= 3) & (count >= values.shape[axis] / 10)
    return np.asarray(np.where(enough, np.where(finite, values, 0.0).sum(axis=axis) / np.maximum(count, 1), np.nan))
