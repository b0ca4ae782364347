"""The paper's two baselines (section 5.2.1), which ignore a sensor or use it fully, by a threshold on a residual."""

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
    trust.R[i, i] = select(ignored, INFINITE, variance)  # marks the sensor as left out in the output R
    trusted = both(sample.present[i] > 0.5, negate(ignored))
    trust.used[i] = select(trusted, 1.0, 0.0)
    trust.precision[i] = select(ignored, 0.0, 1.0 / variance)
    trust.beta[i] = nan
    trust.fault_probability[i] = select(sample.present[i] > 0.5, select(ignored, 1.0, 0.0), nan)


def learn_effdi(sample, trust, memory, settings, work):
    """Ignore sensors after a jump. ``memory``: for each sensor the last two samples, the last two r, and the steps left."""
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
    """Easy and fast FDI: after a jump of its signal, by second differences, a sensor is ignored for a fixed time.

    ``R_k = r_k + r_k-1 + r_k-2`` with ``r_k = |y_k - 2 y_k-1 + y_k-2|``. It cannot detect a frozen sensor, whose differences are
    zero. The decision is ``fault_probability`` (0 or 1). Precision is 0 while a sensor is ignored; beta is NaN.

    Parameters
    ----------
    threshold : float
        Threshold on R_k, in standard deviations of the sensor's noise; by default its 99.9 % quantile without fault.
    duration : float
        Expected duration of a fault in seconds, for which the sensor is ignored.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.EFFDI(duration=0.2)).online(compiled=False)
    >>> for y in (0.0, 0.1, 0.0, 0.1, 4.0):  # at last the first sensor jumps
    ...     out = step(y=[y, 0.0], u=0.0)
    >>> out.fault_probability.tolist(), out.precision.round(1).tolist()
    ([1.0, 0.0], [0.0, 25.0])
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
    """Predict, decide and update by filterpy's Kalman filter. ``memory``: whether it has begun, mean, covariance."""
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

    The estimate is that of a Kalman filter without the ignored sensors. The decision is ``fault_probability`` (0 or 1); beta is
    NaN. From a certain and wrong initial belief it ignores every sample. Give the controller an ``initial_mean``, or an
    ``initial_covariance`` that is large enough.

    With ``filter="filterpy"`` filterpy's Kalman filter predicts, decides and updates, with the same outputs up to rounding
    (`ser_reference` does so over recorded samples). It is for comparisons only. It runs as Python, some hundred times slower, in
    `BayesianController`, `LQGController` and `StateEstimator`, and cannot be compiled or exported. It does not limit the variance
    of states that no sensor sees.

    Parameters
    ----------
    threshold : float
        Threshold on ``|y - C x_t|t-1|``, in standard deviations of the innovation.
    filter : {"own", "filterpy"}
        The Kalman filter in use.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> learner = controllers.SERFDI(threshold=3.0)
    >>> step = controllers.StateEstimator(model, learner, initial_covariance=0.01).online(compiled=False)
    >>> out = step(y=[0.1, 2.0], u=0.0)
    >>> out.fault_probability.tolist(), out.precision.round(1).tolist(), out.x_hat.round(2).tolist()
    ([0.0, 1.0], [25.0, 0.0], [0.02])
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
                f"{who} has its own belief, which SERFDI(filter='filterpy') would replace by that of filterpy's Kalman filter; "
                f"{instead}, or set filter='own'."
            )
        return self
