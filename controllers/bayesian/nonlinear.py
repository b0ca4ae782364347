"""The Bayesian controller for nonlinear models: filtering and control as one minimisation (paper, section 2.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.block import BayesianBlock
from bayesftc.controllers.bayesian.extended_check import (
    EXTENDED_SEERS,
    SQUARES as SQUARES_OF_CHECK,
    VECTORS as VECTORS_OF_CHECK,
    ExtendedSeers,
    extended_consistency,
    make_watch,
)
from bayesftc.controllers.bayesian.free_energy import tell_linearised, tell_no_minimum
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
from bayesftc.controllers.estimation.absurd import Reading, Screen, alarm_of, blame, screening
from bayesftc.controllers.estimation.belief import SAMPLE, Learning
from bayesftc.controllers.estimation.filter import MEAN_CAP, Belief, Limits, hold_variances, innovate, limit, restore
from bayesftc.controllers.linalg.dense import cholesky_semidefinite, congruence
from bayesftc.controllers.linalg.least_squares import is_finite, marginal
from bayesftc.controllers.models.checks import Matrix, check_choice, check_number, frozen
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.linear_rows import linear_rows
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.controllers.precision.base import NAN, Learner, Sample, Trust
from bayesftc.cosim.block import Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, both, select
from bayesftc.cosim.stepping.records import named_alike
from bayesftc.cosim.types import Floats, Kernel


class Bounds(NamedTuple):
    """The largest variance of a belief, the sensors' nominal covariance, and the belief with which all begins."""

    largest: Floats
    nominal: Floats
    initial_mean: Floats
    initial_covariance: Floats


def stay(belief, applied, ahead):
    """Predict that the state stays where it is (a random walk)."""
    mean, covariance, x_hat, P = belief
    n = x_hat.shape[0]
    for i in range(n):
        mean[i] = x_hat[i]
        for j in range(n):
            covariance[i, j] = P[i, j]


@cache
def make_move(look_ahead: Kernel) -> Kernel:
    """Return the step function that predicts by the model, its uncertainty by the model linearised at the estimate."""

    def move(belief, applied, ahead):
        look_ahead(belief.x_hat, applied, ahead.following, ahead.F, ahead.B)
        for i in range(belief.x_hat.shape[0]):
            belief.mean[i] = ahead.following[i]
        congruence(ahead.F, belief.P, ahead.slope, belief.covariance)

    return move


@cache
def make_predict(g: Kernel, g_jacobian: Kernel, move: Kernel) -> Kernel:
    """Return the step function that takes the belief to the next step, with the control that was applied."""

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
        # Where the model has no finite value, or all samples would be too far away to move the belief, nothing could be learned
        # from any sample again: the belief begins anew.
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


def keep_filtered(found, point, spread_out, belief):
    """Carry p(x_t | y_1..t): goal and control prior leave the belief alone (``belief="filtered"``)."""


def take_joint(found, point, spread_out, belief):
    """Carry the belief about x_t of the joint minimum, into which the goal leaks (``belief="joint"``)."""
    n = belief.x_hat.shape[0]
    for i in range(n):
        belief.x_hat[i] = select(found, point[i], belief.x_hat[i])
        for j in range(n):
            belief.P[i, j] = select(found, spread_out[i, j], belief.P[i, j])


class Control(NamedTuple):
    """All that the control is inferred with, besides the `Problem`."""

    wanted: Floats
    goal_covariance: Floats
    prior_root: Floats
    limits: Limits
    X: Floats
    spread_out: Floats
    E: Floats
    goal_noise: Floats
    constant: Floats


class Nonlinear(NamedTuple):
    """All that the estimator works with, besides the `Problem`."""

    reading: Reading
    sample: Sample
    trust: Trust
    belief: Belief
    applied: Floats
    learning: Learning
    screen: Screen
    seers: ExtendedSeers
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
        seers=EXTENDED_SEERS,
        bounds=named_alike(Bounds),
        ahead=named_alike(Ahead, slope="FP"),
    ),
    "problem": named_alike(Problem, y="heard"),
    "search": named_alike(Search),
    "decision": named_alike(Control, goal_covariance="GQ", limits=named_alike(Limits)),
}
"""What all these arrays are called among the ports, state, parameters and scratch space of the controller."""


