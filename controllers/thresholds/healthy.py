"""Tests whether recorded residuals are healthy: repetitions, outliers, and differences between parts of the record.

A threshold learned from faulty samples would miss faults, and these rules refuse such samples. They are conventions, not
theorems. All use ranks or quartiles, so that they assume no distribution, and none depends on the threshold to learn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

CHANCE = 1e-6
"""Runs of equal samples with a smaller expected number do not count as chance."""

FAR = ((5.0, 0.05), (10.0, 0.02))
"""Distances from the median in robust standard deviations, and the largest share of healthy samples beyond them.

Beyond 5 are 6e-7 of normal noise, 0.6 % of Laplace noise, 1 % of Student's t noise with 3 degrees of freedom, 2 % of log-normal
noise, and 9 % of Cauchy noise, which has no variance.
"""

LEAST = 3
"""Number of samples that may be that far out, whatever their share."""

QUARTILE = 0.6745
"""Distance of a normal distribution's upper quartile from its median, in standard deviations."""

SHARE, SHORTEST = 20, 50
"""Windows per record, and least length of a window in samples; a record must have four of these."""

APART = 1 / 3
"""Least difference of two windows' mean ranks (as shares of the record) that counts.

Ranks of two groups without any overlap differ by 1/2, whatever their sizes. At 1/3 a sample of the one is larger than one of the
other in five of six cases: normal levels 1.4 standard deviations apart, or spreads as one to four.
"""

SURE = 10.0
"""Least difference in standard errors of a window's mean rank; it is high, because the two extreme windows are compared."""

CALM, CALM_TO_SD = 0.25, 3.138
"""Quantile of the differences of the windows' halves, and the factor from it to a normal standard deviation."""


def why_unhealthy(values: Floats) -> str | None:
    """Return the evidence that a residual is not healthy throughout, as the end of a sentence; None if there is none.

    Parameters
    ----------
    values : ndarray, shape (N,)
        One residual, in order of time.
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
    return (
        f"has the same value {run} times in a row from sample {at} on, more than by chance: a signal was frozen there"
    )


def _outliers(values: Floats) -> str | None:
    """Test for outliers, with a standard deviation from the quartile for each side of the median: residuals may be skewed."""
    middle = np.median(values)
    # Interpolated quartiles of a coarsely quantised residual would lie between its levels.
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


def _differs(quantity: str, values: Floats) -> str | None:
    """Compare the mean ranks of all windows.

    The error of a window's mean, also with autocorrelation, is estimated from the difference of the window's halves. The lower
    quartile over all windows is that of healthy times, unless three quarters of the record are faulty. A slow oscillation of the
    residual, for example from a slow controller, differs between the halves of a window as well.
    """
    half = max(SHORTEST, len(values) // SHARE) // 2
    if len(values) < 4 * SHORTEST:
        return None
    from scipy.stats import rankdata  # imported here, because it takes half a second

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
        f"is not uniform in time: its {quantity} {first} and {second} differ by more than chance. Either a fault was present "
        "at one of these times, or the controller had not settled; if such changes are usual, record several of them"
    )
