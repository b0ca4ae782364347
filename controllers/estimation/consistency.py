"""The consistency check that runs beside a controller: whether all sensors disagree with the model in the same way.

Each set of sensors has an observer of its own (`_observers`), which knows the control but nothing of what a precision learner
believes. Of its whitened innovations three moments are kept and forgotten exponentially: mean, mean square, and the product
with the one before. With the right model and healthy sensors mean and product are zero. Both are compared with the mean square,
so that a wrong noise level raises nothing. The set that disagrees least decides: one faulty sensor spoils one set.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.estimation.observers import Observers, observers
from bayesftc.cosim.ops import absolute, both, maximum, minimum, select
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

WINDOW = 100.0
"""Samples in which the moments forget."""

MEAN_LIMIT, PRODUCT_LIMIT = 25.0, 18.5
"""Squared mean, and product with the one before (squared, where positive), in units of their variances with the right model, at
which the model is suspect.

Tuned on the seeds 1000 to 1023 of ``tests/controllers/diagnosis/wrong_models.py``, judged on the seeds 0 to 99."""

STRICTER = MEAN_LIMIT / PRODUCT_LIMIT
"""By how much the product is weighed more, so that both have the limit of the mean."""

ABSURD = 1e6
"""Standard deviations beyond which a sample says nothing of the model."""

UNSEEN = 1e150
"""Error in place of a missing sample's: absurd for its own set, and nothing where a zero multiplies it."""

LEAST = 1e-200
"""Where decay ends: numbers below the normal ones are slow, and have no reciprocal."""


class Seers(NamedTuple):
    """The observers of all sets of sensors.

    Attributes
    ----------
    new : ndarray of 1
        Decays from 1 while they are young.
    mean, gain, whiten : ndarray
        Each set's estimate, its observer's gain, and what whitens its innovations.
    error : ndarray of m
        Scratch space.
    white, moments : ndarray
        Each set's whitened innovations, the last ones and these, and their moments.
    settings : ndarray
        Weight of a sample, when they are no longer young, and for each set how its moments count.
    suspect : ndarray of 1
        The output ``model_suspect``.
    """

    new: Floats
    mean: Floats
    gain: Floats
    whiten: Floats
    error: Floats
    white: Floats
    moments: Floats
    settings: Floats
    suspect: Floats


SEERS = named_alike(Seers, "seer_", suspect="model_suspect")
"""What the arrays of the observers are called."""


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
        "seer_white": np.zeros((count, 2, m)),
        "seer_moments": np.concatenate(
            [np.zeros((count, m)), np.nan_to_num(sizes[:, None]), np.zeros((count, 1))], axis=1
        ),
    }
    return state, [weight, settled, *(scalars / MEAN_LIMIT)]


def check_consistency(y, x_hat, C, seers):
    """Take the samples in: correct each observer, update its moments, and say how far the least doubtful set disagrees.

    Where a sample of a set is missing or absurd, its observer takes the controller's estimate, and its moments stay.
    """
    m, n = y.shape[0], x_hat.shape[0]
    counts = grow_old(seers)
    least = 1e300 + 0.0 * counts
    for s in range(seers.mean.shape[0]):
        for i in range(m):
            total = y[i]
            for j in range(n):
                total = total - C[i, j] * seers.mean[s, j]
            seers.error[i] = select(total - total == 0.0, total, UNSEEN)
        for i in range(m):
            total = seers.whiten[s, i, 0] * seers.error[0]
            for j in range(1, i + 1):
                total = total + seers.whiten[s, i, j] * seers.error[j]
            seers.white[s, 1, i] = total
        there = is_seen(s, seers.white)
        least = minimum(least, disagreement(s, there, counts, seers))
        for j in range(n):
            total = seers.mean[s, j]
            for i in range(m):
                total = total + seers.gain[s, j, i] * seers.error[i]
            seers.mean[s, j] = select(there, total, x_hat[j])
    seers.suspect[0] = least / (1.0 + least)


def grow_old(seers):
    """Count a sample, and return the weight that one has: none before the observers have forgotten where they began."""
    # What decays has a state at rest, as python-control looks for; a count of samples has none.
    counts = select(seers.new[0] <= seers.settings[1], seers.settings[0], 0.0)
    seers.new[0] = maximum((1.0 - seers.settings[0]) * seers.new[0], LEAST)
    return counts


def is_seen(s, white):
    """Return whether all samples of a set are there and none is absurd."""
    there = absolute(white[s, 1, 0]) < ABSURD
    for i in range(1, white.shape[2]):
        there = both(there, absolute(white[s, 1, i]) < ABSURD)
    return there


def disagreement(s, there, counts, seers):
    """Update the moments of one set, and return how far it disagrees with the model: 1 is where that is suspect."""
    m = seers.white.shape[2]
    step = select(there, counts, 0.0)
    square, product, far = 0.0 * step, 0.0 * step, 0.0 * step
    for i in range(m):
        new = select(there, seers.white[s, 1, i], 0.0)
        square = square + new * new
        product = product + new * seers.white[s, 0, i]
        seers.white[s, 0, i] = new
        mean = seers.moments[s, i] + step * (new - seers.moments[s, i])
        seers.moments[s, i] = mean
        far = far + mean * mean
    square = maximum(seers.moments[s, m] + step * (square - seers.moments[s, m]), LEAST)
    product = seers.moments[s, m + 1] + step * (product - seers.moments[s, m + 1])
    seers.moments[s, m], seers.moments[s, m + 1] = square, product
    small, alike = 1.0 / square, maximum(product, 0.0)
    return seers.settings[2 + s] * small * maximum(far, STRICTER * alike * alike * small)


def follow(effective, A, B, row, seers):
    """Take each observer to the next sample, with the control that arrives."""
    n = A.shape[0]
    for s in range(seers.mean.shape[0]):
        for i in range(n):
            total = A[i, 0] * seers.mean[s, 0]
            for j in range(1, n):
                total = total + A[i, j] * seers.mean[s, j]
            for j in range(B.shape[1]):
                total = total + B[i, j] * effective[j]
            row[i] = total
        for i in range(n):
            seers.mean[s, i] = row[i]
