"""Find the parts of a closed loop among a diagram's blocks, the faults between them, its slow sensors, and origins of goals."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import groupby
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import Block, sample_time_of
from bayesftc.cosim.blocks.faults.kinds import Delay, Fault
from bayesftc.cosim.blocks.linear_system import LinearSystem
from bayesftc.cosim.blocks.mathblocks import Sum
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef, label
from bayesftc.cosim.diagram.subsystem import INSIDE, Boundary, Subsystem
from bayesftc.cosim.errors import ConnectionError, ModelError, brief
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port, labels

_Visited = dict[tuple[str, str, int], list[str] | None]

AHEAD = "ahead"
"""The output of a `Preview` that lies ahead."""

MOST_TERMS = 3
"""Largest number of signals in the name of what a sensor reads; a sensor of more has its number as a name."""


def find_sensors(diagram: Diagram) -> Node:
    """Return the node of the sensors."""
    nodes = [node for node in diagram.nodes if isinstance(node.block, Sensors)]
    if len(nodes) != 1:
        raise ModelError(f"A closed loop has one Sensors block; {diagram!r} has {len(nodes)}.")
    return nodes[0]


def is_controller(node: Node) -> bool:
    """Return whether a block has the ports of a controller: inputs ``y`` and ``goal``, and the output ``u``."""
    return {"y", "goal"} <= {p.name for p in node.inputs} and "u" in {p.name for p in node.outputs}


def find_controller(diagram: Diagram) -> Node:
    """Return the node of the controller: the block with inputs ``y`` and ``goal`` and the output ``u``.

    Blocks inside a subsystem that is itself a controller are its parts.
    """
    every = [node for node in diagram.nodes if is_controller(node)]
    nodes = [node for node in every if not any(node.name.startswith(f"{other.name}.") for other in every)]
    if len(nodes) != 1:
        own = " Make a Subsystem of the estimator and your law." if any(map(_is_estimator, diagram.nodes)) else ""
        raise ModelError(
            "A closed loop has one controller, a block with inputs y and goal and the output u; "
            f"{diagram!r} has {len(nodes)}.{own}"
        )
    return nodes[0]


def find_inference(diagram: Diagram) -> Node:
    """Return the node that infers the state from the samples: the controller, or the only estimator where there is none."""
    estimators = [node for node in diagram.nodes if _is_estimator(node)]
    alone = len(estimators) == 1 and not any(map(is_controller, diagram.nodes))
    return estimators[0] if alone else find_controller(diagram)


def inferring(block: Block) -> Block:
    """Return the block that infers the state; of a subsystem the one inside, if there is one, else the subsystem."""
    if not isinstance(block, Boundary) or block.inside is None:
        return block
    try:
        return inferring(find_inference(block.inside).block)
    except ModelError:
        return block


def is_linear(diagram: Diagram) -> bool:
    """Return whether all blocks with inputs of a loop, but for its sensors, its controller and faults, are linear systems."""
    own = find_inference(diagram).name
    return all(
        isinstance(block := node.block, Fault | Sensors)
        or (isinstance(block, StateSpace) and isinstance(block.system, LinearSystem))
        for node in diagram.nodes
        if node.inputs and node.name != own and not node.name.startswith(f"{own}.")
    )


def _is_estimator(node: Node) -> bool:
    """Return whether a block has the ports of a state estimator: the input ``y``, and the outputs ``x_hat`` and its noise."""
    return "y" in {p.name for p in node.inputs} and {"x_hat", "precision"} <= {p.name for p in node.outputs}


def faults_before(diagram: Diagram, controller: Node, sensor: int) -> list[str]:
    """Return the names of the faults between the sensors and one element of the controller's ``y``, in their order.

    Faults elsewhere, such as an actuator fault between controller and plant, are not included.
    """
    # The controller's inputs count as visited, so that no path goes through the controller.
    visited: _Visited = {(controller.name, port.name, i): None for port in controller.inputs for i in range(port.size)}
    return _trace_source(diagram, diagram.source_of(controller, controller.port("y"), sensor), visited) or []


def _trace(diagram: Diagram, node: Node, port: Port, element: int, visited: _Visited) -> list[str] | None:
    """Trace one element of an input back to the sensors; return the faults on the path, None if there is no path."""
    place = (node.name, port.name, element)
    if place not in visited:
        visited[place] = None  # a path that returns here is a circle
        visited[place] = _trace_source(diagram, diagram.source_of(node, port, element), visited)
    return visited[place]


def _trace_source(diagram: Diagram, origin: tuple[PortRef, int] | None, visited: _Visited) -> list[str] | None:
    if origin is None:
        return None
    node, channel = origin[0].node, origin[1]
    block = node.block
    if isinstance(block, Sensors):
        return []
    if isinstance(block, Fault):
        faults = _trace(diagram, node, node.port("u"), channel, visited)
        return None if faults is None else [*faults, *([node.name] if block.sensor == channel else [])]
    # A block with one input of the output's size, such as a delay, acts element by element. Of others all elements may matter.
    elementwise = [p.size for p in node.inputs] == [origin[0].port.size]
    paths = [
        _trace(diagram, node, entry, i, visited)
        for entry in node.inputs
        for i in ([channel] if elementwise else range(entry.size))
    ]
    complete = [names for names in paths if names is not None]
    return list(dict.fromkeys(name for names in complete for name in names)) if complete else None


def passed_by(diagram: Diagram, node: Node) -> int | None:
    """Return the only element of a sum that does not come from a source, as where a disturbance is added to a control.

    None for other blocks, and for a sum that changes the element's sign. In deviations from where the loop begins, sources are 0.
    """
    if not isinstance(node.block, Sum):
        return None
    port = node.port("u")
    moving = [i for i in range(port.size) if not _from_source(diagram, node, port, i)]
    return moving[0] if len(moving) == 1 and node.block.signs[moving[0]] == "+" else None


def _from_source(diagram: Diagram, node: Node, port: Port, element: int) -> bool:
    """Return whether one element of an input comes from a block without inputs, if only through faults."""
    origin = diagram.source_of(node, port, element)
    if origin is None:
        return False
    before = origin[0].node
    if isinstance(before.block, Fault):
        return _from_source(diagram, before, before.port("u"), origin[1])
    return all(each.draw is not None for each in before.inputs)


def faults_right_before(diagram: Diagram, node: Node, port: Port, element: int) -> list[tuple[Node, int]]:
    """Return the faults directly before one element of an input, in their order, each with its faulty element.

    Faults before a sum with sources are among them.
    """
    origin = diagram.source_of(node, port, element)
    if origin is not None and (passed := passed_by(diagram, origin[0].node)) is not None:
        return faults_right_before(diagram, origin[0].node, origin[0].node.port("u"), passed)
    if origin is None or not isinstance(origin[0].node.block, Fault):
        return []
    fault, channel = origin[0].node, origin[1]
    before = faults_right_before(diagram, fault, fault.port("u"), channel)
    return [*before, (fault, channel)] if origin[0].node.block.sensor == channel else before


def with_rates(diagram: Diagram, before: Diagram | None = None) -> Diagram:
    """Return a closed loop in which faults of sensors and the controller's learner know how often each sensor has a sample.

    Parameters
    ----------
    diagram : Diagram
        Any diagram; one that is no closed loop does not change.
    before : Diagram, optional
        The same loop with other sensors, from which the faults and the controller are. By default they know of no slow sensors.

    Raises
    ------
    ConnectionError
        If the controller misses samples of a slow sensor, because it runs at other steps.
    """
    try:
        controller, rates = find_controller(diagram), find_sensors(diagram).block.rates  # type: ignore[attr-defined]
        former = (1,) * len(rates) if before is None else find_sensors(before).block.rates  # type: ignore[attr-defined]
    except ModelError:
        return diagram
    if max(rates) == max(former) == 1 or len(rates) != controller.port("y").size or len(former) != len(rates):
        return diagram
    blocks = {node.name: node.block for node in diagram.nodes}
    for i, every in enumerate(rates):
        for name in faults_before(diagram, controller, i):
            fault = blocks[name]
            if isinstance(fault, Fault) and fault.sensor == i:
                blocks[name] = replace(fault, spacing=every)
    blocks[controller.name] = for_rates(controller.block, rates, controller.every, former)
    return diagram.rewired(blocks)


def for_rates(controller: Block, rates: Sequence[int], steps: int = 1, former: Sequence[int] = ()) -> Block:
    """Return a controller whose learner knows the number of steps between two samples of each sensor.

    Parameters
    ----------
    controller : Block
        The controller. One without a learner does not change.
    rates : sequence of int
        Steps from one sample to the next, of each sensor.
    steps : int
        Steps from one sample of the controller to the next.
    former : sequence of int
        The rates that it knows; by default all sensors have a sample at each step.

    Raises
    ------
    ConnectionError
        If the controller misses samples of a slow sensor.
    """
    for i, every in enumerate(rates):
        if every % steps and steps % every:
            raise ConnectionError(
                f"Sensors has every={every} for sensor {i}, but the controller runs every {steps} steps and misses some samples. "
                f"Give slow sensors a multiple of {steps}."
            )
    block: Any = controller
    learner = getattr(block, "precision", None)
    if learner is None or not hasattr(learner, "for_rates"):
        return controller
    new, before = (tuple(max(every // steps, 1) for every in each) for each in (rates, former or (1,) * len(rates)))
    adapted = learner.for_rates(new, before)
    changed: Block = controller if adapted is learner else replace(block, precision=adapted)
    return changed


def healthy_source(
    diagram: Diagram, node: Node, port: Port, element: int, *, sums: bool = True
) -> tuple[Node, Port, int] | None:
    """Return the block, the output and its element that feed one element of an input while no fault is present.

    A subsystem counts as one block. With `sums`, what sources add on the way does not count; see `passed_by`.
    """
    found = healthy_origin(diagram, node, port, element, sums=sums)
    return None if found is None else (found[0].node, found[0].port, found[1])


def healthy_origin(diagram: Diagram, node: Node, port: Port, element: int, *, sums: bool) -> tuple[PortRef, int] | None:
    """Return the port and its element to which one element of an input is connected while no fault is present.

    With `sums` as in `healthy_source`.
    """
    path = _upstream(diagram, node, port, element, sums=sums)
    return next((origin for origin, before in path if before is None), None)


def warn_of_rounded_delays(diagram: Diagram) -> None:
    """Warn of each dead time that is no multiple of the step, and of each delay that is none of a slow sensor's sample time."""
    for node in diagram.nodes:
        fault, step = node.block, diagram.step * node.every
        if not isinstance(fault, Delay) or (fault.spacing == 1 and not fault.permanent):
            continue
        late, between = float(fault.numbers(step)[0] * step), float(fault.spacing * step)
        if abs(late - fault.delay) <= (0.01 if fault.spacing == 1 else 0.5) * float(step):
            continue
        if fault.spacing == 1:
            warn_user(
                f"{node.name!r} delays by {late:g} s, not by {fault.delay:g} s: "
                f"a delay is a whole number of steps, here of {between:g} s."
            )
        else:
            warn_user(
                f"{node.name!r} delays sensor {fault.sensor} by {fault.delay:g} s, but the sensor has a sample every "
                f"{between:g} s, and a fault acts on its samples: they are {late:g} s late. Give a multiple of {between:g} s, or "
                "write the dead time into the plant."
            )


