"""Receiver operating characteristics of long streams, fast and without holding the interpreter."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.cosim.block import Floats

Flags = np.ndarray[Any, np.dtype[np.bool_]]
POINTS = 201
"""At how many false positive rates a curve is given."""


def rates() -> Floats:
    """Return the false positive rates at which curves are given, so that they can be averaged over streams."""
    return np.linspace(0.0, 1.0, POINTS)


def auc(faulty: Flags, score: Floats) -> float:
    """Return the probability that a faulty sample scores higher than a healthy one, ties counting half.

    Parameters
    ----------
    faulty, score : ndarray of the same shape
        The truth, and what a sample is ranked by.
    """
    healthy, positive = np.sort(score[~faulty]), np.sort(score[faulty])
    below, upto = (np.searchsorted(healthy, positive, side=side) for side in ("left", "right"))  # type: ignore[call-overload]
    return float((below.sum() + upto.sum()) / (2.0 * len(healthy) * len(positive)))


def curve(faulty: Flags, score: Floats) -> Floats:
    """Return the true positive rate at each of the false positive `rates`."""
    healthy, positive = np.sort(score[~faulty]), np.sort(score[faulty])
    thresholds = np.quantile(healthy, 1.0 - rates())
    found = 1.0 - np.searchsorted(positive, thresholds, side="left") / len(positive)
    found[-1] = 1.0
    return np.asarray(found)
