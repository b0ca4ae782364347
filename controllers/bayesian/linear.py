"""The Bayesian controller for linear models: filtering and control as one inference (paper, section 2.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cache, cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bayesftc.controllers.bayesian.block import BayesianBlock
from bayesftc.controllers.bayesian.free_energy import write_nothing, write_posterior
from bayesftc.controllers.bayesian.stabilisability import unreached, without_modes
from bayesftc.controllers.bayesian.steady import Gains, steady_gains
from bayesftc.controllers.estimation import filter as _filter
from bayesftc.controllers.estimation.absurd import alarm_of
from bayesftc.controllers.estimation.belief import ESTIMATION, advance, estimation, make_estimate, plan
from bayesftc.controllers.estimation.filter import Aim, Decision, FoldingSpace, Limits, decide, limit
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import Learner, PrecisionLearner, made_once
from bayesftc.controllers.precision.kinds import InfersActuatorFaults
from bayesftc.controllers.switching.actuator_settings import warn_of_small_faults
from bayesftc.cosim.base.html import Lines
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import Definition
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.stepping.records import named_alike
from bayesftc.cosim.types import Floats


class UnstableLoopWarning(UserWarning):
    """The closed loop is not stable, or nearly unstable: because of goal and control priors, or of a mode that no sensor sees."""


class SteadyTarget(NamedTuple):
    """An `LQGController`'s steady state: maps to it from goal and state, the known goals, the control prior's mean and cost.

    ``held`` has a row for each known goal, and ``feedforward`` the gains on the goals in between.
    """

    x_target: Floats
    u_target: Floats
    feedforward: Floats
    held: Floats
    u_prior: Floats
    control_cost: Floats


class Densities(NamedTuple):
    """Parameters of the free energy: mean of the control prior, the goal's covariance, and a constant."""

    u_0: Floats
    goal_noise: Floats
    constant: Floats


class Control(NamedTuple):
    """All arrays from which the control is inferred."""

    aim: Aim
    decision: Decision
    limits: Limits
    folding: FoldingSpace
    steady: SteadyTarget
    densities: Densities


CONTROL = named_alike(
    Control,
    aim=named_alike(Aim, shift="goal_shift"),
    decision=named_alike(Decision, GB="GBw"),
    limits=named_alike(Limits),
    folding=named_alike(FoldingSpace),
    steady=named_alike(SteadyTarget),
    densities=named_alike(Densities),
)
"""Names of these arrays among the controller's state, parameters and scratch space."""


@cache
def _make_step(
    estimate: Callable[..., None],
    fold: Callable[..., None],
    set_target: Callable[..., None],
    write: Callable[..., None],
    posterior: int,
) -> Callable[..., None]:
    """Return the controller's step function, made of the functions that estimate, carry the belief, set the target and report.

    The posterior's outputs begin at the index `posterior`. The result is cached, so that all controllers with the same functions
    share one compiled step function.
    """

    def bayesian_controller(goal, u, outputs, est, control):
        estimate(outputs, est)
        set_target(goal, est.belief.x_hat, est.actuators, control)
        plan(est.actuators, control.aim.GB, control.decision)
        decide(est.belief, est.model.A, control.aim, control.decision, u)
        write(posterior, outputs, u, est, control)
        limit(u, est.actuators.applied, control.limits)
        for i in range(control.aim.shift.shape[0]):
            control.decision.goal_error[i] = control.decision.goal_error[i] - control.aim.shift[i]
        fold(control.aim, control.decision, control.folding, est.belief)
        advance(est)

    return bayesian_controller


def target_goal(goal, x_hat, actuators, control):
    """Make the goal itself the target; leave the control prior as it is."""
    for i in range(control.decision.target.shape[0]):
        control.decision.target[i] = goal[i]


