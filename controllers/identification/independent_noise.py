"""From the innovations model to independent noise of process and sensors."""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.linalg.lyapunov import stationary_covariance
from bayesftc.controllers.linalg.riccati import doubled
from bayesftc.cosim.types import Floats

MOST = 60
"""Largest number of free parameters; a gradient needs as many evaluations, each of the third power of the order."""
DOUBLINGS = 60
"""Largest number of doublings of the steps of a Riccati equation."""


def independent_noise(A: Floats, C: Floats, K: Floats, S: Floats) -> tuple[Floats, Floats]:
    """Return covariances Q (any) and R (diagonal) whose Kalman filter is nearest to the innovations model (A, C, K, S).

    A `LinearModel` assumes that a sensor's noise is independent of the process and of the other sensors. Of all such pairs, the
    one is taken with the largest average likelihood of data from the innovations model, the limit of maximum likelihood on a long
    recording. The criterion is ln |S_QR| + tr(S_QR^-1 V), where S_QR is the innovation covariance by Q and R, and V the actual
    one of their filter. Fewer than (n + 1) / 2 outputs do not determine Q; then one of the equally good ones is returned. From
    about order 10 on, where a free Q would have more than `MOST` parameters, Q is a multiple of K S K', the effect of the
    innovations on the state.
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
            P = doubled(A, C.T @ np.linalg.solve(R, C), Q, DOUBLINGS)
            promised = C @ P @ C.T + R
            gain = A @ np.linalg.solve(promised, C @ P).T
            between = stationary_covariance(A - gain @ C, (K - gain) @ S @ (K - gain).T)
        except np.linalg.LinAlgError:
            return 1e10
        real = C @ between @ C.T + S
        value = float(np.linalg.slogdet(promised)[1] + np.trace(np.linalg.solve(promised, real)))
        return value if np.isfinite(value) else 1e10

    best = None
    for share in (0.8, 0.3):  # initial share of the sensors' noise in the innovations
        with np.errstate(all="ignore"):  # an overflow compares as no better
            optimum = minimize(
                criterion, np.concatenate([start, np.full(m, np.log(share))]), method="BFGS", options={"gtol": 1e-7}
            )
        if best is None or optimum.fun < best.fun:
            best = optimum
    assert best is not None
    Q, R = unpack(best.x)
    return Q, R * np.outer(units, units)
