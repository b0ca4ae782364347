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
    """Goal prior and control prior: ``G x_t+1`` is to be the goal.

    ``GB`` is G B, ``GQ`` is G Q G' plus the goal's covariance; ``prior_precision`` and ``prior_pull`` are the control prior's
    precision and its product with the prior mean (zeros for a flat prior), ``shift`` is G B times that mean.
    """

    G: Floats
    GB: Floats
    GQ: Floats
    prior_precision: Floats
    prior_pull: Floats
    shift: Floats


class Decision(NamedTuple):
    """What is ``sought`` of the next state and what of G B the actuators let through; the rest `decide` leaves behind."""

    sought: Floats
    GB: Floats
    wanted: Floats
    GA: Floats
    GAP: Floats
    SG: Floats
    pull: Floats
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
    """Compute the innovation ``e = y - expected``, which samples there are, and its covariance ``spread = C P C'``.

    A sample that is not finite counts as none, and so does one of an ``invalid`` value and an absurd one (``absurd.py``);
    these are NaN in ``sample.y``. Then ``e`` is 0, and the ``innovation`` that is reported NaN. A belief that was lost is widened
    first. ``reach`` is the ``largest`` variance of a hypothesis, and negative then: no hypothesis goes on as it was. ``e`` is 0
    as well then, for a learner, until `restore`: it is the belief that was wrong, not the sensors.
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
    """Write the innovations as they are, after the learner has seen them."""
    for i in range(sample.e.shape[0]):
        sample.e[i] = select(sample.present[i] > 0.5, sample.y[i] - reading.expected[i], 0.0)


def keep_only(kept, R):
    """Leave of the covariance what belongs to those that are ``kept`` (1 or 0); the others become independent, of variance 1."""
    for i in range(R.shape[0]):
        for j in range(R.shape[0]):
            alone = 1.0 if i == j else 0.0
            R[i, j] = select(both(kept[i] > 0.5, kept[j] > 0.5), R[i, j], alone)


def measure(e, used, R, C, belief, space):
    """Condition the belief on the sensors in use, one after the other, each by Kalman's update in Joseph's form.

    The sensors' noise is whitened first by the Cholesky factor of its covariance (a row and column of the unused left out). One
    by one, no matrix has to be inverted that becomes singular when the belief is far less certain than the sensors.
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


def doubt(wanted):
    """Return how small a pivot, relative to its diagonal, leaves a control undetermined: rounding alone, with a goal missing."""
    missing = 0.0 * wanted[0]
    for i in range(wanted.shape[0]):
        missing = missing + 1.0 - wanted[i]
    return select(missing > 0.5, 1e-12, 0.0)


def decide(belief, A, aim, decision, u):
    """Infer the control: the mean of p(u_t | belief, goal) when x_t+1 = A x_t + B u_t + q is pulled to the goal.

    A goal that is not finite counts as none: its row
    is left out (``wanted``). Leaves the goal's error in ``pull``.
    """
    G, _, GQ, prior_precision, prior_pull, _ = aim
    sought, GB, wanted, GA, GAP, SG, pull, W, Lambda = decision
    _, _, x_hat, P = belief
    g, p = GB.shape[0], GB.shape[1]
    multiply(G, A, GA)
    for i in range(g):
        wanted[i] = select(sought[i] - sought[i] == 0.0, 1.0, 0.0)
        for j in range(GA.shape[1]):
            GA[i, j] = select(wanted[i] > 0.5, GA[i, j], 0.0)
        for j in range(p):
            W[i, j] = select(wanted[i] > 0.5, GB[i, j], 0.0)
    congruence(GA, P, GAP, SG)
    for i in range(g):
        for j in range(g):
            alone = 1.0 if i == j else 0.0
            SG[i, j] = select(both(wanted[i] > 0.5, wanted[j] > 0.5), SG[i, j] + GQ[i, j], alone)
        expected = GA[i, 0] * x_hat[0]
        for j in range(1, GA.shape[1]):
            expected = expected + GA[i, j] * x_hat[j]
        pull[i] = select(wanted[i] > 0.5, sought[i] - expected, 0.0)
    cholesky(SG, SG)
    solve_columns(SG, W)
    add_product(prior_precision, GB, W, Lambda)  # what prior and goal together know of the control
    for i in range(p):
        total = prior_pull[i]
        for s in range(g):
            total = total + W[s, i] * pull[s]
        u[i] = total
    cholesky_determined(Lambda, doubt(wanted), Lambda)
    solve_vector(Lambda, u)


