"""Means over several points, whose runs share seeds, with intervals that know it.

All points of a campaign have the same seeds by default. So runs of a seed at several points have the same noise, and count as
one where it is asked how sure a mean is: deviations from the means of the points are summed over each seed, and the sums are
independent. Of one point that is Student's interval of the mean of its runs. The points themselves are what they are: an
interval says how far other noise would move the mean, not other points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim.types import Floats

NAN = float("nan")


class Estimate(NamedTuple):
    """A mean or a difference of means."""

    value: float  # of all runs that have one; NaN without any
    # Its standard error, and the degrees of freedom of Student's t; NaN with one seed.
    error: float
    freedom: float
    runs: int  # how many runs, or pairs of runs, it is of

    def half(self, level: float = 0.95) -> float:
        """Return half of the confidence interval; NaN where nothing scatters that would tell."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 0.5 + level / 2) * self.error)

    @property
    def p(self) -> float:
        """Probability of a value as far from zero in either direction, if it were zero but for noise."""
        from scipy.special import stdtr

        if self.error == 0.0:  # seeds make no difference
            return float(self.value == 0.0)
        return float(2.0 * stdtr(self.freedom, -abs(self.value) / self.error))


def pooled(values: Floats, points: Any, seeds: Any, designs: Any) -> Estimate:
    """Return the mean of the runs that have a finite value; all arrays have the shape (runs,).

    `designs` numbers the list of seeds of each run's point: runs whose points have different lists are independent.
    """
    known = np.isfinite(values)
    values, seeds, designs = values[known], seeds[known], designs[known]
    n = len(values)
    if not n:
        return Estimate(NAN, NAN, NAN, 0)
    _, place = np.unique(points[known], return_inverse=True)
    means = np.bincount(place, values) / np.bincount(place)
    deviations = (values - means[place]) / n
    variance, weight, most = 0.0, 0.0, 0
    for design in np.unique(designs):
        _, own = np.unique(seeds[designs == design], return_inverse=True)
        sums = np.bincount(own, deviations[designs == design])
        if len(sums) < 2:
            return Estimate(float(values.mean()), NAN, NAN, n)
        part = len(sums) / (len(sums) - 1) * float(sums @ sums)
        variance += part
        weight += part**2 / (len(sums) - 1)
        most += len(sums) - 1
    freedom = variance**2 / weight if weight > 0 else most  # Satterthwaite (1946)
    return Estimate(float(values.mean()), variance**0.5, freedom, n)


def apart(a: Estimate, b: Estimate) -> Estimate:
    """Return the difference of two means of independent runs, as Welch (1947) has it."""
    variance = a.error**2 + b.error**2
    weight = a.error**4 / a.freedom + b.error**4 / b.freedom
    freedom = variance**2 / weight if weight > 0 else a.freedom + b.freedom
    return Estimate(a.value - b.value, variance**0.5, freedom, min(a.runs, b.runs))
