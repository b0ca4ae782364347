"""Common parts of learners with a rate: the map from the rate to a fault probability, and checks of settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bayesftc.controllers.models.checks import check_choice, check_number
from bayesftc.controllers.precision.base import NAN, PrecisionLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import exp, log

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Calibration:
    """A logistic map from beta to a probability: ``1 / (1 + exp(-(slope * x + intercept)))`` (paper, section 4.2).

    ``x`` is the rate relative to its prior: ``log(beta / b0)`` for ``feature="log"``, ``beta / b0`` for ``feature="linear"``.
    Made by `bayesftc.controllers.calibrate`.

    Parameters
    ----------
    slope : float
        Slope of the log-odds over x.
    intercept : float
        The log-odds at x = 0.
    feature : {"log", "linear"}
        Which feature x is.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> learner = controllers.GammaPrecision(calibration=controllers.Calibration(slope=4.0, intercept=-3.0))
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> step(y=[0.1, 1.0], u=0.0).fault_probability.round(2).tolist()
    [0.06, 0.99]
    """

    slope: float
    intercept: float
    feature: Literal["log", "linear"] = "log"

    def __post_init__(self) -> None:
        check_number(self, "slope")
        check_number(self, "intercept")
        check_choice(self, "feature", "log", "linear")


def _no_probability(ratio, slope, intercept):
    """Return NaN, which is the slope of a missing calibration."""
    return slope


def _logistic(x, slope, intercept):
    return 1.0 / (1.0 + exp(-(slope * x + intercept)))


def _logistic_of_log(ratio, slope, intercept):
    return _logistic(log(ratio), slope, intercept)


def probability_map(calibration: Calibration | None) -> tuple[Callable[..., float], float, float]:
    """Return the function of ``(beta / b0, slope, intercept)`` for a learner, with its slope and intercept."""
    if calibration is None:
        return _no_probability, NAN, NAN
    function = _logistic_of_log if calibration.feature == "log" else _logistic
    return function, calibration.slope, calibration.intercept


class RateLearner(PrecisionLearner):
    """Base of the learners that have a rate for each sensor, ``beta``, and accept a calibration.

    `calibrate` accepts any of them. A subclass is a dataclass with the field ``calibration: Calibration | None = None``. Its
    method ``prior_rates(model)`` returns the rates before the first sample. Its learning step function applies the calibration
    to ``beta / prior_rates``; without a calibration its ``fault_probability`` is NaN.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, [0.04, 0.16], dt=0.1)
    >>> [cls.__name__ for cls in controllers.LEARNERS if issubclass(cls, controllers.RateLearner)]
    ['GammaPrecision', 'WishartPrecision', 'VariationalBayesKF']
    >>> controllers.GammaPrecision(prior_shape=2.0).prior_rates(model).tolist()
    [0.08, 0.32]
    """

    calibration: Calibration | None

    def prior_rates(self, model: LinearModel) -> Floats:
        """Return the prior's rate of each sensor, to which the calibration's beta is relative."""
        raise TypeError(f"{type(self).__name__} has no method prior_rates(model); give it one.")

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        if self.calibration is not None:
            return None
        return f"{type(self).__name__} has no calibration; fit one with controllers.calibrate(...) and give it as calibration=."

    def check_calibration(self) -> None:
        """Refuse anything else than a calibration.

        Raises
        ------
        ModelError
            If it is neither a `Calibration` nor None.
        """
        if not (self.calibration is None or isinstance(self.calibration, Calibration)):
            raise ModelError(
                f"{type(self).__name__} has calibration={self.calibration!r}; give a Calibration(slope, intercept), such as the "
                "result of controllers.calibrate(...), or None."
            )
