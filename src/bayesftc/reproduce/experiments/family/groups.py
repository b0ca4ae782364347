"""The family's results by group of cases, a summary of its long table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Figures(NamedTuple):
    """The results of a learner in a group of cases."""

    # Geometric mean and largest of the ratios to the oracle's error; infinite if a run has lost its plant.
    mean: float
    worst: float
    lost: int  # number of such runs
    # Share of healthy sensors' time with an alarm, mean over the cases; None for a learner that detects no faults.
    false_share: float | None


def by_group(report: Mapping[str, Any]) -> dict[str, dict[str, Figures]]:
    """Return the figures of each learner in each group of a report, in the order of the cases."""
    groups: dict[str, list[str]] = {}
    for case, group in report["groups"].items():
        groups.setdefault(group, []).append(case)
    return {
        group: {name: figures([report["table"][case][name] for case in cases]) for name in report["summary"]}
        for group, cases in groups.items()
    }


def figures(cells: Sequence[Mapping[str, Any]]) -> Figures:
    """Return the figures of a learner's cells of a report's table."""
    ratios = [ratio_of(cell) for cell in cells]
    shares = [cell["false_share"] for cell in cells if cell["false_share"] is not None]
    mean = float(np.exp(np.mean(np.log(ratios))))
    return Figures(mean, max(ratios), sum(cell["lost"] for cell in cells), float(np.mean(shares)) if shares else None)


def ratio_of(cell: Mapping[str, Any]) -> float:
    """Return the ratio of a cell of a report's table; infinite if a run has lost its plant."""
    return np.inf if cell["lost"] else float(cell["ratio"])
