"""Calibration of fault probabilities over many runs: reliability diagram and scores, with intervals that count runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.judging.metrics import NAN, without_nan
from bayesftc.cosim.judging.probabilities import Reliability, bins_of, of_bins
from bayesftc.cosim.statistics._intervals import check_level, interval, ratio
from bayesftc.cosim.statistics._runs import by_run, pooled
from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class Calibration:
    """The agreement of the fault probabilities of many runs with the truth; made by `calibration`.

    Attributes
    ----------
    pooled : Reliability
        Diagram, Brier score and calibration error of all samples together.
    brier_interval, calibration_error_interval : tuple of float
        Confidence intervals of `pooled.brier` and `pooled.calibration_error`; NaN with less than two runs.
    observed_low, observed_high : ndarray of shape (bins,)
        Confidence interval of `pooled.observed`, the share of faulty samples in each bin; NaN if less than two runs have a
        sample in it.
    level : float
        Probability that an interval contains the true value.
    runs, left_out : int
        Number of runs with a probability, and of runs without one.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng = np.random.default_rng(0)
    >>> probability = rng.random((50, 100))  # 50 runs
    >>> result = statistics.calibration(probability**2, rng.random((50, 100)) < probability, bins=4)  # too low
    >>> (result.pooled.predicted < result.observed_low).tolist(), result.runs
    ([True, True, True, True], 50)
    """

    pooled: Reliability
    brier_interval: tuple[float, float]
    calibration_error_interval: tuple[float, float]
    observed_low: Floats = field(repr=False)
    observed_high: Floats = field(repr=False)
    level: float
    runs: int
    left_out: int

    def __repr__(self) -> str:
        return short(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file; NaN becomes None."""
        others = {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in vars(self).items() if n != "pooled"}
        plain: dict[str, Any] = without_nan({**self.pooled.to_dict(), **others})
        return plain


def calibration(
    probability: ArrayLike | Sequence[ArrayLike],
    faulty: ArrayLike | Sequence[ArrayLike],
    *,
    bins: int = 10,
    equal: Literal["counts", "widths"] = "counts",
    level: float = 0.95,
) -> Calibration:
    """Return the agreement of the fault probabilities of many runs with the truth, with intervals over runs.

    Samples of a run depend on each other, because faults last. An interval that counts samples would be much too narrow.
    Therefore shares are ratios of sums over runs (delta method). The calibration error is not a share, and has the interval of
    the jackknife (leaving out one run after the other). Both use Student's t. In a bin in which no sample is faulty, or all are,
    runs do not scatter. There the interval is the exact one of a share (Clopper and Pearson 1934), with a run as one sample.

    Parameters
    ----------
    probability : array_like of shape (runs, steps) or (runs, steps, sensors), or a sequence with a smaller array for each run
        Fault probabilities; samples without one (NaN), such as those after the failure of a run, are left out.
    faulty : array_like of bool, or a sequence of such
        The truth, of the same shapes.
    bins : int
        Number of bins; the same for all runs.
    equal : str
        ``"counts"``: all bins have equally many samples; ``"widths"``: all have the same width. See `bayesftc.cosim.reliability`.
    level : float
        Probability that an interval contains the true value.

    Returns
    -------
    Calibration
        Diagram, Brier score and calibration error of all samples together, with their intervals.

    Raises
    ------
    ModelError
        As in `bayesftc.cosim.reliability`.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng = np.random.default_rng(0)
    >>> probability = rng.random((50, 100))  # 50 runs
    >>> result = statistics.calibration(probability, rng.random((50, 100)) < probability, bins=5)
    >>> round(result.pooled.brier, 2), [round(bound, 2) for bound in result.brier_interval]
    (0.17, [0.16, 0.17])
    """
    check_level(level)
    runs = by_run("probability", probability, faulty)
    p, truth, run = pooled(runs)
    place, happened = bins_of(p, bins, equal), truth.astype(np.float64)
    count, predicted, observed = (
        np.bincount(run * bins + place, weights, len(runs) * bins).reshape(len(runs), bins)
        for weights in (None, p, happened)
    )
    scored = count.sum(axis=1) > 0
    count, predicted, observed = count[scored], predicted[scored], observed[scored]
    squares = np.bincount(run, (p - happened) ** 2, len(runs))[scored]
    low, high = np.transpose([_share(o, n, level) for o, n in zip(observed.T, count.T, strict=True)])
    return Calibration(
        pooled=of_bins(p, happened, place, bins),
        brier_interval=_share(squares, count.sum(axis=1), level),
        calibration_error_interval=_jackknifed(predicted, observed, count, level),
        observed_low=low,
        observed_high=high,
        level=level,
        runs=len(count),
        left_out=len(runs) - len(count),
    )


