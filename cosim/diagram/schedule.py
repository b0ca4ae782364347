"""From a diagram to a program: the order of the calls of step functions, and the copies between the calls.

A step has two phases. *Evaluate* computes all outputs at t_k in the order of direct feedthrough. Then it copies the inputs
without feedthrough, which may come from any block. *Advance* takes every state to t_k+1: first the sampled blocks, in any order
(no state is read before the next evaluation), then the FMUs in the order in which they were added.

With Gauss-Seidel coupling, an FMU that directly feeds a later one of the same rate is read again after its step, into a
separate place for the later FMU's step. The outputs that all other blocks read, and that are recorded, stay those of t_k until
t_k+1 is evaluated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.html import Lines
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import Definition, ExternalBlock, sample_time_of
from bayesftc.cosim.diagram.contract import checked
from bayesftc.cosim.diagram.coupling import Coupling
from bayesftc.cosim.diagram.diagram import Diagram, is_external
from bayesftc.cosim.diagram.feedthrough import Feedthrough
from bayesftc.cosim.diagram.groups import Group, Grouping, element_name
from bayesftc.cosim.diagram.memory import Slots, arrange
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.errors import ModelError, StepSizeError, UnconnectedInputError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.types import Floats, Kernel

NOT_FINITE = 1_000_000
"""A status from here on is this number plus the place in memory of an output that is NaN or infinite."""


@dataclass(frozen=True)
class Call:
    """One call of a step function: the node, the kind of function, and the copies (target, source) of its inputs.

    The kind ``inputs`` calls no function. It only copies inputs, so that those of t_k are recorded. The kind ``ahead`` calls the
    output function and writes its results to the place for outputs at t_k+1. The kind ``group`` computes several blocks
    together, of which `node` is the first.
    """

    node: int
    kind: Literal["output", "update", "inputs", "ahead", "group"]
    gathers: tuple[tuple[int, int], ...]
    group: Group | None = None


@dataclass(frozen=True)
class Draw:
    """One random number a step: the stream (block.port), the channel in it, its distribution and its place in memory."""

    stream: str
    channel: int
    draw: int
    uniform: bool
    offset: int


class Schedule:
    """A diagram that is ready to run.

    Attributes
    ----------
    evaluate, advance : tuple of Call
        The two phases of a step.
    draws : tuple of Draw
        The random numbers of a step.
    initial : ndarray
        Memory before the first step: states, parameters, input defaults.
    free : tuple of (Node, Port)
        The unconnected inputs, which keep their start values.
    ahead : dict of int to int
        For each FMU whose outputs at t_k+1 are inputs of a later FMU's step: the place of these outputs in memory.
    groups : tuple of Group
        Blocks that are computed together: algebraic loops, and FMUs that are coupled tightly.
    connected : frozenset of (int, str)
        The connected outputs: node and name.
    finite : frozenset of int
        The nodes whose outputs must be finite.
    remembered : ndarray of int
        The places in memory that belong to the state of a run: all but scratch and outputs that are only recorded.
    """

    def __init__(self, diagram: Diagram, coupling: Coupling = Coupling()):  # noqa: B008 - it is frozen
        self.step = diagram.step
        self.nodes = diagram.nodes
        self.coupling = coupling
        self._place = {node: i for i, node in enumerate(self.nodes)}
        _check_signal_names(self.nodes)
        for node in self.nodes:
            _check_sample_time(node, self.step * node.every)
        self.definitions: tuple[Definition | None, ...] = tuple(
            None
            if is_external(node)
            else checked(node.block, node.block.define(self.step * node.every), repr(node.name))
            for node in self.nodes
        )
        self.slots, values = self._lay_out()
        self._seen_ahead = self._pairs_ahead(diagram)
        self.ahead, self.initial = self._lay_out_ahead(values)
        self.draws = self._check_inputs(diagram)
        self.finite = frozenset(
            i for i, node in enumerate(self.nodes) if node.block.checks_finite
        )  # reads an FMU's file
        self.connected = frozenset(self._connected(diagram))
        self.free = tuple(
            (node, port)
            for node in self.nodes
            for port in node.inputs
            if port.draw is None and all(diagram.source_of(node, port, e) is None for e in range(port.size))
        )
        through = Feedthrough(diagram, {i for i in range(len(self.nodes)) if self._outputs(i)})
        grouping = Grouping(self, lambda i, feedthrough: self._gathers(diagram, i, feedthrough), coupling)
        evaluate = [
            Call(min(unit), "group", (), grouping.loop(unit))
            if through.is_loop(unit)
            else Call(unit[0], "output", self._gathers(diagram, unit[0], feedthrough=True))
            for unit in through.order(solved=coupling.iterated)
            if self._outputs(unit[0])
        ]
        loops = [call.group for call in evaluate if call.group]
        stepped = grouping.steps(self._plants()) if self._tight else []
        self.groups: tuple[Group, ...] = (*loops, *stepped)
        self.initial = np.concatenate([self.initial, np.zeros(grouping.places.end - len(self.initial))])
        for i in range(len(self.nodes)):
            late = self._gathers(diagram, i, feedthrough=False if self._outputs(i) else None)
            if late:
                evaluate.append(Call(i, "inputs", late))
        self.evaluate = tuple(evaluate)
        self.advance = self._advance(diagram, stepped)
        self.compiled = all(d is None or d.compiled for d in self.definitions)
        self.remembered = self._remembered(grouping)

    def kernel(self, call: Call) -> Kernel | None:
        """Return the Python step function of a call; None for an external block, and for a call that only copies inputs."""
        definition = self.definitions[call.node]
        return getattr(definition, call.kind) if definition and call.kind != "inputs" else None

    def signal(self, node: Node, port: Port) -> slice:
        """Return the place of a port's elements in memory."""
        slots = self.slots[self._place[node]]
        start = slots.offset(port.name)
        return slice(start, start + port.size)

    def layout(self) -> tuple[Any, ...]:
        """Return the properties in which two diagrams must agree to exchange their memory."""
        blocks = tuple((node.name, type(node.block).__name__, node.every) for node in self.nodes)
        return str(self.step), self.coupling, blocks, len(self.remembered)

    def depended_on(self, i: int) -> int:
        """Return the number of output elements of a node, without those that are only recorded."""
        block = self.nodes[i].block
        return sum(port.size for port in block.outputs) - block.only_recorded

    def describe(self) -> str:
        """Return the order of a step as text, one call a line; an FMU's line lists the FMUs whose outputs at t_k+1 it gets."""
        lines = [f"at t_k     {self._named(c)}" for c in self.evaluate if c.kind != "inputs"]
        for call in self.advance:
            if call.group:
                lines.append(f"to t_k+1   {self._named(call)}")
            elif call.kind == "update":
                seen = ", ".join(self.nodes[i].name for i in self._seen_ahead.get(call.node, ()))
                lines.append(
                    f"to t_k+1   {self.nodes[call.node].name}" + (f"  (reads {seen} at t_k+1)" if seen else "")
                )
        return Lines("\n".join(lines))

    def every(self, call: Call) -> int:
        """Return the multiple of the base step at which a call is made."""
        return call.group.every if call.group else self.nodes[call.node].every

    def output_name(self, i: int, offset: int) -> str:
        """Return the full name of the output of node `i` that lies `offset` places after its first."""
        return f"{self.nodes[i].name}.{element_name(self.nodes[i].outputs, offset)}"

    def origin_of_nan(self, i: int, memory: Floats) -> str | None:
        """Return the first output from which a NaN may have come to node `i`, followed back block by block; None if none came.

        The first one is an output of a block that got no NaN, as a sensor that drops out.
        """
        sources = {target: source for call in (*self.evaluate, *self.advance) for target, source in call.gathers}
        outputs = {
            begin + e: (j, e)
            for j, node in enumerate(self.nodes)
            for begin in {self.slots[j].start["outputs"], self.ahead.get(j, self.slots[j].start["outputs"])}
            for e in range(sum(port.size for port in node.outputs))
        }
        origin, seen = None, {i}
        while True:
            begin = self.slots[i].start["inputs"]
            places = range(begin, begin + sum(port.size for port in self.nodes[i].inputs))
            taken = [outputs[sources[p]] for p in places if p in sources and np.isnan(memory[p])]
            i, element = next((each for each in taken if each[0] not in seen), (-1, 0))
            if i < 0:
                return origin
            seen.add(i)
            origin = self.output_name(i, element)

    @property
    def _tight(self) -> bool:
        """Whether coupled FMUs make their steps together."""
        return self.coupling.iterated or self.coupling.step_error is not None

    def _named(self, call: Call) -> str:
        if not call.group:
            return self.nodes[call.node].name
        names = " and ".join(self.nodes[i].name for i in call.group.nodes)
        how = [f"guessing {', '.join(call.group.names)}"] if call.group.names else []
        how += ["in substeps"] if call.group.doubling else []
        return f"{names}  ({', '.join(how) or 'one after the other'})"

    def outputs_start(self, call: Call) -> int:
        """Return the place in memory of the outputs that a call writes."""
        return self.ahead[call.node] if call.kind == "ahead" else self.slots[call.node].start["outputs"]

    def updates(self, i: int) -> bool:
        """Return whether a node has an update between t_k and t_k+1."""
        definition, block = self.definitions[i], self.nodes[i].block
        if isinstance(block, ExternalBlock):
            return block.timing != "sampled"
        return definition is not None and definition.update is not None

    def _outputs(self, i: int) -> bool:
        definition = self.definitions[i]
        return definition.output is not None if definition else True

    def _lay_out(self) -> tuple[tuple[Slots, ...], Floats]:
        slots, pieces, total = [], [], 0
        for node, definition in zip(self.nodes, self.definitions, strict=True):
            placed, values = arrange(node.block, definition, total)
            slots.append(placed)
            pieces.append(values)
            total += len(values)
        return tuple(slots), np.concatenate([*pieces, np.zeros(1)])

    def _check_inputs(self, diagram: Diagram) -> tuple[Draw, ...]:
        draws = []
        for node, slots in zip(self.nodes, self.slots, strict=True):
            for port in node.inputs:
                unfed = [e for e in range(port.size) if diagram.source_of(node, port, e) is None]
                if port.draw is not None:
                    columns = port.shape[1] if len(port.shape) > 1 else 1
                    draws += [
                        Draw(
                            f"{node.name}.{port.name}",
                            e // columns,
                            e % columns,
                            port.draw == "uniform",
                            slots.offset(port.name) + e,
                        )
                        for e in unfed
                    ]
                elif unfed and port.default is None:
                    if signal := node.block.named_sources.get(port.name):
                        raise _unknown_signal(diagram, node, signal)
                    element = f"[{unfed[0]}]" if len(unfed) < port.size else ""
                    raise UnconnectedInputError(
                        f"The input {node.name}.{port.name}{element} has no source and no start value; connect an output to it."
                    )
        return tuple(draws)

    def _connected(self, diagram: Diagram) -> Iterator[tuple[int, str]]:
        for node in self.nodes:
            for port in node.inputs:
                for element in range(port.size):
                    source = diagram.source_of(node, port, element)
                    if source is not None:
                        yield self._place[source[0].node], source[0].port.name

    def _gathers(
        self, diagram: Diagram, i: int, feedthrough: bool | None = None, *, ahead: tuple[int, ...] = ()
    ) -> tuple[tuple[int, int], ...]:
        """Return the copies of a block's inputs: of those with feedthrough, of those without, or of all.

        Values of the nodes `ahead` are taken from their outputs at t_k+1.
        """
        node, slots, copies = self.nodes[i], self.slots[i], []
        for port in node.inputs:
            if feedthrough not in {None, port.feedthrough}:
                continue
            for element in range(port.size):
                source = diagram.source_of(node, port, element)
                if source is not None:
                    reference, taken = source
                    j = self._place[reference.node]
                    origin = self.slots[j].offset(reference.port.name) + taken
                    if j in ahead:
                        origin += self.ahead[j] - self.slots[j].start["outputs"]
                    copies.append((slots.offset(port.name) + element, origin))
        return tuple(copies)

    def _plants(self) -> list[int]:
        return [i for i in range(len(self.nodes)) if is_external(self.nodes[i]) and self.updates(i)]

    def _pairs_ahead(self, diagram: Diagram) -> dict[int, tuple[int, ...]]:
        """Return, for each FMU, the earlier FMUs whose outputs at t_k+1 it gets.

        An FMU of another rate has no new value at t_k+1, or not yet. Its outputs at t_k are used.
        """
        if self.coupling.method == "jacobi" or self._tight:
            return {}
        plants, pairs = self._plants(), {}
        for position, j in enumerate(plants):
            before = [i for i in plants[:position] if self.nodes[i].every == self.nodes[j].every]
            seen = tuple(i for i in before if self._feeds(diagram, i, j))
            if seen:
                pairs[j] = seen
        return pairs

    def _lay_out_ahead(self, values: Floats) -> tuple[dict[int, int], Floats]:
        places: dict[int, int] = {}
        total = len(values)
        for i in sorted({i for seen in self._seen_ahead.values() for i in seen}):
            places[i] = total
            total += sum(port.size for port in self.nodes[i].outputs)
        return places, np.concatenate([values, np.full(total - len(values), np.nan)])

    def _remembered(self, grouping: Grouping) -> np.ndarray[Any, np.dtype[np.int64]]:
        remembered = np.ones(len(self.initial), dtype=np.bool_)
        for slots, definition in zip(self.slots, self.definitions, strict=True):
            for name in definition.scratch if definition else ():
                begin = slots.offset(name)
                remembered[begin : begin + prod(slots.sections[name][2])] = False
        for i, node in enumerate(self.nodes):
            begins = {self.slots[i].start["outputs"], *grouping.copies(i)} | {
                self.ahead[j] for j in {i} & self.ahead.keys()
            }
            for begin in begins if node.block.only_recorded else ():
                end = begin + self.depended_on(i)
                remembered[end : end + node.block.only_recorded] = False
        return np.flatnonzero(remembered)

    def _advance(self, diagram: Diagram, groups: list[Group]) -> tuple[Call, ...]:
        sampled = [i for i in range(len(self.nodes)) if not is_external(self.nodes[i]) and self.updates(i)]
        calls = [Call(i, "update", ()) for i in sampled]  # evaluate has copied all inputs
        grouped = {i for group in groups for i in group.nodes}
        for group in groups:
            calls.append(Call(group.nodes[0], "group", (), group))
            if group.every > 1:  # until they run again, their inputs of t_k are recorded
                calls += [Call(i, "inputs", self._gathers(diagram, i)) for i in group.nodes]
        for i in self._plants():
            if i in grouped:
                continue
            seen = self._seen_ahead.get(i, ())
            calls.append(Call(i, "update", self._gathers(diagram, i, ahead=seen)))
            if seen and self.nodes[i].every > 1:  # until it runs again, its inputs of t_k are recorded
                calls.append(Call(i, "inputs", self._gathers(diagram, i)))
            if i in self.ahead:
                calls.append(Call(i, "ahead", ()))
        return tuple(calls)

    def _feeds(self, diagram: Diagram, i: int, j: int) -> bool:
        node = self.nodes[j]
        sources = (diagram.source_of(node, port, e) for port in node.inputs for e in range(port.size))
        return any(source is not None and source[0].node is self.nodes[i] for source in sources)


