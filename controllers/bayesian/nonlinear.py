"""The Bayesian controller for nonlinear models: filtering and control as one minimisation (paper, section 2.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Literal

import numpy as np

from bayesftc.controllers.bayesian.block import BayesianBlock
from bayesftc.controllers.bayesian.extended_check import extended_consistency, make_watch
from bayesftc.controllers.bayesian.free_energy import tell_linearised, tell_no_minimum
from bayesftc.controllers.bayesian.minimise import (
    DISTANT,
    SLOPES,
    SQUARES,
    VECTORS,
    determined,
    factorise,
    keep,
    leave_out_distant,
    locate,
    make_look_ahead,
    make_minimiser,
)
from bayesftc.controllers.estimation.absurd import alarm_of, blame, screening
from bayesftc.controllers.estimation.filter import MEAN_CAP, hold_variances, innovate, limit, restore
from bayesftc.controllers.linalg.dense import cholesky_semidefinite, congruence
from bayesftc.controllers.linalg.least_squares import is_finite, marginal
from bayesftc.controllers.models.checks import Matrix, check_choice, check_number, frozen
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.linear_rows import linear_rows
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.controllers.precision.base import NAN, Learner
from bayesftc.cosim.block import Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, both, select
from bayesftc.cosim.types import Floats, Kernel


def stay(x_hat, P, applied, following, F, B, FP, mean, covariance):
    """Predict that the state stays where it is (a random walk)."""
    n = x_hat.shape[0]
    for i in range(n):
        mean[i] = x_hat[i]
        for j in range(n):
            covariance[i, j] = P[i, j]


@cache
def make_move(look_ahead: Kernel) -> Kernel:
    """Return the step function that predicts by the model, its uncertainty by the model linearised at the estimate."""

    def move(x_hat, P, applied, following, F, B, FP, mean, covariance):
        look_ahead(x_hat, applied, following, F, B)
        for i in range(x_hat.shape[0]):
            mean[i] = following[i]
        congruence(F, P, FP, covariance)

    return move


@cache
def make_predict(g: Kernel, g_jacobian: Kernel, move: Kernel) -> Kernel:
    """Return the step function that takes the belief to the next step, with the control that was applied."""

    def predict(
        x_hat, P, applied, Q, nominal, largest, initial_mean, initial_covariance,
        following, F, B, FP, reading, C, mean, covariance,
    ):  # fmt: skip
        n = x_hat.shape[0]
        move(x_hat, P, applied, following, F, B, FP, mean, covariance)
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


def keep_filtered(found, point, spread_out, x_hat, P):
    """Carry p(x_t | y_1..t): goal and control prior leave the belief alone (``belief="filtered"``)."""


def take_joint(found, point, spread_out, x_hat, P):
    """Carry the belief about x_t of the joint minimum, into which the goal leaks (``belief="joint"``)."""
    n = x_hat.shape[0]
    for i in range(n):
        x_hat[i] = select(found, point[i], x_hat[i])
        for j in range(n):
            P[i, j] = select(found, spread_out[i, j], P[i, j])


@cache
def _make_step(
    learn: Kernel, report: Kernel, alarm: Kernel, g: Kernel, g_jacobian: Kernel, minimise: Kernel, carry: Kernel, predict: Kernel,
    tell: Kernel, watch: Kernel, posterior: int, first: int,
) -> Callable[..., None]:  # fmt: skip
    """Return the controller's step function.

    Among all outputs those of the posterior begin at the place `posterior`, the learner's own at the place `first`.
    """

    def nonlinear_bayesian_controller(
        y, goal, u, x_hat, P, R, innovation, precision, beta, fault_probability, model_suspect, outputs, work,
        mean, covariance, applied, memory,
        Q, nominal, G, GQ, prior_root, control_mean, settings, u_min, u_max, u_change, largest, initial_mean, initial_covariance,
        reading, C, e, present, used, CP, spread, root, kept, wanted, noise, prior,
        z, point, control, following, F, B, FP, residual, slopes, squares, vectors, cost, cost2, X, spread_out,
        heard, doubts, widening, reach, plant, invalid, witnesses, patience, certain,
        goal_noise, constant, E,
        seer_new, seer_mean, seer_covariance, seer_sees, seer_noise, seer_error, seer_white, seer_moments, seer_settings,
        seer_squares, seer_vectors,
    ):  # fmt: skip
        n, p = x_hat.shape[0], u.shape[0]
        T = squares[0]
        g(mean, reading)
        g_jacobian(mean, C)
        innovate(
            y, reading, covariance, C, nominal, plant, invalid, witnesses, patience, largest, doubts, widening, reach,
            heard, e, present, CP, spread, innovation,
        )  # fmt: skip
        learn(heard, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability)
        restore(heard, reading, present, e)
        blame(doubts, certain, fault_probability)
        report(memory, settings, nominal, first, outputs)
        alarm(doubts, outputs)
        leave_out_distant(e, nominal, used)
        cholesky_semidefinite(covariance, root)

        for i in range(p):
            z[i] = applied[i]
        for i in range(n):
            z[p + i] = 0.0
        # First the belief, by the prediction and the sensors alone; from there the control, together with the state, by goal and
        # control prior as well. A loop, for whatever is written twice is compiled twice.
        for part in range(2):
            whole = 1.0 * part
            keep(used, goal, whole, kept, wanted)
            factorise(R, GQ, kept, noise)
            for i in range(p):
                for j in range(p):
                    prior[i, j] = whole * prior_root[i, j]
            minimise(
                z, heard, goal, kept, mean, root, noise, G, prior, control_mean,
                point, control, reading, following, C, F, B, FP, residual, slopes, squares, vectors, cost, cost2,
            )  # fmt: skip
            locate(z, mean, root, point)
            marginal(T, root, p, X, spread_out)
            if part == 0:
                good = is_finite(spread_out, cost[0])
                for i in range(n):
                    x_hat[i] = point[i]
                    for j in range(n):
                        P[i, j] = select(good, spread_out[i, j], covariance[i, j])
        found = determined(T, cost[0], wanted, p)
        for i in range(p):
            u[i] = select(found, z[i], NAN)
        tell(found, posterior, outputs, T, root, X, cost, R, goal_noise, kept, constant, noise, E)
        carry(found, point, spread_out, x_hat, P)
        limit(u, applied, u_min, u_max, u_change)
        predict(
            x_hat, P, applied, Q, nominal, largest, initial_mean, initial_covariance,
            following, F, B, FP, reading, C, mean, covariance,
        )  # fmt: skip
        watch(
            heard, x_hat, P, applied, nominal, largest, initial_mean, initial_covariance,
            reading, C, seer_error, CP, spread, point, spread_out, following, F, B, FP,
            seer_new, seer_mean, seer_covariance, seer_sees, seer_noise, seer_white, seer_moments, seer_settings,
            seer_squares, seer_vectors, model_suspect,
        )  # fmt: skip

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
            learner.step,
            learner.report,
            alarm_of(learner, first),
            model.g,
            of_g,
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
        scratch = {
            "reading": (m,), "C": (m, n), "e": (m,), "present": (m,), "used": (m,), "CP": (m, n), "spread": (m, m),
            "root": (n, n), "kept": (equations,), "wanted": (g,), "noise": (equations, equations), "point": (n,), "control": (p,),
            "following": (n,), "F": (n, n), "B": (n, p), "FP": (n, n), "residual": (equations,), "cost": (1,), "cost2": (1,),
            "X": (n, n), "spread_out": (n, n), "prior": (p, p), "E": (p, p + n) if told else (1, 1),
            "z": (unknowns,), "slopes": (SLOPES, equations, unknowns), "squares": (SQUARES, unknowns, unknowns),
            "vectors": (VECTORS, unknowns),
        }  # fmt: skip
        state = {
            "mean": self.initial_mean, "covariance": self.initial_covariance, "applied": np.zeros(p), "memory": learner.memory,
            "work": np.zeros((learner.work, m, m)), **{name: np.zeros(shape) for name, shape in scratch.items()},
            **screens, **watching,
        }  # fmt: skip
        return Definition(kernel, state=state, parameters=parameters)


__all__ = ["NonlinearBayesianController"]
