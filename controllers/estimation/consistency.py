"""The consistency check that runs beside a controller: whether all sensors disagree with the model in the same way.

Each set of sensors has a Kalman filter (`observers`), which uses the control but no result of the precision learner. Three
moments of each sensor's whitened innovations are kept with exponential forgetting: mean, mean square, and product with the one
before. With the right model and healthy sensors mean and product are zero. Both are compared with the mean square, so that a
wrong noise level has no effect. The set with the least disagreement counts: one faulty sensor spoils one set only, if its
quantity has others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.estimation.filter import MEAN_CAP, hold_variances
from bayesftc.controllers.estimation.observers import Observers, observers
from bayesftc.controllers.linalg.dense import apply, congruence
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.ops import absolute, either, maximum, minimum, select, sqrt
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

WINDOW = 100.0
"""Time constant of the moments' forgetting, in samples of each sensor."""

MEAN_LIMIT, PRODUCT_LIMIT = 25.0, 18.5
"""Limits of the squared mean, and of the product with the one before (squared, where positive), at which the model is suspect, in
units of their variances with the right model.

They are tuned on the seeds 1000 to 1023 of ``tests/controllers/diagnosis/wrong_models.py`` and tested on the seeds 0 to 99."""

STRICTER = MEAN_LIMIT / PRODUCT_LIMIT
"""Factor of the product, so that the limit of the mean holds for both."""

ABSURD = 1e6
"""Standard deviations beyond which a sample is not used."""

UNSEEN = 1e250
"""Error of a missing sample, which no other sample hides in a sum."""

MISSING = 1e200
"""Errors beyond this are of missing samples, as no belief is so far away (`MEAN_CAP`)."""

LARGEST = 1e10
"""Largest variance of a filter without samples, in units of its largest steady one: rounding keeps the others' part of it."""

LEAST = 1e-200
"""Lower limit of decaying numbers: subnormal numbers are slow and have no reciprocal."""


VECTORS = 3
"""Number of scratch vectors: a row of the sensors' matrix, its product with the covariance, and the mean before the samples."""


class ObserverBank(NamedTuple):
    """The filters of all K sets of sensors.

    Attributes
    ----------
    new : ndarray of 1
        Decays from 1 with each step.
    mean, covariance : ndarray
        Each filter's belief.
    whiten : ndarray
        Makes the noise of a set's sensors independent, of variance 1; zero rows and columns for the others.
    noise, transition : ndarray
        Each filter's process covariance, and the model's A.
    error, vectors, square : ndarray
        Scratch space.
    white, moments : ndarray
        Each sensor's last whitened innovation in each set, and its mean, mean square and mean product with the one before.
    settings : ndarray
        Weight of a sample, the value of ``new`` at which samples begin to count, and a factor for each set.
    largest : ndarray of 1
        Largest variance of a belief.
    suspect : ndarray of 1
        The output ``model_suspect``.
    """

    new: Floats
    mean: Floats
    covariance: Floats
    whiten: Floats
    noise: Floats
    transition: Floats
    error: Floats
    vectors: Floats
    square: Floats
    white: Floats
    moments: Floats
    settings: Floats
    largest: Floats
    suspect: Floats


OBSERVER_BANK = named_alike(ObserverBank, "seer_", suspect="model_suspect")
"""Names of the arrays of the filters."""


def consistency(
    model: LinearModel, mean: Any, bank: Observers | None = None
) -> tuple[dict[str, Any], dict[str, Any], dict[str, tuple[int, ...]]]:
    """Return state, parameters and the sizes of scratch space of the check for a model and an initial mean.

    Parameters
    ----------
    model : LinearModel
        The model.
    mean : array_like, shape (n,)
        Mean of all filters at the start. Their covariance is the steady one.
    bank : Observers, optional
        The model's observers; by default those of `observers`. Without any the check's output is NaN.
    """
    bank, n, m = bank or observers(model), model.states, model.sensors
    sets = ((),) if bank is None else bank.sensors
    count, weight = len(sets), 1.0 / WINDOW
    whiten, R = np.zeros((count, m, m)), model.matrix("sensor_covariance")
    for s, chosen in enumerate(map(list, sets)):
        whiten[s][np.ix_(chosen, chosen)] = np.linalg.inv(np.linalg.cholesky(R[np.ix_(chosen, chosen)]))
    member = np.einsum("sii->si", whiten) > 0.0
    settled = 1.0 if bank is None else exponential((float(bank.settling) + 0.5) * logarithm(1.0 - weight))
    # Mean and mean product have the variances of averages over so many scalars; without observers all is NaN.
    scalars = (2.0 - weight) / weight * np.where(member.any(axis=1), member.sum(axis=1), np.nan)
    steady, noise = np.zeros((2, count, n, n)) if bank is None else (bank.covariance, bank.noise)
    state = {
        "seer_new": np.ones(1),
        "seer_mean": np.broadcast_to(np.asarray(mean, float), (count, n)).copy(),
        "seer_covariance": steady,
        "seer_white": np.zeros((count, m)),
        "seer_moments": np.stack([0.0 * member, 1.0 * member, 0.0 * member], axis=1),
    }
    parameters = {
        "seer_whiten": whiten,
        "seer_noise": noise,
        "seer_transition": model.matrix("A") if bank is None else bank.transition,
        "seer_settings": [weight, settled, *(scalars / MEAN_LIMIT)],
        "seer_largest": [LARGEST * max(float(steady.max(initial=0.0)), LEAST)],
    }
    return state, parameters, {"seer_error": (m,), "seer_vectors": (VECTORS, n), "seer_square": (n, n)}


