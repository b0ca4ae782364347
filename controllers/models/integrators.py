"""Integrators that nothing asks about, such as the position behind a speed: what is left of a plant without them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.types import Floats

_EXACT = 1e-8
"""A direction in which the plant stays, and which nothing sees, does so to this part of the other directions."""


@dataclass(frozen=True, eq=False)
class Quotient:
    """What is left of the state, ``z = rows x``; ``x = back z`` is one of the states of which it is left.

    ``dropped`` has a column for each direction that is not in z. It is invariant under A, so that z moves on its own.
    """

    rows: Floats
    back: Floats
    dropped: Floats

    def of(self, A: Floats) -> Floats:
        """Return the transition of z."""
        return np.asarray(self.rows @ A @ self.back)


def without_integrators(A: Floats, H: Floats) -> Quotient | None:
    """Return the plant's state without the integrators that the outputs ``H x`` do not see; None if there is none.

    An integrator is a direction in which ``A - I`` is zero, and what in turn drives only such ones: a position, and the speed
    behind it where only an acceleration is seen. They are the largest space within the kernel of H that ``A - I`` takes to
    nothing if applied often enough, found one power after the other. States that are integrators by themselves are left out as
    they are; else what is left is a mixture.
    """
    from scipy.linalg import matrix_balance

    n = len(A)
    with np.errstate(invalid="ignore"):  # of a permutation that SciPy reads out of the scales and nobody asked for
        balanced, (units, _) = matrix_balance(A, permute=False, separate=True)
    seen = H * units
    sizes = np.linalg.norm(seen, axis=1)
    seen = seen / np.where(sizes > 0, sizes, 1.0)[:, None]
    change = balanced - np.eye(n)
    # Each state in the unit in which it does as much as the others, so that no choice of units decides; not what does nothing.
    does = np.linalg.norm(np.vstack([seen, change]), axis=0)
    own = 1.0 / np.where(does > 1e-12, does, 1.0)
    seen, change = seen * own, change * own / own[:, None]
    found = np.zeros((n, 0))
    while True:
        _, sizes, right = np.linalg.svd(np.vstack([seen, change - found @ (found.T @ change)]))
        following = right[np.append(sizes, np.zeros(n - len(sizes))) <= _EXACT].T
        if following.shape[1] <= found.shape[1]:
            break
        found = following
    if not found.shape[1]:
        return None
    scale = units * own
    sizes = np.linalg.norm(found, axis=1)
    alone = sizes > _EXACT
    if alone.sum() == found.shape[1]:
        one = np.eye(n)
        return Quotient(one[~alone], one[:, ~alone], one[:, alone])
    left = np.linalg.svd(found)[0][:, found.shape[1] :]
    return Quotient(left.T / scale, scale[:, None] * left, scale[:, None] * found)
