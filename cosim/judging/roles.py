"""Finds the signals of a closed loop by their part in it, for the figures and the figure of a run."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np

from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.wiring import (
    element_name,
    elements,
    faults_before,
    faults_right_before,
    find_controller,
    find_sensors,
    label_of,
)
from bayesftc.cosim.judging.signals import (
    ActuatorSignals,
    Flags,
    InputSignals,
    LoopSignals,
    QuantitySignals,
    SensorSignals,
    any_of,
)
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats


def loop_signals(diagram: Diagram, result: Result) -> LoopSignals:
    """Find the signals of a closed loop by the blocks' kinds and connections.

    Parameters
    ----------
    diagram : Diagram
        With one `Sensors` block and one controller, a block with inputs ``y`` and ``goal`` and the output ``u``: as
        `closed_loop` makes it, or put together by hand in the same way.
    result : Result
        A run of it. Signals that were not recorded are None in what is returned.

    Raises
    ------
    ModelError
        If the diagram is no such loop.
    """
    reader = _Reader(diagram, result)
    seen, controller = find_sensors(diagram), find_controller(diagram)
    # A controller may say what its sensors read of its estimate x_hat (a row of NaN: nothing linear), and what its goal is of it.
    C, G = (getattr(controller.block, name, None) for name in ("measurement_matrix", "goal_matrix"))
    y = controller.port("y")
    chains = [faults_before(diagram, controller, i) for i in range(y.size)]
    active = {name: reader.flags(f"{name}.active") for chain in chains for name in chain}
    none: Flags = np.zeros(len(result.time), dtype=bool)
    precision, beta, probability, detected = (
        reader.columns(f"{controller.name}.{name}", y.size)
        for name in ("precision", "beta", "fault_probability", "detected")
    )
    sensors = tuple(
        SensorSignals(
            i,
            reader.source(controller, "y", i),
            any_of([none, *(active[name] for name in chain)]),
            precision[i],
            beta[i],
            probability[i],
            None if (found := detected[i]) is None else found > 0.5,
        )
        for i, chain in enumerate(chains)
    )
    known: dict[str, tuple[int, Flags]] = {}
    for i, chain in enumerate(chains):
        for name in chain:
            if (flags := active[name]) is not None:
                known.setdefault(name, (i, flags))  # a channel that is read twice is named once
    inputs = _inputs(reader, {seen.name, controller.name})
    quantities = _quantities(reader, seen, controller, C, G)
    return LoopSignals(result.time, quantities, sensors, known, inputs, _actuators(reader, controller))


class _Reader:
    """Reads signals of a result by connections of the diagram."""

    def __init__(self, diagram: Diagram, result: Result):
        self.diagram, self.result = diagram, result
        self.names = frozenset(result)

    def signal(self, name: str) -> Floats | None:
        return self.result[name] if name in self.names else None

    def flags(self, name: str) -> Flags | None:
        values = self.signal(name)
        return None if values is None else values > 0.5  # type: ignore[return-value]

    def columns(self, name: str, count: int) -> list[Floats | None]:
        """Return the elements of a signal; None for each if it was not recorded, or has another number of elements."""
        values = self.signal(name)
        found: list[Floats | None] = [] if values is None else list(values.reshape(len(values), -1).T)
        return found if len(found) == count else [None] * count

    def source(self, node: Node, port: str, element: int) -> Floats | None:
        """Return what feeds one element of an input."""
        found = self.diagram.source_of(node, node.port(port), element)
        if found is None:
            return None
        values = self.signal(f"{found[0].node.name}.{found[0].port.name}")
        return values if values is None or values.ndim == 1 else values[:, found[1]]


def _inputs(reader: _Reader, others: Container[str]) -> tuple[InputSignals, ...]:
    """Return the inputs that are fed through faults, but for those of the named blocks."""
    found = []
    for node, port, i in elements(reader.diagram, others):
        if chain := faults_right_before(reader.diagram, node, port, i):
            faults = {fault.name: reader.flags(f"{fault.name}.active") for fault, _ in chain}
            first, element = chain[0]
            sent, received = reader.source(first, "u", element), reader.source(node, port.name, i)
            found.append(InputSignals(element_name(port, i), port.unit, sent, received, faults))
    return tuple(found)


def _actuators(reader: _Reader, controller: Node) -> tuple[ActuatorSignals, ...]:
    """Return what the controller says of its actuators; nothing if it does not, or if that was not recorded."""
    count = controller.port("u").size
    probability, kind, size = (
        reader.columns(f"{controller.name}.actuator_fault_{name}", count) for name in ("probability", "kind", "size")
    )
    led: dict[int, tuple[str, str | None, Flags | None]] = {}
    none: Flags = np.zeros(len(reader.result.time), dtype=bool)
    for node, port, i in elements(reader.diagram, {controller.name}):
        chain = faults_right_before(reader.diagram, node, port, i)
        origin = reader.diagram.source_of(
            *((chain[0][0], chain[0][0].port("u"), chain[0][1]) if chain else (node, port, i))
        )
        if origin is not None and (origin[0].node.name, origin[0].port.name) == (controller.name, "u"):
            faulty = any_of([none, *(reader.flags(f"{fault.name}.active") for fault, _ in chain)])
            led.setdefault(origin[1], (element_name(port, i), port.unit, faulty))
    kinds = getattr(controller.block, "actuator_kinds", ())
    return tuple(
        ActuatorSignals(*led.get(j, (f"control {j}", None, none)), known, kind[j], size[j], kinds)
        for j, known in enumerate(probability)
        if known is not None
    )


def _quantities(
    reader: _Reader, seen: Node, controller: Node, C: Floats | None, G: Floats | None
) -> tuple[QuantitySignals, ...]:
    block: Any = seen.block
    if block.function is not None:  # what it measures is not linear, and is not kept
        return ()
    rows = (
        np.eye(block.signals)[np.arange(block.count) % block.signals]
        if block.matrix is None
        else np.asarray(block.matrix)
    )
    groups: dict[tuple[float, ...], list[int]] = {}
    for i, row in enumerate(rows):
        groups.setdefault(tuple(row), []).append(i)
    inputs = [reader.source(seen, "u", j) for j in range(block.signals)]
    x_hat = reader.signal(f"{controller.name}.x_hat")
    goals = controller.port("goal").size
    found = []
    for number, (row, members) in enumerate(groups.items()):
        used = [weight * signal for weight, signal in zip(row, inputs, strict=True) if weight and signal is not None]
        truth = np.sum(used, axis=0) if used and len(used) == np.count_nonzero(row) else None
        name, unit = label_of(reader.diagram, seen, row, members[0])
        # Sensors of one quantity read the same; a controller may know one of them by a function that is not linear.
        read = next((C[i] for i in members if np.isfinite(C[i]).all()), None) if C is not None else None
        belief = None if x_hat is None or read is None else x_hat @ read
        goal = number if goals == len(groups) and (C is None or G is None) else None  # unless said otherwise, in order
        if read is not None and G is not None:
            goal = next((g for g, row_of_goal in enumerate(G) if np.array_equal(row_of_goal, read)), None)
        reference = None if goal is None else reader.source(controller, "goal", goal)
        found.append(
            QuantitySignals(name, unit, tuple(members), truth, reference, belief, goal is not None, read is not None)
        )
    return tuple(found)


__all__ = ["loop_signals"]
