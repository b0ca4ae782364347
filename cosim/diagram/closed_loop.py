"""The usual diagram in one call: reference, controller, plant, sensors, and faults of sensors, actuators and process."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from numbers import Real
from typing import Any

import numpy as np

from bayesftc.cosim.base.invalid import invalid_values
from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.faults.kinds import Dropout, Fault, RandomFaults
from bayesftc.cosim.blocks.sensors import Sensors
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.errors import (
    ConnectionError,
    ModelError,
    StepSizeError,
    UnconnectedInputError,
    UnknownNameError,
    did_you_mean,
)

Names = str | Sequence[str]


def closed_loop(
    plant: Block,
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
    dt: float | str | Fraction | None = None,
) -> Diagram:
    """Return the diagram of a plant under a controller that sees it through faulty sensors and moves it by faulty actuators.

    ``reference -> controller.goal``; ``plant -> sensors -> faults -> controller.y``; ``controller.u -> input_faults -> plant``;
    ``noise -> input_faults -> plant`` into further inputs. The blocks are named ``plant``, ``controller``, ``sensors``,
    ``reference`` (``reference_0``, ... where there are several), ``<input>_noise``, ``freeze_0`` and the like for faults of
    sensors, ``<input>_freeze_0`` for those of an input (``u_1_freeze_0`` for those of ``u[1]``); monitors have the names given.

    Parameters
    ----------
    plant : Block
        An `FMU`, a `StateSpace`, or any block.
    controller : Block
        A block with inputs ``y`` and ``goal`` and the output ``u``.
    control : str or sequence of str
        The plant's inputs that ``u`` drives, in its order. A vector is driven whole, or an element of it (``"u[1]"``).
    measured : str or sequence of str
        The plant's outputs that the sensors see, vectors whole or elements of them.
    reference : Block, float or a sequence of them
        Where the plant is to go: a source, a constant, or one for each element of the controller's goal.
    sensors : Sensors, optional
        By default one perfect sensor for each measured output. Their ``invalid`` values become those of the controller.
    faults : Fault or sequence of Fault
        Applied to the samples one after the other.
    input_faults : mapping of plant input to Fault or sequence of Fault, optional
        Faults of actuators, where the input is a control, and else of the process: what the plant receives is no longer what the
        controller has sent (it goes on believing in that), or what the noise was. An input with neither has its start value.
    noise : mapping of plant input to Block, optional
        Sources for further inputs of the plant.
    monitors : mapping of name to Block, optional
        Blocks that watch the controller: each input is fed by the controller's output of that name, or by what feeds its ``y``
        or ``goal``. An input with a start value may find nothing there.
    dt : float, str or Fraction, optional
        Base step in seconds; by default the controller's own sample time. With a smaller one, of which the controller's (or
        a discrete plant's) sample time is a whole multiple, these run at every n-th step; sensors, faults and sources run at
        the base step.

    Returns
    -------
    Diagram
        Built and ready: ``closed_loop(...).simulate(20.0, seed=1)``.

    Raises
    ------
    StepSizeError
        If `dt` is missing and the controller knows none, or if it does not divide a sample time.
    ConnectionError, UnknownNameError
        If the parts do not fit together.
    ModelError
        If one of them is of another kind than it must be.
    """
    _check_kinds(plant, controller, sensors, noise)
    step = controller.sample_time if dt is None else dt
    if step is None:
        raise StepSizeError(
            f"{type(controller).__name__} does not know its sample time; give closed_loop(dt=...) in seconds."
        )
    diagram = Diagram(step)
    goals = [diagram.add(block, name) for name, block in _references(reference)]
    plant = plant.watching(_names(measured, "measured"))
    node = diagram.add(plant, "plant", every=_every(plant, "plant", diagram.step))
    outputs = [node[name] for name in _names(measured, "measured")]
    sensors = _fitted(sensors, sum(map(len, outputs)))
    controller = with_invalid(controller, sensors)
    seen = diagram.add(sensors, "sensors")
    diagram.connect(outputs, seen["u"])
    samples = _through(diagram, seen["y"], [faults] if isinstance(faults, Fault) else faults)
    decider = diagram.add(controller, "controller", every=_every(controller, "controller", diagram.step))
    if len(decider["y"]) != sensors.count:
        raise ConnectionError(
            f"The controller has {len(decider['y'])} sensors, but the loop has {sensors.count}; give its model's C a row, or its "
            "modalities a sample, for each sensor, and Sensors the same count."
        )
    diagram.connect(samples, decider["y"])
    diagram.connect([g["y"] for g in goals], decider["goal"])
    inputs = {name: node[name] for name in _names(control, "control")}
    if len(decider["u"]) != sum(map(len, inputs.values())):
        raise ConnectionError(
            f"The controller has {len(decider['u'])} controls, but control= names {sum(map(len, inputs.values()))} inputs of the "
            f"plant: {', '.join(inputs)}."
        )
    if not isinstance(input_faults, Mapping | None):
        raise ModelError(
            f"input_faults is {input_faults!r}; it must say which input of the plant each fault befalls: "
            f"input_faults={{{next(iter(inputs))!r}: GainFault(factor=0.5)}}."
        )
    befallen, first = dict(input_faults or {}), 0
    for name, target in inputs.items():
        _feed(diagram, decider["u"][first : first + len(target)], target, befallen.pop(name, ()), name)
        first += len(target)
    seen_by = {"y": samples, "goal": [g["y"] for g in goals]}
    for name, monitor in (monitors or {}).items():
        _watch(diagram, decider, diagram.add(monitor, name, decider.every), seen_by)
    for name, source in (noise or {}).items():
        _feed(diagram, diagram.add(source, noise_block(name))["y"], node[name], befallen.pop(name, ()), name)
    for name, chain in befallen.items():
        _feed(diagram, _at_rest(diagram, node[name], name), node[name], chain, name)
    return diagram.build()


def _check_kinds(plant: object, controller: object, sensors: object, noise: object) -> None:
    """Refuse what is no block where one must be, and a controller that is none."""
    for role, given in (("plant", plant), ("controller", controller)):
        if not isinstance(given, Block):
            raise ModelError(
                f"The {role} must be a block, not {given!r}: cosim.FMU(path) makes one of an FMU, cosim.StateSpace(system) "
                "one of a system of python-control; docs/write-a-block.md has your own."
            )
    assert isinstance(controller, Block)
    ports = {p.name for p in controller.inputs}, {p.name for p in controller.outputs}
    for name, kind, known in (("y", "input", ports[0]), ("goal", "input", ports[0]), ("u", "output", ports[1])):
        if name not in known:
            raise UnknownNameError(
                f"The controller, of the kind {type(controller).__name__}, has no {kind} {name!r}, but a controller has the "
                "inputs y and goal and the output u. Are plant and controller in each other's place? Blocks with other "
                "ports can be wired by hand: cosim.Diagram."
            )
    if not isinstance(sensors, Sensors | None):
        raise ModelError(f"sensors is {sensors!r}; it must be cosim.Sensors(count=2, std=0.01) or the like.")
    if not isinstance(noise, Mapping | None):
        raise ModelError(
            f"noise is {noise!r}; it must say which input of the plant each source feeds: "
            "noise={'load': cosim.Gaussian(std=0.1)}."
        )


MOST_FAULTS = 1000
"""On one signal, each a block of its own."""


def check_count(faults: Sequence[object]) -> None:
    """Refuse more faults than a loop can have.

    Raises
    ------
    ModelError
        If there are too many.
    """
    if len(faults) > MOST_FAULTS:
        raise ModelError(
            f"There are {len(faults)} faults, but a signal has at most {MOST_FAULTS}; RandomFaults makes any number of them."
        )


def fault_block(fault: Fault, of: str = "") -> str:
    """Return the name of a fault's block: of a sensor, or of an input of the plant, whose name comes first."""
    return fault.name or (f"{_plain(of)}_" if of else "") + fault.default_name


def noise_block(name: str) -> str:
    """Return the name of the block of an input's noise."""
    return f"{_plain(name)}_noise"


def _through(diagram: Diagram, signal: PortRef, faults: Sequence[Fault], of: str = "") -> PortRef:
    """Lead a signal through faults, of sensors or of an input; return what comes out."""
    check_count(faults)
    for fault in faults:
        if not isinstance(fault, Fault):
            raise ModelError(f"faults must be faults such as Freeze(sensor=0, start=6.0), not {fault!r}.")
        modifier = diagram.add(replace(fault, channels=len(signal)), fault_block(fault, of))
        diagram.connect(signal, modifier["u"])
        signal = modifier["y"]
    return signal


def _feed(diagram: Diagram, signal: PortRef, target: PortRef, faults: Fault | Sequence[Fault], name: str) -> None:
    """Connect what feeds an input of the plant to it, through the faults of that input."""
    chain = [faults] if isinstance(faults, Fault) else faults
    for fault in chain:
        kinds = fault.kinds if isinstance(fault, RandomFaults) else (fault,)
        if any(isinstance(kind, Dropout) for kind in kinds):
            raise ModelError(
                f"input_faults has a Dropout for {name!r}, but a plant must always be given a number; take Stuck(at=0.0) for an "
                "actuator that is off, or Freeze() for one that holds its last value."
            )
        if isinstance(fault, Fault) and fault.sensor >= len(signal):
            raise ModelError(
                f"input_faults has a {type(fault).__name__} with sensor={fault.sensor} for {name!r}, which has {len(signal)} "
                f"element{'s' if len(signal) > 1 else ''}, numbered from 0; leave sensor out where there is one."
            )
    diagram.connect(_through(diagram, signal, chain, name), target)


def _plain(name: str) -> str:
    """Return an input's name as part of a block's name: ``u_1`` for the element ``u[1]``."""
    return re.sub(r"\W+", "_", name).strip("_") if name.endswith("]") else name


def _at_rest(diagram: Diagram, target: PortRef, name: str) -> PortRef:
    """Return a source of the value that an input of the plant has while nothing feeds it."""
    if target.direction == "output":
        raise ConnectionError(f"input_faults names {target.name}, which is an output; name an input of the plant.")
    if target.port.default is None or len(target) > 1:
        raise UnconnectedInputError(
            f"A fault is to befall {target.name}, which has no control, no noise and no start value; give it a source, as "
            f"closed_loop(noise={{{name!r}: cosim.Constant(0.0)}})."
        )
    start = np.broadcast_to(target.port.default, target.port.shape).ravel()[target.elements[0]]  # type: ignore[arg-type]
    return diagram.add(Constant(float(start)), f"{_plain(name)}_start")["y"]


def _watch(diagram: Diagram, decider: Node, monitor: Node, seen_by: Mapping[str, Any]) -> None:
    """Connect a monitor's inputs to the controller's outputs of the same names, or to what feeds the controller."""
    outputs = {port.name for port in decider.block.outputs}
    for port in monitor.block.inputs:
        if port.name not in outputs | seen_by.keys():
            if port.default is not None or port.draw is not None:
                continue
            raise UnknownNameError(
                f"The monitor {monitor.name!r} watches {port.name!r}, which is no output of the controller; "
                f"{did_you_mean(port.name, outputs | seen_by.keys())}"
            )
        diagram.connect(decider[port.name] if port.name in outputs else seen_by[port.name], monitor[port.name])


def _every(block: Block, name: str, step: Fraction) -> int:
    """Return at how many base steps a block with a sample time of its own runs."""
    ratio = Fraction(1) if block.sample_time is None else block.sample_time / step
    if ratio.denominator != 1:
        raise StepSizeError(
            f"The {name} must run every {show(block.sample_time or step)} s, which is no whole multiple of dt, {show(step)} s; "
            "give closed_loop a dt that divides it, or leave dt out to take the controller's."
        )
    return int(ratio)


def _names(given: Names, what: str) -> list[str]:
    names = [given] if isinstance(given, str) else list(given)
    if not names:
        raise ModelError(f"{what}= is empty; name at least one variable of the plant.")
    return names


def _references(given: Block | float | Sequence[Block | float]) -> list[tuple[str, Block]]:
    several = list(given) if isinstance(given, Sequence | np.ndarray) else [given]
    blocks: list[Any] = [Constant(real(r)) if isinstance(r, Real) else r for r in several]
    return [("reference" if len(blocks) == 1 else f"reference_{i}", block) for i, block in enumerate(blocks)]


def with_invalid(controller: Block, sensors: Sensors) -> Block:
    """Return the controller with the values that its sensors send in place of a sample.

    Raises
    ------
    ModelError
        If it has no such setting, or other values.
    """
    table = invalid_values("Sensors", sensors.invalid, sensors.count)
    if np.isnan(table).all():
        return controller
    settings: Any = controller
    if "invalid" not in getattr(controller, "__dataclass_fields__", ()):
        raise ModelError(
            f"Sensors has invalid={sensors.invalid!r}, but the controller, of the kind {type(controller).__name__}, has no "
            "setting 'invalid' to know them by; leave invalid out."
        )
    own = invalid_values("The controller", settings.invalid, sensors.count)
    if not np.isnan(own).all() and not np.array_equal(own, table, equal_nan=True):
        raise ModelError(
            f"Sensors has invalid={sensors.invalid!r}, and the controller invalid={settings.invalid!r}; leave one of them out."
        )
    told: Block = replace(settings, invalid=sensors.invalid)
    return told


def _fitted(sensors: Sensors | None, signals: int) -> Sensors:
    if sensors is None:
        return Sensors(count=signals, signals=signals)
    return replace(sensors, signals=signals) if sensors.signals == 1 else sensors
