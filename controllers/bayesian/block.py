"""Settings, checks and ports that the Bayesian controllers for linear and for nonlinear models share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from bayesftc.controllers.bayesian.free_energy import log_normaliser
from bayesftc.controllers.models.checks import (
    Matrix,
    as_covariance,
    as_matrix,
    as_numbers,
    as_vector,
    check_choice,
    check_flags,
    check_limits,
    frozen,
)
from bayesftc.controllers.models.delays import extended_covariance, extended_rows
from bayesftc.controllers.precision.base import Learner, PrecisionLearner
from bayesftc.controllers.precision.held import hold_precision
from bayesftc.controllers.precision.kinds import InfersFaults
from bayesftc.controllers.signals import named, port, summary_of
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.block import Block
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

VARIANCE_CAP = 1e20
"""Largest predicted variance, in units of the largest variance among initial belief, process noise and sensors."""


def extended_mean(model: Any, values: Floats, mean: object) -> object:
    """Extend a mean of the plant's states by past signals, zero disturbances and a constant; return any other `mean` unchanged.

    Past controls are those of the operating point, and past readings equal to the present ones.
    """
    plant, delays = model.states - model.disturbances, model.delays
    if delays is not None and values.shape in {(delays.plant,), (1,)}:
        present = np.broadcast_to(values, delays.plant)
        values = np.concatenate([present, delays.present @ present + delays.rest])
        mean = values
    if model.disturbances and values.shape in {(plant,), (1,)}:
        others = np.zeros(model.disturbances)
        others[-1] = getattr(model, "constant", False)
        return np.concatenate([np.broadcast_to(values, plant), others])
    return mean


def known_constant(model: Any, covariance: Floats) -> Floats:
    """Return the covariance with zero variance for the model's constant, if it has one."""
    if not getattr(model, "constant", False):
        return covariance
    fixed = np.array(covariance)
    fixed[-1], fixed[:, -1] = 0.0, 0.0
    return frozen(fixed)


