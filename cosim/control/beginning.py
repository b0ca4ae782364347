"""Where a closed loop begins: the signals of its first step, and which of them have an effect there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np

from bayesftc.cosim.blocks.faults.base import Fault
from bayesftc.cosim.control.machine import Machine
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import needed, opened
from bayesftc.cosim.diagram.wiring import healthy_origin, healthy_source
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

Place = tuple[Node, Port, int]
"""One element of an input or output of a block."""


def first_values(diagram: Diagram, inputs: Sequence[Place]) -> Floats:
    """Return the values of inputs at the first step of a diagram, without noise, and as no fault would change them.

    An input without a source has its start value, or 0.
    """
    sources = [healthy_source(diagram, *place, sums=False) for place in inputs]
    read = [(node.name, port.name, i) for node, port, i in filter(None, sources)]
    healthy = _without_faults(diagram)
    whole, outside = opened(healthy, list(needed(healthy).values()), "linear")
    machine = Machine(whole, outside, read, None, "interpreted")
    values = iter(machine.output(0.0, machine.initial, np.zeros(len(outside))))
    return np.array(
        [
            start_values(port)[i] if source is None else next(values)
            for (_, port, i), source in zip(inputs, sources, strict=True)
        ],
        dtype=np.float64,
    )


def _without_faults(diagram: Diagram) -> Diagram:
    """Return a diagram in which no block reads from a fault; the faults stay in it."""
    healthy = copy(diagram)
    for (name, port, i), (source, _) in list(diagram.connections()):
        if isinstance(source.node.block, Fault):
            node = diagram[name]
            origin = healthy_origin(diagram, node, node.port(port), i, sums=False)
            if origin is not None:
                healthy._sources[name, port, i] = origin
    return healthy


def start_values(port: Port) -> Floats:
    """Return the start value of each element of an input, or zeros."""
    return np.broadcast_to(0.0 if port.default is None else port.default, port.shape).ravel().astype(np.float64)


def without_effect(A: Floats, B: Floats, C: Floats, D: Floats) -> bool:
    """Return whether no input of a linear system in discrete time has an effect on an output: all its paths have a zero."""
    reached = B.any(axis=1)
    while (more := reached | A[:, reached].any(axis=1)).sum() > reached.sum():
        reached = more
    return not (D.any() or C[:, reached].any())


def listed(values: Iterable[float]) -> str:
    """Return numbers as a list to read."""
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"
