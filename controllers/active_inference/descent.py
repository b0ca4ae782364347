"""Step functions of active inference: prediction errors, precisions, free energy, its gradient, and a step along it."""

from bayesftc.controllers.linalg.dense import cholesky, solve_columns
from bayesftc.controllers.linalg.special import LOG_2_PI
from bayesftc.cosim.ops import absolute, both, log, maximum, minimum, select, sqrt

MEAN_CAP = 1e150
"""Largest magnitude of a state's mean, whose square does not overflow."""

STEP_CAP = 1e100
"""Largest magnitude of a mean after a gradient step, so that an absurd goal does not make the quadratic terms overflow."""


def read(y, expected, limit, e, present):
    """Write the errors ``y - expected``, limited to ``limit``; a sample that is not finite is missing, with the error 0."""
    for i in range(y.shape[0]):
        d = y[i] - expected[i]
        finite = d - d == 0.0
        present[i] = select(finite, 1.0, 0.0)
        e[i] = select(finite, maximum(minimum(d, limit[i]), -limit[i]), 0.0)


def weigh(R, used, sigma, gain, L, inverse, P):
    """Write the precisions ``P = S R^-1 S`` of the sensors in use, with S = diag(sqrt(gain) sigma); zero for the others.

    Returns
    -------
    float
        The logarithm of the determinant of P over the sensors in use.
    """
    m = R.shape[0]
    determinant = 0.0 * gain[0]
    for i in range(m):
        for j in range(m):
            alone = 1.0 if i == j else 0.0
            together = both(used[i] > 0.5, used[j] > 0.5)
            L[i, j] = select(together, R[i, j] / (sigma[i] * sigma[j]), alone)
            inverse[i, j] = alone
    cholesky(L, L)
    solve_columns(L, inverse)
    for i in range(m):
        determinant = determinant + select(used[i] > 0.5, log(gain[i]) - 2.0 * log(L[i, i]), 0.0)
        for j in range(i + 1):
            together = both(used[i] > 0.5, used[j] > 0.5)
            P[i, j] = select(together, inverse[i, j] * sqrt(gain[i] * gain[j]), 0.0)
            P[j, i] = P[i, j]
    return determinant


def prior_error(mean, predicted, eps_x):
    """Write ``eps_x = mean - predicted``."""
    for i in range(mean.shape[0]):
        eps_x[i] = mean[i] - predicted[i]


def quadratic(e, P, weighted):
    """Write ``P e`` into ``weighted`` and return ``e' P e``."""
    total = 0.0 * e[0]
    for i in range(e.shape[0]):
        t = P[i, 0] * e[0]
        for j in range(1, e.shape[0]):
            t = t + P[i, j] * e[j]
        weighted[i] = t
        total = total + e[i] * t
    return total


def belief_gradient(weighted, G, weighted_x, gradient):
    """Write the part of sensors and state prior in dF/dmu: ``P_x eps_x - G' P e``."""
    for j in range(gradient.shape[0]):
        total = weighted_x[j]
        for i in range(G.shape[0]):
            total = total - G[i, j] * weighted[i]
        gradient[j] = total


def add_control_gradient(weighted_u, D, gradient):
    """Add the part of the control's error in dF/dmu: ``-D' P_u eps_u``, with D the derivative of the control law."""
    for j in range(gradient.shape[0]):
        for i in range(D.shape[0]):
            gradient[j] = gradient[j] - D[i, j] * weighted_u[i]


def descend(fraction, rate, gradient, mean):
    """Move the means against the gradient; skip a step to a value that is not finite or too large."""
    for i in range(mean.shape[0]):
        moved = mean[i] - fraction * rate[i] * gradient[i]
        mean[i] = select(absolute(moved) <= STEP_CAP, moved, mean[i])


def free_energy_of(quadratics, determinant, used, means):
    """Return F = -ln p(mu_u, mu, y): half of the quadratic terms, minus the log-determinants, plus ln 2 pi for each error."""
    count = means[0]
    for i in range(used.shape[0]):
        count = count + used[i]
    return 0.5 * (quadratics - determinant + count * LOG_2_PI)


def predict_state(mean, u, A, B, predicted):
    """Write ``predicted = A mean + B u``; exactly the mean for a random walk."""
    for i in range(mean.shape[0]):
        total = A[i, 0] * mean[0]
        for j in range(1, mean.shape[0]):
            total = total + A[i, j] * mean[j]
        for j in range(u.shape[0]):
            total = total + B[i, j] * u[j]
        predicted[i] = maximum(minimum(total, MEAN_CAP), -MEAN_CAP)


def act(mu_u, applied, u):
    """Apply the control's mean; where it is not finite, keep the last control and reset the mean to it."""
    for i in range(u.shape[0]):
        applied[i] = select(mu_u[i] - mu_u[i] == 0.0, mu_u[i], applied[i])
        mu_u[i] = applied[i]
        u[i] = applied[i]


def place(part, first, whole):
    """Copy a vector into a longer one, from element `first` on."""
    for i in range(part.shape[0]):
        whole[first + i] = part[i]


def place_rows(part, first, whole):
    """Copy a matrix into one of more rows, from row `first` on."""
    for i in range(part.shape[0]):
        for j in range(part.shape[1]):
            whole[first + i, j] = part[i, j]