def is_dead_time(fault: Any) -> bool:
    """Return whether a fault is a part of the plant: a delay that is always present."""
    return isinstance(fault, Delay) and fault.permanent


def dead_time(diagram: Diagram, node: Node, port: Port, element: int) -> Fraction:
    """Return the seconds by which faults that are always present delay one element of an input: its dead time."""
    late = Fraction(0)
    for (origin, i), _ in _upstream(diagram, node, port, element, sums=True):
        fault, step = origin.node.block, diagram.step * origin.node.every
        if is_dead_time(fault) and fault.sensor == i:  # type: ignore[attr-defined]
            late += int(fault.numbers(step)[0]) * step  # type: ignore[attr-defined]
    return late


def dead_times(diagram: Diagram, plant: str) -> tuple[dict[int, Fraction], list[Fraction]]:
    """Return the dead times between controller and plant, by control, and those of the controller's samples."""
    controller = find_controller(diagram)
    late = {}
    for node, port, i in elements(diagram, {each.name for each in diagram.nodes} - {plant}):
        source = healthy_source(diagram, node, port, i)
        if source is not None and source[0] is controller and source[1].name == "u":
            late[source[2]] = dead_time(diagram, node, port, i)
    y = controller.port("y")
    return late, [dead_time(diagram, controller, y, i) for i in range(y.size)]


