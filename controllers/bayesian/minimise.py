"""Step functions of the nonlinear Bayesian controller: the joint likelihood as equations, and its minimisation.

The unknowns are ``z = [u, v]``: the control, and the state in units of the prediction's spread, ``x = mean + root v`` with
``root root'`` its covariance, which may be singular. Sensors measure x_t, the goal measures x_t+1. The goal is linear in x_t+1.
Adding the process's covariance to the goal's, ``G Q G' + Sigma_goal``, therefore minimises over x_t+1 exactly.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from bayesftc.controllers.estimation.filter import keep_only, pivot_tolerance
from bayesftc.controllers.linalg.dense import cholesky, multiply, whiten
from bayesftc.controllers.linalg.least_squares import (
    Curvature,
    absorb,
    curve,
    damp,
    is_finite,
    solve_curved,
    squared_length,
)
from bayesftc.cosim.ops import both, maximum, negate, select
from bayesftc.cosim.types import Floats

ROUNDING = 1e-12
"""Relative increase of the cost that counts as rounding; at the minimum a right step may have such an increase."""

FIRST_DAMPING = 3e-2
"""Damping after the first step that fails. Each failure multiplies it by 10, each success by 1/10."""

LEAST_DAMPING = 1e-3
"""A damping of at most this becomes 0 at the next success."""

INFINITE = float("inf")

DISTANT = 1e100
"""A sample at least this many nominal standard deviations away is left out, since its square would overflow."""


SLOPES, SQUARES, VECTORS = 2, 5, 8
"""Numbers of the minimiser's scratch arrays: equations x unknowns, unknowns x unknowns, unknowns."""


class Ahead(NamedTuple):
    """A nonlinear model at a state: sensor readings, next state, and their derivatives C, F (by the state) and B.

    ``Q`` is the covariance of the process, ``slope`` scratch space.
    """

    Q: Floats
    reading: Floats
    following: Floats
    C: Floats
    F: Floats
    B: Floats
    slope: Floats


class Problem(NamedTuple):
    """The terms of the joint cost.

    Samples ``y`` and ``goal``, with ``kept`` 1 for those in use, else 0; the prediction's ``mean`` and the ``root`` of its
    covariance; the Cholesky factor of the ``noise`` of sensors and goal; the goal's matrix ``G``; the control ``prior``'s root
    of the precision and its mean.
    """

    y: Floats
    goal: Floats
    kept: Floats
    mean: Floats
    root: Floats
    noise: Floats
    G: Floats
    prior: Floats
    control_mean: Floats


class Search(NamedTuple):
    """The minimiser's current ``z`` (control, and state in units of the prediction's root) and ``cost``; else scratch space."""

    z: Floats
    point: Floats
    control: Floats
    residual: Floats
    slopes: Floats
    squares: Floats
    vectors: Floats
    cost: Floats
    cost2: Floats


def leave_out_distant(e, nominal, used):
    """Leave out sensors whose innovation is so large that its square would overflow."""
    for i in range(e.shape[0]):
        distance = e[i] / DISTANT
        used[i] = select(distance * distance < nominal[i, i], used[i], 0.0)


def locate(z, mean, root, x):
    """Write the state at z: ``x = mean + root v`` for a lower triangular root."""
    p = z.shape[0] - mean.shape[0]
    for i in range(mean.shape[0]):
        total = mean[i]
        for k in range(i + 1):
            total = total + root[i, k] * z[p + k]
        x[i] = total


def keep(used, goal, with_goal, kept, goal_given):
    """Mark the equations in use: those of the sensors in use and, if ``with_goal``, of the goals that are given."""
    m = used.shape[0]
    for i in range(m):
        kept[i] = used[i]
    for i in range(goal.shape[0]):
        goal_given[i] = select(goal[i] - goal[i] == 0.0, 1.0, 0.0)
        kept[m + i] = goal_given[i] * with_goal


def factorise(R, goal_noise, kept, noise):
    """Write the Cholesky factor of the joint covariance of the sensors and goals that are kept."""
    m, g = R.shape[0], goal_noise.shape[0]
    for i in range(m + g):
        for j in range(m + g):
            noise[i, j] = 0.0
    for i in range(m):
        for j in range(m):
            noise[i, j] = R[i, j]
    for i in range(g):
        for j in range(g):
            noise[m + i, m + j] = goal_noise[i, j]
    keep_only(kept, noise)
    cholesky(noise, noise)


def determined(T, cost, goal_given, controls):
    """Return whether goal and prior determine each control and all numbers are finite."""
    good = is_finite(T, cost)
    for j in range(controls):
        good = both(good, T[j, j] * T[j, j] > pivot_tolerance(goal_given) * squared_length(T, j))
    return good


