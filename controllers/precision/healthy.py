"""Evidence in recorded residuals that they are not healthy: too many far out, or times that differ from other times.

A threshold learned from faulty samples is blind, so these rules are for what would spoil it. They are conventions, not theorems:
all work on ranks or quartiles, so that no distribution is assumed, and none depends on the threshold that is to be learned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

CHANCE = 1e-6
"""Runs of equal samples that are expected less often than this are not taken for chance."""

FAR = ((5.0, 0.05), (10.0, 0.02))
"""Robust standard deviations from the median, and the largest share of a healthy residual's samples beyond them.

Beyond 5 are 6e-7 of normal noise, 0.6 % of Laplace's, 1 % of Student's t with 3 degrees of freedom, 2 % of log-normal noise, and
9 % of Cauchy's, which has no variance.
"""

LEAST = 3
"""So many samples may be far out whatever their share."""

QUARTILE = 0.6745
"""Distance of a normal distribution's upper quartile from its median, in standard deviations."""

SHARE, SHORTEST = 20, 50
"""A window is this part of the record, but no shorter than so many samples; the record must have four of the shortest."""

APART = 1 / 3
"""Least difference of two windows' mean ranks (as shares of the record) that counts.

Ranks of two groups without any overlap differ by 1/2, however many are in each. At 1/3 a sample of the one is larger than one of
the other in five of six cases: normal levels 1.4 standard deviations apart, or spreads as one to four.
"""

SURE = 10.0
"""The difference must also be so many standard errors of one window's mean rank, as the most different two are compared."""

CALM, CALM_TO_SD = 0.25, 3.138
"""The standard error is told by the lower quartile of all windows' halves' differences, and a normal distribution's deviation."""


def why_unhealthy(values: Floats) -> str | None:
    """Return in words what shows that a residual is not healthy throughout, or None.

    Parameters
    ----------
    values : ndarray, shape (N,)
        One residual, in the order in which it came.
    """
    spread = np.abs(values - np.median(values))
    return _repeats(values) or _outliers(values) or _differs("level", values) or _differs("spread", spread)


def _repeats(values: Floats) -> str | None:
    begins = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0]))
    lengths = np.diff(np.concatenate([begins, [len(values)]]))
    longest = int(np.argmax(lengths))
    run, at = int(lengths[longest]), int(begins[longest])
    commonest = np.unique(values, return_counts=True)[1].max() / len(values)
    if len(values) * commonest ** (run - 1) >= CHANCE:
        return None
    return f"has the same value {run} times in a row from sample {at} on, which is no chance: a signal was frozen there"


def _outliers(values: Floats) -> str | None:
    """Each side of the median has its own standard deviation, by its quartile: residuals may be skewed."""
    middle = np.median(values)
    # Of a coarsely quantised residual quartiles that fall between two levels would lie at neither.
    low, high = np.quantile(values, 0.25, method="lower"), np.quantile(values, 0.75, method="higher")
    if low == middle or middle == high:
        return None
    deviations = QUARTILE * np.maximum((values - middle) / (high - middle), (middle - values) / (middle - low))
    for distance, share in FAR:
        far = deviations > distance
        if np.count_nonzero(far) > max(LEAST, share * len(values)):
            return (
                f"has {np.count_nonzero(far)} of {len(values)} samples, from sample {np.argmax(far)} on, more than {distance:g} "
                "robust standard deviations from the median: a fault was present there"
            )
    return None


def _differs(what: str, values: Floats) -> str | None:
    """Compare the mean ranks of all windows.

    How uncertain such a mean is, also where neighbours are alike, is told by the difference of the window's own two halves. Its
    lower quartile over all windows is that of healthy times, unless three quarters of the record are faulty; a slow oscillation
    of the residual, as by a controller that lags, differs between the halves of a window as well.
    """
    half = max(SHORTEST, len(values) // SHARE) // 2
    if len(values) < 4 * SHORTEST:
        return None
    from scipy.stats import rankdata  # half a second to import, which only those who learn a threshold should wait

    ranks = rankdata(values) / len(values)
    sums = np.concatenate([[0.0], np.cumsum(ranks)])
    halves = (sums[half:] - sums[:-half]) / half
    means = (halves[:-half] + halves[half:]) / 2
    calm = CALM_TO_SD * np.quantile(np.abs(halves[half:] - halves[:-half]), CALM) / 2
    error = max(float(calm), float(np.std(ranks)) / np.sqrt(2 * half))
    low, high = int(np.argmin(means)), int(np.argmax(means))
    if means[high] - means[low] <= max(APART, SURE * error):
        return None
    first, second = (f"from sample {at} to {at + 2 * half - 1}" for at in sorted((low, high)))
    return (
        f"is not alike throughout: its {what} {first} and {second} differ by more than chance: a fault was present at one of "
        "these times, or the controller had not settled (if such changes are usual, record several of them)"
    )
