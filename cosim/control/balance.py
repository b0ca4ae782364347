"""Balanced units of the states of a linear system, in which what counts as zero does not depend on the user's units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats


def balanced(A: Floats) -> tuple[Floats, Floats]:
    """Return a square matrix with rows and columns of about equal size, and the units of its states, powers of 2.

    In these units an input matrix is ``B / units[:, None]`` and an output matrix ``C * units``.
    """
    from scipy.linalg import matrix_balance

    if not len(A):
        return A, np.ones(0)
    with np.errstate(invalid="ignore"):  # SciPy also computes an unused permutation from the scales
        same, (units, _) = matrix_balance(A, permute=False, separate=True)
    return same, units


__all__ = ["balanced"]
