"""Autocorrelations of residuals with gaps, and the test of Ljung and Box (Biometrika 65, 1978) whether they are white."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.cosim.types import Floats

LAGS = 20
"""Largest lag of the residuals' autocorrelations."""

FEW = 2 * LAGS
"""Least number of samples for the test."""


def whiteness(residual: Floats) -> tuple[float, float]:
    """Return the probability that white noise is as correlated in time as the residual, and the largest autocorrelation."""
    from scipy.stats import chi2

    correlations, pairs = autocorrelation(residual)
    n, present = int(np.isfinite(residual).sum()), pairs > 0
    statistic = (n + 2) / n * float(np.sum(pairs[present] * correlations[present] ** 2))
    return float(chi2.sf(statistic, present.sum())), float(np.abs(correlations[pairs >= FEW]).max(initial=0.0))


def autocorrelation(residual: Floats) -> tuple[Floats, np.ndarray[Any, np.dtype[np.int64]]]:
    """Return the autocorrelations at the lags 1 to `LAGS` (0 without samples), and the number of pairs of samples of each."""
    present = np.isfinite(residual)
    e = np.where(present, residual - np.nanmean(residual), 0.0)
    power = float(e @ e) / max(present.sum(), 1)
    products = np.array([float(e[lag:] @ e[:-lag]) for lag in range(1, LAGS + 1)])
    pairs = np.array([int((present[lag:] & present[:-lag]).sum()) for lag in range(1, LAGS + 1)])
    return products / np.maximum(pairs, 1) / (power if power > 0 else 1.0), pairs
