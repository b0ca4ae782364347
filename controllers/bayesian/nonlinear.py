"""The Bayesian controller for nonlinear models: filtering and control as one minimisation (paper, section 2.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.block import BayesianBlock
from bayesftc.controllers.bayesian.extended_check import extended_consistency, make_watch
from bayesftc.controllers.bayesian.free_energy import write_linearised, write_nothing_more
from bayesftc.controllers.bayesian.minimise import (
    DISTANT,
    SLOPES,
    SQUARES,
    VECTORS,
    Ahead,
    Problem,
    Search,
    determined,
    factorise,
    keep,
    leave_out_distant,
    locate,
    make_look_ahead,
    make_minimiser,
)
from bayesftc.controllers.estimation.absurd import Reading, Screen, alarm_of, mark_absurd, screening
from bayesftc.controllers.estimation.belief import SAMPLE, Learning
from bayesftc.controllers.estimation.consistency import OBSERVER_BANK, ObserverBank
from bayesftc.controllers.estimation.filter import MEAN_CAP, Belief, Limits, hold_variances, innovate, limit, restore
from bayesftc.controllers.linalg.dense import cholesky_semidefinite, congruence
from bayesftc.controllers.linalg.least_squares import is_finite, marginal
from bayesftc.controllers.models.checks import Matrix, check_choice, check_number, frozen
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.linear_rows import linear_rows
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.controllers.precision.base import NAN, Learner, Sample, Trust, made_once
from bayesftc.cosim.block import Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, both, select
from bayesftc.cosim.stepping.records import named_alike
from bayesftc.cosim.types import Floats, Kernel


class Bounds(NamedTuple):
    """The largest variance of a belief, the sensors' nominal covariance, and the initial belief."""

    largest: Floats
    nominal: Floats
    initial_mean: Floats
    initial_covariance: Floats


def stay(belief, applied, ahead):
    """Predict a constant state (a random walk)."""
    mean, covariance, x_hat, P = belief
    n = x_hat.shape[0]
    for i in range(n):
        mean[i] = x_hat[i]
        for j in range(n):
            covariance[i, j] = P[i, j]


@cache
def make_move(look_ahead: Kernel) -> Kernel:
    """Return the step function that predicts the mean by the model, and the covariance by its linearisation at the estimate."""

    def move(belief, applied, ahead):
        look_ahead(belief.x_hat, applied, ahead.following, ahead.F, ahead.B)
        for i in range(belief.x_hat.shape[0]):
            belief.mean[i] = ahead.following[i]
        congruence(ahead.F, belief.P, ahead.slope, belief.covariance)

    return move


@cache
def make_predict(g: Kernel, g_jacobian: Kernel, move: Kernel) -> Kernel:
    """Return the step function that predicts the belief at the next step, with the control that was applied."""

    def predict(belief, applied, bounds, ahead):
        mean, covariance, x_hat, _ = belief
        largest, nominal, initial_mean, initial_covariance = bounds
        Q, reading, C = ahead.Q, ahead.reading, ahead.C
        n = x_hat.shape[0]
        move(belief, applied, ahead)
        for i in range(n):
            for j in range(n):
                covariance[i, j] = covariance[i, j] + Q[i, j]
        hold_variances(covariance, largest)
        # If the model has no finite value here, or all samples would be too distant to move the belief, no later sample could
        # correct the belief. It is reset to the initial one.
        g(mean, reading)
        g_jacobian(mean, C)
        good = absolute(mean[0]) <= MEAN_CAP
        for i in range(n):
            good = both(good, absolute(mean[i]) <= MEAN_CAP)
            for j in range(n):
                good = both(good, covariance[i, j] - covariance[i, j] == 0.0)
        for i in range(reading.shape[0]):
            distance = reading[i] / (0.1 * DISTANT)
            good = both(good, distance * distance < nominal[i, i])
            for j in range(n):
                good = both(good, C[i, j] - C[i, j] == 0.0)
        for i in range(n):
            mean[i] = select(good, mean[i], initial_mean[i])
            for j in range(n):
                covariance[i, j] = select(good, covariance[i, j], initial_covariance[i, j])

    return predict


def keep_filtered(determinate, point, spread_out, belief):
    """Carry p(x_t | y_1..t), on which goal and control prior have no effect (``belief="filtered"``)."""


