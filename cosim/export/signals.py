"""What of a program the outside sees: its inputs and outputs, and what it can change between steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.export.tunables import Element, settings_of
from bayesftc.cosim.export.units import Units, unit_of_setting
from bayesftc.cosim.ports import Port, labels

Place = tuple[Node, Port, int]
Places = tuple[Place, ...]


class OneElement(tuple[Place]):
    """One element of a port, which the outside sees as a number even where the port has no other."""


@dataclass(frozen=True)
class Signal:
    """An input or output that the outside sees.

    Parameters
    ----------
    name : str
        What the outside calls it.
    shape : tuple of int
        ``()`` for a number.
    unit : str or None
        As its port says.
    start : tuple of float
        Of an input, what it is until it is set.
    places : tuple of int
        Where its elements lie in the memory of the schedule.
    draw : str or None
        Of an input that takes random numbers, their distribution.
    description : str
        What it is, in words.
    origin : str
        What it is called in the diagram, as ``controller.y``.
    """

    name: str
    shape: tuple[int, ...]
    unit: str | None
    start: tuple[float, ...]
    places: tuple[int, ...]
    draw: str | None = None
    description: str = ""
    origin: str = ""


@dataclass(frozen=True)
class Tunable:
    """A parameter of a step function that the outside may change while it runs.

    Parameters
    ----------
    name : str
        What the outside calls it.
    shape : tuple of int
        ``()`` for a number.
    start : tuple of float
        What it is until it is changed.
    node : int
        The number of its block in the schedule.
    parameter : str or None
        If it is all of one parameter of the step functions, in the same order: the name of that.
    description : str
        What it is, in words.
    setting : str
        What the block calls it, as ``precision.forgetting``.
    places : tuple of tuple of (str, int)
        Where each of its numbers stands among the parameters: in which, and which element of it, row by row.
    unit : str or None
        As the block says, or that of the port that the block names.
    """

    name: str
    shape: tuple[int, ...]
    start: tuple[float, ...]
    node: int
    parameter: str | None
    description: str = ""
    setting: str = ""
    places: tuple[tuple[Element, ...], ...] = ()
    unit: str | None = None


def signal_of(schedule: Schedule, label: str, places: Places, units: Units) -> Signal:
    """Return the signal of this name that these elements of a port are."""
    node, port, _ = places[0]
    begin = schedule.signal(node, port).start
    at = tuple(begin + i for _, _, i in places)
    shape = port.shape if len(places) == port.size and not isinstance(places, OneElement) else ()
    drawn = {"uniform": 0.5, "normal": 0.0}.get(port.draw or "")
    start = tuple(float(schedule.initial[i]) if drawn is None else drawn for i in at)
    if any(port.name == output.name for output in node.block.outputs):
        start = (0.0,) * len(at)
    origin = f"{node.name}.{port.name}"
    if len(places) < port.size:
        origin = labels(origin, port.shape)[places[0][2]]
    unit, description = units.get((node.name, port.name)), port.description or _description(node, port)
    return Signal(label, shape, unit, start, at, port.draw, description, origin)


def _description(node: Node, port: Port) -> str:
    if port.draw == "normal":
        return "Standard normal random numbers, new ones at each step; 0 for none"
    if port.draw == "uniform":
        return "Random numbers uniform in (0, 1), new ones at each step"
    return f"{port.name} of {type(node.block).__name__}"


def tunables_of(schedule: Schedule, alone: bool, units: Units) -> Iterator[Tunable]:
    """Yield the settings of all blocks that may change; `alone` says that they need no block's name before them."""
    for i, (node, definition) in enumerate(zip(schedule.nodes, schedule.definitions, strict=True)):
        if definition is None or node.name == OUTSIDE:
            continue
        for setting in settings_of(node.block, definition, schedule.step * node.every):
            label = setting.name if alone else f"{node.name}.{setting.name}"
            whole = {each[0][0] for each in setting.places}
            name = min(whole)
            size = np.size(definition.parameters[name])
            is_whole = setting.places == tuple(((name, e),) for e in range(size))
            yield Tunable(
                label, setting.shape, setting.start, i, name if is_whole else None, setting.description, setting.name,
                setting.places, unit_of_setting(setting.unit, node.name, units),
            )  # fmt: skip