def _upstream(
    diagram: Diagram, node: Node, port: Port, element: int, *, sums: bool
) -> Iterator[tuple[tuple[PortRef, int], int | None]]:
    """Yield the outputs on the way to one element of an input, back to the first block that is no fault.

    Each comes with the element of the input ``u`` that passes through its block, None at the end. With `sums`, sums with sources
    are passed, too.
    """
    origin = next(diagram.origins_of(node, port, element), None)
    while origin is not None:
        block = origin[0].node
        before = origin[1] if isinstance(block.block, Fault) else passed_by(diagram, block) if sums else None
        yield origin, before
        if before is None:
            return
        origin = next(diagram.origins_of(block, block.port("u"), before), None)


def elements(diagram: Diagram, others: Container[str]) -> Iterator[tuple[Node, Port, int]]:
    """Yield each element of each input, except for those of faults and of the named blocks, and those that pass through sums.

    An input of a subsystem counts once: neither what its ports show nor the inputs inside that they feed are yielded.
    """
    for node in diagram.nodes:
        passed = passed_by(diagram, node)
        for port in () if isinstance(node.block, Fault) or node.name in others else node.inputs:
            for i in range(port.size):
                if i != passed and not _of_boundary(diagram, node, port, i):
                    yield node, port, i


def _of_boundary(diagram: Diagram, node: Node, port: Port, element: int) -> bool:
    """Return whether an input is the inside of a subsystem's boundary, or is fed by an input of the subsystem around it."""
    if isinstance(node.block, Boundary) and port.name == INSIDE:
        return True
    origin = next(diagram.origins_of(node, port, element), None)
    return origin is not None and isinstance(origin[0].node.block, Boundary) and origin[0].direction == "input"


