"""Eigenvalues of symmetric matrices in scalar loops, by Jacobi's rotations (Golub and Van Loan, Matrix Computations, 8.5)."""

from bayesftc.cosim.ops import absolute, select, sqrt

SWEEPS = 8
"""Sweeps over all pairs. Convergence is quadratic: up to 20 rows only rounding remains off the diagonal."""

NEGLIGIBLE = 1e-36
"""Square of an element that counts as zero, relative to those on the diagonal (Demmel and Veselic 1992)."""


def diagonalise(a, vectors):
    """Transform the symmetric `a` into the diagonal matrix of its eigenvalues, and write the eigenvectors as columns."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            vectors[i, j] = 1.0 if i == j else 0.0
    sweeps = 1 if n < 3 else SWEEPS
    for _ in range(sweeps):
        for p in range(n - 1):
            for q in range(p + 1, n):
                _rotate(a, vectors, p, q)


def _rotate(a, vectors, p, q):
    """Rotate the coordinates p and q so that ``a[p, q]`` vanishes."""
    n = a.shape[0]
    off = a[p, q]
    none = off * off <= NEGLIGIBLE * absolute(a[p, p] * a[q, q])
    theta = 0.5 * (a[q, q] - a[p, p]) / select(none, 1.0, off)
    tangent = 1.0 / (absolute(theta) + sqrt(theta * theta + 1.0))
    tangent = select(none, 0.0, select(theta < 0.0, -tangent, tangent))
    c = 1.0 / sqrt(tangent * tangent + 1.0)
    s = tangent * c
    a[p, p] = a[p, p] - tangent * off
    a[q, q] = a[q, q] + tangent * off
    a[p, q] = 0.0 * off
    a[q, p] = 0.0 * off
    for k in range(n):
        if k != p and k != q:
            first, second = a[k, p], a[k, q]
            a[k, p] = c * first - s * second
            a[p, k] = a[k, p]
            a[k, q] = s * first + c * second
            a[q, k] = a[k, q]
        first, second = vectors[k, p], vectors[k, q]
        vectors[k, p] = c * first - s * second
        vectors[k, q] = s * first + c * second
