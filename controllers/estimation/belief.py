"""How a linear controller comes from the samples to its belief: precision learned and then used, or both inferred together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.estimation.filter import measure

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.controllers.precision.base import Learner


def learn_later(y, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability):
    """Leave it to the update: there precision and state are inferred together."""


@cache
def make_ways(
    learn: Callable[..., None], infer: Callable[..., None] | None
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the step functions that learn precisions and update the belief, for a precision learner's two (see `Learner`)."""
    if infer is None:

        def update(
            y, e, present, nominal, A, B, C, Q, applied, largest, mean, covariance, memory, settings,
            R, used, precision, beta, fault_probability, works, load, chol, D, whitened, v, gain, J, JP, x_hat, P,
        ):  # fmt: skip
            measure(e, used, R, C, mean, covariance, chol, D, whitened, v, gain, J, JP, x_hat, P)

        return learn, update

    def update_together(
        y, e, present, nominal, A, B, C, Q, applied, largest, mean, covariance, memory, settings,
        R, used, precision, beta, fault_probability, works, load, chol, D, whitened, v, gain, J, JP, x_hat, P,
    ):  # fmt: skip
        infer(
            y, e, present, nominal, A, B, C, Q, applied, mean, covariance, largest, memory, settings,
            R, used, precision, beta, fault_probability, works, load, x_hat, P,
        )  # fmt: skip

    return learn_later, update_together


def belief_state(model: LinearModel, learner: Learner, mean: object, covariance: object) -> dict[str, Any]:
    """Return the state that coming to a belief, `arrive` and the prediction need, with the belief before the first sample."""
    n, p, m = model.states, model.controls, model.sensors
    scratch = {
        "expected": (m,), "e": (m,), "present": (m,), "used": (m,), "CP": (m, n), "spread": (m, m), "chol": (m, m),
        "D": (m, n), "whitened": (m,), "v": (n,), "gain": (n,), "J": (n, n), "JP": (n, n), "load": (2, p), "effective": (p,),
    }  # fmt: skip
    return {
        "mean": mean, "covariance": covariance, "applied": np.zeros(p), "memory": learner.memory,
        "work": np.zeros((learner.work, m, m)), "works": np.ones((2, p)),
        **{name: np.zeros(shape) for name, shape in scratch.items()},
    }  # fmt: skip


def plan(works, load, GB, sought, GBw):
    """Leave to the control what is left to do: of each control ``works`` arrives, and ``load`` is there without it.

    Their first row is what is expected, their second one what the control counts on.
    """
    for i in range(sought.shape[0]):
        for j in range(works.shape[1]):
            sought[i] = sought[i] - GB[i, j] * load[1, j]
            GBw[i, j] = GB[i, j] * works[1, j]


def arrive(applied, works, load, effective):
    """Compute what of the control arrives at the plant."""
    for j in range(applied.shape[0]):
        effective[j] = works[0, j] * applied[j] + load[0, j]
