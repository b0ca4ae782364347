"""Special functions for step functions, from operations that exist in every engine."""

LOG_2_PI = 1.8378770664093453
"""Constant in the logarithm of a normal density."""


def squared_gamma_half_step(a):
    """Return ``(Gamma(a + 1/2) / Gamma(a))**2`` for positive `a`, with a relative error of 1e-12.

    By the recurrence of the gamma function up to a + 8, its factors taken in pairs, and from there by its asymptotic series
    (Abramowitz and Stegun 6.1.47), the exponential of which is so near one that five terms give it.
    """
    p, q = a * (a + 7.0), a * (a + 8.0)
    above = (p * (p + 6.0)) * ((p + 10.0) * (p + 12.0))
    below = ((q + 3.75) * (q + 9.75)) * ((q + 13.75) * (q + 15.75))
    part = 1.0 / (a + 8.0)
    w = part * part
    s = part * (-0.125 + w * (1.0 / 192.0 + w * (-1.0 / 640.0 + w * (17.0 / 14336.0 - w * (31.0 / 18432.0)))))
    series = 1.0 + s * (1.0 + s * (0.5 + s * (1.0 / 6.0 + s * (1.0 / 24.0 + s * (1.0 / 120.0)))))
    step = series * (above / below)
    return (a + 8.0) * (step * step)
