"""Samples that scatter more than their model expects: why sensors are blamed that are healthy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.types import Floats

SCATTER = 1.3
"""Root mean square of errors relative to the model's from which it explains false alarms."""


QUIET = 3.0
"""Stated standard deviation relative to that of the samples from which it is too large: more than a learner corrects."""

ENOUGH = 20
"""Least number of changes, or of differences, that tell the noise of a sensor."""


def scatter(errors: Floats, expected: float, unit: str | None, subject: str, setting: str) -> str:
    """Return a sentence if errors are larger than a model expects; else nothing.

    Parameters
    ----------
    errors : ndarray
        The errors; those that are not finite do not count.
    expected : float
        Their standard deviation by the model.
    unit : str or None
        Their unit.
    subject : str
        The begin of the sentence: what differs from what.
    setting : str
        Where the model's number comes from.
    """
    ratio, found = excess(errors, expected)
    if ratio < SCATTER:
        return ""
    of = behind(unit)
    return f"{subject} by {found:.3g}{of} (root mean square), but the model expects {expected:.3g}{of}: {setting}."


def excess(errors: Floats, expected: float) -> tuple[float, float]:
    """Return the root mean square of errors relative to the expected one, and itself; zeros without any error."""
    finite = errors[np.isfinite(errors)]
    if not len(finite):
        return 0.0, 0.0
    found = float(np.sqrt(np.mean(finite * finite)))
    return found / expected, found


def stated_too_large(y: Floats, std: Floats, groups: Sequence[Sequence[int]]) -> str:
    """Return a sentence if the noise of some sensors is far less than their model says; else nothing.

    White noise is at most as large as the changes from one sample to the next let it be, which contain the motion as well. Errors
    that last show in the differences of sensors of one quantity.

    Parameters
    ----------
    y : ndarray, steps x m
        The samples; one that is not finite is missing. Repetitions do not count: a sensor may be frozen, or coarse.
    std : ndarray, m
        The standard deviations in the model.
    groups : sequence of sequence of int
        The sensors of each quantity.
    """
    most = np.full(len(std), np.inf)
    for i, samples in enumerate(y.T):
        changes = np.diff(samples[np.isfinite(samples)])
        changes = changes[changes != 0.0]
        if len(changes) >= ENOUGH:
            most[i] = np.sqrt(np.mean(changes**2) / 2.0)
    for group in groups:
        for i, j in combinations(group, 2):
            apart = y[:, i] - y[:, j]
            apart = apart[np.isfinite(apart)]
            if len(apart) >= ENOUGH and QUIET * np.std(apart) > np.hypot(std[i], std[j]):
                most[[i, j]] = np.inf
    quiet = np.flatnonzero(QUIET * most < std)
    if not len(quiet):
        return ""
    *first, last = map(str, quiet)
    who = f"sensors {', '.join(first)} and {last}" if first else f"sensor {last}"
    times = float((std[quiet] / most[quiet]).min())
    return (
        f"Unless the errors of {who} last for many samples, the model states them at least {times:.2g} times too large: by the "
        "changes from sample to sample. Correct that before all else (sensor_std in design, or sensor_covariance, in the unit of "
        "the samples). "
    )


__all__ = ["SCATTER", "excess", "scatter", "stated_too_large"]
