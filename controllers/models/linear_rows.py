"""Which sensors of a measurement function read a linear function of the state, as an encoder beside a camera does."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats, Kernel


def linear_rows(function: Kernel, samples: int, states: int) -> Floats:
    """Return a row for each sample that is linear in the state, and a row of NaN for each that is not (samples x states).

    Judged by values: at zero, on each axis, and at points of several sizes in general position, where a function that is not
    linear would agree with its row to 1e-9 by chance only.

    Parameters
    ----------
    function : function
        A step function ``function(x, y)``.
    samples, states : int
        Lengths of y and x.
    """

    def at(point: Floats) -> Floats:
        y = np.full(samples, np.nan)
        with np.errstate(all="ignore"):
            function(np.array(point, dtype=np.float64), y)
        return y

    rows = np.column_stack([at(axis) for axis in np.eye(states)])
    points = np.random.default_rng(0).normal(size=(8, states)) * np.geomspace(0.1, 10.0, 8)[:, np.newaxis]
    linear = at(np.zeros(states)) == 0.0
    for point in points:
        with np.errstate(all="ignore"):
            linear &= np.abs(at(point) - rows @ point) <= 1e-9 * (np.abs(rows) @ np.abs(point))
    rows[~linear] = np.nan
    return rows
