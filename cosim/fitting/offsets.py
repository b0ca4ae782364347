"""Constant differences between the redundant sensors of an output: errors of calibration, and no faults of a while."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats

PARTS = 10
"""Parts of a recording, each with its level: a fault in fewer than half of them hardly moves the median of the levels."""

OUTLYING = 3.0
"""Standard deviations of the levels from which on one is that of a fault."""

FEWEST = 5
"""Least number of samples of a part: the median of fewer is hardly better than a sample."""

AGREE = 0.1
"""Share of the largest offset below which one counts as none."""

STEADY = 0.5
"""Largest scatter of the levels, relative to their median, of a difference that is constant.

A sensor that drifts from 0 on, through all the recording, has 0.61. Two sensors without a difference, with white noise, are below
in about 1 % of recordings, more often with errors that last.
"""


def constant_offsets(residuals: Floats, output_of: np.ndarray[Any, np.dtype[np.int64]]) -> Floats:
    """Return what each sensor constantly reads more than the common reading of the sensors of its output.

    The common reading of two sensors is their mean, weighted by the precision of each: which of them errs is open. Of more
    sensors it is the weighted median, on which one that errs has no effect. Differences that are not constant count as 0.

    Parameters
    ----------
    residuals : ndarray, steps x sensors
        Differences between samples and model; NaN where there is no sample.
    output_of : ndarray, sensors
        The number of each sensor's output.

    Returns
    -------
    ndarray, sensors
    """
    offsets = np.zeros(residuals.shape[1])
    for output in np.unique(output_of):
        members = np.flatnonzero(output_of == output)
        every = np.array([[_constant(residuals[:, i] - residuals[:, k]) for i in members] for k in members])
        levels = every[np.argmin(np.count_nonzero(every, axis=1))]  # beside a sensor that agrees with most others
        if levels.any():
            offsets[members] = levels - _common(levels, _precisions(residuals[:, members]))
    return offsets


def std_of_common(offsets: Floats, output_of: np.ndarray[Any, np.dtype[np.int64]]) -> Floats:
    """Return the standard deviation of the error of each output's common reading (sensors), NaN without offsets.

    If one of the sensors is right, the reading errs by the offset of this one: the root mean square of the offsets. If most
    sensors agree, they are right, and it is the median of the magnitudes, about 0.
    """

    def std(own: Floats) -> float:
        if not own.any():
            return float("nan")
        agreeing = np.count_nonzero(own < AGREE * own.max())
        return float(np.median(own) if 2 * agreeing > len(own) else np.sqrt(np.mean(own**2)))

    return np.array([std(np.abs(offsets[output_of == output])) for output in output_of])


def levels_of_parts(residuals: Floats) -> Floats:
    """Return what each sensor of an output reads more than their median in each of ten parts (parts x sensors).

    Parts in which a sensor has no sample are left out.
    """
    parts = [part for part in np.array_split(residuals, PARTS) if np.isfinite(part).any(axis=0).all()]
    medians = [np.nanmedian(part, axis=0) for part in parts]
    return np.array([levels - np.median(levels) for levels in medians]).reshape(-1, residuals.shape[1])


def _constant(differences: Floats) -> float:
    """Return the median of the levels of ten parts, without outliers; 0 if the others scatter too much for a constant."""
    there = differences[np.isfinite(differences)]
    if len(there) < PARTS * FEWEST:
        return 0.0
    levels = np.array([np.median(part) for part in np.array_split(there, PARTS)])
    apart = np.abs(levels - np.median(levels))
    usual = apart <= OUTLYING * MAD * np.median(apart)
    level = float(np.median(levels[usual]))
    if len(levels[~usual]) and abs(np.median(levels[~usual])) < STEADY * abs(level):
        return 0.0  # without the difference at first, or in the end: a fault that lasts for most of the recording
    return level if np.std(levels[usual], ddof=1) < STEADY * abs(level) else 0.0


def _precisions(residuals: Floats) -> Floats:
    variances = np.nanmedian(np.abs(residuals - np.nanmedian(residuals, axis=0)), axis=0) ** 2
    return np.asarray(1.0 / np.maximum(variances, np.finfo(float).eps * variances.max() + np.finfo(float).tiny))


def _common(levels: Floats, precisions: Floats) -> float:
    if len(levels) == 2:
        return float(np.average(levels, weights=precisions))
    order = np.argsort(levels)
    share = np.cumsum(precisions[order])
    return float(levels[order][np.searchsorted(share, share[-1] / 2)])
