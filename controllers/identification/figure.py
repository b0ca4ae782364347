"""The figure of an identified model on held-out data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.judging.figures.panels import thin
from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, SENSOR_COLOURS
from bayesftc.cosim.statistics._whiteness import LAGS, autocorrelation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.controllers.identification.identify import Identification

MOST = 600
"""Largest number of samples shown; with more, lines hide each other."""


def draw(identified: Identification, figure: Figure) -> Figure:
    """Draw on an empty figure: for each output held-out data and the errors' autocorrelation, and the choice of the order.

    The grey band has 95 % of the autocorrelations of white noise.
    """
    count = len(identified.outputs)
    figure.set_size_inches(9.0, 2.2 * count + 2.4)
    figure.set_layout_engine("constrained")
    grid = figure.add_gridspec(count + 1, 3)
    shown = slice(0, MOST)
    for i, name in enumerate(identified.outputs):
        axis = figure.add_subplot(grid[i, :2])
        gaps = np.isnan(identified.measured[shown, i]).any()
        mark = {"ls": "", "marker": ".", "ms": 4} if gaps else {"lw": 0.8}
        axis.plot(*thin(identified.time[shown], identified.measured[shown, i]), color=BLACK, label="measured", **mark)
        axis.plot(
            *thin(identified.time[shown], identified.predicted[shown, i]), color=BLUE, lw=1.2, label="one sample ahead"
        )
        low, high = np.nanmin(identified.measured[shown, i]), np.nanmax(identified.measured[shown, i])
        axis.plot(
            *thin(identified.time[shown], identified.simulated[shown, i]),
            color=SENSOR_COLOURS[0],
            lw=1.2,
            ls="--",
            label="simulated",
        )
        axis.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
        axis.set_ylabel(name)
        simulated = (
            f", {identified.simulated_fit[i]:.0f} % by simulation" if np.isfinite(identified.simulated_fit[i]) else ""
        )
        axis.set_title(
            f"Held out: {identified.fit[i]:.0f} % explained one sample ahead{simulated}",
            fontsize=10,
            loc="left",
        )
        if i == 0:
            axis.legend(fontsize=8, frameon=False, ncols=3, loc="upper right")
        if i == count - 1:
            axis.set_xlabel("time (s)")
        side = figure.add_subplot(grid[i, 2])
        heights, pairs = autocorrelation(identified.residuals[:, i])
        side.bar(np.arange(1, LAGS + 1)[pairs > 0], heights[pairs > 0], color=BLUE, width=0.6)
        band = 1.96 / np.sqrt(max(pairs.max(), 1))
        side.axhspan(-band, band, color="0.88", zorder=0)
        side.set_ylim(-0.5, 0.5)
        side.set_title("Autocorrelation of errors", fontsize=10, loc="left")
        if i == count - 1:
            side.set_xlabel("lag (samples)")
    axis = figure.add_subplot(grid[count, :])
    order = identified.model.moving.states
    places = np.arange(1, min(len(identified.correlations), 3 * order + 6) + 1)
    colours = [BLUE if place <= order else "0.7" for place in places]
    axis.bar(places, identified.correlations[: len(places)], color=colours)
    axis.set_xticks(places)
    axis.set_xlabel("direction of the past")
    axis.set_ylabel("correlation\nwith the future")
    axis.set_title(f"Order: the first {order} are states", fontsize=10, loc="left")
    for axis in figure.axes:
        axis.tick_params(labelsize=8)
        for edge in ("top", "right"):
            axis.spines[edge].set_visible(False)
    return figure
