"""Means over several points with confidence intervals that take the common seeds of the points into account.

By default all points of a campaign have the same seeds. The runs of a seed at several points then have the same noise and are
not independent. Therefore the deviations from the means of the points are summed over each seed; these sums are independent.
With one point the result is Student's interval of the mean of its runs. The points are fixed: an interval covers other noise,
not other points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim.types import Floats

NAN = float("nan")


class Estimate(NamedTuple):
    """A mean or a difference of means."""

    value: float  # over all runs with a value; NaN without any
    # Standard error and degrees of freedom of Student's t; NaN with one seed.
    error: float
    freedom: float
    runs: int  # number of runs, or of pairs of runs

    def half(self, level: float = 0.95) -> float:
        """Return half of the confidence interval; NaN with one seed."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 0.5 + level / 2) * self.error)

    def bounds(self, positive: bool = False) -> tuple[float, float]:
        """Return the 95 % confidence interval; NaN with one seed.

        Parameters
        ----------
        positive : bool
            Whether no value can be negative. The interval then begins at zero at the earliest, and covers the mean as often.
        """
        half = self.half()
        low = self.value - half
        return max(low, 0.0) if positive and low == low else low, self.value + half

    @property
    def p(self) -> float:
        """Two-sided p-value for the hypothesis that the true value is zero."""
        from scipy.special import stdtr

        if self.error == 0.0:  # all seeds give the same value
            return float(self.value == 0.0)
        return float(2.0 * stdtr(self.freedom, -abs(self.value) / self.error))


def pooled(values: Floats, points: Any, seeds: Any, designs: Any) -> Estimate:
    """Return the mean of the runs with a finite value; all arrays have the shape (runs,).

    `designs` is the index of the list of seeds of each run's point: runs whose points have different lists are independent.
    """
    finite = np.isfinite(values)
    values, seeds, designs = values[finite], seeds[finite], designs[finite]
    n = len(values)
    if not n:
        return Estimate(NAN, NAN, NAN, 0)
    _, place = np.unique(points[finite], return_inverse=True)
    means = np.bincount(place, values) / np.bincount(place)
    deviations = (values - means[place]) / n
    variance, weight, most = 0.0, 0.0, 0
    for design in np.unique(designs):
        _, seed_index = np.unique(seeds[designs == design], return_inverse=True)
        sums = np.bincount(seed_index, deviations[designs == design])
        if len(sums) < 2:
            return Estimate(float(values.mean()), NAN, NAN, n)
        part = len(sums) / (len(sums) - 1) * float(sums @ sums)
        variance += part
        weight += part**2 / (len(sums) - 1)
        most += len(sums) - 1
    freedom = variance**2 / weight if weight > 0 else most  # Satterthwaite (1946)
    return Estimate(float(values.mean()), variance**0.5, freedom, n)


def apart(a: Estimate, b: Estimate) -> Estimate:
    """Return the difference of two means of independent runs (Welch, 1947)."""
    variance = a.error**2 + b.error**2
    weight = a.error**4 / a.freedom + b.error**4 / b.freedom
    freedom = variance**2 / weight if weight > 0 else a.freedom + b.freedom
    return Estimate(a.value - b.value, variance**0.5, freedom, min(a.runs, b.runs))
