"""The consistency check that runs beside a controller: whether all sensors disagree with the model in the same way.

Each set of sensors has an observer (`observers`), which uses the control but no result of the precision learner. Three moments
of its whitened innovations are kept with exponential forgetting: mean, mean square, and product with the one before. With the
right model and healthy sensors mean and product are zero. Both are compared with the mean square, so that a wrong noise level
has no effect. The set with the least disagreement counts: one faulty sensor spoils one set only, if its quantity has others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.estimation.observers import Observers, observers
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.ops import absolute, both, maximum, minimum, select
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

WINDOW = 100.0
"""Time constant of the moments' forgetting, in samples."""

MEAN_LIMIT, PRODUCT_LIMIT = 25.0, 18.5
"""Limits of the squared mean, and of the product with the one before (squared, where positive), at which the model is suspect, in
units of their variances with the right model.

They are tuned on the seeds 1000 to 1023 of ``tests/controllers/diagnosis/wrong_models.py`` and tested on the seeds 0 to 99."""

STRICTER = MEAN_LIMIT / PRODUCT_LIMIT
"""Factor of the product, so that the limit of the mean holds for both."""

ABSURD = 1e6
"""Standard deviations beyond which a sample is not used."""

UNSEEN = 1e150
"""Error of a missing sample: absurd for its set, and without effect where it is multiplied by zero."""

LEAST = 1e-200
"""Lower limit of decaying numbers: subnormal numbers are slow and have no reciprocal."""


class ObserverBank(NamedTuple):
    """The observers of all sets of sensors.

    Attributes
    ----------
    new : ndarray of 1
        Decays from 1 with each sample.
    mean, gain, whiten : ndarray
        Estimate, gain and whitening matrix of each set's observer.
    error : ndarray of m
        Scratch space.
    white, moments : ndarray
        Each set's last and present whitened innovations, and their moments.
    settings : ndarray
        Weight of a sample, the value of ``new`` from which samples count, and a factor for each set.
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


OBSERVER_BANK = named_alike(ObserverBank, "seer_", suspect="model_suspect")
"""Names of the arrays of the observers."""


def consistency(model: LinearModel, initial_mean: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return state and parameters of the check for a model and an initial mean."""
    bank, n, m = observers(model), model.states, model.sensors
    count = 1 if bank is None else len(bank)
    gain = np.zeros((count, n, m)) if bank is None else bank.correction
    whiten = np.zeros((count, m, m)) if bank is None else bank.whiten
    state, settings = moments_of(bank, m)
    state["seer_mean"] = np.broadcast_to(np.asarray(initial_mean, float), (count, n)).copy()
    return state, {"seer_gain": gain, "seer_whiten": whiten, "seer_settings": settings}


def moments_of(bank: Observers | None, m: int) -> tuple[dict[str, Any], list[float]]:
    """Return the state of the moments of observers (None: no observers) of m sensors, and their settings."""
    weight = 1.0 / WINDOW
    sizes = np.array([np.nan] if bank is None else [len(chosen) for chosen in bank.sensors], float)
    count = len(sizes)
    settled = 1.0 if bank is None else exponential((float(bank.settling) - 0.5) * logarithm(1.0 - weight))
    # Mean and mean product have the variances of averages over so many scalars; without observers all is NaN.
    scalars = (2.0 - weight) / weight * sizes
    state = {
        "seer_new": np.ones(1),
        "seer_white": np.zeros((count, 2, m)),
        "seer_moments": np.concatenate(
            [np.zeros((count, m)), np.nan_to_num(sizes[:, None]), np.zeros((count, 1))], axis=1
        ),
    }
    return state, [weight, settled, *(scalars / MEAN_LIMIT)]


def check_consistency(y, x_hat, C, bank):
    """Correct each observer, update its moments, and write the disagreement of the set that disagrees least.

    If a sample of a set is missing or absurd, its observer takes the controller's estimate, and its moments remain.
    """
    m, n = y.shape[0], x_hat.shape[0]
    counts = sample_weight(bank)
    least = 1e300 + 0.0 * counts
    for s in range(bank.mean.shape[0]):
        for i in range(m):
            total = y[i]
            for j in range(n):
                total = total - C[i, j] * bank.mean[s, j]
            bank.error[i] = select(total - total == 0.0, total, UNSEEN)
        for i in range(m):
            total = bank.whiten[s, i, 0] * bank.error[0]
            for j in range(1, i + 1):
                total = total + bank.whiten[s, i, j] * bank.error[j]
            bank.white[s, 1, i] = total
        usable_now = usable(s, bank.white)
        least = minimum(least, disagreement(s, usable_now, counts, bank))
        for j in range(n):
            total = bank.mean[s, j]
            for i in range(m):
                total = total + bank.gain[s, j, i] * bank.error[i]
            bank.mean[s, j] = select(usable_now, total, x_hat[j])
    bank.suspect[0] = least / (1.0 + least)


def sample_weight(bank):
    """Count a sample, and return its weight: 0 until the observers have forgotten their initial state."""
    # A decaying number has an equilibrium, which python-control needs; a count of samples has none.
    counts = select(bank.new[0] <= bank.settings[1], bank.settings[0], 0.0)
    bank.new[0] = maximum((1.0 - bank.settings[0]) * bank.new[0], LEAST)
    return counts


def usable(s, white):
    """Return whether all samples of a set are present and none is absurd."""
    usable_now = absolute(white[s, 1, 0]) < ABSURD
    for i in range(1, white.shape[2]):
        usable_now = both(usable_now, absolute(white[s, 1, i]) < ABSURD)
    return usable_now


def disagreement(s, usable_now, counts, bank):
    """Update the moments of one set, and return its disagreement with the model; from 1 on the model is suspect."""
    m = bank.white.shape[2]
    step = select(usable_now, counts, 0.0)
    square, product, far = 0.0 * step, 0.0 * step, 0.0 * step
    for i in range(m):
        new = select(usable_now, bank.white[s, 1, i], 0.0)
        square = square + new * new
        product = product + new * bank.white[s, 0, i]
        bank.white[s, 0, i] = new
        mean = bank.moments[s, i] + step * (new - bank.moments[s, i])
        bank.moments[s, i] = mean
        far = far + mean * mean
    square = maximum(bank.moments[s, m] + step * (square - bank.moments[s, m]), LEAST)
    product = bank.moments[s, m + 1] + step * (product - bank.moments[s, m + 1])
    bank.moments[s, m], bank.moments[s, m + 1] = square, product
    small, alike = 1.0 / square, maximum(product, 0.0)
    return bank.settings[2 + s] * small * maximum(far, STRICTER * alike * alike * small)


def follow(effective, A, B, row, bank):
    """Predict each observer's state at the next sample, with the effective control."""
    n = A.shape[0]
    for s in range(bank.mean.shape[0]):
        for i in range(n):
            total = A[i, 0] * bank.mean[s, 0]
            for j in range(1, n):
                total = total + A[i, j] * bank.mean[s, j]
            for j in range(B.shape[1]):
                total = total + B[i, j] * effective[j]
            row[i] = total
        for i in range(n):
            bank.mean[s, i] = row[i]
