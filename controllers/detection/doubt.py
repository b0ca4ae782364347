"""Sentences about fault probabilities that are not to be trusted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.detection.calibration import PARTS, TRAINING_SHARE

if TYPE_CHECKING:
    from bayesftc.controllers.detection.calibration import CalibrationReport
    from bayesftc.cosim.judging.probabilities import Reliability
    from bayesftc.cosim.types import Floats

LARGE = 0.05
"""Calibration error from which on there is a doubt; the interval must be above it, so that noise is no reason."""


def doubt(report: CalibrationReport, sensors: Sequence[str] | None = None) -> str:
    """Return what is wrong with the probabilities of a report, and its worst sensor; empty if nothing is.

    Parameters
    ----------
    report : CalibrationReport
        The quality of the probabilities.
    sensors : sequence of str, optional
        What each sensor measures.
    """
    low, high = report.calibration_error_interval
    reasons = ["their Brier score is worse than that of a constant"] * (report.brier > report.brier_of_constant)
    if low > LARGE:
        reasons.append(
            f"they differ from the observed shares of faults by {report.calibration_error:.3f} on average (95 % interval "
            f"{low:.3f} to {high:.3f})"
        )
    if not reasons:
        return ""
    worst = max(range(len(report.sensors)), key=lambda i: _loss(report.sensors[i]))
    name = f"{worst} ({sensors[worst]})" if sensors else f"{worst}"
    return (
        f"Do not rely on these probabilities for such faults: {', and '.join(reasons)}. The worst are those of sensor {name}: "
        f"their mean is {_mean(report.sensors[worst].predicted, report.sensors[worst]):.2g}, and it is in fault in "
        f"{_mean(report.sensors[worst].observed, report.sensors[worst]):.1%} of its samples."
    )


def too_few(report: CalibrationReport, steps: int) -> str:
    """Return that a report has too few faults for a verdict, good or bad; empty if it has enough.

    Parameters
    ----------
    report : CalibrationReport
        The quality of the probabilities.
    steps : int
        The steps of a run that is expected to have enough faults.
    """
    sensors = len(report.sensors)
    if report.faults >= PARTS * sensors:
        return ""
    run = report.samples / sensors / (1.0 - TRAINING_SHARE)  # it may be as long as expected, and have few by chance
    return (
        f"There are too few faults in the test to say whether these probabilities are reliable: {report.faults} begin in it, of "
        f"at least {PARTS * sensors}. Give --steps {1000 * math.ceil(max(steps, 1.5 * run) / 1000)}."
    )


def _loss(sensor: Reliability) -> float:
    """Return by how much the Brier score is worse than that of a constant; negative if it is better."""
    return sensor.brier - sensor.brier_of_constant


def _mean(of_bins: Floats, sensor: Reliability) -> float:
    """Return the mean over all samples of a number in each bin."""
    return float(np.nansum(of_bins * sensor.samples) / sensor.samples.sum())


__all__ = ["doubt", "too_few"]
