"""How far two recordings of a signal are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Deviation:
    """How far a signal of the FMU is from that of the blocks.

    Attributes
    ----------
    signal : str
        Its name in the diagram.
    largest : float
        The largest absolute difference of any element at any step; infinite where one of the two is NaN and the other is not.
    time : float or None
        When it is met first, in seconds; None where there is no difference.
    ulps : float
        That difference in units in the last place: how many doubles lie between the two, plus one.
    relative : float
        It, by the largest absolute value of the signal.
    """

    signal: str
    largest: float
    time: float | None
    ulps: float
    relative: float


def deviation(signal: str, time: Floats, expected: Floats, got: Floats) -> Deviation:
    """Return how far apart two recordings of a signal are, with a row for each time."""
    with np.errstate(invalid="ignore"):  # the difference of infinities
        apart = np.abs(got - expected)
    apart[np.isnan(apart)] = np.inf
    apart[(got == expected) | (np.isnan(got) & np.isnan(expected))] = 0.0
    row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
    largest = float(apart[row, column])
    if largest == 0.0:
        return Deviation(signal, 0.0, None, 0.0, 0.0)
    size = float(np.max(np.abs(expected[np.isfinite(expected)]), initial=0.0))
    ulps = np.inf if not np.isfinite(largest) else float(_between(got[row, column], expected[row, column]))
    return Deviation(signal, largest, float(time[row]), ulps, largest / size if size else np.inf)


def _between(one: float, other: float) -> int:
    """Return how many steps from a double to the next one lead from one number to another."""
    first, second = (int(np.float64(abs(x)).view(np.int64)) * (-1 if x < 0.0 else 1) for x in (one, other))
    return abs(first - second)
