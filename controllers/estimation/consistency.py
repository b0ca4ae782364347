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

from bayesftc.controllers.estimation.filter import MEAN_CAP, hold_variance, keep_only
from bayesftc.controllers.estimation.observers import Observers, observers
from bayesftc.controllers.linalg.dense import apply, cholesky, congruence, whiten
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.ops import absolute, both, either, maximum, minimum, select, sqrt
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

UNCERTAIN = 1e6
"""Variance of a filter's start, in units of its steady one: the samples say where the plant starts, however few a sensor has."""

LARGEST = 1e10
"""Largest variance of a state without samples, in units of its steady one: what is known beside it is not lost in rounding."""

LEAST = 1e-200
"""Lower limit of decaying numbers: subnormal numbers are slow and have no reciprocal."""


class ObserverBank(NamedTuple):
    """The filters of all K sets of sensors.

    Attributes
    ----------
    new : ndarray of 1
        Decays from 1 with each step.
    mean, covariance : ndarray
        Each filter's belief.
    sees : ndarray
        Which sensors (1 or 0) are in each set.
    noise : ndarray
        Each filter's process covariance.
    error, used, root, rows, before : ndarray
        Scratch space.
    white, moments : ndarray
        Each sensor's last whitened innovation in each set, and its mean, mean square and mean product with the one before.
    settings : ndarray
        Weight of a sample, the value of ``new`` at which samples begin to count, and a factor for each set.
    suspect : ndarray of 1
        The output ``model_suspect``.
    """

    new: Floats
    mean: Floats
    covariance: Floats
    sees: Floats
    noise: Floats
    error: Floats
    used: Floats
    root: Floats
    rows: Floats
    before: Floats
    white: Floats
    moments: Floats
    settings: Floats
    suspect: Floats


class Motion(NamedTuple):
    """The filters' transition matrix A, the largest variance of each state, and scratch space."""

    transition: Floats
    largest: Floats
    following: Floats
    square: Floats


OBSERVER_BANK = named_alike(ObserverBank, "seer_", suspect="model_suspect")
MOTION = named_alike(Motion, "seer_")
"""Names of the arrays of the filters, and of those that predict their beliefs by a linear model."""


class Check(NamedTuple):
    """State, parameters and sizes of the scratch space of the check."""

    state: dict[str, Any]
    parameters: dict[str, Any]
    scratch: dict[str, tuple[int, ...]]


def consistency(model: LinearModel, mean: Any) -> Check:
    """Return the arrays of the check for a linear model and a mean at the start."""
    bank, n = observers(model), model.states
    check = check_of(bank, model.sensors, n, mean)
    steady = check.state["seer_covariance"]
    largest = LARGEST * np.einsum("sii->si", steady).max(axis=0)
    moving = {"seer_transition": model.matrix("A") if bank is None else bank.transition, "seer_largest": largest}
    return Check(
        check.state | {"seer_covariance": UNCERTAIN * steady},
        check.parameters | moving,
        check.scratch | {"seer_following": (n,), "seer_square": (n, n)},
    )


def check_of(bank: Observers | None, m: int, n: int, mean: Any) -> Check:
    """Return the arrays for a bank of observers of m sensors and n states, or None; their covariance is the steady one."""
    sets = ((),) if bank is None else bank.sensors
    count, weight = len(sets), 1.0 / WINDOW
    sees = np.array([[float(i in chosen) for i in range(m)] for chosen in sets])
    settled = 1.0 if bank is None else exponential((float(bank.settling) + 0.5) * logarithm(1.0 - weight))
    # Mean and mean product have the variances of averages over so many scalars; without observers all is NaN.
    scalars = (2.0 - weight) / weight * np.where(sees.any(axis=1), sees.sum(axis=1), np.nan)
    covariance, noise = np.zeros((2, count, n, n)) if bank is None else (bank.covariance, bank.noise)
    state = {
        "seer_new": np.ones(1),
        "seer_mean": np.broadcast_to(np.asarray(mean, float), (count, n)).copy(),
        "seer_covariance": covariance,
        "seer_white": np.zeros((count, m)),
        "seer_moments": np.stack([0.0 * sees, sees, 0.0 * sees], axis=1),
    }
    parameters = {"seer_sees": sees, "seer_noise": noise, "seer_settings": [weight, settled, *(scalars / MEAN_LIMIT)]}
    scratch: dict[str, tuple[int, ...]] = {
        "seer_error": (m,),
        "seer_used": (m,),
        "seer_root": (m, m),
        "seer_rows": (m, n),
        "seer_before": (2, n),
    }
    return Check(state, parameters, scratch)


