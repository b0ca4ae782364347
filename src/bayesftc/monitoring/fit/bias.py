"""Slow differences between redundant sensors: constant biases and wandering biases."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.special import ndtri

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.settings import FIT


def biases(y: Floats) -> Floats:
    """Return the constant difference of each sensor from the typical one; their median is 0.

    It is the median of a sensor's differences from all sensors, each the median over the steps at which both have a sample: which
    sensors are there at a step does not matter.
    """
    apart = np.array([median(column[:, None] - y, 0) for column in y.T])
    bias = median(apart, 1)
    return np.asarray(bias - np.median(bias))


def wander(y: Floats, quantile: float) -> tuple[Floats, Floats]:
    """Return the variance of each sensor's wandering bias, 0 if there is none, and its time constant in steps.

    The difference of two sensors has a median in each of many parts of the recording. Each of the two sensors gets half of the
    variance of these medians. A sensor's result is the median over its pairs (the lower one of two), as another sensor may fail.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples without the constant biases.
    quantile : float
        Quantile of the medians' distances: the larger, the more weight has a rare fault or a rare wandering.
    """
    length = max(len(y) // FIT.blocks, FIT.least_block)
    count, sensors = len(y) // length, y.shape[1]
    pairs = list(combinations(range(sensors), 2))
    apart = np.column_stack([y[:, i] - y[:, j] for i, j in pairs])[: count * length].reshape(count, length, -1)
    levels = median(apart, 1)
    samples = np.maximum(np.isfinite(apart).sum(axis=1), 1)
    noise = (MAD * median(np.abs(apart - levels[:, None, :]), 1)) ** 2 * (np.pi / 2) / samples
    of_noise = median(noise, 0)
    finite = np.isfinite(levels).any(axis=0)
    far = np.zeros(len(pairs))
    far[finite] = np.nanquantile(np.abs(levels - median(levels, 0))[:, finite], quantile, axis=0)
    total = np.asarray(far / ndtri((1 + quantile) / 2)) ** 2
    steps = (MAD * median(np.abs(np.diff(levels, axis=0)), 0)) ** 2
    variance = np.nan_to_num(np.where(total > FIT.certain * of_noise, total - of_noise, 0.0))
    correlation = 1.0 - (steps / 2 - of_noise) / np.where(variance > 0, variance, np.inf)  # from part to part
    lasting = length / -np.log(np.clip(np.where(variance > 0, correlation, 0.0), 0.3, 0.95))
    of = [[k for k, pair in enumerate(pairs) if i in pair] for i in range(sensors)]
    lower = [float(np.quantile(variance[k], 0.5, method="lower")) / 2 for k in of]
    return np.array(lower), np.array([np.median(lasting[k]) for k in of])
