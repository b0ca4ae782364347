"""Calibration of the fault probabilities of the detection experiment, with intervals over its streams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.metrics import without_nan
from bayesftc.cosim.probabilities import Reliability, reliability
from bayesftc.cosim.signals import Flags
from bayesftc.cosim.statistics import interval
from bayesftc.reproduce._residuals import Residual

OWN, FITTED = "its learner, on the whole stream", "its classifier, on the test part"
"""Whose probability it is."""


@dataclass(frozen=True)
class Calibration:
    """How well the probabilities of a stream agree with the truth, in bins of equal counts and of equal widths."""

    counts: Reliability
    widths: Reliability

    @classmethod
    def of(cls, probability: Floats, faulty: Flags, bins: int) -> Calibration:
        """Return that of fault probabilities."""
        return cls(
            reliability(probability, faulty, bins=bins), reliability(probability, faulty, bins=bins, equal="widths")
        )


def calibration(streams: Sequence[Calibration], residual: Residual) -> dict[str, Any]:
    """Return Brier score and calibration errors with intervals over the streams, and the reliability diagram.

    Parameters
    ----------
    streams : sequence of Calibration
        At least two.
    residual : Residual
        Whose probabilities they are.
    """
    counts, widths = [s.counts for s in streams], [s.widths for s in streams]
    numbers = {
        "brier": [r.brier for r in counts],
        "brier_of_constant": [r.brier_of_constant for r in counts],
        "ece": [r.calibration_error for r in counts],
        "ece_equal_widths": [r.calibration_error for r in widths],
    }
    plain: dict[str, Any] = without_nan(
        {
            "of": FITTED if residual.probability is None else OWN,
            **{name: {"mean": float(np.mean(v)), "ci": interval(np.array(v))} for name, v in numbers.items()},
            "diagram": {"equal_counts": _diagram(counts), "equal_widths": _diagram(widths)},
        }
    )
    return plain


def _diagram(streams: Sequence[Reliability]) -> list[dict[str, Any]]:
    """Return for each bin its share of the samples, mean probability and share of faulty samples with its interval."""
    samples = np.array([r.samples for r in streams])
    bins = []
    for i in range(samples.shape[1]):
        predicted, observed = (np.array([getattr(r, name)[i] for r in streams]) for name in ("predicted", "observed"))
        known = ~np.isnan(observed)
        bins.append(
            {
                "share": float(samples[:, i].sum() / samples.sum()),
                "predicted": float(predicted[known].mean()) if known.any() else None,
                "observed": float(observed[known].mean()) if known.any() else None,
                "ci": interval(observed[known]) if known.sum() > 1 else None,
            }
        )
    return bins
