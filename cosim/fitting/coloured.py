"""Coloured noise of a fit: its spectrum as that of an ARMA(1, 1), and scores that are nearly white."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.types import Floats

LONGEST = 0.2
"""Longest time constant of the noise, as a share of the recording: of a longer one there are too few times to see its size."""

BINS = 80
"""Number of groups of neighbouring frequencies, about as many in each factor of frequency: the spectrum is smooth."""

GRID = 14
"""Number of poles with which the search for the likeliest begins: each has about twice the time constant of the one before."""


def white_scores(jacobian: Floats, residuals: Floats, basis: Floats) -> Floats:
    """Return scores (rows x parameters) with the sum of ``J^T r`` that are nearly white.

    The filter that makes the residuals' sum over the sensors white is applied to the residuals. Its adjoint inverse is applied
    to the derivatives, backward in time, so that the sum stays the same for any filter.

    Parameters
    ----------
    jacobian : ndarray, rows x sensors x parameters
        Derivatives of the weighted residuals of an output's sensors.
    residuals : ndarray, rows x sensors
        The weighted residuals.
    basis : ndarray, rows x sensors x parameters
        An orthonormal basis of the derivatives of all outputs.
    """
    from scipy.signal import lfilter

    together = basis.sum(axis=1) / np.sqrt(basis.shape[1])
    taken = np.sum(np.abs(np.fft.rfft(together, axis=0)[1:]) ** 2, axis=1) / len(together)
    pole, zero = arma(residuals.sum(axis=1), taken)
    white = lfilter([1.0, -pole], [1.0, zero], residuals, axis=0)
    effects = lfilter([1.0, zero], [1.0, -pole], jacobian[::-1], axis=0)[::-1]
    return np.asarray(np.einsum("kcp,kc->kp", effects, white))


def arma(series: Floats, taken: Floats) -> tuple[float, float]:
    """Return pole and zero of the ARMA(1, 1) of a series; 0 and 0 if it is no better than white noise by Schwarz's criterion.

    White noise with a slow process beside it has the spectrum of an ARMA(1, 1). It maximises the likelihood of the periodogram
    (Whittle, Arkiv for Matematik 2, 1953).

    Parameters
    ----------
    series : ndarray
        Residuals ``e[k]``, with ``e[k] = pole e[k-1] + w[k] + zero w[k-1]`` of white noise w.
    taken : ndarray
        The share of each frequency that the fit has taken out of the noise.
    """
    from scipy.optimize import minimize

    power, left = np.abs(np.fft.rfft(series)[1:]) ** 2, np.maximum(1.0 - taken, 0.0)
    if not power.any():
        return 0.0, 0.0
    begins = np.unique(np.geomspace(1, len(power), BINS).astype(int)) - 1
    power, left, cosine, count = (
        np.add.reduceat(of, begins)
        for of in (power, left, np.cos(2 * np.pi * np.arange(1, len(power) + 1) / len(series)), np.ones(len(power)))
    )
    cosine, left = cosine / count, left / left.sum()

    def surprise(pole: Floats, zero: Floats) -> Floats:
        """Return -2 times the log-likelihood of a sample, up to a constant, with the likeliest variance."""
        pole, zero = pole[..., None], zero[..., None]
        spectrum = (1 + zero**2 + 2 * zero * cosine) / (1 + pole**2 - 2 * pole * cosine)
        return np.asarray(np.log(np.sum(power / spectrum, axis=-1)) + np.sum(left * np.log(spectrum), axis=-1))

    most = 1.0 - 1.0 / max(LONGEST * len(series), 2.0)
    slow = 1.0 - np.geomspace(1.0, 1.0 - most, GRID)
    poles, zeros = np.meshgrid(np.r_[-slow[:0:-1], slow], np.r_[-slow[:0:-1], slow])
    best = np.argmin(surprise(poles, zeros))
    start = np.arctanh(np.array([poles.flat[best], zeros.flat[best]]) * 0.999 / most)
    end = minimize(lambda at: float(surprise(*(most * np.tanh(at)))), start, method="Nelder-Mead")
    none = float(surprise(np.zeros(1), np.zeros(1))[0])
    if len(series) * (none - end.fun) < 2 * np.log(len(series)):
        return 0.0, 0.0
    pole, zero = most * np.tanh(end.x)
    return float(pole), float(zero)
