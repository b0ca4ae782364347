"""Point estimates of the sensors' precisions, by gradient descent on the free energy (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers._checks import check_choice, check_number
from bayesftc.controllers._ports import port
from bayesftc.controllers.precision import ERROR_CAP, NAN, Learner, PrecisionLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import exp, log, maximum, minimum, select

if TYPE_CHECKING:
    from bayesftc.controllers.model import LinearModel

# Settings of the learner.
_RATE, _LEAST, _MOST = range(3)


def descend_log(w, squared, rate):
    """Return the relative precision after one step of ``zeta = ln w`` down the free energy."""
    return exp(log(w) - 0.5 * rate * (w * squared - 1.0))


def descend(w, squared, rate):
    """Return the relative precision after one step of ``w`` itself down the free energy."""
    return w - 0.5 * rate * (squared - 1.0 / w)


@cache
def _learner(step_down: Callable[..., float]) -> Callable[..., None]:
    def learn_point_mass(
        y, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability
    ):
        """Take one gradient step for each sensor that delivered a sample. ``memory``: relative precisions."""
        m = y.shape[0]
        for i in range(m):
            w = memory[i]
            squared = minimum(e[i] * e[i] / nominal[i, i], ERROR_CAP)
            best = 1.0 / squared  # where this sample's free energy is least; infinite for an error of 0
            stepped = step_down(w, squared, settings[_RATE])
            stepped = select(w > best, maximum(stepped, best), minimum(stepped, best))
            stepped = minimum(maximum(stepped, settings[_LEAST]), settings[_MOST])
            w = select(present[i] > 0.5, stepped, w)
            memory[i] = w
            for j in range(m):
                R[i, j] = 0.0
            R[i, i] = nominal[i, i] / w
            used[i] = present[i]
            precision[i] = w / nominal[i, i]
            beta[i] = NAN
            fault_probability[i] = NAN

    return learn_point_mass


def report_point_mass(memory, settings, nominal, first, outputs):
    """Write mean, mode and variance of each sensor's precision: one point, of which the variance is 0."""
    m = nominal.shape[0]
    for i in range(m):
        w = memory[i] / nominal[i, i]
        outputs[first + i] = w
        outputs[first + m + i] = w
        outputs[first + 2 * m + i] = 0.0


@dataclass(frozen=True)
class PointMassPrecision(PrecisionLearner):
    """One number for each sensor's precision, learned by gradient descent on the free energy (paper, section 3.1).

    With w the precision relative to the nominal one and e the innovation in nominal standard deviations, each sample is worth
    the free energy ``F = (w e^2 - ln w) / 2``, and each sample takes one step of size `rate` down it. Sensors are learned one
    by one; a missing sample changes nothing. The learner never forgets: it moves back at its rate as soon as errors are small.

    No step goes past this sample's own minimum ``w = 1 / e^2``: an explicit step that is too long would throw the precision
    to and fro. A squared error is capped at 1e12, so one absurd sample takes the precision to its lower bound and no further.

    It adds the outputs ``precision_mean``, ``precision_mode`` (the same) and ``precision_variance`` (0) to its controller;
    ``beta`` is NaN, for a point has no rate.

    Parameters
    ----------
    rate : float
        Size k of the gradient step. Near the optimum the logarithm of the precision settles within about 2 / k samples.
    lower_bound : float
        Least precision, relative to the nominal one. It matters most: at 0.1 a faulty sensor still pulls the belief away.
    variance_bound : float
        Least variance, relative to the nominal one (the paper's bound); at 1 no sensor is trusted more than the model does.
    parameterization : {"exponential", "direct"}
        Whether the step is taken by zeta = ln w (steps relative to w), or by w itself, which leaves a low precision by leaps,
        as its gradient is 1 / w there.
    """

    rate: float = 0.1
    lower_bound: float = 1e-3
    variance_bound: float = 1.0
    parameterization: Literal["exponential", "direct"] = "exponential"

    def __post_init__(self) -> None:
        check_number(self, "rate", above=0)
        check_number(self, "variance_bound", above=0)
        check_number(self, "lower_bound", above=0)
        check_choice(self, "parameterization", "exponential", "direct")
        if self.lower_bound > 1 / self.variance_bound:
            raise ModelError(
                f"PointMassPrecision has lower_bound={self.lower_bound!r} and variance_bound={self.variance_bound!r}; the "
                "precision's lower bound must be at most 1 / variance_bound, its upper bound."
            )

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, most = model.sensors, 1.0 / self.variance_bound
        start = float(np.clip(1.0, self.lower_bound, most))
        step = _learner(descend_log if self.parameterization == "exponential" else descend)
        ports = tuple(port(f"precision_{name}", (m,)) for name in ("mean", "mode", "variance"))
        settings = np.array([self.rate, self.lower_bound, most])
        return Learner(step, np.full(m, start), settings, ports=ports, report=report_point_mass)

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return "PointMassPrecision holds one number for each precision and no rate, from which a probability could be told."
