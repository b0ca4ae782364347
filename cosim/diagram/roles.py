"""The units of a diagram's signals, and their roles in a closed loop: plain data that a result keeps and saves."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.base.invalid import invalid_values
from bayesftc.cosim.base.units import Unit, difference, shown
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.faults.base import Fault
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef, label
from bayesftc.cosim.diagram.subsystem import Boundary
from bayesftc.cosim.diagram.wiring import (
    element_name,
    elements,
    faults_before,
    faults_right_before,
    find_controller,
    find_inference,
    find_sensors,
    inferring,
    is_dead_time,
    label_of,
    passed_by,
    preview_of,
)
from bayesftc.cosim.errors import BayesFTCError, ConnectionError, ModelError, did_you_mean
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

Place = tuple[str, int]
"""A signal and the number of an element; matrices are counted row by row."""

Key = tuple[str, str]
"""Block and port."""

Units = Mapping[Key, str]


@dataclass(frozen=True)
class SensorRole:
    """One sensor: the controller's input from it, its unit, the faults in between, in their order, and its invalid values."""

    samples: Place | None
    unit: str | None
    faults: tuple[str, ...]
    invalid: tuple[float, ...] = ()


@dataclass(frozen=True)
class QuantityRole:
    """One quantity that sensors measure, or that has a goal.

    Attributes
    ----------
    name : str
        The plant's variable; of a sensor that reads several their sum, such as ``altitude + wander``, or ``sensor i`` of many.
    unit : str or None
        Its unit.
    sensors : tuple of int
        The sensors that measure it; none where only the goal is for it.
    truth : tuple of (float, Place), or None
        Weights and signals whose sum an ideal sensor reads; None if a signal is missing.
    reference : Place or None
        The source of its element of the goal; None if only a later value of it is a signal.
    belief : tuple of float, or None
        Weights of the controller's ``x_hat``; None if it is no linear function of ``x_hat``.
    goal : int or None
        The number of its element of the goal.
    """

    name: str
    unit: str | None
    sensors: tuple[int, ...]
    truth: tuple[tuple[float, Place], ...] | None
    reference: Place | None
    belief: tuple[float, ...] | None
    goal: int | None


@dataclass(frozen=True)
class InputRole:
    """One input of the plant with faults: the signal before them, the signal after them, and their names.

    ``control`` is the number of the control before the faults; None for another signal, such as a noise.
    """

    name: str
    unit: str | None
    sent: Place | None
    received: Place | None
    faults: tuple[str, ...]
    control: int | None


@dataclass(frozen=True)
class ControlRole:
    """One control: the first input of the plant that it feeds, its limits (None: unlimited), the faults in between.

    ``rate`` is the limit of its change per second, and ``dt`` the seconds between two of its values; None in files of earlier
    versions. ``sent`` is its signal; None if it is the output ``u`` of the controller.
    """

    name: str
    unit: str | None
    low: float | None
    high: float | None
    faults: tuple[str, ...]
    rate: float | None = None
    dt: float | None = None
    sent: Place | None = None


KINDS = ("fault_kinds", "fault_sizes", "actuator_kinds", "actuator_sizes", "corrected_kinds")
MATRICES = ("measurement_matrix", "goal_matrix")
"""What a controller may say beside its ports: attributes of `LoopRoles`, and the matrices from ``x_hat`` to sensors and goal."""

GOALS = "goal_names"
"""What a controller may say of its goal: the signals of the plant that the elements are for."""


