"""The figure of a monitored recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.panels import PANEL, finish, legend, make_panels, name_spans, thin
from bayesftc.cosim.judging.plotting import BLACK, LINES, MARKERS, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.monitoring.run import Monitored


def plot_monitored(found: Monitored, figure: Figure | None = None) -> Figure:
    """Return a figure: for each quantity that is measured the samples and the belief, then their distance, then the faults.

    Parameters
    ----------
    found : Monitored
        Alarms are shaded in the colour of their sensor; those of actuators are hatched.
    figure : Figure, optional
        An empty one to draw on.
    """
    plant = found.model.states - found.model.disturbances
    rows = found.model.quantities[:, :plant]
    quantities, of = np.unique(rows, axis=0, return_inverse=True)
    figure, axes = make_panels([PANEL] * (len(quantities) + 2), figure)
    believed = found.x_hat[:, :plant] @ rows.T
    units = found.recording.units
    for q, axis in enumerate(axes[: len(quantities)]):
        members = [i for i, quantity in enumerate(of.reshape(-1)) if quantity == q]
        for i in members:
            _dots(axis, found, i, found.recording.y[:, i])
        axis.plot(*thin(found.time, believed[:, members[0]]), color=BLACK, lw=1.2, label="belief")
        axis.set_ylabel("samples" + _of(units[members[0]]))
    for i in range(len(units)):
        _dots(axes[-2], found, i, found.recording.y[:, i] - believed[:, i])
    axes[-2].set_ylabel("sample minus belief" + _of(units[0] if len(set(units)) == 1 else ""))
    for i, sensor in enumerate(found.recording.sensors):
        style: dict[str, Any] = {"color": _colour(i), "ls": LINES[i % len(LINES)]}
        axes[-1].plot(*thin(found.time, found.fault_probability[:, i]), lw=1.3, label=sensor, **style)
    for j, name in enumerate(found.actuators):
        style = {"color": BLACK, "ls": LINES[j % len(LINES)]}
        shown = thin(found.time, found.actuator_fault_probability[:, j])
        axes[-1].plot(*shown, lw=1.3, label=f"actuator {name}", **style)
    axes[-1].set_ylim(-0.04, 1.04)
    axes[-1].set_ylabel("fault probability")
    for axis in axes:
        for event in found.events:
            axis.axvspan(
                event.start, event.end, color=_colour(found.recording.sensors.index(event.sensor)), alpha=0.12, lw=0
            )
        for blamed in found.actuator_events:
            axis.axvspan(blamed.start, blamed.end, fc="none", ec="0.8", hatch="///", lw=0, zorder=0)
    for axis in (*axes[:-2], axes[-1]):
        legend(axis)
    names = [
        (
            e.start,
            e.end,
            f"{e.sensor}: {e.kind}" if e.kind else e.sensor,
            _colour(found.recording.sensors.index(e.sensor)),
        )
        for e in found.events
    ]
    names += [(e.start, e.end, f"{e.actuator}: {e.kind}", "0.35") for e in found.actuator_events]
    name_spans(axes[0], found.time, names, "alarms")
    finish(axes, found.time)
    return figure


def _dots(axis: Axes, found: Monitored, i: int, values: Floats) -> None:
    known = np.isfinite(values)
    time, shown = thin(found.time[known], values[known])
    marker = MARKERS[i % len(MARKERS)]
    axis.plot(time, shown, marker, ms=1.6, mew=0, color=_colour(i), alpha=0.7, label=found.recording.sensors[i])


def _colour(i: int) -> str:
    return SENSOR_COLOURS[i % len(SENSOR_COLOURS)]


def _of(unit: str) -> str:
    return f" ({unit})" if unit else ""
