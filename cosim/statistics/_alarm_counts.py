"""Count alarms as `judge_alarms` does, but at many thresholds at a time: each run is read once, and sorted."""

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
    """The alarms of many runs at several thresholds; `Alarms` has the definitions.

    Attributes
    ----------
    delays : ndarray of shape (thresholds, faults)
        Delays of the faults of all runs, in samples, infinite for a missed fault.
    runs : ndarray of int, of shape (faults,)
        The run of each fault.
    false_alarms : ndarray of shape (runs, thresholds)
        Numbers of false alarms.
    hours : ndarray of shape (runs,)
        Fault-free time of all sensors.
    false_hours : ndarray of shape (runs, thresholds)
        Fault-free time with an alarm.
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
            np.column_stack([self.false_alarms[:, index], self.hours]),
        )


def count_alarms(runs: Sequence[tuple[Floats, Any]], thresholds: Floats, step: float) -> AlarmCounts:
    """Return the alarms of runs at several thresholds; runs without any score are left out.

    Parameters
    ----------
    runs : sequence of (score, faulty)
        Two ndarrays of shape (steps, sensors) for each run, as for `judge_alarms`.
    thresholds : ndarray of shape (thresholds,)
        The thresholds, in any order.
    step : float
        Sample time in seconds.
    """
    delays: list[Floats] = [np.empty((len(thresholds), 0))]
    owners: list[int] = []
    counts: list[tuple[Floats, Floats, int]] = []
    for score, faulty in runs:
        valid = ~np.isnan(score)
        if not valid.any():
            continue
        alarms, samples, healthy_samples = np.zeros(len(thresholds)), np.zeros(len(thresholds)), 0
        for values, truth, scored in zip(score.T, faulty.T, valid.T, strict=True):
            for begin, end in periods(truth):
                if len(places := begin + np.flatnonzero(scored[begin:end])):
                    delays.append(_delays(values, places, thresholds)[:, None])
                    owners.append(len(counts))
            scores, healthy = values[scored], ~truth[scored]
            on = _at_least(scores[healthy], thresholds)
            # An alarm begins at a sample with an alarm if the sample before has none. Their number is that of samples with an
            # alarm, minus that of samples with an alarm after another one.
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


def _delays(score: Floats, places: Any, thresholds: Floats) -> Floats:
    """Return the delay of a fault at each threshold, given the places of its samples with a score."""
    first = np.searchsorted(np.maximum.accumulate(score[places]), thresholds, side="left")
    return np.append(places - places[0], np.inf)[first]


def _at_least(values: Floats, thresholds: Floats) -> Floats:
    """Return for each threshold the number of values that reach it."""
    return np.asarray(len(values) - np.searchsorted(np.sort(values), thresholds, side="left"), dtype=np.float64)


__all__ = ["AlarmCounts", "count_alarms"]
