"""The signals of a closed loop by their part in it: what the figures and the figure of a run are computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.diagram import Diagram, Node
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.faults import Fault
from bayesftc.cosim.result import Result
from bayesftc.cosim.sensors import Sensors

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]


@dataclass(frozen=True, eq=False)
class SensorSignals:
    """One sensor over time; each array has a row for each recorded step, and is None if its signal was not recorded.

    Attributes
    ----------
    index : int
        Its number, from 0.
    samples : array
        What the controller was given (NaN for a missing sample).
    faulty : array of bool or None
        Whether one of its faults was present; None if that was not recorded.
    precision, beta, probability : array
        The controller's outputs for this sensor.
    """

    index: int
    samples: Floats | None
    faulty: Flags | None
    precision: Floats | None
    beta: Floats | None
    probability: Floats | None


@dataclass(frozen=True, eq=False)
class QuantitySignals:
    """One quantity that sensors measure, over time.

    Attributes
    ----------
    name : str
        The plant's variable, or ``sensor i`` where a sensor measures a mixture of several.
    unit : str or None
        Its unit.
    sensors : tuple of int
        The sensors that measure it.
    truth : array or None
        What an ideal sensor would read: without noise, offset, rounding and fault.
    reference : array or None
        The element of the goal for this very quantity; None if there is none.
    belief : array or None
        The controller's estimate of it: ``C x_hat``.
    """

    name: str
    unit: str | None
    sensors: tuple[int, ...]
    truth: Floats | None
    reference: Floats | None
    belief: Floats | None


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """A run of a closed loop: time in seconds, the measured quantities, the sensors.

    ``faults`` has for each fault that was recorded the number of its sensor and when it was present.
    """

    time: Floats
    quantities: tuple[QuantitySignals, ...]
    sensors: tuple[SensorSignals, ...]
    faults: Mapping[str, tuple[int, Flags]]

    @property
    def faulty(self) -> Flags | None:
        """Whether any sensor had a fault; None if not all of that was recorded."""
        known = [s.faulty for s in self.sensors if s.faulty is not None]
        return np.any(known, axis=0) if known and len(known) == len(self.sensors) else None


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
    seen, brain = _sensors(diagram), _controller(diagram)
    faults = {
        n.name: (n.block.sensor, reader.flags(f"{n.name}.active")) for n in diagram.nodes if isinstance(n.block, Fault)
    }
    parameters = brain.block.define(diagram.step * brain.every).parameters
    C, G = (np.atleast_2d(np.asarray(parameters[name])) if name in parameters else None for name in ("C", "G"))
    y = brain.block.port("y")
    none: Flags = np.zeros(len(result.time), dtype=bool)
    outputs = {name: reader.signal(f"{brain.name}.{name}") for name in ("precision", "beta", "fault_probability")}
    sensors = tuple(
        SensorSignals(
            i,
            reader.source(brain, "y", i),
            _any([none, *(active for sensor, active in faults.values() if sensor == i)]),
            *(None if values is None else values[:, i] for values in outputs.values()),
        )
        for i in range(y.size)
    )
    known = {name: (sensor, active) for name, (sensor, active) in faults.items() if active is not None}
    return LoopSignals(result.time, _quantities(reader, seen, brain, C, G), sensors, known)


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

    def source(self, node: Node, port: str, element: int) -> Floats | None:
        """Return what feeds one element of an input."""
        found = self.diagram.source_of(node, node.block.port(port), element)
        if found is None:
            return None
        values = self.signal(f"{found[0].node.name}.{found[0].port.name}")
        return values if values is None or values.ndim == 1 else values[:, found[1]]


def _any(flags: list[Flags | None]) -> Flags | None:
    known = [f for f in flags if f is not None]
    return np.any(known, axis=0) if len(known) == len(flags) else None


def _quantities(
    reader: _Reader, seen: Node, brain: Node, C: Floats | None, G: Floats | None
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
    x_hat = reader.signal(f"{brain.name}.x_hat")
    goals = brain.block.port("goal").size
    found = []
    for number, (row, members) in enumerate(groups.items()):
        used = [weight * signal for weight, signal in zip(row, inputs, strict=True) if weight and signal is not None]
        truth = np.sum(used, axis=0) if used and len(used) == np.count_nonzero(row) else None
        name, unit = _label(reader.diagram, seen, row, members[0])
        belief, goal = None, number if G is None and goals == len(groups) else None
        if C is not None:
            read = C[members[0]]
            belief = None if x_hat is None else x_hat @ read
            matches = [] if G is None else [g for g, row_of_goal in enumerate(G) if np.array_equal(row_of_goal, read)]
            goal = matches[0] if matches else goal
        reference = None if goal is None else reader.source(brain, "goal", goal)
        found.append(QuantitySignals(name, unit, tuple(members), truth, reference, belief))
    return tuple(found)


def _label(diagram: Diagram, seen: Node, row: tuple[float, ...], sensor: int) -> tuple[str, str | None]:
    nonzero = [j for j, weight in enumerate(row) if weight]
    if len(nonzero) != 1 or row[nonzero[0]] != 1.0:
        return f"sensor {sensor}", seen.block.port("y").unit
    found = diagram.source_of(seen, seen.block.port("u"), nonzero[0])
    if found is None:
        return f"sensor {sensor}", None
    port = found[0].port
    return port.name + (f"[{found[1]}]" if port.size > 1 else ""), port.unit or seen.block.port("y").unit


def _sensors(diagram: Diagram) -> Node:
    found = [node for node in diagram.nodes if isinstance(node.block, Sensors)]
    if len(found) != 1:
        raise ModelError(f"A closed loop has one Sensors block; {diagram!r} has {len(found)}.")
    return found[0]


def _controller(diagram: Diagram) -> Node:
    found = [
        node
        for node in diagram.nodes
        if {"y", "goal"} <= {p.name for p in node.block.inputs} and "u" in {p.name for p in node.block.outputs}
    ]
    if len(found) != 1:
        raise ModelError(
            f"A closed loop has one controller, a block with inputs y and goal and the output u; {diagram!r} has {len(found)}."
        )
    return found[0]


__all__ = ["LoopSignals", "QuantitySignals", "SensorSignals", "loop_signals"]