def limit(u, applied, limits):
    """Limit the control's change since the last step, then the control itself, and remember what is applied.

    A control that is not finite (nothing determines it: no goal under a flat prior) becomes the last one.
    """
    for i in range(u.shape[0]):
        asked = select(u[i] - u[i] == 0.0, u[i], applied[i])
        asked = maximum(minimum(asked, applied[i] + limits.u_change[i]), applied[i] - limits.u_change[i])
        u[i] = maximum(minimum(asked, limits.u_max[i]), limits.u_min[i])
        applied[i] = u[i]


def predict(belief, u, model, largest, AP):
    """Take the belief to the next step, with the control that was applied.

    Means beyond `MEAN_CAP` and variances beyond ``largest`` are held there: an unstable plant that no sensor has seen for
    hundreds of steps then leaves a belief that knows nothing, not one that is not a number.
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
    """Hold variances beyond ``largest`` there."""
    n = covariance.shape[0]
    for i in range(n):
        # A state beyond it is known to nobody: its correlations go too, or repeated steps would make them a false certainty.
        lost = covariance[i, i] > largest[0]
        for j in range(n):
            covariance[i, j] = select(lost, 0.0, covariance[i, j])
            covariance[j, i] = covariance[i, j]
        covariance[i, i] = select(lost, largest[0], covariance[i, i])


def keep_belief(aim, decision, folding, belief):
    """Carry p(x_t | y_1..t): goal and control prior leave the belief alone (``belief="filtered"``)."""


def fold_goal(aim, decision, folding, belief):
    """Condition the belief about x_t on the goal as well: the marginal of the paper's full joint (``belief="joint"``).

    With N = GQ the goal's covariance given x_t and u_t, what the goal says about x_t once u_t is integrated out has the
    information ``V = N^-1 - N^-1 GB (prior + GB' N^-1 GB)^-1 GB' N^-1``. With P = L L' the belief becomes
    ``P <- L (I + L' GA' V GA L)^-1 L'``. ``pull`` is the goal's error at the belief's mean, control prior mean included.
    """
    _, GB, wanted, GA, _, _, pull, W, Lambda = decision
    N, V, Wt, L, GL, VGL, M, X, h = folding
    _, _, x_hat, P = belief
    GQ, prior_precision = aim.GQ, aim.prior_precision
    g, p, n = GB.shape[0], GB.shape[1], GA.shape[1]
    for i in range(g):
        for j in range(g):
            V[i, j] = 1.0 if i == j else 0.0
            N[i, j] = select(both(wanted[i] > 0.5, wanted[j] > 0.5), GQ[i, j], V[i, j])
        for j in range(p):
            W[i, j] = select(wanted[i] > 0.5, GB[i, j], 0.0)
    cholesky(N, N)
    solve_columns(N, V)
    solve_columns(N, W)
    add_product(prior_precision, GB, W, Lambda)  # what prior and goal together know of the control
    for i in range(p):
        for j in range(g):
            Wt[i, j] = W[j, i]
    cholesky_determined(Lambda, doubt(wanted), Lambda)
    solve_columns(Lambda, Wt)
    for i in range(g):
        for j in range(g):
            for s in range(p):
                V[i, j] = V[i, j] - W[i, s] * Wt[s, j]
    cholesky_semidefinite(P, L)
    multiply(GA, L, GL)
    multiply(V, GL, VGL)
    for i in range(n):
        total = 0.0 * pull[0]
        for s in range(g):
            total = total + VGL[s, i] * pull[s]
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
    # Where no goal is left to determine a control of flat prior, nothing is learned from it either, and M is not finite.
    known = M[n - 1, n - 1] - M[n - 1, n - 1] == 0.0
    for i in range(n):
        for j in range(n):
            x_hat[i] = x_hat[i] + select(known, L[i, j] * h[j], 0.0)
        for j in range(i + 1):
            total = L[i, 0] * X[0, j]
            for s in range(1, n):
                total = total + L[i, s] * X[s, j]
            P[i, j] = select(known, total, P[i, j])
            P[j, i] = P[i, j]
