"""Figures of a run: any signals over time, and the story of a closed loop with faulty sensors.

Colours are those of Okabe and Ito, which people with any kind of colour vision can tell apart; lines differ in style as well,
so that they can be told apart in black and white. Legends stand beside the panels and cover nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.panels import finish, legend, make_panels, name_spans, thin
from bayesftc.cosim.judging.signals import ALARM, Flags, InputSignals, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.cosim.run.result import Result

BLACK, BLUE = "#000000", "#0072B2"
SENSOR_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
LINES = ("-", "--", "-.", ":")
MARKERS = ("o", "^", "s", "D", "v")
LONGEST = 24
"""More letters than this a label has not beside a panel."""


def plot_signals(result: Result, signals: Iterable[str] | None = None) -> Figure:
    """Return a figure of a result's signals over time, with a panel for each unit, and for each signal without one.

    Parameters
    ----------
    result : Result
        The run.
    signals : iterable of str, optional
        Names of signals; by default all scalars and vectors that have a number at some time.

    Returns
    -------
    matplotlib.figure.Figure
        To be saved (``figure.savefig("run.png")``) or shown by a notebook.

    Raises
    ------
    UnknownNameError
        If the result has no signal of one of the names.
    """
    if signals is None:
        signals = [name for name in result if result[name].ndim < 3 and not np.isnan(result[name]).all()]
    panels: dict[str, list[tuple[str, Floats]]] = {}
    for name in [signals] if isinstance(signals, str) else signals:
        values = result[name]
        columns = values.reshape(len(values), -1).T
        for label, column in zip(labels(name, values.shape[1:]), columns, strict=True):
            panels.setdefault(result.units.get(name) or name, []).append((label, column))
    figure, axes = make_panels(max(len(panels), 1))
    colours = (BLACK, BLUE, *SENSOR_COLOURS)
    for axis, (key, lines) in zip(axes, panels.items(), strict=False):
        for i, (label, values) in enumerate(lines):
            style = LINES[i // len(colours) % len(LINES)]
            axis.plot(*thin(result.time, values), style, color=colours[i % len(colours)], lw=1.1, label=label)
        axis.set_ylabel(_broken(key))
        if all(np.isnan(values).all() for _, values in lines):
            axis.text(0.5, 0.5, "no value", transform=axis.transAxes, ha="center", color="0.35")
        legend(axis)
    finish(axes, result.time)
    return figure


def plot_run(signals: LoopSignals, title: str | None = None) -> Figure:
    """Return the figure of a closed loop: what was measured and believed, the sensors' precisions, and the faults seen.

    Above, a panel for each measured quantity: true value, reference, samples as dots, the controller's belief; and one for each
    input of the plant with a fault on its way: what was sent, and what the plant received. Then the
    standard deviation that the controller expects of each sensor (``1 / sqrt(precision)``), with marks at the top for samples
    that it ignores altogether and for missing ones, and the fault probability of each sensor and, in black, of each actuator of
    whose faults the controller knows, or where there is none beta, with marks where a fault is detected; those of sensors have
    gaps where samples are missing. Faults are shaded, those of an input hatched.

    Parameters
    ----------
    signals : LoopSignals
        From `bayesftc.cosim.judging.roles.loop_signals`; what was not recorded is left out.
    title : str, optional
        Stands above.
    """
    figure, axes = make_panels(len(signals.quantities) + len(signals.inputs) + 2)
    for axis, quantity in zip(axes, signals.quantities, strict=False):
        _draw_quantity(axis, signals, quantity)
    for axis, each in zip(axes[len(signals.quantities) :], signals.inputs, strict=False):
        _draw_input(axis, signals.time, each)
    unit = signals.quantities[0].unit if len({q.unit for q in signals.quantities}) == 1 else None
    _draw_deviation(axes[-2], signals, unit)
    _draw_detection(axes[-1], signals)
    for axis in axes:
        _shade(axis, signals)
        legend(axis)
    _name_faults(axes[0], signals)
    finish(axes, signals.time)
    if title:
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def _broken(label: str) -> str:
    """Return a label in lines that are no longer than a panel is high, broken after points and underscores."""
    lines = [""]
    for part in re.findall(r"[^._]*[._]?", label):
        if lines[-1] and len(lines[-1]) + len(part) > LONGEST:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _draw_quantity(axis: Axes, signals: LoopSignals, quantity: QuantitySignals) -> None:
    time = signals.time
    for i in quantity.sensors:
        samples = signals.sensors[i].samples
        if samples is not None:
            style: dict[str, Any] = {
                "ls": "none",
                "marker": MARKERS[i % len(MARKERS)],
                "ms": 2.2,
                "mew": 0,
                "alpha": 0.35,
                "zorder": 1,
            }
            axis.plot(*thin(time, samples), color=_colour(i), label=f"sensor {i}", **style)
    lines: list[tuple[str, Floats | None, dict[str, Any]]] = [
        # Broad and light below the others: under a good controller the belief lies on the reference and would hide it.
        ("reference", quantity.reference, {"color": "0.72", "ls": "-", "lw": 4.0, "zorder": 3}),
        ("true value", quantity.truth, {"color": BLACK, "ls": "-", "lw": 1.5, "zorder": 4}),
        ("belief", quantity.belief, {"color": BLUE, "ls": (0, (5, 2)), "lw": 1.3, "zorder": 5}),
    ]
    for label, values, look in lines:
        if values is not None:
            axis.plot(*thin(time, values), label=label, **look)
    axis.set_ylabel(f"{quantity.name} ({quantity.unit})" if quantity.unit else quantity.name)


def _draw_input(axis: Axes, time: Floats, signals: InputSignals) -> None:
    lines: list[tuple[str, Floats | None, dict[str, Any]]] = [
        ("sent", signals.sent, {"color": "#9ECAE1", "ls": "-", "lw": 3.0, "zorder": 3}),
        ("received", signals.received, {"color": BLACK, "ls": "-", "lw": 0.9, "zorder": 4}),
    ]
    for label, values, look in lines:
        if values is not None:
            axis.plot(*thin(time, values), label=label, **look)
    axis.set_ylabel(f"{signals.name} ({signals.unit})" if signals.unit else signals.name)


def _draw_deviation(axis: Axes, signals: LoopSignals, unit: str | None) -> None:
    drawn = []
    for sensor in signals.sensors:
        if sensor.precision is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = np.where(sensor.precision > 0, 1.0 / np.sqrt(sensor.precision), np.nan)
        expected = _given(sensor, expected)
        drawn.append(expected)
        axis.plot(*thin(signals.time, expected), **_line(sensor))
        missing = np.zeros(len(signals.time), dtype=bool) if sensor.missing is None else sensor.missing
        _mark(axis, signals, sensor, "ignored", "|", (sensor.precision == 0) & ~missing)
        _mark(axis, signals, sensor, "missing", "x", missing)
    axis.set_ylabel("expected standard\ndeviation" + (f" ({unit})" if unit else ""))
    _logarithmic(axis, drawn)


def _mark(axis: Axes, signals: LoopSignals, sensor: SensorSignals, what: str, marker: str, where: Flags) -> None:
    """Mark times of a sensor at the top of an axis."""
    if where.any():
        top = np.full(int(where.sum()), 0.97 - 0.05 * sensor.index)
        style: dict[str, Any] = {
            "ls": "none",
            "marker": marker,
            "ms": 5 if marker == "|" else 2.5,
            "color": _colour(sensor.index),
            "transform": axis.get_xaxis_transform(),
        }
        axis.plot(*thin(signals.time[where], top), label=f"sensor {sensor.index} {what}", **style)


def _logarithmic(axis: Axes, drawn: list[Floats]) -> None:
    """Make the axis logarithmic, with ticks at 1, 2, 5 where powers of ten alone would leave one number or none."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_yscale("log")
    known = np.concatenate(drawn) if drawn else np.array([])
    known = known[np.isfinite(known) & (known > 0)]
    if len(known) and known.max() < 100 * known.min():
        axis.set_ylim(0.8 * known.min(), 1.3 * known.max())
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.yaxis.set_minor_formatter(NullFormatter())