def take_joint(determinate, point, spread_out, belief):
    """Carry the belief about x_t at the joint minimum, on which the goal has an effect (``belief="joint"``)."""
    n = belief.x_hat.shape[0]
    for i in range(n):
        belief.x_hat[i] = select(determinate, point[i], belief.x_hat[i])
        for j in range(n):
            belief.P[i, j] = select(determinate, spread_out[i, j], belief.P[i, j])


class Control(NamedTuple):
    """All arrays from which the control is inferred, besides the `Problem`."""

    goal_given: Floats
    goal_covariance: Floats
    prior_root: Floats
    limits: Limits
    X: Floats
    spread_out: Floats
    E: Floats
    goal_noise: Floats
    constant: Floats


class Nonlinear(NamedTuple):
    """All arrays of the estimator, besides the `Problem`."""

    reading: Reading
    sample: Sample
    trust: Trust
    belief: Belief
    applied: Floats
    learning: Learning
    screen: Screen
    bank: ObserverBank
    bounds: Bounds
    ahead: Ahead
    reach: Floats
    CP: Floats


RECORDS = {
    "est": named_alike(
        Nonlinear,
        reading=named_alike(Reading, expected="reading"),
        sample=SAMPLE,
        trust=named_alike(Trust),
        belief=named_alike(Belief),
        learning=named_alike(Learning),
        screen=named_alike(Screen),
        bank=OBSERVER_BANK,
        bounds=named_alike(Bounds),
        ahead=named_alike(Ahead, slope="FP"),
    ),
    "problem": named_alike(Problem, y="samples"),
    "search": named_alike(Search),
    "decision": named_alike(Control, goal_covariance="GQ", limits=named_alike(Limits)),
}
"""Names of these arrays among the controller's ports, state, parameters and scratch space."""


@cache
def _make_step(
    learning: tuple[Kernel, Kernel, Kernel],
    model: tuple[Kernel, Kernel],
    minimise: Kernel,
    carry: Kernel,
    predict: Kernel,
    write: Kernel,
    watch: Kernel,
    posterior: int,
    first: int,
) -> Callable[..., None]:
    """Return the controller's step function.

    ``learning`` has the functions that learn, report and alarm; ``model`` has the sensors' function and its derivatives. Among
    the outputs, those of the posterior begin at the index `posterior`, those of the learner at `first`.
    """
    (learn, report, alarm), (g, g_jacobian) = learning, model

    def nonlinear_bayesian_controller(u, outputs, est, problem, search, decision):
        sample, trust, belief, ahead = est.sample, est.trust, est.belief, est.ahead
        memory, settings, work = est.learning
        n, p, z = belief.x_hat.shape[0], u.shape[0], search.z
        T = search.squares[0]
        g(belief.mean, est.reading.expected)
        g_jacobian(belief.mean, ahead.C)
        innovate(est.reading, sample, belief, est.screen, ahead.C, est.CP, est.bounds.largest, est.reach)
        learn(sample, trust, memory, settings, work)
        restore(est.reading, sample)
        mark_absurd(est.screen, trust.fault_probability)
        report(memory, settings, sample.nominal, first, outputs)
        alarm(est.screen.doubts, outputs)
        leave_out_distant(sample.e, sample.nominal, trust.used)
        cholesky_semidefinite(belief.covariance, problem.root)

        for i in range(p):
            z[i] = est.applied[i]
        for i in range(n):
            z[p + i] = 0.0
        # The first pass finds the belief from prediction and sensors. The second pass starts there and finds control and state
        # from goal and control prior as well. It is one loop, because code that is written twice is compiled twice.
        for part in range(2):
            whole = 1.0 * part
            keep(trust.used, problem.goal, whole, problem.kept, decision.goal_given)
            factorise(trust.R, decision.goal_covariance, problem.kept, problem.noise)
            for i in range(p):
                for j in range(p):
                    problem.prior[i, j] = whole * decision.prior_root[i, j]
            minimise(problem, ahead, search)
            locate(z, belief.mean, problem.root, search.point)
            marginal(T, problem.root, p, decision.X, decision.spread_out)
            if part == 0:
                good = is_finite(decision.spread_out, search.cost[0])
                for i in range(n):
                    belief.x_hat[i] = search.point[i]
                    for j in range(n):
                        belief.P[i, j] = select(good, decision.spread_out[i, j], belief.covariance[i, j])
        determinate = determined(T, search.cost[0], decision.goal_given, p)
        for i in range(p):
            u[i] = select(determinate, z[i], NAN)
        write(determinate, posterior, outputs, T, trust.R, problem, search, decision)
        carry(determinate, search.point, decision.spread_out, belief)
        limit(u, est.applied, decision.limits)
        predict(belief, est.applied, est.bounds, ahead)
        watch(sample.y, est, search.point, decision.spread_out)

    return nonlinear_bayesian_controller


