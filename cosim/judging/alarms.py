"""Judge a detector at a threshold: alarms, delays, missed faults and false alarms.

- An *alarm* is an unbroken sequence of samples whose score is at least the threshold. It *begins* with the first of them.
- A *false alarm* is an alarm that begins in a fault-free sample. It counts once, regardless of its length. An alarm that begins
  during a fault and continues after it is not a false alarm. `Alarms.false_share`, the share of the fault-free time with an
  alarm, shows how long such alarms last.
- A *fault* is an unbroken sequence of samples in which it is present. Its *delay* is the number of samples from its first sample
  to its first sample with an alarm: 0 if the first sample has one. A fault without an alarm is *missed*, and its delay is
  infinite. So quantiles are those of all faults, not only of the faults that are easy to detect.
- A sample whose score is missing (NaN) is left out, as if it did not exist. A fault without any score counts in no figure.

Rates are per hour of one sensor: two sensors for one hour make two hours. As in `bayesftc.cosim.judging.metrics`, a figure is NaN
if it is not defined. The intervals of delays and of missed faults assume that faults are independent of each other. Of several
runs, the interval of the rate of false alarms is wider where alarms come in clusters (`Alarms.rate_interval`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import NAN, periods, without_nan
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

HOUR = 3600.0
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Alarms:
    """The alarms of a detector in one or several runs; made by `judge_alarms` for one. The sum of two is that of all their runs.

    The docstring of the module has the definitions.

    Attributes
    ----------
    step : float
        Sample time in seconds.
    delays : ndarray of shape (faults,)
        Delay of each fault in samples, infinite for a missed fault.
    false_alarms : int
        Number of false alarms.
    hours : float
        Fault-free time in hours, of all sensors together.
    false_hours : float
        Fault-free time with an alarm.
    runs : ndarray of shape (runs, 2), optional
        False alarms and fault-free hours of each run; None if there is only one.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> rng, faulty = np.random.default_rng(0), np.arange(36000) % 3600 >= 3000  # an hour with ten faults
    >>> scores = rng.normal(size=(5, 36000)) + 3 * faulty
    >>> first, *others = (cosim.judge_alarms(score, faulty, threshold=4.0, step=0.1) for score in scores)
    >>> alarms = sum(others, first)  # of five runs
    >>> alarms.faults, alarms.missed, alarms.delay(0.5), alarms.false_alarms
    (50, 0, 3.0, 6)
    >>> [round(bound, 2) for bound in alarms.rate_interval()]  # false alarms per hour
    [0.53, 3.13]
    """

    step: float
    delays: Floats = field(repr=False)
    false_alarms: int
    hours: float
    false_hours: float
    runs: Floats | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return short(self, step="s", hours="h", false_hours="h")

    def __add__(self, other: Alarms) -> Alarms:
        """Return the alarms of the runs of both."""
        if not isinstance(other, Alarms):
            return NotImplemented
        if other.step != self.step:
            raise ModelError(
                f"Alarms at a sample time of {self.step:g} s cannot be pooled with alarms at {other.step:g} s; judge records of "
                "one sample time."
            )
        return Alarms(
            self.step,
            np.concatenate([self.delays, other.delays]),
            self.false_alarms + other.false_alarms,
            self.hours + other.hours,
            self.false_hours + other.false_hours,
            np.concatenate([self._of_runs(), other._of_runs()]),
        )

    def _of_runs(self) -> Floats:
        return np.array([[self.false_alarms, self.hours]]) if self.runs is None else self.runs

    @property
    def faults(self) -> int:
        """Number of faults."""
        return len(self.delays)

    @property
    def missed(self) -> int:
        """Number of faults without an alarm."""
        return int(np.isinf(self.delays).sum())

    @property
    def missed_share(self) -> float:
        """Share of the faults without an alarm."""
        return self.missed / self.faults if self.faults else NAN

    @property
    def false_share(self) -> float:
        """Share of the fault-free time with an alarm."""
        return self.false_hours / self.hours if self.hours else NAN

    @property
    def false_alarms_per_hour(self) -> float:
        """False alarms per hour of one sensor."""
        return self.false_alarms / self.hours if self.hours else NAN

    @property
    def time_between_false_alarms(self) -> float:
        """Mean time between false alarms of one sensor in seconds; NaN without false alarms."""
        return self.hours * HOUR / self.false_alarms if self.false_alarms else NAN

    def delay(self, quantile: float = 0.5) -> float:
        """Return a quantile of the delay in samples, over all faults; NaN if it is that of a missed fault.

        Parameters
        ----------
        quantile : float
            Between 0 and 1. The result is the smallest delay that this share of the faults does not exceed.
        """
        if not self.faults:
            return NAN
        value = np.quantile(self.delays, quantile, method="inverted_cdf")
        return float(value) if np.isfinite(value) else NAN

    def delay_interval(self, quantile: float = 0.5, level: float = LEVEL) -> tuple[float, float]:
        """Return the confidence interval of a quantile of the delay in samples, for any distribution; inf means missed.

        Its bounds are the order statistics between which the quantile lies with at least this probability (David and Nagaraja
        2003, section 7.1).

        Parameters
        ----------
        quantile : float
            Between 0 and 1.
        level : float
            Probability that the interval contains the quantile.
        """
        from scipy.special import bdtr

        if not self.faults:
            return NAN, NAN
        # Probability that at most k of the delays lie below the quantile.
        below = bdtr(np.arange(self.faults + 1), self.faults, quantile)
        first = int(np.searchsorted(below, (1.0 - level) / 2, side="right"))
        last = int(np.searchsorted(below, (1.0 + level) / 2, side="left")) + 1
        ordered = np.concatenate([[0.0], np.sort(self.delays), [np.inf]])
        return float(ordered[first]), float(ordered[min(last, self.faults + 1)])

    def missed_interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the exact confidence interval of the share of missed faults (Clopper and Pearson 1934).

        Parameters
        ----------
        level : float
            Probability that the interval contains the share.
        """
        from scipy.special import betaincinv

        n, k, tail = self.faults, self.missed, (1.0 - level) / 2
        if not n:
            return NAN, NAN
        low = float(betaincinv(k, n - k + 1, tail)) if k else 0.0
        return low, float(betaincinv(k + 1, n - k, 1.0 - tail)) if k < n else 1.0

    def rate_interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the confidence interval of the false alarms per hour.

        Of one run, and without a false alarm, it is Garwood's (1936). That one assumes that false alarms are independent of each
        other (a Poisson process), and is too narrow if they come in clusters. Of several runs it is Garwood's of as many times
        fewer alarms as the variance of their counts exceeds the mean. Then Student's t over runs widens it. It is never
        narrower than that of independent alarms.

        In simulations of runs of equal length with one alarm a run or more and a variance of 2.5 times the mean (negative
        binomial counts, and Poisson clusters of geometric size), the 95 % interval contains the rate in 92 to 99 % of the cases
        with 3 to 40 runs, and in 87 to 98 % with two runs. Garwood's contains it in 77 to 93 %. With independent alarms it is 96
        to 99 %. It is still too narrow with fewer than ten alarms in all, lengths that differ tenfold (83 to 96 %), and larger
        clusters (variance of ten times the mean: 64 to 87 %).

        Parameters
        ----------
        level : float
            Probability that the interval contains the rate.
        """
        from scipy.special import gammaincinv

        if not self.hours:
            return NAN, NAN
        dispersion, wider = _scatter(self._of_runs(), level)
        k, hours, tail = self.false_alarms / dispersion, self.hours / dispersion, (1.0 - level) / 2
        low = float(gammaincinv(k, tail)) if k else 0.0
        high, rate = float(gammaincinv(k + 1, 1.0 - tail)), self.false_alarms_per_hour
        return max(0.0, rate - wider * (rate - low / hours)), rate + wider * (high / hours - rate)

    def to_dict(self) -> dict[str, Any]:
        """Return all figures as plain data for a JSON file, with 95 % intervals; NaN and infinity become None."""
        median, ninety = self.delay(0.5), self.delay(0.9)
        plain: dict[str, Any] = without_nan(
            {
                "faults": self.faults,
                "missed": self.missed,
                "missed_share": self.missed_share,
                "missed_ci": self.missed_interval(),
                "delay_samples": {"median": median, "ci": self.delay_interval(), "quantile_90": ninety},
                "delay_seconds": {"median": median * self.step, "quantile_90": ninety * self.step},
                "false_alarms": self.false_alarms,
                "fault_free_hours": self.hours,
                "false_alarms_per_hour": self.false_alarms_per_hour,
                "false_alarms_per_hour_ci": self.rate_interval(),
                "seconds_between_false_alarms": self.time_between_false_alarms,
                "false_share": self.false_share,
            }
        )
        return plain


def _scatter(runs: Floats, level: float) -> tuple[float, float]:
    """Return the dispersion of the false alarms of runs, at least 1, and by how much its own uncertainty widens an interval.

    The dispersion, variance over mean, is Pearson's chi-square over its degrees of freedom (McCullagh and Nelder 1989).
    It widens as Student's t does beside the normal distribution.
    """
    from scipy.special import ndtri, stdtrit

    counts, hours = runs[runs[:, 1] > 0].T
    if len(counts) < 2 or not counts.sum():
        return 1.0, 1.0
    expected = counts.sum() * hours / hours.sum()
    freedom, upper = len(counts) - 1, 0.5 + level / 2
    dispersion = float(((counts - expected) ** 2 / expected).sum()) / freedom
    return (dispersion, float(stdtrit(freedom, upper) / ndtri(upper))) if dispersion > 1.0 else (1.0, 1.0)


def judge_alarms(
    score: ArrayLike, faulty: ArrayLike, *, threshold: float, step: float, left_out: ArrayLike | None = None
) -> Alarms:
    """Return the alarms of a detector at a threshold, compared with the faults of a run.

    Parameters
    ----------
    score : array_like of shape (steps,) or (steps, sensors)
        A fault probability, its log odds, a residual: a higher score means that a fault is more likely; NaN if missing.
    faulty : array_like of bool of the same shape
        The truth.
    threshold : float
        A sample has an alarm if its score is at least this.
    step : float
        Sample time in seconds.
    left_out : array_like of bool of the same shape, optional
        Samples that count neither as faulty nor as fault-free, such as those with another kind of fault than the judged one.

    Returns
    -------
    Alarms
        Delays, missed faults, false alarms and the fault-free time.

    Raises
    ------
    ModelError
        If the shapes do not agree, the threshold is NaN, or the sample time is not positive.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> faulty = [False, False, False, False, True, True, True, False]
    >>> score = [0.1, 0.9, 0.2, 0.1, 0.3, 0.8, 0.9, 0.2]
    >>> alarms = cosim.judge_alarms(score, faulty, threshold=0.5, step=0.1)
    >>> alarms.false_alarms, alarms.missed, alarms.delays.tolist()
    (1, 0, [1.0])
    """
    values = _columns("score", score, np.float64)
    truth = _columns("faulty", faulty, np.bool_)
    other = np.zeros_like(truth) if left_out is None else _columns("left_out", left_out, np.bool_)
    for name, flags in (("faulty", truth), ("left_out", other)):
        if flags.shape != values.shape:
            raise ModelError(
                f"judge_alarms has a score of shape {values.shape} and {name} of shape {flags.shape}; give equal shapes."
            )
    if np.isnan(threshold):
        raise ModelError("judge_alarms has threshold=nan; give the lowest score of an alarm.")
    pieces = [_of_sensor(*column, float(threshold), _seconds(step)) for column in zip(values.T, truth.T, other.T)]
    total = pieces[0]
    for piece in pieces[1:]:
        total = total + piece
    return replace(total, runs=None)  # sensors of one run may depend on each other


def _of_sensor(score: Floats, faulty: Flags, left_out: Flags, threshold: float, step: float) -> Alarms:
    valid = ~np.isnan(score)
    alarm = score >= threshold
    delays = []
    for a, b in periods(faulty & ~left_out):
        places = a + np.flatnonzero(valid[a:b])
        if len(places):
            alarmed = alarm[places]
            delays.append(float(places[np.argmax(alarmed)] - places[0]) if alarmed.any() else np.inf)
    on, healthy = alarm[valid], (~faulty & ~left_out)[valid]
    begins = on & ~np.concatenate([[False], on[:-1]])
    hours = step / HOUR
    return Alarms(
        step,
        np.array(delays),
        int((begins & healthy).sum()),
        float(healthy.sum() * hours),
        float((on & healthy).sum() * hours),
    )


def alarm_threshold(scores: Sequence[ArrayLike] | ArrayLike, *, step: float, per_hour: float = 1.0) -> float:
    """Return the lowest threshold at which fault-free records have at most a given number of alarms per hour.

    The condition holds at this threshold and at all higher ones. Test the threshold on other records.

    Parameters
    ----------
    scores : array_like of shape (steps,) or (steps, sensors), or sequence of such
        Scores of fault-free records, NaN if missing. Each sensor counts as a separate record.
    step : float
        Sample time in seconds.
    per_hour : float
        Largest number of alarms per hour of one sensor.

    Returns
    -------
    float
        A number just above the score of the first alarm beyond the limit. It is above all scores if too many alarms have the
        highest score, and the lowest score if there are never too many alarms.

    Raises
    ------
    ModelError
        If the records are too short for one alarm at that rate, or a score is infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> healthy = np.abs(np.random.default_rng(0).normal(size=(36000, 2)))  # residuals of two sensors in an hour
    >>> threshold = cosim.alarm_threshold(healthy, step=0.1, per_hour=10.0)
    >>> round(threshold, 2), int((healthy >= threshold).sum())
    (3.69, 20)
    """
    several = isinstance(scores, list | tuple) and len(scores) > 0 and np.ndim(scores[0]) > 0
    records: Any = scores if several else [scores]
    columns = [c[~np.isnan(c)] for record in records for c in _columns("scores", record, np.float64).T]
    if not all(np.isfinite(c).all() for c in columns):
        raise ModelError("alarm_threshold has an infinite score; give finite scores, such as bounded log odds.")
    hours = sum(len(c) for c in columns) * _seconds(step) / HOUR
    allowed = hours * per_hour
    if not (np.isfinite(per_hour) and allowed >= 1):
        raise ModelError(
            f"alarm_threshold has fault-free records of {hours:.3g} hours of one sensor and per_hour={per_hour!r}; give records "
            f"of at least {1 / per_hour if per_hour > 0 else np.inf:.3g} hours, in which one alarm can be expected."
        )
    before = np.concatenate([np.concatenate([[-np.inf], c[:-1]]) for c in columns if len(c)])
    now = np.concatenate(columns)
    lowest, rises = float(now.min()), now > before
    before, now = before[rises], now[rises]
    count = min(len(now), 64 * int(allowed))
    while True:  # sort only the highest samples, because few reach the threshold
        least = np.partition(now, -count)[-count]
        level = _least_level(before, now, float(least), allowed)
        if level is not None:
            return float(np.nextafter(level, np.inf))
        if count == len(now):
            return lowest
        count = min(len(now), 8 * count)


def _least_level(before: Floats, now: Floats, least: float, allowed: float) -> float | None:
    """Return the highest level, from `least` up, that is reached too often from below."""
    up, down = now[now >= least], before[before >= least]
    levels = np.concatenate([up, down])
    order = np.argsort(-levels, kind="stable")
    levels = levels[order]
    alarms = np.cumsum(np.concatenate([np.ones(len(up)), -np.ones(len(down))])[order])
    whole = np.append(levels[1:] < levels[:-1], True)  # among equal levels, only the last has the complete count
    too_many = levels[whole & (alarms > allowed)]
    return float(too_many[0]) if len(too_many) else None


def _columns(name: str, values: ArrayLike, dtype: Any) -> Any:
    """Return an array with a column for each sensor."""
    try:
        array = np.asarray(values, dtype=dtype)
    except (TypeError, ValueError):
        raise ModelError(f"{name} is not an array of numbers; give one.") from None
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or 0 in array.shape:
        raise ModelError(
            f"{name} has shape {np.shape(values)}; it must be (steps,) or (steps, sensors), and not empty."
        )
    return array


def _seconds(step: float) -> float:
    if not (np.isfinite(step) and step > 0):
        raise ModelError(f"step is {step!r}; it must be the sample time in seconds, above 0.")
    return float(step)
