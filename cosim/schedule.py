"""From a diagram to a program: the order of calls, from per-port direct feedthrough, and the layout of memory.

A step has two phases. *Evaluate* computes all outputs at t_k in the order of direct feedthrough, then brings the inputs that
do not feed through, which may come from any block. *Advance* takes every state
to t_k+1: first the blocks that only know sampled time, in any order (no one's state can be seen before the next evaluation),
then the FMUs in the order in which they were added. With Gauss-Seidel coupling, an FMU that feeds a later one of the same
rate directly is read again at once, into a place of its own that only that later FMU's step sees: the outputs that everyone
else sees, and that are recorded, stay those of t_k until t_k+1 is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesftc.cosim._contract import RESERVED, checked
from bayesftc.cosim._coupled.groups import Group, Grouping, components, element_name
from bayesftc.cosim.block import Block, Definition, Floats, Kernel, argument_names
from bayesftc.cosim.coupling import Coupling
from bayesftc.cosim.diagram import Diagram, Node, is_external
from bayesftc.cosim.errors import AlgebraicLoopError, KernelError, ModelError, StepSizeError, UnconnectedInputError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.timebase import show

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction

Sections = dict[str, tuple[str, int, tuple[int, ...]]]
"""For each argument of a step function: its section, its offset in that section, its shape."""

NOT_FINITE = 1_000_000
"""A call's status from here on: the place in memory, plus this number, that came out NaN or infinite."""

TABLE = 32
"""Places reserved for the addresses that an external block's step functions need."""

SECTIONS = ("state", "parameters", "inputs", "outputs")


@dataclass(frozen=True)
class Call:
    """One call of a step function: whose, which one, and the copies (to, from) that bring its inputs.

    The kind ``inputs`` calls no function: it only brings inputs, so that they are recorded as they are at t_k. The kind
    ``ahead`` calls the output function, but its results go to the place of outputs ahead of time. The kind ``group`` computes
    several blocks together, of which `node` is the first.
    """

    node: int
    kind: Literal["output", "update", "inputs", "ahead", "group"]
    gathers: tuple[tuple[int, int], ...]
    group: Group | None = None


@dataclass(frozen=True)
class Draw:
    """One random number a step: the stream (block.port), the channel in it, its distribution and where it goes."""

    stream: str
    channel: int
    draw: int
    uniform: bool
    offset: int


@dataclass(frozen=True)
class Slots:
    """Where a node's sections begin in memory, and what each argument name means."""

    start: dict[str, int]
    sections: Sections

    def offset(self, name: str) -> int:
        """Return the place in memory of the first element of a named array."""
        section, offset, _ = self.sections[name]
        return self.start[section] + offset


