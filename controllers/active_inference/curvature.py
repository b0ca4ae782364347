"""Stable gradient steps: the curvature of the free energy, a bound on its eigenvalues, and the step's fraction.

A step ``z <- z - fraction rate dF/dz`` multiplies an error in z = (mu, mu_u) by ``I - fraction diag(rate) H``. H has the second
derivatives of the free energy, without those of g and f* (as in Gauss-Newton)::

    H = [G' P G + C   0]  +  [D' P_u D   -D' P_u],    C = P_x, or the prior's shift of the start
        [0            0]     [-P_u D         P_u]

For symmetric H the error decreases while ``fraction`` times the largest eigenvalue of M = diag(sqrt(rate)) H diag(sqrt(rate)) is
below 2. M does not depend on the units of states and controls: rates have the square of a unit, and H its inverse.

That eigenvalue is at most ``||M^k||^(1/k)``, where ||.|| is the largest sum of magnitudes in a row (Gelfand), also if C is not
symmetric. With k = 1 that is Gershgorin's bound, up to a factor sqrt(n) too large for n rows. Each squaring of the matrix doubles
k and takes the root of that factor. `largest_step` chooses the least k for which the nominal curvature, whose eigenvalues are
stable, has a bound below 2. The limit is that bound, or 1.9 if it is less. Therefore

- a step at nominal curvature is never shortened;
- for symmetric H a step within the limit is stable, as its eigenvalues are below the bound, and the bound is below 2 (unless the
  nominal curvature itself is within a thousandth of 2);
- a step beyond it is shortened to ``1 / bound``, and ends at the minimum of the steepest direction or before it.

The prediction of a Kalman or Euler prior makes H unsymmetric; `check_stable` has a rule for that case.
"""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.linalg.dense import add_product, multiply
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, maximum, select, sqrt
from bayesftc.cosim.types import Floats

USUAL_LIMIT = 1.9
"""Bound up to which no step is shortened, whatever the nominal curvature; from 2 on steps may diverge."""

MOST_SQUARINGS = 10
"""With these the bound for n states and controls is at most n^(1/2048) times the eigenvalue: 0.1 % too large for ten."""


def curvature_of_belief(G, P, prior_curvature, PG, H):
    """Write the part of sensors and state prior in H."""
    multiply(P, G, PG)
    add_product(prior_curvature, G, PG, H)


def curvature_of_control(D, Pu, PD, H):
    """Add the part of the control's error in H, which couples control and belief by D, the law's derivative."""
    multiply(Pu, D, PD)
    n = D.shape[1]
    for j in range(n):
        for k in range(n):
            for i in range(D.shape[0]):
                H[j, k] = H[j, k] + D[i, j] * PD[i, k]
    for i in range(D.shape[0]):
        for k in range(n):
            H[n + i, k] = -PD[i, k]
            H[k, n + i] = -PD[i, k]
        for j in range(D.shape[0]):
            H[n + i, n + j] = Pu[i, j]


def _row_sum(M):
    """Return the largest sum of magnitudes in a row; NaN if an entry is not finite."""
    worst = 0.0 * M[0, 0]
    for j in range(M.shape[0]):
        total = 0.0 * worst
        for k in range(M.shape[1]):
            total = total + absolute(M[j, k])
        worst = maximum(total, worst) + 0.0 * total
    return worst


def bound_on_eigenvalues(H, root_rate, squarings, M, squared):
    """Return ``||M^k||^(1/k)`` with k = 2^squarings; `M` and `squared` are scratch space of H's size."""
    n = H.shape[0]
    for j in range(n):
        for k in range(n):
            M[j, k] = root_rate[j] * H[j, k] * root_rate[k]
    norm = _row_sum(M)
    bound = norm
    for s in range(squarings):
        for j in range(n):
            for k in range(n):
                M[j, k] = M[j, k] / maximum(1e-300, norm)  # avoids overflow of the powers; keeps NaN
        multiply(M, M, squared)
        for j in range(n):
            for k in range(n):
                M[j, k] = squared[j, k]
        norm = _row_sum(M)
        root = norm
        for _ in range(s + 1):
            root = sqrt(root)
        bound = bound * root
    return bound


def shortening(H, root_rate, largest, squarings, M, squared):
    """Return the fraction of a gradient step, at most 1; if H is not finite, NaN, so that nothing moves."""
    bound = bound_on_eigenvalues(H, root_rate, squarings, M, squared)
    return select(bound <= largest[0], 1.0, 1.0 / bound)


def largest_step(H: Floats, rates: Floats) -> tuple[float, int]:
    """Return the bound up to which no step is shortened, and the number of squarings for the bound.

    Parameters
    ----------
    H : ndarray, shape (n, n)
        The nominal curvature.
    rates : ndarray, shape (n,)
        Rates of descent, per sample.
    """
    bound, squarings = np.inf, -1
    while not bound < 2.0 and squarings < MOST_SQUARINGS:
        squarings += 1
        bound = (1 + 1e-9) * float(  # margin for rounding
            bound_on_eigenvalues(H, np.sqrt(rates), squarings, np.empty_like(H), np.empty_like(H))
        )
    return max(USUAL_LIMIT, bound), squarings


def check_stable(H: Floats, rates: Floats, remedy: str) -> None:
    """Compare the eigenvalues of rates times curvature with the limit of 2.

    Raises
    ------
    ModelError
        If one is too large; `remedy` names the settings to lower.
    """
    # A step multiplies the error by 1 - z, whose magnitude is below 1 if |z|^2 < 2 Re z (a rotating prediction makes z complex).
    with np.errstate(over="ignore"):
        steps = rates[:, np.newaxis] * H
    if not np.isfinite(steps).all():
        raise ModelError(f"The curvature of the free energy is not finite; lower {remedy} or the precisions.")
    z = np.linalg.eigvals(steps)
    z = z[z.real > 1e-9]  # other directions do not limit the rates
    largest = float((np.abs(z) ** 2 / z.real).max(initial=0.0))
    if not largest < 2.0:
        raise ModelError(
            f"The descent is unstable: rate times curvature of the free energy has an eigenvalue of {largest:.3g} at the initial "
            f"mean, but the limit is 2. Lower {remedy} or the precisions of the modalities."
        )
