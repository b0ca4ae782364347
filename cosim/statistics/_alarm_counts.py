"""What `judge_alarms` finds, at many thresholds at a time: each record is looked at once, and sorted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.alarms import HOUR, Alarms
from bayesftc.cosim.block import Floats
from bayesftc.cosim.metrics import periods


@dataclass(frozen=True, eq=False)
class AlarmCounts:
    """The alarms of one run at several thresholds; as of `Alarms`, see there for the definitions.

    Attributes
    ----------
    delays : ndarray of shape (thresholds, faults)
        In samples, infinite if missed.
    false_alarms : ndarray of shape (thresholds,)
        Their number.
    hours : float
        Fault-free time of all sensors.
    false_hours : ndarray of shape (thresholds,)
        How much of it had an alarm.
    step : float
        Sample time in seconds.
    """

    delays: Floats
    false_alarms: Floats
    hours: float
    false_hours: Floats
    step: float

    def at(self, index: int) -> Alarms:
        """Return the alarms at one of the thresholds."""
        return Alarms(
            self.step,
            self.delays[index],
            int(self.false_alarms[index]),
            self.hours,
            float(self.false_hours[index]),
        )


def count_alarms(score: Floats, faulty: Any, thresholds: Floats, step: float) -> AlarmCounts:
    """Return the alarms of a run at several thresholds.

    Parameters
    ----------
    score, faulty : ndarray of shape (steps, sensors)
        As `judge_alarms` takes them.
    thresholds : ndarray of shape (thresholds,)
        In any order.
    step : float
        Sample time in seconds.
    """
    hour = step / HOUR
    delays: list[Floats] = []
    false_alarms = np.zeros(len(thresholds))
    false_samples = np.zeros(len(thresholds))
    healthy_samples = 0
    for values, truth in zip(score.T, faulty.T, strict=True):
        known = ~np.isnan(values)
        delays += [_delays(values, a + np.flatnonzero(known[a:b]), thresholds) for a, b in periods(truth)]
        seen, healthy = values[known], ~truth[known]
        before = np.concatenate([[-np.inf], seen[:-1]])
        on = _at_least(seen[healthy], thresholds)
        # An alarm begins where this sample has one and the one before has none: those that have one, minus those in both.
        false_alarms += on - _at_least(np.minimum(seen, before)[healthy], thresholds)
        false_samples += on
        healthy_samples += int(healthy.sum())
    there = [d for d in delays if len(d)]
    return AlarmCounts(
        np.transpose(there) if there else np.empty((len(thresholds), 0)),
        false_alarms,
        healthy_samples * hour,
        false_samples * hour,
        step,
    )


def _delays(score: Floats, there: np.ndarray[tuple[int], np.dtype[np.intp]], thresholds: Floats) -> Floats:
    """Return the delay of a fault at each threshold; nothing if none of its samples has a score."""
    if not len(there):
        return np.empty(0)
    first = np.searchsorted(np.maximum.accumulate(score[there]), thresholds, side="left")
    return np.append(there - there[0], np.inf)[first]


def _at_least(values: Floats, thresholds: Floats) -> Floats:
    """Return for each threshold how many values are at least that."""
    return np.asarray(len(values) - np.searchsorted(np.sort(values), thresholds, side="left"), dtype=np.float64)


__all__ = ["AlarmCounts", "count_alarms"]
