"""Many steps of a Riccati recursion at once."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats


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


__all__ = ["doubled"]