def check_consistency(y, x_hat, C, nominal, bank):
    """Correct each filter, update the moments, and write the disagreement of the set that disagrees least."""
    m, n = y.shape[0], x_hat.shape[0]
    least = forget_start(bank)
    for s in range(bank.mean.shape[0]):
        for i in range(m):
            total = y[i]
            for j in range(n):
                total = total - C[i, j] * bank.mean[s, j]
            bank.error[i] = total
        least = minimum(least, correct(s, x_hat, C, nominal, bank))
    bank.suspect[0] = least / (1.0 + least)


def forget_start(bank):
    """Count a step for the filters' memory of their start, and return more than any disagreement."""
    # A decaying number has an equilibrium, which python-control needs; a count of steps has none.
    bank.new[0] = maximum((1.0 - bank.settings[0]) * bank.new[0], LEAST)
    return 1e300 + 0.0 * bank.new[0]


def correct(s, x_hat, C, nominal, bank):
    """Correct the filter of one set by ``bank.error``, one sensor after the other, and return the disagreement of the set.

    From 1 on the model is suspect. A missing sample changes nothing, whichever it is: the noise of those that are there is
    made independent by the factor of their covariance. If one is absurd, the filter takes the controller's estimate.
    """
    m, n = C.shape[0], C.shape[1]
    mean, covariance, v, before = bank.mean[s], bank.covariance[s], bank.before[0], bank.before[1]
    for i in range(m):
        there = both(bank.sees[s, i] > 0.5, bank.error[i] - bank.error[i] == 0.0)
        bank.used[i] = select(there, 1.0, 0.0)
        bank.error[i] = select(there, bank.error[i], 0.0)
        for j in range(n):
            bank.rows[i, j] = select(there, C[i, j], 0.0)
        for j in range(m):
            bank.root[i, j] = nominal[i, j]
    keep_only(bank.used, bank.root)
    cholesky(bank.root, bank.root)
    whiten(bank.root, bank.rows, bank.error)
    for j in range(n):
        before[j] = mean[j]
    weight = select(bank.new[0] <= bank.settings[1], bank.settings[0], 0.0)
    zero = 0.0 * weight
    far, square, product, absurd = zero, zero, zero, zero
    for i in range(m):
        row, error, spread = bank.rows[i], bank.error[i], 1.0 + zero
        apply(covariance, row, v)
        for j in range(n):
            spread = spread + row[j] * v[j]
            error = error - row[j] * (mean[j] - before[j])
        new = error / sqrt(spread)
        plausible = absolute(new) < ABSURD
        absurd = select(plausible, absurd, 1.0)
        here = both(either(bank.used[i] > 0.5, bank.sees[s, i] < 0.5), plausible)  # one of another set reads 0
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


def follow(effective, B, bank, motion):
    """Predict each filter's belief at the next sample by a linear model, with the effective control."""
    n = B.shape[0]
    for s in range(bank.mean.shape[0]):
        mean, covariance = bank.mean[s], bank.covariance[s]
        apply(motion.transition, mean, motion.following)
        for i in range(n):
            total = motion.following[i]
            for j in range(B.shape[1]):
                total = total + B[i, j] * effective[j]
            mean[i] = maximum(minimum(total, MEAN_CAP), -MEAN_CAP)
        congruence(motion.transition, covariance, motion.square, covariance)
        for i in range(n):
            for j in range(n):
                covariance[i, j] = covariance[i, j] + bank.noise[s, i, j]
        for i in range(n):
            hold_variance(covariance, i, motion.largest[i])
