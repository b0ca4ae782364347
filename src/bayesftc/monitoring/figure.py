"""The figure of a monitored recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.panels import finish, legend, make_panels, name_spans, thin, with_unit
from bayesftc.cosim.judging.plotting import BLACK, LINES, MARKERS, colour_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.monitoring.run import Monitored


MAIN, STRIP = 1.9, 0.85
"""Heights of panels in inches: for a quantity, and for one sensor's samples."""


def plot_monitored(monitored: Monitored, figure: Figure | None = None) -> Figure:
    """Return a figure: the belief of each quantity, a panel with samples minus belief per sensor, and the faults.

    Parameters
    ----------
    found : Monitored
        The results. Alarms are shaded in the colour of their sensor; those of actuators are hatched.
    figure : Figure, optional
        An empty figure to draw on.
    """
    plant = monitored.model.states - monitored.model.disturbances
    rows = monitored.model.quantities[:, :plant]
    quantities, of = np.unique(rows, axis=0, return_inverse=True)
    units = monitored.recording.units
    heights = [MAIN] * len(quantities) + [STRIP] * len(units) + [MAIN]
    figure, axes = make_panels(heights, figure)
    belief = monitored.x_hat[:, :plant] @ rows.T
    for q, axis in enumerate(axes[: len(quantities)]):
        members = [i for i, quantity in enumerate(of.reshape(-1)) if quantity == q]
        axis.plot(*thin(monitored.time, belief[:, members[0]]), color=BLACK, lw=1.2, label="belief")
        what = monitored.recording.sensors[members[0]] if len(quantities) > 1 else ""
        axis.set_ylabel(with_unit("\n".join(["belief", *filter(None, [what])]), units[members[0]]))
    for i, axis in enumerate(axes[len(quantities) : -1]):
        _dots(axis, monitored, i, monitored.recording.y[:, i] - belief[:, i])
        axis.axhline(0.0, color="0.4", lw=0.8, zorder=0)
        axis.set_ylabel(monitored.recording.sensors[i] + (f"\n({units[i]})" if units[i] else ""), fontsize=8)
    for i, sensor in enumerate(monitored.recording.sensors):
        style: dict[str, Any] = {"color": colour_of(i), "ls": LINES[i % len(LINES)]}
        axes[-1].plot(*thin(monitored.time, monitored.fault_probability[:, i]), lw=1.3, label=sensor, **style)
    for j, name in enumerate(monitored.actuators):
        style = {"color": BLACK, "ls": LINES[j % len(LINES)]}
        shown = thin(monitored.time, monitored.actuator_fault_probability[:, j])
        axes[-1].plot(*shown, lw=1.3, label=f"actuator {name}", **style)
    axes[-1].set_ylim(-0.04, 1.04)
    axes[-1].set_ylabel("fault probability")
    for axis in axes:
        for event in monitored.events:
            axis.axvspan(
                event.start,
                event.end,
                color=colour_of(monitored.recording.sensors.index(event.sensor)),
                alpha=0.12,
                lw=0,
            )
        for alarm in monitored.actuator_events:
            axis.axvspan(alarm.start, alarm.end, fc="none", ec="0.8", hatch="///", lw=0, zorder=0)
    if monitored.events or monitored.actuator_events:
        axes[0].fill_between([], [], color="0.88", lw=0, label="shaded: an alarm")
    axes[len(quantities)].plot([], [], ".", color="0.4", label="samples minus\nbelief")
    for axis in (*axes[: len(quantities) + 1], axes[-1]):
        legend(axis)
    names = [
        (
            e.start,
            e.end,
            f"{e.sensor}: {e.kind}" if e.kind else e.sensor,
            colour_of(monitored.recording.sensors.index(e.sensor)),
        )
        for e in monitored.events
    ]
    names += [(e.start, e.end, f"{e.actuator}: {e.kind}", "0.35") for e in monitored.actuator_events]
    name_spans(axes[0], monitored.time, names, "alarms")
    finish(axes, monitored.time)
    return figure


def _dots(axis: Axes, monitored: Monitored, i: int, values: Floats) -> None:
    finite = np.isfinite(values)
    time, shown = thin(monitored.time[finite], values[finite])
    marker = MARKERS[i % len(MARKERS)]
    axis.plot(time, shown, marker, ms=1.6, mew=0, color=colour_of(i), alpha=0.7)
