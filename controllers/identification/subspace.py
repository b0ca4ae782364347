"""Subspace identification of the innovations model from inputs and outputs, in open or closed loop.

The predictor form is identified (Jansson's SSARX, IFAC SYSID 2003; Chiuso and Picci, Automatica 41, 2005). A long autoregression
gives the predictor's pulse responses. Their effect of future inputs and outputs is subtracted from the future. The canonical
variables between the result and the past are the state. The predictor is stable, and its input, the past, is independent of the
innovation. Feedback and unstable plants are therefore allowed, unlike in N4SID and MOESP of other packages, which are biased in
closed loop, where unstable plants have to be recorded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

PASTS = (4, 6, 8, 12, 16, 24, 32, 48)
"""Lengths of the autoregression to try."""

RIDGE = 1e-12
"""Relative ridge that keeps the covariances of signals without noise invertible."""


@dataclass(frozen=True, eq=False)
class Innovations:
    """``x+ = A x + B u + drift + K e``, ``y = C x + offset + e`` with white e of the covariance S.

    ``correlations`` are the canonical correlations between past and future, those of the states first; ``past`` is the length of
    the autoregression, ``yardstick`` the covariance of its residuals.
    """

    A: Floats
    B: Floats
    C: Floats
    K: Floats
    S: Floats
    drift: Floats
    offset: Floats
    correlations: Floats
    past: int
    yardstick: Floats


def identify_innovations(
    u: Floats, y: Floats, order: int | None, past: int | None, longest: int = PASTS[-1]
) -> Innovations:
    """Return the innovations model of samples (N x p, N x m); stretches with NaN are left out.

    Parameters
    ----------
    u, y : ndarray
        Inputs and outputs, in comparable units.
    order : int or None
        Number of states; None for that of the singular value criterion (Bauer, Automatica 37, 2001).
    past : int or None
        Length of the autoregression; None for the choice by Akaike's criterion.
    longest : int
        Largest length of the autoregression.

    Raises
    ------
    ModelError
        If there are too few samples, or the inputs move too little.
    """
    m = y.shape[1]
    past = choose_past(u, y, longest) if past is None else past
    if order is not None:
        past = max(past, least_past(order, m))
    gain, yardstick = _autoregress(u, y, past)
    rows = np.arange(past, len(y) - past)
    before = _stacked(np.hstack([u, y]), rows, past)
    future = np.hstack([_without_future(u, y, gain, rows + i, i) for i in range(past)])
    whole = np.isfinite(before).all(axis=1) & np.isfinite(future).all(axis=1)
    before, future = before[whole] - before[whole].mean(axis=0), future[whole] - future[whole].mean(axis=0)
    number = len(before)
    left = np.linalg.cholesky(_covariance(future, future, RIDGE))
    right = np.linalg.cholesky(_covariance(before, before, RIDGE))
    coupling = np.linalg.solve(left, np.linalg.solve(right, _covariance(before, future, 0.0)).T)
    _, correlations, back = np.linalg.svd(coupling, full_matrices=False)
    n = _choose_order(correlations, number, u.shape[1], m) if order is None else order
    states = np.linalg.solve(right.T, back[:n].T)  # from the past, in units of the state's spread
    x = np.full((len(y) + 1, n), np.nan)
    at = np.arange(past, len(y) + 1)
    x[at] = _stacked(np.hstack([u, y]), at, past) @ states
    return _fit(u, y, x, correlations, past, yardstick)


def _fit(u: Floats, y: Floats, x: Floats, correlations: Floats, past: int, yardstick: Floats) -> Innovations:
    now, following, p = x[:-1], x[1:], u.shape[1]
    n = now.shape[1]
    one = np.ones((len(y), 1))
    read = np.isfinite(now).all(axis=1) & np.isfinite(y).all(axis=1)
    reading: Floats = np.asarray(
        np.linalg.lstsq(np.hstack([now, one])[read], y[read], rcond=None)[0].T, dtype=np.float64
    )
    e = y - np.hstack([now, one]) @ reading.T
    move = read & np.isfinite(following).all(axis=1) & np.isfinite(u).all(axis=1)
    moving: Floats = np.asarray(
        np.linalg.lstsq(np.hstack([now, u, e, one])[move], following[move], rcond=None)[0].T, dtype=np.float64
    )
    return Innovations(
        A=moving[:, :n],
        B=moving[:, n : n + p],
        C=reading[:, :n],
        K=moving[:, n + p : -1],
        S=_covariance(e[read], e[read], RIDGE),
        drift=moving[:, -1],
        offset=reading[:, -1],
        correlations=correlations,
        past=past,
        yardstick=yardstick,
    )


def _stacked(z: Floats, rows: np.ndarray[tuple[int], np.dtype[np.int64]], past: int) -> Floats:
    """Return ``z_k-1, z_k-2, ..., z_k-past`` side by side for each row k."""
    return np.hstack([z[rows - i] for i in range(1, past + 1)])


def _autoregress(u: Floats, y: Floats, past: int) -> tuple[Floats, Floats]:
    """Return the predictor's pulse responses (m x (p + m) past), and the covariance of its residuals."""
    from scipy.linalg import lstsq

    rows = np.arange(past, len(y))
    regressors = np.hstack([_stacked(np.hstack([u, y]), rows, past), np.ones((len(rows), 1))])
    whole = np.isfinite(regressors).all(axis=1) & np.isfinite(y[rows]).all(axis=1)
    count = int(whole.sum())
    if count < 4 * regressors.shape[1]:
        raise ModelError(
            f"The recording has {count} samples for {regressors.shape[1]} coefficients of an autoregression of {past} samples; "
            f"record at least {4 * regressors.shape[1]} without gaps, or give a smaller past=."
        )
    solution = lstsq(regressors[whole], y[rows][whole], lapack_driver="gelsy")[0]
    e = y[rows][whole] - regressors[whole] @ solution
    return solution[:-1].T, _covariance(e, e, 0.0)


