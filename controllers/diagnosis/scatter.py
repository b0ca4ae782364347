"""Samples that scatter more than their model expects: why sensors are blamed that are healthy."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.types import Floats

SCATTER = 1.3
"""Root mean square of errors relative to the model's from which it explains false alarms."""


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


__all__ = ["SCATTER", "excess", "scatter"]
