"""A diagram as a drawing (SVG): blocks in columns from left to right, with the ports and connections between them."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from bayesftc.cosim.base.html import table
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.subsystem import Boundary, outermost
from bayesftc.cosim.ports import Port, listed

MOST_BLOCKS = 60
"""A diagram with more blocks is shown as a table, because its drawing would be unreadable."""
LETTER, LINE = 6.2, 15.0
"""Width of a letter and height of a line of text, in pixels."""
GAP, BETWEEN, LANE = 60.0, 22.0, 9.0
"""Space between columns, between blocks of a column, and between lines around the blocks, in pixels."""

Wire = tuple[str, str, str, str]
"""A connection: source block and port, target block and port."""


@dataclass
class _Box:
    """A block in the drawing: texts, connected ports on both sides from above, and the upper left corner."""

    name: str
    kind: str
    ins: list[str]
    outs: list[str]
    hint: str
    x: float = 0.0
    y: float = 0.0

    @property
    def width(self) -> float:
        ports = max(map(len, self.ins), default=0) + max(map(len, self.outs), default=0) + 3
        return LETTER * max(len(self.name), len(self.kind), ports) + 16

    @property
    def height(self) -> float:
        return LINE * (2 + max(len(self.ins), len(self.outs))) + 8

    def port(self, name: str, side: str) -> tuple[float, float]:
        """Return the position of a port."""
        row = (self.ins if side == "in" else self.outs).index(name)
        return self.x + (0.0 if side == "in" else self.width), self.y + LINE * (2.6 + row)


def drawing(diagram: Diagram) -> str:
    """Return the drawing of a diagram, or a table of its blocks if it has too many.

    Only connected ports are drawn. The tooltip of a block lists all ports, with sizes and units.
    """
    title = f"Diagram of {len(diagram.nodes)} blocks at {float(diagram.step):g} s"
    nodes = outermost(diagram)
    if len(nodes) > MOST_BLOCKS:
        rows = [(node.name, _kind(node), *_listed(node)) for node in nodes]
        return table(title, rows, ("block", "kind", "inputs", "outputs"))
    wires = _wires(diagram)
    boxes = {}
    for node in nodes:
        kind = _kind(node) + (f", every {node.every} steps" if node.every > 1 else "")
        ports = _listed(node)
        hint = f"inputs: {ports[0]}\noutputs: {ports[1]}"
        ins = _used(node.inputs, {w[3] for w in wires if w[2] == node.name})
        outs = _used(node.outputs, {w[1] for w in wires if w[0] == node.name})
        boxes[node.name] = _Box(node.name, kind, ins, outs, hint)
    if not boxes:
        return f"<p><b>{escape(title)}</b></p>\n<p>No blocks yet.</p>"
    columns = _columns(list(boxes), wires)
    width, height = _place(boxes, columns, wires)
    paths, below = _paths(boxes, columns, wires, height)
    body = "\n".join([*paths, *map(_drawn, boxes.values())])
    style = "font-family: sans-serif; font-size: 11px; max-width: 100%; height: auto"
    return (
        f"<p><b>{escape(title)}</b></p>\n"
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{below:.0f}" viewBox="0 0 {width:.0f} {below:.0f}" '
        f'style="{style}">\n<defs><marker id="bayesftc-end" markerWidth="7" markerHeight="6" refX="7" refY="3" orient="auto">'
        '<path d="M0,0 L7,3 L0,6 z" fill="#444444"/></marker></defs>\n'
        f'<rect width="100%" height="100%" fill="#ffffff"/>\n{body}\n</svg>'
    )


def _inputs(node: Node) -> tuple[Port, ...]:
    return node.block.free if isinstance(node.block, Boundary) else node.inputs


def _kind(node: Node) -> str:
    return "Subsystem" if isinstance(node.block, Boundary) else type(node.block).__name__


def _listed(node: Node) -> tuple[str, str]:
    return listed(_inputs(node)), listed(node.outputs)


def _wires(diagram: Diagram) -> list[Wire]:
    """Return the connections, each once even if it has several elements."""
    wires: dict[Wire, None] = {}
    for node in outermost(diagram):
        for port in _inputs(node):
            for i in range(port.size):
                if (source := next(diagram.origins_of(node, port, i), None)) is not None:
                    wires[source[0].node.name, source[0].port.name, node.name, port.name] = None
    return list(wires)


def _used(ports: tuple[Port, ...], names: set[str]) -> list[str]:
    return [port.name for port in ports if port.name in names]


def _columns(names: list[str], wires: list[Wire]) -> dict[str, int]:
    """Return the column of each block: right of all blocks that feed it, except over connections that close a circle."""
    after: dict[str, list[str]] = {name: [] for name in names}
    for a, _, b, _ in wires:
        if b not in after[a]:
            after[a].append(b)
    fed = {b for a, _, b, _ in wires if a != b}
    order: list[str] = []
    forward: set[tuple[str, str]] = set()
    state: dict[str, int] = {}
    for root in [*(name for name in names if name not in fed), *names]:
        stack = [] if root in state else [(root, iter(after[root]))]
        state.setdefault(root, 1)
        while stack:
            name, rest = stack[-1]
            target = next(rest, None)
            if target is None:
                stack.pop()
                state[name] = 2
                order.insert(0, name)
            elif target not in state:
                state[target] = 1
                forward.add((name, target))
                stack.append((target, iter(after[target])))
            elif state[target] == 2:
                forward.add((name, target))
    column = dict.fromkeys(names, 0)
    for name in order:
        for a, b in forward:
            if a == name:
                column[b] = max(column[b], column[a] + 1)
    for name in reversed(order):  # a block without inputs stands directly before the block that it feeds
        later = [column[b] for a, b in forward if a == name]
        if later and name not in fed:
            column[name] = min(later) - 1
    return column


def _place(boxes: dict[str, _Box], column: dict[str, int], wires: list[Wire]) -> tuple[float, float]:
    """Place the blocks and return the width and the height of the drawing."""
    count = max(column.values(), default=-1) + 1
    stacks = [[box for name, box in boxes.items() if column[name] == c] for c in range(count)]
    tall = max((sum(b.height + BETWEEN for b in stack) for stack in stacks), default=0.0)
    around = sum(column[b] - column[a] != 1 for a, _, b, _ in wires)
    top, x = 12.0 + LANE * sum(column[b] - column[a] > 1 for a, _, b, _ in wires), 16.0 + 0.4 * LANE * around
    for stack in stacks:
        for box in stack:
            box.x = x
        x += max(b.width for b in stack) + GAP

    def arrange(stack: list[_Box], heights: dict[str, list[float]]) -> None:
        """Place blocks below each other, sorted by the mean height of their neighbours' ports."""
        stack.sort(key=lambda b: sum(heights[b.name]) / len(heights[b.name]) if heights[b.name] else b.y)
        y = top + 0.5 * (tall - sum(b.height + BETWEEN for b in stack) + BETWEEN)
        for box in stack:
            box.y, y = y, y + box.height + BETWEEN

    # By sources from left to right, then by targets from right to left, so that fewer lines cross.
    ahead = [wire for wire in wires if column[wire[2]] == column[wire[0]] + 1]
    for stack in stacks:
        arrange(stack, {b.name: [boxes[a].port(out, "out")[1] for a, out, t, _ in ahead if t == b.name] for b in stack})
    for stack in reversed(stacks):
        arrange(
            stack, {b.name: [boxes[t].port(into, "in")[1] for a, _, t, into in ahead if a == b.name] for b in stack}
        )
    return x - GAP + 16.0 + 0.4 * LANE * around, top + tall + 8.0


