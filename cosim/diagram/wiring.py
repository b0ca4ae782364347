"""Find the parts of a closed loop among the blocks of a diagram, and the faults on the connections between them."""

from __future__ import annotations

from collections.abc import Container, Iterator

from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.blocks.sensors import Sensors
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.subsystem import INSIDE, Boundary
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port

_Visited = dict[tuple[str, str, int], list[str] | None]


def find_sensors(diagram: Diagram) -> Node:
    """Return the node of the sensors."""
    nodes = [node for node in diagram.nodes if isinstance(node.block, Sensors)]
    if len(nodes) != 1:
        raise ModelError(f"A closed loop has one Sensors block; {diagram!r} has {len(nodes)}.")
    return nodes[0]


def find_controller(diagram: Diagram) -> Node:
    """Return the node of the controller: the block with inputs ``y`` and ``goal`` and the output ``u``."""
    nodes = [
        node
        for node in diagram.nodes
        if {"y", "goal"} <= {p.name for p in node.inputs} and "u" in {p.name for p in node.outputs}
    ]
    if len(nodes) != 1:
        raise ModelError(
            f"A closed loop has one controller, a block with inputs y and goal and the output u; {diagram!r} has {len(nodes)}."
        )
    return nodes[0]


def faults_before(diagram: Diagram, controller: Node, sensor: int) -> list[str]:
    """Return the names of the faults between the sensors and one element of the controller's ``y``, in their order.

    Faults elsewhere, such as an actuator fault between controller and plant, are not included.
    """
    # The controller's inputs count as visited, so that no path goes through the controller.
    visited: _Visited = {(controller.name, port.name, i): None for port in controller.inputs for i in range(port.size)}
    return _trace_source(diagram, diagram.source_of(controller, controller.port("y"), sensor), visited) or []


def _trace(diagram: Diagram, node: Node, port: Port, element: int, visited: _Visited) -> list[str] | None:
    """Trace one element of an input back to the sensors; return the faults on the path, None if there is no path."""
    place = (node.name, port.name, element)
    if place not in visited:
        visited[place] = None  # a path that returns here is a circle
        visited[place] = _trace_source(diagram, diagram.source_of(node, port, element), visited)
    return visited[place]


def _trace_source(diagram: Diagram, origin: tuple[PortRef, int] | None, visited: _Visited) -> list[str] | None:
    if origin is None:
        return None
    node, channel = origin[0].node, origin[1]
    block = node.block
    if isinstance(block, Sensors):
        return []
    if isinstance(block, Fault):
        faults = _trace(diagram, node, node.port("u"), channel, visited)
        return None if faults is None else [*faults, *([node.name] if block.sensor == channel else [])]
    # A block with one input of the output's size, such as a delay, acts element by element. Of others all elements may matter.
    elementwise = [p.size for p in node.inputs] == [origin[0].port.size]
    paths = [
        _trace(diagram, node, entry, i, visited)
        for entry in node.inputs
        for i in ([channel] if elementwise else range(entry.size))
    ]
    complete = [names for names in paths if names is not None]
    return list(dict.fromkeys(name for names in complete for name in names)) if complete else None


def faults_right_before(diagram: Diagram, node: Node, port: Port, element: int) -> list[tuple[Node, int]]:
    """Return the faults directly before one element of an input, in their order, each with its faulty element."""
    origin = diagram.source_of(node, port, element)
    if origin is None or not isinstance(origin[0].node.block, Fault):
        return []
    fault, channel = origin[0].node, origin[1]
    before = faults_right_before(diagram, fault, fault.port("u"), channel)
    return [*before, (fault, channel)] if origin[0].node.block.sensor == channel else before


def healthy_source(diagram: Diagram, node: Node, port: Port, element: int) -> tuple[Node, Port, int] | None:
    """Return the block, the output and its element that feed one element of an input while no fault is present.

    A subsystem counts as one block.
    """
    origin = next(diagram.origins_of(node, port, element), None)
    while origin is not None and isinstance(origin[0].node.block, Fault):
        fault = origin[0].node
        origin = next(diagram.origins_of(fault, fault.port("u"), origin[1]), None)
    return None if origin is None else (origin[0].node, origin[0].port, origin[1])


def elements(diagram: Diagram, others: Container[str]) -> Iterator[tuple[Node, Port, int]]:
    """Yield each element of each input, except for those of faults and of the named blocks.

    An input of a subsystem counts once: neither what its ports show nor the inputs inside that they feed are yielded.
    """
    for node in diagram.nodes:
        for port in () if isinstance(node.block, Fault) or node.name in others else node.inputs:
            for i in range(port.size):
                if not _of_boundary(diagram, node, port, i):
                    yield node, port, i


def _of_boundary(diagram: Diagram, node: Node, port: Port, element: int) -> bool:
    """Return whether an input is the inside of a subsystem's boundary, or is fed by an input of the subsystem around it."""
    if isinstance(node.block, Boundary) and port.name == INSIDE:
        return True
    origin = next(diagram.origins_of(node, port, element), None)
    return origin is not None and isinstance(origin[0].node.block, Boundary) and origin[0].direction == "input"


def element_name(port: Port, i: int) -> str:
    """Return the name of one element of a port."""
    return port.name + (f"[{i}]" if port.size > 1 else "")


def label_of(diagram: Diagram, sensors: Node, row: tuple[float, ...], sensor: int) -> tuple[str, str | None]:
    """Return the name and the unit of the quantity that a sensor measures, given its row of the measurement matrix."""
    nonzero = [j for j, weight in enumerate(row) if weight]
    if len(nonzero) != 1 or row[nonzero[0]] != 1.0:
        return f"sensor {sensor}", sensors.port("y").unit
    source = diagram.source_of(sensors, sensors.port("u"), nonzero[0])
    if source is None:
        return f"sensor {sensor}", None
    port = source[0].port
    return element_name(port, source[1]), port.unit or sensors.port("y").unit
