"""A Wishart distribution over the precision matrix of all sensors (paper, section 3.2), for correlated sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.models.checks import as_number, check_choice, check_flags, check_number
from bayesftc.controllers.precision.base import ERROR_CAP, NAN, Learner
from bayesftc.controllers.precision.matrix import (
    BELIEF,
    FORGETTING,
    INTERCEPT,
    LESS,
    PRIOR,
    SLOPE,
    TO_PRIOR,
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
from bayesftc.cosim.ops import maximum, minimum, select, sqrt

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


@cache
def _learner(to_probability: Callable[..., float]) -> Callable[..., None]:
    def learn_wishart(sample, trust, memory, settings, work):
        """Forget, then learn from this sample: n + 1, V^-1 + e e' (paper, section 3.2)."""
        m = sample.y.shape[0]
        any_present = any_of(sample.present)
        forget(any_present, memory, settings, sample.nominal)
        T = work[0]
        for i in range(m):
            for j in range(m):
                a, b = sqrt(ERROR_CAP * sample.nominal[i, i]), sqrt(ERROR_CAP * sample.nominal[j, j])
                both = maximum(minimum(sample.e[i], a), -a) * maximum(minimum(sample.e[j], b), -b)
                T[i, j] = both + settings[BELIEF] * sample.spread[i, j]
        complete(sample.present, memory, settings, sample.nominal, T, work[1], work[2])
        learn_errors(any_present, T, memory, settings, sample.nominal)
        invert(memory, work[0], work[1])
        expected_covariance(sample.present, memory, settings, trust.R, trust.used, trust.precision, trust.beta)
        for i in range(m):
            ratio = trust.beta[i] / (0.5 * settings[PRIOR] * sample.nominal[i, i])
            probability = to_probability(ratio, settings[SLOPE], settings[INTERCEPT])
            trust.fault_probability[i] = select(sample.present[i] > 0.5, probability, NAN)

    return learn_wishart


@dataclass(frozen=True)
class WishartPrecision(RateLearner):
    """A Wishart distribution over the precision matrix of all sensors, learned from their innovations (paper, section 3.2).

    Each sample adds 1 to the degrees of freedom n and e e' to the inverse scale V^-1. The new expected precision n V weights the
    same sample. The prior expects the model's sensor covariance, with its correlations. ``beta`` is half the diagonal of V^-1,
    the rate of the gamma distribution of 1 / R_ii; with one sensor it equals that of `GammaPrecision`.

    For missing samples, the expected errors given the present ones, by the covariance learned so far, are used. The present
    sensors then learn as they would alone, and the missing ones keep their covariance given the others. If all samples are
    missing, the distribution only forgets.

    All innovations contain the error of the prediction, which counts as correlated noise.

    The controller gets the output ``precision_degrees_of_freedom`` and, as m x m matrices, ``precision_scale``,
    ``precision_mean``, ``precision_mode`` and ``precision_variance``.

    Parameters
    ----------
    forgetting : float or None
        Forgetting factor in (0, 1] per step; None never forgets.
    degrees_of_freedom : float or None
        Degrees of freedom n0 of the prior, above m - 1 for m sensors; the prior counts as n0 samples. At the default m + 3 each
        1 / R_ii has the shape 2 of `GammaPrecision`'s default prior, for any number of sensors.
    forget_to : {"prior", "zero"}
        Whether n and V^-1 decay towards their prior (n <- rho n + (1 - rho) n0, likewise V^-1), or V^-1 and n - m - 1 towards
        zero (Sarkka and Hartikainen, arXiv 1302.0681, 2013).
    belief_uncertainty : bool
        Whether to add the belief's covariance H P H' to e e'; the paper leaves it out.
    estimate : {"mean", "mode"}
        The precision in use: n V, or (n - m - 1) V, whose inverse is the expected covariance.
    calibration : Calibration or None
        Logistic map from beta to the fault probability; without one the probability is NaN.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.WishartPrecision()).online(compiled=False)
    >>> for _ in range(10):
    ...     out = step(y=[0.0, 3.0], u=0.0)
    >>> out.precision_mean.round(1).tolist()
    [[64.6, 0.9], [0.9, 0.2]]
    """

    forgetting: float | None = 0.95
    degrees_of_freedom: float | None = None
    forget_to: Literal["prior", "zero"] = "prior"
    belief_uncertainty: bool = False
    estimate: Literal["mean", "mode"] = "mean"
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        check_choice(self, "forget_to", "prior", "zero")
        check_choice(self, "estimate", "mean", "mode")
        check_number(self, "forgetting", above=0, most=1, optional=True)
        check_number(self, "degrees_of_freedom", above=0, optional=True)
        check_flags(self, "belief_uncertainty")
        self.check_calibration()

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, degrees = model.sensors, self._degrees(model)
        to_probability, slope, intercept = probability_map(self.calibration)
        settings = np.zeros(8)
        settings[FORGETTING] = 1.0 if self.forgetting is None else self.forgetting
        settings[PRIOR] = degrees
        settings[TOWARDS] = degrees if self.forget_to == "prior" else m + 1
        settings[TO_PRIOR] = self.forget_to == "prior"
        settings[LESS] = m + 1 if self.estimate == "mode" else 0
        settings[BELIEF] = self.belief_uncertainty
        settings[SLOPE], settings[INTERCEPT] = slope, intercept
        memory = prior_memory(degrees, degrees * model.matrix("sensor_covariance"))
        return Learner(_learner(to_probability), memory, settings, 3, wishart_ports(m), report_wishart)

    def prior_rates(self, model: LinearModel) -> Floats:
        """See `RateLearner.prior_rates`."""
        return np.asarray(0.5 * self._degrees(model) * np.diag(model.matrix("sensor_covariance")))

    def _degrees(self, model: LinearModel) -> float:
        m = model.sensors
        if self.degrees_of_freedom is None:
            return m + 3.0
        title = f"For {m} sensors and the {self.estimate} WishartPrecision has degrees_of_freedom"
        return as_number(title, self.degrees_of_freedom, above=m + 1 if self.estimate == "mode" else m - 1)
