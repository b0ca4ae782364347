"""Robust updates from the literature: each sample has its own weight, and there is no memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.estimation import posterior as _posterior
from bayesftc.controllers.estimation.posterior import errors_after, prepare
from bayesftc.controllers.linalg.dense import cholesky, solve_columns
from bayesftc.controllers.models.checks import check_flags, check_number
from bayesftc.controllers.precision.base import ERROR_CAP, NAN, Learner, PrecisionLearner
from bayesftc.controllers.signals import port
from bayesftc.cosim.ops import maximum, minimum, select, sqrt

if TYPE_CHECKING:
    from collections.abc import Callable

    from bayesftc.controllers.models.linear import LinearModel

NO_PROBABILITY = (
    "weights each sample by itself and has no belief about the sensor from which a probability could follow."
)


def mahalanobis(present, nominal, E, L):
    """Return the trace of E R^-1 over the sensors with a sample; `E` is overwritten."""
    m = nominal.shape[0]
    for i in range(m):
        for j in range(m):
            both_present = present[i] * present[j] > 0.5
            L[i, j] = select(both_present, nominal[i, j], 1.0 if i == j else 0.0)
            E[i, j] = select(both_present, E[i, j], 0.0)
    cholesky(L, L)
    solve_columns(L, E)
    total = E[0, 0]
    for i in range(1, m):
        total = total + E[i, i]
    return maximum(minimum(total, ERROR_CAP), 0.0)


def use_weights(weights, joint, sample, trust):
    """Divide the nominal covariance by the weights: one for all sensors, or one for each variance, uncorrelated."""
    nominal = sample.nominal
    m = nominal.shape[0]
    for i in range(m):
        for j in range(m):
            trust.R[i, j] = select(joint > 0.5, nominal[i, j], nominal[i, i] if i == j else 0.0) / weights[0, i]
        trust.used[i] = sample.present[i]
        trust.precision[i] = 1.0 / trust.R[i, i]
        trust.beta[i] = NAN
        trust.fault_probability[i] = NAN


def report_weights(memory, settings, nominal, first, outputs):
    """Write the weight of each sensor's sample."""
    for i in range(nominal.shape[0]):
        outputs[first + i] = memory[i]


# Settings of both learners.
_JOINT, _PARAMETER = range(2)


@cache
def _student_learner(iterations: int) -> Callable[..., None]:
    def learn_student(sample, trust, memory, settings, work):
        """Iterate between the belief and the samples' weights. ``memory``: the weights, for the report."""
        m = sample.y.shape[0]
        joint, freedom = settings[_JOINT], settings[_PARAMETER]
        weights, E = work[14], work[0]
        prepare(sample.e, sample.spread, sample.nominal, work)
        count = 0.0 * sample.present[0]
        for i in range(m):
            count = count + sample.present[i]
            weights[0, i] = 1.0
        for _ in range(iterations):
            use_weights(weights, joint, sample, trust)
            errors_after(sample.present, trust.R, work)
            for i in range(m):
                squared = minimum(E[i, i] / sample.nominal[i, i], ERROR_CAP)
                weights[0, i] = select(sample.present[i] > 0.5, (1.0 + freedom) / (freedom + squared), 1.0)
            together = mahalanobis(sample.present, sample.nominal, E, work[12])
            for i in range(m):
                common = select(count > 0.5, (count + freedom) / (freedom + together), 1.0)
                weights[0, i] = select(joint > 0.5, common, weights[0, i])
        use_weights(weights, joint, sample, trust)
        for i in range(m):
            memory[i] = weights[0, i]

    return learn_student


def learn_weighted(sample, trust, memory, settings, work):
    """Weight each sample by its innovation. ``memory``: the weights, for the report."""
    m = sample.y.shape[0]
    joint, c2 = settings[_JOINT], settings[_PARAMETER] * settings[_PARAMETER]
    weights, E = work[0], work[1]
    for i in range(m):
        for j in range(m):
            a, b = sqrt(ERROR_CAP * sample.nominal[i, i]), sqrt(ERROR_CAP * sample.nominal[j, j])
            E[i, j] = maximum(minimum(sample.e[i], a), -a) * maximum(minimum(sample.e[j], b), -b)
        weights[0, i] = c2 / (c2 + E[i, i] / sample.nominal[i, i])
    together = mahalanobis(sample.present, sample.nominal, E, work[2])
    for i in range(m):
        weights[0, i] = select(joint > 0.5, c2 / (c2 + together), weights[0, i])
        memory[i] = weights[0, i]
    use_weights(weights, joint, sample, trust)


