"""Step functions of the Bayesian controller's three stages: measurement update, control, prediction."""

from typing import NamedTuple

from bayesftc.controllers.estimation.absurd import count_doubts, screen_samples, widen
from bayesftc.controllers.linalg.dense import (
    add_product,
    apply,
    cholesky,
    cholesky_determined,
    cholesky_semidefinite,
    congruence,
    multiply,
    multiply_transposed,
    solve_columns,
    solve_vector,
    whiten,
)
from bayesftc.controllers.precision.base import NAN
from bayesftc.cosim.ops import both, maximum, minimum, select
from bayesftc.cosim.types import Floats

MEAN_CAP = 1e150
"""Largest magnitude of a predicted state; its square is still a double."""


class Belief(NamedTuple):
    """Mean and covariance of n states before the samples, and after them."""

    mean: Floats
    covariance: Floats
    x_hat: Floats
    P: Floats


class ModelMatrices(NamedTuple):
    """The matrices of a linear model, x_t+1 = A x_t + B u_t + q and y_t = C x_t + r, and the covariance Q of q."""

    A: Floats
    B: Floats
    C: Floats
    Q: Floats


class UpdateSpace(NamedTuple):
    """Scratch space of `measure`."""

    L: Floats
    D: Floats
    whitened: Floats
    v: Floats
    gain: Floats
    J: Floats
    JP: Floats


class Aim(NamedTuple):
    """Goal prior (on ``G x_t+1``) and control prior.

    ``GB`` is G B, ``GQ`` is G Q G' plus the goal's covariance. ``prior_precision`` is the control prior's precision,
    ``prior_pull`` its product with the prior mean (zeros for a flat prior), ``shift`` is G B times that mean.
    """

    G: Floats
    GB: Floats
    GQ: Floats
    prior_precision: Floats
    prior_pull: Floats
    shift: Floats


class Decision(NamedTuple):
    """The ``target`` of the next state, G B times the actuators' effectiveness, and results of `decide`."""

    target: Floats
    GB: Floats
    goal_given: Floats
    GA: Floats
    GAP: Floats
    SG: Floats
    goal_error: Floats
    W: Floats
    Lambda: Floats


class Limits(NamedTuple):
    """Least and largest control, and its largest change in a step."""

    u_min: Floats
    u_max: Floats
    u_change: Floats


class FoldingSpace(NamedTuple):
    """Scratch space of `fold_goal`."""

    N: Floats
    V: Floats
    Wt: Floats
    L: Floats
    GL: Floats
    VGL: Floats
    M: Floats
    X: Floats
    h: Floats


def innovate(reading, sample, belief, screen, C, CP, largest, reach):
    """Compute the innovation ``e = y - expected``, which samples are present, and the covariance ``spread = C P C'``.

    Samples that are not finite, ``invalid`` or absurd (``absurd.py``) count as missing and become NaN in ``sample.y``. For them
    ``e`` is 0, and the reported ``innovation`` is NaN. A lost belief is widened first. Then ``reach``, else the ``largest``
    variance of a hypothesis, is negative: all hypotheses restart. ``e`` is 0 for all sensors until `restore`, because the belief
    was wrong and the learner must not attribute the error to the sensors.
    """
    widen(belief.covariance, screen)
    reach[0] = select(screen.widening[0] > 1.0, -1.0, largest[0])
    multiply(C, belief.covariance, CP)
    multiply_transposed(CP, C, sample.spread)
    screen_samples(reading, sample, screen)
    count_doubts(reading, sample, screen)
    for i in range(reading.y.shape[0]):
        d = sample.y[i] - reading.expected[i]
        finite = d - d == 0.0
        sample.present[i] = select(finite, 1.0, 0.0)
        sample.e[i] = select(both(finite, reach[0] > 0.0), d, 0.0)
        reading.innovation[i] = select(finite, d, NAN)


def restore(reading, sample):
    """Write the actual innovations after the learner's step."""
    for i in range(sample.e.shape[0]):
        sample.e[i] = select(sample.present[i] > 0.5, sample.y[i] - reading.expected[i], 0.0)


def keep_only(kept, R):
    """Keep the covariance of the elements that are ``kept`` (1 or 0); the others become independent with variance 1."""
    for i in range(R.shape[0]):
        for j in range(R.shape[0]):
            alone = 1.0 if i == j else 0.0
            R[i, j] = select(both(kept[i] > 0.5, kept[j] > 0.5), R[i, j], alone)


