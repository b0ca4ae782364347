"""The consistency check beside a nonlinear controller: each set of sensors has an extended Kalman filter of its own.

What `_consistency` asks of steady observers is asked of these, whose gain and whose innovations' covariance go with the state.
Sets and rest are those of the model linearised at the initial mean.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.minimise import Ahead
from bayesftc.controllers.estimation.consistency import UNSEEN, disagreement, grow_old, is_seen, moments_of
from bayesftc.controllers.estimation.filter import Belief, UpdateSpace, keep_only, measure
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.linalg.dense import cholesky, multiply, multiply_transposed, whiten
from bayesftc.cosim.ops import both, minimum, select
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats, Kernel

SQUARES, VECTORS = 2, 3
"""How many arrays of scratch space the filters need: states x states, and as long as there are states or sensors."""


class ExtendedSeers(NamedTuple):
    """The filters of all sets of sensors: as `Seers`, with the covariance of each, the sensors it sees, and its process noise.

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


EXTENDED_SEERS = named_alike(ExtendedSeers, "seer_", suspect="model_suspect")
"""What the arrays of the filters are called."""


def extended_consistency(start: LinearModel, mean: Floats, covariance: Floats) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the state and the parameters of the check for a model linearised where it starts, and for the belief there."""
    seers, m = observers(start), start.sensors
    chosen = ((),) if seers is None else seers.sensors
    state, settings = moments_of(seers, m)
    state |= {
        "seer_mean": np.tile(mean, (len(chosen), 1)),
        "seer_covariance": np.tile(covariance, (len(chosen), 1, 1)),
    }
    sees = np.array([[float(i in those) for i in range(m)] for those in chosen])
    noise = np.tile(start.matrix("process_covariance"), (len(chosen), 1, 1)) if seers is None else seers.noise
    return state, {"seer_sees": sees, "seer_noise": noise, "seer_settings": settings}


def innovate_alone(heard, sees, nominal, mean, covariance, ahead, e, CP, spread, white):
    """Write the innovations of one filter: ``e`` as they are, whitened ones where they are kept; 0 of sensors it does not see."""
    multiply(ahead.C, covariance, CP)
    multiply_transposed(CP, ahead.C, spread)
    for i in range(e.shape[0]):
        d = heard[i] - ahead.reading[i]
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
    """Return the step function of the check: `_consistency.check_consistency` and ``follow``, of extended Kalman filters.

    Parameters
    ----------
    g, g_jacobian : step function
        What the sensors read, and its derivatives.
    predict : step function
        What takes a belief to the next sample, by the model.
    """

    def watch(heard, est, point, spread_out):
        n, seers, ahead, nominal = point.shape[0], est.seers, est.ahead, est.sample.nominal
        counts = grow_old(seers)
        least = 1e300 + 0.0 * counts
        for s in range(seers.mean.shape[0]):
            mean, covariance, sees = seers.mean[s], seers.covariance[s], seers.sees[s]
            belief = Belief(mean, covariance, point, spread_out)
            g(mean, ahead.reading)
            g_jacobian(mean, ahead.C)
            innovate_alone(
                heard, sees, nominal, mean, covariance, ahead, seers.error, est.CP, est.sample.spread, seers.white[s, 1]
            )
            there = is_seen(s, seers.white)
            least = minimum(least, disagreement(s, there, counts, seers))
            space = UpdateSpace(
                est.sample.spread,
                est.CP,
                seers.vectors[0],
                seers.vectors[1],
                seers.vectors[2],
                seers.squares[0],
                seers.squares[1],
            )
            measure(seers.error, sees, nominal, ahead.C, belief, space)
            for i in range(n):
                point[i] = select(there, point[i], est.belief.x_hat[i])
                for j in range(n):
                    spread_out[i, j] = select(there, spread_out[i, j], est.belief.P[i, j])
            own = Ahead(seers.noise[s], ahead.reading, ahead.following, ahead.C, ahead.F, ahead.B, ahead.slope)
            predict(belief, est.applied, est.bounds, own)
        seers.suspect[0] = least / (1.0 + least)

    return watch
