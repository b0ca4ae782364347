"""Steps at which all sensors repeat their values at once: the quantity or the logger is at rest, and no sensor is frozen.

The learner judges the repetitions of each sensor alone. In a parked car, where four wheel sensors send 0, it would detect four
freezes. What the sensors send then counts as missing, and belief and probabilities are held; see `surprises`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.switching.sensor_kernels import COARSE
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.monitoring.recording import Recording

LEAST = 3
"""Least steps of a rest: two coarse sensors can repeat values at once by chance, but rarely three times in a row."""

SETTLES = 3
"""Samples of a sensor after a rest for which its probabilities stay held. The learner may have detected a freeze in the rest,
and a change by one unit of a coarse resolution can still be a freeze's dither."""


def at_rest(y: Floats) -> Flags:
    """Return the steps at which the last sample of every sensor equals the one before; none with a single sensor.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples. At a step without a sample the sensor's last one counts.
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


def known(rest: Flags) -> Flags:
    """Return the steps of rests at which it is known that all sensors repeat their values."""
    later = rest.copy()
    for begin, _ in periods(rest):
        later[begin : begin + LEAST - 1] = False
    return later


def surprises(recording: Recording, model: LinearModel) -> bool:
    """Return whether a rest means that samples say nothing of the quantity, as those of a logger that repeats its last row.

    They then count as missing: else they would be believed, and all sensors blamed when the logger goes on. Coarse sensors repeat
    their values also while the quantity moves by less than a step, and say that: beside a single other one, which may be frozen,
    they count on.
    """
    variances = np.diag(model.matrix("sensor_covariance"))
    return int(np.sum(np.array(recording.resolution) ** 2 < COARSE * variances)) > 1


def held(
    signals: Mapping[str, Floats], names: Iterable[str], y: Floats, rest: Flags, silent: Flags | None = None
) -> dict[str, Floats]:
    """Return the signals, some of which keep their values from before a rest until it ends for their sensor.

    They also keep them at steps that say nothing of it.

    Parameters
    ----------
    signals : mapping of str to ndarray
        By name, over the steps.
    names : iterable of str
        The signals that are held, each with one column per sensor.
    y : ndarray, steps x sensors
        Samples.
    rest : ndarray, steps
        From `at_rest`.
    silent : ndarray, steps x sensors, optional
        Steps that say nothing of a sensor, as those in a gap of the recording.
    """
    steps, kept = np.arange(len(y)), {name: signals[name].copy() for name in names}
    for i, column in enumerate(y.T):
        count = np.cumsum(np.isfinite(column))
        before = np.maximum.accumulate(np.where(rest, count, -SETTLES - 1))
        kept_here = count - before <= SETTLES if silent is None else silent[:, i] | (count - before <= SETTLES)
        last = np.maximum.accumulate(np.where(kept_here, 0, steps))
        for values in kept.values():
            values[:, i] = values[last, i]
    return {**signals, **kept}


class RestWatch:
    """Holds signals at rest while samples arrive, as `held` does in a recording.

    A rest is known at its third step only. So a signal has its own values in the first two, and then those of before.

    Parameters
    ----------
    sensors : int
        Number of sensors.
    """

    def __init__(self, sensors: int):
        self._last = np.full(sensors, np.nan)
        self._equal = np.zeros(sensors, dtype=bool)
        self._since = np.full(sensors, SETTLES + 1)
        self._was_held = np.zeros(sensors, dtype=bool)
        self._alike = 0
        self._given: deque[dict[str, Floats]] = deque(maxlen=LEAST)

    def see(self, y: Floats) -> bool:
        """Take the samples of a step, one for each sensor; return whether all are known to repeat their values."""
        there = np.isfinite(y)
        self._equal[there] = y[there] == self._last[there]
        self._last[there] = y[there]
        self._alike = self._alike + 1 if len(y) > 1 and self._equal.all() else 0
        self._was_held = self._since <= SETTLES
        self._since = np.zeros_like(self._since) if self._alike >= LEAST else self._since + there
        return self._alike >= LEAST

    def hold(self, signals: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return the signals of the step, each with one row per sensor."""
        is_held = self._since <= SETTLES
        given = {name: values.copy() for name, values in signals.items()}
        if self._given:
            for name, values in given.items():
                begins, goes_on = is_held & ~self._was_held, is_held & self._was_held
                values[begins] = self._given[0][name][begins]
                values[goes_on] = self._given[-1][name][goes_on]
        self._given.append(given)
        return given