def measure(e, used, R, C, belief, space):
    """Condition the belief on the sensors in use, one after the other, each by Kalman's update in Joseph's form.

    First the sensors' noise is whitened by the Cholesky factor of its covariance, without rows and columns of unused sensors.
    Updates one by one invert no matrix, which could become singular if the belief is far less certain than the sensors.
    """
    mean, covariance, x_hat, P = belief
    L, D, whitened, v, gain, J, JP = space
    m, n = C.shape[0], C.shape[1]
    for i in range(m):
        for j in range(m):
            L[i, j] = R[i, j]
        whitened[i] = select(used[i] > 0.5, e[i], 0.0)
        for j in range(n):
            D[i, j] = select(used[i] > 0.5, C[i, j], 0.0)
    keep_only(used, L)
    cholesky(L, L)
    whiten(L, D, whitened)
    for i in range(n):
        x_hat[i] = mean[i]
        for j in range(n):
            P[i, j] = covariance[i, j]
    for s in range(m):
        S = 1.0 + 0.0 * whitened[s]
        error = whitened[s]
        for i in range(n):
            total = P[i, 0] * D[s, 0]
            for j in range(1, n):
                total = total + P[i, j] * D[s, j]
            v[i] = total
            S = S + D[s, i] * total
            error = error - D[s, i] * (x_hat[i] - mean[i])
        for i in range(n):
            gain[i] = v[i] / S
            x_hat[i] = x_hat[i] + gain[i] * error
        for i in range(n):
            for j in range(n):
                J[i, j] = (1.0 if i == j else 0.0) - gain[i] * D[s, j]
        congruence(J, P, JP, P)
        for i in range(n):
            for j in range(n):
                P[i, j] = P[i, j] + gain[i] * gain[j]


def pivot_tolerance(goal_given):
    """Return the relative pivot size that leaves a control undetermined: nonzero, for rounding, only if a goal is missing."""
    missing = 0.0 * goal_given[0]
    for i in range(goal_given.shape[0]):
        missing = missing + 1.0 - goal_given[i]
    return select(missing > 0.5, 1e-12, 0.0)


def decide(belief, A, aim, decision, u):
    """Infer the control: the mean of p(u_t | belief, goal) for x_t+1 = A x_t + B u_t + q.

    A goal that is not finite counts as missing: its row is left out (``goal_given``). Writes the goal's error to ``goal_error``.
    """
    G, _, GQ, prior_precision, prior_pull, _ = aim
    target, GB, goal_given, GA, GAP, SG, goal_error, W, Lambda = decision
    _, _, x_hat, P = belief
    g, p = GB.shape[0], GB.shape[1]
    multiply(G, A, GA)
    for i in range(g):
        goal_given[i] = select(target[i] - target[i] == 0.0, 1.0, 0.0)
        for j in range(GA.shape[1]):
            GA[i, j] = select(goal_given[i] > 0.5, GA[i, j], 0.0)
        for j in range(p):
            W[i, j] = select(goal_given[i] > 0.5, GB[i, j], 0.0)
    congruence(GA, P, GAP, SG)
    for i in range(g):
        for j in range(g):
            alone = 1.0 if i == j else 0.0
            SG[i, j] = select(both(goal_given[i] > 0.5, goal_given[j] > 0.5), SG[i, j] + GQ[i, j], alone)
        expected = GA[i, 0] * x_hat[0]
        for j in range(1, GA.shape[1]):
            expected = expected + GA[i, j] * x_hat[j]
        goal_error[i] = select(goal_given[i] > 0.5, target[i] - expected, 0.0)
    cholesky(SG, SG)
    solve_columns(SG, W)
    add_product(prior_precision, GB, W, Lambda)  # the control's precision given prior and goal
    for i in range(p):
        total = prior_pull[i]
        for s in range(g):
            total = total + W[s, i] * goal_error[s]
        u[i] = total
    cholesky_determined(Lambda, pivot_tolerance(goal_given), Lambda)
    solve_vector(Lambda, u)


def limit(u, applied, limits):
    """Limit the control's change since the last step, then the control itself, and store the applied control.

    A control that is not finite (no goal under a flat prior) becomes the last one.
    """
    for i in range(u.shape[0]):
        request = select(u[i] - u[i] == 0.0, u[i], applied[i])
        request = maximum(minimum(request, applied[i] + limits.u_change[i]), applied[i] - limits.u_change[i])
        u[i] = maximum(minimum(request, limits.u_max[i]), limits.u_min[i])
        applied[i] = u[i]


