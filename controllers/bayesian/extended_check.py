"""The consistency check beside a nonlinear controller: each set of sensors has an extended Kalman filter of its own.

What `_consistency` asks of steady observers is asked of these, whose gain and whose innovations' covariance go with the state.
Sets and rest are those of the model linearised at the initial mean.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.estimation.consistency import UNSEEN, disagreement, grow_old, is_seen, moments_of
from bayesftc.controllers.estimation.filter import keep_only, measure
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.linalg.dense import cholesky, multiply, multiply_transposed, whiten
from bayesftc.cosim.ops import both, minimum, select

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats, Kernel

SQUARES, VECTORS = 2, 3
"""How many arrays of scratch space the filters need: states x states, and as long as there are states or sensors."""


def extended_consistency(start: LinearModel, mean: Floats, covariance: Floats) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the state and the parameters of the check for a model linearised where it starts, and for the belief there."""
    seers, n, m = observers(start), start.states, start.sensors
    chosen = ((),) if seers is None else seers.sensors
    state, settings = moments_of(seers, m)
    state |= {
        "seer_mean": np.tile(mean, (len(chosen), 1)),
        "seer_covariance": np.tile(covariance, (len(chosen), 1, 1)),
        "seer_squares": np.zeros((SQUARES, n, n)),
        "seer_vectors": np.zeros((VECTORS, max(n, m))),
    }
    sees = np.array([[float(i in those) for i in range(m)] for those in chosen])
    noise = np.tile(start.matrix("process_covariance"), (len(chosen), 1, 1)) if seers is None else seers.noise
    return state, {"seer_sees": sees, "seer_noise": noise, "seer_settings": settings}


def innovate_alone(heard, sees, nominal, mean, covariance, reading, C, e, CP, spread, white):
    """Write the innovations of one filter: ``e`` as they are, whitened ones where they are kept; 0 of sensors it does not see."""
    multiply(C, covariance, CP)
    multiply_transposed(CP, C, spread)
    for i in range(e.shape[0]):
        d = heard[i] - reading[i]
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

    def watch(
        heard, x_hat, P, applied, nominal, largest, initial_mean, initial_covariance,
        reading, C, e, CP, spread, point, spread_out, following, F, B, FP,
        seer_new, seer_mean, seer_covariance, seer_sees, seer_noise, seer_white, seer_moments, seer_settings,
        seer_squares, seer_vectors, model_suspect,
    ):  # fmt: skip
        n = x_hat.shape[0]
        counts = grow_old(seer_new, seer_settings)
        least = 1e300 + 0.0 * counts
        for s in range(seer_mean.shape[0]):
            mean, covariance, sees = seer_mean[s], seer_covariance[s], seer_sees[s]
            g(mean, reading)
            g_jacobian(mean, C)
            innovate_alone(heard, sees, nominal, mean, covariance, reading, C, e, CP, spread, seer_white[s, 1])
            there = is_seen(s, seer_white)
            least = minimum(least, disagreement(s, there, counts, seer_white, seer_moments, seer_settings))
            measure(
                e, sees, nominal, C, mean, covariance, spread, CP, seer_vectors[0], seer_vectors[1], seer_vectors[2],
                seer_squares[0], seer_squares[1], point, spread_out,
            )  # fmt: skip
            for i in range(n):
                point[i] = select(there, point[i], x_hat[i])
                for j in range(n):
                    spread_out[i, j] = select(there, spread_out[i, j], P[i, j])
            predict(
                point, spread_out, applied, seer_noise[s], nominal, largest, initial_mean, initial_covariance,
                following, F, B, FP, reading, C, mean, covariance,
            )  # fmt: skip
        model_suspect[0] = least / (1.0 + least)

    return watch
