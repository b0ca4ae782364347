"""Receiver operating characteristics of many runs: the curve with a band, and the area under it with an interval.

Samples of a run depend on each other, because residuals and faults last. Runs are independent. So all intervals count runs, not
samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import NAN, auc, without_nan
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.statistics._intervals import check_level, interval
from bayesftc.cosim.statistics._runs import by_run, pooled
from bayesftc.cosim.types import Floats

POINTS = 201
"""Number of false positive rates of a curve."""


def roc_rates() -> Floats:
    """Return the false positive rates of all curves, which are the same so that curves can be averaged over runs.

    Returns
    -------
    ndarray of shape (201,)
        Evenly spaced from 0 to 1.

    Examples
    --------
    >>> from bayesftc.cosim import statistics
    >>> rates = statistics.roc_rates()
    >>> rates.shape, rates[:3].tolist()
    ((201,), [0.0, 0.005, 0.01])
    """
    return np.linspace(0.0, 1.0, POINTS)


def roc_curve(faulty: ArrayLike, score: ArrayLike) -> Floats:
    """Return the true positive rate of a single record at each of the false positive rates of `roc_rates`.

    At the rate 0 it is the share of faulty samples whose score is at least the highest healthy score. Over healthy samples of
    equal score the curve is a straight line, as if their order were random.

    Parameters
    ----------
    faulty, score : array_like of the same shape
        The truth and the finite score of each sample; at least one sample is faulty and one is not.

    Returns
    -------
    ndarray of shape (201,)
        From 0 to 1, not falling.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng, faulty = np.random.default_rng(0), np.arange(1000) >= 600
    >>> curve = statistics.roc_curve(faulty, rng.normal(size=1000) + 2 * faulty)
    >>> float(np.interp(0.1, statistics.roc_rates(), curve).round(1))  # 10 % false positives
    0.8
    """
    truth, score = np.asarray(faulty, dtype=bool), np.asarray(score, dtype=np.float64)
    healthy, positive = np.sort(score[~truth]), np.sort(score[truth])
    thresholds = np.quantile(healthy, 1.0 - roc_rates())
    rates = 1.0 - np.searchsorted(positive, thresholds, side="left") / len(positive)
    ties = np.searchsorted(healthy, thresholds, side="right") - np.searchsorted(healthy, thresholds, side="left")
    tied = ties > 1
    tied[0] = False
    if tied.any():
        t = thresholds[tied]
        above = [1.0 - np.searchsorted(values, t, side="right") / len(values) for values in (healthy, positive)]
        part = np.clip((roc_rates()[tied] - above[0]) * len(healthy) / ties[tied], 0.0, 1.0)
        rates[tied] = above[1] + part * (rates[tied] - above[1])
    rates[0] = min(rates[0], rates[1])
    rates[-1] = 1.0
    return np.asarray(rates)


@dataclass(frozen=True, eq=False)
class Roc:
    """The receiver operating characteristic of a score over many runs; made by `roc`.

    Attributes
    ----------
    auc : float
        Area under the curve of all samples together: the probability that a faulty sample of any run has a higher score than a
        healthy sample of any run; equal scores count half.
    low, high : float
        Its confidence interval; NaN with less than two runs, or if the score separates all samples.
    level : float
        Probability that the interval, or the band at a point, contains the true value.
    runs : int
        Number of runs with a score.
    left_out : int
        Number of runs without one.
    auc_of_runs : ndarray of shape (runs + left_out,)
        Area of each run by itself; NaN if all samples are faulty, or none is, or none has a score. Use these with `compare` to
        compare two scores run by run.
    false_positive_rate : ndarray of shape (201,)
        From 0 to 1.
    true_positive_rate : ndarray of shape (201,)
        At these rates, the mean of the curves of the runs with a curve (vertical average).
    lower, upper : ndarray of shape (201,)
        Its band of pointwise confidence intervals by Student's t; NaN with less than two curves.
    true_positive_rate_pooled : ndarray of shape (201,)
        The curve of all samples together.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng, faulty = np.random.default_rng(0), np.tile(np.arange(100) >= 60, (30, 1))
    >>> result = statistics.roc(rng.normal(size=(30, 100)) + 2 * faulty, faulty)
    >>> result.runs, round(result.auc, 2), [round(bound, 2) for bound in (result.low, result.high)]
    (30, 0.92, [0.91, 0.93])
    >>> float(np.interp(0.05, result.false_positive_rate, result.true_positive_rate).round(1))
    0.6
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

    def __repr__(self) -> str:
        return short(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file; NaN becomes None."""
        plain: dict[str, Any] = without_nan(
            {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}
        )
        return plain


def roc(score: ArrayLike | Sequence[ArrayLike], faulty: ArrayLike | Sequence[ArrayLike], *, level: float = 0.95) -> Roc:
    """Return the receiver operating characteristic of a score over many runs.

    The interval of the area is that of DeLong et al. (1988) for samples that depend on each other within runs (Obuchowski 1997).
    It uses the contribution of each run to the area, the logit scale, and Student's t for few runs. All sensors of a run count
    as one run.

    Parameters
    ----------
    score : array_like of shape (runs, steps) or (runs, steps, sensors), or a sequence with a smaller array for each run
        A higher score means that a fault is more likely. Samples without a score (NaN), such as those after the failure of a
        run, are left out.
    faulty : array_like of bool, or a sequence of such
        The truth, of the same shapes.
    level : float
        Probability that the interval contains the true value.

    Returns
    -------
    Roc
        The curve and the area under it, with its interval.

    Raises
    ------
    ModelError
        If the shapes do not agree, or all samples are faulty, or none is.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng = np.random.default_rng(0)
    >>> faulty = np.tile(np.arange(100) >= 60, (30, 1))  # 30 runs, with a fault from sample 60 on
    >>> result = statistics.roc(rng.normal(size=(30, 100)) + faulty, faulty)
    >>> round(result.auc, 2), result.low < 0.76 < result.high  # by theory 0.76
    (0.75, True)
    """
    check_level(level)
    runs = by_run("score", score, faulty)
    scores, truth, run = pooled(runs)
    if truth.all() or not truth.any():
        raise ModelError(
            f"roc has {len(truth)} samples with a score, and {'none' if not truth.any() else 'all'} of them "
            "faulty; give faulty and healthy samples."
        )
    area, low, high = _area(scores, truth, run, len(runs), level)
    areas = np.array([auc(flags, values) for values, flags in runs])
    bounds = _finite_bounds(scores)
    curves = np.array(
        [_curve(flags, values, bounds) for (values, flags), valid in zip(runs, ~np.isnan(areas), strict=True) if valid]
    ).reshape(-1, POINTS)
    band = np.full((2, POINTS), NAN)
    if len(curves) > 1:
        band = np.clip(np.transpose([interval(column, level) for column in curves.T]), 0.0, 1.0)
    scored = int((np.bincount(run, minlength=len(runs)) > 0).sum())
    return Roc(
        auc=area,
        low=low,
        high=high,
        level=level,
        runs=scored,
        left_out=len(runs) - scored,
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

    (positive, faulty_runs), (healthy, healthy_runs) = (
        _ordered(score[which], run[which]) for which in (faulty, ~faulty)
    )
    area = auc(faulty, score)
    # For each faulty sample, the share of healthy samples with a lower score; for each healthy sample, vice versa.
    parts = np.bincount(faulty_runs, _mean_rank(healthy, positive) - area, runs) / len(positive)
    parts += np.bincount(healthy_runs, 1.0 - area - _mean_rank(positive, healthy), runs) / len(healthy)
    n = int((np.bincount(run, minlength=runs) > 0).sum())
    if n < 2 or not 0 < area < 1:
        return area, NAN, NAN
    error = float(np.sqrt(n / (n - 1) * (parts**2).sum()))
    half = stdtrit(n - 1, 0.5 + level / 2) * error / (area * (1.0 - area))
    return area, float(expit(logit(area) - half)), float(expit(logit(area) + half))


def _ordered(score: Floats, run: Any) -> tuple[Floats, Any]:
    """Return the scores in order, with their runs; searching ordered scores is ten times as fast."""
    order = np.argsort(score)
    return score[order], run[order]


def _mean_rank(ordered: Floats, values: Floats) -> Floats:
    """Return for each value the share of the ordered values that are lower; equal values count half."""
    left, right = (np.searchsorted(ordered, values, side=side) for side in ("left", "right"))  # type: ignore[call-overload]
    return np.asarray((left + right) / (2.0 * len(ordered)))


def _finite_bounds(score: Floats) -> tuple[float, float]:
    """Return finite replacements for infinite scores: below and above all finite scores."""
    finite = score[np.isfinite(score)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return low - max(1.0, abs(low)), high + max(1.0, abs(high))


def _curve(faulty: Flags, score: Floats, bounds: tuple[float, float]) -> Floats:
    valid = ~np.isnan(score)
    return roc_curve(faulty[valid], np.clip(score[valid], *bounds))


__all__ = ["Roc", "roc", "roc_curve", "roc_rates"]
