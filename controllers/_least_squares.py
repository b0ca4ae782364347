"""Linear least squares in step functions, by Givens rotations: the inner step of nonlinear least squares.

Equations ``row @ z = value`` are absorbed one by one into a triangle ``T z = b`` that stands for all of them: the square root of
their information. Unlike the normal equations this squares no condition number, and it is done with a huge equation (a sharp
sensor) before a tiny one (a vague prior) could drown in it.
"""

from bayesftc.cosim.ops import select, sqrt


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


def solve_triangle(T, b, z):
    """Solve ``T z = b``; an unknown of which no equation speaks becomes 0."""
    n = T.shape[0]
    for i in range(n):
        j = n - 1 - i
        total = b[j]
        for k in range(j + 1, n):
            total = total - T[j, k] * z[k]
        z[j] = select(T[j, j] == 0.0, 0.0, total / T[j, j])


def squared_length(T, j):
    """Return the squared length of column `j`: of the triangle, and so of all equations that it stands for."""
    total = T[0, j] * T[0, j]
    for i in range(1, j + 1):
        total = total + T[i, j] * T[i, j]
    return total


def damp(T, b, damping, D, d, row):
    """Write into ``D, d`` the triangle with a pull of each unknown to zero, `damping` times its column's squared length."""
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
