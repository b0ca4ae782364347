"""Do two means differ? Welch's and the paired t-test, the rank tests, and what becomes of p where many tests are made.

The t-tests take many pairs of samples at a time. Means that differ by no more than rounding are equal, however little the
samples scatter: their p is 1.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""Relative difference of two means that rounding alone may make."""

Correction = Literal["bonferroni", "holm", "benjamini-hochberg"]
CORRECTIONS = ("bonferroni", "holm", "benjamini-hochberg")


class Difference(NamedTuple):
    """A difference of two means and its t-test; each field is a number, or an array for many pairs of samples.

    Attributes
    ----------
    mean : float
        Of ours minus that of theirs.
    error : float
        Its standard error.
    freedom : float
        Degrees of freedom of Student's t.
    p : float
        Probability, if the means are equal, of a difference that is as large or larger in either direction.
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
            Probability that the interval covers the difference.
        """
        from scipy.special import stdtrit

        half = stdtrit(self.freedom, 0.5 + level / 2) * self.error
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
    # Of each mean; none is taken for zero, so that samples without any scatter have a (huge) statistic as well.
    tiny = np.finfo(np.float64).tiny
    variances = [np.maximum(sample.var(axis=-1, ddof=1) / n, tiny) for sample, n in zip(samples, runs, strict=True)]
    variance = variances[0] + variances[1]
    # Shares instead of squares, which would vanish where the variances are small.
    freedom = 1.0 / sum((v / variance) ** 2 / (n - 1) for v, n in zip(variances, runs, strict=True))
    return _judged(means[0], means[1], np.sqrt(variance), freedom)


def paired(ours: ArrayLike, theirs: ArrayLike) -> Difference:
    """Return the difference of the means of samples that belong together run by run, by the paired t-test.

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        At least two pairs.
    """
    samples = [np.asarray(sample, dtype=np.float64) for sample in (ours, theirs)]
    n = samples[0].shape[-1]
    difference = samples[0] - samples[1]
    error = np.maximum(difference.std(axis=-1, ddof=1) / n**0.5, np.finfo(np.float64).tiny)
    return _judged(samples[0].mean(axis=-1), samples[1].mean(axis=-1), error, np.float64(n - 1))


def _judged(ours: Any, theirs: Any, error: Any, freedom: Any) -> Difference:
    from scipy.special import stdtr

    difference = ours - theirs
    differ = np.abs(difference) > ROUNDING * np.maximum(np.abs(ours), np.abs(theirs))
    p = np.where(differ, 2.0 * stdtr(freedom, -np.abs(difference) / error), 1.0)
    return Difference(difference, error, freedom, p)


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
    found = welch(ours, theirs)
    return decided(-found.mean, found.p, significance)


def decided(better: ArrayLike, p: ArrayLike, significance: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the sign of each difference that is significant, and 0 for the others.

    Parameters
    ----------
    better : array_like
        By how much ours is better.
    p : array_like of the same shape
        Of its test; NaN decides nothing.
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
        Two-sided.
    effect : float
        Rank-biserial correlation, between -1 and 1: positive where ours are larger.
    """

    statistic: float
    p: float
    effect: float


def signed_ranks(ours: Floats, theirs: Floats) -> RankTest:
    """Return Wilcoxon's signed-rank test of samples that belong together, by `scipy.stats.wilcoxon`; pairs that tie are left out.

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
    found, ranks = wilcoxon(difference), rankdata(np.abs(difference))
    return RankTest(
        float(found.statistic), float(found.pvalue), float((ranks * np.sign(difference)).sum() / ranks.sum())
    )


def rank_sum(ours: Floats, theirs: Floats) -> RankTest:
    """Return Wilcoxon's rank-sum test of independent samples (Mann and Whitney's U), by `scipy.stats.mannwhitneyu`.

    Parameters
    ----------
    ours, theirs : ndarray of shape (runs,)
        At least one run each.
    """
    from scipy.stats import mannwhitneyu

    found = mannwhitneyu(ours, theirs)
    u = float(found.statistic)
    same = len(np.unique([*ours, *theirs])) == 1  # of which scipy says NaN from 1.18 on, and said 1 before
    return RankTest(u, 1.0 if same else float(found.pvalue), 2.0 * u / (len(ours) * len(theirs)) - 1.0)


def corrected(p: ArrayLike, correction: Correction | None) -> Floats:
    """Return the p-values of several tests, corrected for their number, as `statsmodels` calls them "adjusted".

    Parameters
    ----------
    p : array_like of shape (tests,)
        NaN stands for no test and stays.
    correction : str or None
        ``"bonferroni"`` or ``"holm"`` (Holm 1979, never less powerful): with p below 5 %, the probability of a single false
        finding among all tests is at most 5 %. ``"benjamini-hochberg"`` (1995): of what is found, at most 5 % is false on
        average. None: as they are.

    Raises
    ------
    ModelError
        If there is no such correction.
    """
    values = np.array(p, dtype=np.float64)
    if correction is None:
        return values
    if correction not in CORRECTIONS:
        raise ModelError(f"There is no correction {correction!r}; take one of {', '.join(map(repr, CORRECTIONS))}.")
    known = np.flatnonzero(~np.isnan(values))
    tests = values[known]
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
    values[known] = tests
    return values


__all__ = [
    "CORRECTIONS", "Correction", "Difference", "RankTest", "corrected", "decided", "outcomes", "paired", "rank_sum",
    "signed_ranks", "welch",
]  # fmt: skip