def element_name(port: Port, i: int) -> str:
    """Return the name of one element of a port."""
    return port.name + (f"[{i}]" if port.size > 1 else "")


def label_of(diagram: Diagram, sensors: Node, row: tuple[float, ...], sensor: int) -> tuple[str, str | None]:
    """Return the name and the unit of the quantity that a sensor measures, given its row of the measurement matrix.

    The name is that of a signal, or says what the sensor reads of several: ``altitude + 0.5 wander``.
    """
    nonzero = [j for j, weight in enumerate(row) if weight]
    if len(nonzero) != 1 or row[nonzero[0]] != 1.0:
        terms = [(row[j], diagram.source_of(sensors, sensors.port("u"), j)) for j in nonzero]
        named = [(weight, element_name(source[0].port, source[1])) for weight, source in terms if source is not None]
        known = 0 < len(named) == len(terms) <= MOST_TERMS
        return _sum(named) if known else f"sensor {sensor}", sensors.port("y").unit_of(sensor)
    source = diagram.source_of(sensors, sensors.port("u"), nonzero[0])
    if source is None:
        return f"sensor {sensor}", None
    port = source[0].port
    return element_name(port, source[1]), port.unit_of(source[1]) or sensors.port("y").unit_of(sensor)


def _sum(terms: list[tuple[float, str]]) -> str:
    """Return a sum of signals with their weights as text."""
    first, *rest = [(weight, name if abs(weight) == 1.0 else f"{abs(weight):.3g} {name}") for weight, name in terms]
    signs = "".join(f" {'-' if weight < 0.0 else '+'} {text}" for weight, text in rest)
    return f"{'-' if first[0] < 0.0 else ''}{first[1]}{signs}"


def warn_of_other_signals(diagram: Diagram, plant: Node, controller: Node) -> None:
    """Warn if the controller's model has other signals of the plant, or another order of them, than the loop connects."""
    model = getattr(controller.block, "model", None)
    names = getattr(model, "names", None)
    sensors = find_sensors(diagram)
    rows = sensors.block.rows  # type: ignore[attr-defined]
    if rows is None:
        return
    measured = [label_of(diagram, sensors, tuple(row), i)[0] for i, row in enumerate(rows)]
    driven: dict[int, str] = {}
    for port in plant.inputs:
        for i, name in enumerate(labels(port.name, port.shape)):
            origin = healthy_source(diagram, plant, port, i)
            if origin is not None and origin[0] is controller and origin[1].name == "u":
                driven[origin[2]] = name
    known = {name for port in (*plant.inputs, *plant.outputs) for name in labels(port.name, port.shape)}
    for role, kind, of_model, of_loop in (
        ("measured", "sensors", names.sensors if names else _named_by_rows(model, measured), measured),
        ("control", "controls", names.controls if names else (), [driven[j] for j in sorted(driven)]),
    ):
        if list(of_model) != of_loop and len(of_model) == len(of_loop) and known.issuperset((*of_model, *of_loop)):
            how = "" if names else " (by the rows of C)"
            warn_user(
                f"The controller's model has the {kind} {', '.join(of_model)}{how}, but the loop has {', '.join(of_loop)} in "
                f"their places. {_remedy(role, of_model, of_loop)}, or design the controller for the signals of the loop."
            )