@dataclass(frozen=True)
class LoopRoles:
    """The parts of a closed loop: names of blocks and signals, without any numbers of a run.

    ``fault_kinds`` and ``actuator_kinds`` name the kinds of faults that the controller can identify, from number 1 on.
    ``fault_sizes`` and ``actuator_sizes`` say for each of them what the size of a fault is in: ``"unit"`` of the sensor or the
    control, ``"noise"`` for multiples of the sensor's noise, ``"distance"`` for that from the belief in such multiples,
    ``"effect"`` for a share of the control's effect; empty: no fault.
    ``corrected_kinds`` are those of sensor faults that the controller estimates and subtracts, so that the sensor is still used.
    ``readings`` is the signal of all sensors before their faults, and ``lag`` a sentence about how far the controller is behind a
    moving reference; both are empty in files of earlier versions.
    """

    controller: str
    sensors: tuple[SensorRole, ...]
    quantities: tuple[QuantityRole, ...]
    inputs: tuple[InputRole, ...]
    controls: tuple[ControlRole, ...]
    fault_kinds: tuple[str, ...] = ()
    actuator_kinds: tuple[str, ...] = ()
    fault_sizes: tuple[str, ...] = ()
    actuator_sizes: tuple[str, ...] = ()
    readings: str = ""
    corrected_kinds: tuple[str, ...] = ()
    lag: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> LoopRoles:
        """Return the roles from the data of `to_dict`, also after JSON has turned tuples into lists."""
        parts = {"sensors": SensorRole, "quantities": QuantityRole, "inputs": InputRole, "controls": ControlRole}
        frozen = {name: _frozen(value) for name, value in plain.items() if name not in parts}
        roles: dict[str, Any] = {
            name: tuple(part(**{key: _frozen(value) for key, value in each.items()}) for each in plain[name])
            for name, part in parts.items()
        }
        return cls(**frozen, **roles)


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def find_roles(diagram: Diagram) -> LoopRoles:
    """Find the parts of a closed loop by the blocks' kinds and connections.

    Parameters
    ----------
    diagram : Diagram
        A diagram with one `Sensors` block and one controller, a block with inputs ``y`` and ``goal`` and the output ``u``:
        from `closed_loop`, or connected by hand in the same way. Or one `StateEstimator` and a law that is no such block.

    Raises
    ------
    ModelError
        If the diagram is not such a loop.
    """
    sensor_node, controller = find_sensors(diagram), find_inference(diagram)
    y = controller.port("y")
    quantities = _quantities(diagram, sensor_node, controller)
    units = {i: quantity.unit for quantity in quantities for i in quantity.sensors}
    received = {
        i: unit[0] for (name, port, i), unit in _declared(diagram).items() if (name, port) == (controller.name, "y")
    }
    units |= received
    read = sensor_node.port("y")
    blocks = {node.name: node.block for node in diagram.nodes}
    invalid = invalid_values("The controller", getattr(inferring(controller.block), "invalid", ()), y.size)
    sensors = tuple(
        SensorRole(
            _source(diagram, controller, y, i),
            shown(units[i] if i in units else read.unit_of(i) if i < read.size else None),
            tuple(fault for fault in faults_before(diagram, controller, i) if not is_dead_time(blocks[fault])),
            tuple(invalid[i][np.isfinite(invalid[i])].tolist()),
        )
        for i in range(y.size)
    )
    of_sensors = {name for sensor in sensors for name in sensor.faults}
    sent = _sent(diagram, controller)
    inputs = _inputs(diagram, {sensor_node.name, controller.name}, sent, of_sensors)
    readings = f"{sensor_node.name}.{read.name}"
    controls = _controls(diagram, controller, sent)
    told = traits(controller.block)
    kinds, lag = {name: told.get(name, ()) for name in KINDS}, told.get("lag", "")
    return LoopRoles(controller.name, sensors, quantities, inputs, controls, **kinds, readings=readings, lag=lag)


def traits(block: Block) -> dict[str, Any]:
    """Return what a controller says about itself beside its ports; an exported one says it in its FMU.

    These are the `KINDS`, ``lag``, the `MATRICES` and the `GOALS`. What has another form, in a block or a file of somebody else,
    is left out.
    A subsystem has those of the estimator or controller inside.
    """
    inside = inferring(block)
    told = getattr(inside, "traits", None)
    told = told if isinstance(told, Mapping) else {}
    given = {name: getattr(inside, name, told.get(name)) for name in (*KINDS, GOALS, "lag", *MATRICES)}
    found: dict[str, Any] = {"lag": given["lag"]} if isinstance(given["lag"], str) else {}
    sizes: dict[str, int] = {port.name: port.size for port in (*block.inputs, *block.outputs)}
    for name in (*KINDS, GOALS):
        of = given[name]
        if isinstance(of, list | tuple) and all(isinstance(each, str) for each in of):
            found[name] = tuple(of)
    if len(found.get(GOALS, ())) != sizes.get("goal"):
        found.pop(GOALS, None)
    for name, rows in zip(MATRICES, ("y", "goal"), strict=True):
        try:
            matrix = np.array(given[name], dtype=np.float64)  # None, as JSON has no NaN, becomes NaN
        except (TypeError, ValueError):
            continue
        if matrix.ndim == 2 and matrix.shape == (sizes.get(rows), sizes.get("x_hat", matrix.shape[1])):
            found[name] = matrix
    return found


