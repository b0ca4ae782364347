"""Removal of integrators that no output sees, such as the position behind a speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.control.balance import balanced
from bayesftc.cosim.types import Floats

_EXACT = 1e-8
"""Relative size below which a direction counts as constant and unseen."""


@dataclass(frozen=True, eq=False)
class Quotient:
    """The remaining state ``z = rows x``; ``x = back z`` is one of the states that have it.

    ``dropped`` has a column for each direction that is not in z. It is invariant under A, so that z does not depend on it.
    """

    rows: Floats
    back: Floats
    dropped: Floats

    def of(self, A: Floats) -> Floats:
        """Return the transition of z."""
        return np.asarray(self.rows @ A @ self.back)


def without_integrators(A: Floats, H: Floats) -> Quotient | None:
    """Return the plant's state without the integrators that the outputs ``H x`` do not see; None if there is none.

    An integrator is a direction in which ``A - I`` is zero, or that drives only such directions: a position, and the speed behind
    it if only an acceleration is seen. Together they are the largest space within the kernel of H on which ``A - I`` is
    nilpotent, found power by power. If whole states are integrators, only these are removed; else z is a mixture of states.
    """
    n = len(A)
    same, units = balanced(A)
    visible = H * units
    sizes = np.linalg.norm(visible, axis=1)
    visible = visible / np.where(sizes > 0, sizes, 1.0)[:, None]
    change = same - np.eye(n)
    # Scaled to equal effects of all states, the result does not depend on units; states without effect keep theirs.
    effect = np.linalg.norm(np.vstack([visible, change]), axis=0)
    unit = 1.0 / np.where(effect > 1e-12, effect, 1.0)
    visible, change = visible * unit, change * unit / unit[:, None]
    space = np.zeros((n, 0))
    while True:
        _, sizes, right = np.linalg.svd(np.vstack([visible, change - space @ (space.T @ change)]))
        following = right[np.append(sizes, np.zeros(n - len(sizes))) <= _EXACT].T
        if following.shape[1] <= space.shape[1]:
            break
        space = following
    if not space.shape[1]:
        return None
    scale = units * unit
    sizes = np.linalg.norm(space, axis=1)
    alone = sizes > _EXACT
    if alone.sum() == space.shape[1]:
        one = np.eye(n)
        return Quotient(one[~alone], one[:, ~alone], one[:, alone])
    left = np.linalg.svd(space)[0][:, space.shape[1] :]
    return Quotient(left.T / scale, scale[:, None] * left, scale[:, None] * space)
