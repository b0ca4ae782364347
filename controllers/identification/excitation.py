"""Whether a recording's inputs move enough to tell what they do."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

MOVES = 5.0
"""A direction of past inputs that was moved by less than this many samples' worth was not moved: noise does not average out."""

ROWS = 20_000
"""Samples that are looked at, from the first on."""


def order_of_excitation(u: Floats, most: int) -> tuple[int, list[int]]:
    """Return the order of which inputs are persistently exciting, up to `most`, and which of them are not of the next one.

    Inputs are exciting of order L if the block Hankel matrix of L rows of them has full rank (Willems et al., Systems & Control
    Letters 54, 2005): no combination of their last L samples stays what it is. A single step has order 1, each sine 2, white
    noise any.

    Parameters
    ----------
    u : ndarray, samples x inputs
        Inputs of mean 0 and variance 1; rows with NaN are left out with all that needs them.
    most : int
        Orders beyond this are not asked about.
    """
    u = u[:ROWS]
    for order in range(1, most + 1):
        hankel = np.hstack([u[order - 1 - lag : len(u) - lag] for lag in range(order)])
        hankel = hankel[np.isfinite(hankel).all(axis=1)]
        hankel = hankel - hankel.mean(axis=0)
        sizes, directions = np.linalg.eigh(hankel.T @ hankel)
        if sizes[0] < MOVES:
            still = directions[:, sizes < MOVES].reshape(order, u.shape[1], -1)
            share = (still**2).sum(axis=(0, 2)) / (still**2).sum()
            return order - 1, [int(i) for i in np.flatnonzero(share > 0.1)]
    return most, []


def moved_by_outputs(u: Floats, y: Floats, past: int) -> list[int]:
    """Return which inputs follow from the outputs and the past: a controller moves them, and nothing else does.

    Those which follow from the inputs' own past alone (sums of sines) do not count.

    Parameters
    ----------
    u, y : ndarray, samples x inputs or outputs
        Of mean 0 and variance 1.
    past : int
        How many samples ago counts.
    """
    u, y = u[:ROWS], y[:ROWS]
    rows = np.arange(past, len(u))
    own = np.hstack([u[rows - lag] for lag in range(1, past + 1)])
    both = np.hstack([own, *(y[rows - lag] for lag in range(past + 1))])
    whole = np.isfinite(both).all(axis=1) & np.isfinite(u[rows]).all(axis=1)
    if whole.sum() < 4 * both.shape[1]:
        return []
    left = []
    for known in (own, both):
        given = np.hstack([known, np.ones((len(rows), 1))])[whole]
        e = u[rows][whole] - given @ np.linalg.lstsq(given, u[rows][whole], rcond=None)[0]
        left.append((e**2).sum(axis=0))
    return [int(i) for i in np.flatnonzero((left[1] < MOVES) & (left[1] < 1e-2 * left[0]))]