@dataclass(frozen=True, eq=False)
class NonlinearBayesianController(BayesianBlock):
    """Infers the state and the control that brings the next state to the goal, for a nonlinear model.

    At every sample the controller minimises the joint negative log-likelihood of the state x_t, the control u_t and the next
    state x_t+1 (paper, section 2.3). Its terms are prediction prior, sensors, process, goal prior and control prior. A fixed
    number of Gauss-Newton steps with Levenberg-Marquardt damping starts from the prediction and the last control. The covariance
    is that of the model linearised at the minimum (Laplace's approximation). For a linear model the result is that of
    `BayesianController`.

    Inputs and outputs are those of `BayesianController`; ``innovation`` is ``y - g(x_t|t-1)``. With ``posterior_outputs`` the
    covariances ``u_covariance, u_state_covariance`` are those of the model linearised at the minimum, and ``free_energy`` is
    the minimum of -L itself.

    Parameters
    ----------
    model : NonlinearModel or LinearModel
        Model of plant and sensors.
    precision : PrecisionLearner
        Learns the sensors' precisions; by default `SwitchingPrecision`, here always in its per-sensor form.
    goal_on : "states" or matrix
        What the goal is given for: all states, or ``G x`` for a matrix G with a column for each state.
    goal_covariance : number, vector or matrix
        Covariance of the goal prior.
    control_covariance : number, vector, matrix or None
        Covariance of the control prior; None is a flat prior.
    control_mean : number or vector
        Mean of the control prior.
    belief : {"filtered", "joint"}
        What is carried to the next step. "filtered": the minimum over prediction and sensors alone, p(x_t | y_1..t). "joint":
        the minimum of the full joint likelihood, into which the goal leaks.
    u_min, u_max : number or vector
        Limits of the control. The prediction uses the limited control.
    u_rate : number or vector
        Largest change of the control per second, also at the first step: see `initial_control`.
    initial_mean, initial_covariance : optional
        Belief before the first sample; by default 0 and the identity. The controller returns to it where the model has no
        finite value.
    initial_control : number or vector, optional
        The control before the first step; by default 0.
    prediction : {"model", "random walk"}
        The prediction prior of the next sample. "model": f at the belief and the control that was applied. "random walk": the
        belief itself plus process noise.
    iterations : int
        Number of steps of each of the two minimisations of a sample (belief, control). The time of a sample is proportional to
        it. The default suffices for strongly nonlinear problems (docs/explanation/controllers.md gives the shares that converge).
    invalid : sequence of number, or of one for each sensor
        Values that mark a missing sample, such as ``[-9999, 65535]``: a sample equal to one of them counts as missing.
    posterior_outputs : bool
        Whether the covariance of the control and the free energy are outputs as well.
    goal_names : sequence of str
        See `BayesianController`.

    Raises
    ------
    ModelError
        If dimensions do not fit, a covariance is not positive definite, the model is not finite at the initial mean, or a flat
        control prior leaves a control undetermined there.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> from bayesftc.cosim.ops import sin
    >>> def swing(x, u, x_next):
    ...     x_next[0] = x[0] + 0.05 * x[1]
    ...     x_next[1] = x[1] + 0.05 * (u[0] - 9.81 * sin(x[0]))
    >>> def angle_twice(x, y):
    ...     y[0] = x[0]
    ...     y[1] = x[0]
    >>> model = controllers.NonlinearModel(swing, angle_twice, 2, 1, 2, 1e-6, 1e-4, dt=0.05)
    >>> controller = controllers.NonlinearBayesianController(model, controllers.FixedPrecision(), goal_on=[[0.0, 1.0]])
    >>> step = controller.online(compiled=False)
    >>> for _ in range(3):
    ...     out = step(y=[0.5, 0.51], goal=[0.0])  # the control holds the pendulum at this angle
    >>> out.x_hat.round(2).tolist(), out.u.round(1).tolist()
    ([0.51, -0.0], [4.8])
    """

    model: NonlinearModel
    goal_on: Literal["states"] | Matrix = "states"
    prediction: Literal["model", "random walk"] = "model"
    iterations: int = 40

    def __post_init__(self) -> None:
        if isinstance(self.model, LinearModel):
            object.__setattr__(self, "model", NonlinearModel.from_linear(self.model))
        if not isinstance(self.model, NonlinearModel):
            raise ModelError(f"NonlinearBayesianController needs a NonlinearModel, not {self.model!r}.")
        check_choice(self, "prediction", "model", "random walk")
        check_number(self, "iterations", least=1, most=1000, whole=True)
        self._check_settings()
        self._check_reach(self._start().matrix("B"))
        self._learner()  # raises now, not in the loop, for settings that do not fit the model

    def _distinct_outputs(self) -> Floats:
        raise ModelError(
            "goal_on='outputs' is for linear models only; give the matrix G that maps the state to what has a goal."
        )

    def _start(self) -> LinearModel:
        # Learners need a linear model of the sensors. At the initial mean the linearisation was checked to be finite.
        return self.model.linearised(np.asarray(self.initial_mean), np.asarray(self.control_mean))

    @made_once
    def _learner(self) -> Learner:
        return self.precision.apart("NonlinearBayesianController").learner(self._start())

    @property
    def measurement_matrix(self) -> Floats:
        """Matrix that maps ``x_hat`` to what each sensor measures, without errors (m x n); NaN in rows of nonlinear sensors."""
        rows = linear_rows(self.model.g, self.model.sensors, self.model.states)
        plant = self.model.states - self.model.disturbances
        rows[:, plant:] = np.where(np.isfinite(rows[:, plant:]), 0.0, np.nan)
        return frozen(rows)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        model, learner = self.model, self._learner()
        n, p, m, g = model.states, model.controls, model.sensors, self.goals
        of_f, of_g = model.derivatives
        look_ahead, iterations = make_look_ahead(model.f, of_f), int(self.iterations)
        first = sum(port.size for port in self._common_outputs)
        move = make_move(look_ahead) if self.prediction == "model" else stay
        kernel = _make_step(
            (learner.step, learner.report, alarm_of(learner, first)),
            (model.g, of_g),
            make_minimiser(model.g, of_g, look_ahead, iterations),
            take_joint if self.belief == "joint" else keep_filtered,
            make_predict(model.g, of_g, move),
            write_linearised if self.posterior_outputs else write_nothing_more,
            make_watch(model.g, of_g, make_predict(model.g, of_g, make_move(look_ahead))),
            first - sum(port.size for port in self._posterior_ports),
            first,
        )
        prior, with_posterior = self._prior_precision(), self.posterior_outputs
        start = self._start()
        screens, screen_parameters = screening(self, start)
        check = extended_consistency(
            start, np.asarray(self.initial_mean, float), np.asarray(self.initial_covariance, float)
        )
        parameters = (
            self._shared_parameters(step)
            | screen_parameters
            | self._densities()
            | check.parameters
            | {
                "prior_root": np.linalg.cholesky(prior).T if prior.any() else prior,
                "control_mean": self.control_mean,
                "initial_mean": self.initial_mean,
                "initial_covariance": self.initial_covariance,
            }
        )
        unknowns, equations = p + n, m + g
        sizes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(("samples", "e", "present", "used", "reading"), (m,)),
            **dict.fromkeys(("root", "F", "FP", "X", "spread_out"), (n, n)),
            **dict.fromkeys(("C", "CP"), (m, n)),
            **dict.fromkeys(("reach", "cost", "cost2"), (1,)),
            **dict.fromkeys(("point", "following"), (n,)),
            **dict.fromkeys(("kept", "residual"), (equations,)),
            **{"spread": (m, m), "goal_given": (g,), "noise": (equations, equations), "control": (p,), "B": (n, p)},
            **{
                "prior": (p, p),
                "E": (p, p + n) if with_posterior else (1, 1),
                "z": (unknowns,),
                "work": (learner.work, m, m),
            },
            "slopes": (SLOPES, equations, unknowns),
            "squares": (SQUARES, unknowns, unknowns),
            "vectors": (VECTORS, unknowns),
            **check.scratch,
        }
        state = {
            "mean": self.initial_mean,
            "covariance": self.initial_covariance,
            "applied": self.control_before,
            "memory": learner.memory,
            **screens,
            **check.state,
        }
        scratch = {name: np.zeros(shape) for name, shape in sizes.items()}
        return Definition(kernel, state=state, parameters=parameters, scratch=scratch, records=RECORDS)
