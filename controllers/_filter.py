"""Step functions of the Bayesian controller's three stages: measurement update, control, prediction."""

from bayesftc.controllers._linalg import (
    apply,
    cholesky,
    congruence,
    multiply,
    multiply_transposed,
    solve_columns,
    solve_vector,
)
from bayesftc.cosim.ops import both, maximum, minimum, select


def innovate(y, mean, covariance, C, e, present, CP, spread):
    """Compute the innovation ``e = y - C mean``, which samples there are, and its covariance ``spread = C P C'``.

    A sample that is not finite counts as none; its innovation is 0.
    """
    multiply(C, covariance, CP)
    multiply_transposed(CP, C, spread)
    for i in range(y.shape[0]):
        expected = C[i, 0] * mean[0]
        for j in range(1, C.shape[1]):
            expected = expected + C[i, j] * mean[j]
        d = y[i] - expected
        finite = d - d == 0.0
        present[i] = select(finite, 1.0, 0.0)
        e[i] = select(finite, d, 0.0)


def measure(e, used, R, C, CP, spread, mean, covariance, S, K, KR, J, JP, x_hat, P):
    """Condition the belief on the sensors in use: Kalman's update in Joseph's form, a row and column of the unused left out."""
    m, n = C.shape[0], C.shape[1]
    for i in range(m):
        for j in range(m):
            together = both(used[i] > 0.5, used[j] > 0.5)
            alone = 1.0 if i == j else 0.0
            S[i, j] = select(together, spread[i, j] + R[i, j], alone)
        for j in range(n):
            K[i, j] = select(used[i] > 0.5, CP[i, j], 0.0)  # K holds the gain's transpose: S^-1 C P
    cholesky(S, S)
    solve_columns(S, K)
    for j in range(n):
        total = mean[j]
        for i in range(m):
            total = total + K[i, j] * e[i]
        x_hat[j] = total
    for i in range(n):
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for s in range(m):
                total = total - K[s, i] * C[s, j]
            J[i, j] = total
    congruence(J, covariance, JP, P)
    for s in range(m):
        for j in range(n):
            total = 0.0 * K[s, j]
            for r in range(m):
                total = total + select(both(used[s] > 0.5, used[r] > 0.5), R[s, r], 0.0) * K[r, j]
            KR[s, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = P[i, j]
            for s in range(m):
                total = total + K[s, i] * KR[s, j]
            P[i, j] = total
            P[j, i] = total


def decide(goal, x_hat, P, A, G, GQ, GB, prior_precision, prior_pull, GA, GAP, SG, pull, W, Lambda, u):
    """Infer the control: the mean of p(u_t | belief, goal) when x_t+1 = A x_t + B u_t + q is pulled to the goal.

    ``GQ`` is G Q G' plus the goal's covariance, ``GB`` is G B, ``prior_precision`` and ``prior_pull`` the control prior's
    precision and its product with the prior mean (zeros for a flat prior). Leaves the goal's error in ``pull``.
    """
    g, p = GB.shape[0], GB.shape[1]
    multiply(G, A, GA)
    congruence(GA, P, GAP, SG)
    for i in range(g):
        for j in range(g):
            SG[i, j] = SG[i, j] + GQ[i, j]
        expected = GA[i, 0] * x_hat[0]
        for j in range(1, GA.shape[1]):
            expected = expected + GA[i, j] * x_hat[j]
        pull[i] = goal[i] - expected
        for j in range(p):
            W[i, j] = GB[i, j]
    cholesky(SG, SG)
    solve_columns(SG, W)
    for i in range(p):
        for j in range(p):
            total = prior_precision[i, j]
            for s in range(g):
                total = total + GB[s, i] * W[s, j]
            Lambda[i, j] = total
        total = prior_pull[i]
        for s in range(g):
            total = total + W[s, i] * pull[s]
        u[i] = total
    cholesky(Lambda, Lambda)
    solve_vector(Lambda, u)


def limit(u, applied, u_min, u_max, u_change):
    """Limit the control and its change since the last step, and remember what is applied."""
    for i in range(u.shape[0]):
        low = maximum(u_min[i], applied[i] - u_change[i])
        high = minimum(u_max[i], applied[i] + u_change[i])
        u[i] = maximum(minimum(u[i], high), low)
        applied[i] = u[i]


def predict(x_hat, P, u, A, B, Q, AP, mean, covariance):
    """Take the belief to the next step, with the control that was applied."""
    apply(A, x_hat, mean)
    for i in range(B.shape[0]):
        total = mean[i]
        for j in range(B.shape[1]):
            total = total + B[i, j] * u[j]
        mean[i] = total
    congruence(A, P, AP, covariance)
    for i in range(Q.shape[0]):
        for j in range(Q.shape[1]):
            covariance[i, j] = covariance[i, j] + Q[i, j]


def keep_belief(pull, GA, GQ, GB, prior_precision, N, V, W, Wt, Lambda, L, GL, VGL, M, X, h, x_hat, P):
    """Carry p(x_t | y_1..t): goal and control prior leave the belief alone (``belief="filtered"``)."""


def fold_goal(pull, GA, GQ, GB, prior_precision, N, V, W, Wt, Lambda, L, GL, VGL, M, X, h, x_hat, P):
    """Condition the belief about x_t on the goal as well: the marginal of the paper's full joint (``belief="joint"``).

    With N = GQ the goal's covariance given x_t and u_t, what the goal says about x_t once u_t is integrated out has the
    information ``V = N^-1 - N^-1 GB (prior + GB' N^-1 GB)^-1 GB' N^-1``. With P = L L' the belief becomes
    ``P <- L (I + L' GA' V GA L)^-1 L'``. ``pull`` is the goal's error at the belief's mean, control prior mean included.
    """
    g, p, n = GB.shape[0], GB.shape[1], GA.shape[1]
    for i in range(g):
        for j in range(g):
            V[i, j] = 1.0 if i == j else 0.0
        for j in range(p):
            W[i, j] = GB[i, j]
    cholesky(GQ, N)
    solve_columns(N, V)
    solve_columns(N, W)
    for i in range(p):
        for j in range(p):
            total = prior_precision[i, j]
            for s in range(g):
                total = total + GB[s, i] * W[s, j]
            Lambda[i, j] = total
        for j in range(g):
            Wt[i, j] = W[j, i]
    cholesky(Lambda, Lambda)
    solve_columns(Lambda, Wt)
    for i in range(g):
        for j in range(g):
            for s in range(p):
                V[i, j] = V[i, j] - W[i, s] * Wt[s, j]
    for i in range(n):
        for j in range(n):
            L[i, j] = 0.0
    cholesky(P, L)
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
    for i in range(n):
        for j in range(n):
            x_hat[i] = x_hat[i] + L[i, j] * h[j]
        for j in range(i + 1):
            total = L[i, 0] * X[0, j]
            for s in range(1, n):
                total = total + L[i, s] * X[s, j]
            P[i, j] = total
            P[j, i] = total
