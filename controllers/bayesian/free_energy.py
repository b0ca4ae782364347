"""The covariance of a Bayesian controller's control, and the free energy (paper, section 2.3).

Given the filtered belief N(x_hat, P) and with x_t integrated out, the goal measures u_t with the covariance
S = G (A P A' + Q) G' + Sigma_goal. With W = S^-1 G B and Lambda = Pi_u + (G B)' W the joint posterior of u_t and x_t has ::

    Cov(u_t) = Lambda^-1,    Cov(u_t, x_t) = -Lambda^-1 W' G A P.

The free energy is the minimum of -L of eq. 8 as a density, F = -ln p(x_t, u_t, x_t+1, y_t, goal). Each square has the factor one
half, and the logarithms of the covariances have a positive sign (the paper's equation prints neither). At the minimum over the
states, the squares are those of the innovation and of the goal's error, each weighted by the inverse of its covariance.
"""

import numpy as np

from bayesftc.controllers.bayesian.minimise import factorise
from bayesftc.controllers.estimation.filter import keep_only
from bayesftc.controllers.linalg.dense import cholesky, cholesky_semidefinite, solve_vector
from bayesftc.controllers.linalg.least_squares import divide
from bayesftc.controllers.linalg.special import LOG_2_PI
from bayesftc.controllers.precision.base import NAN
from bayesftc.cosim.ops import log, select
from bayesftc.cosim.types import Floats


def write_nothing(first, outputs, u, est, control):
    """Write no further outputs."""


def write_posterior(first, outputs, u, est, control):
    """Write Cov(u_t), Cov(u_t, x_t) and the free energy into ``outputs`` from the index `first` on.

    It uses the results of `decide`: ``GAP = G A P``, ``W``, the factors ``SG`` of S and of ``Lambda``, and ``goal_error``. It
    overwrites ``SG`` and scratch space. NaN where neither goal nor control prior determines the control.
    """
    target, GBw, goal_given, _, GAP, SG, goal_error, W, Lambda = control.decision
    u_0, goal_noise, constant = control.densities
    prior_precision, covariance, effective = control.aim.prior_precision, est.belief.covariance, est.actuators.effective
    e, spread, R, used = est.sample.e, est.sample.spread, est.trust.R, est.trust.used
    chol, whitened, J = est.space.L, est.space.whitened, est.space.J
    m, n, g, p = R.shape[0], GAP.shape[1], GBw.shape[0], GBw.shape[1]
    for c in range(p):
        for i in range(p):
            effective[i] = 1.0 if i == c else 0.0
        solve_vector(Lambda, effective)
        for i in range(p):
            outputs[first + i * p + c] = effective[i]
    for c in range(n):
        for i in range(p):
            total = 0.0 * u[i]
            for s in range(g):
                total = total - W[s, i] * GAP[s, c]
            effective[i] = total
        solve_vector(Lambda, effective)
        for i in range(p):
            outputs[first + p * p + i * n + c] = effective[i]

    doubled = constant[0]
    for i in range(m):
        whitened[i] = select(used[i] > 0.5, e[i], 0.0)
        for j in range(m):
            chol[i, j] = spread[i, j] + R[i, j]
    keep_only(used, chol)
    cholesky(chol, chol)
    doubled = doubled + squared_distance(chol, whitened)
    for i in range(m):
        for j in range(m):
            chol[i, j] = R[i, j]
    keep_only(used, chol)
    cholesky(chol, chol)
    doubled = doubled + log_determinant(chol, used)
    cholesky_semidefinite(covariance, J)
    doubled = doubled + log_pseudo_determinant(J)

    for i in range(g):
        error = goal_error[i]
        for j in range(p):
            error = error - GBw[i, j] * u[j]
        target[i] = select(goal_given[i] > 0.5, error, 0.0)
    doubled = doubled + squared_distance(SG, target)
    for i in range(p):
        for j in range(p):
            doubled = doubled + (u[i] - u_0[i]) * prior_precision[i, j] * (u[j] - u_0[j])
    for i in range(g):
        for j in range(g):
            SG[i, j] = goal_noise[i, j]
    keep_only(goal_given, SG)
    cholesky(SG, SG)
    outputs[first + p * p + p * n] = 0.5 * (doubled + log_determinant(SG, goal_given))


def squared_distance(lower, error):
    """Return ``error' (lower lower')^-1 error``; the error is overwritten."""
    total = 0.0 * error[0]
    for i in range(error.shape[0]):
        for k in range(i):
            error[i] = error[i] - lower[i, k] * error[k]
        error[i] = error[i] / lower[i, i]
        total = total + error[i] * error[i]
    return total


def log_determinant(lower, kept):
    """Return ``ln |2 pi lower lower'|`` over the elements that are kept."""
    total = 0.0 * kept[0]
    for i in range(lower.shape[0]):
        total = total + select(kept[i] > 0.5, LOG_2_PI + 2.0 * log(lower[i, i]), 0.0)
    return total


def log_pseudo_determinant(lower):
    """Return ``ln |2 pi lower lower'|`` over the nonzero pivots: a zero pivot has no density."""
    total = 0.0 * lower[0, 0]
    for i in range(lower.shape[0]):
        certain = lower[i, i] == 0.0
        total = total + select(certain, 0.0, LOG_2_PI + 2.0 * log(select(certain, 1.0, lower[i, i])))
    return total


def write_linearised(determinate, first, outputs, T, R, problem, search, decision):
    """Write these outputs for a nonlinear model, linearised at the minimum of the joint cost (Laplace's approximation).

    ``T`` is the triangle of the equations at the minimum, of u_t and of x_t in units of ``root``; ``X`` is a result of
    `marginal`; ``cost`` is the sum of squares. ``noise`` and ``E`` (controls x unknowns) are overwritten. NaN without a minimum.
    """
    root, kept, noise, cost = problem.root, problem.kept, problem.noise, search.cost
    X, E, goal_noise, constant = decision.X, decision.E, decision.goal_noise, decision.constant
    n, p = root.shape[0], E.shape[0]
    for i in range(p):
        for j in range(p + n):
            E[i, j] = 1.0 if i == j else 0.0
    divide(E, T, 0, E)
    for i in range(p):
        for j in range(p):
            total = 0.0
            for k in range(p + n):
                total = total + E[i, k] * E[j, k]
            outputs[first + i * p + j] = select(determinate, total, NAN)
        for j in range(n):
            total = 0.0
            for k in range(n):
                total = total + E[i, p + k] * X[j, k]
            outputs[first + p * p + i * n + j] = select(determinate, total, NAN)
    factorise(R, goal_noise, kept, noise)
    doubled = cost[0] + constant[0] + log_determinant(noise, kept) + log_pseudo_determinant(root)
    outputs[first + p * p + p * n] = select(determinate, 0.5 * doubled, NAN)


def write_nothing_more(determinate, first, outputs, T, R, problem, search, decision):
    """Write no further outputs."""


def log_normaliser(covariance: Floats) -> float:
    """Return ``ln |2 pi covariance|`` of the states that have a density.

    States that are certain, or linear functions of those before them, have none and are left out.
    """
    lower = np.zeros_like(covariance)
    cholesky_semidefinite(covariance, lower)
    return float(log_pseudo_determinant(lower))
