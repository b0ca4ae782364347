"""Open a diagram: find its signals by name, and copy it with some of them fed from outside."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from math import gcd

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.subsystem import with_inside
from bayesftc.cosim.errors import ModelError, UnconnectedInputError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, labels

Names = Sequence[str] | Mapping[str, str] | str
"""Names of signals; a mapping gives each a new name."""

Signals = Mapping[str, tuple[Node, Port]]
Element = tuple[str, str, int]
"""Block, port and element of a scalar signal."""

OUTSIDE = "<outside>"
"""The name of the block for all signals from outside."""


def signals_of(diagram: Diagram) -> tuple[Signals, Signals]:
    """Return all inputs and all outputs of a diagram's blocks by name, such as ``plant.v``."""
    inputs, outputs = (
        {f"{node.name}.{port.name}": (node, port) for node in diagram.nodes for port in getattr(node.block, side)}
        for side in ("inputs", "outputs")
    )
    return inputs, outputs


def chosen(
    signals: Signals, names: Names, what: str, who: str, allowed: Callable[[str], str]
) -> dict[str, tuple[Node, Port, int]]:
    """Return the scalar signals of the given names, each by its label: ``y[0]``, ``y[1]`` for a vector ``y``.

    Parameters
    ----------
    signals : mapping of str to (Node, Port)
        All signals by name.
    names : sequence or mapping of str
        Names of the signals to choose, vectors or elements.
    what, who : str
        Nouns for a signal and for the caller in error messages.
    allowed : callable
        Converts a label into an allowed one.
    """
    listed = [names] if isinstance(names, str) else names
    renamed = names if isinstance(names, Mapping) else {name: name for name in listed}
    if len(renamed) < len(listed):
        raise ModelError(f"{who} has one of its {what}s twice: {', '.join(listed)}; name each once.")
    result: dict[str, tuple[Node, Port, int]] = {}
    for signal, label in renamed.items():
        label = allowed(label)
        if signal in signals:
            node, port = signals[signal]
            scalars = {scalar: (node, port, i) for i, scalar in enumerate(labels(label, port.shape))}
        else:
            scalars = {label: _one(signals, signal, what)}
        for scalar, place in scalars.items():
            if scalar in result or place in result.values():
                raise ModelError(
                    f"{who} has two {what}s {scalar!r}, or one of them twice; name each once, and give one of them another "
                    f"name, as in {what}s={{{signal!r}: 'other'}}."
                )
            result[scalar] = place
    return result


def _one(signals: Signals, signal: str, what: str) -> tuple[Node, Port, int]:
    match = re.fullmatch(r"(.+)\[([\d,]+)\]", signal)
    if match and match[1] in signals:
        node, port = signals[match[1]]
        elements = labels(match[1], port.shape)
        if signal in elements:
            return node, port, elements.index(signal)
    raise UnknownNameError(f"There is no {what} {signal!r}; {did_you_mean(signal, signals)}")


def _hand_on(u, y):
    for i in range(y.shape[0]):
        y[i] = u[i]


@dataclass(frozen=True)
class HandOn(Block):
    """A block whose ``y`` is ``u``. It represents signals from outside, or stands between FMUs."""

    size: int

    @property
    def inputs(self) -> tuple[Port, ...]:
        """``u``: the numbers from outside."""
        return (Port("u", (self.size,), default=0.0),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """``y``: the same."""
        return (Port("y", (self.size,)),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_hand_on)


def needed(diagram: Diagram) -> dict[str, tuple[Node, Port, int]]:
    """Return the scalar inputs that have neither a source nor a start value."""
    return {
        label: (node, port, i)
        for node in diagram.nodes
        for port in node.block.inputs
        for i, label in enumerate(labels(f"{node.name}.{port.name}", port.shape))
        if port.draw is None and port.default is None and next(diagram.origins_of(node, port, i), None) is None
    }


def part_of(diagram: Diagram, names: Iterable[str]) -> Diagram:
    """Return a diagram of some blocks of another one, and of the blocks inside those that are subsystems.

    Its base step is the largest possible one. Connections to other blocks are left out.
    """
    nodes = [diagram[name] for name in with_inside(diagram, names)]
    every = gcd(*(node.every for node in nodes))
    part = Diagram(diagram.step * every)
    new = {node.name: part.add(node.block, node.name, node.every // every) for node in nodes}
    for node in nodes:
        for port in node.inputs:
            for i in range(port.size):
                # Of a subsystem whose ports are left out, the block on their other side counts.
                origins = ((s, e) for s, e in diagram.origins_of(node, port, i) if s.node.name in new)
                if (origin := next(origins, None)) is not None:
                    part._sources[node.name, port.name, i] = new[origin[0].node.name][origin[0].port.name], origin[1]
    return part


def opened(diagram: Diagram, given: Sequence[tuple[Node, Port, int]], who: str) -> tuple[Diagram, list[Element]]:
    """Return a copy of the diagram in which the given signals come from outside, and the elements for their values.

    If a given signal is an output, all inputs that it feeds are fed from outside instead.
    """
    whole = copy(diagram)
    coupling, whole._coupling = whole._coupling, None
    outside = whole.add(HandOn(len(given)), OUTSIDE)["y"] if given else None
    for j, (node, port, i) in enumerate(given):
        assert outside is not None
        targets = [(node.name, port.name, i)]
        if any(port.name == output.name for output in node.block.outputs):
            targets = [
                target
                for target, (source, element) in diagram.connections()
                if source.node is node and source.port.name == port.name and element == i
            ]
        for target in targets:
            whole._sources[target] = outside, j
    for name, (node, _, _) in needed(whole).items():
        raise UnconnectedInputError(
            f"The input {name} of {type(node.block).__name__} has neither a source nor a start value; add it to the inputs "
            f"of {who}, where it is by default."
        )
    whole.build(coupling)
    return whole, [(OUTSIDE, "u", j) for j in range(len(given))]
