"""The linear model of a recording with too many gaps to leave out, by expectation and maximisation.

A sensor that delivers only every fifth sample leaves no complete stretch of rows. The likelihood of the present samples needs
none, because a Kalman filter bridges the gaps. It is maximised step by step (Shumway and Stoffer, J. Time Series Analysis 3,
1982; Gibson and Ninness, Automatica 41, 2005): a smoother estimates the states, and regression on these gives the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.controllers.identification import gaps_kernels as kernels
from bayesftc.controllers.identification.subspace import choose_past, identify_innovations
from bayesftc.cosim.types import Floats

ROUNDS = 300
"""Largest number of rounds."""

SETTLED = 1e-2
"""Rounds end when the log-likelihood increases by less."""

MOST = 12
"""Largest order to try."""


@dataclass(frozen=True, eq=False)
class NoisyModel:
    """``x+ = A x + B u + drift + q``, ``y = C x + offset + r`` with independent noise, q of covariance Q, r of variances R."""

    A: Floats
    B: Floats
    drift: Floats
    C: Floats
    offset: Floats
    Q: Floats
    R: Floats


def identify_with_gaps(
    u: Floats, y: Floats, order: int | None, past: int | None, longest: int
) -> tuple[NoisyModel, Floats, int]:
    """Return the model, canonical correlations of the recording with straight lines in its gaps, and the past in use.

    Parameters
    ----------
    u, y : ndarray
        Inputs and outputs of mean 0 and variance 1; NaN where an output has no sample.
    order : int or None
        Number of states; None for the best Bayesian information criterion, from 1 up until two are worse.
    past : int or None
        Length of the autoregression at the start of the search; None for Akaike's choice.
    longest : int
        Largest past.
    """
    share = np.isfinite(y).mean(axis=0)
    often = share >= 0.5 * share.max()
    bridged = np.column_stack([_bridged(column) for column in y[:, often].T])
    past = choose_past(u, bridged, longest) if past is None else past
    candidates: list[tuple[float, NoisyModel, Floats]] = []
    for n in range(1, MOST + 1) if order is None else (order,):
        first = identify_innovations(u, bridged, n, past, longest)
        C, offset = np.zeros((len(share), n)), np.zeros(len(share))
        C[often], offset[often] = first.C, first.offset
        # The initial noise moves all states, because a noise that starts at zero would remain near zero.
        power = max(float(np.trace(first.K @ first.S @ first.K.T)) / n, 1e-6)
        start = NoisyModel(first.A, first.B, first.drift, C, offset, power * np.eye(n), np.full(len(share), 0.1))
        model, likelihood = bridge_gaps(u, y, start)
        numbers = n * (2 * len(share) + u.shape[1])
        candidates.append((numbers * np.log(np.isfinite(y).sum()) - 2 * likelihood, model, first.correlations))
        if len(candidates) > 2 and candidates[-3][0] <= min(candidates[-2][0], candidates[-1][0]):
            break
    _, model, correlations = min(candidates, key=lambda one: one[0])
    return model, correlations, past


def _bridged(column: Floats) -> Floats:
    present = np.flatnonzero(np.isfinite(column))
    return np.interp(np.arange(len(column)), present, column[present])


def bridge_gaps(u: Floats, y: Floats, model: NoisyModel) -> tuple[NoisyModel, float]:
    """Return the most likely model of samples with gaps near an initial one, and its log-likelihood.

    Parameters
    ----------
    u, y : ndarray
        Inputs and outputs, in units in which both are about 1 in size; NaN where an output has no sample.
    model : NoisyModel
        The initial model.
    """
    from bayesftc.cosim.stepping.compiler import compile_function

    smooth = compile_function(kernels.smooth, kernels.SMOOTH, kernels.CALLS)
    steps, n = len(y), len(model.A)
    present_all = np.isfinite(y)
    x0, P0 = np.zeros(n), np.eye(n)
    inputs = np.hstack([u, np.ones((steps, 1))])
    before, best = -np.inf, model
    for _ in range(ROUNDS):
        ahead, P_ahead = np.zeros((steps + 1, n)), np.zeros((steps + 1, n, n))
        x, P, between = np.zeros((steps, n)), np.zeros((steps, n, n)), np.zeros((n, n))
        ahead[0], P_ahead[0] = x0, P0
        current = (y - model.offset, u @ model.B.T + model.drift, model.A, model.C, model.Q, model.R)
        written = (ahead, P_ahead, x, P, between, np.zeros((5, n, n)))
        likelihood = float(smooth(*map(np.ascontiguousarray, current), *written))
        if not likelihood > before + SETTLED:
            break
        before, best = likelihood, model
        x0, P0 = x[0], (P[0] + P[0].T) / 2
        model = _maximised(x, P, between, inputs, y, present_all)
    return best, before


def _maximised(x: Floats, P: Floats, between: Floats, inputs: Floats, y: Floats, present_all: Floats) -> NoisyModel:
    n, m, p = x.shape[1], y.shape[1], inputs.shape[1] - 1
    now = np.hstack([x[:-1], inputs[:-1]])
    moments = now.T @ now
    moments[:n, :n] += P[:-1].sum(axis=0)
    cross = x[1:].T @ now
    cross[:, :n] += between
    moving: Floats = np.asarray(np.linalg.solve(moments, cross.T).T, dtype=np.float64)
    Q = (x[1:].T @ x[1:] + P[1:].sum(axis=0) - moving @ cross.T) / len(now)
    C, offset, R = np.empty((m, n)), np.empty(m), np.empty(m)
    for i in range(m):
        present = present_all[:, i]
        read, spread = np.hstack([x[present], np.ones((present.sum(), 1))]), P[present].sum(axis=0)
        moments = read.T @ read
        moments[:n, :n] += spread
        row = np.linalg.solve(moments, read.T @ y[present, i])
        C[i], offset[i] = row[:n], row[n]
        R[i] = (np.sum((y[present, i] - read @ row) ** 2) + C[i] @ spread @ C[i]) / present.sum()
    return NoisyModel(
        moving[:, :n], moving[:, n : n + p], moving[:, -1], C, offset, (Q + Q.T) / 2 + 1e-12 * np.eye(n), R + 1e-12
    )