def _named_by_rows(model: Any, measured: Sequence[str]) -> list[str]:
    """Return a name for each sensor of a model without names: equal rows of C are one of the loop's signals, in their order."""
    signals, numbers = list(dict.fromkeys(measured)), getattr(model, "quantity", ())
    return [signals[q] for q in numbers] if len({*numbers}) == len(signals) else []


def _remedy(role: str, of_model: Sequence[str], of_loop: Sequence[str]) -> str:
    """Return what to give the loop for the signals of the model: the signals, or the number of sensors of each."""
    signals = list(dict.fromkeys(of_model))
    if role != "measured" or signals != list(dict.fromkeys(of_loop)):
        return f"Give {role}={signals}"
    each = [of_model.count(name) for name in signals]
    grouped = [name for name, count in zip(signals, each, strict=True) for _ in range(count)]
    if list(of_model) == grouped:
        return f"Give sensors=Sensors(count={each}, ...)"
    return f"Give sensors=Sensors(count={len(of_model)}, ...), a single number, with which the sensors read the signals in turn"


def warn_of_held_inputs(diagram: Diagram, plant: Node, controller: Node) -> None:
    """Warn if an input of the plant without a source has another value than that at which the controller's model was made."""
    held = dict(getattr(getattr(controller.block, "model", None), "held_inputs", ()))
    for port in plant.inputs:
        for i, name in enumerate(labels(port.name, port.shape)):
            if name in held and port.default is not None and healthy_source(diagram, plant, port, i) is None:
                value = float(np.broadcast_to(port.default, port.shape).ravel()[i])
                if value != held[name]:
                    warn_user(
                        f"The controller's model was made with {name} = {held[name]:g}, but {name} of the plant has no source "
                        f"and stays at {value:g}. Give it a source, such as noise={{{name!r}: cosim.Constant({held[name]:g})}}; "
                        "in a scenario file, [noise]."
                    )


APART = 30.0
"""Ratio of standard deviations from which on sensors hardly read the same signal."""


def warn_of_turns(sensors: Sensors) -> None:
    """Warn if sensors that read the signals in turn have a noise as if they read one signal after the other."""
    if sensors.matrix is not None or sensors.function is not None or np.ndim(sensors.std) == 0:
        return
    std = np.asarray(sensors.std, float).tolist()
    counts = tuple(len(list(group)) for _, group in groupby(std))
    if len(counts) == sensors.signals < len(std) and max(std) > APART * min(std) > 0.0:
        warn_user(
            f"With count={len(std)} the sensors read the {sensors.signals} signals in turn, but std={brief(std)} looks as "
            f"if they read one signal after the other. If they do, give count={counts}."
        )


def warn_of_late_sensors(diagram: Diagram, controller: Node) -> None:
    """Warn of a dead time of a sensor that the controller's model does not know, while another sensor is not as late.

    If all sensors of a quantity are late alike, the model may have the dead time among the states of its plant.
    """
    C, y = getattr(controller.block, "measurement_matrix", None), controller.port("y")
    sensors, step = find_sensors(diagram), diagram.step * controller.every
    rows = sensors.block.rows  # type: ignore[attr-defined]
    if C is None or rows is None or len(C) != y.size or len(rows) != y.size or not np.isfinite(C).all():
        return
    delays = getattr(getattr(controller.block, "model", None), "delays", None)
    known = getattr(delays, "sensors", (0,) * y.size)
    samples = [dead_time(diagram, controller, y, i) / step for i in range(y.size)]
    unknown = [late - of_model for late, of_model in zip(samples, known, strict=True)]
    for i in range(y.size):
        least = max(min(unknown[j] for j in range(y.size) if np.array_equal(C[j], C[i])), 0)
        if unknown[i] >= least + 1:
            name = label_of(diagram, sensors, tuple(rows[i]), i)[0]
            warn_user(
                f"Sensor {i} ({name}) is {show((unknown[i] - least) * step)} s later than another sensor of its quantity, which "
                "the controller's model does not know: it may be blamed while the quantity changes. Give the controller the "
                "delays of its sensors in samples: "
                f"design(sensor_delays={[round(late) for late in samples]}), or model.with_delays."
            )
            return


