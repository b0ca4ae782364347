"""Calibration of the fault probabilities of the detection experiment, with intervals over its streams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bayesftc.cosim.judging.probabilities import Reliability, reliability
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.statistics import mean_reliability
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.shared.residuals import Residual

OWN, FITTED = "its learner, on the whole stream", "its classifier, on the test part"
"""The sources of a probability."""


@dataclass(frozen=True)
class Calibration:
    """The reliability of the probabilities of a stream, in bins of equal counts and of equal widths."""

    counts: Reliability
    widths: Reliability

    @classmethod
    def of(cls, probability: Floats, faulty: Flags, bins: int) -> Calibration:
        """Return the calibration of fault probabilities."""
        return cls(
            reliability(probability, faulty, bins=bins), reliability(probability, faulty, bins=bins, equal="widths")
        )


def calibration(streams: Sequence[Calibration], residual: Residual) -> dict[str, Any]:
    """Return Brier score and calibration errors with intervals over two or more streams, and the reliability diagram."""
    counts, widths = (mean_reliability([getattr(s, name) for s in streams]) for name in ("counts", "widths"))
    return {
        "of": FITTED if residual.probability is None else OWN,
        **{name: counts[name] for name in ("brier", "brier_of_constant", "ece")},
        "ece_equal_widths": widths["ece"],
        "diagram": {"equal_counts": counts["diagram"], "equal_widths": widths["diagram"]},
    }