@cache
def _make_step(
    learning: tuple[Kernel, Kernel, Kernel],
    model: tuple[Kernel, Kernel],
    minimise: Kernel,
    carry: Kernel,
    predict: Kernel,
    tell: Kernel,
    watch: Kernel,
    posterior: int,
    first: int,
) -> Callable[..., None]:
    """Return the controller's step function.

    ``learning`` learns, reports and alarms, ``model`` is what the sensors read, and its derivatives. Among all outputs those of
    the posterior begin at the place `posterior`, the learner's own at the place `first`.
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
        blame(est.screen, trust.fault_probability)
        report(memory, settings, sample.nominal, first, outputs)
        alarm(est.screen.doubts, outputs)
        leave_out_distant(sample.e, sample.nominal, trust.used)
        cholesky_semidefinite(belief.covariance, problem.root)

        for i in range(p):
            z[i] = est.applied[i]
        for i in range(n):
            z[p + i] = 0.0
        # First the belief, by the prediction and the sensors alone; from there the control, together with the state, by goal and
        # control prior as well. A loop, for whatever is written twice is compiled twice.
        for part in range(2):
            whole = 1.0 * part
            keep(trust.used, problem.goal, whole, problem.kept, decision.wanted)
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
        found = determined(T, search.cost[0], decision.wanted, p)
        for i in range(p):
            u[i] = select(found, z[i], NAN)
        tell(found, posterior, outputs, T, trust.R, problem, search, decision)
        carry(found, search.point, decision.spread_out, belief)
        limit(u, est.applied, decision.limits)
        predict(belief, est.applied, est.bounds, ahead)
        watch(sample.y, est, search.point, decision.spread_out)

    return nonlinear_bayesian_controller


@dataclass(frozen=True, eq=False)
class NonlinearBayesianController(BayesianBlock):
    """Infers the state and the control that brings the next state to the goal, for a nonlinear model.

    At every sample the joint negative log-likelihood of the state x_t, the control u_t and the next state x_t+1 (paper, section
    2.3) is minimised: prediction prior, sensors, process, goal prior, control prior. Gauss-Newton steps with
    Levenberg-Marquardt damping start from the prediction and the last control; their number is fixed. The covariance is that of
    the model linearised at the minimum (Laplace's approximation). For a linear model all this is `BayesianController`.

    Inputs and outputs are those of `BayesianController`: ``y``, ``goal``; ``u, x_hat, P, R, innovation, precision, beta,
    fault_probability, model_suspect``, and those of the precision learner. ``innovation`` is ``y - g(x_t|t-1)``. With
    ``posterior_outputs`` also ``u_covariance, u_state_covariance, free_energy``, of the model linearised at the minimum, and the
    least value of -L itself.

    Parameters
    ----------
    model : NonlinearModel or LinearModel
        What the controller believes about plant and sensors.
    precision : PrecisionLearner
        How far each sensor is trusted; by default `SwitchingPrecision`, here always in its per-sensor form.
    goal_on : "states" or matrix
        What the goal is given for: all states, or ``G x`` for a matrix G with a column for each state.
    goal_covariance : number, vector or matrix
        Covariance of the goal prior.
    control_covariance : number, vector, matrix or None
        Covariance of the control prior; None is a flat one.
    control_mean : number or vector
        Mean of the control prior.
    belief : {"filtered", "joint"}
        Carry the minimum of prediction and sensors alone, p(x_t | y_1..t); or that of the full joint, into which the goal leaks.
    u_min, u_max : number or vector
        Limits of the control; the prediction uses the control that was applied.
    u_rate : number or vector
        Largest change of the control per second; the first step is measured from 0.
    initial_mean, initial_covariance : optional
        Belief before the first sample, by default 0 and the identity; also once it is lost where the model has no finite value.
    prediction : {"model", "random walk"}
        The prediction prior of the next sample: by f and the control that was applied; or the belief itself plus process noise.
    iterations : int
        Number of steps of each of the two minimisations a sample (belief, control). A sample's cost in time is proportional to
        it; with the default strongly nonlinear problems converge, too (docs/controllers.md has the shares).
    invalid : sequence of number, or of one for each sensor
        Values that devices send in place of a sample, as ``[-9999, 65535]``: a sample equal to one of them counts as missing.
    posterior_outputs : bool
        Whether the covariance of the control and the free energy are outputs as well.

    Raises
    ------
    ModelError
        If dimensions do not fit, a covariance is not positive definite, the model is not finite at the initial mean, or a flat
        control prior leaves a control undetermined there.
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
        self._learner()  # settings that do not fit the model fail here, not in the loop

    def _distinct_outputs(self) -> Floats:
        raise ModelError("goal_on='outputs' is for linear models; give the matrix G of what the goal is of the state.")

    def _start(self) -> LinearModel:
        # Learners know the sensors by a linear model: the one at the initial mean, where it is known to be finite.
        return self.model.linearised(np.asarray(self.initial_mean), np.asarray(self.control_mean))

    def _learner(self) -> Learner:
        return self.precision.apart("NonlinearBayesianController").learner(self._start())

    @property
    def measurement_matrix(self) -> Floats:
        """What each sensor measures of ``x_hat``, its own errors left out (m x n); a row of NaN: no linear function."""
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
        first = sum(port.size for port in self._own_outputs)
        move = make_move(look_ahead) if self.prediction == "model" else stay
        kernel = _make_step(
            (learner.step, learner.report, alarm_of(learner, first)),
            (model.g, of_g),
            make_minimiser(model.g, of_g, look_ahead, iterations),
            take_joint if self.belief == "joint" else keep_filtered,
            make_predict(model.g, of_g, move),
            tell_linearised if self.posterior_outputs else tell_no_minimum,
            make_watch(model.g, of_g, make_predict(model.g, of_g, make_move(look_ahead))),
            first - sum(port.size for port in self._posterior_ports),
            first,
        )
        prior, told = self._prior_precision(), self.posterior_outputs
        start = self._start()
        screens, screen_parameters = screening(self, start)
        watching, constants = extended_consistency(
            start, np.asarray(self.initial_mean, float), np.asarray(self.initial_covariance, float)
        )
        parameters = self._shared_parameters(step) | screen_parameters | self._densities() | constants | {
            "prior_root": np.linalg.cholesky(prior).T if prior.any() else prior,
            "control_mean": self.control_mean, "initial_mean": self.initial_mean, "initial_covariance": self.initial_covariance,
        }  # fmt: skip
        unknowns, equations = p + n, m + g
        sizes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(("heard", "e", "present", "used", "reading", "seer_error"), (m,)),
            **dict.fromkeys(("root", "F", "FP", "X", "spread_out"), (n, n)),
            **dict.fromkeys(("C", "CP"), (m, n)),
            **dict.fromkeys(("reach", "cost", "cost2"), (1,)),
            **dict.fromkeys(("point", "following"), (n,)),
            **dict.fromkeys(("kept", "residual"), (equations,)),
            **{"spread": (m, m), "wanted": (g,), "noise": (equations, equations), "control": (p,), "B": (n, p)},
            **{"prior": (p, p), "E": (p, p + n) if told else (1, 1), "z": (unknowns,), "work": (learner.work, m, m)},
            "slopes": (SLOPES, equations, unknowns),
            "squares": (SQUARES, unknowns, unknowns),
            "vectors": (VECTORS, unknowns),
            "seer_squares": (SQUARES_OF_CHECK, n, n),
            "seer_vectors": (VECTORS_OF_CHECK, max(n, m)),
        }
        state = {
            "mean": self.initial_mean, "covariance": self.initial_covariance, "applied": np.zeros(p), "memory": learner.memory,
            **screens, **watching,
        }  # fmt: skip
        scratch = {name: np.zeros(shape) for name, shape in sizes.items()}
        return Definition(kernel, state=state, parameters=parameters, scratch=scratch, records=RECORDS)
