"""The interface of a program: its inputs, its outputs, and its tunable parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.diagram.roles import Units, UnitsOfElements
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.export.tunables import Element, settings_of
from bayesftc.cosim.export.units import unit_of_setting
from bayesftc.cosim.ports import Port, labels

Place = tuple[Node, Port, int]
Places = tuple[Place, ...]


class OneElement(tuple[Place]):
    """One element of a port, which is a scalar in the interface even if the port has no other element."""


@dataclass(frozen=True)
class Signal:
    """An input or output of a program.

    Parameters
    ----------
    name : str
        Its name in the interface.
    shape : tuple of int
        ``()`` for a number.
    unit : str or None
        The unit of its elements, if it is one.
    start : tuple of float
        For an input, its value until it is set.
    places : tuple of int
        The indices of its elements in the memory of the schedule.
    draw : str or None
        For an input of random numbers, their distribution.
    description : str
        A description for users.
    origin : str
        Its name in the diagram, as ``controller.y``.
    element_descriptions : tuple of str
        A description of each element; empty if they have none of their own.
    element_units : tuple of (str or None)
        The unit of each element, if they have different ones; else empty.
    """

    name: str
    shape: tuple[int, ...]
    unit: str | None
    start: tuple[float, ...]
    places: tuple[int, ...]
    draw: str | None = None
    description: str = ""
    origin: str = ""
    element_descriptions: tuple[str, ...] = ()
    element_units: tuple[str | None, ...] = ()


@dataclass(frozen=True)
class Tunable:
    """A parameter of a step function that can change while the program runs.

    Parameters
    ----------
    name : str
        Its name in the interface.
    shape : tuple of int
        ``()`` for a number.
    start : tuple of float
        Its value until it is changed.
    node : int
        The number of its block in the schedule.
    parameter : str or None
        The parameter of the step functions with exactly these numbers, in the same order, if there is one.
    description : str
        A description for users.
    setting : str
        The setting of the block, as ``precision.forgetting``.
    places : tuple of tuple of (str, int)
        For each of its numbers, the places among the parameters: the parameter's name, and the element, row by row.
    unit : str or None
        The unit that the block declares, or that of the port to which it refers.
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


def signal_of(schedule: Schedule, label: str, places: Places, units: UnitsOfElements) -> Signal:
    """Return the signal of this name for these elements of a port."""
    node, port, _ = places[0]
    begin = schedule.signal(node, port).start
    at = tuple(begin + i for _, _, i in places)
    shape = port.shape if len(places) == port.size and not isinstance(places, OneElement) else ()
    draw_value = {"uniform": 0.5, "normal": 0.0}.get(port.draw or "")
    start = tuple(float(schedule.initial[i]) if draw_value is None else draw_value for i in at)
    if any(port.name == output.name for output in node.block.outputs):
        start = (0.0,) * len(at)
    origin = f"{node.name}.{port.name}"
    if len(places) < port.size:
        origin = labels(origin, port.shape)[places[0][2]]
    of_elements = tuple(units.get((node.name, port.name, i)) for _, _, i in places)
    unit = of_elements[0] if len({*of_elements}) == 1 else None
    description = port.description or _description(node, port)
    given = port.element_descriptions
    each = tuple(given[i] for _, _, i in places) if len(given) == port.size else ()
    if each and not shape:
        description, each = each[0], ()
    return Signal(
        label, shape, unit, start, at, port.draw, description, origin, each, of_elements * (len({*of_elements}) > 1)
    )


def _description(node: Node, port: Port) -> str:
    if port.draw == "normal":
        return "Standard normal random numbers, new ones at each step; 0 for none"
    if port.draw == "uniform":
        return "Random numbers uniform in (0, 1), new ones at each step"
    return f"{port.name} of {type(node.block).__name__}"


def tunables_of(schedule: Schedule, alone: bool, units: Units) -> Iterator[Tunable]:
    """Yield the tunable settings of all blocks; with `alone`, without the block's name before them."""
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
                label,
                setting.shape,
                setting.start,
                i,
                name if is_whole else None,
                setting.description,
                setting.name,
                setting.places,
                unit_of_setting(setting.unit, node.name, units),
            )