def check_consistency(y, x_hat, C, bank):
    """Correct each filter, update the moments, and write the disagreement of the set that disagrees least."""
    m, n = y.shape[0], x_hat.shape[0]
    least = forget_start(bank)
    for s in range(bank.mean.shape[0]):
        for i in range(m):
            total = y[i]
            for j in range(n):
                total = total - C[i, j] * bank.mean[s, j]
            bank.error[i] = total
        least = minimum(least, correct(s, x_hat, C, bank))
    bank.suspect[0] = least / (1.0 + least)


def forget_start(bank):
    """Count a step for the filters' memory of their start, and return more than any disagreement."""
    # A decaying number has an equilibrium, which python-control needs; a count of steps has none.
    bank.new[0] = maximum((1.0 - bank.settings[0]) * bank.new[0], LEAST)
    return 1e300 + 0.0 * bank.new[0]


def correct(s, x_hat, C, bank):
    """Correct the filter of one set by ``bank.error``, one sensor after the other, and return the disagreement of the set.

    From 1 on the model is suspect. Missing samples change nothing. If one is absurd, the filter takes the controller's estimate.
    """
    m, n = C.shape[0], C.shape[1]
    mean, covariance = bank.mean[s], bank.covariance[s]
    row, v, before = bank.vectors[0], bank.vectors[1], bank.vectors[2]
    for j in range(n):
        before[j] = mean[j]
    weight = select(bank.new[0] <= bank.settings[1], bank.settings[0], 0.0)
    zero = 0.0 * weight
    far, square, product, absurd = zero, zero, zero, zero
    for i in range(m):
        bank.error[i] = select(bank.error[i] - bank.error[i] == 0.0, bank.error[i], UNSEEN)
        error = bank.whiten[s, i, 0] * bank.error[0]
        for k in range(1, i + 1):
            error = error + bank.whiten[s, i, k] * bank.error[k]
        missing = absolute(error) > MISSING
        for j in range(n):
            total = bank.whiten[s, i, 0] * C[0, j]
            for k in range(1, i + 1):
                total = total + bank.whiten[s, i, k] * C[k, j]
            row[j] = total
        apply(covariance, row, v)
        spread = 1.0 + zero
        for j in range(n):
            spread = spread + row[j] * v[j]
            error = error - row[j] * (mean[j] - before[j])
        new = error / sqrt(spread)
        here = absolute(new) < ABSURD
        absurd = select(either(here, missing), absurd, 1.0)
        new, error, gain = select(here, new, 0.0), select(here, error, 0.0), select(here, 1.0 / spread, 0.0)
        for j in range(n):
            mean[j] = mean[j] + v[j] * gain * error
            for k in range(n):
                covariance[j, k] = covariance[j, k] - v[j] * gain * v[k]
            covariance[j, j] = maximum(covariance[j, j], 0.0)
        step = select(here, weight, 0.0)
        bank.moments[s, 0, i] = bank.moments[s, 0, i] + step * (new - bank.moments[s, 0, i])
        bank.moments[s, 1, i] = bank.moments[s, 1, i] + step * (new * new - bank.moments[s, 1, i])
        bank.moments[s, 2, i] = bank.moments[s, 2, i] + step * (new * bank.white[s, i] - bank.moments[s, 2, i])
        bank.white[s, i] = select(here, new, bank.white[s, i])
        far = far + bank.moments[s, 0, i] * bank.moments[s, 0, i]
        square = square + bank.moments[s, 1, i]
        product = product + bank.moments[s, 2, i]
    for j in range(n):
        mean[j] = select(absurd > 0.5, x_hat[j], mean[j])
    square, alike = maximum(square, LEAST), maximum(product, 0.0)
    small = 1.0 / square
    return bank.settings[2 + s] * small * maximum(far, STRICTER * alike * alike * small)


def follow(effective, B, bank):
    """Predict each filter's belief at the next sample, with the effective control."""
    n = B.shape[0]
    for s in range(bank.mean.shape[0]):
        mean, covariance, following = bank.mean[s], bank.covariance[s], bank.vectors[0]
        apply(bank.transition, mean, following)
        for i in range(n):
            total = following[i]
            for j in range(B.shape[1]):
                total = total + B[i, j] * effective[j]
            mean[i] = maximum(minimum(total, MEAN_CAP), -MEAN_CAP)
        congruence(bank.transition, covariance, bank.square, covariance)
        for i in range(n):
            for j in range(n):
                covariance[i, j] = covariance[i, j] + bank.noise[s, i, j]
        hold_variances(covariance, bank.largest)
