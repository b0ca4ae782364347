"""The state estimator of the Bayesian controller alone: it watches a plant that somebody else drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from bayesftc.controllers.bayesian.block import VARIANCE_CAP, extended_mean, known_constant
from bayesftc.controllers.estimation.absurd import alarm_of
from bayesftc.controllers.estimation.belief import ESTIMATION, estimation, look_ahead, make_estimate
from bayesftc.controllers.models.checks import Matrix, as_covariance, as_numbers, as_vector, frozen
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import PrecisionLearner
from bayesftc.controllers.precision.held import hold_precision
from bayesftc.controllers.signals import port
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class StateEstimator(Block):
    """Infers the state and each sensor's precision from redundant and possibly faulty sensors, and controls nothing.

    The estimator of `BayesianController` without its decision: for a plant that another controller or a person drives, and for
    recorded data. With the same samples and controls both have the same belief, to the last bit.

    Inputs ``y`` (m samples; NaN is a missing one) and ``u`` (p; the known input that acts until the next sample; where it is not
    finite the last one goes on, unconnected it is 0). The belief at a sample does not wait for the input at it. Outputs
    ``x_hat`` (n), ``P`` (n x n), ``R`` (m x m), ``innovation``, ``precision``, ``beta``, ``fault_probability`` (m each) and those
    of the precision learner, as `BayesianController` has them.

    Parameters
    ----------
    model : LinearModel
        What is believed about plant and sensors.
    precision : PrecisionLearner
        How far each sensor is trusted; by default `SwitchingPrecision`. With `FixedPrecision` it is a Kalman filter.
    initial_mean : number or vector
        Belief before the first sample; where it is given for the plant's states alone, estimated disturbances begin at 0.
    initial_covariance : number, vector, matrix or None
        Its covariance. By default the plant's states have a variance of 1, and so have disturbances that wander without end; a
        sensor's error (`LinearModel.with_sensor_errors`) has the variance that it keeps.
    invalid : sequence of number, or of one for each sensor
        Values that devices send in place of a sample, as ``[-9999, 65535]``: a sample equal to one of them counts as missing.

    Raises
    ------
    ModelError
        If the model is no linear one, dimensions do not fit, or the covariance is not positive semi-definite.
    """

    model: LinearModel
    precision: PrecisionLearner = field(default_factory=SwitchingPrecision)
    initial_mean: float | tuple[float, ...] = 0.0
    initial_covariance: Matrix | None = None
    invalid: Invalid = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.model, LinearModel):
            raise ModelError(f"StateEstimator needs a LinearModel, not {self.model!r}; see LinearModel.from_control.")
        if not isinstance(self.precision, PrecisionLearner):
            raise ModelError(
                f"precision must be a precision learner such as SwitchingPrecision(), not {self.precision!r}."
            )
        n = self.model.states
        object.__setattr__(self, "initial_mean", as_vector("The initial_mean", self._extended(self.initial_mean), n))
        start = self._start() if self.initial_covariance is None else self.initial_covariance
        covariance = as_covariance("The initial_covariance", start, n, singular=True)
        object.__setattr__(self, "initial_covariance", known_constant(self.model, covariance))
        invalid_values(type(self).__name__, self.invalid, self.model.sensors)  # wrong ones fail here
        self.precision.learner(self.model)  # settings that do not fit the model fail here, not in the loop

    def _extended(self, mean: object) -> object:
        values = np.atleast_1d(as_numbers("The initial_mean", mean, "it must be a number or a list of numbers"))
        return extended_mean(self.model, values, mean)

    def _start(self) -> Floats:
        """Return the variances of a belief that knows of the disturbances what their model says."""
        A, Q = self.model.matrix("A"), self.model.matrix("process_covariance")
        variances = np.ones(len(A))
        for i in range(len(A) - self.model.disturbances, len(A)):
            if abs(A[i, i]) < 1:
                variances[i] = Q[i, i] / (1 - A[i, i] ** 2)
        return frozen(variances)

    @property
    def measurement_matrix(self) -> Floats:
        """What each sensor measures of ``x_hat``, its own errors left out (m x n)."""
        return self.model.quantities

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return "estimator"

    @property
    def sample_time(self) -> Fraction:
        """The model's sample time in seconds, at which the estimator must run."""
        step: Fraction = self.model.step
        return step

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``y`` and ``u``."""
        return port("y", (self.model.sensors,)), port(
            "u", (self.model.controls,), default=0.0, feedthrough=False, known=True
        )

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``x_hat, P, R, innovation, precision, beta, fault_probability, model_suspect``, and the learner's own."""
        return *self._own_outputs, *self.precision.learner(self.model).ports

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """See `Block.held`."""
        block: Block = hold_precision(self, self.precision.learner(self.model).ports, outputs)
        return block

    @property
    def _own_outputs(self) -> tuple[Port, ...]:
        n, m = self.model.states, self.model.sensors
        each = tuple(port(name, (m,)) for name in ("innovation", "precision", "beta", "fault_probability"))
        return port("x_hat", (n,)), port("P", (n, n)), port("R", (m, m)), *each, port("model_suspect")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        model, learner = self.model, self.precision.learner(self.model)
        Q, nominal = model.matrix("process_covariance"), model.matrix("sensor_covariance")
        largest = VARIANCE_CAP * max(M.diagonal().max() for M in (np.asarray(self.initial_covariance), Q, nominal))
        first = sum(port.size for port in self._own_outputs)
        estimate = make_estimate(learner.step, learner.infer, learner.report, alarm_of(learner, first), first)
        state, parameters, scratch = estimation(self, model, learner, largest)
        return Definition(estimate, look_ahead, state, parameters, learner.compiled, scratch, {"est": ESTIMATION})