def predict(belief, u, model, largest, AP):
    """Predict the belief at the next step, with the control that was applied.

    Means are limited to `MEAN_CAP` and variances to ``largest``. With an unstable plant that no sensor has seen for hundreds of
    steps, the belief then becomes very uncertain but stays finite.
    """
    mean, covariance, x_hat, P = belief
    A, B, _, Q = model
    n = A.shape[0]
    apply(A, x_hat, mean)
    for i in range(n):
        total = mean[i]
        for j in range(B.shape[1]):
            total = total + B[i, j] * u[j]
        mean[i] = maximum(minimum(total, MEAN_CAP), -MEAN_CAP)
    congruence(A, P, AP, covariance)
    for i in range(n):
        for j in range(n):
            covariance[i, j] = covariance[i, j] + Q[i, j]
    hold_variances(covariance, largest)


def hold_variances(covariance, largest):
    """Limit the variances to ``largest``."""
    for i in range(covariance.shape[0]):
        hold_variance(covariance, i, largest[0])


def hold_variance(covariance, i, largest):
    """Limit the variance of one state."""
    # The correlations of such a state are removed as well, or repeated steps would turn them into false certainty.
    lost = covariance[i, i] > largest
    for j in range(covariance.shape[0]):
        covariance[i, j] = select(lost, 0.0, covariance[i, j])
        covariance[j, i] = covariance[i, j]
    covariance[i, i] = select(lost, largest, covariance[i, i])


def keep_belief(aim, decision, folding, belief):
    """Carry p(x_t | y_1..t), on which goal and control prior have no effect (``belief="filtered"``)."""


def fold_goal(aim, decision, folding, belief):
    """Condition the belief about x_t on the goal as well: the marginal of the paper's full joint (``belief="joint"``).

    N = GQ is the goal's covariance given x_t and u_t. With u_t integrated out, the goal's information about x_t is
    ``V = N^-1 - N^-1 GB (prior + GB' N^-1 GB)^-1 GB' N^-1``. With P = L L' the belief becomes
    ``P <- L (I + L' GA' V GA L)^-1 L'``. ``goal_error`` is the goal's error at the means of belief and control prior.
    """
    _, GB, goal_given, GA, _, _, goal_error, W, Lambda = decision
    N, V, Wt, L, GL, VGL, M, X, h = folding
    _, _, x_hat, P = belief
    GQ, prior_precision = aim.GQ, aim.prior_precision
    g, p, n = GB.shape[0], GB.shape[1], GA.shape[1]
    for i in range(g):
        for j in range(g):
            V[i, j] = 1.0 if i == j else 0.0
            N[i, j] = select(both(goal_given[i] > 0.5, goal_given[j] > 0.5), GQ[i, j], V[i, j])
        for j in range(p):
            W[i, j] = select(goal_given[i] > 0.5, GB[i, j], 0.0)
    cholesky(N, N)
    solve_columns(N, V)
    solve_columns(N, W)
    add_product(prior_precision, GB, W, Lambda)  # the control's precision given prior and goal
    for i in range(p):
        for j in range(g):
            Wt[i, j] = W[j, i]
    cholesky_determined(Lambda, pivot_tolerance(goal_given), Lambda)
    solve_columns(Lambda, Wt)
    for i in range(g):
        for j in range(g):
            for s in range(p):
                V[i, j] = V[i, j] - W[i, s] * Wt[s, j]
    cholesky_semidefinite(P, L)
    multiply(GA, L, GL)
    multiply(V, GL, VGL)
    for i in range(n):
        total = 0.0 * goal_error[0]
        for s in range(g):
            total = total + VGL[s, i] * goal_error[s]
        h[i] = total
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for s in range(g):
                total = total + GL[s, i] * VGL[s, j]
            M[i, j] = total
            X[i, j] = L[j, i]
    cholesky(M, M)
    solve_vector(M, h)
    solve_columns(M, X)
    # If no goal determines a control with a flat prior, M is not finite and the goal gives no information.
    finite_result = M[n - 1, n - 1] - M[n - 1, n - 1] == 0.0
    for i in range(n):
        for j in range(n):
            x_hat[i] = x_hat[i] + select(finite_result, L[i, j] * h[j], 0.0)
        for j in range(i + 1):
            total = L[i, 0] * X[0, j]
            for s in range(1, n):
                total = total + L[i, s] * X[s, j]
            P[i, j] = select(finite_result, total, P[i, j])
            P[j, i] = P[i, j]