def _check_sample_time(node: Node, step: Fraction) -> None:
    required = sample_time_of(node.block)
    if required is not None and required != step:
        raise StepSizeError(
            f"Block {node.name!r} must run every {show(required)} s, but the diagram runs it every {show(step)} s; "
            "change the diagram's dt, the block's every=, or the block's own sample time."
        )


def _unknown_signal(diagram: Diagram, node: Node, signal: str) -> UnknownNameError:
    """Return the error about a named source that does not exist."""
    names = (
        name
        for each in diagram.nodes
        for port in (*each.outputs, *each.inputs)
        for name in labels(f"{each.name}.{port.name}", port.shape)
    )
    known = [name for name in names if diagram.find(name)]
    return UnknownNameError(
        f"{type(node.block).__name__} {node.name!r} reads the signal {signal!r}, but the diagram has no number of that name; "
        f"{did_you_mean(signal, known)}"
    )


def _check_signal_names(nodes: tuple[Node, ...]) -> None:
    owners: dict[str, Node] = {}
    for node in nodes:
        for port in (*node.inputs, *node.outputs):
            name = f"{node.name}.{port.name}"
            if owners.setdefault(name, node) is not node:
                raise ModelError(
                    f"The blocks {owners[name].name!r} and {node.name!r} both have a signal {name!r}; give one of them "
                    "another name."
                )
