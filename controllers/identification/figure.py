"""The figure of an identified model: what it makes of held-out data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.judging.panels import thin
from bayesftc.cosim.judging.plotting import BLACK, BLUE, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.controllers.identification.identify import Identification

MOST = 600
"""Samples that are shown: with more, no line is seen beside another."""


def draw(found: Identification, figure: Figure) -> Figure:
    """Draw on an empty figure: for each output held-out data and the errors' autocorrelation, and what told the order.

    Grey behind the autocorrelations is where 95 % of those of white noise are.
    """
    from bayesftc.controllers.identification.identify import LAGS, autocorrelation

    count = len(found.outputs)
    figure.set_size_inches(9.0, 2.2 * count + 2.4)
    figure.set_layout_engine("constrained")
    grid = figure.add_gridspec(count + 1, 3)
    shown = slice(0, MOST)
    for i, name in enumerate(found.outputs):
        axis = figure.add_subplot(grid[i, :2])
        gaps = np.isnan(found.measured[shown, i]).any()
        mark = {"ls": "", "marker": ".", "ms": 4} if gaps else {"lw": 0.8}
        axis.plot(*thin(found.time[shown], found.measured[shown, i]), color=BLACK, label="measured", **mark)
        axis.plot(*thin(found.time[shown], found.predicted[shown, i]), color=BLUE, lw=1.2, label="one sample ahead")
        low, high = np.nanmin(found.measured[shown, i]), np.nanmax(found.measured[shown, i])
        axis.plot(
            *thin(found.time[shown], found.simulated[shown, i]),
            color=SENSOR_COLOURS[0],
            lw=1.2,
            ls="--",
            label="simulated",
        )
        axis.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
        axis.set_ylabel(name)
        simulated = f", {found.simulated_fit[i]:.0f} % by simulation" if np.isfinite(found.simulated_fit[i]) else ""
        axis.set_title(
            f"Held out: {found.fit[i]:.0f} % explained one sample ahead{simulated}",
            fontsize=10,
            loc="left",
        )
        if i == 0:
            axis.legend(fontsize=8, frameon=False, ncols=3, loc="upper right")
        if i == count - 1:
            axis.set_xlabel("time (s)")
        side = figure.add_subplot(grid[i, 2])
        heights, pairs = autocorrelation(found.residuals[:, i])
        side.bar(np.arange(1, LAGS + 1)[pairs > 0], heights[pairs > 0], color=BLUE, width=0.6)
        band = 1.96 / np.sqrt(max(pairs.max(), 1))
        side.axhspan(-band, band, color="0.88", zorder=0)
        side.set_ylim(-0.5, 0.5)
        side.set_title("Autocorrelation of errors", fontsize=10, loc="left")
        if i == count - 1:
            side.set_xlabel("lag (samples)")
    axis = figure.add_subplot(grid[count, :])
    order = found.model.moving.states
    places = np.arange(1, min(len(found.correlations), 3 * order + 6) + 1)
    colours = [BLUE if place <= order else "0.7" for place in places]
    axis.bar(places, found.correlations[: len(places)], color=colours)
    axis.set_xticks(places)
    axis.set_xlabel("direction of the past")
    axis.set_ylabel("correlation\nwith the future")
    axis.set_title(f"Order: the first {order} are states", fontsize=10, loc="left")
    for axis in figure.axes:
        axis.tick_params(labelsize=8)
        for edge in ("top", "right"):
            axis.spines[edge].set_visible(False)
    return figure
