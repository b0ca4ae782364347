"""A point estimate of all sensors' precision matrix, by gradient descent on the free energy (paper, section 3.1).

With V = Pi^-1 the free energy of a sample's innovations e is ``F = (e' Pi e - ln |Pi|) / 2``, and its derivative by Pi is
``(e e' - V) / 2``. A step along it can leave the positive definite matrices. The step is therefore one of the matrix's logarithm,
in coordinates in which the present matrix is the identity. With any factor ``Pi = M M'``, ::

    Pi <- M exp(-k/2 (M' e e' M - I)) M'

This is the geodesic down the gradient in the affine-invariant metric. It is positive definite for every rate. It does not depend
on the factor, the units or the order of the sensors, and for one sensor it is the step of ``zeta = ln w``. As ``e e'`` has rank
one the exponential has a closed form. For V, with s = e' Pi e, ::

    V <- exp(-k/2) V + (exp(k/2 (s - 1)) - exp(-k/2)) e e' / s

With missing samples, F is that of the present sensors, whose covariance is a block of V. Its gradient does not change the
covariance of the missing sensors given the present ones.
"""

from bayesftc.controllers.estimation.filter import keep_only
from bayesftc.controllers.linalg.dense import (
    cholesky,
    multiply,
    multiply_transposed,
    solve_columns,
    solve_vector,
    whiten,
)
from bayesftc.controllers.linalg.eigen import diagonalise
from bayesftc.controllers.precision.base import ERROR_CAP, NAN
from bayesftc.controllers.precision.matrix import invert
from bayesftc.cosim.ops import exp, maximum, minimum, select, sqrt

WIDEST = 1e-10
"""Least ratio of the bounds; matrices with more distant eigenvalues cannot be inverted reliably."""

RATE, LEAST, MOST = range(3)
"""Settings: size of the step, bounds of the relative precision."""

WORK = 6
"""Number of m x m matrices of scratch space."""


def learn_matrix(sample, trust, memory, settings, work):
    """Take one gradient step with the present samples. ``memory``: one unused number, the covariance, its inverse."""
    m = sample.y.shape[0]
    for i in range(m):
        for j in range(m):
            trust.R[i, j] = memory[1 + i * m + j]
    _descend(
        sample.e,
        sample.present,
        sample.nominal,
        settings,
        trust.R,
        work[0],
        work[1],
        work[2],
        work[3][0],
        work[4][0],
        work[5][0],
    )
    _bound(sample.nominal, settings, trust.R, work[0], work[1], work[2], work[3], work[4], work[5])
    for i in range(m):
        for j in range(m):
            memory[1 + i * m + j] = trust.R[i, j]
        trust.used[i] = sample.present[i]
        trust.precision[i] = 1.0 / trust.R[i, i]
        trust.beta[i] = NAN
        trust.fault_probability[i] = NAN
    invert(memory, work[0], work[1])


def _descend(e, present, nominal, settings, V, L, X, K, error, weighed, along):
    """Take the step of V as above, but not past this sample's minimum along e, where s is 1."""
    m = V.shape[0]
    for i in range(m):
        largest = sqrt(ERROR_CAP * nominal[i, i])
        error[i] = select(present[i] > 0.5, maximum(minimum(e[i], largest), -largest), 0.0)
        weighed[i] = error[i]
        for j in range(m):
            L[i, j] = V[i, j]
            X[i, j] = select(present[i] > 0.5, V[i, j], 0.0)
    keep_only(present, L)
    cholesky(L, L)
    solve_columns(L, X)
    multiply(V, X, K)  # the covariance explained by the present sensors; V itself if none is missing
    solve_vector(L, weighed)
    s = 0.0 * e[0]
    for i in range(m):
        s = s + error[i] * weighed[i]
        along[i] = V[i, 0] * weighed[0]
        for j in range(1, m):
            along[i] = along[i] + V[i, j] * weighed[j]
    shrink = exp(-0.5 * settings[RATE])
    grow = exp(minimum(0.5 * settings[RATE] * (s - 1.0), 700.0))
    grow = select(s > 1.0, minimum(grow, s), maximum(grow, s))
    weight = select(s > 0.0, (grow - shrink) / select(s > 0.0, s, 1.0), 0.0)
    for i in range(m):
        for j in range(i + 1):
            explained = 0.5 * (K[i, j] + K[j, i])
            V[i, j] = V[i, j] - explained + shrink * explained + weight * along[i] * along[j]
            V[j, i] = V[i, j]


def _bound(nominal, settings, V, root, rows, relative, vectors, factor, no_values):
    """Limit the eigenvalues of the covariance relative to the nominal one to their bounds."""
    m = V.shape[0]
    cholesky(nominal, root)
    for i in range(m):
        no_values[0, i] = 0.0
        for j in range(m):
            rows[i, j] = V[i, j]
    whiten(root, rows, no_values[0])
    for i in range(m):
        for j in range(m):
            relative[i, j] = rows[j, i]
    whiten(root, relative, no_values[0])
    for i in range(m):
        for j in range(i):
            relative[i, j] = 0.5 * (relative[i, j] + relative[j, i])
            relative[j, i] = relative[i, j]
    diagonalise(relative, vectors)
    for i in range(m):
        for j in range(i + 1, m):
            root[i, j] = 0.0
    multiply(root, vectors, factor)
    for j in range(m):
        deviation = sqrt(maximum(minimum(relative[j, j], 1.0 / settings[LEAST]), 1.0 / settings[MOST]))
        for i in range(m):
            factor[i, j] = factor[i, j] * deviation
    multiply_transposed(factor, factor, V)


def report_matrix(memory, settings, nominal, first, outputs):
    """Write mean, mode and variance of the precision matrix: a point estimate, with variance 0."""
    size = nominal.shape[0] * nominal.shape[0]
    for i in range(size):
        outputs[first + i] = memory[1 + size + i]
        outputs[first + size + i] = memory[1 + size + i]
        outputs[first + 2 * size + i] = 0.0
