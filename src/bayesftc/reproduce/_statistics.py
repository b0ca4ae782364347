"""The statistics of the experiments: confidence intervals of means and ratios, and tests whether two means differ.

They need two functions of `scipy.special` alone; `scipy.stats`, which has both ready, takes half a second to import.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.block import Floats

ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""Relative difference of two means that rounding alone may make."""


def interval(values: Floats, level: float = 0.95) -> list[float]:
    """Return the confidence interval of the mean of independent values, by Student's t distribution.

    Parameters
    ----------
    values : ndarray of shape (n,)
        At least two.
    level : float
        Probability that the interval covers the mean.
    """
    from scipy.special import stdtrit

    half = stdtrit(len(values) - 1, 0.5 + level / 2) * values.std(ddof=1) / len(values) ** 0.5
    return [float(values.mean() - half), float(values.mean() + half)]


def ratio(ours: Floats, theirs: Floats, level: float = 0.95) -> tuple[float, list[float]]:
    """Return the ratio of the means of paired values, and its confidence interval.

    By the delta method: to first order the ratio r errs as the mean of ``(ours - r theirs) / mean(theirs)`` does, of which
    Student's t gives the interval. What both have in common (their noise) leaves it narrow.

    Parameters
    ----------
    ours, theirs : ndarray of shape (n,)
        At least two pairs; the mean of `theirs` is not zero.
    level : float
        Probability that the interval covers the ratio.
    """
    r = float(ours.mean() / theirs.mean())
    low, high = interval((ours - r * theirs) / theirs.mean(), level)
    return r, [r + low, r + high]


def rms_ratio(ours: Floats, theirs: Floats) -> dict[str, Any]:
    """Return the ratio of two root mean squares over runs with the same noise, and its 95 % confidence interval.

    Parameters
    ----------
    ours, theirs : ndarray of shape (runs,)
        Error of each run; of theirs there may be more, of which the first count.

    Returns
    -------
    dict
        ``ratio``, ``ratio_ci``, ``n`` (number of runs).
    """
    n = len(ours)
    squared, bounds = ratio(ours**2, theirs[:n] ** 2)
    return {"ratio": squared**0.5, "ratio_ci": [max(b, 0.0) ** 0.5 for b in bounds], "n": n}


def outcomes(ours: ArrayLike, theirs: ArrayLike, significance: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return 1 where our mean error is significantly smaller, -1 where it is significantly larger, else 0.

    By Welch's t-test, two-sided. It takes both samples for independent. Ours share their noise run by run, which makes the
    difference of the means more certain than the test believes: it errs towards 0. Means that differ by no more than rounding
    are equal, however little the samples scatter.

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        Errors of each run, at least two.
    significance : float
        Level of the tests.
    """
    from scipy.special import stdtr

    samples = [np.asarray(sample, dtype=np.float64) for sample in (ours, theirs)]
    means = [sample.mean(axis=-1) for sample in samples]
    runs = [sample.shape[-1] for sample in samples]
    # Of each mean; none is taken for zero, so that samples without any scatter have a (huge) statistic as well.
    tiny = np.finfo(np.float64).tiny
    variances = [np.maximum(sample.var(axis=-1, ddof=1) / n, tiny) for sample, n in zip(samples, runs, strict=True)]
    difference, variance = means[1] - means[0], variances[0] + variances[1]
    # Shares instead of squares, which would vanish where the variances are small.
    freedom = 1.0 / sum((v / variance) ** 2 / (n - 1) for v, n in zip(variances, runs, strict=True))
    p = 2.0 * stdtr(freedom, -np.abs(difference) / np.sqrt(variance))
    differ = np.abs(difference) > ROUNDING * np.maximum(np.abs(means[0]), np.abs(means[1]))
    return np.where(differ & (p < significance), np.sign(difference), 0).astype(np.int64)