def _paths(boxes: dict[str, _Box], column: dict[str, int], wires: list[Wire], height: float) -> tuple[list[str], float]:
    """Return the lines and the total height: curves between neighbours, others around above, and backwards below."""
    paths, above, below = [], 6.0, height
    for a, out, b, into in wires:
        (x, y), (to, end) = boxes[a].port(out, "out"), boxes[b].port(into, "in")
        if column[b] - column[a] == 1:
            bend = max(20.0, 0.5 * (to - x))
            path = f"M{x:.1f},{y:.1f} C{x + bend:.1f},{y:.1f} {to - bend:.1f},{end:.1f} {to:.1f},{end:.1f}"
        else:
            if column[b] > column[a]:
                lane, above = above, above + LANE
            else:
                lane, below = below, below + LANE
            side = 10.0 + 0.4 * (lane if column[b] > column[a] else lane - height)
            path = f"M{x:.1f},{y:.1f} h{side:.1f} V{lane:.1f} H{to - side:.1f} V{end:.1f} H{to:.1f}"
        hint = f"<title>{escape(f'{a}.{out} to {b}.{into}')}</title>"
        paths.append(f'<path d="{path}" fill="none" stroke="#444444" marker-end="url(#bayesftc-end)">{hint}</path>')
    return paths, below + 8.0


def _drawn(box: _Box) -> str:
    """Return a block with its name, its kind and its ports."""
    middle = box.x + 0.5 * box.width
    frame = f'x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="4"'
    parts = [
        f'<g fill="#222222"><title>{escape(box.hint)}</title>',
        f'<rect {frame} fill="#f4f7fb" stroke="#5b7ea6"/>',
        f'<text x="{middle:.1f}" y="{box.y + LINE:.1f}" text-anchor="middle" font-weight="bold">{escape(box.name)}</text>',
        f'<text x="{middle:.1f}" y="{box.y + 1.85 * LINE:.1f}" text-anchor="middle" fill="#777777">{escape(box.kind)}</text>',
    ]
    for side, names in (("in", box.ins), ("out", box.outs)):
        for name in names:
            x, y = box.port(name, side)
            place = f'x="{x + (6 if side == "in" else -6):.1f}" y="{y + 4:.1f}"'
            parts.append(f'<text {place} text-anchor="{"start" if side == "in" else "end"}">{escape(name)}</text>')
    return "\n".join([*parts, "</g>"])


__all__ = ["drawing"]
