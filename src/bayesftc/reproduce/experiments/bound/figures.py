"""The figure of the bound, drawn from its report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, SENSOR_COLOURS
from bayesftc.reproduce.experiments.bound.run import BOUND
from bayesftc.reproduce.shared.drawing import SWITCHING_STYLES, figure, finish, legend
from bayesftc.reproduce.shared.residuals import LABELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS = "ovsD^Pph"
ASIDE = 0.09
"""Distance of two marks of one cell, which would otherwise overlap."""
COLOURS = {"SER": SENSOR_COLOURS[0], "beta": BLUE, **{name: style["color"] for name, style in SWITCHING_STYLES.items()}}
"""As in the figures of tracking and detection."""


def areas(report: dict[str, Any]) -> Figure:
    """Return the AUC of each residual and the bound, for each size of the faults."""
    cells = sorted(report["cells"], key=lambda cell: cell["auc"][BOUND]["mean"])
    names = [name for name in cells[0]["auc"] if name != BOUND]
    made = figure(8.2, 4.2)
    axis = made.subplots()
    x = np.arange(len(cells))
    for i, name in enumerate([BOUND, *names]):
        mean = np.array([cell["auc"][name]["mean"] for cell in cells])
        low, high = np.array([cell["auc"][name]["ci"] for cell in cells]).T
        style: dict[str, Any] = {"color": BLACK, "lw": 1.6, "marker": "_", "ms": 22, "mew": 2.2, "ls": "none"}
        if name != BOUND:
            style = {"color": COLOURS.get(name, "0.5"), "marker": MARKS[(i - 1) % len(MARKS)], "ms": 6, "ls": "none"}
        aside = 0.0 if name == BOUND else ASIDE * (i - 1 - (len(names) - 1) / 2)
        axis.errorbar(x + aside, mean, [mean - low, high - mean], capsize=3, label=_label(name), **style)
    axis.set_xticks(x, [f"{c['injection']:g} m/s\n{c['drift']:g} m/s per s" for c in cells], fontsize=9)
    title = f"Mean over {report['settings']['streams']} streams; bars: 95 % intervals"
    finish(axis, title, xlabel="injection and drift", ylabel="AUC of the presence of a fault")
    best_first = sorted(names, key=lambda name: -sum(cell["auc"][name]["mean"] for cell in cells))
    legend(axis, [_label(name) for name in (BOUND, *best_first)])
    return made


def _label(name: str) -> str:
    return "bound (mean times and sizes\nof the faults known)" if name == BOUND else LABELS.get(name, name)


FIGURES = {"bound": areas}
