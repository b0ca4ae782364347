"""The consistency check beside a nonlinear controller: each set of sensors has an extended Kalman filter.

The module `consistency` makes the same check with a linear model. The sets of sensors and the noise are those of the model
linearised at the initial mean.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.bayesian.minimise import Ahead
from bayesftc.controllers.estimation.consistency import Check, check_of, correct, forget_start
from bayesftc.controllers.estimation.filter import Belief
from bayesftc.controllers.estimation.observers import observers
from bayesftc.cosim.ops import minimum

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats, Kernel


def extended_consistency(start: LinearModel, mean: Floats, covariance: Floats) -> Check:
    """Return the arrays of the check for the model linearised at the initial mean, and for the initial belief."""
    bank = observers(start, groups=start.alike)  # what is proportional here is not elsewhere
    check = check_of(bank, start.sensors, start.states, mean)
    return check._replace(
        state=check.state | {"seer_covariance": np.tile(covariance, (len(check.state["seer_mean"]), 1, 1))}
    )


@cache
def make_watch(g: Kernel, g_jacobian: Kernel, predict: Kernel) -> Kernel:
    """Return the step function of the check: `consistency.check_consistency` and ``follow`` with extended Kalman filters.

    Parameters
    ----------
    g, g_jacobian : step function
        The sensors' function of the state, and its derivatives.
    predict : step function
        Predicts a belief at the next sample by the model.
    """

    def watch(samples, est, point, spread_out):
        n, bank, ahead = point.shape[0], est.bank, est.ahead
        least = forget_start(bank)
        for s in range(bank.mean.shape[0]):
            mean, covariance = bank.mean[s], bank.covariance[s]
            g(mean, ahead.reading)
            g_jacobian(mean, ahead.C)
            for i in range(samples.shape[0]):
                bank.error[i] = samples[i] - ahead.reading[i]
            least = minimum(least, correct(s, est.belief.x_hat, ahead.C, est.sample.nominal, bank))
            for i in range(n):
                point[i] = mean[i]
                for j in range(n):
                    spread_out[i, j] = covariance[i, j]
            model = Ahead(bank.noise[s], ahead.reading, ahead.following, ahead.C, ahead.F, ahead.B, ahead.slope)
            predict(Belief(mean, covariance, point, spread_out), est.applied, est.bounds, model)
        bank.suspect[0] = least / (1.0 + least)

    return watch
