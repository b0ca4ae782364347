"""What the learners with a rate share: the map from that rate to a fault probability, and the checks of common settings."""

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
        Of the log-odds over x.
    intercept : float
        The log-odds at x = 0.
    feature : {"log", "linear"}
        What x is.
    """

    slope: float
    intercept: float
    feature: Literal["log", "linear"] = "log"

    def __post_init__(self) -> None:
        check_number(self, "slope")
        check_number(self, "intercept")
        check_choice(self, "feature", "log", "linear")


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


class RateLearner(PrecisionLearner):
    """Base of the learners that have a rate for each sensor, ``beta``, and take a calibration.

    `calibrate` takes any of them. A subclass is a dataclass with the field ``calibration: Calibration | None = None``, says by
    ``prior_rates(model)`` what its rates are before the first sample, and applies the calibration to ``beta / prior_rates`` in
    its learning step function; without a calibration its ``fault_probability`` is NaN.
    """

    calibration: Calibration | None

    def prior_rates(self, model: LinearModel) -> Floats:
        """Return the prior's rate of each sensor, which the calibration's beta is relative to."""
        raise TypeError(
            f"{type(self).__name__} does not say what its prior's rates are: give it a method prior_rates(model)."
        )

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        if self.calibration is not None:
            return None
        return f"{type(self).__name__} has no calibration: fit one with controllers.calibrate(...) and pass it as calibration=."

    def check_calibration(self) -> None:
        """Refuse what is no calibration.

        Raises
        ------
        ModelError
            If it is neither a `Calibration` nor None.
        """
        if not (self.calibration is None or isinstance(self.calibration, Calibration)):
            raise ModelError(
                f"{type(self).__name__} has calibration={self.calibration!r}; give a Calibration(slope, intercept), as "
                "controllers.calibrate(...) finds, or None."
            )