def _without_future(
    u: Floats, y: Floats, gain: Floats, rows: np.ndarray[tuple[int], np.dtype[np.int64]], steps: int
) -> Floats:
    """Return the outputs at rows without the predicted effect of the last `steps` samples before them."""
    if steps == 0:
        return y[rows]
    width = u.shape[1] + y.shape[1]
    return np.asarray(y[rows] - _stacked(np.hstack([u, y]), rows, steps) @ gain[:, : steps * width].T)


def least_past(order: int, outputs: int) -> int:
    """Return the shortest autoregression for a model of an order."""
    return max(-(-order // outputs) + 1, 1)


def samples_needed(inputs: int, outputs: int, order: int | None, past: int | None) -> tuple[int, int]:
    """Return the number of samples needed for learning, and the shortest autoregression with these."""
    width = inputs + outputs
    least = 1 if order is None else least_past(order, outputs)
    if past is None and least <= PASTS[0]:
        return 8 * (PASTS[0] * width + 1), PASTS[0]
    length = max(least, PASTS[0] if past is None else past)
    return max(4 * (length * width + 1) + length, 8 * (PASTS[0] * width + 1) if past is None else 0), length


def choose_past(u: Floats, y: Floats, longest: int) -> int:
    """Return the length of the autoregression by Akaike's criterion, on the same samples for all lengths."""
    width, m = u.shape[1] + y.shape[1], y.shape[1]
    lengths = [past for past in PASTS if past <= longest and 8 * (past * width + 1) <= len(y)] or [PASTS[0]]
    rows = np.arange(lengths[-1], len(y))
    table = np.hstack([np.ones((len(rows), 1)), _stacked(np.hstack([u, y]), rows, lengths[-1]), y[rows]])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) <= table.shape[1]:
        return lengths[0]
    # One triangle serves all lengths: below the columns of a shorter past are the residuals of the outputs.
    triangle = np.asarray(np.linalg.qr(table, mode="r"))[:, -m:]
    criteria = []
    for past in lengths:
        residual = triangle[1 + past * width :]
        S = residual.T @ residual / len(table)
        size = np.linalg.slogdet(S + 1e-14 * np.trace(S) * np.eye(m))[1]
        criteria.append(len(table) * size + 2 * m * (past * width + 1))
    return lengths[int(np.argmin(criteria))]


def _choose_order(correlations: Floats, number: int, p: int, m: int) -> int:
    """Return the order at which the remaining correlations do not outweigh the parameters of a further state."""
    left = np.append(correlations[1:], 0.0)[: len(correlations)]
    cost = [(left[n - 1] ** 2 + (2 * n * m + n * p) * np.log(number) / number) for n in range(1, len(left) + 1)]
    return 1 + int(np.argmin(cost))


def _covariance(a: Floats, b: Floats, ridge: float) -> Floats:
    product = a.T @ b / len(a)
    if ridge:
        product = product + ridge * max(float(np.trace(product)) / len(product), 1e-300) * np.eye(len(product))
    return np.asarray(product)