def _share(part: Floats, whole: Floats, level: float) -> tuple[float, float]:
    """Return the interval of a share from sums over runs."""
    runs = int((whole > 0).sum())
    if runs < 2:
        return NAN, NAN
    if part.sum() in (0.0, whole.sum()):
        far = ((1.0 - level) / 2) ** (1.0 / runs)
        return (0.0, 1.0 - far) if part.sum() == 0.0 else (far, 1.0)
    low, high = ratio(part, whole, level)[1]
    return max(low, 0.0), min(high, 1.0)


def _jackknifed(predicted: Floats, observed: Floats, count: Floats, level: float) -> tuple[float, float]:
    """Return the interval of the calibration error by the delete-one jackknife."""
    from scipy.special import stdtrit

    runs = len(count)
    if runs < 2:
        return NAN, NAN
    gap, samples = predicted - observed, count.sum(axis=1)
    whole = np.abs(gap.sum(axis=0)).sum() / samples.sum()
    without = np.abs(gap.sum(axis=0) - gap).sum(axis=1) / (samples.sum() - samples)
    half = stdtrit(runs - 1, 0.5 + level / 2) * (runs - 1) ** 0.5 * without.std()
    return max(float(whole - half), 0.0), min(float(whole + half), 1.0)


def mean_reliability(runs: Sequence[Reliability], level: float = 0.95) -> dict[str, Any]:
    """Return the mean over runs of the results of `bayesftc.cosim.reliability`, with intervals by Student's t.

    It suits a few long runs, each with separate bins. `calibration` has the same bins for all runs, and suits short runs.

    Parameters
    ----------
    runs : sequence of Reliability
        At least two, with equal numbers of bins.
    level : float
        Probability that an interval contains the true value.

    Returns
    -------
    dict
        ``brier``, ``brier_of_constant`` and ``ece`` (calibration error), each with ``mean`` and ``ci``; ``diagram``: for each bin
        its ``share`` of the samples, mean probability ``predicted``, and share of faulty samples ``observed`` with its ``ci``.
        It is None if no run has a sample in the bin (``ci``: less than two runs).

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import statistics
    >>> rng = np.random.default_rng(0)
    >>> runs = rng.random((3, 5000))  # probabilities in three long runs
    >>> each = [cosim.reliability(run, rng.random(5000) < run) for run in runs]
    >>> mean = statistics.mean_reliability(each)
    >>> round(mean["brier"]["mean"], 2), [round(bound, 2) for bound in mean["brier"]["ci"]], len(mean["diagram"])
    (0.17, [0.16, 0.18], 10)
    """
    names = {"brier": "brier", "brier_of_constant": "brier_of_constant", "ece": "calibration_error"}
    numbers = {name: np.array([getattr(r, attribute) for r in runs]) for name, attribute in names.items()}
    plain: dict[str, Any] = without_nan(
        {
            **{name: {"mean": float(np.mean(v)), "ci": interval(v, level)} for name, v in numbers.items()},
            "diagram": _diagram(runs, level),
        }
    )
    return plain


def _diagram(runs: Sequence[Reliability], level: float) -> list[dict[str, Any]]:
    samples = np.array([r.samples for r in runs])
    bins = []
    for i in range(samples.shape[1]):
        predicted, observed = (np.array([getattr(r, name)[i] for r in runs]) for name in ("predicted", "observed"))
        valid = ~np.isnan(observed)
        bins.append(
            {
                "share": float(samples[:, i].sum() / samples.sum()),
                "predicted": float(predicted[valid].mean()) if valid.any() else None,
                "observed": float(observed[valid].mean()) if valid.any() else None,
                "ci": interval(observed[valid], level) if valid.sum() > 1 else None,
            }
        )
    return bins


__all__ = ["Calibration", "calibration", "mean_reliability"]
