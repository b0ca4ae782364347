"""The consistency check beside a nonlinear controller: each set of sensors has an extended Kalman filter.

The module `consistency` makes the same check with steady observers. Here gains and covariances of the innovations depend on the
state. The sets of sensors and the noise are those of the model linearised at the initial mean.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.minimise import Ahead
from bayesftc.controllers.estimation.consistency import UNSEEN, disagreement, moments_of, sample_weight, usable
from bayesftc.controllers.estimation.filter import Belief, UpdateSpace, keep_only, measure
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.linalg.dense import cholesky, multiply, multiply_transposed, whiten
from bayesftc.cosim.ops import both, minimum, select
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats, Kernel

SQUARES, VECTORS = 2, 3
"""Numbers of the filters' scratch arrays: states x states, and of the length of the states or sensors."""


class FilterBank(NamedTuple):
    """The filters of all sets of sensors: as `ObserverBank`, with each one's covariance, its sensors, and its process noise.

    ``squares``, ``vectors`` and ``error`` are scratch space.
    """

    new: Floats
    mean: Floats
    covariance: Floats
    sees: Floats
    noise: Floats
    error: Floats
    white: Floats
    moments: Floats
    settings: Floats
    squares: Floats
    vectors: Floats
    suspect: Floats


FILTER_BANK = named_alike(FilterBank, "seer_", suspect="model_suspect")
"""Names of the arrays of the filters."""


def extended_consistency(start: LinearModel, mean: Floats, covariance: Floats) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the check's state and parameters for the model linearised at the initial mean, and for the initial belief."""
    bank, m = observers(start, groups=start.alike), start.sensors  # what is proportional here is not elsewhere
    chosen = ((),) if bank is None else bank.sensors
    state, settings = moments_of(bank, m)
    state |= {
        "seer_mean": np.tile(mean, (len(chosen), 1)),
        "seer_covariance": np.tile(covariance, (len(chosen), 1, 1)),
    }
    sees = np.array([[float(i in members) for i in range(m)] for members in chosen])
    noise = np.tile(start.matrix("process_covariance"), (len(chosen), 1, 1)) if bank is None else bank.noise
    return state, {"seer_sees": sees, "seer_noise": noise, "seer_settings": settings}


def innovate_alone(samples, sees, nominal, mean, covariance, ahead, e, CP, spread, white):
    """Write one filter's innovations into ``e``, and whitened into ``white``; 0 for sensors that it does not use."""
    multiply(ahead.C, covariance, CP)
    multiply_transposed(CP, ahead.C, spread)
    for i in range(e.shape[0]):
        d = samples[i] - ahead.reading[i]
        e[i] = select(sees[i] > 0.5, select(d - d == 0.0, d, UNSEEN), 0.0)
        white[i] = e[i]
        for j in range(e.shape[0]):
            both_seen = both(sees[i] > 0.5, sees[j] > 0.5)
            spread[i, j] = select(both_seen, spread[i, j] + nominal[i, j], 0.0)
    keep_only(sees, spread)
    cholesky(spread, spread)
    whiten(spread, CP, white)


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
        n, bank, ahead, nominal = point.shape[0], est.bank, est.ahead, est.sample.nominal
        counts = sample_weight(bank)
        least = 1e300 + 0.0 * counts
        for s in range(bank.mean.shape[0]):
            mean, covariance, sees = bank.mean[s], bank.covariance[s], bank.sees[s]
            belief = Belief(mean, covariance, point, spread_out)
            g(mean, ahead.reading)
            g_jacobian(mean, ahead.C)
            innovate_alone(
                samples,
                sees,
                nominal,
                mean,
                covariance,
                ahead,
                bank.error,
                est.CP,
                est.sample.spread,
                bank.white[s, 1],
            )
            usable_now = usable(s, bank.white)
            least = minimum(least, disagreement(s, usable_now, counts, bank))
            space = UpdateSpace(
                est.sample.spread,
                est.CP,
                bank.vectors[0],
                bank.vectors[1],
                bank.vectors[2],
                bank.squares[0],
                bank.squares[1],
            )
            measure(bank.error, sees, nominal, ahead.C, belief, space)
            for i in range(n):
                point[i] = select(usable_now, point[i], est.belief.x_hat[i])
                for j in range(n):
                    spread_out[i, j] = select(usable_now, spread_out[i, j], est.belief.P[i, j])
            model = Ahead(bank.noise[s], ahead.reading, ahead.following, ahead.C, ahead.F, ahead.B, ahead.slope)
            predict(belief, est.applied, est.bounds, model)
        bank.suspect[0] = least / (1.0 + least)

    return watch
