"""The consistency check that runs beside a controller: whether all sensors disagree with the model in the same way.

Each set of sensors has an observer of its own (`_observers`), which knows the control but nothing of what a precision learner
believes. Of its whitened innovations three moments are kept and forgotten exponentially: mean, mean square, and the product
with the one before. With the right model and healthy sensors mean and product are zero. Both are compared with the mean square,
so that a wrong noise level raises nothing. The set that disagrees least decides: one faulty sensor spoils one set.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.estimation.observers import Observers, observers
from bayesftc.cosim.ops import absolute, both, maximum, minimum, select

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

WINDOW = 100.0
"""Samples in which the moments forget."""

MEAN_LIMIT, PRODUCT_LIMIT = 25.0, 18.5
"""Squared mean, and product with the one before (squared, where positive), in units of their variances with the right model, at
which the model is suspect.

Tuned on the seeds 1000 to 1023 of ``src/bayesftc/reproduce/experiments/models/wrong.py``, judged on the seeds 0 to 99."""

STRICTER = MEAN_LIMIT / PRODUCT_LIMIT
"""By how much the product is weighed more, so that both have the limit of the mean."""

ABSURD = 1e6
"""Standard deviations beyond which a sample says nothing of the model."""

UNSEEN = 1e150
"""Error in place of a missing sample's: absurd for its own set, and nothing where a zero multiplies it."""

LEAST = 1e-200
"""Where decay ends: numbers below the normal ones are slow, and have no reciprocal."""


def consistency(model: LinearModel, initial_mean: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the state and the parameters of the check for a model and a belief before the first sample."""
    seers, n, m = observers(model), model.states, model.sensors
    count = 1 if seers is None else len(seers)
    gain = np.zeros((count, n, m)) if seers is None else seers.correction
    whiten = np.zeros((count, m, m)) if seers is None else seers.whiten
    state, settings = moments_of(seers, m)
    state["seer_mean"] = np.broadcast_to(np.asarray(initial_mean, float), (count, n)).copy()
    return state, {"seer_gain": gain, "seer_whiten": whiten, "seer_settings": settings}


def moments_of(seers: Observers | None, m: int) -> tuple[dict[str, Any], list[float]]:
    """Return the state of the moments of observers (None: there are none) of m sensors, and their settings."""
    weight = 1.0 / WINDOW
    sizes = np.array([np.nan] if seers is None else [len(chosen) for chosen in seers.sensors], float)
    count = len(sizes)
    settled = 1.0 if seers is None else (1.0 - weight) ** (float(seers.rest) - 0.5)
    # The variances of the mean and of the mean product are those of so many scalars; where there are none all is NaN.
    scalars = (2.0 - weight) / weight * sizes
    state = {
        "seer_new": np.ones(1),
        "seer_error": np.zeros(m),
        "seer_white": np.zeros((count, 2, m)),
        "seer_moments": np.concatenate(
            [np.zeros((count, m)), np.nan_to_num(sizes[:, None]), np.zeros((count, 1))], axis=1
        ),
    }
    return state, [weight, settled, *(scalars / MEAN_LIMIT)]


def check_consistency(
    y, x_hat, C, seer_new, seer_mean, seer_error, seer_white, seer_moments, seer_gain, seer_whiten, seer_settings, model_suspect
):  # fmt: skip
    """Take the samples in: correct each observer, update its moments, and say how far the least doubtful set disagrees.

    Where a sample of a set is missing or absurd, its observer takes the controller's estimate, and its moments stay.
    """
    m, n = y.shape[0], x_hat.shape[0]
    counts = grow_old(seer_new, seer_settings)
    least = 1e300 + 0.0 * counts
    for s in range(seer_mean.shape[0]):
        for i in range(m):
            total = y[i]
            for j in range(n):
                total = total - C[i, j] * seer_mean[s, j]
            seer_error[i] = select(total - total == 0.0, total, UNSEEN)
        for i in range(m):
            total = seer_whiten[s, i, 0] * seer_error[0]
            for j in range(1, i + 1):
                total = total + seer_whiten[s, i, j] * seer_error[j]
            seer_white[s, 1, i] = total
        there = is_seen(s, seer_white)
        least = minimum(least, disagreement(s, there, counts, seer_white, seer_moments, seer_settings))
        for j in range(n):
            total = seer_mean[s, j]
            for i in range(m):
                total = total + seer_gain[s, j, i] * seer_error[i]
            seer_mean[s, j] = select(there, total, x_hat[j])
    model_suspect[0] = least / (1.0 + least)


def grow_old(seer_new, seer_settings):
    """Count a sample, and return the weight that one has: none before the observers have forgotten where they began."""
    # What decays has a state at rest, as python-control looks for; a count of samples has none.
    counts = select(seer_new[0] <= seer_settings[1], seer_settings[0], 0.0)
    seer_new[0] = maximum((1.0 - seer_settings[0]) * seer_new[0], LEAST)
    return counts


def is_seen(s, seer_white):
    """Return whether all samples of a set are there and none is absurd."""
    there = absolute(seer_white[s, 1, 0]) < ABSURD
    for i in range(1, seer_white.shape[2]):
        there = both(there, absolute(seer_white[s, 1, i]) < ABSURD)
    return there


def disagreement(s, there, counts, seer_white, seer_moments, seer_settings):
    """Update the moments of one set, and return how far it disagrees with the model: 1 is where that is suspect."""
    m = seer_white.shape[2]
    step = select(there, counts, 0.0)
    square, product, far = 0.0 * step, 0.0 * step, 0.0 * step
    for i in range(m):
        new = select(there, seer_white[s, 1, i], 0.0)
        square = square + new * new
        product = product + new * seer_white[s, 0, i]
        seer_white[s, 0, i] = new
        mean = seer_moments[s, i] + step * (new - seer_moments[s, i])
        seer_moments[s, i] = mean
        far = far + mean * mean
    square = maximum(seer_moments[s, m] + step * (square - seer_moments[s, m]), LEAST)
    product = seer_moments[s, m + 1] + step * (product - seer_moments[s, m + 1])
    seer_moments[s, m], seer_moments[s, m + 1] = square, product
    small, alike = 1.0 / square, maximum(product, 0.0)
    return seer_settings[2 + s] * small * maximum(far, STRICTER * alike * alike * small)


def follow(effective, A, B, J, seer_mean):
    """Take each observer to the next sample, with the control that arrives."""
    n = A.shape[0]
    for s in range(seer_mean.shape[0]):
        for i in range(n):
            total = A[i, 0] * seer_mean[s, 0]
            for j in range(1, n):
                total = total + A[i, j] * seer_mean[s, j]
            for j in range(B.shape[1]):
                total = total + B[i, j] * effective[j]
            J[0, i] = total
        for i in range(n):
            seer_mean[s, i] = J[0, i]
