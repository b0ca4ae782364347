"""The figure of a monitored recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.recordings.columns import bare_name
from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.figures.panels import (
    ROW,
    as_dates,
    broken,
    finish,
    have_room,
    legend,
    make_panels,
    name_spans,
    thin,
    thin_marks,
    write_names,
)
from bayesftc.cosim.judging.figures.plotting import BLACK, LINES, MARKERS, colour_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.monitoring.alarms import ActuatorEvent, FaultEvent
    from bayesftc.monitoring.gaps import Gap
    from bayesftc.monitoring.recording import Recording
    from bayesftc.monitoring.run import Monitored


LEAST_WIDTH = 0.003
"""Least width of the shade of an alarm, as a share of the recording: two or three pixels."""

MAIN, STRIP = 1.9, 0.85
"""Heights of panels in inches: for a quantity, and for one sensor's samples."""


def plot_monitored(monitored: Monitored, figure: Figure | None = None) -> Figure:
    """Return a figure: the belief of each quantity, a panel with samples minus belief per sensor, and the faults.

    Parameters
    ----------
    monitored : Monitored
        The results. Alarms are shaded in the colour of their sensor; those of actuators are hatched.
    figure : Figure, optional
        An empty figure to draw on.
    """
    quantities = monitored.model.alike
    recording = monitored.recording
    clock, sensors = _Clock(recording), [bare_name(sensor) for sensor in recording.sensors]
    time, units = clock(monitored.time), recording.units
    spans = [_Span(clock, event, recording.sensors.index(event.sensor)) for event in monitored.events]
    names = [(s.start, s.end, ": ".join(filter(None, [sensors[s.sensor], s.kind])), s.colour) for s in spans]
    names += [(*clock.ends(e), f"{e.actuator}: {e.kind}", "0.35") for e in monitored.actuator_events]
    many = not have_room(time, names)  # then each sensor has the kinds of its faults above its own panel
    strips = [STRIP + ROW * (many and any(s.kind and s.sensor == i for s in spans)) for i in range(len(sensors))]
    heights = [MAIN] * len(quantities) + strips + [MAIN]
    figure, axes = make_panels(heights, figure)
    belief = monitored.x_hat @ monitored.model.quantities.T
    several = len(quantities) > 1
    for members, axis in zip(quantities, axes, strict=False):
        i = members[0]
        values = recording.as_read(i, belief[:, i]) if several else belief[:, i]
        axis.plot(*thin(time, values), color=BLACK, lw=1.2, label="belief")
        what = f"belief of what\n{sensors[i]} reads" if several else "belief"
        axis.set_ylabel(broken(with_unit(what, units[i]), MAIN))
    for i, axis in enumerate(axes[len(quantities) : -1]):
        _dots(axis, i, time, recording.y[:, i] - belief[:, i])
        axis.axhline(0.0, color="0.4", lw=0.8, zorder=0)
        axis.set_ylabel(broken(sensors[i] + (f"\n({units[i]})" if units[i] else ""), STRIP, 8.0), fontsize=8)
    for i, sensor in enumerate(sensors):
        style: dict[str, Any] = {"color": colour_of(i), "ls": LINES[i % len(LINES)]}
        axes[-1].plot(*thin(time, monitored.fault_probability[:, i]), lw=1.3, label=sensor, **style)
    for j, name in enumerate(monitored.actuators):
        style = {"color": BLACK, "ls": LINES[j % len(LINES)]}
        shown = thin(time, monitored.actuator_fault_probability[:, j])
        axes[-1].plot(*shown, lw=1.3, label=f"actuator {name}", **style)
    threshold = monitored.alarm.threshold
    axes[-1].axhline(threshold, color="0.4", lw=0.8, zorder=0, label=f"alarm from {threshold:g}")
    axes[-1].set_ylim(-0.04, 1.04)
    axes[-1].set_ylabel("fault probability")
    _shade(axes, clock, monitored, spans)
    axes[len(quantities)].plot([], [], ".", color="0.4", label="samples minus\nbelief")
    for axis in (*axes[: len(quantities) + 1], axes[-1]):
        legend(axis)
    events: tuple[FaultEvent | ActuatorEvent, ...] = (*monitored.events, *monitored.actuator_events)
    count = sum(not event.continued for event in events)
    name_spans(axes[0], time, names, f"shaded: {count} alarms, in the colour of their sensor")
    if many:
        for i, axis in enumerate(axes[len(quantities) : -1]):
            kinds = [(s.start, s.end, s.kind, s.colour) for s in spans if s.kind and s.sensor == i]
            write_names(axis, time, kinds, STRIP)
    finish(axes, time, recording.origin)
    return figure


class _Clock:
    """The places of times on the axis: seconds, or matplotlib's dates if the recording has dates."""

    def __init__(self, recording: Recording):
        self._origin = recording.origin

    def __call__(self, time: Floats) -> Floats:
        return time if self._origin is None else as_dates(time, self._origin)

    def ends(self, event: FaultEvent | ActuatorEvent | Gap) -> tuple[float, float]:
        start, end = self(np.array([event.start, event.end])).tolist()
        return start, end


class _Span:
    """The place of an alarm on the axis, the number of its sensor, and its kind."""

    def __init__(self, clock: _Clock, event: FaultEvent, sensor: int):
        self.start, self.end = clock.ends(event)
        self.sensor, self.kind, self.colour = sensor, event.kind or "", colour_of(sensor)

    def wide(self, least: float) -> tuple[float, float]:
        """Return start and end, at least so far from each other."""
        more = max(least - (self.end - self.start), 0.0) / 2
        return self.start - more, self.end + more


def _shade(axes: list[Axes], clock: _Clock, monitored: Monitored, spans: list[_Span]) -> None:
    """Shade alarms in all panels, short ones wider and darker, and name what is shaded beside the first."""
    ends = clock(monitored.time[[0, -1]])
    least = LEAST_WIDTH * float(ends[1] - ends[0])
    for axis in axes:
        for span in spans:
            axis.axvspan(
                *span.wide(least), color=span.colour, alpha=0.12 if span.end - span.start > least else 0.4, lw=0
            )
        for alarm in monitored.actuator_events:
            axis.axvspan(*clock.ends(alarm), fc="none", ec="0.8", hatch="///", lw=0, zorder=0)
    if monitored.events or monitored.actuator_events:
        axes[0].fill_between([], [], color="0.88", lw=0, label="shaded: an alarm")
    gaps = [(begin, end - begin) for begin, end in map(clock.ends, monitored.recording.gaps)]
    dotted: dict[str, Any] = {"fc": "none", "ec": "0.75", "hatch": "...", "lw": 0}
    for axis in axes if gaps else ():
        axis.broken_barh(gaps, (0.0, 1.0), transform=axis.get_xaxis_transform(), zorder=0, **dotted)
    if gaps:
        axes[0].fill_between([], [], label="dotted: a gap of\nthe recording", **dotted)


def _dots(axis: Axes, i: int, time: Floats, values: Floats) -> None:
    finite = np.isfinite(values)
    marker = MARKERS[i % len(MARKERS)]
    axis.plot(*thin_marks(time[finite], values[finite]), marker, ms=1.6, mew=0, color=colour_of(i), alpha=0.7)
