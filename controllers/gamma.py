"""Gamma distributions over the sensors' precisions (paper, section 3.2), and the map from their rate to a fault probability."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.precision import ERROR_CAP, NAN, Learner, PrecisionLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import either, exp, log, maximum, minimum, select
from bayesftc.cosim.ports import Port

if TYPE_CHECKING:
    from bayesftc.controllers.model import LinearModel

RATE_FLOOR = 1e-12
"""Least rate, in units of its prior: sensors that agree exactly for ever must not become infinitely precise."""


@dataclass(frozen=True)
class Calibration:
    """A logistic map from beta to a probability: ``1 / (1 + exp(-(slope * x + intercept)))`` (paper, section 4.2).

    ``x`` is the rate relative to its prior: ``log(beta / b0)`` for ``feature="log"``, ``beta / b0`` for ``feature="linear"``.
    Made by `bayesftc.controllers.calibrate`.
    """

    slope: float
    intercept: float
    feature: Literal["log", "linear"] = "log"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.slope) and np.isfinite(self.intercept)) or self.feature not in {"log", "linear"}:
            raise ModelError(f"{self!r} cannot be used: slope and intercept must be finite, feature 'log' or 'linear'.")


# Settings of the gamma learner.
_FORGETTING, _SHAPE0, _TO_PRIOR, _BELIEF, _MODE, _SLOPE, _INTERCEPT = range(7)


def _no_probability(ratio, slope, intercept):
    """Without a calibration: NaN, which stands where the slope would."""
    return slope


def _logistic(x, slope, intercept):
    return 1.0 / (1.0 + exp(-(slope * x + intercept)))


def _logistic_of_log(ratio, slope, intercept):
    return _logistic(log(ratio), slope, intercept)


def probability_map(calibration: Calibration | None) -> tuple[Callable[..., float], float, float]:
    """Return the function of ``(beta / b0, slope, intercept)`` that a learner calls, and its slope and intercept."""
    if calibration is None:
        return _no_probability, NAN, NAN
    function = _logistic_of_log if calibration.feature == "log" else _logistic
    return function, calibration.slope, calibration.intercept


def _squared(i, e, spread, nominal, settings):
    squared = e[i] * e[i] + settings[_BELIEF] * spread[i, i]
    return minimum(squared, ERROR_CAP * nominal[i, i])


def _report(i, a, b, settings, present, probability, R, used, precision, beta, fault_probability):
    """Turn shape and rate of sensor `i` into its precision, covariance, beta and probability."""
    for j in range(R.shape[0]):
        R[i, j] = 0.0
        R[j, i] = 0.0
    w = (a - settings[_MODE]) / b
    R[i, i] = 1.0 / w
    used[i] = present
    precision[i] = w
    beta[i] = b
    fault_probability[i] = select(present > 0.5, probability, NAN)


MOMENTS = ("shape", "rate", "mean", "mode", "variance")
"""What the learner reports of each sensor's gamma distribution, as outputs ``precision_shape`` and so on."""


def moment_ports(sensors: int) -> tuple[Port, ...]:
    """Return the ports for the moments of one distribution for each sensor."""
    return tuple(Port(f"precision_{name}", (sensors,)) for name in MOMENTS)


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
    def learn_gamma(
        y, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability
    ):
        """Forget, then learn from this sample: shape + 1/2, rate + e^2 / 2 (paper, section 3.2). ``memory``: shapes, rates.

        Without a sample the distribution decays towards its prior; one that decays towards zero waits instead, for the shape
        must not vanish.
        """
        m = y.shape[0]
        a0 = settings[_SHAPE0]
        for i in range(m):
            b0 = a0 * nominal[i, i]
            sampled = present[i] > 0.5
            rho = select(either(sampled, settings[_TO_PRIOR] > 0.5), settings[_FORGETTING], 1.0)
            back = settings[_TO_PRIOR] * (1.0 - rho)
            a = rho * memory[i] + back * a0 + 0.5 * present[i]
            b = rho * memory[m + i] + back * b0
            b = b + select(sampled, 0.5 * _squared(i, e, spread, nominal, settings), 0.0)
            b = maximum(b, RATE_FLOOR * b0)
            memory[i] = a
            memory[m + i] = b
            probability = to_probability(b / b0, settings[_SLOPE], settings[_INTERCEPT])
            _report(i, a, b, settings, present[i], probability, R, used, precision, beta, fault_probability)

    return learn_gamma


