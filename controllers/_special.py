"""Special functions in step functions, from the operations that every form of them has."""

from bayesftc.cosim.ops import absolute, exp, log, maximum

SHIFT = 8


def log_gamma_half_step(a):
    """Return ``log(Gamma(a + 1/2) / Gamma(a))`` for positive `a`, to 1e-12.

    By the recurrence of the gamma function up to `SHIFT`, and from there by its asymptotic series (Abramowitz and Stegun 6.1.47).
    """
    ratio = 1.0 + 0.0 * a
    for k in range(SHIFT):
        ratio = ratio * (a + (k + 0.5)) / (a + k)
    z = a + SHIFT
    w = 1.0 / (z * z)
    series = (-0.125 + w * (1.0 / 192.0 + w * (-1.0 / 640.0 + w * (17.0 / 14336.0 - w * (31.0 / 18432.0))))) / z
    return 0.5 * log(z) + series - log(ratio)


def log_sum(a, b):
    """Return ``log(exp(a) + exp(b))`` of two finite numbers, whose exponentials need not be."""
    return maximum(a, b) + log(1.0 + exp(-absolute(a - b)))
