"""Gamma distributions over the sensors' precisions (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.models.checks import check_choice, check_flags, check_number
from bayesftc.controllers.precision.base import ERROR_CAP, NAN, RATE_FLOOR, Learner
from bayesftc.controllers.precision.rate import Calibration, RateLearner, probability_map
from bayesftc.controllers.signals import port
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import either, maximum, minimum, select
from bayesftc.cosim.ports import Port

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

# Settings of the gamma learner.
_FORGETTING, _SHAPE0, _TO_PRIOR, _BELIEF, _MODE, _SLOPE, _INTERCEPT = range(7)


def _squared(i, sample, settings):
    squared = sample.e[i] * sample.e[i] + settings[_BELIEF] * sample.spread[i, i]
    return minimum(squared, ERROR_CAP * sample.nominal[i, i])


def _report(i, a, b, settings, present, probability, trust):
    """Write precision, covariance, beta and probability of sensor `i` from shape and rate."""
    for j in range(trust.R.shape[0]):
        trust.R[i, j] = 0.0
        trust.R[j, i] = 0.0
    w = (a - settings[_MODE]) / b
    trust.R[i, i] = 1.0 / w
    trust.used[i] = present
    trust.precision[i] = w
    trust.beta[i] = b
    trust.fault_probability[i] = select(present > 0.5, probability, NAN)


MOMENTS = ("shape", "rate", "mean", "mode", "variance")
"""Reported moments of each sensor's gamma distribution, as outputs ``precision_shape`` and so on."""


def moment_ports(sensors: int) -> tuple[Port, ...]:
    """Return the ports for the moments of one distribution for each sensor."""
    return tuple(port(f"precision_{name}", (sensors,)) for name in MOMENTS)


def report_gamma(memory, settings, nominal, first, outputs):
    """Write the moments of each sensor's precision; ``memory`` ends with all shapes, then all rates."""
    m, last = nominal.shape[0], memory.shape[0]
    for i in range(m):
        a = memory[last - 2 * m + i]
        b = memory[last - m + i]
        mean = a / b
        outputs[first + i] = a
        outputs[first + m + i] = b
        outputs[first + 2 * m + i] = mean
        outputs[first + 3 * m + i] = maximum(a - 1.0, 0.0) / b  # below a shape of 1 the density is highest at zero
        outputs[first + 4 * m + i] = mean / b


@cache
def _forgetting_learner(to_probability: Callable[..., float]) -> Callable[..., None]:
    def learn_gamma(sample, trust, memory, settings, work):
        """Forget, then learn from this sample: shape + 1/2, rate + e^2 / 2 (paper, section 3.2). ``memory``: shapes, rates.

        Without a sample the distribution decays towards its prior. One that decays towards zero remains, because the shape must
        not vanish.
        """
        m = sample.y.shape[0]
        a0 = settings[_SHAPE0]
        for i in range(m):
            b0 = a0 * sample.nominal[i, i]
            sampled = sample.present[i] > 0.5
            rho = select(either(sampled, settings[_TO_PRIOR] > 0.5), settings[_FORGETTING], 1.0)
            back = settings[_TO_PRIOR] * (1.0 - rho)
            a = rho * memory[i] + back * a0 + 0.5 * sample.present[i]
            b = rho * memory[m + i] + back * b0
            b = b + select(sampled, 0.5 * _squared(i, sample, settings), 0.0)
            b = maximum(b, RATE_FLOOR * b0)
            memory[i] = a
            memory[m + i] = b
            probability = to_probability(b / b0, settings[_SLOPE], settings[_INTERCEPT])
            _report(i, a, b, settings, sample.present[i], probability, trust)

    return learn_gamma


@cache
def _window_learner(to_probability: Callable[..., float]) -> Callable[..., None]:
    def learn_gamma_window(sample, trust, memory, settings, work):
        """Learn from the last samples only.

        ``memory``: for each sensor a shift register of e^2; then of 1 for a sample; then shapes, rates.
        """
        m = sample.y.shape[0]
        length = memory.shape[0] // (2 * m) - 1
        a0 = settings[_SHAPE0]
        for i in range(m):
            b0 = a0 * sample.nominal[i, i]
            errors, counts = i * length, (m + i) * length
            for s in range(length - 1):
                memory[errors + length - 1 - s] = memory[errors + length - 2 - s]
                memory[counts + length - 1 - s] = memory[counts + length - 2 - s]
            memory[errors] = select(sample.present[i] > 0.5, _squared(i, sample, settings), 0.0)
            memory[counts] = sample.present[i]
            a, b = a0, b0
            for s in range(length):
                a = a + 0.5 * memory[counts + s]
                b = b + 0.5 * memory[errors + s]
            memory[2 * m * length + i] = a
            memory[2 * m * length + m + i] = b
            probability = to_probability(b / b0, settings[_SLOPE], settings[_INTERCEPT])
            _report(i, a, b, settings, sample.present[i], probability, trust)

    return learn_gamma_window