def _draw_detection(axis: Axes, signals: LoopSignals) -> None:
    known = [s for s in signals.sensors if s.probability is not None and not np.isnan(s.probability).all()]
    if known or signals.actuators:
        for sensor in known:
            assert sensor.probability is not None
            axis.plot(*thin(signals.time, _given(sensor, sensor.probability)), **_line(sensor))
        for j, actuator in enumerate(signals.actuators):
            # As those of an input, whose faults are hatched: no colour, for these are the sensors'.
            style: dict[str, Any] = {"color": BLACK, "ls": LINES[j % len(LINES)], "lw": 1.3, "zorder": 3}
            axis.plot(*thin(signals.time, actuator.probability), label=f"actuator {actuator.name}", **style)
        axis.axhline(ALARM, color="0.4", lw=0.8, zorder=0, label=f"alarm from {ALARM:g}")
        axis.set_ylim(-0.04, 1.04)
        axis.set_ylabel("fault probability")
        return
    rated = [s for s in signals.sensors if s.beta is not None and not np.isnan(s.beta).all()]
    for sensor in rated:
        assert sensor.beta is not None
        axis.plot(*thin(signals.time, _given(sensor, sensor.beta)), **_line(sensor))
    for sensor in signals.sensors:
        if sensor.alarm is not None:
            _mark(axis, signals, sensor, "detected", "|", sensor.alarm)
    axis.set_ylabel("beta")
    if rated:
        _logarithmic(axis, [s.beta for s in rated if s.beta is not None])
    else:
        axis.set_yticks([])
        axis.set_ylabel("fault probability")
        axis.text(
            0.5,
            0.5,
            "no fault probability and no beta in this run",
            transform=axis.transAxes,
            ha="center",
            color="0.35",
        )


