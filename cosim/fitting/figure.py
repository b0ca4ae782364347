"""The figure of a fit: samples and outputs, and their differences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.figures.panels import PANEL, broken, finish, legend, make_panels, thin
from bayesftc.cosim.judging.figures.plotting import BLACK, MARKERS, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.fitting.fitted import FittedFMU

LOWEST, SHARE = 0.6, 99.0
"""Height of a panel of differences relative to that of samples, and the percentile of the counted ones that it shows twofold."""


def plot_fit(fitted: FittedFMU, figure: Figure | None = None) -> Figure:
    """Draw for each output its samples and the fit, and below their differences.

    Samples that do not count are grey crosses. The held-out part is shaded.

    Parameters
    ----------
    fitted : FittedFMU
        The fit.
    figure : Figure, optional
        An empty figure to draw on; by default a new one for a file.
    """
    figure, axes = make_panels([PANEL, LOWEST * PANEL] * len(fitted.sensors), figure)
    units, first = fitted.units, 0
    for j, (output, columns) in enumerate(fitted.sensors.items()):
        above, below = axes[2 * j : 2 * j + 2]
        limit = 0.0
        for i, column in enumerate(columns, start=first):
            y, colour = fitted.measured[:, i], SENSOR_COLOURS[(i - first) % len(SENSOR_COLOURS)]
            counts = fitted.weights[:, i] >= 0.5
            error = y - fitted.fitted[:, j]
            if (counts & np.isfinite(error)).any():
                limit = max(limit, 2.0 * float(np.nanpercentile(np.abs(error[counts]), SHARE)))
            marker = MARKERS[(i - first) % len(MARKERS)]
            for axis, values in ((above, y), (below, error)):
                good, bad = (np.where(counts == is_counted, values, np.nan) for is_counted in (True, False))
                axis.plot(*thin(fitted.time, good), marker, ms=2, color=colour, alpha=0.5, label=column)
                axis.plot(*thin(fitted.time, bad), "x", ms=3, color="0.6", zorder=1)
        above.plot(*thin(fitted.time, fitted.fitted[:, j]), color=BLACK, lw=1.2, label="fit")
        below.axhline(0.0, color=BLACK, lw=0.8)
        if limit > 0:
            below.set_ylim(-limit, limit)
        above.set_ylabel(broken(with_unit(output, units[output]), PANEL))
        below.set_ylabel("samples - fit")
        legend(above)
        first += len(columns)
    if fitted.split < len(fitted.time):
        for axis in axes:
            axis.axvspan(fitted.time[fitted.split], fitted.time[-1], color="0.93", zorder=0)
    finish(axes, fitted.time)
    notes = ["grey crosses: samples that do not count"] * bool(
        (fitted.weights[np.isfinite(fitted.measured)] < 0.5).any()
    )
    notes += ["shaded: held out"] * (fitted.split < len(fitted.time))
    figure.suptitle(f"Fit of {', '.join(fitted.parameters)}; " + "; ".join(notes), fontsize=10, x=0.01, ha="left")
    return figure