@dataclass(frozen=True)
class GammaPrecision(RateLearner):
    """A gamma distribution over each sensor's precision, learned from its innovations (paper, section 3.2).

    Each sample adds 1/2 to the shape and half the squared innovation to the rate. The new expected precision, shape / rate,
    weights the same sample. The ``beta`` output is the rate: the beta residual of section 4.2. Sensors are learned one by one; a
    correlation in the model's sensor covariance is not used. The controller gets the outputs ``precision_shape``,
    ``precision_rate``, ``precision_mean``, ``precision_mode`` and ``precision_variance``, with a number for each sensor.

    Parameters
    ----------
    forgetting : float or None
        Forgetting factor in (0, 1] per step. None is the paper's literal update without forgetting; a recovered sensor then
        regains its precision only after many times the fault's length.
    window : int or None
        Look-back window in steps (at most 64) instead of forgetting.
    prior_shape : float
        Shape a0 of the prior. Its rate is a0 times the sensor's nominal variance, so that the prior expects the nominal variance.
        The prior counts as 2 a0 samples.
    forget_to : {"prior", "zero"}
        Whether shape and rate decay towards the prior (a <- rho a + (1 - rho) a0, likewise b), or towards zero
        (Sarkka and Nummenmaa, IEEE TAC 54, 2009).
    belief_uncertainty : bool
        Whether to add the belief's variance H P H' to the squared innovation; the paper leaves it out.
    estimate : {"mean", "mode"}
        The precision in use: a / b or (a - 1) / b.
    calibration : Calibration or None
        Logistic map from beta to the fault probability; without one the probability is NaN.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.GammaPrecision()).online(compiled=False)
    >>> for _ in range(10):
    ...     out = step(y=[0.0, 3.0], u=0.0)  # 25 is the nominal precision
    >>> out.precision.round(1).tolist(), out.beta.round(2).tolist()
    ([73.5, 0.2], [0.08, 35.77])
    """

    forgetting: float | None = 0.95
    window: int | None = None
    prior_shape: float = 2.0
    forget_to: Literal["prior", "zero"] = "prior"
    belief_uncertainty: bool = False
    estimate: Literal["mean", "mode"] = "mean"
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        check_choice(self, "forget_to", "prior", "zero")
        check_choice(self, "estimate", "mean", "mode")
        check_number(self, "forgetting", above=0, most=1, optional=True)
        check_number(self, "window", least=1, most=64, whole=True, optional=True)
        check_number(self, "prior_shape", above=1 if self.estimate == "mode" else 0)
        check_flags(self, "belief_uncertainty")
        self.check_calibration()
        if self.forget_to == "zero" and self.estimate == "mode" and (self.forgetting or 1.0) <= 0.5:
            raise ModelError(
                "With forget_to='zero' and estimate='mode', give a forgetting factor above 0.5, or the shape falls below 1."
            )

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        settings = np.zeros(7)
        settings[_FORGETTING] = 1.0 if self.forgetting is None else self.forgetting
        settings[_SHAPE0] = self.prior_shape
        settings[_TO_PRIOR] = self.forget_to == "prior"
        settings[_BELIEF] = self.belief_uncertainty
        settings[_MODE] = self.estimate == "mode"
        to_probability, settings[_SLOPE], settings[_INTERCEPT] = probability_map(self.calibration)
        prior = np.concatenate([np.full(model.sensors, self.prior_shape), self.prior_rates(model)])
        ports = moment_ports(model.sensors)
        if self.window is not None:
            memory = np.concatenate([np.zeros(2 * model.sensors * int(self.window)), prior])
            return Learner(_window_learner(to_probability), memory, settings, ports=ports, report=report_gamma)
        return Learner(_forgetting_learner(to_probability), prior, settings, ports=ports, report=report_gamma)

    def prior_rates(self, model: LinearModel) -> Floats:
        """See `RateLearner.prior_rates`."""
        return np.asarray(self.prior_shape * np.diag(model.matrix("sensor_covariance")))
