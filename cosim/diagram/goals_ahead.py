"""Goals that lie ahead: where the goal of a controller with a preview comes from, and the refusal of a present one."""

from __future__ import annotations

from fractions import Fraction

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef, label
from bayesftc.cosim.errors import ConnectionError

AHEAD = "ahead"
"""The output of a `Preview` that lies ahead."""


def preview_time(controller: Block) -> Fraction:
    """Return the seconds by which a controller's goal lies ahead, from its property ``preview``; else 0."""
    return getattr(controller, "preview", 0) * (controller.sample_time or Fraction(0))


def origins_of_goal(diagram: Diagram, controller: Node, element: int) -> list[PortRef]:
    """Return the outputs on which one element of a controller's goal depends.

    They are outputs of `Preview` blocks, of blocks without connected inputs, and of the controller itself. Blocks in between,
    such as a `RateLimiter`, are followed through all their inputs.
    """
    origins: dict[tuple[str, str], PortRef] = {}
    places = [(controller, controller.port("goal"), element)]
    visited = {(controller.name, "goal", element)}
    while places:
        source = diagram.source_of(*places.pop())
        if source is None:
            continue
        node = source[0].node
        before = [(node, port, i) for port in node.inputs for i in range(port.size)]
        connected = [place for place in before if diagram.source_of(*place) is not None]
        if node is controller or isinstance(node.block, Preview) or not connected:
            origins[node.name, source[0].port.name] = source[0]
            continue
        for place in connected:
            if (key := (node.name, place[1].name, place[2])) not in visited:
                visited.add(key)
                places.append(place)
    return list(origins.values())


def goals_ahead(diagram: Diagram, controller: Node) -> list[PortRef]:
    """Return the outputs ``ahead`` of `Preview` blocks on which the controller's goal depends."""
    elements = range(controller.port("goal").size)
    origins = [origin for i in elements for origin in origins_of_goal(diagram, controller, i) if lies_ahead(origin)]
    return list({origin.node.name: origin for origin in origins}.values())


def lies_ahead(origin: PortRef) -> bool:
    """Return whether an output is the one of a `Preview` that lies ahead."""
    return isinstance(origin.node.block, Preview) and origin.port.name == AHEAD


def present_origin(diagram: Diagram, controller: Node, element: int) -> PortRef | None:
    """Return an output that keeps one element of the goal from lying ahead; None if it lies ahead or is constant."""
    origins = [o for o in origins_of_goal(diagram, controller, element) if not isinstance(o.node.block, Constant)]
    present = [o for o in origins if isinstance(o.node.block, Preview) and not lies_ahead(o)]
    if present or not origins or any(map(lies_ahead, origins)):
        return present[0] if present else None
    return origins[0]


def check_goals_ahead(diagram: Diagram, controller: Node) -> None:
    """Refuse a controller with a preview whose goal is a present value.

    Raises
    ------
    ConnectionError
        With the output that the goal comes from, and the one to connect.
    """
    if not preview_time(controller.block):
        return
    goal = controller["goal"]
    for i in goal.elements:
        origin = present_origin(diagram, controller, i)
        if origin is None:
            continue
        count, name = getattr(controller.block, "preview", 0), goal.name if len(goal) == 1 else label(goal[i])
        title = f"{name} must lie {count} samples ahead (preview={count}), but depends on {origin.name}, "
        if isinstance(origin.node.block, Preview):
            remedy = f"which is the present value. Connect '{origin.node.name}.{AHEAD}' in its place."
        else:
            remedy = (
                "whose future the loop does not have. Make that block the reference and connect 'reference.ahead', or use "
                "preview=0."
            )
        raise ConnectionError(title + remedy)


__all__ = ["check_goals_ahead", "goals_ahead", "lies_ahead", "present_origin", "preview_time"]
