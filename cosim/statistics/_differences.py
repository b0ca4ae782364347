"""Tests for the difference of two means: Welch's and the paired t-test, rank tests, corrections for many tests.

The t-tests take many pairs of samples at a time. Means that differ by no more than rounding count as equal (p is 1), even if the
samples scatter very little.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

TINY = np.finfo(np.float64).tiny
"""Stands for a standard error of zero."""

ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""Largest relative difference of two means that rounding may cause."""

Correction = Literal["bonferroni", "holm", "benjamini-hochberg"]
CORRECTIONS = ("bonferroni", "holm", "benjamini-hochberg")


class Difference(NamedTuple):
    """A difference of two means and its t-test; each field is a number, or an array for many pairs of samples.

    Attributes
    ----------
    mean : float
        Mean of `ours` minus mean of `theirs`.
    error : float
        Its standard error.
    freedom : float
        Degrees of freedom of Student's t.
    p : float
        Probability, if the means are equal, of a difference at least as large, in either direction.
    """

    mean: Any
    error: Any
    freedom: Any
    p: Any

    def interval(self, level: float) -> list[float]:
        """Return the confidence interval of a single difference.

        Parameters
        ----------
        level : float
            Probability that the interval contains the difference.
        """
        from scipy.special import stdtrit

        half = stdtrit(self.freedom, 0.5 + level / 2) * (self.error if self.error > TINY else 0.0)
        return [float(self.mean - half), float(self.mean + half)]


def welch(ours: ArrayLike, theirs: ArrayLike) -> Difference:
    """Return the difference of the means of independent samples, by Welch's t-test (unequal variances).

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        At least two runs each; their numbers may differ.
    """
    samples = [np.asarray(sample, dtype=np.float64) for sample in (ours, theirs)]
    means = [sample.mean(axis=-1) for sample in samples]
    runs = [sample.shape[-1] for sample in samples]
    # Variances of the means. They are never zero, so that samples without scatter also have a (huge) statistic.
    variances = [np.maximum(sample.var(axis=-1, ddof=1) / n, TINY) for sample, n in zip(samples, runs, strict=True)]
    variance = variances[0] + variances[1]
    # Shares instead of squares, which would underflow for small variances.
    freedom = 1.0 / sum((v / variance) ** 2 / (n - 1) for v, n in zip(variances, runs, strict=True))
    return _tested(means[0], means[1], np.sqrt(variance), freedom)


def paired(ours: ArrayLike, theirs: ArrayLike) -> Difference:
    """Return the difference of the means of paired samples, by the paired t-test.

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        At least two pairs.
    """
    samples = [np.asarray(sample, dtype=np.float64) for sample in (ours, theirs)]
    n = samples[0].shape[-1]
    difference = samples[0] - samples[1]
    error = np.maximum(difference.std(axis=-1, ddof=1) / n**0.5, TINY)
    return _tested(samples[0].mean(axis=-1), samples[1].mean(axis=-1), error, np.float64(n - 1))


def _tested(ours: Any, theirs: Any, error: Any, freedom: Any) -> Difference:
    from scipy.special import stdtr

    difference = ours - theirs
    differ = np.abs(difference) > ROUNDING * np.maximum(np.abs(ours), np.abs(theirs))
    p = np.where(differ, 2.0 * stdtr(freedom, -np.abs(difference) / error), 1.0)
    return Difference(difference, error, freedom, p)