class Schedule:
    """A diagram ready to run.

    Attributes
    ----------
    evaluate, advance : tuple of Call
        The two phases of a step.
    draws : tuple of Draw
        What the engine's random streams fill.
    initial : ndarray
        Memory as it stands before the first step: states, parameters, input defaults.
    free : tuple of (Node, Port)
        The inputs that nothing feeds, which keep their start values.
    ahead : dict of int to int
        Where in memory the outputs at t_k+1 stand, while the others step, of the FMUs that a later FMU sees so.
    groups : tuple of Group
        Blocks that are computed together: algebraic loops, and FMUs that are coupled tightly.
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
        self.free = tuple(
            (node, port)
            for node in self.nodes
            for port in node.block.inputs
            if port.draw is None and all(diagram.source_of(node, port, e) is None for e in range(port.size))
        )
        self._edges = self._feedthrough_edges(diagram)
        grouping = Grouping(self, lambda i, feedthrough: self._gathers(diagram, i, feedthrough), coupling)
        evaluate = [
            Call(min(unit), "group", (), grouping.loop(unit))
            if self._is_loop(unit)
            else Call(unit[0], "output", self._gathers(diagram, unit[0], feedthrough=True))
            for unit in self._order()
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

    def kernel(self, call: Call) -> Kernel | None:
        """Return the Python step function of a call; None for an external block, and where only inputs are brought."""
        definition = self.definitions[call.node]
        return getattr(definition, call.kind) if definition and call.kind != "inputs" else None

    def signal(self, node: Node, port: Port) -> slice:
        """Return where a port's elements lie in memory."""
        slots = self.slots[self._place[node]]
        start = slots.offset(port.name)
        return slice(start, start + port.size)

    def layout(self) -> tuple[Any, ...]:
        """Return what two diagrams must have in common for the memory of one to be that of the other."""
        blocks = tuple((node.name, type(node.block).__name__, node.every) for node in self.nodes)
        return str(self.step), self.coupling, blocks, len(self.initial)

    def describe(self) -> str:
        """Return the order of a step as text, a line a call; an FMU's line names the FMUs that it sees at t_k+1 already."""
        lines = [f"at t_k     {self._named(c)}" for c in self.evaluate if c.kind != "inputs"]
        for call in self.advance:
            if call.group:
                lines.append(f"to t_k+1   {self._named(call)}")
            elif call.kind == "update":
                seen = ", ".join(self.nodes[i].name for i in self._seen_ahead.get(call.node, ()))
                lines.append(f"to t_k+1   {self.nodes[call.node].name}" + (f"  (sees {seen} at t_k+1)" if seen else ""))
        return "\n".join(lines)

    def every(self, call: Call) -> int:
        """Return at which multiple of the base step a call is made."""
        return call.group.every if call.group else self.nodes[call.node].every

    def output_name(self, i: int, offset: int) -> str:
        """Return the full name of the output of node `i` that lies `offset` places behind its first."""
        return f"{self.nodes[i].name}.{element_name(self.nodes[i].block.outputs, offset)}"

    @property
    def _tight(self) -> bool:
        """Whether FMUs that are coupled make their steps together."""
        return self.coupling.iterated or self.coupling.step_error is not None

    def _is_loop(self, unit: list[int]) -> bool:
        return len(unit) > 1 or unit[0] in self._edges[unit[0]]

    def _named(self, call: Call) -> str:
        if not call.group:
            return self.nodes[call.node].name
        names = " and ".join(self.nodes[i].name for i in call.group.nodes)
        how = [f"guessing {', '.join(call.group.names)}"] if call.group.names else []
        how += ["in steps of their own"] if call.group.doubling else []
        return f"{names}  ({', '.join(how) or 'one after the other'})"

    def outputs_start(self, call: Call) -> int:
        """Return where in memory the outputs that a call writes begin."""
        return self.ahead[call.node] if call.kind == "ahead" else self.slots[call.node].start["outputs"]

    def updates(self, i: int) -> bool:
        """Return whether a node has something to do between t_k and t_k+1."""
        definition = self.definitions[i]
        return (
            definition.update is not None
            if definition
            else getattr(self.nodes[i].block, "timing", "plant") != "sampled"
        )

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
            for port in node.block.inputs:
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
                    element = f"[{unfed[0]}]" if len(unfed) < port.size else ""
                    raise UnconnectedInputError(
                        f"The input {node.name}.{port.name}{element} has no source and no start value; connect an output to it."
                    )
        return tuple(draws)

    def _gathers(
        self, diagram: Diagram, i: int, feedthrough: bool | None = None, *, ahead: tuple[int, ...] = ()
    ) -> tuple[tuple[int, int], ...]:
        """Return the copies that bring a block's inputs: those that feed through, those that do not, or all of them.

        What comes from the nodes `ahead` is taken from their outputs ahead of time.
        """
        node, slots, copies = self.nodes[i], self.slots[i], []
        for port in node.block.inputs:
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

    def _feedthrough_edges(self, diagram: Diagram) -> dict[int, dict[int, tuple[str, str]]]:
        edges: dict[int, dict[int, tuple[str, str]]] = {i: {} for i in range(len(self.nodes))}
        for i, node in enumerate(self.nodes):
            if not self._outputs(i):
                continue
            for port in node.block.inputs:
                for element in range(port.size if port.feedthrough else 0):
                    source = diagram.source_of(node, port, element)
                    if source is not None:
                        j = self._place[source[0].node]
                        edges[j].setdefault(
                            i, (f"{source[0].node.name}.{source[0].port.name}", f"{node.name}.{port.name}")
                        )
        return edges

    def _order(self) -> list[list[int]]:
        """Return the blocks in an order in which each finds its inputs; those of an algebraic loop stand together."""
        waiting = dict.fromkeys(range(len(self.nodes)), 0)
        for targets in self._edges.values():
            for target in targets:
                waiting[target] += 1
        order: list[list[int]] = []
        while waiting:
            ready = next(([i] for i, count in waiting.items() if count == 0), None)
            if ready is None:
                if not self.coupling.iterated:
                    raise AlgebraicLoopError(self._loop_sentence(set(waiting)))
                needs = {i: {j for j in waiting if i in self._edges[j]} for i in waiting}
                ready = components(list(waiting), needs)[0]
            for i in ready:
                del waiting[i]
            order.append(ready)
            for target in [target for i in ready for target in self._edges[i] if target in waiting]:
                waiting[target] -= 1
        return order

    def _loop_sentence(self, stuck: set[int]) -> str:
        # Walk backwards: each stuck block has a stuck predecessor, so the walk must close.
        path = [min(stuck)]
        while True:
            before = next(j for j in sorted(stuck) if path[-1] in self._edges[j])
            if before in path:
                loop = [*path[path.index(before) :], before][::-1]
                break
            path.append(before)
        lines = [
            f"  {self._edges[a][b][0]} -> {self._edges[a][b][1]}  ({self.nodes[b].name} feeds it through)"
            for a, b in pairwise(loop)
        ]
        direct = [
            self.nodes[i].name for i in sorted(set(loop)) if getattr(self.nodes[i].block, "timing", "") == "direct"
        ]
        return (
            "The diagram has an algebraic loop, in which each value at t_k depends on itself:\n"
            + "\n".join(lines)
            + "\nPut a UnitDelay into one of these connections, declare the input feedthrough=False where that is true, or let "
            "the loop be solved at each step with build(coupling='iterated')."
            + (f" {direct[0]!r} with timing='plant' shows the inputs of the step before." if direct else "")
        )

    def _plants(self) -> list[int]:
        return [i for i in range(len(self.nodes)) if is_external(self.nodes[i]) and self.updates(i)]

    def _pairs_ahead(self, diagram: Diagram) -> dict[int, tuple[int, ...]]:
        """Return, for each FMU, the earlier ones that it sees at the end of its step.

        An FMU of another rate has no new value there, or not yet: it is seen at t_k, as by everyone else.
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
            total += sum(port.size for port in self.nodes[i].block.outputs)
        return places, np.concatenate([values, np.full(total - len(values), np.nan)])

    def _advance(self, diagram: Diagram, groups: list[Group]) -> tuple[Call, ...]:
        sampled = [i for i in range(len(self.nodes)) if not is_external(self.nodes[i]) and self.updates(i)]
        calls = [Call(i, "update", ()) for i in sampled]  # all inputs have come by the end of evaluate
        grouped = {i for group in groups for i in group.nodes}
        for group in groups:
            calls.append(Call(group.nodes[0], "group", (), group))
            if group.every > 1:  # until they run again, their inputs too are recorded as at t_k
                calls += [Call(i, "inputs", self._gathers(diagram, i)) for i in group.nodes]
        for i in self._plants():
            if i in grouped:
                continue
            seen = self._seen_ahead.get(i, ())
            calls.append(Call(i, "update", self._gathers(diagram, i, ahead=seen)))
            if seen and self.nodes[i].every > 1:  # until it runs again, its inputs too are recorded as at t_k
                calls.append(Call(i, "inputs", self._gathers(diagram, i)))
            if i in self.ahead:
                calls.append(Call(i, "ahead", ()))
        return tuple(calls)

    def _feeds(self, diagram: Diagram, i: int, j: int) -> bool:
        node = self.nodes[j]
        sources = (diagram.source_of(node, port, e) for port in node.block.inputs for e in range(port.size))
        return any(source is not None and source[0].node is self.nodes[i] for source in sources)


def arrange(block: Block, definition: Definition | None, begin: int) -> tuple[Slots, Floats]:
    """Lay one block's sections out from place `begin` on; return where everything is and the initial values.

    An external block, without a definition, gets room for its table of addresses as its parameters.
    """
    groups: dict[str, Mapping[str, Floats]] = {
        "state": _arrays(definition.state) if definition else {},
        "parameters": _arrays(definition.parameters) if definition else {"<table>": np.zeros(TABLE)},
        "inputs": {p.name: _filled(p, 0.0 if p.default is None else p.default) for p in block.inputs},
        "outputs": {p.name: _filled(p, np.nan) for p in block.outputs},
    }
    start: dict[str, int] = {}
    sections: Sections = {}
    pieces: list[Floats] = []
    for section in SECTIONS:
        start[section], offset = begin, 0
        for name, array in groups[section].items():
            if name in sections or (definition is not None and name in RESERVED):
                raise KernelError(
                    f"{type(block).__name__} uses the name {name!r} twice among its ports, states and parameters "
                    f"({', '.join(sorted(RESERVED))} are taken): rename one."
                )
            sections[name] = (section, offset, array.shape)
            pieces.append(array.ravel())
            offset += array.size
        begin += offset
        if section in {"inputs", "outputs"}:
            sections.setdefault(section, (section, 0, (offset,)))
    return Slots(start, sections), np.concatenate([np.zeros(0), *pieces])


def bind(kernel: Kernel, slots: Slots, memory: Floats) -> Callable[[float, int], None]:
    """Return the plain Python step function with views of memory as its arguments; it still takes ``t`` and ``k``."""
    views: list[Any] = []
    for name in argument_names(kernel):
        if name in {"t", "k"}:
            views.append(name)
        else:
            shape = slots.sections[name][2]
            start = slots.offset(name)
            views.append(memory[start : start + prod(shape)].reshape(shape))

    def step(t: float, k: int) -> None:
        # NumPy's numbers, as array elements are: a division by zero gives an infinity, as in compiled code.
        now = {"t": np.float64(t), "k": np.int64(k)}
        try:
            kernel(*[now[v] if isinstance(v, str) else v for v in views])
        except ZeroDivisionError:
            raise KernelError(
                f"Step function {kernel.__name__!r} divides one plain Python number by another, which is zero; compiled code "
                "would go on with an infinity. Let one of the two come from an array."
            ) from None

    return step


def _check_sample_time(node: Node, step: Fraction) -> None:
    wanted = node.block.sample_time
    if wanted is not None and wanted != step:
        raise StepSizeError(
            f"Block {node.name!r} must run every {show(wanted)} s, but the diagram runs it every {show(step)} s; "
            "change the diagram's dt, the block's every=, or the block's own sample time."
        )


def _check_signal_names(nodes: tuple[Node, ...]) -> None:
    owners: dict[str, Node] = {}
    for node in nodes:
        for port in (*node.block.inputs, *node.block.outputs):
            name = f"{node.name}.{port.name}"
            if owners.setdefault(name, node) is not node:
                raise ModelError(
                    f"The blocks {owners[name].name!r} and {node.name!r} both have a signal {name!r}; give one of them "
                    "another name."
                )


def _arrays(values: Mapping[str, object]) -> dict[str, Floats]:
    return {name: np.atleast_1d(np.asarray(value, dtype=np.float64)) for name, value in values.items()}


def _filled(port: Port, value: float | tuple[Any, ...]) -> Floats:
    return np.full(port.shape or (1,), value, dtype=np.float64)