@cache
def _window_learner(to_probability: Callable[..., float]) -> Callable[..., None]:
    def learn_gamma_window(
        y, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability
    ):
        """Learn from the last samples only.

        ``memory``: for each sensor a shift register of e^2; then of 1 for a sample; then shapes, rates.
        """
        m = y.shape[0]
        length = memory.shape[0] // (2 * m) - 1
        a0 = settings[_SHAPE0]
        for i in range(m):
            b0 = a0 * nominal[i, i]
            errors, counts = i * length, (m + i) * length
            for s in range(length - 1):
                memory[errors + length - 1 - s] = memory[errors + length - 2 - s]
                memory[counts + length - 1 - s] = memory[counts + length - 2 - s]
            memory[errors] = select(present[i] > 0.5, _squared(i, e, spread, nominal, settings), 0.0)
            memory[counts] = present[i]
            a, b = a0, b0
            for s in range(length):
                a = a + 0.5 * memory[counts + s]
                b = b + 0.5 * memory[errors + s]
            memory[2 * m * length + i] = a
            memory[2 * m * length + m + i] = b
            probability = to_probability(b / b0, settings[_SLOPE], settings[_INTERCEPT])
            _report(i, a, b, settings, present[i], probability, R, used, precision, beta, fault_probability)

    return learn_gamma_window


@dataclass(frozen=True)
class GammaPrecision(PrecisionLearner):
    """A gamma distribution over each sensor's precision, learned from its innovations (paper, section 3.2).

    Each sample adds 1/2 to the shape and half the squared innovation to the rate; the new expected precision shape / rate
    weights the same sample. Its ``beta`` output is the rate: the beta residual of section 4.2. Sensors are learned one by one:
    a correlation in the model's sensor covariance is not used. It adds the outputs ``precision_shape``, ``precision_rate``,
    ``precision_mean``, ``precision_mode`` and ``precision_variance`` to its controller, a number for each sensor.

    Parameters
    ----------
    forgetting : float or None
        Forgetting factor in (0, 1] per step; None is the paper's literal update, which never forgets (and so trusts a
        recovered sensor again only after many times the fault's length).
    window : int or None
        Look-back window in steps (at most 64) instead of forgetting.
    prior_shape : float
        Shape a0 of the prior; its rate is a0 times the sensor's nominal variance, so that the prior expects the nominal
        variance. It counts as 2 a0 samples.
    forget_to : {"prior", "zero"}
        Whether shape and rate decay towards the prior (a <- rho a + (1 - rho) a0, likewise b), or towards zero
        (Sarkka and Nummenmaa, IEEE TAC 54, 2009).
    belief_uncertainty : bool
        Whether the belief's own variance H P H' is added to the squared innovation; the paper leaves it out.
    estimate : {"mean", "mode"}
        Which precision is used: a / b or (a - 1) / b.
    calibration : Calibration or None
        Logistic map from beta to the fault probability; without one the probability is NaN.
    """

    forgetting: float | None = 0.95
    window: int | None = None
    prior_shape: float = 2.0
    forget_to: Literal["prior", "zero"] = "prior"
    belief_uncertainty: bool = False
    estimate: Literal["mean", "mode"] = "mean"
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        if self.forgetting is not None and not 0.0 < self.forgetting <= 1.0:
            raise ModelError(
                f"GammaPrecision has forgetting={self.forgetting!r}; it must lie in (0, 1], or be None for none."
            )
        if self.window is not None and (int(self.window) != self.window or not 1 <= self.window <= 64):
            raise ModelError(
                f"GammaPrecision has window={self.window!r}; it must be a whole number of steps from 1 to 64."
            )
        least = 1.0 if self.estimate == "mode" else 0.0
        if not (np.isfinite(self.prior_shape) and self.prior_shape > least):
            raise ModelError(f"GammaPrecision has prior_shape={self.prior_shape!r}; it must be above {least:g}.")
        if self.estimate not in {"mean", "mode"} or self.forget_to not in {"prior", "zero"}:
            raise ModelError("GammaPrecision takes estimate 'mean' or 'mode' and forget_to 'prior' or 'zero'.")
        if (
            self.forget_to == "zero"
            and self.estimate == "mode"
            and self.forgetting is not None
            and self.forgetting <= 0.5
        ):
            raise ModelError(
                "With forget_to='zero' the mode needs a forgetting factor above 0.5: else the shape falls below 1."
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
        rates = self.prior_shape * np.diag(model.matrix("sensor_covariance"))
        prior = np.concatenate([np.full(model.sensors, self.prior_shape), rates])
        ports = moment_ports(model.sensors)
        if self.window is not None:
            memory = np.concatenate([np.zeros(2 * model.sensors * int(self.window)), prior])
            return Learner(_window_learner(to_probability), memory, settings, ports=ports, report=report_gamma)
        return Learner(_forgetting_learner(to_probability), prior, settings, ports=ports, report=report_gamma)

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        if self.calibration is not None:
            return None
        return "GammaPrecision has no calibration: fit one with controllers.calibrate(...) and pass it as calibration=."