@dataclass(frozen=True)
class StudentTUpdate(PrecisionLearner):
    """The robust Student-t update: heavy-tailed sensor noise, by variational Bayes (Huang et al., IEEE TAES 53, 2017).

    The noise is Gaussian with covariance R / lambda, where lambda is gamma distributed with mean 1. Each sample infers it anew:
    ``E[lambda] = (d + v) / (v + tr(E R^-1))`` with ``E = r r' + H P H'`` of the belief updated by R / E[lambda], iterated from
    lambda = 1. The controller gets the output ``precision_weight``, E[lambda] for each sensor; ``beta`` is NaN.

    Parameters
    ----------
    degrees_of_freedom : float
        v of the t distribution; smaller values give heavier tails. The weight of a sample is at most (1 + v) / v. At 5 the
        noise still has moments up to the fourth.
    iterations : int
        Number of iterations for lambda in a sample (1 to 20).
    joint : bool
        One lambda for all sensors (d of them), as published; one failed sensor then reduces the weight of the others as well. By
        default each sensor has its own (d = 1), and a correlation in the model's covariance is not used.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.StudentTUpdate()).online(compiled=False)
    >>> out = step(y=[0.0, 3.0], u=0.0)
    >>> out.precision_weight.round(2).tolist(), out.x_hat.round(2).tolist()
    ([0.76, 0.03], [0.11])
    """

    degrees_of_freedom: float = 5.0
    iterations: int = 5
    joint: bool = False

    def __post_init__(self) -> None:
        check_number(self, "degrees_of_freedom", above=0)
        check_number(self, "iterations", least=1, most=_posterior.MOST_ITERATIONS, whole=True)
        check_flags(self, "joint")

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, settings = model.sensors, np.array([self.joint, self.degrees_of_freedom], dtype=np.float64)
        step, ports = _student_learner(int(self.iterations)), (port("precision_weight", (m,)),)
        return Learner(step, np.ones(m), settings, _posterior.WORK + 1, ports, report_weights)

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return f"StudentTUpdate {NO_PROBABILITY}"


@dataclass(frozen=True)
class WeightedLikelihood(PrecisionLearner):
    """The weighted-likelihood filter: large innovations get small weights (Duran-Martin et al., arXiv 2405.05646, 2024).

    With e the innovation in nominal standard deviations, its log-likelihood has the weight ``w = c^2 / (c^2 + e^2)`` (the inverse
    multiquadric), so its covariance is R / w. The controller gets the output ``precision_weight``, w for each sensor; ``beta``
    is NaN.

    Parameters
    ----------
    c : float
        Number of standard deviations at which a sample has half its weight; 3 is also the default threshold of `SERFDI`.
    joint : bool
        One weight for all sensors by ``e' R^-1 e``, as published; one failed sensor then reduces the weight of the others as
        well. By default each sensor has its own, and a correlation in the model's covariance is not used.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.WeightedLikelihood(c=3.0)).online(compiled=False)
    >>> out = step(y=[0.0, 3.0], u=0.0)
    >>> out.precision_weight.round(3).tolist(), out.x_hat.round(2).tolist()
    ([1.0, 0.038], [0.11])
    """

    c: float = 3.0
    joint: bool = False

    def __post_init__(self) -> None:
        check_number(self, "c", above=0)
        check_flags(self, "joint")

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, settings = model.sensors, np.array([self.joint, self.c], dtype=np.float64)
        return Learner(learn_weighted, np.ones(m), settings, 3, (port("precision_weight", (m,)),), report_weights)

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return f"WeightedLikelihood {NO_PROBABILITY}"