@dataclass(frozen=True, eq=False)
class BayesianController(InfersActuatorFaults, BayesianBlock):
    """Infers the state and the control that brings the next state to the goal, from redundant and possibly faulty sensors.

    At every sample the controller computes the joint posterior of the state x_t, the control u_t and the next state x_t+1 in
    closed form. The prediction prior and the sensors give the belief p(x_t | y_1..t). The goal prior on x_t+1 and an optional
    control prior give the control. The precision learner sets the weight of each sensor.

    Inputs:

    - ``y`` (m): samples; NaN is a missing one.
    - ``goal``: for x_t+1; NaN is no goal. Without a goal a flat control prior keeps the last control.

    Outputs, besides those of the precision learner (moments of the precision):

    - ``u`` (p), ``x_hat`` (n), ``P`` (n x n).
    - ``R`` (m x m): the sensor covariance in use; infinite on the diagonal for a sensor that is left out.
    - ``innovation`` (m): ``y - C x_t|t-1``, the state estimation residual; NaN for a missing sample.
    - ``precision`` (m), ``beta`` (m).
    - ``fault_probability`` (m): NaN at a missing sample, except with `SwitchingPrecision`, which
      also infers whether a sensor has dropped out.

    With ``posterior_outputs`` there are three more, of the joint posterior p(x_t, u_t | y_1..t, goal) before limits:

    - ``u_covariance`` (p x p).
    - ``u_state_covariance`` (p x n). Both covariances are NaN where nothing determines the control.
    - ``free_energy``: the minimum of -L (eq. 8) over x_t, u_t and x_t+1 with the sensor covariance ``R``, as a density:
      ``F = -ln p(x_t, u_t, x_t+1, y_t, goal)`` (nats). Missing samples, missing goals, flat priors and states without
      uncertainty contribute nothing.

    Parameters
    ----------
    model : LinearModel
        Model of plant and sensors.
    precision : PrecisionLearner
        Learns the sensors' precisions; by default `SwitchingPrecision`. With `FixedPrecision` the belief is a Kalman filter's.
    goal_on : {"states", "outputs"} or matrix
        What the goal is given for: all states except disturbances; each distinct output (row of C); or ``G x`` for a matrix G
        with a column for each state.
    goal_covariance : number, vector or matrix
        Covariance of the goal prior. With a control prior, a smaller one makes the control more aggressive.
    control_covariance : number, vector, matrix or None
        Covariance of the control prior; None is a flat prior, which makes the control deadbeat.
    control_mean : number or vector
        Mean of the control prior.
    belief : {"filtered", "joint"}
        The belief that the next step starts from. "filtered": p(x_t | y_1..t), as in a Kalman filter, independent of the priors.
        "joint": the marginal of the full joint posterior, which also depends on the goal; `SwitchingPrecision` then judges each
        sensor by itself, in its per-sensor form.
    u_min, u_max : number or vector
        Limits of the control. The prediction uses the limited control.
    u_rate : number or vector
        Largest change of the control per second, also at the first step: see `initial_control`.
    initial_mean, initial_covariance : optional
        Belief before the first sample; by default 0 and the identity.
    initial_control : number or vector, optional
        The control before the first step; by default that of the model's operating point (`LinearModel.about`), else 0.
    invalid : sequence of number, or of one for each sensor
        Values that mark a missing sample, such as ``[-9999, 65535]``: a sample equal to one of them counts as missing.
    posterior_outputs : bool
        Whether the covariance of the control and the free energy are outputs as well. They take some time at each sample.
    goal_names : sequence of str
        A name for each element of the goal: that of a signal of the plant. Tables and figures then also show the tracking error
        of what no sensor measures. `design` gives them.

    Raises
    ------
    ModelError
        If dimensions do not fit, a covariance is not positive definite, or a flat control prior leaves a control undetermined.

    Warns
    -----
    UnstableLoopWarning
        If the closed loop (fixed precision, no limits) has a pole on or outside the unit circle. Poles of constants that no
        control moves, such as a sensor's bias as a state, do not count.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.BayesianController(model, goal_covariance=0.01, control_covariance=4.0).online(compiled=False)
    >>> out = step(y=[1.0, 1.1, 9.0], goal=[2.0])  # the third sensor is wrong
    >>> out.fault_probability.round(2).tolist(), out.x_hat.round(2).tolist(), out.u.round(2).tolist()
    ([0.0, 0.0, 1.0], [1.03], [6.41])
    """

    model: LinearModel

    def __post_init__(self) -> None:
        if not isinstance(self.model, LinearModel):
            raise ModelError(
                f"BayesianController needs a LinearModel, not {brief(self.model)}; see LinearModel.from_control."
            )
        self._check_settings()
        self._check_reach(self.model.matrix("B"))
        self._learner()  # raises now, not in the loop, for settings that do not fit the model
        warn_of_small_faults(self._precision.actuator_modes, self.model, self.u_min, self.u_max)  # type: ignore[arg-type]
        self._warn_if_unstable()

    @property
    def _precision(self) -> PrecisionLearner:
        # With belief="joint" the goal moves the belief about the state, so that this belief cannot reveal actuator faults.
        owner = "A BayesianController with belief='joint'"
        return self.precision.apart(owner) if self.belief == "joint" else self.precision

    @made_once
    def _learner(self) -> Learner:
        return self._precision.learner(self.model)

    @property
    def measurement_matrix(self) -> Floats:
        """Matrix that maps ``x_hat`` to what each sensor measures, without the sensor's error (m x n)."""
        return self.model.quantities

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        model, learner, (G, _, prior) = self.model, self._learner(), self._priors()
        n, p, g = model.states, model.controls, len(G)
        B = model.matrix("B")
        joint = self.belief == "joint"
        shared = self._shared_parameters(step)
        state, model_parameters, space = estimation(self, model, learner, shared["largest"], self.control_before)
        parameters = model_parameters | shared | {"GB": G @ B}
        sizes: dict[str, tuple[int, ...]] = {
            "goal_given": (g,),
            "GA": (g, n),
            "GAP": (g, n),
            "SG": (g, g),
            "goal_error": (g,),
            "W": (g, p),
            "Lambda": (p, p),
            "target": (g,),
            "GBw": (g, p),
        }
        folding = {
            "N": (g, g),
            "V": (g, g),
            "Wt": (p, g),
            "L": (n, n),
            "GL": (g, n),
            "VGL": (g, n),
            "M": (n, n),
            "X": (n, n),
            "h": (n,),
        }
        sizes |= {name: shape if joint else (1,) * len(shape) for name, shape in folding.items()}
        scratch = space | {name: np.zeros(shape) for name, shape in sizes.items()}
        set_target, constants, steady = self._target_rule(G @ B, prior)
        parameters |= constants
        state |= steady
        fold = _filter.fold_goal if joint else _filter.keep_belief
        parameters |= self._densities() | {"u_0": np.array(self.control_mean)}
        write = write_posterior if self.posterior_outputs else write_nothing
        first = sum(port.size for port in self._common_outputs)
        posterior = first - sum(port.size for port in self._posterior_ports)
        infer = None if joint else learner.infer
        estimate = make_estimate(learner.step, infer, learner.report, alarm_of(learner, first), first)
        kernel = _make_step(estimate, fold, set_target, write, posterior)
        records = {"est": ESTIMATION, "control": CONTROL}
        return Definition(
            kernel,
            state=state,
            parameters=parameters,
            scratch=scratch,
            records=records,
            compiled=learner.compiled,
        )

    def _target_rule(self, GB: Floats, prior: Floats) -> tuple[Callable[..., None], dict[str, Any], dict[str, Any]]:
        """Return the step function that turns the goal into the target of the next state, its parameters and its state."""
        mean = np.asarray(self.control_mean)
        constants = {"goal_shift": GB @ mean, "prior_precision": prior, "prior_pull": prior @ mean}
        unused = {
            "x_target": np.zeros((1, 1)),
            "u_target": np.zeros((1, 1)),
            "feedforward": np.zeros((1, 1)),
            "held": np.zeros((1, 1)),
            "u_prior": np.zeros(1),
            "control_cost": np.zeros((1, 1)),
        }
        return target_goal, constants | unused, {}

    def linear_law(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the controller in steady state as a linear system (A, B, C, D), at nominal precisions and without limits.

        Inputs are ``y`` followed by ``goal``, outputs ``u``, states the predicted mean of the belief. All are deviations from
        the operating point, so that the constant of a model (`LinearModel.about`) drops out.
        """
        return self.feedback()

    def feedback(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the law for a goal that stays, with the predicted mean of the belief as its only state."""
        model = self.model.moving
        A, B, C = (model.matrix(name) for name in "ABC")
        n = model.states
        K, L, M, T, F = self.steady_gains()
        update = np.eye(n) - K @ C  # x_hat = seen @ mean + K @ y
        move = A @ T - B @ L  # mean at the next step = move @ x_hat + ... goal
        return move @ update, np.hstack([move @ K, A @ F + B @ M]), -L @ update, np.hstack([-L @ K, M])

    def closed_loop_poles(self) -> NDArray[np.complex128]:
        """Return the poles of the closed loop (plant and filter) in steady state, at fixed precision and without limits.

        With ``belief="filtered"``, estimation and control are independent (separation principle): the poles are those of the
        filter and the eigenvalues of A - B L, where L is the gain of the control on the belief. No control moves an estimated
        disturbance, so only the poles of its estimate count.
        """
        of, past = self._apart
        if past:
            return np.append(of.closed_loop_poles(), np.zeros(2 * past))
        return np.linalg.eigvals(self.closed_loop_matrix()).astype(np.complex128)

    @cached_property
    def undelayed(self) -> Self | None:
        """The controller of the plant without delays, which has the same poles except those at 0; None if they differ.

        The poles differ if signals with different delays share noise, sensor errors or costs, or if estimation and control are
        not separate. Eigenvalues of the whole matrix would be wrong: rounding moves those of a chain of n delays from 0 to about
        the n-th root of 1e-16.
        """
        model, delays = self.model, self.model.delays
        if delays is None or self.belief != "filtered":
            return None
        pairs = [(model.sensor_covariance, delays.sensors), (self.control_covariance, delays.inputs)]
        errors = model.moving.matrix("C")[:, model.states - model.disturbances :]
        pairs.append((errors @ errors.T, delays.sensors))
        if any(_mixed(np.asarray(matrix, dtype=np.float64), steps) for matrix, steps in pairs if matrix is not None):
            return None
        keep = delays.others(model.states)
        values = {f.name: getattr(self, f.name) for f in fields(self)} | {
            "model": model.undelayed,
            "goal_on": self.goal_matrix[:, keep],
            "initial_mean": np.asarray(self.initial_mean)[keep],
            "initial_covariance": np.asarray(self.initial_covariance)[np.ix_(keep, keep)],
        }
        twin = object.__new__(type(self))  # no warning of its own
        twin.__dict__.update(values)
        return twin

    @property
    def _apart(self) -> tuple[Self, int]:
        """The controller that has the poles, and the number of past signals, each with a pole at 0 in plant and belief."""
        if self.undelayed is None or self.model.delays is None:
            return self, 0
        return self.undelayed, self.model.delays.states

    def closed_loop_matrix(self) -> Floats:
        """Return the transition matrix of the plant's states and the predicted mean together; see `closed_loop_poles`."""
        model = self.model.moving
        A, B, C = (model.matrix(name) for name in "ABC")
        plant, m = model.states - model.disturbances, model.sensors
        A, B, C = A[:plant, :plant], B[:plant], C[:, :plant]
        move, input_matrix, out, direct = self.feedback()
        return np.block([[A + B @ direct[:, :m] @ C, B @ out], [input_matrix[:, :m] @ C, move]])

    def steady_gains(self) -> Gains:
        """Return the gains of filter and control in steady state, at the model's sensor covariance and without limits."""
        A, B, C = (self.model.moving.matrix(name) for name in "ABC")
        return self._steady_gains(A, B, C, self._priors()[0][:, : len(A)])

    def describe(self) -> str:
        """Return a description of the controller and of the closed loop as text.

        It has the poles, the model and its noise, the precision learner and the faults that it distinguishes, the gains of filter
        and control in steady state, and the expected standard deviations of tracking and belief.
        """
        from bayesftc.controllers.bayesian import describing

        parts = (describing.model_lines, describing.learner_lines, describing.gain_lines, describing.accuracy_lines)
        return Lines("\n".join([*self._pole_lines(), *(line for part in parts for line in part(self))]))

    def _pole_lines(self) -> list[str]:
        from bayesftc.controllers.bayesian.describing import pole_lines

        of, past = self._apart
        return pole_lines(of._relevant_poles(), float(self.model.step), 2 * past)

    def _steady_gains(self, A: Floats, B: Floats, C: Floats, G: Floats) -> Gains:
        """Return the gains of filter and control in steady state."""
        Q, R = self.model.moving.matrix("process_covariance"), self.model.matrix("sensor_covariance")
        _, goal_covariance, prior = self._priors()
        start = np.asarray(self.initial_covariance)[: len(A), : len(A)]
        return steady_gains(A, B, C, G, Q, R, goal_covariance, prior, start, joint=self.belief == "joint")

    def _warn_if_unstable(self) -> None:
        poles = self._apart[0]._relevant_poles()
        size = float(np.abs(poles).max()) if len(poles) else 0.0
        if size >= 1.0 - 1e-9:
            poles = poles[np.argsort(-np.abs(poles))]
            shown = ", ".join(f"{p.real:.3g}" if abs(p.imag) < 1e-12 else f"{p.real:.3g}{p.imag:+.3g}j" for p in poles)
            state = "unstable" if size > 1.0 + 1e-9 else "on the edge of stability"
            warn_user(
                f"The closed loop is {state}: its poles are {shown}, the largest of magnitude {size:.3g}. There are three "
                "possible causes. If the goal for the next step alone is short-sighted, increase goal_covariance, decrease "
                "control_covariance, or set goals only for what the control reaches in one step. If the control hardly acts, "
                "increase control_covariance. If no sensor sees an unstable mode of the model, add a sensor.",
                UnstableLoopWarning,
            )

    def _relevant_poles(self) -> NDArray[np.complex128]:
        """Return the loop's poles without those of constants that no control moves, such as a sensor's bias."""
        plant = self.model.states - self.model.disturbances
        A, B = self.model.matrix("A")[:plant, :plant], self.model.matrix("B")[:plant]
        constant = [mode for mode in unreached(A, B) if abs(abs(mode) - 1.0) <= 1e-9]
        return without_modes(self.closed_loop_poles(), constant)[0]


def _mixed(matrix: Floats, delays: tuple[int, ...]) -> bool:
    """Return whether a matrix has entries between signals of different delays."""
    return matrix.ndim == 2 and bool(matrix[np.not_equal.outer(delays, delays)].any())
