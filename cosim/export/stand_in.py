"""An FMU in place of the blocks from which it was exported: the counterparts of its variables among their signals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import gcd, isclose
from pathlib import Path

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.diagram.diagram import Diagram, is_external
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import HandOn
from bayesftc.cosim.diagram.subsystem import with_inside
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.types import Floats

FED, PLACED = "<fed>", "<placed>"
"""Names of the block that replays recorded inputs, and of the FMU."""

Place = tuple[str, str, int]
"""Block, port and element."""


class StandIn:
    """An FMU, the blocks that it replaces, and the counterparts of their elements.

    Attributes
    ----------
    blocks : tuple of str
        The names of the blocks.
    into : dict of Place to (str, int)
        For elements of the blocks' inputs, the FMU's port and element, in the order of the FMU's inputs.
    out : dict of Place to (str, int)
        The same for outputs.
    notes : list of str
        Sentences about signals without a counterpart.
    """

    def __init__(self, fmu: FMU, diagram: Diagram, blocks: Sequence[str] | str | None):
        self.fmu, self.diagram = fmu, diagram
        self.blocks = _blocks_of(fmu, diagram, blocks)
        self.every = gcd(*(diagram[name].every for name in self.blocks))
        self._check_step()
        nodes = [diagram[name] for name in self.blocks]
        into, unmatched = _counterparts(fmu, nodes, "inputs")
        if unmatched:
            port_names = [_label(self.blocks, n, p) for n in nodes for p in n.block.inputs]
            raise UnknownNameError(
                f"{_file(fmu)} has the input {unmatched[0]!r}, but {' and '.join(self.blocks)} has none of this name; "
                f"{did_you_mean(unmatched[0], port_names)}"
            )
        self.into = into
        self.out, unmatched = _counterparts(fmu, nodes, "outputs")
        if not self.out:
            port_names = [_label(self.blocks, n, p) for n in nodes for p in n.block.outputs]
            raise UnknownNameError(
                f"{_file(fmu)} has no output of {' and '.join(self.blocks)}; {did_you_mean((unmatched or [''])[0], port_names)}"
            )
        self.notes = list(self._without_counterpart(nodes, unmatched))

    def _without_counterpart(self, nodes: Sequence[Node], unmatched: Sequence[str]) -> Iterator[str]:
        """Yield sentences about outputs that are not compared, and inputs that the FMU does not have."""
        if unmatched:
            yield f"Not compared, as the diagram does not have them: {_some(unmatched)}."
        missing: list[str] = []
        for name, port in [(n.name, p) for n in nodes for p in n.block.outputs]:
            missing_elements = [i for i in range(port.size) if (name, port.name, i) not in self.out]
            whole = f"{name}.{port.name}"
            missing += (
                [whole]
                if len(missing_elements) == port.size
                else [labels(whole, port.shape)[i] for i in missing_elements]
            )
        if missing:
            yield f"Not compared, as the FMU does not have them: {_some(missing)}."
        unfed = [
            label
            for n in nodes
            for p in n.block.inputs
            for i, label in enumerate(labels(f"{n.name}.{p.name}", p.shape))
            if (n.name, p.name, i) not in self.into and self._moves(n, p, i)
        ]
        if unfed:
            yield f"The FMU has no inputs for {_some(unfed)}, which change in the diagram."

    def _moves(self, node: Node, port: Port, i: int) -> bool:
        """Return whether an input changes by random numbers or a source outside the blocks."""
        source = next(self.diagram.origins_of(node, port, i), None)
        return port.draw is not None if source is None else source[0].node.name not in self.blocks

    def _check_step(self) -> None:
        description = self.fmu.description
        own_step = description.default_experiment.get("stepSize")
        step = float(self.diagram.step * self.every)
        free = description.capabilities.get("canHandleVariableCommunicationStepSize")
        if own_step and not free and self.fmu.kind == "co-simulation" and not isclose(own_step, step, rel_tol=1e-9):
            raise StepSizeError(
                f"{_file(self.fmu)} makes steps of {own_step:g} s, but {' and '.join(self.blocks)} one every {step:g} s. "
                "Export it with that step."
            )

    def place(self, diagram: Diagram, fed: Floats, live: Mapping[Place, tuple[Node, str, int]] | None = None) -> Node:
        """Add the FMU to a diagram, with recorded or live inputs; return the block that passes on its outputs."""
        live = live or {}
        played = diagram.add(_Played(fed), FED)
        # Separates FMUs, so that none uses values of another that it would not get from a block.
        gate = diagram.add(HandOn(len(self.into) + 1), f"{PLACED}.in")
        node = diagram.add(self.fmu, PLACED, self.every)
        after = diagram.add(HandOn(len(self.out)), f"{PLACED}.out")
        for j, (place, (port, element)) in enumerate(self.into.items(), 1):
            source = live.get(place)
            diagram._sources[gate.name, "u", j] = (source[0][source[1]], source[2]) if source else (played["y"], j)
            diagram._sources[node.name, port, element] = gate["y"], j
        for j, (port, element) in enumerate(self.out.values()):
            diagram._sources[after.name, "u", j] = node[port], element
        return after

    def unheard(self) -> str:
        """Return an output that other blocks of the diagram use and the FMU lacks, or nothing."""
        for (name, _, _), (source, element) in self.diagram.connections():
            used = source.node.name, source.port.name, element
            if name not in self.blocks and source.node.name in self.blocks and used not in self.out:
                return labels(f"{used[0]}.{used[1]}", source.port.shape)[element]
        return ""

    def in_loop(self, fed: Floats) -> Diagram:
        """Return the diagram with the FMU in place of the blocks."""
        whole, old = Diagram(self.diagram.step), self.diagram
        nodes = {n.name: whole.add(n.block, n.name, n.every) for n in old.nodes if n.name not in self.blocks}
        live = {}
        for place in self.into:
            fed_by = next(old.origins_of(old[place[0]], old[place[0]].port(place[1]), place[2]), None)
            if fed_by is not None and fed_by[0].node.name in nodes:
                live[place] = nodes[fed_by[0].node.name], fed_by[0].port.name, fed_by[1]
        after, order = self.place(whole, fed, live), list(self.out)
        for (name, port, element), (source, source_element) in old.connections():
            if name in nodes:
                if source.node.name in nodes:
                    whole._sources[name, port, element] = nodes[source.node.name][source.port.name], source_element
                else:
                    at = order.index((source.node.name, source.port.name, source_element))
                    whole._sources[name, port, element] = after["y"], at
        return whole.build(old._coupling)


NAME_IT = "Name it by blocks=..."
"""The remedy where the block is not clear; the command line has another one."""


def _blocks_of(fmu: FMU, diagram: Diagram, blocks: Sequence[str] | str | None) -> tuple[str, ...]:
    """Return the blocks that an FMU replaces."""
    if blocks is not None:
        names = (blocks,) if isinstance(blocks, str) else tuple(blocks)
        if not names:
            raise ModelError("There is no block to compare with; name at least one.")
        for name in names:
            if is_external(diagram[name]):
                raise ModelError(
                    f"The block {name!r} is an FMU itself; name the block from which {_file(fmu)} was exported."
                )
        return tuple(with_inside(diagram, names))
    declared = fmu.description.blocks
    candidates = [node for node in diagram.nodes if not is_external(node)]
    if declared and all(any(node.name == name for node in candidates) for name in declared):
        return declared
    fitting = [node.name for node in candidates if _fits(fmu, node)]
    if len(fitting) == 1:
        return tuple(with_inside(diagram, fitting))
    reason = "no block has its inputs and outputs"
    if fitting:
        reason = f"{', '.join(fitting[:-1])} and {fitting[-1]} have its inputs and outputs"
    note = f" It was exported from {' and '.join(declared)}." if declared else ""
    raise ModelError(
        f"The block from which {_file(fmu)} was exported is not clear: {reason}.{note} {NAME_IT}; there are "
        f"{_some([node.name for node in candidates])}."
    )


def _fits(fmu: FMU, node: Node) -> bool:
    sides = [_counterparts(fmu, [node], side) for side in ("inputs", "outputs")]
    return not any(unmatched for _, unmatched in sides) and bool(sides[1][0])


def _counterparts(fmu: FMU, nodes: Sequence[Node], side: str) -> tuple[dict[Place, tuple[str, int]], list[str]]:
    """Return the FMU's port and element for elements of the blocks, and the FMU's ports without a counterpart."""
    blocks = [node.name for node in nodes]
    whole = {f"{n.name}.{p.name}": (n, p) for n in nodes for p in getattr(n.block, side)}
    single = {
        label: (n.name, p.name, i) for name, (n, p) in whole.items() for i, label in enumerate(labels(name, p.shape))
    }
    result: dict[Place, tuple[str, int]] = {}
    unmatched, declared = [], fmu.description.blocks
    alone = _alone(blocks)
    for port in getattr(fmu, side):
        name = fmu.description.origins.get(port.name, port.name)
        if alone and _alone(declared):  # a block that was exported alone may have another name here
            name = name.removeprefix(f"{declared[0]}.")
        names = (name, f"{blocks[0]}.{name}") if alone else (name,)
        port_match = next((whole[n] for n in names if n in whole and whole[n][1].size == port.size), None)
        element_match = next((single[n] for n in names if n in single and port.size == 1), None)
        if port_match is not None:
            result |= {(port_match[0].name, port_match[1].name, i): (port.name, i) for i in range(port.size)}
        elif element_match is not None:
            result[element_match] = port.name, 0
        else:
            unmatched.append(port.name)
    return result, unmatched


def _alone(blocks: Sequence[str]) -> bool:
    """Return whether there is one block, with those inside it if it is a subsystem."""
    return bool(blocks) and all(name.startswith(f"{blocks[0]}.") for name in blocks[1:])


def _label(blocks: Sequence[str], node: Node, port: Port) -> str:
    return port.name if _alone(blocks) else f"{node.name}.{port.name}"


def _file(fmu: FMU) -> str:
    return Path(fmu.path).name


def _some(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _play(k, values, y):
    for i in range(y.shape[0]):
        y[i] = values[k, i]


@dataclass(frozen=True, eq=False)
class _Played(Block):
    """A row of recorded numbers at each step."""

    values: Floats = field(repr=False)

    @property
    def outputs(self) -> tuple[Port, ...]:
        return (Port("y", (self.values.shape[1],)),)

    def define(self, step: Fraction) -> Definition:
        return Definition(_play, parameters={"values": self.values})
