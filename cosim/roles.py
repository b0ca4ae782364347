"""The signals of a closed loop by their part in it: what the figures and the figure of a run are computed from."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.diagram import Diagram, Node
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.faults import Fault
from bayesftc.cosim.ports import Port, PortRef
from bayesftc.cosim.result import Result
from bayesftc.cosim.sensors import Sensors

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]

ALARM = 0.5
"""The fault probability from which on there is an alarm."""


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
        Whether a fault between the sensor and the controller was present; None if that was not recorded.
    precision, beta, probability : array
        The controller's outputs for this sensor.
    detected : array of bool or None
        Whether the controller says that it has detected a fault (`ExplicitDetection` does).
    """

    index: int
    samples: Floats | None
    faulty: Flags | None
    precision: Floats | None
    beta: Floats | None
    probability: Floats | None
    detected: Flags | None = None

    @property
    def missing(self) -> Flags | None:
        """Which samples were missing (NaN); None if the samples were not recorded."""
        return None if self.samples is None else np.isnan(self.samples)

    @property
    def alarm(self) -> Flags | None:
        """With which samples there is an alarm; None if that was not recorded, or if a sample has no finite probability.

        A probability of at least `ALARM` is one; of a controller that gives none, what it says is detected.
        """
        if self.probability is not None:
            known = ~np.isnan(self.probability)
            if known.any() or self.detected is None:
                needed = known if self.missing is None else known | self.missing
                return self.probability >= ALARM if needed.all() else None  # type: ignore[return-value]
        return self.detected


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
        The element of the goal for this very quantity; None if there is none, or if it was not recorded.
    belief : array or None
        The controller's estimate of it: ``C x_hat``; None if that was not recorded, or if there is none.
    has_goal : bool
        Whether there is an element of the goal for it.
    has_belief : bool
        Whether the controller says what linear function of ``x_hat`` it is.
    """

    name: str
    unit: str | None
    sensors: tuple[int, ...]
    truth: Floats | None
    reference: Floats | None
    belief: Floats | None
    has_goal: bool
    has_belief: bool


@dataclass(frozen=True, eq=False)
class InputSignals:
    """One input of the plant on whose way there is a fault, of an actuator or of the process, over time.

    Attributes
    ----------
    name : str
        The plant's variable.
    unit : str or None
        Its unit.
    sent, received : array or None
        What the controller (or a noise) has sent, and what the plant was given; None if that was not recorded.
    faults : mapping of str to array of bool or None
        For each fault on the way when it was present; None if that was not recorded.
    """

    name: str
    unit: str | None
    sent: Floats | None
    received: Floats | None
    faults: Mapping[str, Flags | None]

    @property
    def faulty(self) -> Flags | None:
        """Whether any of the faults was present; None if not all of that was recorded."""
        return _any(list(self.faults.values()))


@dataclass(frozen=True, eq=False)
class ActuatorSignals:
    """What a controller that knows of actuators' faults says of one of its controls, over time.

    Attributes
    ----------
    name : str
        The plant's variable that the control goes to; ``control j`` if it goes to none.
    unit : str or None
        Its unit.
    faulty : array of bool or None
        Whether a fault on the way was present; None if that was not recorded.
    probability : array
        That the actuator has a fault.
    kind, size : array or None
        The most probable mode by its number (0: healthy), and the size of its fault; None if that was not recorded.
    kinds : tuple of str
        Names of the modes, from number 1 on.
    """

    name: str
    unit: str | None
    faulty: Flags | None
    probability: Floats
    kind: Floats | None
    size: Floats | None
    kinds: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """A run of a closed loop: time in seconds, the measured quantities, the sensors, the inputs with a fault on their way.

    ``faults`` has for each fault of a sensor that was recorded the number of that sensor and when it was present;
    ``actuators`` are those that the controller says something of.
    """

    time: Floats
    quantities: tuple[QuantitySignals, ...]
    sensors: tuple[SensorSignals, ...]
    faults: Mapping[str, tuple[int, Flags]]
    inputs: tuple[InputSignals, ...] = ()
    actuators: tuple[ActuatorSignals, ...] = ()

    @property
    def faulty(self) -> Flags | None:
        """Whether any sensor or input had a fault; None if not all of that was recorded."""
        return _any([*(s.faulty for s in self.sensors), *(i.faulty for i in self.inputs)])


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
    # A controller may say what its sensors read of its estimate x_hat (a row of NaN: nothing linear), and what its goal is of it.
    C, G = (getattr(brain.block, name, None) for name in ("measurement_matrix", "goal_matrix"))
    y = brain.block.port("y")
    chains = [faults_before(diagram, brain, i) for i in range(y.size)]
    active = {name: reader.flags(f"{name}.active") for chain in chains for name in chain}
    none: Flags = np.zeros(len(result.time), dtype=bool)
    precision, beta, probability, detected = (
        reader.columns(f"{brain.name}.{name}", y.size)
        for name in ("precision", "beta", "fault_probability", "detected")
    )
    sensors = tuple(
        SensorSignals(
            i,
            reader.source(brain, "y", i),
            _any([none, *(active[name] for name in chain)]),
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
    inputs = _inputs(reader, {seen.name, brain.name})
    quantities = _quantities(reader, seen, brain, C, G)
    return LoopSignals(result.time, quantities, sensors, known, inputs, _actuators(reader, brain))


def faults_before(diagram: Diagram, brain: Node, sensor: int) -> list[str]:
    """Return the names of the faults between the sensors and one element of the controller's ``y``, in their order.

    A fault elsewhere, such as that of an actuator between controller and plant, is no fault of a sensor.
    """
    # What comes out of the controller leads to no sensor, whatever it has seen.
    known: _Known = {(brain.name, port.name, i): None for port in brain.block.inputs for i in range(port.size)}
    return _trace_source(diagram, diagram.source_of(brain, brain.block.port("y"), sensor), known) or []


_Known = dict[tuple[str, str, int], list[str] | None]


def _trace(diagram: Diagram, node: Node, port: Port, element: int, known: _Known) -> list[str] | None:
    """Follow one element of an input back to the sensors; return the faults on the way, None if it does not lead there."""
    at = (node.name, port.name, element)
    if at not in known:
        known[at] = None  # a way that comes back here leads round in a circle
        known[at] = _trace_source(diagram, diagram.source_of(node, port, element), known)
    return known[at]


def _trace_source(diagram: Diagram, origin: tuple[PortRef, int] | None, known: _Known) -> list[str] | None:
    if origin is None:
        return None
    node, channel = origin[0].node, origin[1]
    block = node.block
    if isinstance(block, Sensors):
        return []
    if isinstance(block, Fault):
        found = _trace(diagram, node, block.port("u"), channel, known)
        return None if found is None else [*found, *([node.name] if block.sensor == channel else [])]
    # Another block on the way, such as a delay, has one input as long as its output: element by element. Else all may matter.
    alike = [p.size for p in block.inputs] == [origin[0].port.size]
    ways = [
        _trace(diagram, node, entry, i, known)
        for entry in block.inputs
        for i in ([channel] if alike else range(entry.size))
    ]
    there = [names for names in ways if names is not None]
    return list(dict.fromkeys(name for names in there for name in names)) if there else None


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
        found = self.diagram.source_of(node, node.block.port(port), element)
        if found is None:
            return None
        values = self.signal(f"{found[0].node.name}.{found[0].port.name}")
        return values if values is None or values.ndim == 1 else values[:, found[1]]


def _any(flags: list[Flags | None]) -> Flags | None:
    known = [f for f in flags if f is not None]
    return np.any(known, axis=0) if known and len(known) == len(flags) else None


def _elements(diagram: Diagram, others: Container[str]) -> Iterator[tuple[Node, Port, int]]:
    """Give each element of each input, but for those of faults and of the named blocks."""
    for node in diagram.nodes:
        for port in () if isinstance(node.block, Fault) or node.name in others else node.block.inputs:
            for i in range(port.size):
                yield node, port, i


def _element(port: Port, i: int) -> str:
    return port.name + (f"[{i}]" if port.size > 1 else "")


def _inputs(reader: _Reader, others: Container[str]) -> tuple[InputSignals, ...]:
    """Return the inputs that are fed through faults, but for those of the named blocks."""
    found = []
    for node, port, i in _elements(reader.diagram, others):
        if chain := _chain(reader.diagram, node, port, i):
            faults = {fault.name: reader.flags(f"{fault.name}.active") for fault, _ in chain}
            first, element = chain[0]
            sent, received = reader.source(first, "u", element), reader.source(node, port.name, i)
            found.append(InputSignals(_element(port, i), port.unit, sent, received, faults))
    return tuple(found)


def _actuators(reader: _Reader, brain: Node) -> tuple[ActuatorSignals, ...]:
    """Return what the controller says of its actuators; nothing if it does not, or if that was not recorded."""
    count = brain.block.port("u").size
    probability, kind, size = (
        reader.columns(f"{brain.name}.actuator_fault_{name}", count) for name in ("probability", "kind", "size")
    )
    led: dict[int, tuple[str, str | None, Flags | None]] = {}
    none: Flags = np.zeros(len(reader.result.time), dtype=bool)
    for node, port, i in _elements(reader.diagram, {brain.name}):
        chain = _chain(reader.diagram, node, port, i)
        origin = reader.diagram.source_of(
            *((chain[0][0], chain[0][0].block.port("u"), chain[0][1]) if chain else (node, port, i))
        )
        if origin is not None and (origin[0].node.name, origin[0].port.name) == (brain.name, "u"):
            faulty = _any([none, *(reader.flags(f"{fault.name}.active") for fault, _ in chain)])
            led.setdefault(origin[1], (_element(port, i), port.unit, faulty))
    kinds = getattr(brain.block, "actuator_kinds", ())
    return tuple(
        ActuatorSignals(*led.get(j, (f"control {j}", None, none)), known, kind[j], size[j], kinds)
        for j, known in enumerate(probability)
        if known is not None
    )


def _chain(diagram: Diagram, node: Node, port: Port, element: int) -> list[tuple[Node, int]]:
    """Return the faults right before one element of an input, in their order, each with its element that is meant."""
    origin = diagram.source_of(node, port, element)
    if origin is None or not isinstance(origin[0].node.block, Fault):
        return []
    fault, channel = origin[0].node, origin[1]
    before = _chain(diagram, fault, fault.block.port("u"), channel)
    return [*before, (fault, channel)] if origin[0].node.block.sensor == channel else before


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
        # Sensors of one quantity read the same; a controller may know one of them by a function that is not linear.
        read = next((C[i] for i in members if np.isfinite(C[i]).all()), None) if C is not None else None
        belief = None if x_hat is None or read is None else x_hat @ read
        goal = number if goals == len(groups) and (C is None or G is None) else None  # unless said otherwise, in order
        if read is not None and G is not None:
            goal = next((g for g, row_of_goal in enumerate(G) if np.array_equal(row_of_goal, read)), None)
        reference = None if goal is None else reader.source(brain, "goal", goal)
        found.append(
            QuantitySignals(name, unit, tuple(members), truth, reference, belief, goal is not None, read is not None)
        )
    return tuple(found)


def _label(diagram: Diagram, seen: Node, row: tuple[float, ...], sensor: int) -> tuple[str, str | None]:
    nonzero = [j for j, weight in enumerate(row) if weight]
    if len(nonzero) != 1 or row[nonzero[0]] != 1.0:
        return f"sensor {sensor}", seen.block.port("y").unit
    found = diagram.source_of(seen, seen.block.port("u"), nonzero[0])
    if found is None:
        return f"sensor {sensor}", None
    port = found[0].port
    return _element(port, found[1]), port.unit or seen.block.port("y").unit


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


__all__ = ["ActuatorSignals", "InputSignals", "LoopSignals", "QuantitySignals", "SensorSignals", "loop_signals"]
