"""How well a recording determines the parameters: standard errors, correlations, and what cannot be told apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.fitting.coloured import white_scores
from bayesftc.cosim.statistics._whiteness import FEW, whiteness
from bayesftc.cosim.types import Floats

LEAST = 1e-12
"""Smallest singular value, as a share of the largest: below is rounding. The standard error is then very large, not infinite."""

STRONGEST = 0.97
"""Largest coefficient of the prewhitening, as its authors recommend."""


@dataclass(frozen=True)
class Combination:
    """A direction in which the parameters can change together; its standard error, in units of the ranges' widths.

    Attributes
    ----------
    std : float
        Standard error along the direction. A uniform distribution over a range has 0.29.
    direction : dict of str to float
        The share of each parameter, in units of its range; the squares sum to 1.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from bayesftc import cosim, fmus
    >>> time = 0.1 * np.arange(300)
    >>> v = 20.0 * np.exp(-0.05 * time) + 0.1 * np.random.default_rng(0).standard_normal(300)
    >>> table, ranges = pd.DataFrame({"time": time, "v": v}), {"m": (50.0, 150.0), "b": (2.0, 8.0)}
    >>> car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})
    >>> combination = cosim.fit(car, table, ranges, outputs="v").profile[0]  # only b / m is determined
    >>> combination.std > 0.29, {name: round(share, 1) for name, share in combination.direction.items()}
    (True, {'m': 0.8, 'b': 0.6})
    """

    std: float
    direction: dict[str, float]


def is_correlated(residuals: Floats, white: float) -> list[bool]:
    """Return for each sensor whether its residuals depend on those before them, or on those of another sensor.

    The test in time is that of Ljung and Box. Residuals of two sensors are correlated if their correlation is beyond what white
    noise exceeds with the probability `white`.

    Parameters
    ----------
    residuals : ndarray, rows x sensors
        NaN where a sample does not count.
    white : float
        Probability below which they are correlated.
    """
    from scipy.stats import norm

    count = residuals.shape[1]
    many = [int(np.isfinite(column).sum()) >= FEW and np.nanstd(column) > 0 for column in residuals.T]
    found = [many[i] and whiteness(residuals[:, i])[0] < white for i in range(count)]
    for i in range(count):
        for j in range(i):
            both = np.isfinite(residuals[:, i]) & np.isfinite(residuals[:, j])
            if many[i] and many[j] and both.sum() >= FEW:
                shared = np.corrcoef(residuals[both, i], residuals[both, j])[0, 1]
                if 2 * norm.sf(abs(shared) * np.sqrt(both.sum())) < white:
                    found[i] = found[j] = True
    return found


def covariance(
    jacobian: Floats, residuals: Floats, output_of: np.ndarray[Any, np.dtype[np.int64]], *, correlated: bool
) -> Floats:
    """Return the covariance of the parameters at the optimum.

    With independent residuals of variance 1 it is the inverse of the Gauss-Newton matrix. Otherwise it is the sandwich with the
    long-run covariance of the scores (Newey and West, Econometrica 55, 1987; the number of lags by Andrews, Econometrica 59,
    1991), which `white_scores` has made nearly white. It holds for residuals that are correlated in time and between sensors.

    Parameters
    ----------
    jacobian : ndarray, rows x sensors x parameters
        Derivatives of the weighted residuals.
    residuals : ndarray, rows x sensors
        The weighted residuals.
    output_of : ndarray, sensors
        The number of each sensor's output.
    correlated : bool
        Whether they are correlated.
    """
    basis, sizes, axes = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[2]), full_matrices=False)
    least = LEAST * max(float(sizes[0]), np.finfo(float).tiny ** 0.25)
    known, unknown = axes[sizes > least], axes[sizes <= least]
    inverse = (known.T / sizes[sizes > least] ** 2) @ known
    # The scores of a direction without effect are 0, and would look certain.
    rest = unknown.T @ unknown / least**2
    if not correlated:
        return np.asarray(inverse + rest)
    basis = basis[:, sizes > least].reshape(*residuals.shape, -1)
    outputs = [output_of == output for output in np.unique(output_of)]
    scores = sum(white_scores(jacobian[:, of], residuals[:, of], basis[:, of]) for of in outputs)
    return np.asarray(long_run(scores @ inverse) + rest)


def long_run(scores: Floats) -> Floats:
    """Return the covariance of the sum of a series (rows x columns) that is correlated in time.

    Prewhitened by an autoregression of order one (Andrews and Monahan, Econometrica 60, 1992), without which the sum over lags
    is too small for strongly correlated series. It sees the first lag alone: not white noise beside a slow process.
    """
    r = np.clip(_autoregression(scores), -STRONGEST, STRONGEST)
    innovations = np.concatenate([scores[:1], scores[1:] - r * scores[:-1]])
    rho = _autoregression(innovations)
    alpha = float(np.mean(4 * rho**2 / ((1 - rho) * (1 + rho)) ** 2))
    lags = min(int(1.1447 * (alpha * len(scores)) ** (1 / 3)), len(scores) // 4)
    total = innovations.T @ innovations
    for lag in range(1, lags + 1):
        product = (1 - lag / (lags + 1)) * innovations[lag:].T @ innovations[:-lag]
        total = total + product + product.T
    return np.asarray(total / np.outer(1 - r, 1 - r))


def _autoregression(series: Floats) -> Floats:
    """Return each column's coefficient of an autoregression of order one."""
    power = np.sum(series[:-1] ** 2, axis=0)
    return np.asarray(np.sum(series[1:] * series[:-1], axis=0) / np.where(power > 0, power, 1.0))


def combinations(names: tuple[str, ...], covariance: Floats) -> tuple[Combination, ...]:
    """Return the principal directions of a covariance in units of the ranges, the least determined first."""
    variances, axes = np.linalg.eigh(covariance)
    found = []
    for variance, axis in sorted(zip(variances, axes.T, strict=True), key=lambda pair: -pair[0]):
        signed = axis * np.sign(axis[np.abs(axis).argmax()])
        found.append(Combination(float(np.sqrt(max(variance, 0.0))), dict(zip(names, signed.tolist(), strict=True))))
    return tuple(found)
