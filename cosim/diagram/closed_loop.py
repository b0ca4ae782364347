"""Make the diagram of a closed loop in one call: reference, controller, plant, sensors, and all faults."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from numbers import Real
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.arguments import with_named_arguments
from bayesftc.cosim.base.invalid import invalid_values
from bayesftc.cosim.base.numbers import counted, real, with_article
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import Block, sample_time_of
from bayesftc.cosim.blocks.faults.kinds import Dropout, Fault, RandomFaults
from bayesftc.cosim.blocks.faults.without_effect import (
    unconnected,
    unread_sensors,
    unread_variables,
    warn_without_effect,
)
from bayesftc.cosim.blocks.linear_system import is_system
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.roles import check_units_of_goals
from bayesftc.cosim.diagram.subsystem import outermost, port_named
from bayesftc.cosim.diagram.wiring import (
    check_goals_ahead,
    fixed_step,
    has_later_goals,
    preview_time,
    warn_of_held_inputs,
    warn_of_late_sensors,
    warn_of_other_signals,
    warn_of_rounded_delays,
    warn_of_start,
    warn_of_turns,
    with_rates,
    wrong_goals,
)
from bayesftc.cosim.errors import (
    ConnectionError,
    ModelError,
    StepSizeError,
    UnconnectedInputError,
    UnknownNameError,
    brief,
    did_you_mean,
)
from bayesftc.cosim.fmi.fmu import FMU

Names = str | Sequence[str]
Connection = tuple[Names, str]
"""The names of one or several sources, and of the input that they feed."""


@with_named_arguments
def closed_loop(
    plant: Any,
    controller: Block,
    *,
    control: Names,
    measured: Names,
    reference: Block | float | Sequence[Block | float],
    sensors: Sensors | None = None,
    faults: Fault | Sequence[Fault] = (),
    input_faults: Mapping[str, Fault | Sequence[Fault]] | None = None,
    noise: Mapping[str, Block] | None = None,
    monitors: Mapping[str, Block] | None = None,
    blocks: Mapping[str, Block | tuple[Block, int]] | None = None,
    connections: Sequence[Connection] = (),
    dt: float | str | Fraction | None = None,
) -> Diagram:
    """Return the diagram of a plant with controller, sensors, and faults of sensors and actuators.

    The signals are ``reference -> controller.goal``, ``plant -> sensors -> faults -> controller.y``, ``controller.u ->
    input_faults -> plant``, and ``noise -> input_faults -> plant`` for further inputs.

    The blocks are named ``plant``, ``controller``, ``sensors``, ``reference`` (``reference_0``, ... if there are several) and
    ``<input>_noise``. Sensor faults have names such as ``freeze_0`` (a second one of the same kind and sensor ``freeze_0_2``),
    faults of an input such as ``<input>_freeze_0`` (``u_1_freeze_0`` for ``u[1]``). Monitors have the given names.

    Parameters
    ----------
    plant : Block, or system of python-control
        An `FMU`, a `StateSpace`, or any block. A system of python-control becomes a `StateSpace`.
    controller : Block, or system of python-control
        A block with inputs ``y`` and ``goal`` and the output ``u``, or an exported controller: ``FMU("controller.fmu")``. One of
        FMI 2.0, and a system of python-control, gets ``arrays=True``, so that its ``y[0]`` and ``y[1]`` are one port.
    control : str or sequence of str
        The plant's inputs for ``u``, in its order: vectors as a whole, or elements of them (``"u[1]"``).
    measured : str or sequence of str
        The plant's outputs for the sensors: vectors as a whole, or elements of them.
    reference : Block, float or a sequence of them
        The goal: a source, a constant, or one for each element of the controller's ``goal``. If the property ``preview``
        of the controller is n > 0, each source becomes a `Preview`. The same holds for the FMU of such a controller. The
        output ``y`` of the `Preview` is the present goal. The controller gets the output ``ahead``: the goal n samples of
        the controller later. In `connections`, blocks between reference and controller then get ``"reference.ahead"``.
    sensors : Sensors, optional
        By default one perfect sensor for each measured output. The controller gets the ``invalid`` values of the sensors.
        Its learner expects no sample from a slow sensor (``every``) in the steps between the samples of that sensor.
    faults : Fault or sequence of Fault
        Sensor faults, applied to the samples one after the other.
    input_faults : mapping of plant input to Fault or sequence of Fault, optional
        Actuator faults if the input is a control, else process faults. They change the signal before it reaches the plant.
        The controller still computes with the control that it sent. At an input with neither control nor noise, the fault changes
        the start value of the input.
    noise : mapping of plant input to Block, optional
        Sources for further inputs of the plant.
    monitors : mapping of name to Block, optional
        Blocks that monitor the controller. Each input of a monitor gets the controller's output of the same name. Inputs called
        ``y`` and ``goal`` get the same signals as these inputs of the controller. An input with a start value needs no signal.
    blocks : mapping of name to Block, optional
        Further blocks, or pairs of a block and its `every` (see `Diagram.add`).
    connections : sequence of (str or sequence of str, str)
        Connections of the further blocks, from outputs to an input: ``("controller.u", "limiter.u")``. They replace the loop's
        own connection to the same input, as ``("limiter.y", "plant.force")`` does. A source may also be
        the name of an input. It then stands for the signal that the loop itself feeds to this input, after the input's faults.
    dt : float, str or Fraction, optional
        Base step in seconds; by default the controller's sample time. With a smaller one, the controller (or a discrete plant)
        runs at every n-th step; its sample time must be a whole multiple of `dt`. Sensors, faults and sources run at the base
        step.

    Returns
    -------
    Diagram
        The built diagram: ``closed_loop(...).simulate(20.0, seed=1)``.

    Warns
    -----
    UserWarning
        If a sensor, a measured variable or a further block is not used. Also if the controller's belief excludes the
        initial state of a `StateSpace`, and the controller's learner does not expect such a start (``start_doubt`` of
        `SwitchingPrecision`).

    Raises
    ------
    StepSizeError
        If `dt` is missing and the controller has no sample time, or if `dt` does not divide a sample time.
    ConnectionError, UnknownNameError
        If the parts do not fit together.
    ModelError
        If one of them is of the wrong kind.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    >>> loop = cosim.closed_loop(
    ...     plant, controllers.LQGController(model, goal_covariance=0.01), control="u", measured="y",
    ...     sensors=cosim.Sensors(2, 0.2), faults=cosim.Freeze(sensor=0, start=5.0), reference=1.0,
    ... )
    >>> run = loop.simulate(10.0, seed=1, engine="interpreted")
    >>> round(float(run["plant.y"][50:].mean()), 1), float(run["freeze_0.active"].mean().round(2))
    (1.0, 0.5)
    """
    plant = StateSpace(plant) if is_system(plant) else plant
    controller = with_arrays(StateSpace(controller) if is_system(controller) else controller)
    _check_kinds(plant, controller, sensors, noise)
    diagram = Diagram(base_step(controller, dt))
    diagram.defer_units()  # a block that converts them may replace a connection of the loop
    goals = [diagram.add(each, name)[output] for name, each, output in _references(reference, controller, diagram.step)]
    chains = [faults, *(input_faults.values() if isinstance(input_faults, Mapping) else ())]
    plant = plant.watching([*_names(measured, "measured"), *_compared("plant", chains), *_taken("plant", connections)])
    node = diagram.add(plant, "plant", every=_every(plant, "plant", diagram.step))
    outputs = [_port(node, name, "measured") for name in _names(measured, "measured")]
    inputs = {name: _port(node, name, "control") for name in _names(control, "control")}
    sensors = _fitted(sensors, sum(map(len, outputs)))
    warn_of_turns(sensors)
    controller = with_invalid(controller, sensors)
    sensor_node = diagram.add(sensors, "sensors")
    diagram.connect(outputs, sensor_node["u"])
    samples = _through(diagram, sensor_node["y"], _chain(faults))
    controller_node = diagram.add(controller, "controller", every=_every(controller, "controller", diagram.step))
    if len(controller_node["y"]) != len(sensors):
        raise ConnectionError(
            f"The controller has {counted(len(controller_node['y']), 'sensor')}, but the loop has {len(sensors)}. Give the loop "
            f"sensors=cosim.Sensors(count={_count_for(controller, sum(map(len, outputs)))}, std=...), or the controller's model "
            "a row of C, or a modality, for each sensor of the loop."
        )
    diagram.connect(samples, controller_node["y"])
    if sum(map(len, goals)) != len(controller_node["goal"]):
        raise ConnectionError(wrong_goals(sum(map(len, goals)), controller))
    diagram.connect(goals, controller_node["goal"])
    if len(controller_node["u"]) != sum(map(len, inputs.values())):
        raise ConnectionError(
            f"The controller has {counted(len(controller_node['u']), 'control')}, but control= names "
            f"{sum(map(len, inputs.values()))} of "
            f"the plant's inputs: {', '.join(inputs)}."
        )
    if not isinstance(input_faults, Mapping | None):
        raise ModelError(
            f"input_faults is {brief(input_faults)}; it must be a mapping from inputs of the plant to faults: "
            f"input_faults={{{next(iter(inputs))!r}: GainFault(factor=0.5)}}."
        )
    remaining, first = dict(input_faults or {}), 0
    for name, target in inputs.items():
        _feed(diagram, controller_node["u"][first : first + len(target)], target, remaining.pop(name, ()), name)
        first += len(target)
    controller_inputs = {"y": samples, "goal": goals}
    for name, monitor in (monitors or {}).items():
        _watch(diagram, controller_node, diagram.add(monitor, name, controller_node.every), controller_inputs)
    for name, source in (noise or {}).items():
        if name in inputs:
            raise ConnectionError(
                f"noise names {name!r}, which has a control already. To add a disturbance to the control, put a sum before the "
                "plant: closed_loop(blocks={'disturbance': cosim.Gaussian(std=0.1), 'total': cosim.Sum()}, "
                f"connections=[(['plant.{name}', 'disturbance.y'], 'total.u'), ('total.y', 'plant.{name}')]). On the left of a "
                f"connection, 'plant.{name}' is what the plant got before: the control."
            )
        _check_source(f"noise[{name!r}]", source)
        target = _input(node, name, "noise")
        _feed(diagram, diagram.add(source, noise_block(name))["y"], target, remaining.pop(name, ()), name)
    for name, chain in remaining.items():
        target = _input(node, name, "input_faults")
        _feed(diagram, _start_value(diagram, target, name), target, chain, name)
    warn_of_other_signals(diagram, node, controller_node)
    _extend(diagram, blocks or {}, connections)
    diagram.check_units()
    warn_of_held_inputs(diagram, node, controller_node)
    warn_of_start(diagram, node, controller_node)
    warn_of_late_sensors(diagram, controller_node)
    check_goals_ahead(diagram, controller_node)
    check_units_of_goals(diagram)
    unread = _unread(sensors, controller, [port.name for port in outputs])
    warn_without_effect([*unread, *_unconnected(diagram, blocks or {})])
    loop = with_rates(diagram.build())
    warn_of_rounded_delays(loop)
    return loop


def check_parts(
    plant: Block,
    *,
    control: Names,
    measured: Names,
    sensors: Sensors | None = None,
    faults: Sequence[Fault] = (),
    noise: Mapping[str, Block] | None = None,
    input_faults: Mapping[str, Sequence[Fault]] | None = None,
) -> None:
    """Refuse parts that `closed_loop` would refuse whatever the controller; see there for them.

    Raises
    ------
    UnknownNameError, ConnectionError, ModelError
        As `closed_loop`.
    """
    diagram = Diagram(1)
    names = _names(measured, "measured")
    node = diagram.add(plant.watching(names), "plant")
    width = sum(len(_port(node, name, "measured")) for name in names)
    sensor_node = diagram.add(_fitted(sensors, width), "sensors")
    _through(diagram, sensor_node["y"], faults)
    for name in _names(control, "control"):
        _port(node, name, "control")
    for name in noise or {}:
        _input(node, name, "noise")
    for name, chain in (input_faults or {}).items():
        _check_input_faults(chain, len(_input(node, name, "input_faults")), name)


def _count_for(controller: Block, signals: int) -> int | tuple[int, ...]:
    """Return the count of `Sensors` for a controller of several quantities: the number of each, if they are not in turn."""
    count = next(port.size for port in controller.inputs if port.name == "y")
    groups = getattr(getattr(controller, "model", None), "alike", ())
    in_turn = tuple(tuple(range(i, count, signals)) for i in range(signals))
    return count if len(groups) != signals or groups == in_turn else tuple(len(group) for group in groups)


def _unread(sensors: Sensors, controller: Block, measured: Sequence[str]) -> Iterator[str]:
    yield from unread_variables("The matrix of sensors=", sensors.matrix, measured)
    C = getattr(controller, "measurement_matrix", None)
    if C is not None:
        yield from unread_sensors("C of the controller's model", C)


def _unconnected(diagram: Diagram, blocks: Mapping[str, Any]) -> Iterator[str]:
    ends = {name for place, (origin, _) in diagram.connections() for name in (place[0], origin.node.name)}
    for name in sorted(blocks.keys() - ends):
        yield unconnected(f"The block {name!r}", "Connect it with connections=[...]")


def base_step(controller: Block, dt: float | str | Fraction | None) -> float | str | Fraction:
    """Return the base step of a loop: the given one, by default the controller's sample time.

    Raises
    ------
    StepSizeError
        If there is neither.
    """
    step = _sample_time(controller) if dt is None else dt
    if step is None:
        raise StepSizeError(f"{type(controller).__name__} has no sample time; give closed_loop(dt=...) in seconds.")
    return step


def with_arrays(controller: Block) -> Block:
    """Return a controller with array ports: some FMUs, and python-control, have numbers in their place, ``y[0]``, ``y[1]``."""
    if not isinstance(controller, FMU | StateSpace) or controller.arrays:
        return controller
    scalars, gathered = controller, replace(controller, arrays=True)
    return gathered if len(_missing_ports(gathered)) < len(_missing_ports(scalars)) else scalars


def _sample_time(block: Block) -> Fraction | None:
    """Return the sample time of a block; of a controller in an FMU, which makes steps of one size only, that size."""
    fixed = fixed_step(block) if isinstance(block, FMU) and block.timing == "sampled" else None
    return fixed or sample_time_of(block)


def _check_kinds(plant: object, controller: object, sensors: object, noise: object) -> None:
    """Refuse arguments that are not blocks, and a controller without the ports of one."""
    for role, given in (("plant", plant), ("controller", controller)):
        if not isinstance(given, Block):
            raise ModelError(
                f"The {role} must be a block, not {brief(given)}; use cosim.FMU(path) for an FMU, cosim.StateSpace(system) for a "
                "system of python-control, or write a block (docs/reference/write-a-block.md)."
            )
    assert isinstance(controller, Block)
    for kind, name in _missing_ports(controller)[:1]:
        named = "Name those of a system of python-control: control.ss(..., inputs=['y[0]', 'y[1]', 'goal'], outputs=['u']). "
        raise UnknownNameError(
            f"The controller, of the kind {type(controller).__name__}, has no {kind} {name!r}; a controller has the "
            "inputs y and goal and the output u. Check whether plant and controller are exchanged. "
            f"{named * isinstance(controller, StateSpace)}Connect blocks with other ports in a cosim.Diagram."
        )
    if not isinstance(sensors, Sensors | None):
        raise ModelError(
            f"sensors is {brief(sensors)}; it must be one Sensors block, such as cosim.Sensors(count=2, std=0.01), or, for two "
            "sensors of the first measured output and one of the second, cosim.Sensors(count=(2, 1), std=(0.01, 0.1))."
        )
    if not isinstance(noise, Mapping | None):
        raise ModelError(
            f"noise is {brief(noise)}; it must be a mapping from inputs of the plant to sources: "
            "noise={'load': cosim.Gaussian(std=0.1)}."
        )


def _missing_ports(controller: Block) -> list[tuple[str, str]]:
    """Return the ports of a controller that a block lacks: pairs of side and name."""
    sides = {"input": {port.name for port in controller.inputs}, "output": {port.name for port in controller.outputs}}
    return [
        (side, name) for side, name in (("input", "y"), ("input", "goal"), ("output", "u")) if name not in sides[side]
    ]


def _check_source(what: str, given: object) -> None:
    if not isinstance(given, Block):
        raise ModelError(
            f"{what} is {brief(given)}. Only blocks can be added to a diagram: give a source, such as cosim.Constant(1.0), "
            "cosim.Gaussian(std=0.1), or cosim.Table(times, values) for a course over time."
        )


MOST_FAULTS = 1000
"""Largest number of faults on one signal; each is a separate block."""


def check_count(faults: Sequence[object]) -> None:
    """Refuse more faults than a loop can have.

    Raises
    ------
    ModelError
        If there are too many.
    """
    if len(faults) > MOST_FAULTS:
        raise ModelError(
            f"There are {len(faults)} faults, but a signal has at most {MOST_FAULTS}; use RandomFaults for any number of them."
        )


def fault_blocks(faults: Sequence[Fault], of: str = "") -> list[str]:
    """Return the names of the blocks of a signal's faults; for an input of the plant they begin with the name of that input.

    Of several faults without names, of one kind and channel, the second one is ``freeze_0_2``, the third one ``freeze_0_3``.
    """
    names: list[str] = []
    given = {fault.name for fault in faults}
    for fault in faults:
        first = name = fault.name or (f"{_plain(of)}_" if of else "") + fault.default_name
        number = 1
        while not fault.name and (name in names or name in given):
            number += 1
            name = f"{first}_{number}"
        names.append(name)
    return names


def noise_block(name: str) -> str:
    """Return the name of the noise block of an input."""
    return f"{_plain(name)}_noise"


def _compared(block: str, chains: Sequence[Fault | Sequence[Fault]]) -> list[str]:
    """Return the variables of a block on which faults have conditions."""
    signals = [signal for faults in chains for fault in _chain(faults) for signal in fault.named_sources.values()]
    return [signal.removeprefix(f"{block}.") for signal in signals if signal.startswith(f"{block}.")]


def _taken(block: str, connections: Sequence[Connection]) -> list[str]:
    """Return the variables of a block that connections take."""
    sources = [source for names, _ in connections for source in ([names] if isinstance(names, str) else names)]
    return [source.removeprefix(f"{block}.") for source in sources if source.startswith(f"{block}.")]


def _chain(faults: Fault | Sequence[Fault]) -> Sequence[Fault]:
    """Return the faults of one signal as a sequence, after a check that they are faults and not too many."""
    chain = [faults] if isinstance(faults, Fault | str) else faults
    wrong = [each for each in chain if not isinstance(each, Fault)] if isinstance(chain, Sequence) else [chain]
    if wrong:
        raise ModelError(
            f"faults must contain only faults, such as Freeze(sensor=0, start=6.0), not {brief(wrong[0])}."
        )
    check_count(chain)
    return chain


def _through(diagram: Diagram, signal: PortRef, faults: Sequence[Fault], of: str = "") -> PortRef:
    """Connect a signal to a chain of faults, of sensors or of an input; return the output of the last."""
    for fault, name in zip(faults, fault_blocks(faults, of), strict=True):
        modifier = diagram.add(replace(fault, channels=len(signal)), name)
        diagram.connect(signal, modifier["u"])
        signal = modifier["y"]
    return signal


def _feed(diagram: Diagram, signal: PortRef, target: PortRef, faults: Fault | Sequence[Fault], name: str) -> None:
    """Connect a signal to an input of the plant, through the faults of that input."""
    chain = _chain(faults)
    _check_input_faults(chain, len(signal), name)
    diagram.connect(_through(diagram, signal, chain, name), target)


def _check_input_faults(chain: Sequence[Fault], size: int, name: str) -> None:
    """Refuse faults that an input of that size cannot have."""
    for fault in chain:
        kinds = fault.kinds if isinstance(fault, RandomFaults) else (fault,)
        if any(isinstance(kind, Dropout) for kind in kinds):
            raise ModelError(
                f"input_faults has a Dropout for {name!r}, but inputs of a plant must be numbers; use Stuck(at=0.0) for an "
                "actuator that is off, or Freeze() for one that holds its last value."
            )
        if isinstance(fault, Fault) and fault.sensor >= size:
            raise ModelError(
                f"input_faults has {with_article(type(fault).__name__)} with sensor={fault.sensor} for {name!r}, which has "
                f"{size} element{'s' if size > 1 else ''}, numbered from 0; leave sensor out where there is one."
            )


def _plain(name: str) -> str:
    """Return an input's name as part of a block's name: ``u_1`` for the element ``u[1]``."""
    return re.sub(r"\W+", "_", name).strip("_") if name.endswith("]") else name


def _start_value(diagram: Diagram, target: PortRef, name: str) -> PortRef:
    """Return a source of the start value of an unconnected input of the plant."""
    if target.direction == "output":
        raise ConnectionError(f"input_faults names {target.name}, which is an output; name an input of the plant.")
    if target.port.default is None or len(target) > 1:
        raise UnconnectedInputError(
            f"input_faults names {target.name}, which has no control, no noise and no start value; give it a source, such as "
            f"closed_loop(noise={{{name!r}: cosim.Constant(0.0)}})."
        )
    start = np.broadcast_to(target.port.default, target.port.shape).ravel()[target.elements[0]]  # type: ignore[arg-type]
    return diagram.add(Constant(float(start)), f"{_plain(name)}_start")["y"]


def _watch(diagram: Diagram, controller_node: Node, monitor: Node, inputs: Mapping[str, Any]) -> None:
    """Connect a monitor's inputs to the controller's outputs of the same names, or to the sources of its inputs."""
    outputs = {port.name for port in controller_node.block.outputs}
    for port in monitor.block.inputs:
        if port.name not in outputs | inputs.keys():
            if port.default is not None or port.draw is not None:
                continue
            raise UnknownNameError(
                f"The monitor {monitor.name!r} has the input {port.name!r}, which is no output of the controller; "
                f"{did_you_mean(port.name, outputs | inputs.keys())}"
            )
        diagram.connect(controller_node[port.name] if port.name in outputs else inputs[port.name], monitor[port.name])


def _extend(
    diagram: Diagram, blocks: Mapping[str, Block | tuple[Block, int]], connections: Sequence[Connection]
) -> None:
    """Add further blocks, and their connections in place of those of the loop to the same inputs."""
    outside = {node.name for node in outermost(diagram)}
    own = {place: origin for place, origin in diagram.connections() if place[0] in outside}
    faults = [node for node in diagram.nodes if isinstance(node.block, Fault)]
    for name, given in blocks.items():
        block, every = given if isinstance(given, tuple) else (given, None)
        if every is None:
            every = _every(block, name, diagram.step) if isinstance(block, Block) else 1
        diagram.add(block, name, every)
    pairs = [(_sources(diagram, names, own), port_named(diagram, target, LOOP)) for names, target in connections]
    for _, target in pairs:
        for element in target:
            if (target.node.name, target.port.name, element.elements[0]) in own:
                diagram.disconnect(element)
    for sources, target in pairs:
        diagram.connect(sources, target)
    heard = {origin.node for _, (origin, _) in diagram.connections() if origin.port.name == "y"}
    for fault in faults:
        if fault not in heard:
            raise ConnectionError(
                f"The connections leave out the fault {fault.name!r}, so that it has no effect; take the signal after it, "
                f"'{fault.name}.y', or remove the fault."
            )


LOOP = "The loop"


def _sources(diagram: Diagram, names: Names, own: Mapping[tuple[str, str, int], tuple[PortRef, int]]) -> list[PortRef]:
    """Return the outputs that a connection takes, by their names; of an input, what the loop itself feeds to it."""
    outputs = []
    for name in [names] if isinstance(names, str) else names:
        port = port_named(diagram, name, LOOP)
        if port.direction == "output":
            outputs.append(port)
            continue
        for element in port:
            origin = own.get((port.node.name, port.port.name, element.elements[0]))
            if origin is None:
                raise ConnectionError(
                    f"{element.name} is an input that the loop itself does not feed; a connection begins at an output."
                )
            outputs.append(PortRef(origin[0].node, origin[0].port, origin[0].direction, (origin[1],)))
    return outputs


def _every(block: Block, name: str, step: Fraction) -> int:
    """Return the number of base steps in the sample time of a block; 1 if it has none."""
    sample_time = _sample_time(block)
    ratio = Fraction(1) if sample_time is None else sample_time / step
    if ratio.denominator != 1:
        raise StepSizeError(
            f"The {name} must run every {show(sample_time or step)} s, which is no whole multiple of dt, {show(step)} s; "
            "give closed_loop a dt that divides it, or leave dt out to use the controller's sample time."
        )
    return int(ratio)


def _port(node: Node, name: str, role: Literal["measured", "control"]) -> PortRef:
    """Return an output of the plant that is measured, or an input that is a control."""
    ports = {port.name: port for port in (node.outputs if role == "measured" else node.inputs)}
    try:
        found = node[name]
    except UnknownNameError:
        raise UnknownNameError(
            f"closed_loop() has {role}={name!r}. Block {node.name!r} has no port {name!r}; {did_you_mean(name, ports)}"
        ) from None
    if found.port.name not in ports:
        kinds = ("an input", "source", "an output") if role == "measured" else ("an output", "target", "an input")
        raise ConnectionError(
            f"closed_loop() has {role}={name!r}. {found.name} is {kinds[0]}, but the {kinds[1]} must be {kinds[2]}; "
            f"{did_you_mean(name, ports)}"
        )
    return found


def _input(node: Node, name: str, argument: str) -> PortRef:
    """Return a port of the plant that an argument names as an input; an unknown name is refused with the inputs alone."""
    try:
        return node[name]
    except UnknownNameError:
        inputs = [port.name for port in node.inputs]
        if any(each.startswith(f"{name}[") for each in inputs):
            raise  # the message says how an array becomes one port
        raise UnknownNameError(
            f"{argument} names {name!r}, which is no input of the plant; {did_you_mean(name, inputs)}"
        ) from None


def _names(given: Names, what: str) -> list[str]:
    names = [given] if isinstance(given, str) else list(given)
    if not names:
        raise ModelError(f"{what}= is empty; name at least one variable of the plant.")
    return names


def _references(
    given: Block | float | Sequence[Block | float], controller: Block, step: Fraction
) -> list[tuple[str, Block, Literal["y", "ahead"]]]:
    """Return the names and blocks of the references, and the output that is the goal."""
    several = list(given) if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) else [given]
    blocks: list[Any] = [Constant(real(r)) if isinstance(r, Real) else r for r in several]
    for block in blocks:
        if isinstance(block, Mapping):
            raise ModelError(
                "reference is a mapping. Give a list with a source for each goal, in the order of the goals."
            )
        _check_source("reference", block)
    names = ["reference" if len(blocks) == 1 else f"reference_{i}" for i in range(len(blocks))]
    time = preview_time(controller, step)
    if not time:
        return [(name, block, "y") for name, block in zip(names, blocks, strict=True)]
    blocks = [
        block if isinstance(block, Preview) or has_later_goals(block) else Preview(block, time) for block in blocks
    ]
    outputs: list[Literal["y", "ahead"]] = ["ahead" if isinstance(block, Preview) else "y" for block in blocks]
    return list(zip(names, blocks, outputs, strict=True))


def with_invalid(controller: Block, sensors: Sensors) -> Block:
    """Return the controller with the invalid values of its sensors.

    Raises
    ------
    ModelError
        If the controller has no setting ``invalid``, or other values in it.
    """
    table = invalid_values("Sensors", sensors.invalid, len(sensors))
    if np.isnan(table).all():
        return controller
    settings: Any = controller
    if "invalid" not in getattr(controller, "__dataclass_fields__", ()):
        raise ModelError(
            f"Sensors has invalid={sensors.invalid!r}, but the controller, of the kind {type(controller).__name__}, has no "
            "setting 'invalid'; leave invalid out."
        )
    values = invalid_values("The controller", settings.invalid, len(sensors))
    if not np.isnan(values).all() and not np.array_equal(values, table, equal_nan=True):
        raise ModelError(
            f"Sensors has invalid={sensors.invalid!r}, and the controller invalid={settings.invalid!r}; leave one of them out."
        )
    changed: Block = replace(settings, invalid=sensors.invalid)
    return changed


def _fitted(sensors: Sensors | None, signals: int) -> Sensors:
    if sensors is None:
        return Sensors(count=signals, signals=signals)
    return replace(sensors, signals=signals) if sensors.signals == 1 else sensors
