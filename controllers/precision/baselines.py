"""The paper's two baselines (section 5.2.1): they ignore a sensor or trust it fully, by a threshold on a residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesftc.controllers.models.checks import check_choice, check_number
from bayesftc.controllers.precision.base import TOGETHER, Learner, PrecisionLearner
from bayesftc.controllers.precision.filterpy import reference_filter, update_by_ser
from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, both, maximum, negate, select, sqrt

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

INFINITE = float("inf")

EFFDI_QUANTILE_999 = 19.76
"""The 99.9 % quantile of EF-FDI's statistic without fault, in standard deviations of the sensor's noise (checked by a test)."""


def _decide(i, ignored, nan, sample, trust):
    variance = sample.nominal[i, i]
    for j in range(sample.y.shape[0]):
        trust.R[i, j] = sample.nominal[i, j]
    trust.R[i, i] = select(ignored, INFINITE, variance)  # so that the output R says that it is left out
    trusted = both(sample.present[i] > 0.5, negate(ignored))
    trust.used[i] = select(trusted, 1.0, 0.0)
    trust.precision[i] = select(ignored, 0.0, 1.0 / variance)
    trust.beta[i] = nan
    trust.fault_probability[i] = select(sample.present[i] > 0.5, select(ignored, 1.0, 0.0), nan)


def learn_effdi(sample, trust, memory, settings, work):
    """``memory``: for each sensor the last two samples, the last two r, and the steps for which it is still ignored."""
    for i in range(sample.y.shape[0]):
        at = 5 * i
        r = absolute(sample.y[i] - 2.0 * memory[at] + memory[at + 1])
        jumped = r + memory[at + 2] + memory[at + 3] > settings[0] * sqrt(sample.nominal[i, i])
        left = select(jumped, settings[1], memory[at + 4])
        memory[at + 1] = memory[at]
        memory[at] = sample.y[i]
        memory[at + 3] = memory[at + 2]
        memory[at + 2] = r
        memory[at + 4] = maximum(left - 1.0, 0.0)
        _decide(i, left > 0.5, settings[2], sample, trust)


@dataclass(frozen=True)
class EFFDI(PrecisionLearner):
    """Easy and fast FDI: a jump of the sensor's signal, by its second differences, has it ignored for a fixed time.

    ``R_k = r_k + r_k-1 + r_k-2`` with ``r_k = |y_k - 2 y_k-1 + y_k-2|``. It cannot see a frozen sensor, whose differences are
    zero. The decision is ``fault_probability`` (0 or 1); precision is 0 while a sensor is ignored; beta is NaN.

    Parameters
    ----------
    threshold : float
        On R_k, in standard deviations of the sensor's noise; the default is its 99.9 % quantile without fault.
    duration : float
        Expected duration of a fault in seconds, for which the sensor is ignored.
    """

    threshold: float = EFFDI_QUANTILE_999
    duration: float = 0.4

    def __post_init__(self) -> None:
        check_number(self, "threshold", above=0, finite=False)
        check_number(self, "duration", above=0)

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        steps = whole_steps(self.duration, model.step, "EFFDI's duration")
        memory = np.tile(
            [np.nan, np.nan, np.nan, np.nan, 0.0], model.sensors
        )  # no history yet: NaN exceeds no threshold
        return Learner(learn_effdi, memory, np.array([self.threshold, steps, np.nan]))


def learn_serfdi(sample, trust, memory, settings, work):
    """Compare each innovation with its standard deviation."""
    for i in range(sample.y.shape[0]):
        ignored = absolute(sample.e[i]) > settings[0] * sqrt(sample.spread[i, i] + sample.nominal[i, i])
        _decide(i, ignored, settings[1], sample, trust)


def infer_by_filterpy(sample, trust, belief, model, actuators, learning, reach):
    """Predict, decide and update by filterpy's Kalman filter. ``memory``: whether it has begun, its mean, its covariance."""
    n, memory, settings = len(model.A), learning.memory, learning.settings
    if memory[0]:
        kf = reference_filter(model.A, model.B, model.Q, memory[1 : n + 1], memory[n + 1 :].reshape(n, n))
        kf.predict(u=actuators.applied.reshape(-1, 1))
    else:
        kf = reference_filter(model.A, model.B, model.Q, belief.mean, belief.covariance)
    ignored = update_by_ser(kf, sample.y, model.C, sample.nominal, settings[0])
    belief.x_hat[:], belief.P[:] = kf.x[:, 0], kf.P
    memory[0], memory[1 : n + 1], memory[n + 1 :] = 1.0, belief.x_hat, belief.P.ravel()
    for i in range(len(sample.y)):
        _decide(i, ignored[i], settings[1], sample, trust)


@dataclass(frozen=True)
class SERFDI(PrecisionLearner):
    """State estimation residual: a sensor whose innovation exceeds the threshold is ignored at this sample.

    The estimate is a Kalman filter's that leaves ignored sensors out. The decision is ``fault_probability`` (0 or 1); beta is
    NaN. Started from a belief that is sure and wrong it ignores every sample: give the controller an ``initial_mean``, or an
    ``initial_covariance`` that admits what it does not know.

    With ``filter="filterpy"`` that Kalman filter is filterpy's: it predicts, decides and updates, with the same outputs to
    rounding (`ser_reference` is the same over recorded samples). It is for comparisons: it runs as Python, some hundred times
    slower, in `BayesianController`, `LQGController` and `StateEstimator`; it cannot be compiled or exported; and it does not
    limit the variance of states that no sensor sees, as ours does.

    Parameters
    ----------
    threshold : float
        On ``|y - C x_t|t-1|``, in standard deviations of the innovation.
    filter : {"own", "filterpy"}
        Whose Kalman filter computes the estimate.
    """

    threshold: float = 3.0
    filter: Literal["own", "filterpy"] = "own"

    def __post_init__(self) -> None:
        check_number(self, "threshold", above=0, finite=False)
        check_choice(self, "filter", "own", "filterpy")

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        settings = np.array([self.threshold, np.nan])
        if self.filter == "own":
            return Learner(learn_serfdi, np.zeros(1), settings)
        n = model.states
        return Learner(learn_serfdi, np.zeros(1 + n + n * n), settings, infer=infer_by_filterpy, compiled=False)

    def apart(self, who: str, instead: str = TOGETHER) -> SERFDI:
        """See `PrecisionLearner.apart`."""
        if self.filter == "filterpy":
            raise ModelError(
                f"{who} has a belief of its own, which SERFDI(filter='filterpy') would take from filterpy's Kalman filter; "
                f"{instead}, or take filter='own'."
            )
        return self
