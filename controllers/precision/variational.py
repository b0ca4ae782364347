"""The variational-Bayes adaptive Kalman filter as a precision learner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.estimation import posterior as _posterior
from bayesftc.controllers.estimation.posterior import errors_after, prepare
from bayesftc.controllers.models.checks import check_choice, check_number
from bayesftc.controllers.precision.base import ERROR_CAP, NAN, RATE_FLOOR, Learner
from bayesftc.controllers.precision.gamma import moment_ports, report_gamma
from bayesftc.controllers.precision.matrix import (
    FORGETTING,
    INTERCEPT,
    LESS,
    PRIOR,
    SLOPE,
    TOWARDS,
    any_of,
    complete,
    expected_covariance,
    forget,
    invert,
    learn_errors,
    prior_memory,
    report_wishart,
    wishart_ports,
)
from bayesftc.controllers.precision.rate import Calibration, RateLearner, probability_map
from bayesftc.cosim.ops import maximum, minimum, select

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

# Settings of the form with one gamma distribution for each sensor.
_FORGETTING, _SHAPE0, _SLOPE, _INTERCEPT = range(4)


@cache
def _diagonal_learner(to_probability: Callable[..., float], iterations: int) -> Callable[..., None]:
    def learn_variances(sample, trust, memory, settings, work):
        """Iterate between the belief and the rates. ``memory``: rates before this sample, shapes, rates."""
        m = sample.y.shape[0]
        prepare(sample.e, sample.spread, sample.nominal, work)
        for i in range(m):
            rho = select(sample.present[i] > 0.5, settings[_FORGETTING], 1.0)
            memory[i] = rho * memory[2 * m + i]
            memory[m + i] = rho * memory[m + i] + 0.5 * sample.present[i]
            memory[2 * m + i] = memory[i]
            trust.used[i] = sample.present[i]
        for _ in range(iterations):
            for i in range(m):
                for j in range(m):
                    trust.R[i, j] = memory[2 * m + i] / memory[m + i] if i == j else 0.0
            errors_after(sample.present, trust.R, work)
            for i in range(m):
                squared = minimum(work[0][i, i], ERROR_CAP * sample.nominal[i, i])
                b = memory[i] + select(sample.present[i] > 0.5, 0.5 * squared, 0.0)
                memory[2 * m + i] = maximum(b, RATE_FLOOR * settings[_SHAPE0] * sample.nominal[i, i])
        for i in range(m):
            trust.precision[i] = 1.0 / trust.R[i, i]
            trust.beta[i] = memory[2 * m + i]
            ratio = trust.beta[i] / (settings[_SHAPE0] * sample.nominal[i, i])
            probability = to_probability(ratio, settings[_SLOPE], settings[_INTERCEPT])
            trust.fault_probability[i] = select(sample.present[i] > 0.5, probability, NAN)

    return learn_variances


@cache
def _full_learner(to_probability: Callable[..., float], iterations: int) -> Callable[..., None]:
    def learn_covariance(sample, trust, memory, settings, work):
        """Iterate between the belief and the covariance. ``memory``: n, V^-1, V, or here the former V^-1 for V."""
        m = sample.y.shape[0]
        any_present = any_of(sample.present)
        prepare(sample.e, sample.spread, sample.nominal, work)
        forget(any_present, memory, settings, sample.nominal)
        degrees = memory[0]
        for at in range(1, 1 + m * m):
            memory[m * m + at] = memory[at]
        memory[0] = degrees + any_present
        for _ in range(iterations):
            expected_covariance(sample.present, memory, settings, trust.R, trust.used, trust.precision, trust.beta)
            errors_after(sample.present, trust.R, work)
            memory[0] = degrees
            for at in range(1, 1 + m * m):
                memory[at] = memory[m * m + at]
            complete(sample.present, memory, settings, sample.nominal, work[0], work[12], work[13])
            learn_errors(any_present, work[0], memory, settings, sample.nominal)
        invert(memory, work[0], work[1])
        for i in range(m):
            trust.beta[i] = 0.5 * memory[1 + i * m + i]
            ratio = trust.beta[i] / (0.5 * settings[PRIOR] * sample.nominal[i, i])
            probability = to_probability(ratio, settings[SLOPE], settings[INTERCEPT])
            trust.fault_probability[i] = select(sample.present[i] > 0.5, probability, NAN)

    return learn_covariance


@dataclass(frozen=True)
class VariationalBayesKF(RateLearner):
    """The variational-Bayes adaptive Kalman filter (Sarkka and Nummenmaa, IEEE TAC 54, 2009).

    It differs from `GammaPrecision` in three ways. A sample adds to the rate the squared *residual* after the update and the
    belief's variance H P H'. Belief and rates are iterated until they agree. Shape and rate decay towards zero, but not while a
    sample is missing, because the shape must not vanish. Each iteration updates the belief by R = diag(b / a), then the rates by
    that belief, as published. The covariance in use is that at the start of the last iteration, ``beta`` the rate at its end.

    The controller gets the outputs of `GammaPrecision`, or with ``covariance="full"`` those of `WishartPrecision`. In a
    controller without a covariance of its belief one iteration suffices, because the update changes nothing.

    Parameters
    ----------
    forgetting : float
        Forgetting factor rho in (0, 1] per step.
    iterations : int
        Fixed-point iterations in a sample (1 to 20); 2 or 3 are usual.
    prior_shape : float
        Shape a0 of each sensor's prior. Its rate makes the prior expect the model's variance: a0 R for a diagonal covariance,
        (a0 - 1) R for a full one.
    covariance : {"diagonal", "full"}
        One gamma distribution for each sensor, or one inverse Wishart distribution over the covariance matrix (Sarkka and
        Hartikainen, arXiv 1302.0681, 2013), with missing sensors as in `WishartPrecision`.
    calibration : Calibration or None
        Logistic map from beta to the fault probability; without one the probability is NaN.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.VariationalBayesKF()).online(compiled=False)
    >>> for _ in range(10):
    ...     out = step(y=[0.0, 3.0], u=0.0)  # 25 is the nominal precision
    >>> out.precision.round(1).tolist(), out.x_hat.round(2).tolist()
    ([7.8, 0.2], [0.13])
    """

    forgetting: float = 0.95
    iterations: int = 3
    prior_shape: float = 2.0
    covariance: Literal["diagonal", "full"] = "diagonal"
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        check_choice(self, "covariance", "diagonal", "full")
        check_number(self, "forgetting", above=0, most=1)
        check_number(self, "iterations", least=1, most=_posterior.MOST_ITERATIONS, whole=True)
        check_number(self, "prior_shape", above=1 if self.covariance == "full" else 0)
        self.check_calibration()

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, nominal = model.sensors, model.matrix("sensor_covariance")
        to_probability, slope, intercept = probability_map(self.calibration)
        if self.covariance == "diagonal":
            rates = self.prior_rates(model)
            memory = np.concatenate([rates, np.full(m, self.prior_shape), rates])
            settings = np.array([self.forgetting, self.prior_shape, slope, intercept])
            step = _diagonal_learner(to_probability, int(self.iterations))
            return Learner(step, memory, settings, _posterior.WORK, moment_ports(m), report_gamma)
        weight = 2.0 * self.prior_shape - 2.0
        settings = np.zeros(8)
        settings[FORGETTING], settings[PRIOR] = self.forgetting, weight
        settings[TOWARDS] = settings[LESS] = m + 1
        settings[SLOPE], settings[INTERCEPT] = slope, intercept
        step = _full_learner(to_probability, int(self.iterations))
        memory = prior_memory(weight + m + 1, weight * nominal)
        return Learner(step, memory, settings, _posterior.WORK, wishart_ports(m), report_wishart)

    def prior_rates(self, model: LinearModel) -> Floats:
        """See `RateLearner.prior_rates`."""
        shape = self.prior_shape if self.covariance == "diagonal" else 0.5 * (2.0 * self.prior_shape - 2.0)
        return np.asarray(shape * np.diag(model.matrix("sensor_covariance")))