@dataclass(frozen=True, eq=False)
class BayesianBlock(InfersFaults, Block, ABC):
    """A controller with a model, a precision learner, a goal prior and a control prior.

    The docstrings of the controllers describe the settings ``model, precision, goal_on, goal_covariance, control_covariance,
    control_mean, belief, u_min, u_max, u_rate, initial_mean, initial_covariance, initial_control, invalid, posterior_outputs,
    goal_names``.
    """

    model: Any
    precision: PrecisionLearner = field(default_factory=SwitchingPrecision)
    goal_on: Literal["states", "outputs"] | Matrix = "states"
    goal_covariance: Matrix = 1.0
    control_covariance: Matrix | None = None
    control_mean: float | tuple[float, ...] = field(default=0.0, metadata={"unit": "{u}"})
    belief: Literal["filtered", "joint"] = "filtered"
    u_min: float | tuple[float, ...] = field(default=float("-inf"), metadata={"unit": "{u}"})
    u_max: float | tuple[float, ...] = field(default=float("inf"), metadata={"unit": "{u}"})
    u_rate: float | tuple[float, ...] = field(default=float("inf"), metadata={"unit": "{u}/s"})
    initial_mean: float | tuple[float, ...] = 0.0
    initial_covariance: Matrix = 1.0
    initial_control: float | tuple[float, ...] | None = field(default=None, kw_only=True, metadata={"unit": "{u}"})
    invalid: Invalid = field(default=(), kw_only=True)
    posterior_outputs: bool = field(default=False, kw_only=True)
    goal_names: tuple[str, ...] = field(default=(), kw_only=True)

    def __str__(self) -> str:
        """Return the sizes of the model and the kind of learner, for ``print(controller)``; its ``repr`` has all settings."""
        more = (
            f"; {type(self).__name__}.describe() returns gains, poles and accuracy" if hasattr(self, "describe") else ""
        )
        return f"{summary_of(self)}{more}"

    def _check_settings(self) -> None:
        """Check all settings except the model, and expand numbers to arrays."""
        if not isinstance(self.precision, PrecisionLearner):
            raise ModelError(
                f"precision is {brief(self.precision)}; it must be a precision learner: an object such as SwitchingPrecision() "
                "or, for a Kalman filter, FixedPrecision()."
            )
        check_choice(self, "belief", "filtered", "joint")
        check_flags(self, "posterior_outputs")
        self._check_goal_names()
        n, p = self.model.states, self.model.controls
        values = {
            "goal_covariance": as_covariance("The goal_covariance", self.goal_covariance, self.goals),
            "control_mean": as_vector("The control_mean", self.control_mean, p),
            "u_min": as_vector("u_min", self.u_min, p, finite=False),
            "u_max": as_vector("u_max", self.u_max, p, finite=False),
            "u_rate": as_vector("u_rate", self.u_rate, p, finite=False),
            "initial_mean": as_vector("The initial_mean", self._extended(self.initial_mean), n),
            "initial_covariance": known_constant(
                self.model,
                as_covariance(
                    "The initial_covariance",
                    extended_covariance(self.model, "The initial_covariance", self.initial_covariance),
                    n,
                    singular=True,
                ),
            ),
        }
        invalid_values(type(self).__name__, self.invalid, self.model.sensors)  # raises for wrong values
        if self.initial_control is not None:
            values["initial_control"] = before = as_vector("The initial_control", self.initial_control, p)
            if ((before < values["u_min"]) | (before > values["u_max"])).any():
                raise ModelError(
                    f"The initial_control {before.tolist()} is outside the limits u_min={values['u_min'].tolist()} and "
                    f"u_max={values['u_max'].tolist()}. Give a control within them."
                )
        if self.control_covariance is not None:
            values["control_covariance"] = as_covariance("The control_covariance", self.control_covariance, p)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        names = getattr(self.model, "names", None)
        check_limits(values["u_min"], values["u_max"], names.controls if names else ())
        if (values["u_rate"] <= 0).any():
            raise ModelError(
                f"u_rate is {values['u_rate'].tolist()}; it must be positive (units of the control per second)."
            )

    def _check_goal_names(self) -> None:
        given = self.goal_names
        if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
            raise ModelError(f"goal_names is {given!r}; it must be a list of texts.")
        if len({*given}) < len(given):
            raise ModelError(f"goal_names is {given!r}; name each element once.")
        if given and len(given) != self.goals:
            raise ModelError(
                f"goal_names has {counted(len(given), 'name')}, but there are {self.goals} elements of the goal: {given!r}."
            )
        object.__setattr__(self, "goal_names", tuple(given))

    def _check_reach(self, effect: Floats) -> None:
        """Refuse a flat control prior if the goal does not determine each control; ``effect`` is d x_t+1 / d u_t."""
        p = self.model.controls
        if self.model.delays is not None and any(self.model.delays.inputs):
            raise ModelError(
                f"{type(self).__name__} has a goal for the next state, which a late control does not reach "
                f"(inputs={list(self.model.delays.inputs)} of with_delays). Use LQGController."
            )
        if self.control_covariance is None and (rank := np.linalg.matrix_rank(self.goal_matrix @ effect)) < p:
            raise ModelError(
                f"With a flat control prior the goal must determine each of the {p} controls. In one step the goal depends on "
                f"only {rank} of them; give a control_covariance."
            )

    @property
    def control_before(self) -> Floats:
        """The control before the first step: `initial_control`, else that of the model's operating point, else 0."""
        given, at = self.initial_control, getattr(self.model, "operating_control", None)
        known = given if given is not None else at
        return np.zeros(self.model.controls) if known is None else np.array(known, dtype=np.float64)

    def _extended(self, mean: object) -> object:
        # A mean of the plant's states alone implies zero disturbances.
        values = np.atleast_1d(as_numbers("The initial_mean", mean, "it must be a number or a list of numbers"))
        return extended_mean(self.model, values, mean)

    @property
    def lag(self) -> str:
        """A sentence about the lag of the control law itself behind a moving reference; empty without a lag."""
        return "The controller steers the state to it one step later."

    @property
    def goal_matrix(self) -> Floats:
        """Matrix G that maps the state to what has a goal (g x n)."""
        n = self.model.states
        if isinstance(self.goal_on, str):
            if self.goal_on == "states":
                return frozen(np.eye(n)[: self.model.plant_states])
            if self.goal_on == "outputs":
                return frozen(self._distinct_outputs())
            raise ModelError(f"goal_on is {self.goal_on!r}; it must be 'states', 'outputs' or a matrix.")
        rows = as_numbers(
            "The matrix goal_on", self.goal_on, "give a row for each element of the goal, with a column for each state"
        )
        return as_matrix("The matrix goal_on", extended_rows(self.model, np.atleast_2d(rows)), columns=n)

    def _distinct_outputs(self) -> Floats:
        """Return the rows of the quantities that the sensors measure, each distinct one once."""
        rows = self.model.quantities
        return np.asarray(rows[sorted(np.unique(rows, axis=0, return_index=True)[1])])

    @property
    def goals(self) -> int:
        """Number of elements of the goal."""
        return len(self.goal_matrix)

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return "controller"

    @property
    def sample_time(self) -> Fraction:
        """The model's sample time in seconds, at which the controller must run."""
        step: Fraction = self.model.step
        return step

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``y`` and ``goal``."""
        return port("y", (self.model.sensors,), of=named(self.model, "sensors")), port(
            "goal", (self.goals,), elements=self.goal_names
        )

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``u, x_hat, P, R, innovation, precision, beta, fault_probability, model_suspect`` and those of the learner."""
        return *self._common_outputs, *self._learner().ports

    @property
    def _common_outputs(self) -> tuple[Port, ...]:
        n, p, m = self.model.states, self.model.controls, self.model.sensors
        shapes: dict[str, tuple[int, ...]] = {
            "u": (p,),
            "x_hat": (n,),
            "P": (n, n),
            "R": (m, m),
            "innovation": (m,),
            "precision": (m,),
            "beta": (m,),
        }
        names = {"u": named(self.model, "controls"), "x_hat": named(self.model, "states")}
        elements = {"x_hat": getattr(self.model, "state_names", ())}
        return (
            *(
                port(name, shape, of=names.get(name, ()), elements=elements.get(name, ()))
                for name, shape in shapes.items()
            ),
            port("fault_probability", (m,)),
            port("model_suspect"),
            *self._posterior_ports,
        )

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """See `Block.held`."""
        block: Block = hold_precision(self, self._learner().ports, outputs)
        return block

    @property
    def _posterior_ports(self) -> tuple[Port, ...]:
        n, p = self.model.states, self.model.controls
        if not self.posterior_outputs:
            return ()
        return port("u_covariance", (p, p)), port("u_state_covariance", (p, n)), port("free_energy")

    @abstractmethod
    def _learner(self) -> Learner:
        """Return the precision learner for the model."""

    def _prior_precision(self) -> Floats:
        p = self.model.controls
        return (
            np.zeros((p, p)) if self.control_covariance is None else np.linalg.inv(np.asarray(self.control_covariance))
        )

    def _priors(self) -> tuple[Floats, Floats, Floats]:
        """Return the goal's matrix, the goal prior's covariance, and the control prior's precision."""
        return self.goal_matrix, np.asarray(self.goal_covariance, float), self._prior_precision()

    def _densities(self) -> dict[str, Any]:
        """Return the parameters of the free energy; zeros if it is not an output."""
        if not self.posterior_outputs:
            return {"goal_noise": np.zeros((1, 1)), "constant": 0.0}
        constant = log_normaliser(self.model.matrix("process_covariance"))
        if self.control_covariance is not None:
            constant += log_normaliser(np.asarray(self.control_covariance))
        return {"goal_noise": np.array(self.goal_covariance), "constant": constant}

    def _shared_parameters(self, step: Fraction) -> dict[str, Any]:
        """Return the parameters that the step functions of both controllers have."""
        Q, nominal = self.model.matrix("process_covariance"), self.model.matrix("sensor_covariance")
        initial, (G, goal_covariance, _) = np.asarray(self.initial_covariance), self._priors()
        return {
            "Q": Q,
            "nominal": nominal,
            "G": G,
            "GQ": G @ Q @ G.T + goal_covariance,
            "settings": self._learner().settings,
            "u_min": self.u_min,
            "u_max": self.u_max,
            "u_change": np.asarray(self.u_rate) * float(step),
            "largest": VARIANCE_CAP * max(M.diagonal().max() for M in (initial, Q, nominal)),
        }