def _shade(axis: Axes, signals: LoopSignals) -> None:
    """Shade the faults of each sensor in its colour, over the whole height."""
    for sensor in signals.sensors:
        where = sensor.faulty
        if where is not None and where.any():
            height = axis.get_xaxis_transform()
            style: dict[str, Any] = {
                "color": _colour(sensor.index),
                "alpha": 0.12,
                "lw": 0,
                "zorder": 0,
                "step": "post",
            }
            axis.fill_between(signals.time, 0, 1, where=where, transform=height, **style)
    for each in signals.inputs:
        if each.faulty is not None and each.faulty.any():
            height = axis.get_xaxis_transform()
            style = {"fc": "none", "ec": "0.8", "hatch": "///", "lw": 0, "zorder": 0, "step": "post"}
            axis.fill_between(signals.time, 0, 1, where=each.faulty, transform=height, **style)


def _name_faults(axis: Axes, signals: LoopSignals) -> None:
    """Write each fault's name above its period, or one note where there are too many."""
    faults = [
        (a, b, f"sensor {i}: {_kind(name, '', f'_{i}')}", _colour(i))
        for name, (i, active) in signals.faults.items()
        for a, b in periods(active)
    ]
    faults += [
        (a, b, f"{each.name}: {_kind(name, f'{each.name}_', '_0')}", "0.35")
        for each in signals.inputs
        for name, active in each.faults.items()
        if active is not None
        for a, b in periods(active)
    ]
    named = [(float(signals.time[a]), float(signals.time[b - 1]), text, colour) for a, b, text, colour in faults]
    name_spans(axis, signals.time, named, "faults")


def _kind(name: str, of: str, number: str) -> str:
    """Return the kind of fault in a default name such as ``freeze_1``; a name that was given stays as it is."""
    kind = name.removeprefix(of).removesuffix(number)
    return name if kind == name else kind.replace("_", " ")


def _given(sensor: SensorSignals, values: Floats) -> Floats:
    """Return a learner's output with a gap where there was no sample to learn from: it only relaxes there, and says nothing."""
    return values if sensor.missing is None else np.where(sensor.missing, np.nan, values)


def _line(sensor: SensorSignals) -> dict[str, Any]:
    i = sensor.index
    return {"color": _colour(i), "ls": LINES[i % len(LINES)], "lw": 1.3, "label": f"sensor {i}"}


def _colour(sensor: int) -> str:
    return SENSOR_COLOURS[sensor % len(SENSOR_COLOURS)]


__all__ = ["plot_run", "plot_signals"]
