"""How far a gradient step may go: the curvature of the free energy, a bound on its eigenvalues, and the step's fraction.

A step ``z <- z - fraction rate dF/dz`` multiplies an error in z = (mu, mu_u) by ``I - fraction diag(rate) H``, with H the second
derivatives of the free energy (those of g and f* left out, as Gauss and Newton do)::

    H = [G' P G + C   0]  +  [D' P_u D   -D' P_u],    C = P_x, or what the state prior moves the start by
        [0            0]     [-P_u D         P_u]

For symmetric H it shrinks while ``fraction`` times the largest eigenvalue of M = diag(sqrt(rate)) H diag(sqrt(rate)) is below 2.
M is the same in all units of states and controls, for rates have the square of a unit that H has one over.

That eigenvalue is at most ``||M^k||^(1/k)``, where ||.|| is the largest sum of magnitudes in a row (Gelfand), also if C is not
symmetric. With k = 1 that is Gershgorin's bound, up to sqrt(n) too large for n rows; each doubling of k, a squaring of the
matrix, takes the root of that factor. `largest_step` chooses the least k for which the nominal curvature, whose eigenvalues
are known to be stable, has a bound below 2, and takes that bound as the limit, or 1.9 if it is less. So

- a step at nominal curvature is never shortened;
- for symmetric H a step within the limit is stable, as its eigenvalues are below the bound, and the bound is below 2 (unless the
  nominal curvature itself is within a thousandth of 2);
- a step beyond it is shortened to ``1 / bound``: it ends at the minimum of the steepest direction, or before it.

The prediction of a Kalman or Euler prior makes H unsymmetric: `check_stable` then judges the nominal curvature by its own rule.
"""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.linalg.dense import add_product, multiply
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, maximum, select, sqrt
from bayesftc.cosim.types import Floats

USUAL_LIMIT = 1.9
"""Up to this no step is shortened, whatever the nominal curvature; from 2 on it may diverge."""

MOST_SQUARINGS = 10
"""Then the bound of n states and controls is at most n^(1/2048) times the eigenvalue: 0.1 % too large for ten."""


def curvature_of_belief(G, P, prior_curvature, PG, H):
    """Write the part of H that sensors and state prior make."""
    multiply(P, G, PG)
    add_product(prior_curvature, G, PG, H)


def curvature_of_control(D, Pu, PD, H):
    """Add the part of H that the control's error makes, which couples control and belief by D, the law's derivative."""
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
    """Return ``||M^k||^(1/k)`` with k = 2^squarings; `M` and `squared` are scratch of H's size."""
    n = H.shape[0]
    for j in range(n):
        for k in range(n):
            M[j, k] = root_rate[j] * H[j, k] * root_rate[k]
    norm = _row_sum(M)
    bound = norm
    for s in range(squarings):
        for j in range(n):
            for k in range(n):
                M[j, k] = M[j, k] / maximum(1e-300, norm)  # so that no power overflows; NaN stays
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
    """Return the fraction of a gradient step to take, at most 1; NaN, so that nothing moves, if H is not finite."""
    bound = bound_on_eigenvalues(H, root_rate, squarings, M, squared)
    return select(bound <= largest[0], 1.0, 1.0 / bound)


def largest_step(H: Floats, rates: Floats) -> tuple[float, int]:
    """Return up to which bound no step is shortened, and with how many squarings the bound is computed.

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
        bound = (1 + 1e-9) * float(  # rounding is no reason to shorten
            bound_on_eigenvalues(H, np.sqrt(rates), squarings, np.empty_like(H), np.empty_like(H))
        )
    return max(USUAL_LIMIT, bound), squarings


def check_stable(H: Floats, rates: Floats, remedy: str) -> None:
    """Compare the eigenvalues of rates times curvature with the limit of 2.

    Raises
    ------
    ModelError
        If one is too large; `remedy` is what to lower.
    """
    # A step multiplies the error by 1 - z: by less than one where |z|^2 < 2 Re z (a turning prediction makes z complex).
    with np.errstate(over="ignore"):
        steps = rates[:, np.newaxis] * H
    if not np.isfinite(steps).all():
        raise ModelError(f"The curvature of the free energy is beyond all numbers; lower {remedy} or the precisions.")
    z = np.linalg.eigvals(steps)
    z = z[z.real > 1e-9]  # in other directions no rate is too large
    largest = float((np.abs(z) ** 2 / z.real).max(initial=0.0))
    if not largest < 2.0:
        raise ModelError(
            f"The descent is unstable: rate times curvature of the free energy has an eigenvalue of {largest:.3g} at the "
            f"initial mean, and must stay below 2. Lower {remedy} or the precisions of the modalities."
        )
