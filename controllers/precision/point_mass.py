"""Point estimates of the sensors' precisions, by gradient descent on the free energy (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.models.checks import check_choice, check_flags, check_number
from bayesftc.controllers.precision.base import ERROR_CAP, NAN, Learner, PrecisionLearner
from bayesftc.controllers.precision.matrix import prior_memory
from bayesftc.controllers.precision.point_mass_matrix import (
    LEAST,
    MOST,
    RATE,
    WIDEST,
    WORK,
    learn_matrix,
    report_matrix,
)
from bayesftc.controllers.signals import port
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import exp, log, maximum, minimum, select

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel


def descend_log(w, squared, rate):
    """Return the relative precision after one step of ``zeta = ln w`` down the free energy."""
    return exp(log(w) - 0.5 * rate * (w * squared - 1.0))


def descend(w, squared, rate):
    """Return the relative precision after one step of ``w`` itself down the free energy."""
    return w - 0.5 * rate * (squared - 1.0 / w)


@cache
def _learner(step_down: Callable[..., float]) -> Callable[..., None]:
    def learn_point_mass(sample, trust, memory, settings, work):
        """Take one gradient step for each sensor with a sample. ``memory``: relative precisions."""
        m = sample.y.shape[0]
        for i in range(m):
            w = memory[i]
            squared = minimum(sample.e[i] * sample.e[i] / sample.nominal[i, i], ERROR_CAP)
            best = 1.0 / squared  # the minimum of this sample's free energy; infinite for an error of 0
            stepped = step_down(w, squared, settings[RATE])
            stepped = select(w > best, maximum(stepped, best), minimum(stepped, best))
            stepped = minimum(maximum(stepped, settings[LEAST]), settings[MOST])
            w = select(sample.present[i] > 0.5, stepped, w)
            memory[i] = w
            for j in range(m):
                trust.R[i, j] = 0.0
            trust.R[i, i] = sample.nominal[i, i] / w
            trust.used[i] = sample.present[i]
            trust.precision[i] = w / sample.nominal[i, i]
            trust.beta[i] = NAN
            trust.fault_probability[i] = NAN

    return learn_point_mass


def report_point_mass(memory, settings, nominal, first, outputs):
    """Write mean, mode and variance of each sensor's precision: a point estimate, with variance 0."""
    m = nominal.shape[0]
    for i in range(m):
        w = memory[i] / nominal[i, i]
        outputs[first + i] = w
        outputs[first + m + i] = w
        outputs[first + 2 * m + i] = 0.0


@dataclass(frozen=True)
class PointMassPrecision(PrecisionLearner):
    """One number for each sensor's precision, learned by gradient descent on the free energy (paper, section 3.1).

    Let w be the precision relative to the nominal one, and e the innovation in nominal standard deviations. The free energy of a
    sample is ``F = (w e^2 - ln w) / 2``, and each sample takes one step of size `rate` down its gradient. Sensors are learned one
    by one; a missing sample changes nothing. There is no forgetting: w returns at its rate as soon as errors are small.

    No step goes past this sample's minimum ``w = 1 / e^2``, because too long an explicit step would oscillate. A squared error is
    limited to 1e12, so that one absurd sample takes the precision to its lower bound and not further.

    With ``full=True`` the precision matrix of all sensors is learned, as in the paper, with correlations:
    ``F = (e' Pi e - ln |Pi|) / 2``, by steps of the matrix's logarithm, which keep it positive definite (derived in the module
    `point_mass_matrix`). The bounds then hold for each eigenvalue of the precision relative to the nominal one. A missing sensor
    keeps its covariance given the others. All innovations contain the error of the prediction, which counts as correlated noise;
    for sensors with independent noise the diagonal is the better choice.

    The controller gets the outputs ``precision_mean``, ``precision_mode`` (the same) and ``precision_variance`` (0): m numbers
    each, or m x m if the matrix is full. ``beta`` is NaN, because a point estimate has no rate.

    Parameters
    ----------
    rate : float
        Size k of the gradient step. Near the optimum the logarithm of the precision settles within about 2 / k samples.
    lower_bound : float
        Least precision, relative to the nominal one. This setting matters most: at 0.1 a faulty sensor still moves the belief.
    variance_bound : float
        Least variance, relative to the nominal one (the paper's bound); at 1 no precision exceeds the nominal one.
    parameterization : {"exponential", "direct"}
        The variable of the step: zeta = ln w, with steps relative to w; or w itself, which leaves a low precision in leaps,
        because its gradient there is 1 / w.
    full : bool
        Whether to learn the full precision matrix; with "exponential" only.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.PointMassPrecision(rate=0.1)).online(compiled=False)
    >>> [step(y=[0.0, 0.8], u=0.0).precision.round(1).tolist() for _ in range(3)]  # 25 is the nominal precision
    [[25.0, 11.8], [24.7, 10.2], [24.6, 9.0]]
    """

    rate: float = 0.1
    lower_bound: float = 1e-3
    variance_bound: float = 1.0
    parameterization: Literal["exponential", "direct"] = "exponential"
    full: bool = False

    def __post_init__(self) -> None:
        check_number(self, "rate", above=0)
        check_number(self, "variance_bound", above=0)
        check_number(self, "lower_bound", above=0)
        check_choice(self, "parameterization", "exponential", "direct")
        check_flags(self, "full")
        if self.full and self.parameterization == "direct":
            raise ModelError(
                "PointMassPrecision has full=True and parameterization='direct', but such a step can leave the positive definite "
                "matrices; give 'exponential', or full=False."
            )
        if self.full and self.lower_bound * self.variance_bound < WIDEST:
            raise ModelError(
                f"PointMassPrecision has lower_bound={self.lower_bound!r} and variance_bound={self.variance_bound!r}. For a full "
                f"matrix their product must be at least {WIDEST:g}, so that it can be inverted; give larger ones."
            )
        if self.lower_bound > 1 / self.variance_bound:
            raise ModelError(
                f"PointMassPrecision has lower_bound={self.lower_bound!r} and variance_bound={self.variance_bound!r}. Give a "
                "lower bound of at most 1 / variance_bound, which is the upper bound."
            )

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, most = model.sensors, 1.0 / self.variance_bound
        start = float(np.clip(1.0, self.lower_bound, most))
        settings = np.array([self.rate, self.lower_bound, most])
        names = [f"precision_{name}" for name in ("mean", "mode", "variance")]
        if self.full:
            memory = prior_memory(1.0, model.matrix("sensor_covariance") / start)
            ports = tuple(port(name, (m, m)) for name in names)
            return Learner(learn_matrix, memory, settings, WORK, ports, report_matrix)
        step = _learner(descend_log if self.parameterization == "exponential" else descend)
        ports = tuple(port(name, (m,)) for name in names)
        return Learner(step, np.full(m, start), settings, ports=ports, report=report_point_mass)

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return "PointMassPrecision has a point estimate of each precision, but no rate from which a probability could follow."
