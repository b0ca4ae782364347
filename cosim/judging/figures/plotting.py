"""The figure of any signals over time.

The colours are those of Okabe and Ito, which are distinct for all kinds of colour vision. Lines also differ in style, so that
they are distinct in black and white. Legends are beside the panels and cover nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.judging.figures.panels import PANEL, broken, finish, legend, make_panels, thin
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.diagram.roles import LoopRoles, Place
    from bayesftc.cosim.run.result import Result

BLACK, BLUE = "#000000", "#0072B2"
SENSOR_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#882255", "#999933", "#6E7F80")
LINES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "D", "P", "X")
"""Marks of samples: symmetric, because a small triangle seems to lie beside its sample; filled, because they have no edge."""

OF_SENSORS = ("innovation", "precision", "beta", "fault_size")
"""Outputs of a controller with an element for each sensor, in its unit or a power of it."""


def plot_signals(result: Result, signals: Iterable[str] | None = None, figure: Figure | None = None) -> Figure:
    """Return a figure of a result's signals over time, with a panel for each unit, and for each signal without one.

    A vector whose elements belong to several quantities, such as the samples of all sensors, has a panel for each of them.

    Parameters
    ----------
    result : Result
        The run.
    signals : iterable of str, optional
        Names of signals; by default all scalars and vectors that have a number at some time.
    figure : Figure, optional
        An empty figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        Save it (``figure.savefig("run.png")``), or return it from a notebook's cell to show it.

    Raises
    ------
    UnknownNameError
        If the result has no signal of one of the names.
    """
    if signals is None:
        signals = [name for name in result if result[name].ndim < 3 and not np.isnan(result[name]).all()]
    panels: dict[str, list[tuple[str, Floats]]] = {}
    parts = {} if result.roles is None else _panels_of_elements(result.roles)
    for name in [signals] if isinstance(signals, str) else signals:
        values = result[name]
        columns = values.reshape(len(values), -1).T
        own = [parts.get((name, i), name) for i in range(len(columns))]
        known = result.units.get(name) or (name if len(set(own)) == 1 else None)
        for label, column, key in zip(labels(name, values.shape[1:]), columns, own, strict=True):
            panels.setdefault(known or key, []).append((label, column))
    figure, axes = make_panels([PANEL] * max(len(panels), 1), figure)
    colours = (BLACK, BLUE, *SENSOR_COLOURS)
    for axis, (key, lines) in zip(axes, panels.items(), strict=False):
        for i, (label, values) in enumerate(lines):
            style = LINES[i // len(colours) % len(LINES)]
            axis.plot(*thin(result.time, values), style, color=colours[i % len(colours)], lw=1.1, label=label)
        axis.set_ylabel(broken(key, PANEL))
        if all(np.isnan(values).all() for _, values in lines):
            axis.text(0.5, 0.5, "no value", transform=axis.transAxes, ha="center", color="0.35")
        legend(axis)
    finish(axes, result.time)
    return figure


def _panels_of_elements(roles: LoopRoles) -> dict[Place, str]:
    """Return the panel of each element of a loop's signals whose quantity is known: its unit, or the signal and the quantity.

    What a controller infers of a sensor has a panel without the sensor's values, because it is much smaller.
    """
    names = {i: quantity.name for quantity in roles.quantities for i in quantity.sensors}
    panels: dict[Place, str] = {}
    for i, sensor in enumerate(roles.sensors):
        measured = sensor.unit or names.get(i, f"sensor {i}")
        for signal in (roles.readings, *(f"{fault}.y" for each in roles.sensors for fault in each.faults)):
            panels[signal, i] = sensor.unit or f"{signal}\n{measured}"
        if sensor.samples is not None:
            panels[sensor.samples] = sensor.unit or f"{sensor.samples[0]}\n{measured}"
        for output in OF_SENSORS:
            signal = f"{roles.controller}.{output}"
            panels[signal, i] = f"{signal}\n{f'sensors in {sensor.unit}' if sensor.unit else measured}"
    for quantity in roles.quantities:
        places = [quantity.reference] if quantity.reference else []
        places += [place for weight, place in quantity.truth or () if len(quantity.truth or ()) == 1 and weight == 1.0]
        if quantity.belief and sorted(quantity.belief)[-1] == sum(map(abs, quantity.belief)) == 1.0:
            places.append((f"{roles.controller}.x_hat", quantity.belief.index(1.0)))
        for place in places:
            panels[place] = quantity.unit or f"{place[0]}\n{quantity.name}"
    for j, control in enumerate(roles.controls):
        place = control.sent or (f"{roles.controller}.u", j)
        panels[place] = control.unit or f"{place[0]}\n{control.name}"
    return panels


def colour_of(sensor: int) -> str:
    """Return the colour of a sensor."""
    return SENSOR_COLOURS[sensor % len(SENSOR_COLOURS)]


__all__ = ["colour_of", "plot_signals"]
