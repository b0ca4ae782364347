"""Angles that begin anew after a full turn, such as headings from 0 to 360 degrees: recognise them, and count on."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesftc.cosim.types import Floats

PERIODS = (360.0, 2 * np.pi)
"""Full turns that are recognised."""

JUMP = 0.8
"""Least share of a period of the jump from one end of the range to the other."""

SMALL = 0.125
"""Largest share of a period of the usual change between two samples: noise of a larger one may jump by a period as well."""

LIKE = 2.0
"""Multiple of the usual change within which a jump is as long as the period."""

SPAN = 1.01
"""Largest range of the samples as a share of the period; roundings may be beyond."""

OFTEN = 3
"""Least number of jumps if only one of the sensors has them: a spike is two."""

RECENT = 100
"""Steps without another value after which a sensor does not show any more where the quantity is: it has frozen or is silent."""


def find_period(columns: Iterable[Floats]) -> float:
    """Return the period of redundant sensors whose samples jump by a full turn up and down; 0 if they do not."""
    values = [column[np.isfinite(column)] for column in columns]
    for period in PERIODS:
        jumps = [_jumps(column, period) for column in values]
        if sum(count > 0 for count in jumps) > 1 or max(jumps, default=0) >= OFTEN:
            return float(period)
    return 0.0


def _jumps(values: Floats, period: float) -> int:
    """Return the number of jumps of a sensor by a period; 0 if they are not as long as it."""
    if len(values) < 2 or np.ptp(values) > SPAN * period:
        return 0
    size = np.abs(np.diff(values))
    far = size > JUMP * period
    if not far.any() or far.all():
        return 0
    usual = float(np.quantile(size[~far], 0.99))
    same = float(np.median(np.abs(size[far] - period))) <= LIKE * usual
    return int(far.sum()) if same and usual <= SMALL * period else 0


class Turns:
    """Puts the samples of redundant sensors of an angle on the turn that is nearest to the quantity, step by step.

    The quantity is where the median of the sensors was. So one sensor that fails, or is silent during a turn, does not get onto
    another turn than the others. A sensor that repeats its sample stays where it is.

    Parameters
    ----------
    periods : sequence of float
        Period of each sensor, 0 for those that are no angles. Sensors with the same period measure the same angle.
    """

    def __init__(self, periods: Iterable[float]):
        self._periods = np.array([*periods], dtype=np.float64)
        self._groups = [np.flatnonzero(self._periods == period) for period in np.unique(self._periods) if period > 0]
        self._raw, self._placed = (np.full(len(self._periods), np.nan) for _ in range(2))
        self._age = np.full(len(self._periods), RECENT)

    @property
    def needed(self) -> bool:
        """Whether any sensor measures an angle."""
        return bool(self._groups)

    def place(self, y: Floats) -> Floats:
        """Return the samples of a step on their turns; missing ones, and those of other quantities, stay."""
        if not self._groups:
            return y
        placed = y.copy()
        new = np.isfinite(y) & (y != self._raw)
        for group in self._groups:
            level = self._level(group, y)
            turns = np.rint((level - y[group]) / self._periods[group])
            on = np.where(new[group], y[group] + self._periods[group] * turns, self._placed[group])
            placed[group] = np.where(np.isfinite(y[group]), on, np.nan)
        there = np.isfinite(y)
        self._raw[there], self._placed[there] = y[there], placed[there]
        self._age = np.where(new, 0, self._age + 1)
        return placed

    def _level(self, group: np.ndarray, y: Floats) -> float:
        """Return where the angle was at the last steps; at the first one that of the first sensor with a sample."""
        known = np.isfinite(self._placed[group])
        recent = known & (self._age[group] < RECENT)
        of = self._placed[group][recent if recent.any() else known]
        if len(of):
            return float(np.median(of))
        first = y[group][np.isfinite(y[group])]
        return float(first[0]) if len(first) else np.nan


__all__ = ["SPAN", "Turns", "find_period"]
