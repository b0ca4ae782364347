"""The states of a recording with gaps: forward by Kalman, backward by Rauch, Tung and Striebel."""

from bayesftc.controllers.linalg.dense import apply, cholesky, congruence, multiply, solve_columns
from bayesftc.cosim.ops import log

_VECTOR, _TABLE, _TABLES = "float64[::1]", "float64[:, ::1]", "float64[:, :, ::1]"
_TYPES = [_TABLE] * 5 + [_VECTOR] + [_TABLE, _TABLES] * 2 + [_TABLE, _TABLES]
SMOOTH = f"float64({', '.join(_TYPES)})"
"""Types for which `smooth` is compiled."""

CALLS = (multiply, congruence, apply, cholesky, solve_columns)
"""Functions that it calls."""

TWO_PI = 6.283185307179586


def smooth(y, drive, A, C, Q, R, ahead, P_ahead, x, P, between, space):
    """Write means and covariances of the states given all samples; return the samples' log density.

    Parameters
    ----------
    y : array, steps x outputs
        Samples minus the model's offset; NaN where there is none.
    drive : array, steps x states
        Effect of inputs and drift on the state until the next step.
    A, C, Q : array
        Transition, outputs of the state, covariance of the process noise.
    R : array
        Variances of the outputs' noise.
    ahead, P_ahead : array, (steps + 1) x states, (steps + 1) x states x states
        The first element is the state before the first sample. Written: the states given the samples before theirs.
    x, P : array, steps x states, steps x states x states
        Written: the states given all samples.
    between : array, states x states
        Increased by the covariances of each state after the first with the one before it, given all samples.
    space : array, 5 x states x states
        Scratch space.
    """
    steps, m, n = y.shape[0], y.shape[1], A.shape[0]
    gain, work, lower, change, column = space[0], space[1], space[2], space[3], space[4, 0]
    total = 0.0
    for k in range(steps):
        for i in range(n):
            x[k, i] = ahead[k, i]
            for j in range(n):
                P[k, i, j] = P_ahead[k, i, j]
        for s in range(m):  # one sensor after the other, because their noises are independent
            if y[k, s] == y[k, s]:
                e, spread = y[k, s], R[s]
                for i in range(n):
                    e = e - C[s, i] * x[k, i]
                    column[i] = 0.0
                    for j in range(n):
                        column[i] = column[i] + P[k, i, j] * C[s, j]
                for i in range(n):
                    spread = spread + C[s, i] * column[i]
                for i in range(n):
                    x[k, i] = x[k, i] + column[i] * (e / spread)
                    for j in range(n):
                        P[k, i, j] = P[k, i, j] - column[i] * column[j] / spread
                total = total - 0.5 * (log(TWO_PI * spread) + e * e / spread)
        apply(A, x[k], ahead[k + 1])
        congruence(A, P[k], work, P_ahead[k + 1])
        for i in range(n):
            ahead[k + 1, i] = ahead[k + 1, i] + drive[k, i]
            for j in range(n):
                P_ahead[k + 1, i, j] = P_ahead[k + 1, i, j] + Q[i, j]
    for back in range(1, steps):
        k = steps - 1 - back
        # The transpose of the gain: P_ahead^-1 A P.
        cholesky(P_ahead[k + 1], lower)
        multiply(A, P[k], gain)
        solve_columns(lower, gain)
        for i in range(n):
            column[i] = x[k + 1, i] - ahead[k + 1, i]
            for j in range(n):
                change[i, j] = P[k + 1, i, j] - P_ahead[k + 1, i, j]
        for i in range(n):
            for j in range(n):
                x[k, i] = x[k, i] + gain[j, i] * column[j]
        multiply(P[k + 1], gain, work)
        for i in range(n):
            for j in range(n):
                between[i, j] = between[i, j] + work[i, j]
        multiply(change, gain, work)
        for i in range(n):
            for j in range(n):
                add = 0.0
                for a in range(n):
                    add = add + gain[a, i] * work[a, j]
                P[k, i, j] = P[k, i, j] + add
    return total
