"""From the innovations model to noise of the process and of the sensors that are independent of each other."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

MOST = 60
"""Numbers that are searched for at most: a gradient takes as many evaluations, each as long as the order's third power."""


def independent_noise(A: Floats, C: Floats, K: Floats, S: Floats) -> tuple[Floats, Floats]:
    """Return covariances Q (any) and R (diagonal) whose Kalman filter is nearest to the innovations model (A, C, K, S).

    A sensor's noise is its own and has nothing to do with the process: that is what a `LinearModel` believes. Of all such pairs
    the one is taken under which data of the innovations model have the largest likelihood on average, which is where maximum
    likelihood on a long recording would end. The criterion is ln |S_QR| + tr(S_QR^-1 V), where S_QR is the innovation
    covariance that Q and R promise and V the one that their filter really has. Where fewer than (n + 1) / 2 outputs leave Q
    undetermined, one of the equally good ones is returned. From about order 10 on, where a free Q would have more than `MOST`
    numbers, it is a multiple of what the innovations do to the state, K S K'.
    """
    from scipy.optimize import minimize

    n, m = K.shape
    units = np.sqrt(np.diag(S))
    C, K, S = C / units[:, None], K * units, S / np.outer(units, units)
    lower = np.tril_indices(n)
    innovations = K @ S @ K.T
    shape = np.linalg.cholesky(innovations + 1e-3 * max(float(np.trace(innovations)) / n, 1e-9) * np.eye(n))
    free = len(lower[0]) + m <= MOST
    start = shape[lower] if free else np.ones(1)

    def unpack(theta: Floats) -> tuple[Floats, Floats]:
        if free:
            L = np.zeros((n, n))
            L[lower] = theta[: len(start)]
        else:
            L = theta[0] * shape
        return L @ L.T + 1e-12 * np.eye(n), np.diag(np.exp(theta[len(start) :]))

    def criterion(theta: Floats) -> float:
        Q, R = unpack(theta)
        try:
            P = _riccati(A, C, Q, R)
            promised = C @ P @ C.T + R
            gain = A @ np.linalg.solve(promised, C @ P).T
            between = _lyapunov(A - gain @ C, (K - gain) @ S @ (K - gain).T)
        except np.linalg.LinAlgError:
            return 1e10
        real = C @ between @ C.T + S
        value = float(np.linalg.slogdet(promised)[1] + np.trace(np.linalg.solve(promised, real)))
        return value if np.isfinite(value) else 1e10

    best = None
    for share in (0.8, 0.3):  # how much of the innovations is the sensors' own, to begin with
        with np.errstate(all="ignore"):  # what is too large for a number is no better than what it is compared with
            found = minimize(
                criterion, np.concatenate([start, np.full(m, np.log(share))]), method="BFGS", options={"gtol": 1e-7}
            )
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    Q, R = unpack(best.x)
    return Q, R * np.outer(units, units)


def _riccati(A: Floats, C: Floats, Q: Floats, R: Floats) -> Floats:
    """Return the covariance of the prediction, by structure-preserving doubling (Chu et al., Linear Algebra Appl. 396, 2005).

    SciPy's solver is more careful and, for matrices as small as these, a hundred times slower; it is called once per evaluation.
    """
    F, G, P, one = A.T, C.T @ np.linalg.solve(R, C), Q, np.eye(len(A))
    for _ in range(60):
        inner = np.linalg.solve(one + G @ P, np.hstack([F, G]))
        left, right = inner[:, : len(A)], inner[:, len(A) :]
        step = F.T @ P @ left
        F, G, P = F @ left, G + F @ right @ F.T, P + (step + step.T) / 2
        if not np.abs(step).max() > 1e-15 * np.abs(P).max():
            break
    return np.asarray(P)


def _lyapunov(M: Floats, W: Floats) -> Floats:
    """Return X with ``X = M X M' + W``, by doubling."""
    X = W
    for _ in range(60):
        step = M @ X @ M.T
        X, M = X + step, M @ M
        if not np.abs(step).max() > 1e-15 * np.abs(X).max():
            break
    return np.asarray(X)
