"""The parts of a closed loop as linear systems: the plant at its start values, its sensors, and the controller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.blocks.linear_system import LinearSystem, held, normalised
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.control.beginning import first_values, listed, start_values, without_effect
from bayesftc.cosim.control.delays import Held, Matrices, interpolated, late, repeated
from bayesftc.cosim.control.differences import equations, parted, slopes
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import part_of
from bayesftc.cosim.diagram.roles import QuantityRole, find_roles
from bayesftc.cosim.diagram.subsystem import Boundary
from bayesftc.cosim.diagram.wiring import dead_time, element_name, find_controller, find_sensors, healthy_source
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.types import Floats

Engine = Literal["auto", "compiled", "interpreted"]
Element = tuple[Port, int]
"""A port and the number of an element."""

CONSTANT = 1e-9
"""Distance from 1 of a derivative by differences of a number by itself, up to which the number stays constant."""

NO_INFLUENCE = 1e-7
"""Smaller derivatives by differences count as rounding."""


@dataclass(frozen=True)
class Parts:
    """The linear parts of a closed loop, without its faults and its sources; all at the sample time of the controller.

    Attributes
    ----------
    without_delay : Matrices
        The plant from the controls to the measured signals, and to its other outputs with a goal, without the dead times of the
        controls.
    within : Held
        What the controls do to the plant within a sample.
    delays : tuple of Fraction
        Dead times of the controls in samples.
    controller : Matrices
        From ``y`` and the goals, one after the other, to the controls, with the dead times of the samples.
    sensors : ndarray
        The measurement matrix, from the signals to the sensors. A signal with a goal but without a sensor has a column of zeros.
    tracked : mapping of str to (int, ndarray)
        The quantities with a goal, by name: the number of the goal, and the coefficients of the signals.
    controls, goals : tuple of str
        The plant's inputs in the order of ``u``; the elements of the goal.
    step : Fraction
        Sample time in seconds.
    """

    without_delay: Matrices
    within: Held
    delays: tuple[Fraction, ...]
    controller: Matrices
    sensors: Floats
    tracked: dict[str, tuple[int, Floats]]
    controls: tuple[str, ...]
    goals: tuple[str, ...]
    step: Fraction

    @property
    def plant(self) -> Matrices:
        """The plant with the dead times of the controls, whose last values are further states."""
        return late(self.without_delay, self.delays, self.within)


def loop_parts(diagram: Diagram, plant: Any = None) -> Parts:
    """Return the linear parts of a closed loop.

    Parameters
    ----------
    diagram : Diagram
        A diagram from `closed_loop`, or connected by hand in the same way.
    plant : control.StateSpace or control.TransferFunction, optional
        Replaces the plant, dead times of the diagram included: from the controls in the order of ``u`` to the measured signals.

    Raises
    ------
    ModelError
        If the diagram is no closed loop, or a part of it cannot be linearized.
    """
    try:
        sensors, controller = find_sensors(diagram), find_controller(diagram)
    except ModelError as error:
        raise ModelError(f"{error} {_OTHER_LOOPS}") from None
    rows = sensors.block.rows  # type: ignore[attr-defined]
    if rows is None:
        raise ModelError(
            f"The sensors {sensors.name!r} have a measurement function, which is not linear. Linearize the whole loop: "
            "loop.to_control(...).linearize(state)."
        )
    y = controller.port("y")
    for i in range(y.size):
        origin = healthy_source(diagram, controller, y, i)
        if origin is None or origin[0] is not sensors or origin[2] != i:
            raise ModelError(
                f"Sample {i} of {controller.name!r} does not come from sensor {i} of {sensors.name!r} through faults and "
                f"sums with sources alone. {_WHOLE}"
            )
    node, measured = _measured(diagram, sensors)
    driven = _driven(diagram, node, controller)
    step = diagram.step * controller.every
    quantities = [each for each in find_roles(diagram).quantities if each.goal is not None]
    aims = {} if plant is not None else _unmeasured(node, quantities)
    linear, within = (
        _of_system(plant, step, rows)
        if plant is not None
        else _of_block(
            diagram, node, driven, [*measured, *aims.values()], step, _plant_inputs(diagram, node, driven, controller)
        )
    )
    rows = np.hstack([rows, np.zeros((len(rows), len(aims)))])
    p, q = len(driven), len(measured) + len(aims)
    if linear.D.shape != (q, p):
        raise ModelError(
            f"plant= has {linear.D.shape[1]} inputs and {linear.D.shape[0]} outputs, but the loop has {p} controls and {q} "
            "measured signals. Give a system with an input for each control and an output for each measured signal."
        )
    names = tuple(element_name(port, i) for port, i in driven)
    _check_plant(node.name, linear, names)
    law = _law(diagram, controller, sensors, names)
    delays = [Fraction(0)] * p
    if plant is None:
        delays = [_dead_time(diagram, node, *element, diagram.step * node.every) / step for element in driven]
        law = late(law, [_dead_time(diagram, controller, y, i, step) / step for i in range(y.size)])
    goals = tuple(element_name(controller.port("goal"), i) for i in range(controller.port("goal").size))
    alone = dict(zip(aims, np.eye(q)[len(measured) :], strict=True))
    tracked = {
        each.name: (each.goal, rows[each.sensors[0]] if each.sensors else alone[each.name])
        for each in quantities
        if each.goal is not None and (each.sensors or each.name in alone)
    }
    return Parts(linear, within, tuple(delays), law, rows, tracked, names, goals, step)


# --- Find the parts --------------------------------------------------------------------------------------------------

_OTHER_LOOPS = (
    "For a loop of other blocks, system = diagram.to_control(inputs=['pi.u'], outputs=['pi.u']) opens the loop at the output u "
    "of a block 'pi', and control.margin(-system.linearize(system.initial_state)) has its margins. With the reference as the "
    "input, inputs=['reference.y'], it is the closed loop, for poles() and control.step_info."
)
_WHOLE = "Linearize the whole loop: loop.to_control(inputs=['controller.u'], ...).linearize(state)."


def _measured(diagram: Diagram, sensors: Node) -> tuple[Node, list[Element]]:
    """Return the plant, and its outputs that the sensors measure."""
    port = sensors.port("u")
    origins = [next(diagram.origins_of(sensors, port, i), None) for i in range(port.size)]
    nodes = {None if origin is None else origin[0].node.name for origin in origins}
    if len(nodes) > 1 or None in nodes:
        raise ModelError(
            f"The sensors {sensors.name!r} read signals of {len(nodes)} blocks, so that there is no single plant. {_WHOLE}"
        )
    return origins[0][0].node, [(origin[0].port, origin[1]) for origin in origins if origin is not None]  # type: ignore[index]


def _unmeasured(node: Node, quantities: Iterable[QuantityRole]) -> dict[str, Element]:
    """Return the outputs of the plant that have a goal but no sensor, by the name of their quantity."""
    places = {(f"{node.name}.{port.name}", i): (port, i) for port in node.block.outputs for i in range(port.size)}
    return {
        each.name: places[each.truth[0][1]]
        for each in quantities
        if not each.sensors and each.truth and each.truth[0][1] in places
    }


def _driven(diagram: Diagram, node: Node, controller: Node) -> list[Element]:
    """Return the inputs of the plant that the controls feed, in the order of ``u``."""
    inputs: dict[int, Element] = {}
    for port in node.block.inputs:
        for i in range(port.size):
            origin = healthy_source(diagram, node, port, i)
            if origin is not None and origin[0] is controller and origin[1].name == "u":
                if origin[2] in inputs:
                    raise ModelError(f"Control {origin[2]} feeds two inputs of {node.name!r}. {_WHOLE}")
                inputs[origin[2]] = port, i
    missing = [j for j in range(controller.port("u").size) if j not in inputs]
    if missing:
        raise ModelError(
            f"Control {missing[0]} of {controller.name!r} does not lead to the plant {node.name!r} through faults and sums with "
            f"sources alone. {_WHOLE}"
        )
    return [inputs[j] for j in sorted(inputs)]


def _dead_time(diagram: Diagram, node: Node, port: Port, i: int, step: Fraction) -> Fraction:
    """Return the dead time of one element of an input, which must be a multiple of the steps at which it is read."""
    time = dead_time(diagram, node, port, i)
    if (time / step).denominator != 1:
        raise ModelError(
            f"{node.name}.{element_name(port, i)} has a dead time of {show(time)} s, which is no multiple of the sample time of "
            f"{show(step)} s at which {node.name!r} runs. Round it, or give the plant with its dead time: loop.linear(plant=...)."
        )
    return time


# --- Linearize the parts ---------------------------------------------------------------------------------------------


def _plant_inputs(diagram: Diagram, node: Node, driven: Sequence[Element], controller: Node) -> Floats:
    """Return the inputs of the plant, linearized there: at the operating point of the controller's model, if it has one.

    Otherwise a controller with a model begins at the start values of the plant's inputs, and another one at its first controls.
    """
    ports = _inputs(node)
    elements, model = [(port, i) for port in ports for i in range(port.size)], getattr(controller.block, "model", None)
    if model is None:
        return first_values(diagram, [(node, *element) for element in elements])
    others = dict(getattr(model, "held_inputs", ()))
    u = np.array([others.get(element_name(port, i), start_values(port)[i]) for port, i in elements], dtype=np.float64)
    if (control := getattr(model, "operating_control", None)) is not None and len(control) == len(driven):
        u[[elements.index(element) for element in driven]] = control
    return u


def _of_block(
    diagram: Diagram,
    node: Node,
    driven: Sequence[Element],
    measured: Sequence[Element],
    step: Fraction,
    u: Floats,
) -> tuple[Matrices, Held]:
    """Return the plant from controls to measured signals, linearized at its start values with the inputs `u`."""
    block: Any = node.block
    plant_step, ports = diagram.step * node.every, _inputs(node)
    inputs, outputs = _elements(ports), _elements(block.outputs)
    columns = [inputs.index((port.name, i)) for port, i in driven]
    lines = [outputs.index((port.name, i)) for port, i in measured]
    if isinstance(block, StateSpace) and isinstance(block.system, LinearSystem):
        a, b, c, d = block.system.matrices()
        continuous = block.system.dt == 0
    elif isinstance(block, StateSpace):  # its equations, rather than steps of its solver
        x, both = np.array(block.initial, dtype=np.float64), equations(block)
        point = np.concatenate([x, u])
        a, b, c, d = parted(slopes(both, point)[0], len(x))
        continuous = block.system.dt == 0
    elif isinstance(block, FMU) and block.kind == "model exchange":
        with ModelEquations(block) as model:
            a, b, c, d = model.jacobians(model.x0, u)
        continuous = True
    else:
        system = _system(diagram, node, [port.name for port in ports], [port.name for port in block.outputs])
        if system._machine.opaque:
            raise ModelError(_hidden(node, driven, measured, step, u))
        linear = system.linearize(_settled_state(diagram, node, system, u), u)
        a, b, c, d = linear.A, linear.B, linear.C, linear.D
        continuous = False
    ratio = step / plant_step
    if ratio.denominator != 1:
        raise ModelError(
            f"The plant {node.name!r} runs every {show(plant_step)} s, slower than its controller ({show(step)} s), so that the "
            "loop is not a linear system with a constant step. Run the controller as often as the plant."
        )
    return _moving(a, b[:, columns], c[lines], d[np.ix_(lines, columns)], float(step), 0 if continuous else int(ratio))


def _moving(a: Floats, b: Floats, c: Floats, d: Floats, step: float, steps: int) -> tuple[Matrices, Held]:
    """Return a sampled plant without numbers that stay constant, such as parameters, and without numbers that nothing reads.

    An FMU of this package has such numbers among its states: with them the plant has poles at 1 and 0 that are none of it.
    """
    A, B = repeated(a, b, steps) if steps else held(a, b, step)
    keep = np.ones(len(A), dtype=bool)
    while keep.any():
        matrix = A[np.ix_(keep, keep)]
        apart = matrix - np.diag(np.diag(matrix))
        constant = (
            (np.abs(np.diag(matrix) - 1.0) < CONSTANT) & (apart == 0.0).all(axis=1) & (B[keep] == 0.0).all(axis=1)
        )
        unread = (matrix == 0.0).all(axis=0) & (c[:, keep] == 0.0).all(axis=0)
        if not (constant | unread).any():
            break
        keep[keep] = ~(constant | unread)
    a, b = a[np.ix_(keep, keep)], b[keep]
    within = interpolated(a, b, step, steps) if steps else Held(a, b, step)
    return Matrices(A[np.ix_(keep, keep)], B[keep], c[:, keep], d), within


def _hidden(node: Node, driven: Sequence[Element], measured: Sequence[Element], step: Fraction, u: Floats) -> str:
    """Return the message about a plant with hidden states, with a line to copy if it is an FMU; `u` is where it is to rest."""
    text = f"The plant {node.name!r} has hidden states, so that it cannot be linearized at its start values. Give a linear model"
    if not isinstance(node.block, FMU):
        return f"{text} of it, a system of python-control: loop.linear(plant=system)."
    names = {
        role: [labels(port.name, port.shape)[i] for port, i in elements]
        for role, elements in (("measured", measured), ("actuated", driven))
    }
    given = ", ".join(f"{role}={ports!r}" for role, ports in names.items())
    inputs = [(element_name(port, i), start_values(port)[i]) for port in _inputs(node) for i in range(port.size)]
    if at := {name: value for (name, start), value in zip(inputs, u.tolist(), strict=True) if value != start}:
        given += f", at={at!r}"  # else it is to rest at its start values, and may not
    return (
        f"{text} of it, from its responses to pulses:\n"
        f"model = bayesftc.controllers.LinearModel.from_fmu(loop[{node.name!r}].block, {given}, dt={show(step)!r})\n"
        "linear = loop.linear(plant=model.to_control())  # then linear.bode(), linear.margins() and so on"
    )


def _inputs(node: Node) -> list[Port]:
    """Return the inputs of a block or a subsystem that are not random."""
    ports = node.block.free if isinstance(node.block, Boundary) else node.inputs
    return [port for port in ports if port.draw is None]


def _system(
    diagram: Diagram, node: Node, inputs: Sequence[str], outputs: Sequence[str], engine: Engine = "auto"
) -> Any:
    """Return a block or a subsystem of a diagram as a system of python-control, without noise."""
    block = node.block
    if not isinstance(block, Boundary):
        return block.to_control(diagram.step * node.every, inputs=inputs, outputs=outputs, seed=None, engine=engine)
    part = part_of(diagram, [node.name])
    if any(each.every != 1 for each in part.nodes):
        raise ModelError(
            f"The blocks of {node.name!r} run at different rates, so that it is not a linear system with a constant step. "
            f"{_WHOLE}"
        )
    whole = [{f"{node.name}.{name}": name for name in names} for names in (inputs, outputs)]
    return part.to_control(inputs=whole[0], outputs=whole[1], seed=None, engine=engine)


def _settled_state(diagram: Diagram, node: Node, system: Any, u: Floats) -> Floats:
    """Return the initial state of a block or a subsystem, with filters that have had many samples."""
    x = np.array(system.initial_state)
    parts = part_of(diagram, [node.name]).nodes if isinstance(node.block, Boundary) else (node,)
    own = {
        state if part is node else f"{part.name.replace('.', '_')}_{state}"
        for part in parts
        for state in getattr(part.block, "settling", ())
    }
    places = [i for i, label in enumerate(system.state_labels) if label.partition("[")[0] in own]
    for _ in places:  # no filter settles later: a window has as many numbers as it needs samples
        before, x[places] = x[places], system.dynamics(0.0, x, u)[places]
        if np.array_equal(x[places], before):
            break
    return x


def _elements(ports: Iterable[Port]) -> list[tuple[str, int]]:
    return [(port.name, i) for port in ports for i in range(port.size)]


def _of_system(system: Any, step: Fraction, rows: Floats) -> tuple[Matrices, Held]:
    """Return a given linear system for the plant, sampled if it is continuous; its outputs may be the sensors."""
    linear = normalised(system)
    if not isinstance(linear, LinearSystem):
        raise ModelError(f"plant= is {system!r}; it must be a linear system of python-control.")
    a, b, c, d = linear.matrices()
    if linear.dt == 0:
        within = Held(a, b, float(step))
        a, b = held(a, b, float(step))
    elif linear.dt is not None and linear.dt is not True and rational_step(linear.dt) != step:
        raise ModelError(
            f"plant= has a sample time of {linear.dt:g} s, but the controller runs every {show(step)} s. Use a system with the "
            "sample time of the controller, or in continuous time."
        )
    else:
        within = interpolated(a, b, float(step), 1)
    if len(c) == len(rows) != rows.shape[1]:  # the outputs are the sensors, as from `LinearModel.to_control`
        c, d = (np.asarray(np.linalg.lstsq(rows, matrix)[0], float) for matrix in (c, d))
    return Matrices(a, b, c, d), within


def _law(diagram: Diagram, node: Node, sensors: Node, names: Sequence[str]) -> Matrices:
    """Return the controller of the named controls: by its method ``linear_law``, else linearized at its first inputs.

    A controller that says which goal belongs to which state has the goal at which the plant stands, others the first reference.
    """
    block = node.block
    if hasattr(block, "linear_law"):
        return Matrices(*block.linear_law())
    signals, samples, goals = sensors.port("u"), node.port("y"), node.port("goal")
    others = [port for port in _inputs(node) if port.name not in {"y", "goal"}]
    places = [(sensors, signals, i) for i in range(signals.size)]
    places += [(node, port, i) for port in (goals, *others) for i in range(port.size)]
    seen, goal, rest = np.split(first_values(diagram, places), [signals.size, signals.size + goals.size])
    y = sensors.block.rows @ seen  # type: ignore[attr-defined]
    C, G = (getattr(block, name, None) for name in ("measurement_matrix", "goal_matrix"))
    if C is not None and G is not None and np.isfinite(C).all():
        goal = G @ np.linalg.lstsq(C, y)[0]
    system = _system(diagram, node, ["y", "goal", *(port.name for port in others)], ["u"], "interpreted")
    u = np.concatenate([y, goal, rest])
    linear = system.linearize(_settled_state(diagram, node, system, u), u)
    m, p = samples.size, samples.size + goals.size
    A, B, C, D = linear.A, linear.B[:, :p], linear.C, linear.D[:, :p]
    idle = [name for j, name in enumerate(names) if without_effect(A, B[:, :m], C[[j]], D[[j], :m])]
    if idle:
        warn_user(
            f"Where the loop begins, at y = {listed(y)} and goal = {listed(goal)}, the controller {node.name!r} has no feedback: "
            f"its control {' and '.join(idle)} does not depend on y, probably because it is at its limit. {_NO_FEEDBACK} Begin "
            "elsewhere (start values of the plant, reference), or linearize the controller without its limits."
        )
    keep = np.abs(C).max(axis=0, initial=0.0) > NO_INFLUENCE
    while (more := keep | (np.abs(A[keep]).max(axis=0, initial=0.0) > NO_INFLUENCE)).sum() > keep.sum():
        keep = more
    return Matrices(A[np.ix_(keep, keep)], B[keep], C[:, keep], D)


def _check_plant(title: str, plant: Matrices, names: Sequence[str]) -> None:
    """Refuse derivatives that are missing, and warn of controls without an effect on the plant."""
    if not all(np.isfinite(matrix).all() for matrix in plant):
        raise ModelError(
            f"The plant {title!r} cannot be linearized at its start values: its equations cannot be evaluated near them, or "
            "have no finite derivative there, as a root at zero. Give other start values, or a linear model: "
            "loop.linear(plant=system)."
        )
    A, B, C, D = plant
    idle = [name for j, name in enumerate(names) if without_effect(A, B[:, [j]], C, D[:, [j]])]
    if idle:
        warn_user(
            f"Where the plant {title!r} begins, {' and '.join(idle)} has no effect on its measured signals, as within a dead "
            f"band or beyond a limit. {_NO_FEEDBACK} Give other start values, or a linear model: loop.linear(plant=system)."
        )


_NO_FEEDBACK = "So poles, margins and step response are those without feedback, and an infinite margin says nothing."
