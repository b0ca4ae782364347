"""The figure of the family, drawn from the report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.reproduce.experiments.family.groups import ratio_of
from bayesftc.reproduce.shared.drawing import colour_bar, figure, heat_map
from bayesftc.reproduce.shared.tables import broken

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIMIT = 10.0
"""The ratio with the strongest colour; its inverse has the opposite one."""
ROWS = 84
"""Cases in one column of the figure."""


def ratios(report: dict[str, Any]) -> Figure:
    """Return the heat map of the errors over the oracle's, by case and learner."""
    from matplotlib.colors import LogNorm

    cells, learners = report["table"], list(report["settings"]["learners"])
    cases = list(cells)
    columns = -(-len(cases) // ROWS)
    size = -(-len(cases) // columns)
    made = figure(columns * (4.4 + 0.62 * len(learners)), 2.2 + 0.22 * size)
    axes = made.subplots(1, columns, squeeze=False)[0]
    image: Any = None
    for axis, first in zip(axes, range(0, len(cases), size), strict=True):
        few = cases[first : first + size]
        values = np.array([[ratio_of(cells[case][name]) for name in learners] for case in few])
        names = [broken(name) for name in learners]
        image = heat_map(axis, values, few, names, "{:.2f}", cmap="RdBu_r", norm=LogNorm(1 / LIMIT, LIMIT))
        axis.set_ylim(size - 0.5, -0.5)
        axis.xaxis.tick_top()
        axis.tick_params(axis="x", rotation=90, length=0)
        axis.tick_params(axis="both", labelsize=8)
    label = "root-mean-square error over that of the oracle, which leaves faulty samples out"
    colour_bar(made, image, list(axes), label, location="bottom", shrink=0.3, pad=0.005, extend="both")
    return made


FIGURES = {"family": ratios}
