"""Confidence intervals of means, and of ratios of means.

They need only one function of `scipy.special`, because importing `scipy.stats` takes half a second.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError

Method = Literal["BCa", "percentile", "basic"]
METHODS = ("BCa", "percentile", "basic")
LARGEST = 10_000_000
"""Largest number of values that the bootstrap draws at a time: 80 MB."""


def interval(values: ArrayLike, level: float = 0.95) -> list[float]:
    """Return the confidence interval of the mean of independent values, by Student's t distribution.

    Parameters
    ----------
    values : array_like of shape (n,)
        At least two.
    level : float
        Probability that the interval covers the mean.

    Returns
    -------
    list of float
        Lower and upper bound, in the unit of the values.

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> errors = [0.41, 0.52, 0.47, 0.55, 0.40]
    >>> [round(bound, 3) for bound in statistics.interval(errors)]
    [0.388, 0.552]
    """
    from scipy.special import stdtrit

    values = np.asarray(values, dtype=np.float64)
    half = stdtrit(len(values) - 1, 0.5 + level / 2) * values.std(ddof=1) / len(values) ** 0.5
    return [float(values.mean() - half), float(values.mean() + half)]


def ratio(ours: ArrayLike, theirs: ArrayLike, level: float = 0.95) -> tuple[float, list[float]]:
    """Return the ratio of the means of paired values, and its confidence interval.

    By the delta method: to first order the error of the ratio r is that of the mean of ``(ours - r theirs) / mean(theirs)``,
    whose interval is by Student's t. Noise that both have in common does not widen it.

    Parameters
    ----------
    ours, theirs : array_like of shape (n,)
        At least two pairs; the mean of `theirs` is not zero.
    level : float
        Probability that the interval covers the ratio.

    Returns
    -------
    float, list of float
        The ratio, and the lower and upper bound.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> theirs = np.array([1.0, 2.0, 3.0, 4.0])
    >>> ratio, (low, high) = statistics.ratio(0.5 * theirs + np.array([0.1, -0.1, 0.1, -0.1]), theirs)
    >>> round(ratio, 3), round(low, 3), round(high, 3)
    (0.5, 0.427, 0.573)
    """
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    r = float(ours.mean() / theirs.mean())
    low, high = interval((ours - r * theirs) / theirs.mean(), level)
    return r, [r + low, r + high]


def rms_ratio(ours: ArrayLike, theirs: ArrayLike, *, resamples: int = 0, seed: int = 0) -> dict[str, Any]:
    """Return the ratio of two root mean squares over runs with the same noise, and its 95 % confidence interval.

    By the delta method (`ratio`), or by the percentiles of the paired bootstrap, which suits errors that are many times larger
    in a few runs than in the others.

    Parameters
    ----------
    ours, theirs : array_like of shape (runs,)
        Error of each run. If `theirs` has more runs, the first count.
    resamples : int
        Number of samples of pairs that the bootstrap draws; 0 for the delta method.
    seed : int
        Seed of the draws: the same seed gives the same interval.

    Returns
    -------
    dict
        ``ratio``, ``ratio_ci`` (lower and upper bound), ``n`` (number of runs).

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> ours, theirs = [0.4, 0.5, 0.3, 0.6], [0.8, 0.9, 0.7, 1.1]
    >>> figures = statistics.rms_ratio(ours, theirs)
    >>> round(figures["ratio"], 2), [round(bound, 2) for bound in figures["ratio_ci"]], figures["n"]
    (0.52, [0.45, 0.59], 4)
    """
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    n = len(ours)
    squared, bounds = ratio(ours**2, theirs[:n] ** 2)
    if resamples:
        drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=resamples)
        bounds = np.quantile((drawn @ ours**2) / (drawn @ theirs[:n] ** 2), [0.025, 0.975]).tolist()
    return {"ratio": squared**0.5, "ratio_ci": [max(b, 0.0) ** 0.5 for b in bounds], "n": n}


def bootstrap_interval(
    values: ArrayLike, level: float = 0.95, *, method: Method = "BCa", resamples: int = 9_999, seed: int = 0
) -> list[float]:
    """Return the confidence interval of the mean of independent values by the bootstrap, which assumes no distribution.

    By `scipy.stats.bootstrap`.

    Parameters
    ----------
    values : array_like of shape (n,)
        At least two.
    level : float
        Probability that the interval covers the mean.
    method : str
        ``"BCa"`` (bias-corrected and accelerated, Efron 1987; its time grows with the square of n), ``"percentile"`` or
        ``"basic"``.
    resamples : int
        Number of samples.
    seed : int
        Seed of the draws: the same seed gives the same interval.

    Returns
    -------
    list of float
        Lower and upper bound, in the unit of the values.

    Raises
    ------
    ModelError
        If there is no such method.

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> errors = [0.41, 0.52, 0.47, 0.55, 0.40, 0.44, 0.49, 2.50]  # one run is an outlier
    >>> [round(bound, 1) for bound in statistics.bootstrap_interval(errors)]
    [0.5, 1.5]
    """
    from scipy.stats import bootstrap

    if method not in METHODS:
        raise ModelError(f"The bootstrap has no method {method!r}; use one of {', '.join(map(repr, METHODS))}.")
    values = np.asarray(values, dtype=np.float64)
    if np.ptp(values) == 0:  # BCa would divide by zero; the bootstrap of equal values is that value
        return [float(values[0])] * 2
    bounds = bootstrap(
        (values,),
        np.mean,
        n_resamples=resamples,
        batch=max(LARGEST // len(values), 1),
        confidence_level=level,
        method=method,
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return [float(bounds.low), float(bounds.high)]


def check_level(level: float) -> None:
    """Raise an error if a level of confidence is not between 0 and 1."""
    if not 0 < level < 1:
        raise ModelError(f"level is {level!r}; it must be a probability between 0 and 1, such as 0.95.")


__all__ = ["Method", "bootstrap_interval", "check_level", "interval", "ratio", "rms_ratio"]
