"""Where an FMU has not recovered from a gap of the recording: without inputs, its state after the gap is unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.fitting.samples import Samples
    from bayesftc.cosim.judging.signals import Flags

WINDOW = 50
"""Samples whose median shows the error of the FMU: a fifth of the noise remains, and outliers have no effect."""

USUAL = 3 * MAD
"""Multiple of the median of such errors up to which one is usual: three standard deviations of normal numbers."""


def recovering(samples: Samples, outputs: Floats, least: Floats) -> Flags:
    """Return the samples after each gap up to the first one from which on the FMU follows the sensors again.

    It follows a sensor if medians of the next residuals are as near to the typical residual as before the first gap. It
    must follow half of the sensors, because others may have failed. If it never does, all samples up to the end are meant. An FMU
    without inputs in the recording has no such samples.

    Parameters
    ----------
    samples : Samples
        The recording.
    outputs : ndarray, steps x outputs
        The outputs of the FMU.
    least : ndarray, sensors
        Least usual residual of each sensor, for recordings without noise.

    Returns
    -------
    ndarray, steps x sensors
        Whether the sample follows a gap from which the FMU has not recovered.
    """
    late: Flags = np.zeros(samples.y.shape, dtype=bool)
    if not samples.gaps or not samples.inputs:
        return late
    residuals = samples.y - outputs[:, samples.output_of]
    follows = np.column_stack(
        [_follows(*pair, samples.gaps[0][0]) for pair in zip(residuals.T, least.tolist(), strict=True)]
    )
    for j in range(outputs.shape[1]):
        sensors = samples.output_of == j
        steps = np.flatnonzero(2 * follows[:, sensors].sum(axis=1) >= sensors.sum())
        for _, end in samples.gaps:
            later = steps[np.searchsorted(steps, end) :]
            late[end : later[0] if len(later) else None, sensors] = True
    return late & np.isfinite(samples.y)


def _follows(residuals: Floats, least: float, first_gap: int) -> Flags:
    """Return the steps from which on the next residuals are as before the first gap; all, if there are too few to tell.

    If there are too few before the gap, they are compared with all.
    """
    there = np.flatnonzero(np.isfinite(residuals))
    if len(there) < 2 * WINDOW:
        return np.ones(len(residuals), dtype=bool)
    windows, found = np.lib.stride_tricks.sliding_window_view, residuals[there]
    known = int(np.searchsorted(there, first_gap, side="right"))
    known = known if known >= 2 * WINDOW else len(there)
    errors = np.abs(np.median(windows(found - np.median(found[:known]), WINDOW), axis=1))
    largest = windows(np.append(errors, np.zeros(WINDOW - 1)), WINDOW).max(axis=1)  # since an error may cross 0
    usual = largest <= max(USUAL * float(np.median(errors[: known - WINDOW + 1])), least)
    usual = np.append(usual, np.full(WINDOW - 1, usual[-1]))
    return np.asarray(usual[np.minimum(np.searchsorted(there, np.arange(len(residuals))), len(there) - 1)])
