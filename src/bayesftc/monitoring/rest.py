"""When all sensors repeat themselves at once: then the quantity is at rest, or the logger is, and no sensor is frozen.

The learner judges each sensor's repetitions by themselves: four wheels of a parked car, which all send 0, are four freezes to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

LEAST = 3
"""Steps of a rest: two coarse sensors may repeat themselves at once by chance, but hardly three times in a row."""

SETTLES = 3
"""Samples of a sensor after a rest until what was taken for a freeze meanwhile is forgotten: a change by one unit of a coarse
resolution is still a freeze's dither."""


def at_rest(y: Floats) -> Flags:
    """Return at which steps the last sample of every sensor equals the one before; of a single sensor nothing is known.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples; a sensor that has none at a step is as it was at its last one.
    """
    alike, steps = np.full(len(y), y.shape[1] > 1), np.arange(len(y))
    for column in y.T:
        there = np.flatnonzero(np.isfinite(column))
        equal = np.concatenate([[False, False], np.diff(column[there]) == 0])[: len(there) + 1]
        alike &= equal[np.searchsorted(there, steps, side="right")]
    rest = np.zeros(len(y), dtype=bool)
    for begin, end in periods(alike):
        rest[begin:end] = end - begin >= LEAST
    return rest


def held(signals: Mapping[str, Floats], names: Iterable[str], y: Floats, rest: Flags) -> dict[str, Floats]:
    """Return signals of which some keep what they were before a rest, until it is over for their sensor.

    Parameters
    ----------
    signals : mapping of str to ndarray
        By name, over the steps.
    names : iterable of str
        Those that are held; they have a column for each sensor.
    y : ndarray, steps x sensors
        Samples.
    rest : ndarray, steps
        From `at_rest`.
    """
    steps, kept = np.arange(len(y)), {name: signals[name].copy() for name in names}
    for i, column in enumerate(y.T):
        count = np.cumsum(np.isfinite(column))
        before = np.maximum.accumulate(np.where(rest, count, -SETTLES - 1))
        last = np.maximum.accumulate(np.where(count - before <= SETTLES, 0, steps))
        for values in kept.values():
            values[:, i] = values[last, i]
    return {**signals, **kept}
