"""Find sensors of a measurement function that are linear in the state, such as an encoder beside a camera."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats, Kernel


def linear_rows(function: Kernel, samples: int, states: int) -> Floats:
    """Return the row of each sample that is linear in the state, and NaN for each other one (samples x states).

    The test is by values: at zero, on each axis, and at points of several sizes in general position. A nonlinear function agrees
    with its row to 1e-9 there only by chance.

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
