"""Which blocks of a diagram are the parts of a closed loop, and which faults lie on the ways between them."""

from __future__ import annotations

from collections.abc import Container, Iterator

from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.blocks.sensors import Sensors
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port

_Known = dict[tuple[str, str, int], list[str] | None]


def find_sensors(diagram: Diagram) -> Node:
    """Return the block of the sensors."""
    found = [node for node in diagram.nodes if isinstance(node.block, Sensors)]
    if len(found) != 1:
        raise ModelError(f"A closed loop has one Sensors block; {diagram!r} has {len(found)}.")
    return found[0]


def find_controller(diagram: Diagram) -> Node:
    """Return the controller: what the sensors and the goal lead to, and what sends a control."""
    found = [
        node
        for node in diagram.nodes
        if {"y", "goal"} <= {p.name for p in node.inputs} and "u" in {p.name for p in node.outputs}
    ]
    if len(found) != 1:
        raise ModelError(
            f"A closed loop has one controller, a block with inputs y and goal and the output u; {diagram!r} has {len(found)}."
        )
    return found[0]


def faults_before(diagram: Diagram, brain: Node, sensor: int) -> list[str]:
    """Return the names of the faults between the sensors and one element of the controller's ``y``, in their order.

    A fault elsewhere, such as that of an actuator between controller and plant, is no fault of a sensor.
    """
    # What comes out of the controller leads to no sensor, whatever it has seen.
    known: _Known = {(brain.name, port.name, i): None for port in brain.inputs for i in range(port.size)}
    return _trace_source(diagram, diagram.source_of(brain, brain.port("y"), sensor), known) or []


def _trace(diagram: Diagram, node: Node, port: Port, element: int, known: _Known) -> list[str] | None:
    """Follow one element of an input back to the sensors; return the faults on the way, None if it does not lead there."""
    at = (node.name, port.name, element)
    if at not in known:
        known[at] = None  # a way that comes back here leads round in a circle
        known[at] = _trace_source(diagram, diagram.source_of(node, port, element), known)
    return known[at]


def _trace_source(diagram: Diagram, origin: tuple[PortRef, int] | None, known: _Known) -> list[str] | None:
    if origin is None:
        return None
    node, channel = origin[0].node, origin[1]
    block = node.block
    if isinstance(block, Sensors):
        return []
    if isinstance(block, Fault):
        found = _trace(diagram, node, node.port("u"), channel, known)
        return None if found is None else [*found, *([node.name] if block.sensor == channel else [])]
    # Another block on the way, such as a delay, has one input as long as its output: element by element. Else all may matter.
    alike = [p.size for p in node.inputs] == [origin[0].port.size]
    ways = [
        _trace(diagram, node, entry, i, known)
        for entry in node.inputs
        for i in ([channel] if alike else range(entry.size))
    ]
    there = [names for names in ways if names is not None]
    return list(dict.fromkeys(name for names in there for name in names)) if there else None


def faults_right_before(diagram: Diagram, node: Node, port: Port, element: int) -> list[tuple[Node, int]]:
    """Return the faults right before one element of an input, in their order, each with its element that is meant."""
    origin = diagram.source_of(node, port, element)
    if origin is None or not isinstance(origin[0].node.block, Fault):
        return []
    fault, channel = origin[0].node, origin[1]
    before = faults_right_before(diagram, fault, fault.port("u"), channel)
    return [*before, (fault, channel)] if origin[0].node.block.sensor == channel else before


def healthy_source(diagram: Diagram, node: Node, port: Port, element: int) -> tuple[Node, Port, int] | None:
    """Return the block, the output and its element that feed one element of an input while no fault is present."""
    origin = diagram.source_of(node, port, element)
    while origin is not None and isinstance(origin[0].node.block, Fault):
        origin = diagram.source_of(origin[0].node, origin[0].node.port("u"), origin[1])
    return None if origin is None else (origin[0].node, origin[0].port, origin[1])


def elements(diagram: Diagram, others: Container[str]) -> Iterator[tuple[Node, Port, int]]:
    """Give each element of each input, but for those of faults and of the named blocks."""
    for node in diagram.nodes:
        for port in () if isinstance(node.block, Fault) or node.name in others else node.inputs:
            for i in range(port.size):
                yield node, port, i


def element_name(port: Port, i: int) -> str:
    """Return what one element of a port is called."""
    return port.name + (f"[{i}]" if port.size > 1 else "")


def label_of(diagram: Diagram, seen: Node, row: tuple[float, ...], sensor: int) -> tuple[str, str | None]:
    """Return the name and the unit of the quantity that a sensor measures by a row of its matrix."""
    nonzero = [j for j, weight in enumerate(row) if weight]
    if len(nonzero) != 1 or row[nonzero[0]] != 1.0:
        return f"sensor {sensor}", seen.port("y").unit
    found = diagram.source_of(seen, seen.port("u"), nonzero[0])
    if found is None:
        return f"sensor {sensor}", None
    port = found[0].port
    return element_name(port, found[1]), port.unit or seen.port("y").unit