UNLIKELY = 5.0
"""Standard deviations between belief and plant at the start from which on healthy sensors are blamed."""


def warn_of_start(diagram: Diagram, plant: Node, controller: Node) -> None:
    """Warn if the plant starts where the controller's belief at the start excludes it, as far as both are known."""
    sensors, block = find_sensors(diagram), controller.block
    outputs = plant.block.outputs_at_start() if isinstance(plant.block, StateSpace) else None
    rows, C = sensors.block.rows, getattr(block, "measurement_matrix", None)  # type: ignore[attr-defined]
    mean, covariance = (getattr(block, f"initial_{name}", None) for name in ("mean", "covariance"))
    if outputs is None or rows is None or C is None or mean is None or covariance is None:
        return
    modes = any(port.name == "process_mode_probability" for port in controller.outputs)
    if modes and getattr(getattr(block, "precision", None), "start_doubt", 0.0) > 0:
        return  # the learner takes the place from the first samples
    sources = [healthy_source(diagram, sensors, sensors.port("u"), j) for j in range(rows.shape[1])]
    names = [port.name for port in plant.outputs]
    if any(source is None or source[0] is not plant for source in sources):
        return
    start = rows @ outputs[[names.index(source[1].name) for source in sources if source is not None]]
    belief, noise = C @ np.asarray(mean), np.asarray(getattr(block.model, "sensor_covariance", 0.0))  # type: ignore[attr-defined]
    std = np.sqrt(np.diag(C @ np.asarray(covariance) @ C.T + noise))
    for i in range(len(rows)):
        origin = healthy_source(diagram, controller, controller.port("y"), i)
        if origin == (sensors, sensors.port("y"), i) and abs(start[i] - belief[i]) > UNLIKELY * std[i]:
            name, unit = label_of(diagram, sensors, tuple(rows[i]), i)
            unit = behind(unit)
            warn_user(
                f"The controller's belief begins with {name} = {belief[i]:.4g}{unit}, give or take {std[i]:.2g}{unit}, but the "
                f"plant begins at {start[i]:.4g}{unit}, so healthy sensors may be blamed: design the controller for the plant of "
                f"the loop, cosim.StateSpace(system, initial={brief(list(plant.block.initial))}), or give the controller "  # type: ignore[attr-defined]
                "initial_mean=..., or a larger initial_covariance=... (design: initial_spread=...)."
            )
            return


# --- Goals --------------------------------------------------------------------------------------------------------


def wrong_goals(given: int, controller: Block) -> str:
    """Return the message about a reference of another size than the goal."""
    size = next(port.size for port in controller.inputs if port.name == "goal")
    several = f"{size} elements" if size > 1 else "one element"
    names = f" ({', '.join(known)})" if (known := goal_names(controller)) else ""
    advice = (
        "Give a source for each: reference=[...], or one [[reference]] for each in a scenario file."
        if size > 1
        else "Give one source: reference=..., or [reference] in a scenario file."
    )
    course = " A course over time is one source, cosim.Table(times, values)." if given > size else ""
    return f"The goal has {several}{names}, but the reference has {given}. {advice}{course}"


def goal_names(controller: Block) -> list[str]:
    """Return the names of the sensors or states that are the elements of the goal; none if an element is neither."""
    model, goals = getattr(controller, "model", None), getattr(controller, "goal_matrix", ())
    named: list[tuple[str, Any]] = []
    if signals := getattr(model, "names", None):
        named += zip(signals.sensors, model.quantities, strict=True)  # type: ignore[union-attr]
    states = getattr(model, "state_names", ())
    named += zip(states, np.eye(len(states)), strict=True)
    found = [next((name for name, row in named if np.allclose(row, goal)), "") for goal in goals]
    return found if all(found) else []


