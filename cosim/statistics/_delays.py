"""Detection delay, missed faults and false alarms of a detector at rising thresholds, over many runs.

Alarms, faults and delays are those of `bayesftc.cosim.judging.alarms`. Intervals count runs, because the faults, alarms and
sensors of one run may depend on each other in any way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.alarms import Alarms
from bayesftc.cosim.judging.metrics import NAN
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.statistics._alarm_counts import AlarmCounts, count_alarms
from bayesftc.cosim.statistics._intervals import check_level, ratio
from bayesftc.cosim.statistics._runs import by_run, pooled
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

COUNT = 50
"""Default number of thresholds of a curve."""


def delay_curve(
    score: ArrayLike | Sequence[ArrayLike],
    faulty: ArrayLike | Sequence[ArrayLike],
    *,
    step: float,
    thresholds: ArrayLike | int = COUNT,
    level: float = 0.95,
) -> pd.DataFrame:
    """Return false alarms, detection delay and missed faults at thresholds from low to high, over many runs.

    Parameters
    ----------
    score : array_like of shape (runs, steps) or (runs, steps, sensors), or a sequence with a smaller array for each run
        A higher score means that a fault is more likely. Samples without a score (NaN), such as those after the failure of a
        run, are left out.
    faulty : array_like of bool, or a sequence of such
        The truth, of the same shapes.
    step : float
        Sample time in seconds.
    thresholds : array_like or int
        The lowest scores of an alarm; or their number. A number of thresholds is chosen so that the share of fault-free samples
        above them falls by the same factor from each to the next.
    level : float
        Probability that an interval contains the true value. The interval of the false alarms per hour is that of `Alarms`, which
        widens with the scatter of the runs. The others are by Student's t over runs, for the ratio of two sums (delta method).
        The interval of the median follows, by Woodruff's method (1952), from that of the share of faults that are found sooner.
        If no fault or all faults are missed, runs do not scatter. Then it is the exact interval of `Alarms`.

    Returns
    -------
    DataFrame
        A row for each threshold, in rising order, with the columns

        - ``threshold``; ``false_alarms_per_hour`` of one sensor; ``false_share``: share of the fault-free time with an alarm;
        - ``missed_share``: share of missed faults;
        - ``median_delay`` in seconds of all faults; the delay of a missed fault is infinite (NaN if more than half are missed);
        - ``delay_90`` in seconds, within which 90 % of all faults are found (NaN if more than a tenth are missed);
        - ``mean_delay`` in seconds of the faults that are found, which is too favourable if many are missed;
        - ``faults`` and ``runs``: their numbers.

        All but ``false_share``, ``delay_90`` and the numbers have an interval in columns that end in ``_low`` and ``_high``.

    Raises
    ------
    ModelError
        If shapes do not agree, a threshold or the sample time is wrong, or there is no fault-free sample with a score.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> rng = np.random.default_rng(0)
    >>> faulty = np.tile(np.arange(600) >= 400, (20, 1))  # 20 runs of a minute, with a fault in the last 20 seconds
    >>> curve = statistics.delay_curve(rng.normal(size=(20, 600)) + 2 * faulty, faulty, step=0.1, thresholds=[2.0, 3.0, 4.0])
    >>> curve[["threshold", "false_alarms_per_hour", "median_delay", "missed_share"]].round(1)
       threshold  false_alarms_per_hour  median_delay  missed_share
    0        2.0                  796.5           0.0           0.0
    1        3.0                   45.0           0.4           0.0
    2        4.0                    0.0           1.4           0.0
    """
    import pandas as pd

    check_level(level)
    if not (np.isfinite(step) and step > 0):
        raise ModelError(f"step is {step!r}; it must be the sample time in seconds, above 0.")
    runs = by_run("score", score, faulty)
    levels = _levels(thresholds, runs)
    counts = count_alarms(runs, levels, float(step))
    rows = [{"threshold": float(each), **_row(counts, i, level)} for i, each in enumerate(levels)]
    return pd.DataFrame(rows).assign(runs=len(counts.hours))


def _levels(given: ArrayLike | int, runs: Sequence[tuple[Floats, Flags]]) -> Floats:
    scores, truth, _ = pooled(runs)
    healthy = scores[~truth]
    if not len(healthy):
        raise ModelError("delay_curve has no fault-free sample with a score; give runs that begin before their faults.")
    if isinstance(given, int | np.integer) and not isinstance(given, bool):
        if given < 2:
            raise ModelError(f"delay_curve has thresholds={given}; give at least 2, or a list of thresholds.")
        shares = np.geomspace(1.0, 1.0 / len(healthy), int(given))
        return np.unique(np.quantile(healthy, 1.0 - shares, method="higher"))
    levels = np.sort(np.atleast_1d(np.asarray(given, dtype=np.float64)).ravel())
    if not len(levels) or np.isnan(levels).any():
        raise ModelError("delay_curve has no threshold, or one that is NaN; give the lowest scores of an alarm.")
    return levels


def _row(counts: AlarmCounts, index: int, level: float) -> dict[str, Any]:
    """Return the figures at one threshold."""
    total, owners = counts.at(index), counts.runs
    is_found, median = np.isfinite(total.delays), total.delay()

    def of_runs(which: Any, weights: Floats | None = None) -> Any:
        return np.bincount(owners[which], weights, len(counts.hours))

    faults, detected = of_runs(slice(None)), of_runs(is_found)
    seconds = of_runs(is_found, total.delays[is_found] * total.step)
    # If more than half are missed, the interval of the median follows from the faults that are found.
    sooner = of_runs(is_found if np.isnan(median) else total.delays <= median)
    return {
        **_named("false_alarms_per_hour", total.false_alarms_per_hour, total.rate_interval(level)),
        "false_share": total.false_share,
        **_named("missed_share", total.missed_share, _missed(total, faults - detected, faults, level)),
        **_named("median_delay", median * total.step, _median(total, sooner, faults, level)),
        "delay_90": total.delay(0.9) * total.step,
        **_named("mean_delay", *_mean(seconds, detected, level)),
        "faults": total.faults,
    }


def _named(name: str, value: float, bounds: Sequence[float]) -> dict[str, float]:
    return {name: value, f"{name}_low": float(bounds[0]), f"{name}_high": float(bounds[1])}


def _ratio(ours: Floats, theirs: Floats, level: float) -> tuple[float, list[float]]:
    """Return the ratio of two sums over runs, with its interval; NaN if it is not defined."""
    if not theirs.sum():
        return NAN, [NAN, NAN]
    if len(theirs) < 2:
        return float(ours.sum() / theirs.sum()), [NAN, NAN]
    return ratio(ours, theirs, level)


def _missed(total: Alarms, missed: Floats, faults: Floats, level: float) -> Sequence[float]:
    if total.missed in (0, total.faults):
        return total.missed_interval(level)
    low, high = _ratio(missed, faults, level)[1]
    return max(low, 0.0), min(high, 1.0)


def _mean(seconds: Floats, detected: Floats, level: float) -> tuple[float, list[float]]:
    value, (low, high) = _ratio(seconds, detected, level)
    return value, [max(low, 0.0) if low == low else low, high]


def _median(total: Alarms, sooner: Floats, faults: Floats, level: float) -> Sequence[float]:
    """Return the interval of the median delay in seconds, given the number of faults in each run that are found by then."""
    low, high = _ratio(sooner, faults, level)[1]
    if np.isnan(low):
        return NAN, NAN
    half = (high - low) / 2
    shares = np.clip([0.5 - half, 0.5 + half], 0.0, 1.0)
    bounds = np.quantile(total.delays, shares, method="inverted_cdf")
    return float(bounds[0] * total.step), float(bounds[1] * total.step)


__all__ = ["delay_curve"]
