"""The steady covariance of a linear system under noise."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

DOUBLINGS = 60
"""Most doublings of the time; modes that need more are not damped."""


def stationary_covariance(M: Floats, W: Floats) -> Floats:
    """Return X with ``X = M X M' + W`` for a symmetric W, by doubling: Smith's method.

    In contrast to a solution as one system of equations (scipy's), rounding does not depend on the units of the states.

    Parameters
    ----------
    M : ndarray, shape (n, n)
        Transition matrix of a stable system.
    W : ndarray, shape (n, n)
        Covariance of its noise in each step.
    """
    X = W
    for _ in range(DOUBLINGS):
        step = M @ X @ M.T
        X, M = X + step, M @ M
        if not (np.diag(step) > 1e-15 * np.diag(X)).any():
            break
    return np.asarray(X)


__all__ = ["stationary_covariance"]
