"""The Bayesian controller for linear models: filtering and control as one inference (paper, section 2.3)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesftc.controllers.bayesian.block import BayesianBlock
from bayesftc.controllers.bayesian.free_energy import tell_nothing, tell_posterior
from bayesftc.controllers.bayesian.steady import Gains, steady_gains
from bayesftc.controllers.estimation import filter as _filter
from bayesftc.controllers.estimation.absurd import alarm_of
from bayesftc.controllers.estimation.belief import ESTIMATION, estimation, go_on, make_estimate, plan
from bayesftc.controllers.estimation.filter import Aim, Decision, FoldingSpace, Limits, decide, limit
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import Learner, PrecisionLearner
from bayesftc.cosim.block import Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.stepping.records import named_alike
from bayesftc.cosim.types import Floats


class UnstableLoopWarning(UserWarning):
    """Plant and belief together do not settle: by the goal and control priors, or by a mode that no sensor sees."""


class Seeking(NamedTuple):
    """How an `LQGController` finds a steady state: maps from goal and state to it, the goal that is held, and its control."""

    x_target: Floats
    u_target: Floats
    held: Floats
    u_prior: Floats


class Densities(NamedTuple):
    """What only the free energy needs: mean of the control prior, the goal's covariance, and a constant."""

    u_0: Floats
    goal_noise: Floats
    constant: Floats


class Control(NamedTuple):
    """All that the control is inferred with."""

    aim: Aim
    decision: Decision
    limits: Limits
    folding: FoldingSpace
    seeking: Seeking
    densities: Densities


CONTROL = named_alike(
    Control,
    aim=named_alike(Aim, shift="goal_shift"),
    decision=named_alike(Decision, GB="GBw"),
    limits=named_alike(Limits),
    folding=named_alike(FoldingSpace),
    seeking=named_alike(Seeking),
    densities=named_alike(Densities),
)
"""What all these arrays are called among the state, parameters and scratch space of the controller."""


@cache
def _make_step(
    estimate: Callable[..., None],
    fold: Callable[..., None],
    seek: Callable[..., None],
    tell: Callable[..., None],
    posterior: int,
) -> Callable[..., None]:
    """Return the controller's step function for ways of estimating, carrying the belief, seeking the goal and telling.

    Among all outputs those of the posterior begin at the place `posterior`. The same functions give the same one, so that it is
    looked through and compiled once for however many controllers.
    """

    def bayesian_controller(goal, u, outputs, est, control):
        estimate(outputs, est)
        seek(goal, est.belief.x_hat, est.actuators, control)
        plan(est.actuators, control.aim.GB, control.decision)
        decide(est.belief, est.model.A, control.aim, control.decision, u)
        tell(posterior, outputs, u, est, control)
        limit(u, est.actuators.applied, control.limits)
        for i in range(control.aim.shift.shape[0]):
            control.decision.pull[i] = control.decision.pull[i] - control.aim.shift[i]
        fold(control.aim, control.decision, control.folding, est.belief)
        go_on(est)

    return bayesian_controller


def seek_goal(goal, x_hat, actuators, control):
    """Seek the goal as it is given; the control prior stays what it is."""
    for i in range(control.decision.sought.shape[0]):
        control.decision.sought[i] = goal[i]


