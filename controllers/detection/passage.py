"""The first passage of a forgetting sum of squares over a threshold: ``x <- ratio x + z**2``, with normal z.

The sum is a Markov chain; z has any mean and variance. With F_k(x) = Pr[x_k <= x, no alarm up to k], for x up to the threshold h,

    F_k+1(x) = E[F_k((x - z**2) / ratio)],

where F_k is constant beyond h. It is solved by collocation. F is taken at Chebyshev nodes in the square root of the distance from
the lower end, near which F is flat. The expectation is a Gauss-Legendre quadrature over z, whose integrand has no singularity,
unlike one over z**2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.detection.weighted_chi_square import geometric_weights, quantile, tails

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

NODES = 64
NEVER = 1e-13
"""A healthy sum below its quantile of this probability counts as impossible; faulty sums are larger."""

OVER = 1e-10
"""A passage counts as certain if the probability of none so far is less."""

MOST_STEPS = 100_000


class Passage:
    """The chain below a threshold.

    Parameters
    ----------
    ratio : float
        Forgetting factor, in (0, 1).
    threshold : float
        Threshold on the sum x.
    """

    def __init__(self, ratio: float, threshold: float):
        law = geometric_weights(ratio)
        low = min(quantile(NEVER, law, upper=False), 0.5 * threshold)
        angle = np.pi * (np.arange(NODES) + 0.5) / NODES
        self._places = 0.5 - 0.5 * np.cos(angle)
        self._signs = (-1.0) ** np.arange(NODES) * np.sin(angle)
        self._low, self._span = low, threshold - low
        x = low + self._span * self._places**2
        self._end = self._interpolation(np.ones(1))[0]
        below = np.array([tails(value, law)[0] for value in (*x, threshold)])
        self.healthy = np.asarray(below[:-1] / below[-1])
        """F at the nodes for a healthy sum that is below the threshold."""
        last = np.sqrt(np.maximum(x - ratio * low, 0.0))
        self._sure = np.sqrt(
            np.maximum(x - ratio * threshold, 0.0)
        )  # below it, x remains under the node from any value
        g, weights = np.polynomial.legendre.leggauss(NODES)
        half = 0.5 * (last - self._sure)[:, None]
        self._z = self._sure[:, None] + half * (1.0 + g)
        self._weights = half * weights / np.sqrt(2.0 * np.pi)
        before = (x[:, None] - self._z**2) / ratio
        self._values = self._interpolation(np.sqrt(np.clip((before - low) / self._span, 0.0, 1.0)).ravel())

    def _interpolation(self, places: Floats) -> Floats:
        """Return the matrix from values at the nodes to values at points in [0, 1] (barycentric form)."""
        distance = places[:, None] - self._places
        terms = self._signs / np.where(distance == 0, np.inf, distance)
        rows = terms / terms.sum(axis=1, keepdims=True)
        hit = (distance == 0).any(axis=1)
        rows[hit] = distance[hit] == 0
        return np.asarray(rows)

    def _kernel(self, mean: float, variance: float) -> tuple[Floats, Floats]:
        """Return the quadrature's weights for z with these moments, and the probabilities of z in the range of constant F."""
        from scipy.special import ndtr

        deviation = np.sqrt(variance)
        density = np.exp(-0.5 * ((self._z - mean) / deviation) ** 2) + np.exp(
            -0.5 * ((self._z + mean) / deviation) ** 2
        )
        sure = ndtr((self._sure - mean) / deviation) - ndtr((-self._sure - mean) / deviation)
        return self._weights * density / deviation, np.asarray(sure)

    def advance(self, F: Floats, mean: float, variance: float) -> Floats:
        """Return F at the nodes one sample later."""
        weights, sure = self._kernel(mean, variance)
        inside = (weights * (self._values @ F).reshape(weights.shape)).sum(axis=1)
        return np.asarray(inside + sure * (self._end @ F))

    def matrix(self, mean: float, variance: float) -> Floats:
        """Return the matrix that advances F at the nodes by one sample."""
        weights, sure = self._kernel(mean, variance)
        values = self._values.reshape(*weights.shape, NODES)
        return np.asarray(np.einsum("jq,jqn->jn", weights, values) + np.outer(sure, self._end))

    def without_alarm(self, F: Floats) -> float:
        """Return the probability of no alarm so far."""
        return float(self._end @ F)

    def survival(self, means: Floats, variances: Floats) -> Floats:
        """Return the probability of no alarm up to each sample from the first faulty one on.

        Parameters
        ----------
        means, variances : ndarray, shape (steps,)
            Moments of z at each faulty sample; healthy ones are 0 and 1.
        """
        F, probabilities = self.healthy, np.zeros(len(means))
        for k, (mean, variance) in enumerate(zip(means, variances, strict=True)):
            F = self.advance(F, float(mean), float(variance))
            probabilities[k] = self.without_alarm(F)
            if probabilities[k] < OVER:
                break
        return np.maximum(probabilities, 0.0)

    def mean_delay(self, means: Floats, variances: Floats, *, settles: bool) -> float:
        """Return the expected number of samples from the first faulty one to the first alarm (0 for an immediate alarm).

        Parameters
        ----------
        means, variances : ndarray, shape (steps,)
            See `survival`.
        settles : bool
            Whether the last moments hold for ever; else the delay after them is not counted.
        """
        F, total = self.healthy, 0.0
        for mean, variance in zip(means, variances, strict=True):
            F = self.advance(F, float(mean), float(variance))
            total += self.without_alarm(F)
            if self.without_alarm(F) < OVER:
                return total
        if settles:
            M = self.matrix(float(means[-1]), float(variances[-1]))
            total += self.without_alarm(np.linalg.solve(np.eye(NODES) - M, M @ F))
        return total
