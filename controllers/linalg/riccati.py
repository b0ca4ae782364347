"""Solutions of Riccati equations: the steady state, and many steps of the recursion at once."""

from __future__ import annotations

import warnings
from functools import lru_cache

import numpy as np

from bayesftc.cosim.types import Floats

ROUNDING = 1e-9
"""Size of a negative eigenvalue up to which a covariance counts as rounded."""

SMALL = 1e-6
"""Mean variance of sensors below which the equation is solved in units of it."""

NEWTON_STEPS = 5
"""Most steps of Newton's method; it doubles the digits at each, and one makes the covariance positive."""


class _ByValue:
    """A matrix that equals another of the same elements in the same order in memory, in which sums have the same bits."""

    def __init__(self, matrix: Floats) -> None:
        self.matrix = matrix.copy(order="K")
        self._key = matrix.shape, matrix.strides, matrix.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByValue) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def predicted_covariance(A: Floats, C: Floats, Q: Floats, R: Floats) -> Floats:
    """Return the solution of the filter's Riccati equation.

    Elements of A that are no more than rounding can mislead scipy's balancing: its solution then has a negative variance.
    Newton's method, of which each step is a Lyapunov equation, gives a covariance from there (Hewer 1971). Small
    variances, as of nanometres in SI units, would be lost beside elements of A near 1. So they are solved for in units of the
    sensors' variance.

    Raises
    ------
    LinAlgError, ValueError
        If there is none.
    """
    size = float(np.trace(R)) / len(R)
    unit = size if 0.0 < size < SMALL else 1.0
    return _solved(*map(_ByValue, (A, C, Q / unit, R / unit))) * unit


@lru_cache(maxsize=512)  # a design, its learner, and each diagnosis ask for the same filters
def _solved(*given: _ByValue) -> Floats:
    from scipy.linalg import LinAlgWarning, solve_discrete_are, solve_discrete_lyapunov

    A, C, Q, R = (each.matrix for each in given)
    P = np.asarray(solve_discrete_are(A.T, C.T, Q, R))
    for _ in range(NEWTON_STEPS):
        if is_covariance(P):
            break
        F, K = error_transition(A, C, P, R)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)  # whoever uses the result judges it
            P = np.asarray(solve_discrete_lyapunov(F, Q + A @ K @ R @ K.T @ A.T))
    return P


def is_covariance(P: Floats) -> bool:
    """Return whether a matrix has no negative eigenvalue, but for rounding, in units in which its variances are 1."""
    variances = np.diag(P)
    units = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    correlation = (P + P.T) / 2 / np.outer(units, units)
    return bool((variances >= 0.0).all()) and float(np.linalg.eigvalsh(correlation)[0]) >= -ROUNDING


def error_transition(A: Floats, C: Floats, P: Floats, R: Floats) -> tuple[Floats, Floats]:
    """Return the transition matrix of the prediction error, A (I - K C), and the gain K."""
    K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return np.asarray(A @ (np.eye(len(A)) - K @ C)), np.asarray(K, dtype=np.float64)


def doubled(A: Floats, G: Floats, Q: Floats, most: int) -> Floats:
    """Return the result of many steps of ``P' = A P (I + G P)^-1 A' + Q`` from P = 0 on, by doubling their number.

    Two such maps in a row are again such a map (Chu et al., Linear Algebra Appl. 396, 2005). SciPy's solver of the equation is
    more careful but, for small matrices, a hundred times slower.

    Parameters
    ----------
    A, G, Q : ndarray, n x n
        Of a filter the transition, the information of a sample (C' R^-1 C) and the process noise; G and Q are symmetric.
    most : int
        Largest number of doublings; fewer if P does not change any more.

    Returns
    -------
    ndarray, n x n
        P, not finite if it grows for ever.
    """
    F, P, one = A.T, Q, np.eye(len(A))
    with np.errstate(all="ignore"):
        for _ in range(most):
            inner = np.linalg.solve(one + G @ P, np.hstack([F, G]))
            left, right = inner[:, : len(A)], inner[:, len(A) :]
            step = F.T @ P @ left
            F, G, P = F @ left, G + F @ right @ F.T, P + (step + step.T) / 2
            if not np.abs(step).max() > 1e-15 * np.abs(P).max():
                break
    return np.asarray(P)


__all__ = ["doubled", "error_transition", "is_covariance", "predicted_covariance"]
