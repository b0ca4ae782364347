"""Least squares in step functions by Givens rotations, and the secant correction for fast nonlinear convergence.

Equations ``row @ z = value`` are absorbed one by one into an equivalent triangle ``T z = b``, the square root of their
information. Unlike the normal equations this squares no condition number, and a tiny equation (a vague prior) is not lost beside
a huge one (a sharp sensor).
"""

from typing import NamedTuple

from bayesftc.controllers.linalg.dense import cholesky, multiply_transposed, solve_vector
from bayesftc.cosim.ops import absolute, both, minimum, select, sqrt
from bayesftc.cosim.types import Floats

LEAST_BEND = 0.7
"""Least remaining share of the curvature along a step. With Powell's 0.2 random problems need more steps."""


def absorb(T, b, row, value):
    """Absorb the equation ``row @ z = value`` into the triangle; `row` is overwritten. A row of zeros changes nothing."""
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
    """Return the squared length of column `j` of the triangle, which is that of all absorbed equations."""
    total = T[0, j] * T[0, j]
    for i in range(1, j + 1):
        total = total + T[i, j] * T[i, j]
    return total


def damp(T, b, damping, D, d, row):
    """Write into ``D, d`` the triangle with an equation ``z = 0`` for each unknown, weighted by `damping`.

    The weight is `damping` times the squared length of the unknown's column, or 1 if it has no equation.
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


def divide(A, T, first, X):
    """Write ``X = A T^-1`` for an upper triangle: the part of `T` from `first` on. `X` may be `A`."""
    n = A.shape[1]
    for i in range(A.shape[0]):
        for j in range(n):
            total = A[i, j]
            for k in range(j):
                total = total - X[i, k] * T[first + k, first + j]
            X[i, j] = total / T[first + j, first + j]


def solve_curved(D, d, S, M, step):
    """Solve ``(D'D + S) step = D'd`` for a triangle and a symmetric S; without S if the sum is not positive definite.

    The form ``(I + D'^-1 S D^-1) (D step) = d`` squares no condition number if S is zero.
    """
    n = D.shape[0]
    divide(S, D, 0, M)
    for i in range(n):
        for j in range(i):
            other = M[i, j]
            M[i, j] = M[j, i]
            M[j, i] = other
    divide(M, D, 0, M)
    for i in range(n):
        M[i, i] = M[i, i] + 1.0
        step[i] = d[i]
    cholesky(M, M)
    sound = 0.0
    for i in range(n):
        sound = sound + (M[i, i] - M[i, i])
    solve_vector(M, step)
    for i in range(n):
        j = n - 1 - i
        total = select(sound == 0.0, step[j], d[j])
        for k in range(j + 1, n):
            total = total - D[j, k] * step[k]
        step[j] = total / D[j, j]


def turn(T, moved, turned):
    """Write ``T'T moved``, the linear equations' change of the gradient, and return ``moved' T'T moved``."""
    n = T.shape[0]
    squared = 0.0
    for i in range(n):
        total = T[i, i] * moved[i]
        for k in range(i + 1, n):
            total = total + T[i, k] * moved[k]
        turned[i] = total
        squared = squared + total * total
    for j in range(n):
        i = n - 1 - j
        total = T[0, i] * turned[0]
        for k in range(1, i + 1):
            total = total + T[k, i] * turned[k]
        turned[i] = total
    return squared


class Curvature(NamedTuple):
    """Estimate ``S`` of the residuals' curvature; ``M`` and three vectors are scratch space."""

    S: Floats
    M: Floats
    moved: Floats
    turned: Floats
    bent: Floats


def curve(changed, z, z2, T2, J, J2, values, least, curvature):
    """Update ``S``, the residuals' curvature, which Gauss-Newton leaves out of the Hessian, from the step to `z2`.

    It is the structured secant update of Dennis, Gay and Welsch (ACM Trans. Math. Softw. 7, 1981), with their sizing. If the cost
    curves less along the step than the share `LEAST_BEND` of ``T'T + S``, or downwards, the update is reduced until that share
    remains (Powell, Lect. Notes Math. 630, 1978): the sum stays positive along the step, and steps grow. There is no update if
    the point has not `changed`, or if the step is so short (`least`) that its differences are rounding.
    """
    S, M, moved, turned, bent = curvature
    n = z.shape[0]
    for i in range(n):
        moved[i] = z2[i] - z[i]
    squared = turn(T2, moved, turned)
    bend = 0.0
    previous = 0.0
    for i in range(n):
        total = 0.0  # the change of the gradient that is due to the residuals' curvature
        for k in range(values.shape[0]):
            total = total - (J2[k, i] - J[k, i]) * values[k]
        bent[i] = total
        bend = bend + moved[i] * total
        for j in range(n):
            previous = previous + moved[i] * S[i, j] * moved[j]
    # Reset S if the cost would not curve upwards along the step.
    sound = squared + previous > 0.0
    previous = select(sound, previous, 0.0)
    size = select(previous == 0.0, 1.0, minimum(1.0, absolute(bend) / absolute(previous)))
    size = select(sound, size, 0.0)
    model = squared + previous
    flat = squared + bend < LEAST_BEND * model
    share = select(flat, (1.0 - LEAST_BEND) * model / (previous - bend), 1.0)
    along = 0.0  # moved' (T'T + S) moved with the new S
    for i in range(n):
        total = 0.0
        for j in range(n):
            total = total + S[i, j] * moved[j]
        bent[i] = share * bent[i] + (1.0 - share) * select(sound, total, 0.0)
        turned[i] = turned[i] + bent[i]
        along = along + moved[i] * turned[i]
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
    """Write ``P = root S root'``, where S is the covariance of the unknowns from `first` on, and ``T'T`` their information."""
    divide(root, T, first, X)
    multiply_transposed(X, X, P)