def known_roles(diagram: Diagram) -> LoopRoles | None:
    """Return the roles of `find_roles`; None if the diagram is no closed loop."""
    try:
        return find_roles(diagram)
    except (BayesFTCError, RecursionError):  # a result must be saved even with a chain of hundreds of faults
        return None


def _source(diagram: Diagram, node: Node, port: Port, element: int) -> Place | None:
    """Return the source of one element of an input."""
    source = diagram.source_of(node, port, element)
    return None if source is None else (f"{source[0].node.name}.{source[0].port.name}", source[1])


def _sender(diagram: Diagram, node: Node, port: Port, element: int) -> Place | None:
    """Return the source of one element of an input before what other sources add to it."""
    source = diagram.source_of(node, port, element)
    if source is not None and (passed := passed_by(diagram, source[0].node)) is not None:
        return _sender(diagram, source[0].node, source[0].node.port("u"), passed)
    return _source(diagram, node, port, element)


def _reference(diagram: Diagram, controller: Node, goal: int) -> Place | None:
    """Return the source of one element of the goal; of a goal that lies ahead, the present one.

    None if the goal lies ahead and comes from a block that does not have its present value, such as a `RateLimiter`.
    """
    source = diagram.source_of(controller, controller.port("goal"), goal)
    if source is None:
        return None
    node, block = source[0].node, source[0].node.block
    if isinstance(block, Preview):
        return f"{node.name}.y", source[1]
    if preview_of(diagram, controller) and not isinstance(block, Constant):
        return None
    return f"{node.name}.{source[0].port.name}", source[1]


def _sent(diagram: Diagram, controller: Node) -> list[Place | None]:
    """Return the signal of each control: an output of the controller, or what an estimator receives from the law."""
    if (u := _port(controller.outputs, "u")) is not None:
        return [(f"{controller.name}.u", j) for j in range(u.size)]
    u = _port(controller.inputs, "u")
    return [] if u is None else [_source(diagram, controller, u, j) for j in range(u.size)]


def _port(ports: Iterable[Port], name: str) -> Port | None:
    return next((port for port in ports if port.name == name), None)


def _inputs(
    diagram: Diagram, others: Container[str], controls: Sequence[Place | None], of_sensors: Container[str]
) -> tuple[InputRole, ...]:
    """Return the inputs that are fed through faults, except for those of the named blocks, and faults of sensors.

    A block between the faults of sensors and the controller, such as a filter, has an input fed through faults, but these are
    the sensors' ones.
    """
    roles = []
    for node, port, i in elements(diagram, others):
        faults = faults_right_before(diagram, node, port, i)
        if chain := [(fault, element) for fault, element in faults if fault.name not in of_sensors]:
            first, element = chain[0]
            sent = _sender(diagram, first, first.port("u"), element)
            received = _source(diagram, node, port, i)
            control = controls.index(sent) if sent in controls and sent else None
            names = _faults(chain)
            if not names:
                continue
            roles.append(InputRole(element_name(port, i), shown(port.unit), sent, received, names, control))
    return tuple(roles)


def _faults(chain: Iterable[tuple[Node, int]]) -> tuple[str, ...]:
    """Return the names of faults between controller and plant, without dead times, which belong to the plant."""
    return tuple(fault.name for fault, _ in chain if not is_dead_time(fault.block))


