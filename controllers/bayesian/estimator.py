"""The state estimator of the Bayesian controller alone, for a plant that another controller drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from bayesftc.controllers.bayesian.block import VARIANCE_CAP, extended_mean, known_constant
from bayesftc.controllers.estimation.absurd import alarm_of
from bayesftc.controllers.estimation.belief import ESTIMATION, estimation, look_ahead, make_estimate
from bayesftc.controllers.models.checks import Matrix, as_covariance, as_numbers, as_vector, frozen
from bayesftc.controllers.models.delays import extended_covariance
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import Learner, PrecisionLearner, made_once
from bayesftc.controllers.precision.held import hold_precision
from bayesftc.controllers.precision.kinds import InfersActuatorFaults
from bayesftc.controllers.signals import named, port, summary_of
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class StateEstimator(InfersActuatorFaults, Block):
    """Infers the state and each sensor's precision from redundant and possibly faulty sensors, without control.

    This is the estimator of `BayesianController` without the control: for recorded data, and for a plant that a person or
    another controller drives. With the same samples and controls both have the same belief, to the last bit.

    Inputs:

    - ``y`` (m): samples; NaN is a missing one.
    - ``u`` (p): the input of the plant until the next sample. A value that is not finite repeats the last one. Only where
      it moves nothing (B is zero) may it be left out. The belief at a sample does not depend on the input at that sample.

    Outputs ``x_hat`` (n), ``P`` (n x n), ``R`` (m x m), ``innovation``, ``precision``, ``beta``, ``fault_probability`` (m each)
    and those of the precision learner are those of `BayesianController`.

    Parameters
    ----------
    model : LinearModel
        Model of plant and sensors.
    precision : PrecisionLearner
        Learns the sensors' precisions; by default `SwitchingPrecision`. With `FixedPrecision` the block is a Kalman filter.
    initial_mean : number or vector
        Mean before the first sample. If it is given for the plant's states alone, estimated disturbances begin at 0.
    initial_covariance : number, vector, matrix or None
        Covariance before the first sample. By default the plant's states and random-walk disturbances have a variance of 1; a
        sensor's error (`LinearModel.with_sensor_errors`) has its stationary variance.
    invalid : sequence of number, or of one for each sensor
        Values that mark a missing sample, such as ``[-9999, 65535]``: a sample equal to one of them counts as missing.

    Raises
    ------
    ModelError
        If the model is not linear, dimensions do not fit, or the covariance is not positive semi-definite.

    Examples
    --------
    >>> import math
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.1]], [[1.0], [1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, initial_mean=20.0).online(compiled=False)
    >>> out = step(y=[20.1, math.nan, 25.0], u=[0.0])  # one sample is missing, one is wrong
    >>> out.x_hat.round(2).tolist(), out.fault_probability.round(2).tolist()
    ([20.11], [0.0, 0.01, 1.0])
    """

    model: LinearModel
    precision: PrecisionLearner = field(default_factory=SwitchingPrecision)
    initial_mean: float | tuple[float, ...] = 0.0
    initial_covariance: Matrix | None = None
    invalid: Invalid = field(default=(), kw_only=True)

    def __str__(self) -> str:
        """Return the sizes of the model and the kind of learner, for ``print``; the ``repr`` has all settings."""
        return summary_of(self)

    def __post_init__(self) -> None:
        if not isinstance(self.model, LinearModel):
            raise ModelError(
                f"StateEstimator needs a LinearModel, not {brief(self.model)}; see LinearModel.from_control."
            )
        if not isinstance(self.precision, PrecisionLearner):
            raise ModelError(
                f"precision is {brief(self.precision)}; it must be a precision learner: an object such as SwitchingPrecision() "
                "or, for a Kalman filter, FixedPrecision()."
            )
        n = self.model.states
        object.__setattr__(self, "initial_mean", as_vector("The initial_mean", self._extended(self.initial_mean), n))
        start = self._start() if self.initial_covariance is None else self.initial_covariance
        name = "The initial_covariance"
        covariance = as_covariance(name, extended_covariance(self.model, name, start), n, singular=True)
        object.__setattr__(self, "initial_covariance", known_constant(self.model, covariance))
        invalid_values(type(self).__name__, self.invalid, self.model.sensors)  # raises for wrong values
        self._learner()  # raises now, not in the loop, for settings that do not fit the model

    @made_once
    def _learner(self) -> Learner:
        return self.precision.learner(self.model)

    def _extended(self, mean: object) -> object:
        values = np.atleast_1d(as_numbers("The initial_mean", mean, "it must be a number or a list of numbers"))
        return extended_mean(self.model, values, mean)

    def _start(self) -> Floats:
        """Return variances of 1 for the plant's states, and the stationary ones for disturbances that have them."""
        A, Q = self.model.matrix("A"), self.model.matrix("process_covariance")
        variances, delays = np.ones(len(A)), self.model.delays
        for i in range(len(A) - self.model.disturbances, len(A)):
            if abs(A[i, i]) < 1:
                variances[i] = Q[i, i] / (1 - A[i, i] * A[i, i])
        return frozen(variances if delays is None else np.delete(variances, delays.places))

    @property
    def measurement_matrix(self) -> Floats:
        """Matrix that maps ``x_hat`` to what each sensor measures, without the sensor's error (m x n)."""
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
        # Without a default, a forgotten connection is an error; a plant that no control moves needs none.
        default = None if self.model.effects.any() else 0.0
        return port("y", (self.model.sensors,), of=named(self.model, "sensors")), port(
            "u",
            (self.model.controls,),
            default=default,
            feedthrough=False,
            applied=True,
            of=named(self.model, "controls"),
        )

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``x_hat, P, R, innovation, precision, beta, fault_probability, model_suspect``, and those of the learner."""
        return *self._common_outputs, *self._learner().ports

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """See `Block.held`."""
        block: Block = hold_precision(self, self._learner().ports, outputs)
        return block

    @property
    def _common_outputs(self) -> tuple[Port, ...]:
        n, m = self.model.states, self.model.sensors
        each = tuple(port(name, (m,)) for name in ("innovation", "precision", "beta", "fault_probability"))
        return port("x_hat", (n,)), port("P", (n, n)), port("R", (m, m)), *each, port("model_suspect")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        model, learner = self.model, self._learner()
        Q, nominal = model.matrix("process_covariance"), model.matrix("sensor_covariance")
        largest = VARIANCE_CAP * max(M.diagonal().max() for M in (np.asarray(self.initial_covariance), Q, nominal))
        first = sum(port.size for port in self._common_outputs)
        estimate = make_estimate(learner.step, learner.infer, learner.report, alarm_of(learner, first), first)
        state, parameters, scratch = estimation(self, model, learner, largest, np.zeros(model.controls))
        return Definition(estimate, look_ahead, state, parameters, learner.compiled, scratch, {"est": ESTIMATION})