# --- Goals that lie ahead -------------------------------------------------------------------------------------------


def samples_ahead(controller: Block) -> int:
    """Return by how many of its samples a controller's goal lies ahead, from its property ``preview`` or its FMU; else 0.

    Of a subsystem it is that of the controller inside that gets its goal.
    """
    if isinstance(controller, Subsystem):
        controller = controller.boundary
    if isinstance(controller, Boundary) and controller.inside is not None:
        ahead = {preview_of(controller.inside, controller.inside[name]) for name in controller.led}
        if len(ahead) > 1:
            raise ModelError(
                "The goal of a subsystem feeds controllers inside with different previews. Give them the same preview, or each "
                "an input of its own."
            )
        return int(ahead.pop() / controller.step) if ahead else 0
    told = getattr(controller, "traits", None)
    given = told.get("preview", 0) if isinstance(told, Mapping) else 0
    number = real(getattr(controller, "preview", given))
    return int(number) if number >= 1 and number.is_integer() else 0


def preview_time(controller: Block, step: Fraction) -> Fraction:
    """Return the seconds by which a controller's goal lies ahead; `step` is its sample time if it has none of its own."""
    own = fixed_step(controller) if isinstance(controller, FMU) else sample_time_of(controller)
    return samples_ahead(controller) * (own or step)


def preview_of(diagram: Diagram, controller: Node) -> Fraction:
    """Return the seconds by which the goal of a diagram's controller lies ahead."""
    return preview_time(controller.block, diagram.step * controller.every)


def fixed_step(fmu: FMU) -> Fraction | None:
    """Return the size of the steps of an FMU that makes steps of one size only."""
    step, capabilities = fmu.description.default_experiment.get("stepSize"), fmu.description.capabilities
    return rational_step(step) if step and not capabilities.get("canHandleVariableCommunicationStepSize") else None


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
    """Return whether an output lies ahead: the one of a `Preview`, or that of a block of later goals from outside."""
    return (isinstance(origin.node.block, Preview) and origin.port.name == AHEAD) or has_later_goals(origin.node.block)


def has_later_goals(block: Block) -> bool:
    """Return whether a source itself has the goals that a controller with a preview needs, as one of goals from outside."""
    return getattr(block, "later_goals", False) is True


def present_origin(diagram: Diagram, controller: Node, element: int) -> PortRef | None:
    """Return an output that keeps one element of the goal from lying ahead; None if it lies ahead or is constant."""
    origins = [o for o in origins_of_goal(diagram, controller, element) if not isinstance(o.node.block, Constant)]
    present = [o for o in origins if isinstance(o.node.block, Preview) and not lies_ahead(o)]
    if present or not origins or any(map(lies_ahead, origins)):
        return present[0] if present else None
    return origins[0]


def check_goals_ahead(diagram: Diagram, controller: Node) -> None:
    """Refuse a controller with a preview whose goal is a present value, or that of another later time.

    Raises
    ------
    ConnectionError
        With the output that the goal comes from, and the one to connect.
    """
    time = preview_of(diagram, controller)
    if not time:
        return
    goal = controller["goal"]
    for i in goal.elements:
        source = diagram.source_of(controller, controller.port("goal"), i)
        block = None if source is None else source[0].node.block
        if source is not None and isinstance(block, Preview) and lies_ahead(source[0]) and block.time != time:
            raise ConnectionError(
                f"{source[0].name} lies {show(Fraction(block.time))} s ahead, but the controller's preview is "
                f"{show(time)} s. Give Preview the time {show(time)}, or give its source alone as the reference, which "
                "closed_loop shifts."
            )
        origin = present_origin(diagram, controller, i)
        if origin is None:
            continue
        count, name = samples_ahead(controller.block), goal.name if len(goal) == 1 else label(goal[i])
        title = f"{name} must lie {count} samples ahead (preview={count}), but depends on {origin.name}, "
        if isinstance(origin.node.block, Preview):
            remedy = f"which is the present value. Connect '{origin.node.name}.{AHEAD}' in its place."
        else:
            remedy = (
                "whose future the loop does not have. Make that block the reference and connect 'reference.ahead', or use "
                "a controller with preview=0."
            )
        raise ConnectionError(title + remedy)
