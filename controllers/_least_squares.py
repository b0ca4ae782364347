"""Least squares in step functions, by Givens rotations; and the secant correction that makes nonlinear ones converge fast.

Equations ``row @ z = value`` are absorbed one by one into a triangle ``T z = b`` that stands for all of them: the square root of
their information. Unlike the normal equations this squares no condition number, and it is done with a huge equation (a sharp
sensor) before a tiny one (a vague prior) could drown in it.
"""

from bayesftc.controllers._linalg import cholesky, solve_vector
from bayesftc.cosim.ops import absolute, both, minimum, select, sqrt


def absorb(T, b, row, value):
    """Absorb the equation ``row @ z = value`` into the triangle; `row` is used up. A row of zeros changes nothing."""
    n = T.shape[0]
    for j in range(n):
        length = sqrt(T[j, j] * T[j, j] + row[j] * row[j])
        empty = length == 0.0
        c = select(empty, 1.0, T[j, j] / length)
        s = select(empty, 0.0, row[j] / length)
        for k in range(j, n):
            t = T[j, k]
            T[j, k] = c * t + s * row[k]
            row[k] = c * row[k] - s * t
        t = b[j]
        b[j] = c * t + s * value
        value = c * value - s * t


def squared_length(T, j):
    """Return the squared length of column `j`: of the triangle, and so of all equations that it stands for."""
    total = T[0, j] * T[0, j]
    for i in range(1, j + 1):
        total = total + T[i, j] * T[i, j]
    return total


def damp(T, b, damping, D, d, row):
    """Write into ``D, d`` the triangle with a pull of each unknown to zero, `damping` times its column's squared length.

    An unknown of which no equation speaks is pulled to zero, too.
    """
    n = T.shape[0]
    for i in range(n):
        d[i] = b[i]
        for j in range(n):
            D[i, j] = T[i, j]
    for j in range(n):
        for k in range(n):
            row[k] = 0.0
        row[j] = sqrt(damping * squared_length(T, j))
        absorb(D, d, row, 0.0)
        D[j, j] = select(D[j, j] == 0.0, 1.0, D[j, j])


def solve_curved(D, d, S, M, step):
    """Solve ``(D'D + S) step = D'd`` for a triangle and a symmetric correction; NaN where the sum is not positive definite.

    It is solved as ``(I + D'^-1 S D^-1) (D step) = d``, so that without a correction no condition number is squared. `d` is
    used up.
    """
    n = D.shape[0]
    for i in range(n):
        for j in range(n):
            total = S[i, j]
            for k in range(j):
                total = total - M[i, k] * D[k, j]
            M[i, j] = total / D[j, j]
    for j in range(n):
        for i in range(n):
            total = M[i, j]
            for k in range(i):
                total = total - D[k, i] * M[k, j]
            M[i, j] = total / D[i, i]
    for i in range(n):
        M[i, i] = M[i, i] + 1.0
    cholesky(M, M)
    solve_vector(M, d)
    for i in range(n):
        j = n - 1 - i
        total = d[j]
        for k in range(j + 1, n):
            total = total - D[j, k] * step[k]
        step[j] = total / D[j, j]


def pull(T, b, i):
    """Return element `i` of ``T'b``, the negative gradient."""
    total = T[0, i] * b[0]
    for k in range(1, i + 1):
        total = total + T[k, i] * b[k]
    return total


def curve(changed, z, z2, T, b, T2, b2, J, J2, values, least, S, M, moved, turned, bent):
    """Learn from the step to `z2` what Gauss and Newton leave out of the Hessian: ``S``, the residuals' own curvature.

    The structured secant update of Dennis, Gay and Welsch (ACM Trans. Math. Softw. 7, 1981), with their sizing. Nothing is
    learned where it has not `changed`, or where the step is so short (`least`) that only rounding would be learned from.
    """
    n = z.shape[0]
    along = 0.0  # moved' turned: positive where the cost curves upwards
    bend = 0.0
    known = 0.0
    for i in range(n):
        moved[i] = z2[i] - z[i]
        turned[i] = pull(T, b, i) - pull(T2, b2, i)  # the change of the gradient
        total = 0.0
        for k in range(values.shape[0]):
            total = total - (J2[k, i] - J[k, i]) * values[k]  # that part of it which is due to the residuals' curvature
        bent[i] = total
        along = along + moved[i] * turned[i]
        bend = bend + moved[i] * bent[i]
    for i in range(n):
        for j in range(n):
            known = known + moved[i] * S[i, j] * moved[j]
    size = minimum(1.0, absolute(bend) / absolute(known))
    size = select(known == 0.0, 1.0, size)
    wrong = 0.0
    for i in range(n):
        for j in range(n):
            bent[i] = bent[i] - size * S[i, j] * moved[j]
        wrong = wrong + moved[i] * bent[i]
    good = both(changed, along > least)
    total = 0.0
    for i in range(n):
        for j in range(n):
            both_ways = bent[i] * turned[j] + turned[i] * bent[j]
            M[i, j] = size * S[i, j] + both_ways / along - wrong * turned[i] * turned[j] / (along * along)
            total = total + (M[i, j] - M[i, j])
    good = both(good, total == 0.0)
    for i in range(n):
        for j in range(n):
            S[i, j] = select(good, M[i, j], S[i, j])


def is_finite(T, cost):
    """Return whether the triangle and the cost are finite numbers."""
    total = cost - cost
    for j in range(T.shape[0]):
        total = total + (T[j, j] - T[j, j])
    return total == 0.0


def marginal(T, root, first, X, P):
    """Write ``P = root S root'`` where S is the covariance of the unknowns from `first` on, of unit information ``T'T``."""
    n = root.shape[0]
    for i in range(n):
        for j in range(n):
            total = root[i, j]
            for k in range(j):
                total = total - X[i, k] * T[first + k, first + j]
            X[i, j] = total / T[first + j, first + j]
    for i in range(n):
        for j in range(i + 1):
            total = X[i, 0] * X[j, 0]
            for k in range(1, n):
                total = total + X[i, k] * X[j, k]
            P[i, j] = total
            P[j, i] = total
