"""The figure of the fault probabilities, drawn from the report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, SENSOR_COLOURS
from bayesftc.reproduce.shared.drawing import diagonal, figure, finish

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def reliability(report: dict[str, Any]) -> Figure:
    """Return the reliability diagrams of all learners, one for each range of lengths, with the numbers of samples."""
    settings, ranges = report["settings"], report["reliability"]
    made = figure(5.4 * len(ranges), 6.2)
    axes = made.subplots(2, len(ranges), sharex=True, sharey="row", height_ratios=(4, 1), squeeze=False)
    bar = settings["bar"]
    for (title, learners), axis, below in zip(ranges.items(), *axes, strict=True):
        axis.fill_between([0, 1], [-bar, 1 - bar], [bar, 1 + bar], color="0.93", lw=0, zorder=0)
        diagonal(axis)
        styles = zip((BLUE, *SENSOR_COLOURS[2:], BLACK), "osvD^P", ("-", *["--"] * 5), strict=False)
        for (name, of), (colour, mark, line) in zip(learners.items(), styles, strict=False):
            bins = [b for b in of["bins"] if b["samples"] >= settings["enough"]]
            x, y = ([b[key] for b in bins] for key in ("predicted", "observed"))
            error = np.clip(np.abs(np.array([b["ci"] for b in bins], float).T - y), 0.0, None) if bins else None
            look = {"color": colour, "ls": line, "lw": 1.4, "marker": mark, "ms": 4.5}
            axis.errorbar(x, y, error, capsize=2, elinewidth=0.8, label=name, **look)
            below.plot(x, [b["samples"] for b in bins], **look)
        finish(axis, f"faults of {title}", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        finish(below, yscale="log", xlabel="fault probability")
    axes[0][0].set_ylabel("share of faulty samples")
    axes[1][0].set_ylabel("samples")
    axes[0][0].legend(frameon=False, fontsize=8.5, loc="upper left")
    return made


FIGURES = {"probabilities": reliability}
