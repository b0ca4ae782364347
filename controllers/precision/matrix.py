"""The Wishart distribution over the sensors' precision matrix in the memory of learners of a full covariance."""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.linalg.dense import cholesky, cholesky_semidefinite
from bayesftc.controllers.precision.base import ERROR_CAP, RATE_FLOOR
from bayesftc.controllers.signals import port
from bayesftc.cosim.ops import either, maximum, select, sqrt
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

# Settings of the learner. The prior's V^-1 is PRIOR times the nominal covariance; n decays towards TOWARDS; the expected
# covariance is V^-1 / (n - LESS).
FORGETTING, PRIOR, TOWARDS, TO_PRIOR, LESS, BELIEF, SLOPE, INTERCEPT = range(8)

LOOSENING = 1e-12
"""Relative decrease of the correlations in each step: far above a step's rounding, far below any visible effect.

It keeps ``V^-1 - LOOSENING * diag(V^-1)`` positive definite, so that rounding cannot make V^-1 indefinite, even
after a sample of 1e6 standard deviations or if sensors agree exactly (Demmel, LAPACK working note 14, 1989).
"""


def any_of(present):
    """Return 1 if any sensor has a sample, else 0."""
    any_present = present[0]
    for i in range(1, present.shape[0]):
        any_present = maximum(any_present, present[i])
    return any_present


def forget(any_present, memory, settings, nominal):
    """Let degrees of freedom and inverse scale decay. ``memory``: n, V^-1, V.

    Without any sample a distribution that decays towards zero remains as it is.
    """
    m = nominal.shape[0]
    rho = select(either(any_present > 0.5, settings[TO_PRIOR] > 0.5), settings[FORGETTING], 1.0)
    memory[0] = rho * memory[0] + (1.0 - rho) * settings[TOWARDS]
    back = settings[TO_PRIOR] * (1.0 - rho) * settings[PRIOR]
    for i in range(m):
        for j in range(m):
            at = 1 + i * m + j
            memory[at] = rho * memory[at] + back * nominal[i, j]


def complete(present, memory, settings, nominal, T, Z, S):
    """Complete the squared errors `T` of the present sensors to expected ones of all sensors.

    The missing sensors are regressed on the present ones by the expected covariance so far. With G = S_mp S_pp^-1 and T the
    squared errors of the present ones, the result is ``[T, T G'; G T, G T G' + S_mm - G S_pm]``, the variational Bayes update for
    missing data. It does not change the expected covariance of the missing sensors given the present ones, and the present ones
    learn as they would alone. The computation uses factors, so that the result cannot become indefinite. `Z` and `S` are scratch
    space.
    """
    m = nominal.shape[0]
    for i in range(m):
        for j in range(m):
            T[i, j] = select(present[i] * present[j] > 0.5, T[i, j], 0.0)
            S[i, j] = memory[1 + i * m + j] / (memory[0] - settings[LESS])
    cholesky_semidefinite(T, Z)
    for i in range(m):
        most = ERROR_CAP * nominal[i, i]
        shorten = sqrt(most / maximum(T[i, i], most))
        for c in range(m):
            Z[i, c] = shorten * Z[i, c]
            T[i, c] = Z[i, c]  # not explained by the sensors eliminated so far
    for k in range(m):
        for i in range(m):
            if i != k:
                g = select(present[k] > 0.5, S[i, k] / S[k, k], 0.0)
                for j in range(m):
                    S[i, j] = S[i, j] - g * S[k, j]
                    T[i, j] = T[i, j] - g * T[k, j]
        for j in range(m):
            S[k, j] = select(present[k] > 0.5, 0.0, S[k, j])
            S[j, k] = select(present[k] > 0.5, 0.0, S[j, k])
    for i in range(m):
        for c in range(m):
            Z[i, c] = select(present[i] > 0.5, Z[i, c], -T[i, c])
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for c in range(m):
                total = total + Z[i, c] * Z[j, c]
            T[i, j] = total
            T[j, i] = total


def learn_errors(any_present, T, memory, settings, nominal):
    """Add the squared errors `T` to the inverse scale, and keep it positive definite: see `LOOSENING`."""
    m = nominal.shape[0]
    memory[0] = memory[0] + any_present
    for i in range(m):
        for j in range(m):
            at = 1 + i * m + j
            total = memory[at] + select(any_present > 0.5, T[i, j], 0.0)
            least = RATE_FLOOR * settings[PRIOR] * nominal[i, i]
            memory[at] = maximum(total, least) if i == j else (1.0 - LOOSENING) * total


def expected_covariance(present, memory, settings, R, used, precision, beta):
    """Write the sensor covariance in use, V^-1 / (n - LESS), and the rate of each sensor's marginal, half its V^-1."""
    m = R.shape[0]
    for i in range(m):
        for j in range(m):
            R[i, j] = memory[1 + i * m + j] / (memory[0] - settings[LESS])
        used[i] = present[i]
        precision[i] = 1.0 / R[i, i]
        beta[i] = 0.5 * memory[1 + i * m + i]


def invert(memory, lower, inverse):
    """Write the scale V after its inverse, as the product of a triangular matrix with its transpose."""
    m = lower.shape[0]
    for i in range(m):
        for j in range(m):
            lower[i, j] = memory[1 + i * m + j]
    cholesky(lower, lower)
    for c in range(m):
        for i in range(m):
            total = 1.0 if i == c else 0.0
            for k in range(c, i):
                total = total - lower[i, k] * inverse[k, c]
            inverse[i, c] = total / lower[i, i] if i >= c else 0.0 * lower[i, i]
    for i in range(m):
        for j in range(m):
            total = inverse[m - 1, i] * inverse[m - 1, j]
            for k in range(m - 1):
                total = total + inverse[k, i] * inverse[k, j]
            memory[1 + m * m + i * m + j] = total


def report_wishart(memory, settings, nominal, first, outputs):
    """Write degrees of freedom n, scale V, mean n V, mode (n - m - 1) V and variance n (V_ij^2 + V_ii V_jj)."""
    m = nominal.shape[0]
    n, size, last = memory[0], m * m, memory.shape[0]
    outputs[first] = n
    for i in range(m):
        for j in range(m):
            at = first + 1 + i * m + j
            v = memory[last - size + i * m + j]
            outputs[at] = v
            outputs[at + size] = n * v
            outputs[at + 2 * size] = maximum(n - m - 1.0, 0.0) * v
            outputs[at + 3 * size] = n * (v * v + memory[last - size + i * m + i] * memory[last - size + j * m + j])


def wishart_ports(sensors: int) -> tuple[Port, ...]:
    """Return the ports for the moments of the distribution."""
    names = ("scale", "mean", "mode", "variance")
    return (port("precision_degrees_of_freedom"), *(port(f"precision_{name}", (sensors, sensors)) for name in names))


def prior_memory(degrees: float, inverse_scale: Floats) -> Floats:
    """Return the memory before the first sample."""
    V = np.linalg.inv(inverse_scale)
    return np.concatenate([[degrees], inverse_scale.ravel(), ((V + V.T) / 2).ravel()])