@cache
def make_look_ahead(f: Callable[..., None], f_jacobian: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that writes the next state and its derivatives."""

    def look_ahead(x, control, following, F, B):
        f(x, control, following)
        f_jacobian(x, control, F, B)

    return look_ahead


@cache
def make_minimiser(
    g: Callable[..., None], g_jacobian: Callable[..., None], look_ahead: Callable[..., None], iterations: int
) -> Callable[..., None]:
    """Return the step function that minimises the joint cost from ``z``, by Gauss-Newton steps with Marquardt's damping.

    Where residuals stay large, Gauss-Newton converges slowly, because it leaves out their curvature; the curvature is therefore
    estimated from step to step.

    On return ``z`` has the minimum and ``squares[0]`` the triangle of the equations linearised there. The cost is twice the
    negative log-likelihood, up to a constant. There are `iterations` trial steps. A step is rejected if it would raise the cost
    or lead to a value that is not finite; the next one is then damped more.
    """

    def equations(problem, ahead, trial, point, control, J, residual, row, T, b, cost):
        y, goal, kept, mean, root, noise, G, prior_root, control_mean = problem
        _, reading, following, C, F, B, slope = ahead
        m, n, p = y.shape[0], mean.shape[0], control.shape[0]
        locate(trial, mean, root, point)
        for i in range(p):
            control[i] = trial[i]
        g(point, reading)
        g_jacobian(point, C)
        look_ahead(point, control, following, F, B)
        multiply(F, root, slope)
        for i in range(m):
            residual[i] = select(kept[i] > 0.5, y[i] - reading[i], 0.0)
            for j in range(p + n):
                J[i, j] = 0.0
            for j in range(n):
                total = 0.0
                for k in range(j, n):
                    total = total + C[i, k] * root[k, j]
                J[i, p + j] = select(kept[i] > 0.5, total, 0.0)
        for i in range(goal.shape[0]):
            in_use = kept[m + i] > 0.5
            error = goal[i]
            for k in range(n):
                error = error - G[i, k] * following[k]
            residual[m + i] = select(in_use, error, 0.0)
            for j in range(p + n):
                total = 0.0
                for k in range(n):
                    total = total + G[i, k] * (B[k, j] if j < p else slope[k, j - p])
                J[m + i, j] = select(in_use, total, 0.0)
        whiten(noise, J, residual)
        cost[0] = 0.0
        for i in range(p + n):
            for j in range(p + n):
                T[i, j] = 1.0 if i == j else 0.0
            b[i] = -trial[i]
        for i in range(p):
            b[i] = 0.0
            for j in range(p):
                T[i, j] = prior_root[i, j]
                b[i] = b[i] + prior_root[i, j] * (control_mean[j] - trial[j])
        for i in range(p + n):
            cost[0] = cost[0] + b[i] * b[i]
        for i in range(residual.shape[0]):
            cost[0] = cost[0] + residual[i] * residual[i]
            for j in range(p + n):
                row[j] = J[i, j]
            absorb(T, b, row, residual[i])

    def minimise(problem, ahead, search):
        z, point, control, residual, slopes, squares, vectors, cost, cost2 = search
        J, J2 = slopes[0], slopes[1]
        T, T2, D, S, M = squares[0], squares[1], squares[2], squares[3], squares[4]
        b, b2, d, trial, row = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
        curvature = Curvature(S, M, vectors[5], vectors[6], vectors[7])
        n = z.shape[0]
        cost[0] = INFINITE  # the start is the first point that is tried
        damping = 0.0
        for i in range(n):
            trial[i] = z[i]
            for j in range(n):
                T[i, j] = 0.0
                S[i, j] = 0.0
        for _ in range(iterations + 1):
            equations(problem, ahead, trial, point, control, J2, residual, row, T2, b2, cost2)
            better = both(is_finite(T2, cost2[0]), negate(cost2[0] > cost[0] * (1.0 + ROUNDING)))
            started = cost[0] < INFINITE
            flat = ROUNDING * ROUNDING * cost[0]
            curve(both(better, started), z, trial, T2, J, J2, residual, flat, curvature)
            for i in range(n):
                z[i] = select(better, trial[i], z[i])
                b[i] = select(better, b2[i], b[i])
                for j in range(n):
                    T[i, j] = select(better, T2[i, j], T[i, j])
            for i in range(residual.shape[0]):
                for j in range(n):
                    J[i, j] = select(better, J2[i, j], J[i, j])
            cost[0] = select(better, cost2[0], cost[0])
            eased = select(damping > LEAST_DAMPING, 0.1 * damping, 0.0)
            damping = select(better, eased, maximum(10.0 * damping, FIRST_DAMPING))
            damp(T, b, damping, D, d, row)
            solve_curved(D, d, S, M, trial)
            for i in range(n):
                trial[i] = z[i] + trial[i]

    return minimise