def _controls(diagram: Diagram, controller: Node, controls_sent: Sequence[Place | None]) -> tuple[ControlRole, ...]:
    count = len(controls_sent)
    own = f"{controller.name}.u"
    low, high, rate = (_limits(controller, name, count) for name in ("u_min", "u_max", "u_rate"))
    targets: dict[int, tuple[str, str | None, tuple[str, ...]]] = {}
    # The input of the plant, if there is one behind a sum or a limit, and else that of the last block.
    for node, port, i in sorted(
        elements(diagram, {controller.name}), key=lambda each: each[1].name in each[0].block.one_unit
    ):
        for sent, faults in _ways(diagram, node, port, i, set()):
            if sent in controls_sent:
                targets.setdefault(controls_sent.index(sent), (element_name(port, i), shown(port.unit), faults))
    controls = []
    for j in range(count):
        name, unit, faults = targets.get(j, (f"control {j}", None, ()))
        place = controls_sent[j]
        signal = None if place is None or place[0] == own else place
        period = float(diagram.step * controller.every)
        controls.append(ControlRole(name, unit, low[j], high[j], faults, rate[j], period, signal))
    return tuple(controls)


def _ways(
    diagram: Diagram, node: Node, port: Port, i: int, seen: set[Element]
) -> Iterator[tuple[Place, tuple[str, ...]]]:
    """Yield each source of one element of an input, also behind blocks that keep the unit, with the faults on the way."""
    chain = faults_right_before(diagram, node, port, i)
    begin = (chain[0][0], chain[0][0].port("u"), chain[0][1]) if chain else (node, port, i)
    origin = diagram.source_of(*begin)
    if origin is None:
        return
    source, element = origin
    place, faults = (f"{source.node.name}.{source.port.name}", element), _faults(chain)
    yield place, faults
    one_unit = () if isinstance(source.node.block, Sensors) else source.node.block.one_unit
    for before in source.node.inputs if source.port.name in one_unit else ():
        elementwise = before.size == source.port.size
        for j in (element,) if elementwise else range(before.size):
            step = (source.node.name, before.name, j)
            if before.name in one_unit and step not in seen:
                seen.add(step)
                for earlier, more in _ways(diagram, source.node, before, j, seen):
                    yield earlier, (*more, *faults)


def _limits(controller: Node, name: str, count: int) -> list[float | None]:
    """Return a limit of each control; None if there is none or the controller has no such setting."""
    limits = getattr(controller.block, name, None)
    if limits is None:
        return [None] * count
    values = np.broadcast_to(np.asarray(limits, dtype=np.float64), (count,))
    return [float(value) if np.isfinite(value) else None for value in values]


def _quantities(diagram: Diagram, sensor_node: Node, controller: Node) -> tuple[QuantityRole, ...]:
    block: Any = sensor_node.block
    rows = block.rows
    if rows is None:  # nonlinear measurements have no roles
        return ()
    # A controller may have matrices from its estimate x_hat to the sensors (a row of NaN: not linear) and to its goal.
    C: Floats | None
    G: Floats | None
    told = traits(controller.block)
    C, G = (told.get(name) for name in MATRICES)
    estimates = any(port.name == "x_hat" for port in controller.outputs)
    groups: dict[tuple[float, ...], list[int]] = {}
    for i, row in enumerate(rows):
        groups.setdefault(tuple(map(float, row)), []).append(i)
    inputs = [_source(diagram, sensor_node, sensor_node.port("u"), j) for j in range(block.signals)]
    given = _port(controller.inputs, "goal")
    goals = 0 if given is None else given.size
    named = getattr(controller.block, "goals", ())
    named = named if isinstance(controller.block, Boundary) else ()
    titles = told.get(GOALS, ())
    roles = []
    for number, (row, members) in enumerate(groups.items()):
        used = [(weight, place) for weight, place in zip(row, inputs, strict=True) if weight and place is not None]
        truth = tuple(used) if used and len(used) == np.count_nonzero(row) else None
        name, unit = label_of(diagram, sensor_node, row, members[0])
        # Sensors of one quantity have equal rows, but the controller may have a nonlinear model of one of them.
        weights = next((C[i] for i in members if np.isfinite(C[i]).all()), None) if C is not None else None
        goal = number if goals == len(groups) and (C is None or G is None) else None  # without matrices: in order
        if weights is not None and G is not None:
            goal = next((g for g, row_of_goal in enumerate(G) if np.array_equal(row_of_goal, weights)), None)
        if names := named or (titles if G is None else ()):
            goal = names.index(name) if name in names else None
        reference = None if goal is None else _reference(diagram, controller, goal)
        belief = tuple(map(float, weights)) if weights is not None and estimates else None
        roles.append(QuantityRole(name, shown(unit), tuple(members), truth, reference, belief, goal))
    known = [role.name for role in roles]
    for name in named:
        if name not in known:
            raise ModelError(f"The subsystem {controller.name!r} has a goal for {name!r}; {did_you_mean(name, known)}")
    for goal, name in enumerate(titles):
        if any(role.goal == goal or role.name == name for role in roles):
            continue
        place, unit = _output(_before(diagram, sensor_node, controller), name)
        truth = None if place is None else ((1.0, place),)
        belief = tuple(map(float, G[goal])) if G is not None and estimates else None
        roles.append(QuantityRole(name, shown(unit), (), truth, _reference(diagram, controller, goal), belief, goal))
    return tuple(roles)


