"""Dense linear algebra in scalar loops, for step functions: results go into given arrays, without allocation."""

from bayesftc.cosim.ops import maximum, select, sqrt

NAN = float("nan")


def multiply(a, b, out):
    """``out = a @ b``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = a[i, 0] * b[0, j]
            for k in range(1, a.shape[1]):
                total = total + a[i, k] * b[k, j]
            out[i, j] = total


def multiply_transposed(a, b, out):
    """``out = a @ b.T``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = a[i, 0] * b[j, 0]
            for k in range(1, a.shape[1]):
                total = total + a[i, k] * b[j, k]
            out[i, j] = total


def add_product(c, a, b, out):
    """``out = c + a.T @ b``."""
    for i in range(a.shape[1]):
        for j in range(b.shape[1]):
            total = c[i, j]
            for k in range(a.shape[0]):
                total = total + a[k, i] * b[k, j]
            out[i, j] = total


def congruence(a, p, work, out):
    """``out = a @ p @ a.T`` for symmetric `p`: exactly symmetric. `work` has the shape of `a`; `out` may be `p`."""
    multiply(a, p, work)
    for i in range(a.shape[0]):
        for j in range(i + 1):
            total = work[i, 0] * a[j, 0]
            for k in range(1, a.shape[1]):
                total = total + work[i, k] * a[j, k]
            out[i, j] = total
            out[j, i] = total


def apply(a, x, out):
    """``out = a @ x`` for a vector `x`."""
    for i in range(a.shape[0]):
        total = a[i, 0] * x[0]
        for k in range(1, a.shape[1]):
            total = total + a[i, k] * x[k]
        out[i] = total


def cholesky(a, lower):
    """Write the lower Cholesky factor of the symmetric positive definite `a` into `lower` (which may be `a`)."""
    for j in range(a.shape[0]):
        d = a[j, j]
        for k in range(j):
            d = d - lower[j, k] * lower[j, k]
        d = sqrt(d)
        lower[j, j] = d
        for i in range(j + 1, a.shape[0]):
            t = a[i, j]
            for k in range(j):
                t = t - lower[i, k] * lower[j, k]
            lower[i, j] = t / d


def cholesky_determined(a, tolerance, lower):
    """As `cholesky`, but all NaN if a pivot is at most `tolerance` times its diagonal: `a` is singular."""
    for j in range(a.shape[0]):
        least = tolerance * a[j, j]
        d = a[j, j]
        for k in range(j):
            d = d - lower[j, k] * lower[j, k]
        d = sqrt(select(d > least, d, NAN))
        lower[j, j] = d
        for i in range(j + 1, a.shape[0]):
            t = a[i, j]
            for k in range(j):
                t = t - lower[i, k] * lower[j, k]
            lower[i, j] = t / d


def cholesky_semidefinite(a, lower):
    """Write a lower factor of the positive semi-definite `a` into `lower`, with a column of zeros for each missing rank."""
    n = a.shape[0]
    for j in range(n):
        d = a[j, j]
        for k in range(j):
            d = d - lower[j, k] * lower[j, k]
        positive = d > 1e-14 * a[j, j]
        d = sqrt(maximum(d, 0.0))
        for i in range(n):
            if i < j:
                lower[i, j] = 0.0
            elif i == j:
                lower[i, j] = select(positive, d, 0.0)
            else:
                t = a[i, j]
                for k in range(j):
                    t = t - lower[i, k] * lower[j, k]
                lower[i, j] = select(positive, t / d, 0.0)


def whiten(lower, rows, values):
    """Replace the equations ``rows @ x = values`` with noise of the factor `lower` by ones with independent unit noise."""
    for i in range(lower.shape[0]):
        for k in range(i):
            values[i] = values[i] - lower[i, k] * values[k]
            for j in range(rows.shape[1]):
                rows[i, j] = rows[i, j] - lower[i, k] * rows[k, j]
        values[i] = values[i] / lower[i, i]
        for j in range(rows.shape[1]):
            rows[i, j] = rows[i, j] / lower[i, i]


def solve_columns(lower, b):
    """Replace `b` (rows x columns) by the solution of ``lower @ lower.T @ x = b``."""
    n = lower.shape[0]
    for c in range(b.shape[1]):
        for i in range(n):
            t = b[i, c]
            for k in range(i):
                t = t - lower[i, k] * b[k, c]
            b[i, c] = t / lower[i, i]
        for j in range(n):
            i = n - 1 - j
            t = b[i, c]
            for k in range(i + 1, n):
                t = t - lower[k, i] * b[k, c]
            b[i, c] = t / lower[i, i]


def solve_vector(lower, b):
    """Replace the vector `b` by the solution of ``lower @ lower.T @ x = b``."""
    n = lower.shape[0]
    for i in range(n):
        t = b[i]
        for k in range(i):
            t = t - lower[i, k] * b[k]
        b[i] = t / lower[i, i]
    for j in range(n):
        i = n - 1 - j
        t = b[i]
        for k in range(i + 1, n):
            t = t - lower[k, i] * b[k]
        b[i] = t / lower[i, i]
