"""The figure of a closed loop: signals and belief, samples, control, expected noise, and faults that the controller infers.

The colours are those of Okabe and Ito, which are distinct for all kinds of colour vision. Lines also differ in style, so that
they are distinct in black and white. Legends are beside the panels and cover nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.figures.fault_panels import (
    detection_panels,
    deviation_panels,
    draw_shades,
    name_faults,
)
from bayesftc.cosim.judging.figures.limits import limit_axis
from bayesftc.cosim.judging.figures.panels import (
    broken,
    drawable,
    finish,
    legend,
    make_panels,
    thin,
    thin_marks,
    with_peaks,
)
from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, MARKERS, colour_of
from bayesftc.cosim.judging.lost import loss_of
from bayesftc.cosim.judging.signals import ControlSignals, InputSignals, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LETTERS = 100
"""Largest number of letters in a line of the title."""
MAIN, NARROW, STRIP = 2.1, 1.5, 0.8
"""Heights of panels in inches: of a quantity, of an input, and of the samples of one sensor."""
MOST_STRIPS = 12
"""Largest number of sensors whose samples are drawn, so that the figure fits on a page."""
FEW_SAMPLES = 50
"""Most samples of a sensor that are drawn with larger marks: a reader looks for each of them."""
NORMAL_95 = 1.96
"""Half width in standard deviations of the interval that contains a normal variable with a probability of 95 %."""

COINCIDE = 0.01
"""Lines coincide if, for nine tenths of the run, they are nearer to each other than this share of the range of the panel."""

MOST_SHADED = 2
"""Largest number of faulty sensors whose faults are shaded in one panel, because the colours of more mix."""

AT_LOSS: dict[str, Any] = {"color": "#CC0000", "ls": (0, (1, 1)), "lw": 1.4, "zorder": 7}
"""Look of the line at which a loop is lost."""

_Panels = list[tuple[float, Callable[["Axes"], None], Sequence[int]]]
"""Panels: height, function that draws it, and the sensors of which the faults are shaded."""


def plot_run(signals: LoopSignals, title: str | None = None, figure: Figure | None = None) -> Figure:
    """Return the figure of a closed loop.

    From above, with time in seconds:

    - for each measured quantity its true value, its reference, and the belief: mean, and the mean plus and minus 1.96 standard
      deviations; if true value and reference coincide, a panel of their difference and of the error of the belief; below it
      the samples of each of its sensors with the mean of the belief;
    - for each control the sent signal, its limits, and with a fault in between the signal that the plant received; the same for
      other inputs of the plant with faults;
    - the standard deviation that the controller expects of each sensor (``1 / sqrt(precision)``). While it is more than a
      hundred times the smallest one of the same quantity, a sensor with an alarm has a bar above the values instead: filled for
      "ignored", or hatched for "corrected" if the controller subtracts an offset that it infers and still uses the sensor.
      Crosses are missing samples, but not the steps between two samples of a slow sensor;
    - the fault probability of each sensor and, in black, of each actuator whose faults the controller infers; above it the most
      probable kind of fault during an alarm. Without a probability: beta, with marks for detected faults. Without both there is
      no such panel.

    If a transient at the start would squeeze a panel, its belief or control is cut off there, with marks and the largest value.
    So are all lines and samples of a loop that is lost, from shortly before it is; a vertical line marks when.

    Present faults are named at the top, and shaded in the panels that they concern; those of an input are hatched in all. Lines
    have gaps at missing samples, except probabilities of learners that infer dropouts, and keep the value of the last sample
    between those of a slow sensor. Signals that were not recorded are left out.

    Parameters
    ----------
    signals : LoopSignals
        The signals, from `bayesftc.cosim.judging.roles.loop_signals`.
    title : str, optional
        Title of the figure.
    figure : Figure, optional
        An empty figure to draw on.
    """
    loss = loss_of(signals)
    until = None if loss is None else loss.shown
    panels: _Panels = []
    for quantity in signals.quantities:
        at: dict[str, Any] = {"time": signals.time, "quantity": quantity, "until": until}
        panels.append((MAIN, partial(draw_quantity, **at), quantity.sensors))
        if _coincide(quantity):
            panels.append((NARROW, partial(_draw_errors, **at), quantity.sensors))
        panels += _strips(signals, [signals.sensors[i] for i in quantity.sensors], quantity.belief, until)
    if not signals.quantities:
        panels += _strips(signals, signals.sensors, None, until)
    for j, control in enumerate(signals.controls):
        received = [each for each in signals.inputs if each.control == j]
        panels.append((NARROW, partial(_draw_control, time=signals.time, control=control, inputs=received), ()))
    for each in signals.inputs:
        if each.control is None or each.control >= len(signals.controls):
            panels.append((NARROW, partial(_draw_input, time=signals.time, each=each), ()))
    faulty = [sensor.index for sensor in signals.sensors if sensor.faulty is not None and sensor.faulty.any()]
    shown = faulty if len(faulty) <= MOST_SHADED else ()
    panels += [(height, draw, shown) for height, draw in (*deviation_panels(signals), *detection_panels(signals))]
    drawing, axes = make_panels([height for height, *_ in panels], figure)
    for axis, (_, draw, shaded) in zip(axes, panels, strict=True):
        draw(axis)
        draw_shades(axis, signals, shaded)
        if loss is not None:
            axis.axvline(
                float(signals.time[loss.row]), label="the loop is lost" if axis is axes[0] else None, **AT_LOSS
            )
    name_faults(axes[0], signals)
    for axis in axes:
        legend(axis)
    finish(axes, signals.time)
    if title:
        drawing.suptitle(fill(title, LETTERS), fontsize=10, x=0.01, ha="left")
    return drawing


def draw_quantity(axis: Axes, *, time: Floats, quantity: QuantitySignals, until: int | None = None) -> None:
    """Draw the true value, the reference and the belief of a quantity; the axis is scaled to the rows before `until`."""
    lines: list[tuple[str, Floats | None, dict[str, Any]]] = [
        # Broad and light below the others, because under a good controller the belief would hide the reference.
        ("reference", quantity.reference, {"color": "0.75", "ls": "-", "lw": 3.0, "zorder": 2}),
        ("true value", quantity.truth, {"color": BLACK, "ls": "-", "lw": 1.1, "zorder": 4}),
        ("belief: mean", quantity.belief, {"color": BLUE, "ls": (0, (5, 2)), "lw": 1.3, "zorder": 5}),
    ]
    for label, values, look in lines:
        if values is not None:
            axis.plot(*thin(time, values), label=label, **look)
    cut, what = [] if quantity.belief is None else [quantity.belief], ""
    if quantity.belief is not None and quantity.spread is not None:
        cut = [quantity.belief - NORMAL_95 * quantity.spread, quantity.belief + NORMAL_95 * quantity.spread]
        what = "95 % interval"  # wide before the first samples, while the belief is inside
        kept = with_peaks(quantity.belief)
        low, high = (drawable(limit[kept]) for limit in cut)
        style: dict[str, Any] = {"color": BLUE, "alpha": 0.35, "lw": 0, "zorder": 3}
        axis.fill_between(time[kept], low, high, label="belief: 95 % interval", **style)
    axis.set_ylabel(broken(with_unit(quantity.name, quantity.unit), MAIN))
    whole = [values for values in (quantity.truth, quantity.reference) if values is not None]
    limit_axis(axis, time, whole, cut, what, until)


def _coincide(quantity: QuantitySignals) -> bool:
    """Whether true value and reference cannot be told apart in their panel, such as those of a precise axis."""
    if quantity.truth is None or quantity.reference is None:
        return False
    apart = np.abs(quantity.truth - quantity.reference)
    known = np.isfinite(apart)
    size = np.ptp([quantity.truth[known], quantity.reference[known]]) if known.any() else 0.0
    return bool(size > 0.0) and float(np.quantile(apart[known], 0.9)) < COINCIDE * float(size)


def _draw_errors(axis: Axes, *, time: Floats, quantity: QuantitySignals, until: int | None) -> None:
    """Draw what the panel above does not resolve: the tracking error, and the error of the belief within its interval."""
    assert quantity.truth is not None
    assert quantity.reference is not None
    tracking, whole = quantity.truth - quantity.reference, []
    axis.plot(*thin(time, tracking), color=BLACK, lw=1.0, zorder=4, label="true value - reference")
    if quantity.belief is not None:
        whole = [quantity.belief - quantity.truth]
        axis.plot(*thin(time, whole[0]), color=BLUE, ls=(0, (5, 2)), lw=1.0, zorder=5, label="belief - true value")
        if quantity.spread is not None:
            kept = with_peaks(quantity.spread)
            half = drawable(NORMAL_95 * quantity.spread)
            style: dict[str, Any] = {"color": BLUE, "alpha": 0.35, "lw": 0, "zorder": 3}
            axis.fill_between(
                time[kept], -half[kept], half[kept], label="95 % interval of\nthe belief's error", **style
            )
            whole += [half, -half]
    axis.set_ylabel(broken(with_unit(f"error of {quantity.name}", quantity.unit), NARROW))
    limit_axis(axis, time, [], [tracking, *whole], until=until)


def _strips(signals: LoopSignals, sensors: Any, belief: Floats | None, until: int | None) -> _Panels:
    """Return a panel for the samples of each sensor, because samples of redundant sensors would hide each other."""
    recorded = [sensor for sensor in sensors if sensor.samples is not None]
    shown = recorded[:MOST_STRIPS]
    panels: _Panels = []
    for number, sensor in enumerate(shown):
        rest = f"\n({len(recorded) - len(shown)} more sensors are not drawn)" if len(recorded) > len(shown) else ""
        label = None if number else f"samples{rest}"
        draw = partial(_draw_samples, time=signals.time, sensor=sensor, belief=belief, label=label, until=until)
        panels.append((STRIP, draw, (sensor.index,)))
    return panels


def _draw_samples(
    axis: Axes, *, time: Floats, sensor: SensorSignals, belief: Floats | None, label: str | None, until: int | None
) -> None:
    """Draw samples and belief; with a label for the samples, both are in the legend (only for the first sensor)."""
    if belief is not None:
        limit_axis(axis, time, [] if sensor.samples is None else [sensor.samples], [belief], until=until)
        axis.plot(*thin(time, belief), color=BLUE, lw=0.8, zorder=2, label=label and "belief: mean")
    assert sensor.samples is not None
    # Before thinning, which may leave none of the samples of a slow sensor with its pauses.
    given = ~np.isnan(sensor.samples)
    size = 2.0 if given.sum() > FEW_SAMPLES else 4.0
    style: dict[str, Any] = {"ls": "none", "marker": MARKERS[sensor.index % len(MARKERS)], "ms": size, "mew": 0}
    axis.plot(
        *thin_marks(time[given], sensor.samples[given]),
        color=colour_of(sensor.index),
        alpha=0.6,
        zorder=3,
        label=label,
        **style,
    )
    axis.set_ylabel(f"sensor {sensor.index}" + (f"\n({sensor.unit})" if sensor.unit else ""), fontsize=8)


def _draw_control(axis: Axes, *, time: Floats, control: ControlSignals, inputs: list[InputSignals]) -> None:
    _draw_sent(axis, time, control.sent, "control")
    for each in inputs:
        if each.received is not None:
            axis.plot(*thin(time, each.received), color=BLACK, lw=0.9, zorder=4, label=f"received by {each.name}")
    limits = [limit for limit in (control.low, control.high) if limit is not None]
    lines = [axis.axhline(limit, color="0.4", lw=0.9, ls=":", zorder=1) for limit in limits]
    axis.set_ylabel(broken(with_unit(control.name, control.unit), NARROW))
    limit_axis(axis, time, [], [control.sent, *(each.received for each in inputs if each.received is not None)])
    low, high = axis.get_ylim()
    seen = [line for line, limit in zip(lines, limits, strict=True) if low <= limit <= high]
    for line in seen[:1]:
        line.set_label("limits of the control" if len(seen) > 1 else "limit of the control")


def _draw_input(axis: Axes, *, time: Floats, each: InputSignals) -> None:
    if each.sent is not None:
        _draw_sent(axis, time, each.sent, "sent")
    if each.received is not None:
        axis.plot(*thin(time, each.received), color=BLACK, lw=0.9, zorder=4, label="received")
    axis.set_ylabel(broken(with_unit(each.name, each.unit), NARROW))
    limit_axis(axis, time, [], [values for values in (each.sent, each.received) if values is not None])


def _draw_sent(axis: Axes, time: Floats, values: Floats, label: str) -> None:
    axis.plot(*thin(time, values), color="#6BAED6", lw=1.6, zorder=3, label=label)


__all__ = ["draw_quantity", "plot_run"]