@dataclass(frozen=True, eq=False)
class BayesianController(BayesianBlock):
    """Infers the state and the control that brings the next state to the goal, from redundant and possibly faulty sensors.

    At every sample the joint posterior of the state x_t, the control u_t and the next state x_t+1 is computed in closed form:
    the prediction prior and the sensors give the belief p(x_t | y_1..t); the goal prior on x_t+1 and, if wanted, a control
    prior give the control. How far each sensor is trusted is the precision learner's part.

    Inputs ``y`` (m samples; NaN is a missing one) and ``goal`` (of x_t+1; NaN is no goal, under which a flat control prior holds
    the last control). Outputs ``u`` (p), ``x_hat`` (n), ``P`` (n x n),
    ``R`` (m x m, the sensor covariance in use; infinite on the diagonal for a sensor that is left out), ``innovation`` (m;
    ``y - C x_t|t-1``, the state estimation residual; NaN for a missing sample), ``precision`` (m), ``beta`` (m),
    ``fault_probability`` (m; NaN while a sensor delivers no sample: that is known, not inferred), and those of the precision
    learner (moments of the precision).

    With ``posterior_outputs`` there are three more, of the joint posterior p(x_t, u_t | y_1..t, goal), before limits:
    ``u_covariance`` (p x p), ``u_state_covariance`` (p x n, NaN like the former where nothing determines the control), and
    ``free_energy``: -L of eq. 8 where it is least over x_t, u_t and x_t+1, with the sensor covariance ``R``, as a density:
    ``F = -ln p(x_t, u_t, x_t+1, y_t, goal)`` (nats). Samples, goals and flat priors that are none have no part in it, nor
    have states without uncertainty.

    Parameters
    ----------
    model : LinearModel
        What the controller believes about plant and sensors.
    precision : PrecisionLearner
        How far each sensor is trusted; by default `SwitchingPrecision`. With `FixedPrecision` the belief is a Kalman filter's.
    goal_on : {"states", "outputs"} or matrix
        What the goal is given for: all states (disturbances excluded), one value for each distinct output (row of C), or
        ``G x`` for a matrix G with a column for each state.
    goal_covariance : number, vector or matrix
        Covariance of the goal prior. The smaller, the more aggressive, where a control prior stands against it.
    control_covariance : number, vector, matrix or None
        Covariance of the control prior; None is a flat one, which makes the control deadbeat.
    control_mean : number or vector
        Mean of the control prior.
    belief : {"filtered", "joint"}
        Carry p(x_t | y_1..t), which is a Kalman filter's whatever the priors; or the marginal of the full joint, into which
        the goal leaks (and `SwitchingPrecision` then judges sensor by sensor).
    u_min, u_max : number or vector
        Limits of the control; the prediction uses the control that was applied.
    u_rate : number or vector
        Largest change of the control per second; the first step is measured from 0.
    initial_mean, initial_covariance : optional
        Belief before the first sample; by default 0 and the identity.
    invalid : sequence of number, or of one for each sensor
        Values that devices send in place of a sample, as ``[-9999, 65535]``: a sample equal to one of them counts as missing.
    posterior_outputs : bool
        Whether the covariance of the control and the free energy are outputs as well. They cost some time at each sample.

    Raises
    ------
    ModelError
        If dimensions do not fit, a covariance is not positive definite, or a flat control prior leaves a control undetermined.

    Warns
    -----
    UnstableLoopWarning
        If plant and belief together (fixed precision, no limits) have a pole on or outside the unit circle, constants that no
        control moves (a sensor's bias as a state) left out.
    """

    model: LinearModel

    def __post_init__(self) -> None:
        if not isinstance(self.model, LinearModel):
            raise ModelError(
                f"BayesianController needs a LinearModel, not {self.model!r}; see LinearModel.from_control."
            )
        self._check_settings()
        self._check_reach(self.model.matrix("B"))
        self._learner()  # settings that do not fit the model fail here, not in the loop
        self._warn_if_unstable()

    @property
    def actuator_kinds(self) -> tuple[str, ...]:
        """Names of the ways in which actuators can fail that the precision learner tells."""
        return tuple(type(mode).__name__ for mode in self._precision.actuator_modes)

    @property
    def _precision(self) -> PrecisionLearner:
        # With belief="joint" what the goal says counts as known of the state, by which no actuator can be judged.
        who = "A BayesianController with belief='joint'"
        return self.precision.apart(who) if self.belief == "joint" else self.precision

    def _learner(self) -> Learner:
        return self._precision.learner(self.model)

    @property
    def measurement_matrix(self) -> Floats:
        """What each sensor measures of ``x_hat``, its own errors left out (m x n)."""
        return self.model.quantities

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        model, learner, (G, _, prior) = self.model, self._learner(), self._priors()
        n, p, g = model.states, model.controls, len(G)
        B = model.matrix("B")
        joint = self.belief == "joint"
        shared = self._shared_parameters(step)
        state, known, space = estimation(self, model, learner, shared["largest"])
        parameters = known | shared | {"GB": G @ B, "prior_precision": prior}
        sizes: dict[str, tuple[int, ...]] = {
            "wanted": (g,),
            "GA": (g, n),
            "GAP": (g, n),
            "SG": (g, g),
            "pull": (g,),
            "W": (g, p),
            "Lambda": (p, p),
            "sought": (g,),
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
        seek, constants, seeking = self._seeking(G @ B, prior)
        parameters |= constants
        state |= seeking
        fold = _filter.fold_goal if joint else _filter.keep_belief
        parameters |= self._densities() | {"u_0": np.array(self.control_mean)}
        tell = tell_posterior if self.posterior_outputs else tell_nothing
        first = sum(port.size for port in self._own_outputs)
        posterior = first - sum(port.size for port in self._posterior_ports)
        infer = None if joint else learner.infer
        estimate = make_estimate(learner.step, infer, learner.report, alarm_of(learner, first), first)
        kernel = _make_step(estimate, fold, seek, tell, posterior)
        records = {"est": ESTIMATION, "control": CONTROL}
        return Definition(
            kernel,
            state=state,
            parameters=parameters,
            scratch=scratch,
            records=records,
            compiled=learner.compiled,
        )

    def _seeking(self, GB: Floats, prior: Floats) -> tuple[Callable[..., None], dict[str, Any], dict[str, Any]]:
        """Return the step function that takes the goal to what is sought of the next state, its parameters and state."""
        mean = np.asarray(self.control_mean)
        constants = {"goal_shift": GB @ mean, "prior_pull": prior @ mean}
        unused = {
            "x_target": np.zeros((1, 1)),
            "u_target": np.zeros((1, 1)),
            "held": np.zeros(1),
            "u_prior": np.zeros(1),
        }
        return seek_goal, constants | unused, {}

    def linear_law(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the controller in steady state as a linear system (A, B, C, D), with nominal precisions and without limits.

        Its inputs are ``y`` and ``goal``, one after the other, its outputs ``u``, its states the predicted mean of the belief;
        all of them are deviations from an operating point, so that the constant of a model (`LinearModel.about`) is none.
        """
        model = self.model.moving
        A, B, C = (model.matrix(name) for name in "ABC")
        n = model.states
        K, L, M, T, F = self.steady_gains()
        seen = np.eye(n) - K @ C  # x_hat = seen @ mean + K @ y
        move = A @ T - B @ L  # mean at the next step = move @ x_hat + ... goal
        return move @ seen, np.hstack([move @ K, A @ F + B @ M]), -L @ seen, np.hstack([-L @ K, M])

    def closed_loop_poles(self) -> NDArray[np.complex128]:
        """Return the poles of plant and belief together in steady state, at fixed precision and without limits.

        With ``belief="filtered"`` estimation and control separate: these are the eigenvalues of A - B L, with L the control's
        gain on the belief, and those of the filter. States of an estimated disturbance move on their own; of them only the
        estimates are counted.
        """
        return np.linalg.eigvals(self.closed_loop_matrix()).astype(np.complex128)

    def closed_loop_matrix(self) -> Floats:
        """Return the transition matrix of the plant's states and the predicted mean together; see `closed_loop_poles`."""
        model = self.model.moving
        A, B, C = (model.matrix(name) for name in "ABC")
        plant, m = model.states - model.disturbances, model.sensors
        A, B, C = A[:plant, :plant], B[:plant], C[:, :plant]
        move, given, out, direct = self.linear_law()
        return np.block([[A + B @ direct[:, :m] @ C, B @ out], [given[:, :m] @ C, move]])

    def steady_gains(self) -> Gains:
        """Return the gains of filter and control in steady state, at the model's sensor covariance and without limits."""
        A, B, C = (self.model.moving.matrix(name) for name in "ABC")
        return self._steady_gains(A, B, C, self._priors()[0][:, : len(A)])

    def describe(self) -> str:
        """Return in sentences what the controller expects and what the loop will do.

        Poles, model, trust in the sensors and the faults that it tells, gains of filter and control in steady state, and the
        standard deviations that the model expects of tracking and belief.
        """
        from bayesftc.controllers.bayesian import describing

        parts = (describing.model_lines, describing.learner_lines, describing.gain_lines, describing.accuracy_lines)
        return "\n".join([*self._pole_lines(), *(line for part in parts for line in part(self))])

    def _pole_lines(self) -> list[str]:
        from bayesftc.controllers.bayesian.describing import pole_lines

        return pole_lines(self._poles_to_judge())

    def _steady_gains(self, A: Floats, B: Floats, C: Floats, G: Floats) -> Gains:
        """Return the gains of filter and control in steady state."""
        Q, R = self.model.moving.matrix("process_covariance"), self.model.matrix("sensor_covariance")
        _, goal_covariance, prior = self._priors()
        start = np.asarray(self.initial_covariance)[: len(A), : len(A)]
        return steady_gains(A, B, C, G, Q, R, goal_covariance, prior, start, joint=self.belief == "joint")

    def _warn_if_unstable(self) -> None:
        poles = self._poles_to_judge()
        size = float(np.abs(poles).max()) if len(poles) else 0.0
        if size >= 1.0 - 1e-9:
            poles = poles[np.argsort(-np.abs(poles))]
            shown = ", ".join(f"{p.real:.3g}" if abs(p.imag) < 1e-12 else f"{p.real:.3g}{p.imag:+.3g}j" for p in poles)
            state = "unstable" if size > 1.0 + 1e-9 else "on the edge of stability"
            warnings.warn(
                f"The closed loop is {state}: its poles are {shown}, the largest of magnitude {size:.3g}. Either the goal for "
                "the next step alone is short-sighted: weaken it (goal_covariance), tighten the control prior "
                "(control_covariance), or set goals only for what the control reaches in one step; or the control hardly acts: "
                "loosen its prior; or no sensor sees an unstable mode of the model: add one.",
                UnstableLoopWarning,
                stacklevel=4,
            )

    def _poles_to_judge(self) -> NDArray[np.complex128]:
        """Return the loop's poles without those that stand for a constant no control moves, such as a sensor's bias."""
        plant = self.model.states - self.model.disturbances
        A, B = self.model.matrix("A")[:plant, :plant], self.model.matrix("B")[:plant]
        poles = self.closed_loop_poles()
        for eigenvalue in np.linalg.eigvals(A):
            reach = np.linalg.svd(np.hstack([eigenvalue * np.eye(plant) - A, B]), compute_uv=False)[-1]
            if abs(abs(eigenvalue) - 1.0) <= 1e-9 and reach <= 1e-9 * np.abs(A).max():
                poles = np.delete(poles, np.argmin(np.abs(poles - eigenvalue)))
        return poles
