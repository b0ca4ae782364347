"""Logs that repeat the last value of a slow sensor, or leave out a value that has not changed: recognise them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesftc.cosim.types import Floats

OFTEN = 20
"""Least number of changes: fewer do not show that they are regular."""

SLOWER = 1.9
"""Least number of rows from one change to the next: a new value in nearly every row is no slower sensor."""

NEAR = 0.25
"""Relative difference of two intervals that are equal, or a row: a new value waits for the next row."""

REGULAR = 0.8
"""Least share of intervals that are equal, or multiples. Of samples that repeat at random, at most 0.6 are."""

COARSE = 1.5
"""Multiple of the resolution up to which a change is one unit. A smooth quantity changes by one, also at regular intervals."""

LARGER = 0.1
"""Least share of changes by more than one unit: noise that is as large as the resolution has .4."""

EMPTY = 0.05
"""Least share of empty cells of a sensor that is logged only where it has changed."""

MANY = 200
"""Least number of its values."""

ONE_WAY = 0.2
"""Share of rises, or of falls, below which a signal moves in one direction: a counter or a filling tank never repeats a value."""

EDGE, AT_EDGE = 1.6, 0.05
"""Multiple of the least change up to which changes are near it, and their least share.

Of changes that are logged whatever their size, the least one is nearly 0, and the others are many times as large: of 200, a
twentieth is so near to the least one with a chance of 1 in 20,000.
"""


def is_held(time: Floats, values: Floats, resolution: float) -> bool:
    """Return whether the values change in nearly equal intervals of several rows, and repeat in between.

    Parameters
    ----------
    time, values : ndarray
        The samples, all finite.
    resolution : float
        Resolution of the sensor; 0 if it is too fine to matter.
    """
    changes = _fresh(values)
    if len(changes) < OFTEN or np.mean(np.abs(np.diff(values[changes])) > COARSE * resolution) < LARGER:
        return False
    rows = np.arange(float(len(time)))
    return any(_regular(np.diff(at[changes]), float(np.median(np.diff(at)))) for at in (time, rows))


def least_change(cells: Floats) -> float | None:
    """Return the least change of values that are logged only where they have changed; None if they are logged otherwise.

    Of samples that are lost at random, some equal the one before, or are as close to it as one likes.

    Parameters
    ----------
    cells : ndarray
        The values, NaN in an empty cell.
    """
    there = np.flatnonzero(np.isfinite(cells))
    if len(there) < MANY or 1.0 - len(there) / (there[-1] - there[0] + 1) < EMPTY:
        return None
    if _regular(np.diff(there).astype(float), 1.0):  # a slow sensor
        return None
    moved = np.diff(cells[there])
    if not ONE_WAY < np.mean(moved > 0) < 1.0 - ONE_WAY:
        return None
    changes = np.abs(moved)
    least = float(changes.min())
    return least if least > 0 and np.mean(changes <= EDGE * least) >= AT_EDGE else None


def _regular(intervals: Floats, row: float) -> bool:
    """Return whether most intervals are one of several rows, or a multiple of it where a sample equals the one before."""
    median = float(np.median(intervals))
    usual = float(intervals[np.abs(intervals - median) <= 0.5 * median].mean())
    if usual < SLOWER * row:
        return False
    apart = np.abs(intervals - np.maximum(np.rint(intervals / usual), 1.0) * usual)
    return bool(np.mean(apart < max(NEAR * usual, row)) >= REGULAR)


def _fresh(values: Floats) -> np.ndarray:
    """Return the places of the first value and of all that differ from the one before."""
    return np.flatnonzero(np.concatenate([[True], np.diff(values) != 0]))


def without_held(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the samples without values that repeat the one before."""
    fresh = _fresh(values)
    return time[fresh], values[fresh]


class HeldValues:
    """Finds repeated values of some sensors while rows arrive.

    Parameters
    ----------
    held : sequence of bool
        For each sensor, whether repeated values are no samples.
    """

    def __init__(self, held: Iterable[bool]):
        self._held = np.array([*held], dtype=bool)
        self._last = np.full(len(self._held), np.nan)

    def repeated(self, row: Floats) -> np.ndarray:
        """Return for each sensor whether its value in this row is the last one again, and no sample."""
        again = self._held & (row == self._last)
        self._last = np.where(np.isfinite(row), row, self._last)
        return np.asarray(again)


__all__ = ["HeldValues", "is_held", "least_change", "without_held"]
