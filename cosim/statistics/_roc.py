"""Receiver operating characteristics of many runs: the curve with a band, and the area under it with an interval.

Samples of a run depend on each other, since residuals and faults last; runs do not. So whatever is said of certainty counts runs,
never samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import NAN, auc, without_nan
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.statistics._intervals import check_level, interval
from bayesftc.cosim.statistics._runs import by_run, pooled
from bayesftc.cosim.types import Floats

POINTS = 201
"""At how many false positive rates a curve is given."""


def roc_rates() -> Floats:
    """Return the false positive rates at which curves are given, so that they can be averaged over runs."""
    return np.linspace(0.0, 1.0, POINTS)


def roc_curve(faulty: Flags, score: Floats) -> Floats:
    """Return the true positive rate of a single record at each of the false positive rates of `roc_rates`.

    At the rate 0 that is the share of faulty samples whose score is at least the highest healthy one. Where healthy samples tie,
    the curve is a straight line over them, as if chance decided.

    Parameters
    ----------
    faulty, score : ndarray of the same shape
        The truth, and what a sample is ranked by, finite; at least one sample is faulty and one is not.
    """
    healthy, positive = np.sort(score[~faulty]), np.sort(score[faulty])
    thresholds = np.quantile(healthy, 1.0 - roc_rates())
    found = 1.0 - np.searchsorted(positive, thresholds, side="left") / len(positive)
    ties = np.searchsorted(healthy, thresholds, side="right") - np.searchsorted(healthy, thresholds, side="left")
    tied = ties > 1
    tied[0] = False
    if tied.any():
        t = thresholds[tied]
        above = [1.0 - np.searchsorted(values, t, side="right") / len(values) for values in (healthy, positive)]
        part = np.clip((roc_rates()[tied] - above[0]) * len(healthy) / ties[tied], 0.0, 1.0)
        found[tied] = above[1] + part * (found[tied] - above[1])
    found[0] = min(found[0], found[1])
    found[-1] = 1.0
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Roc:
    """The receiver operating characteristic of a score over many runs; made by `roc`.

    Attributes
    ----------
    auc : float
        Area under the curve of all samples together: the probability that a faulty sample of any run has a higher score than a
        healthy one of any run, ties counting half.
    low, high : float
        Its confidence interval; NaN with less than two runs, or if the score separates all samples.
    level : float
        Probability that the interval covers, and each point of the band.
    runs : int
        Number of runs with a score.
    left_out : int
        Number of runs without one.
    auc_of_runs : ndarray of shape (runs + left_out,)
        Area of each run by itself; NaN where all samples are faulty, or none is, or none has a score. Whether two scores differ,
        `compare` tells from these, run by run.
    false_positive_rate : ndarray of shape (201,)
        From 0 to 1.
    true_positive_rate : ndarray of shape (201,)
        At these rates, the mean of the curves of the runs that have one (vertical average).
    lower, upper : ndarray of shape (201,)
        Band of its confidence intervals, point by point, by Student's t; NaN with less than two curves.
    true_positive_rate_pooled : ndarray of shape (201,)
        The curve of all samples together.
    """

    auc: float
    low: float
    high: float
    level: float
    runs: int
    left_out: int
    auc_of_runs: Floats = field(repr=False)
    false_positive_rate: Floats = field(repr=False)
    true_positive_rate: Floats = field(repr=False)
    lower: Floats = field(repr=False)
    upper: Floats = field(repr=False)
    true_positive_rate_pooled: Floats = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file; NaN becomes None."""
        plain: dict[str, Any] = without_nan(
            {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}
        )
        return plain


