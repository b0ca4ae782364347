"""The Bayesian controller with an infinite horizon: the linear quadratic Gaussian regulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesftc.controllers.bayesian.describing import listed
from bayesftc.controllers.bayesian.linear import BayesianController
from bayesftc.controllers.bayesian.preview import MOST, goal_effects, target_steady_state
from bayesftc.controllers.bayesian.riccati import Regulator, regulate
from bayesftc.controllers.bayesian.stabilisability import (
    refuse_undetectable,
    refuse_unstabilisable,
    unreached,
    without_modes,
)
from bayesftc.controllers.bayesian.steady import Gains
from bayesftc.controllers.models.checks import Matrix, as_number, frozen
from bayesftc.controllers.signals import with_names
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

CERTAIN = 1e-13
"""Weight of the belief's uncertainty relative to the goal prior; the law equals the regulator's to this accuracy."""


@dataclass(frozen=True, eq=False)
class LQGController(BayesianController):
    """Infers the state, and the control that is best in the long run for holding the outputs at the goal.

    `BayesianController` has a goal for the *next* state, which is short-sighted. Here the goal is for the outputs. At every
    sample the controller computes a steady state (x_ss, u_ss) from the goal. The goal prior on the next state has the mean x_ss,
    and as its precision the Riccati equation's cost-to-go P; the control prior is N(u_ss, R^-1). The one-step posterior is then
    the law of the linear quadratic regulator,

        u = u_ss - (R + B' P B)^-1 B' P A (x_hat - x_ss),

    for the cost ``(y - goal)' goal_covariance^-1 (y - goal) + (u - u_ss)' control_covariance^-1 (u - u_ss)`` of each sample. A
    common factor of both precisions does not change this law. The controller uses so small a factor that the uncertainty of the
    belief has no effect.

    The law itself has no limits. ``u_min``, ``u_max`` and ``u_rate`` limit its control, which is then no longer optimal. The
    belief is predicted with the limited control, so that estimated disturbances do not wind up.

    Integrators that the goals do not see, such as the position for a goal on the speed, are not controlled. A, B, P and the
    steady state are those of the remaining states.

    With fewer goals than controls, u_ss is the cheapest solution. The steady state (x_ss, u_ss) allows for estimated
    disturbances (`LinearModel.with_disturbance`), for loads that last (states that nothing moves and that decay more slowly
    than the closed loop, such as ``loads`` of `design`), and for actuator faults that the precision learner infers. They
    therefore leave no steady error.

    Ports are those of `BayesianController`, with one element of ``goal`` for each goal. An element that is NaN keeps its last
    value; before the first value it is the output at the initial mean.

    With ``preview=n`` the goals of the next n samples are known. The input ``goal`` at t_k is then the goal for t_k+n, and the
    controller holds the goals until their time has come. The first goal also counts for the first n samples. The control is
    optimal for the known goals, with the last one held after them. `closed_loop` shifts the reference by itself.

    Parameters
    ----------
    model : LinearModel
        Model of plant and sensors.
    precision : PrecisionLearner
        Learns the sensors' precisions; by default `SwitchingPrecision`. With `FixedPrecision` the belief is a Kalman filter's.
    goal_on : "outputs" or matrix
        What the goal is given for: each distinct output (row of C), or ``H x`` for a matrix H with a column for each state.
    goal_covariance : number, vector or matrix
        Inverse of the cost of the outputs' errors. By Bryson's rule: squares of the largest acceptable errors.
    control_covariance : number, vector or matrix
        Inverse of the cost of the controls: squares of the largest acceptable deviations from u_ss.
    control_mean : 0
        Not used; the mean of the control prior is u_ss.
    belief, u_min, u_max, u_rate, initial_mean, initial_covariance, initial_control, invalid
        See `BayesianController`.
    preview : int
        Number n of samples by which the input ``goal`` lies ahead, at most 9,999. Beyond the settling time of the loop a
        larger number has no effect.
    posterior_outputs : False
        Must be False. Only the ratio of the two priors has a meaning: control covariance and free energy do not exist.
    goal_names : sequence of str
        See `BayesianController`.

    Raises
    ------
    ModelError
        If dimensions do not fit; if there are more goals than controls; if the goals cannot be held in steady state; or if a
        mode that does not decay is moved by no control or seen by no sensor. The message gives the mode's eigenvalue.

    Examples
    --------
    >>> from bayesftc.controllers import LinearModel, LQGController
    >>> servo = LinearModel([[1, 0.1], [0, 1]], [[0.005], [0.1]], [[1, 0]], [1e-6, 1e-6], 1e-4, dt=0.1)
    >>> controller = LQGController(servo, goal_covariance=0.01, control_covariance=1.0)
    >>> print(controller.describe().splitlines()[0])
    Closed-loop poles of the control: 0.78+0.177764j, 0.78-0.177764j; the slowest of magnitude 0.800 (time constant 0.448 s).
    """

    goal_on: Literal["states", "outputs"] | Matrix = "outputs"
    control_covariance: Matrix | None = 1.0
    preview: int = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        if isinstance(self.goal_on, str) and self.goal_on == "states":
            raise ModelError(
                "LQGController has goal_on='states', but not every state can be held at any value. Give 'outputs' or the matrix "
                "that maps the state to what has a goal."
            )
        if self.control_covariance is None:
            raise ModelError("LQGController needs a control_covariance, the inverse of the controls' cost.")
        if np.any(self.control_mean):
            raise ModelError(
                "LQGController has a control_mean, but computes the control prior's mean from the goal; leave control_mean out."
            )
        if self.posterior_outputs:
            raise ModelError(
                "LQGController has posterior_outputs=True, but the scale of its goal and control priors is arbitrary. There is "
                "neither a covariance of the control nor a free energy; use BayesianController, or leave posterior_outputs out."
            )
        preview = as_number("LQGController has preview", self.preview, least=0, most=MOST, whole=True)
        object.__setattr__(self, "preview", int(preview))
        super().__post_init__()

    def _check_reach(self, effect: Floats) -> None:
        refuse_unstabilisable(self.model)
        refuse_undetectable(self.model)
        self.regulator  # noqa: B018 - raises for goals that cannot be held

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``y`` and ``goal``."""
        y, goal = super().inputs
        if self.preview:
            told = f"Goal of {self.preview} samples later; NaN keeps the last"
            each = tuple(with_names(told, [name]) for name in self.goal_names)
            goal = replace(goal, description=told, element_descriptions=each)
        return y, goal

    @property
    def lag(self) -> str:
        """A sentence about the lag of the control law itself behind a moving reference; empty with a preview."""
        return (
            ""
            if self.preview
            else "The regulator lags behind a moving reference. If that is known n samples ahead, give the controller preview=n."
        )

    @property
    def _costs(self) -> tuple[Floats, Floats]:
        """Return the costs of goals and controls."""
        goals, controls = (np.linalg.inv(np.asarray(c, float)) for c in (self.goal_covariance, self.control_covariance))
        return goals, controls

    @cached_property
    def regulator(self) -> Regulator:
        """The regulator: cost-to-go, gain, and the maps from the goal to the steady state."""
        return regulate(self.model, self.goal_matrix, *self._costs)

    @cached_property
    def _goal_effects(self) -> Floats:
        plant = self.model.states - self.model.disturbances
        A, B = self.model.matrix("A")[:plant, :plant], self.model.matrix("B")[:plant]
        return goal_effects(self.regulator, A, B, self.goal_matrix[:, :plant], *self._costs, self.preview)

    @cached_property
    def preview_gains(self) -> Floats:
        """Gains of the control on the goals of t_k, .., t_k+n, as an array of n + 1 matrices (p x r); see ``preview``."""
        total, plant = self.steady_gains().M, self.model.states - self.model.disturbances
        if not self.preview:
            return frozen(total[None])
        B, (_, cost) = self.model.matrix("B")[:plant], self._costs
        weight = cost + B.T @ self.regulator.cost_to_go @ B
        gains = np.linalg.solve(weight, np.concatenate([[cost @ self.regulator.u_of_goal], self._goal_effects]))
        gains[-1] = total - gains[:-1].sum(axis=0)
        return frozen(gains)

    def linear_law(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the controller in steady state as a linear system; see `BayesianController.linear_law`.

        With a preview the goals of t_k, .., t_k+n-1 are further states, and the input ``goal`` is that of t_k+n.
        """
        A, B, C, D = self.feedback()
        if not self.preview:
            return A, B, C, D
        n, m, r, p = len(A), self.model.sensors, self.goals, self.model.controls
        kept, effect = self.preview * r, self.model.moving.matrix("B")
        gains = np.hstack([*self.preview_gains])
        shift = np.eye(kept, kept + r, r)  # of all known goals, those that remain known
        return (
            np.block([[A, effect @ gains[:, :kept]], [np.zeros((kept, n)), shift[:, :kept]]]),
            np.block([[B[:, :m], effect @ gains[:, kept:]], [np.zeros((kept, m)), shift[:, kept:]]]),
            np.hstack([C, gains[:, :kept]]),
            np.hstack([D[:, :m], gains[:, kept:].reshape(p, r)]),
        )

    def _pole_lines(self) -> list[str]:
        of, past = self._apart
        plant = of.model.states - of.model.disturbances
        A, B = of.model.matrix("A")[:plant, :plant], of.model.matrix("B")[:plant]
        dt = float(of.model.step)
        poles, still = without_modes(of.regulator.poles(A, B), unreached(A, B, edge=1.0))
        lines = [f"Closed-loop poles of the control: {listed(poles, dt, past)}."]
        lines += [f"Modes that no control moves: {listed(still, dt)}."] * bool(still)
        lines.append(f"All poles, the filter's included: {listed(of._relevant_poles(), dt, 2 * past)}.")
        lines.append(f"Without control: {listed(np.linalg.eigvals(A), dt, past)}.")
        if self.preview:
            ahead = show(self.preview * self.model.step)
            lines.append(f"The input goal is the goal of {self.preview} samples later ({ahead} s).")
        if self.regulator.drifting:
            lines.append(
                f"The goals do not depend on {self.regulator.drifting} of the plant's integrators (such as the position behind a "
                "speed). These are not controlled and are not among the closed-loop poles."
            )
        return lines

    def _relevant_poles(self) -> NDArray[np.complex128]:
        poles = super()._relevant_poles()
        return poles[np.argsort(np.abs(poles - 1.0))[self.regulator.drifting :]] if self.regulator.drifting else poles

    def _priors(self) -> tuple[Floats, Floats, Floats]:
        root, factor = self._scaled
        G = np.hstack([root, np.zeros((len(root), self.model.disturbances))])
        return G, np.eye(len(root)) / factor, factor * self._prior_precision()

    @cached_property
    def _scaled(self) -> tuple[Floats, float]:
        """The goal prior's matrix, and the factor by which both precisions are scaled down."""
        root = self.regulator.root
        plant = root.shape[1]
        A, Q = self.model.matrix("A")[:plant], self.model.matrix("process_covariance")[:plant, :plant]
        prior_covariance = A @ np.asarray(self.initial_covariance) @ A.T + Q
        spread = float(np.trace(root @ prior_covariance @ root.T))
        return root, CERTAIN / max(spread, 1e-100)

    def _target_rule(self, GB: Floats, prior: Floats) -> tuple[Callable[..., None], dict[str, Any], dict[str, Any]]:
        regulator, H = self.regulator, self.goal_matrix
        root, x_of_others = regulator.root, regulator.x_of_others
        x_of_loads, u_of_loads = regulator.x_of_loads, regulator.u_of_loads
        p, mean = self.model.controls, np.asarray(self.initial_mean)
        targets = {
            "x_target": root @ np.hstack([regulator.x_of_goal, x_of_loads, x_of_others - x_of_loads @ x_of_others]),
            "u_target": np.hstack([regulator.u_of_goal, u_of_loads, regulator.u_of_others - u_of_loads @ x_of_others]),
        }
        # Each row has the goals of a time, the present one first; NaN before the first sample.
        held = np.vstack([np.full((self.preview, self.goals), np.nan), H @ mean])
        state = {"held": held, "u_prior": np.zeros(p), "prior_pull": np.zeros(p), "goal_shift": np.zeros(len(root))}
        state["prior_precision"] = np.zeros((p, p))
        targets["control_cost"] = prior
        targets["feedforward"] = (
            self._scaled[1] * np.hstack([*self._goal_effects]) if self.preview else np.zeros((1, 1))
        )
        return target_steady_state, {name: frozen(value) for name, value in targets.items()}, state

    def _steady_gains(self, A: Floats, B: Floats, C: Floats, G: Floats) -> Gains:
        gains, regulator = super()._steady_gains(A, B, C, G), self.regulator
        estimated = len(A) - regulator.gain.shape[1]
        offset = regulator.u_of_others + regulator.gain @ regulator.x_of_others
        return gains._replace(
            L=np.hstack([regulator.gain, -offset[:, :estimated]]),
            M=regulator.u_of_goal + regulator.gain @ regulator.x_of_goal,
            F=np.zeros((len(A), self.goals)),  # the goal prior is too weak to change the belief
        )
