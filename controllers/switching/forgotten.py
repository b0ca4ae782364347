"""What is known of a model's states if all samples are forgotten."""

from __future__ import annotations

from math import inf

import numpy as np

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.types import Floats

DOUBLINGS = 40
"""Number of doublings of the time over which process noise acts: more samples than any recording has."""


def unsampled_variances(model: LinearModel) -> Floats:
    """Return the variance of each state that process noise moves without any sample, in the long run.

    A belief that fades forgets samples, all of them at most. Without this limit, a slow state that no sensor reads, such as
    the temperature of a wall, reaches any variance before a reading shows it, and then even a tiny probability of that belief
    spoils the estimate. The variance is infinite for a state that does not decay, and for the constant.
    """
    A, S = (model.moving.matrix(name) for name in ("A", "process_covariance"))
    with np.errstate(all="ignore"):  # of modes that grow
        for _ in range(DOUBLINGS):
            S, A = S + A @ S @ A.T, A @ A
    variances = np.full(model.states, inf)
    variances[: len(S)] = np.where(np.isfinite(np.diag(S)), np.diag(S), inf)
    return variances


__all__ = ["unsampled_variances"]
