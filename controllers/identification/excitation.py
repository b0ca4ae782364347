"""Tests whether a recording's inputs move enough for identification."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

MOVES = 5.0
"""Least sum of squares, in samples of variance 1, of a direction of past inputs that counts as moved."""

ROWS = 20_000
"""Largest number of samples in the tests, from the first one on."""

SINE, LEAST_OF_SINE = 0.85, 64
"""Share of an input's power in one spectral line from which on it is nearly a sine (a square wave has .81); least samples for
that."""


def order_of_excitation(u: Floats, most: int) -> tuple[int, list[int]]:
    """Return the order of persistent excitation, up to `most`, and the inputs that lack the next order.

    Inputs are exciting of order L if their block Hankel matrix of L rows has full rank (Willems et al., Systems & Control Letters
    54, 2005): no combination of their last L samples is constant. A single step has order 1, each sine 2, white noise any.

    Parameters
    ----------
    u : ndarray, samples x inputs
        Inputs of mean 0 and variance 1; stretches with NaN are left out.
    most : int
        Largest order to test.
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


def nearly_sines(u: Floats) -> list[int]:
    """Return the inputs of which a single sine is nearly all: what else moves them is mostly a controller's answer to noise.

    Parameters
    ----------
    u : ndarray, samples x inputs
        Inputs; samples with NaN are left out.
    """
    found = []
    for i, column in enumerate(u.T):
        values = column[np.isfinite(column)]
        if len(values) < LEAST_OF_SINE or not np.ptp(values):
            continue
        power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))) ** 2
        peak = int(power.argmax())
        if power[max(peak - 2, 0) : peak + 3].sum() > SINE * power.sum():
            found.append(i)
    return found


def moved_by_outputs(u: Floats, y: Floats, past: int) -> list[int]:
    """Return the inputs that follow from the outputs and the past: only a controller moves them.

    Inputs that follow from the inputs' past alone (sums of sines) do not count.

    Parameters
    ----------
    u, y : ndarray, samples x inputs or outputs
        Inputs and outputs of mean 0 and variance 1.
    past : int
        Number of past samples.
    """
    u, y = u[:ROWS], y[:ROWS]
    rows = np.arange(past, len(u))
    input_past = np.hstack([u[rows - lag] for lag in range(1, past + 1)])
    both = np.hstack([input_past, *(y[rows - lag] for lag in range(past + 1))])
    whole = np.isfinite(both).all(axis=1) & np.isfinite(u[rows]).all(axis=1)
    if whole.sum() < 4 * both.shape[1]:
        return []
    left = []
    for predictors in (input_past, both):
        regressors = np.hstack([predictors, np.ones((len(rows), 1))])[whole]
        e = u[rows][whole] - regressors @ np.linalg.lstsq(regressors, u[rows][whole], rcond=None)[0]
        left.append((e**2).sum(axis=0))
    return [int(i) for i in np.flatnonzero((left[1] < MOVES) & (left[1] < 1e-2 * left[0]))]
