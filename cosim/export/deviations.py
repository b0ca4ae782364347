"""The deviation between two recordings of a signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Deviation:
    """The deviation of a signal of the FMU from that of the blocks.

    Attributes
    ----------
    signal : str
        Its name in the diagram.
    largest : float
        The largest absolute difference of any element at any step; infinite if only one of the two is NaN.
    time : float or None
        When it first occurs, in seconds; None if there is no difference.
    ulps : float
        This difference in units in the last place: the number of doubles between the two, plus one.
    relative : float
        This difference, divided by the largest absolute value of the signal.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise, limit = diagram.add(cosim.Gaussian(std=1.0)), diagram.add(cosim.Saturation(-1.0, 1.0), "limit")
    >>> diagram.connect(noise["y"], limit["u"])
    >>> with TemporaryDirectory() as folder:
    ...     fmu = cosim.export_fmu(cosim.Saturation(-1.0, 2.0), f"{folder}/limit.fmu", dt=0.1)  # another limit
    ...     deviation = cosim.verify_fmu(fmu, diagram, "limit", duration=100.0).beside[0]
    >>> deviation.signal, round(deviation.largest, 3), deviation.time
    ('limit.y', 1.0, 1.1)
    """

    signal: str
    largest: float
    time: float | None
    ulps: float
    relative: float


def deviation(signal: str, time: Floats, expected: Floats, actual: Floats) -> Deviation:
    """Return the deviation between two recordings of a signal, which have a row for each time."""
    with np.errstate(invalid="ignore"):  # the difference of infinities
        difference = np.abs(actual - expected)
    difference[np.isnan(difference)] = np.inf
    difference[(actual == expected) | (np.isnan(actual) & np.isnan(expected))] = 0.0
    row, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    largest = float(difference[row, column])
    if largest == 0.0:
        return Deviation(signal, 0.0, None, 0.0, 0.0)
    size = float(np.max(np.abs(expected[np.isfinite(expected)]), initial=0.0))
    ulps = np.inf if not np.isfinite(largest) else float(_between(actual[row, column], expected[row, column]))
    return Deviation(signal, largest, float(time[row]), ulps, largest / size if size else np.inf)


def _between(one: float, other: float) -> int:
    """Return the distance of two numbers in units in the last place."""
    first, second = (int(np.float64(abs(x)).view(np.int64)) * (-1 if x < 0.0 else 1) for x in (one, other))
    return abs(first - second)