def roc(score: ArrayLike | Sequence[ArrayLike], faulty: ArrayLike | Sequence[ArrayLike], *, level: float = 0.95) -> Roc:
    """Return the receiver operating characteristic of a score over many runs.

    The interval of the area is that of DeLong et al. (1988) for samples that depend on each other within runs (Obuchowski 1997):
    by the share that each run has in the area, on the scale of its logit, with Student's t for few runs. Sensors of a run belong
    to one run.

    Parameters
    ----------
    score : array_like of shape (runs, steps) or (runs, steps, sensors), or a sequence with a smaller array for each run
        What is the higher the more a sample looks faulty. Samples without one (NaN), such as those after a run has failed, are
        left out.
    faulty : array_like of bool, or a sequence of such
        The truth, of the same shapes.
    level : float
        Probability that the interval covers.

    Raises
    ------
    ModelError
        If the shapes do not agree, or all samples are faulty, or none is.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> faulty = np.tile(np.arange(100) >= 60, (30, 1))  # 30 runs, with a fault from sample 60 on
    >>> found = roc(rng.normal(size=(30, 100)) + faulty, faulty)
    >>> round(found.auc, 2), found.low < 0.76 < found.high  # by theory 0.76
    (0.75, True)
    """
    check_level(level)
    runs = by_run("score", score, faulty)
    scores, truth, run = pooled(runs)
    if truth.all() or not truth.any():
        raise ModelError(
            f"roc has {len(truth)} samples with a score, and {'none' if not truth.any() else 'all'} of them "
            "faulty; it takes faulty and healthy ones."
        )
    area, low, high = _area(scores, truth, run, len(runs), level)
    areas = np.array([auc(its, own) for own, its in runs])
    bounds = _finite_bounds(scores)
    curves = np.array(
        [_curve(its, own, bounds) for (own, its), known in zip(runs, ~np.isnan(areas), strict=True) if known]
    ).reshape(-1, POINTS)
    band = np.full((2, POINTS), NAN)
    if len(curves) > 1:
        band = np.clip(np.transpose([interval(column, level) for column in curves.T]), 0.0, 1.0)
    known = int((np.bincount(run, minlength=len(runs)) > 0).sum())
    return Roc(
        auc=area,
        low=low,
        high=high,
        level=level,
        runs=known,
        left_out=len(runs) - known,
        auc_of_runs=areas,
        false_positive_rate=roc_rates(),
        true_positive_rate=curves.mean(axis=0) if len(curves) else np.full(POINTS, NAN),
        lower=band[0],
        upper=band[1],
        true_positive_rate_pooled=_curve(truth, scores, bounds),
    )


def _area(score: Floats, faulty: Flags, run: Any, runs: int, level: float) -> tuple[float, float, float]:
    """Return the area under the curve of all samples, and its interval."""
    from scipy.special import expit, logit, stdtrit

    (positive, its), (healthy, others) = (_ordered(score[which], run[which]) for which in (faulty, ~faulty))
    area = auc(faulty, score)
    # Of each faulty sample the share of the healthy ones that it is above, and the other way round.
    own = np.bincount(its, _mean_rank(healthy, positive) - area, runs) / len(positive)
    own += np.bincount(others, 1.0 - area - _mean_rank(positive, healthy), runs) / len(healthy)
    n = int((np.bincount(run, minlength=runs) > 0).sum())
    if n < 2 or not 0 < area < 1:
        return area, NAN, NAN
    error = float(np.sqrt(n / (n - 1) * (own**2).sum()))
    half = stdtrit(n - 1, 0.5 + level / 2) * error / (area * (1.0 - area))
    return area, float(expit(logit(area) - half)), float(expit(logit(area) + half))


def _ordered(score: Floats, run: Any) -> tuple[Floats, Any]:
    """Return scores in order, and the runs that they belong to: places of ordered scores are found ten times as fast."""
    order = np.argsort(score)
    return score[order], run[order]


def _mean_rank(ordered: Floats, values: Floats) -> Floats:
    """Return for each value the share of ordered ones that it is above, ties counting half."""
    left, right = (np.searchsorted(ordered, values, side=side) for side in ("left", "right"))  # type: ignore[call-overload]
    return np.asarray((left + right) / (2.0 * len(ordered)))


def _finite_bounds(score: Floats) -> tuple[float, float]:
    """Return what stands for the infinities of a score: below and above all that is finite."""
    finite = score[np.isfinite(score)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return low - max(1.0, abs(low)), high + max(1.0, abs(high))


def _curve(faulty: Flags, score: Floats, bounds: tuple[float, float]) -> Floats:
    known = ~np.isnan(score)
    return roc_curve(faulty[known], np.clip(score[known], *bounds))


__all__ = ["Roc", "roc", "roc_curve", "roc_rates"]
