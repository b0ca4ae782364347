"""What `judge_alarms` finds, at many thresholds at a time: each run is looked at once, and sorted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.judging.alarms import HOUR, Alarms
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class AlarmCounts:
    """The alarms of many runs at several thresholds; as of `Alarms`, see there for the definitions.

    Attributes
    ----------
    delays : ndarray of shape (thresholds, faults)
        Of the faults of all runs, in samples, infinite if missed.
    runs : ndarray of int, of shape (faults,)
        The run of each fault.
    false_alarms : ndarray of shape (runs, thresholds)
        Their number.
    hours : ndarray of shape (runs,)
        Fault-free time of all sensors.
    false_hours : ndarray of shape (runs, thresholds)
        How much of it had an alarm.
    step : float
        Sample time in seconds.
    """

    delays: Floats
    runs: Any
    false_alarms: Floats
    hours: Floats
    false_hours: Floats
    step: float

    def at(self, index: int) -> Alarms:
        """Return the alarms of all runs at one of the thresholds."""
        return Alarms(
            self.step,
            self.delays[index],
            int(self.false_alarms[:, index].sum()),
            float(self.hours.sum()),
            float(self.false_hours[:, index].sum()),
        )


def count_alarms(runs: Sequence[tuple[Floats, Any]], thresholds: Floats, step: float) -> AlarmCounts:
    """Return the alarms of runs at several thresholds; runs without any score are left out.

    Parameters
    ----------
    runs : sequence of (score, faulty)
        Of each run two ndarrays of shape (steps, sensors), as `judge_alarms` takes them.
    thresholds : ndarray of shape (thresholds,)
        In any order.
    step : float
        Sample time in seconds.
    """
    delays: list[Floats] = [np.empty((len(thresholds), 0))]
    owners: list[int] = []
    counts: list[tuple[Floats, Floats, int]] = []
    for score, faulty in runs:
        known = ~np.isnan(score)
        if not known.any():
            continue
        alarms, samples, healthy_samples = np.zeros(len(thresholds)), np.zeros(len(thresholds)), 0
        for values, truth, there in zip(score.T, faulty.T, known.T, strict=True):
            for begin, end in periods(truth):
                if len(seen := begin + np.flatnonzero(there[begin:end])):
                    delays.append(_delays(values, seen, thresholds)[:, None])
                    owners.append(len(counts))
            scores, healthy = values[there], ~truth[there]
            on = _at_least(scores[healthy], thresholds)
            # An alarm begins where this sample has one and the one before has none: those that have one, minus those in both.
            both = np.minimum(scores, np.concatenate([[-np.inf], scores[:-1]]))
            alarms += on - _at_least(both[healthy], thresholds)
            samples += on
            healthy_samples += int(healthy.sum())
        counts.append((alarms, samples, healthy_samples))
    hour = step / HOUR
    return AlarmCounts(
        np.concatenate(delays, axis=1),
        np.array(owners, dtype=np.intp),
        np.array([alarms for alarms, _, _ in counts]).reshape(-1, len(thresholds)),
        np.array([healthy * hour for _, _, healthy in counts]),
        np.array([samples * hour for _, samples, _ in counts]).reshape(-1, len(thresholds)),
        step,
    )


def _delays(score: Floats, there: Any, thresholds: Floats) -> Floats:
    """Return the delay of a fault at each threshold, given its samples that have a score."""
    first = np.searchsorted(np.maximum.accumulate(score[there]), thresholds, side="left")
    return np.append(there - there[0], np.inf)[first]


def _at_least(values: Floats, thresholds: Floats) -> Floats:
    """Return for each threshold how many values are at least that."""
    return np.asarray(len(values) - np.searchsorted(np.sort(values), thresholds, side="left"), dtype=np.float64)


__all__ = ["AlarmCounts", "count_alarms"]
