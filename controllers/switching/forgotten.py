"""How far a belief may fade: beyond what is known of a model's states if all samples are forgotten."""

from __future__ import annotations

from math import inf

import numpy as np

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.switching.bank.hypothesis import FADED
from bayesftc.cosim.types import Floats

DOUBLINGS = 40
"""Number of doublings of the time over which process noise acts: more samples than any recording has."""


def most_variances(model: LinearModel) -> Floats:
    """Return the variance of each state up to which a belief fades: `FADED` times that without any sample, in the long run.

    Without this limit, a slow state that no sensor reads, such as the temperature of a wall, reaches any variance before a
    reading shows it, and then even a tiny probability of that belief spoils the estimate. It is infinite for a state that does
    not decay or that no noise moves, and for the constant.

    The model may be wrong, and the state then farther away than it says. With 1 in place of `FADED`, a load that the model lacks
    makes the controller of a hall blame healthy sensors for 85 % of a day, in place of .1 %. With 1e5, a slow state that no
    sensor reads is nearly twice as far off as in a Kalman filter.
    """
    A, S = (model.moving.matrix(name) for name in ("A", "process_covariance"))
    with np.errstate(all="ignore"):  # of modes that grow
        for _ in range(DOUBLINGS):
            S, A = S + A @ S @ A.T, A @ A
        lasting = ~(np.abs(A) < 1.0).all(axis=1)  # NaN is not below 1
    variances = np.diag(S)
    most = np.full(model.states, inf)
    most[: len(S)] = np.where(lasting | ~(variances > 0.0) | ~np.isfinite(variances), inf, FADED * variances)
    return most


__all__ = ["most_variances"]