def outcomes(ours: ArrayLike, theirs: ArrayLike, significance: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return 1 where the mean error of `ours` is significantly smaller than that of `theirs`, -1 where it is larger, else 0.

    By Welch's two-sided t-test, which assumes that both samples are independent. If they share their noise run by run, the
    difference of the means is more certain than the test assumes, so that the test is conservative (towards 0). Means that
    differ by no more than rounding count as equal, even if the samples scatter very little.

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        Errors of each run, at least two.
    significance : float
        Level of the tests.

    Returns
    -------
    ndarray of int, ...
        An outcome for each pair of samples.

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> ours = [[0.40, 0.42, 0.41], [0.5, 0.9, 0.1]]  # two scenarios of three runs
    >>> theirs = [[0.50, 0.53, 0.51], [0.4, 0.8, 0.2]]
    >>> statistics.outcomes(ours, theirs, significance=0.05).tolist()
    [1, 0]
    """
    difference = welch(ours, theirs)
    return decided(-difference.mean, difference.p, significance)


def decided(better: ArrayLike, p: ArrayLike, significance: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the sign of each significant difference, and 0 for the others.

    Parameters
    ----------
    better : array_like
        Difference, positive if the first sample is better.
    p : array_like of the same shape
        Its p-value; with NaN the difference is not significant.
    significance : float
        Level of the tests.
    """
    return np.where(np.asarray(p) < significance, np.sign(better), 0).astype(np.int64)


class RankTest(NamedTuple):
    """A test of ranks.

    Attributes
    ----------
    statistic : float
        Wilcoxon's smaller sum of ranks, or U of Mann and Whitney.
    p : float
        Two-sided p-value.
    effect : float
        Rank-biserial correlation, between -1 and 1, positive if `ours` are larger.
    """

    statistic: float
    p: float
    effect: float


def signed_ranks(ours: Floats, theirs: Floats) -> RankTest:
    """Return Wilcoxon's signed-rank test of paired samples, by `scipy.stats.wilcoxon`; pairs of equal values are left out.

    Parameters
    ----------
    ours, theirs : ndarray of shape (runs,)
        At least one pair.
    """
    from scipy.stats import rankdata, wilcoxon

    difference = ours - theirs
    difference = difference[difference != 0]
    if not len(difference):
        return RankTest(0.0, 1.0, 0.0)
    test, ranks = wilcoxon(difference), rankdata(np.abs(difference))
    return RankTest(float(test.statistic), float(test.pvalue), float((ranks * np.sign(difference)).sum() / ranks.sum()))


def rank_sum(ours: Floats, theirs: Floats) -> RankTest:
    """Return Wilcoxon's rank-sum test of independent samples (Mann and Whitney's U), by `scipy.stats.mannwhitneyu`.

    Parameters
    ----------
    ours, theirs : ndarray of shape (runs,)
        At least one run each.
    """
    from scipy.stats import mannwhitneyu

    test = mannwhitneyu(ours, theirs)
    u = float(test.statistic)
    same = len(np.unique([*ours, *theirs])) == 1  # scipy returns NaN for p from version 1.18 on, and 1 before
    return RankTest(u, 1.0 if same else float(test.pvalue), 2.0 * u / (len(ours) * len(theirs)) - 1.0)


def corrected(p: ArrayLike, correction: Correction | None) -> Floats:
    """Return the p-values of several tests, corrected for their number ("adjusted" in `statsmodels`).

    Parameters
    ----------
    p : array_like of shape (tests,)
        The p-values; NaN means no test and stays.
    correction : str or None
        ``"bonferroni"`` or ``"holm"`` (Holm 1979, never less powerful): with p below 5 %, the probability of any false
        finding among all tests is at most 5 %. ``"benjamini-hochberg"`` (1995): on average, at most 5 % of the findings are
        false. None: no correction.

    Returns
    -------
    ndarray of shape (tests,)
        The corrected p-values, at most 1, in the order of `p`.

    Raises
    ------
    ModelError
        If there is no such correction.

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> statistics.corrected([0.01, 0.04, 0.03], "holm").round(3).tolist()
    [0.03, 0.06, 0.06]
    >>> statistics.corrected([0.01, 0.04, 0.03], "benjamini-hochberg").round(3).tolist()
    [0.03, 0.04, 0.04]
    """
    values = np.array(p, dtype=np.float64)
    if correction is None:
        return values
    if correction not in CORRECTIONS:
        raise ModelError(f"There is no correction {correction!r}; use one of {', '.join(map(repr, CORRECTIONS))}.")
    valid = np.flatnonzero(~np.isnan(values))
    tests = values[valid]
    if correction == "bonferroni":
        tests = np.minimum(tests * len(tests), 1.0)
    elif correction == "holm":
        order = np.argsort(tests, kind="stable")
        stepped = np.maximum.accumulate(tests[order] * np.arange(len(tests), 0, -1))
        tests = np.empty_like(tests)
        tests[order] = np.minimum(stepped, 1.0)
    elif len(tests):
        from scipy.stats import false_discovery_control

        tests = false_discovery_control(tests)
    values[valid] = tests
    return values


__all__ = [
    "CORRECTIONS",
    "Correction",
    "Difference",
    "RankTest",
    "corrected",
    "decided",
    "outcomes",
    "paired",
    "rank_sum",
    "signed_ranks",
    "welch",
]
