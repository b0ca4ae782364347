"""Thresholds for any distribution of the residual, by Chebyshev's inequality with moments of healthy data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.models.checks import (
    as_covariance,
    as_numbers,
    as_vector,
    check_choice,
    check_number,
    refuse_missing,
)
from bayesftc.controllers.thresholds.healthy import why_unhealthy
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class FittedThreshold:
    """A threshold on the Mahalanobis distance ``d_M = sqrt((r - mean)' covariance^-1 (r - mean))`` of a residual r.

    Made by `ChebyshevThreshold.fit`. It contains plain numbers, and can be compared, pickled and written into a scenario file.

    Parameters
    ----------
    mean : sequence of n numbers
        Mean of the healthy residual.
    covariance : n rows of n numbers
        Covariance of the healthy residual.
    bound : float
        Least distance of a residual that counts as faulty.

    Raises
    ------
    ModelError
        If the sizes differ, the covariance is not positive definite, or the bound is not positive.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> threshold = controllers.FittedThreshold(mean=(0.0,), covariance=((0.05,),), bound=10.0)
    >>> learner = controllers.ExplicitDetection(threshold=threshold)
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> step(y=[2.0, 2.5], u=0.0).detected.tolist()  # 2.5 is 11 standard deviations
    [0.0, 1.0]
    """

    mean: Sequence[float]
    covariance: Sequence[Sequence[float]]
    bound: float

    def __post_init__(self) -> None:
        mean = as_vector("The threshold's mean", self.mean, np.size(self.mean))
        covariance = as_covariance("The threshold's covariance", self.covariance, mean.size)
        check_number(self, "bound", above=0, finite=False)
        object.__setattr__(self, "mean", tuple(mean.tolist()))
        object.__setattr__(self, "covariance", tuple(map(tuple, covariance.tolist())))
        object.__setattr__(self, "bound", float(self.bound))

    @property
    def size(self) -> int:
        """Number n of the residual's elements."""
        return len(self.mean)

    def distance(self, residual: ArrayLike) -> Floats:
        """Return the Mahalanobis distance of residuals; NaN where an element is missing.

        Parameters
        ----------
        residual : array, shape (..., n)
            The residuals; for n = 1 the last axis may be missing.
        """
        r = np.asarray(residual, dtype=np.float64)
        if self.size == 1 and (r.ndim < 2 or r.shape[-1] != 1):
            r = r[..., None]
        if r.ndim == 0 or r.shape[-1] != self.size:
            raise ModelError(
                f"The residual has the shape {r.shape}, but the threshold is for {self.size} elements; put the elements along "
                "the last axis."
            )
        centred = (r - np.asarray(self.mean)).reshape(-1, self.size).T
        whitened = np.linalg.solve(np.linalg.cholesky(np.asarray(self.covariance)), centred)
        return np.asarray(np.sqrt(np.sum(whitened**2, axis=0)).reshape(r.shape[:-1]))

    def exceeds(self, residual: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return whether the distance is at least the bound; False where an element is missing.

        Parameters
        ----------
        residual : array, shape (..., n)
            As for `distance`.
        """
        return self.distance(residual) >= self.bound


@dataclass(frozen=True)
class ChebyshevThreshold:
    """Learns a threshold that a healthy residual exceeds with at most the probability `alpha`, for any distribution.

    By the multivariate Chebyshev inequality, ``Pr[d_M^2 >= n / alpha] <= alpha`` for every distribution of n elements with this
    mean and covariance. The moments are those of the samples, so the bound is as accurate as these.

    Parameters
    ----------
    alpha : float
        Bound on the false-alarm rate, in (0, 1).
    form : {"robust", "printed"}
        ``"robust"`` sets the threshold on d_M to sqrt(n / alpha). ``"printed"`` sets it to n / alpha, as printed in the paper's
        predecessor, which is far looser.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> healthy = 0.2 * np.random.default_rng(0).standard_normal((1000, 2))  # in practice a recorded innovation
    >>> threshold = controllers.ChebyshevThreshold(alpha=0.01).fit(healthy)
    >>> round(threshold.bound, 2), np.sqrt(np.diag(threshold.covariance)).round(1).tolist()
    (14.14, [0.2, 0.2])
    """

    alpha: float = 0.01
    form: Literal["robust", "printed"] = "robust"

    def __post_init__(self) -> None:
        check_number(self, "alpha", above=0, below=1)
        check_choice(self, "form", "robust", "printed")

    def fit(self, residuals: ArrayLike, faulty: ArrayLike | None = None) -> FittedThreshold:
        """Return the threshold learned from healthy residuals.

        Parameters
        ----------
        residuals : array, shape (N, n) or (N,)
            The residuals in order of time. There must be more than n / alpha. With fewer, a new sample is the most extreme of
            all more often than `alpha`, so that no threshold learned from them can guarantee it (Stellato et al., The American
            Statistician 71, 2017).
        faulty : array of bool, shape (N,), optional
            Whether a fault was present, if known; all must be False.

        Raises
        ------
        ModelError
            If there are too few samples, some are not finite, their covariance is singular, or they are evidently faulty. They
            are if labelled so, if a run of equal values is too long for chance, or if more than 5 % are beyond 5 robust standard
            deviations or 2 % beyond 10. They also are if level or spread in one twentieth of the record (at least 50 samples)
            differs from that of another part.

        Notes
        -----
        The rules against faulty samples do not depend on `alpha`. They refused none of 200 healthy records of each kind, with
        1000 and with 2000 samples: normal, Laplace, log-normal and Student's t noise (3 degrees of freedom), correlated noise
        (0.9 from sample to sample), and the shipped car on four references. Of faulty records of that car (freeze, injection of 3
        to 20 standard deviations, drift of 2 or 5 a second, tenfold noise) they refused 99 % with the fault present for 10 % of
        the time, and 99.9 % with 20 to 60 %. They do not detect a fault that lasts for the whole record or for less than 5 % of
        it, nor one below 1.4 standard deviations. They refuse a healthy record with a single transient, or with fewer than five
        periods of a slow oscillation, above the noise, and often one that is correlated over more than a hundredth of its length.
        In that case record longer, leave the transient out, or, if the threshold should allow for it, record it several times.
        """
        samples = as_numbers("The residuals", residuals, "they must be numbers, a row for each sample")
        samples = samples[:, None] if samples.ndim == 1 else samples
        if samples.ndim != 2 or not samples.shape[1]:
            raise ModelError(f"The residuals have the shape {samples.shape}; give a row for each sample.")
        count, n = samples.shape
        needed = int(n / self.alpha) + 1
        if count < needed:
            raise ModelError(
                f"A threshold for {n} residual(s) at alpha={self.alpha:g} needs at least {needed} healthy samples, but there are "
                f"{count}; record a longer run, or allow a larger alpha."
            )
        refuse_missing("residuals", samples)
        _refuse_faulty(samples, faulty)
        covariance = np.atleast_2d(np.cov(samples, rowvar=False))
        _refuse_singular(covariance)
        bound = np.sqrt(n / self.alpha) if self.form == "robust" else n / self.alpha
        return FittedThreshold(samples.mean(axis=0), covariance, float(bound))  # type: ignore[arg-type]


def _refuse_singular(covariance: Floats) -> None:
    variances = np.diag(covariance)
    units = np.sqrt(np.where(variances > 0, variances, 1.0))
    if (variances <= 0).any() or np.linalg.eigvalsh(covariance / np.outer(units, units))[0] <= 1e-12:
        raise ModelError(
            "The covariance of the residuals is singular: one of them is constant, or a combination of the others; leave it out."
        )


def _refuse_faulty(samples: Floats, faulty: ArrayLike | None) -> None:
    if faulty is not None:
        labels = np.asarray(faulty)
        if labels.shape != (len(samples),):
            raise ModelError(
                f"faulty has the shape {labels.shape}; give one label for each of the {len(samples)} samples."
            )
        if np.count_nonzero(labels):
            raise ModelError(
                f"{np.count_nonzero(labels)} of the {len(samples)} samples are labelled faulty, but a threshold must be learned "
                "from healthy ones; leave them out: residuals[~faulty]."
            )
    for column, values in enumerate(samples.T):
        if evidence := why_unhealthy(values):
            raise ModelError(
                f"No threshold can be learned from these residuals. Number {column} {evidence}; give healthy samples only."
            )