def _output(nodes: Iterable[Node], name: str) -> tuple[Place | None, str | None]:
    """Return the first output of some blocks with this name, and its unit; nothing if there is none."""
    for node in nodes:
        for port in node.block.outputs:
            for i in range(port.size):
                if element_name(port, i) == name:
                    return (f"{node.name}.{port.name}", i), port.unit_of(i)
    return None, None


def _before(diagram: Diagram, sensors: Node, controller: Node) -> list[Node]:
    """Return the blocks on whose outputs the sensors depend, the nearest first, without the controller."""
    found = [sensors]
    for node in found:
        for port in node.inputs:
            for i in range(port.size):
                source = diagram.source_of(node, port, i)
                if source is not None and source[0].node not in (*found, controller):
                    found.append(source[0].node)
    return found[1:]


def units_of(diagram: Diagram) -> Units:
    """Return the unit of each port that declares one, or whose elements are connected to ports of one unit.

    Units are passed on along connections, element by element, and through blocks whose ports share one unit
    (`Block.one_unit`), such as a fault or a delay. If ports of different units are connected, the unit is not known.
    """
    return _of_ports(diagram, {place: unit for place, (unit, _) in _declared(diagram).items()}, {})


def units_of_settings(diagram: Diagram, at: Mapping[str, int] | None = None) -> Units:
    """Return the units of ports in which settings of their blocks are given.

    They are those of `units_of`, but a fault is in the unit of its own sensor, and a source of a goal without a unit in that of
    the quantity.

    Parameters
    ----------
    diagram : Diagram
        The diagram.
    at : mapping of str to int, optional
        For a block, the element of its ports for which a setting is, such as 2 for ``sensors.std[2]``.
    """
    goals: dict[Element, set[str | None]] = {}
    roles = known_roles(diagram)
    for quantity in roles.quantities if roles is not None else ():
        if quantity.reference is not None:
            goals.setdefault(_element(quantity.reference), set()).add(quantity.unit)
    known = {place: unit for place, units in goals.items() if len(units) == 1 and (unit := next(iter(units)))}
    known |= {place: unit for place, (unit, _) in _declared(diagram).items()}
    faults = {node.name: node.block.sensor for node in diagram.nodes if isinstance(node.block, Fault)}
    return _of_ports(diagram, known, faults | dict(at or {}))


def _of_ports(diagram: Diagram, known: UnitsOfElements, at: Mapping[str, int]) -> Units:
    """Return the unit of each port whose elements have one unit; of some blocks that of one element."""
    result: dict[Key, str] = {}
    for node in diagram.nodes:
        for port in (*node.block.inputs, *node.block.outputs):
            i = at.get(node.name, port.size)
            units = {known.get((node.name, port.name, j)) for j in ([i] if i < port.size else range(port.size))}
            unit = port.unit or (units.pop() if len(units) == 1 else None)
            if unit:
                result[node.name, port.name] = unit
    return result


Element = tuple[str, str, int]
"""Block, port and element."""

UnitsOfElements = Mapping[Element, str]


def _declared(diagram: Diagram) -> dict[Element, tuple[str, Unit | None]]:
    """Return the unit of each element of a port, and its definition by an FMU: declared by the port, or passed on to it."""
    origin: dict[Element, Element] = {}
    units: dict[Element, tuple[str, Unit | None]] = {}

    def first(element: Element) -> Element:
        while (before := origin.setdefault(element, element)) != element:
            origin[element] = origin[before]  # half the way next time
            element = before
        return element

    def join(one: Element, other: Element) -> None:
        origin[first(one)] = first(other)

    for node in diagram.nodes:
        for port in (*node.block.inputs, *node.block.outputs):
            for i in range(port.size):
                if unit := port.unit_of(i):
                    units[node.name, port.name, i] = unit, port.meaning
        if isinstance(node.block, Sensors):
            for i, j in enumerate(node.block.reads):
                if j is not None:
                    join((node.name, "u", j), (node.name, "y", i))
            continue
        shared = [node.port(name) for name in node.block.one_unit]
        for port in shared[1:]:
            same = port.size == shared[0].size
            for i in range(max(port.size, shared[0].size)):  # element by element; else one unit for all
                one, other = (i, i) if same else (min(i, shared[0].size - 1), min(i, port.size - 1))
                join((node.name, shared[0].name, one), (node.name, port.name, other))
    for place, (source, i) in diagram.connections():
        join(place, (source.node.name, source.port.name, i))
    groups: dict[Element, dict[str, Unit | None]] = {}
    for element, (unit, meaning) in units.items():
        groups.setdefault(first(element), {})[unit] = meaning
    single = {root: next(iter(group.items())) for root, group in groups.items() if len(group) == 1}
    return {element: single[first(element)] for element in [*origin] if first(element) in single} | units


def check_units_of_goals(diagram: Diagram) -> None:
    """Refuse a reference in another unit than the quantity that it is the goal of; what is no closed loop has no goals.

    Raises
    ------
    ConnectionError
        With the two units, and the block that converts one into the other.
    """
    try:
        controller = find_controller(diagram)
    except ModelError:
        return
    known, goal = _declared(diagram), controller.port("goal")
    sources = [diagram.source_of(controller, goal, i) for i in range(goal.size)]
    given = [s and known.get((s[0].node.name, s[0].port.name, s[1])) for s in sources]
    # Without any unit, as in most campaigns, the quantities need not be found.
    roles = known_roles(diagram) if any(given) else None
    for quantity in roles.quantities if roles is not None else ():
        k = quantity.goal
        measured = known.get(_where(quantity, controller))
        if k is None or k >= goal.size or measured is None or not (source := sources[k]) or not (of := given[k]):
            continue
        if gap := difference(of[0], measured[0], of[1], measured[1]):
            origin = PortRef(source[0].node, source[0].port, "output", (source[1],))
            target = controller["goal"] if goal.size == 1 else controller["goal"][k]
            raise ConnectionError(
                f"{label(origin)} is in {of[0]}, but {target.name}, the goal of {quantity.name}, is in {measured[0]}{gap}"
            )


def _where(quantity: QuantityRole, controller: Node) -> Element:
    """Return where the unit of a quantity is known: where the controller receives it, else at the plant.

    A block before the controller may have converted the samples.
    """
    if quantity.sensors:
        return controller.name, "y", quantity.sensors[0]
    return _element(quantity.truth[0][1] if quantity.truth else (".", 0))


def _element(place: Place) -> Element:
    block, _, port = place[0].rpartition(".")
    return block, port, place[1]


def units_of_elements(diagram: Diagram) -> UnitsOfElements:
    """Return the unit of each element of a port, as `units_of` does, and of the elements of the controller's goal.

    A source of the goal has no unit, so that no connection passes one on.
    """
    roles = known_roles(diagram)
    goals = (
        {}
        if roles is None
        else {(roles.controller, "goal", q.goal): q.unit for q in roles.quantities if q.goal is not None and q.unit}
    )
    return goals | {place: unit for place, (unit, _) in _declared(diagram).items()}


__all__ = [
    "ControlRole",
    "InputRole",
    "LoopRoles",
    "Place",
    "QuantityRole",
    "SensorRole",
    "Units",
    "UnitsOfElements",
    "check_units_of_goals",
    "find_roles",
    "known_roles",
    "units_of",
    "units_of_elements",
    "units_of_settings",
]
