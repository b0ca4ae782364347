"""The parts of a closed loop as linear systems: the plant where it stands, its sensors, and the controller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.linear_system import LinearSystem, held, normalised
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.diagram.wiring import element_name, find_controller, find_sensors, healthy_source
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

Element = tuple[Port, int]
"""A port and an element of it."""

NO_INFLUENCE = 1e-7
"""Derivatives by differences that are smaller than this are rounding."""


class Matrices(NamedTuple):
    """A linear system in discrete time."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats


@dataclass(frozen=True)
class Parts:
    """The linear parts of a closed loop, without its faults; all at the sample time of the controller.

    Attributes
    ----------
    plant : Matrices
        From the controls to the signals that are measured.
    controller : Matrices
        From ``y`` and the goals, one after the other, to the controls.
    sensors : ndarray
        What each sensor reads of the signals.
    tracked : mapping of str to (int, ndarray)
        The measured quantities that have a goal, by name: the number of the goal, and what they are of the signals.
    controls, goals : tuple of str
        The plant's inputs in the order of ``u``; the elements of the goal.
    step : Fraction
        Sample time in seconds.
    """

    plant: Matrices
    controller: Matrices
    sensors: Floats
    tracked: dict[str, tuple[int, Floats]]
    controls: tuple[str, ...]
    goals: tuple[str, ...]
    step: Fraction


def loop_parts(diagram: Diagram, plant: Any = None) -> Parts:
    """Return the linear parts of a closed loop.

    Parameters
    ----------
    diagram : Diagram
        As `closed_loop` makes it, or put together by hand in the same way.
    plant : control.StateSpace or control.TransferFunction, optional
        What stands for the plant: from the controls in the order of ``u`` to the measured signals.

    Raises
    ------
    ModelError
        If the diagram is no closed loop, or a part of it cannot be linearized.
    """
    seen, controller = find_sensors(diagram), find_controller(diagram)
    rows = seen.block.rows  # type: ignore[attr-defined]
    if rows is None:
        raise ModelError(
            f"The sensors {seen.name!r} measure by a function, which is not linear. Linearize the whole loop: "
            "loop.to_control(...).linearize(state)."
        )
    y = controller.port("y")
    for i in range(y.size):
        origin = healthy_source(diagram, controller, y, i)
        if origin is None or origin[0] is not seen or origin[2] != i:
            raise ModelError(
                f"Sample {i} of {controller.name!r} does not come from sensor {i} of {seen.name!r} through faults alone. {_WHOLE}"
            )
    node, measured = _measured(diagram, seen)
    driven = _driven(diagram, node, controller)
    step = diagram.step * controller.every
    given, start = (
        (_of_system(plant, step, rows), np.zeros(len(measured)))
        if plant is not None
        else _of_block(node, driven, measured, diagram.step * node.every, step)
    )
    p, q = len(driven), len(measured)
    if given.D.shape != (q, p):
        raise ModelError(
            f"plant= has {given.D.shape[1]} inputs and {given.D.shape[0]} outputs, but the loop has {p} controls and {q} "
            "measured signals. Give a system with an input for each control and an output for each measured signal."
        )
    law = _law(controller.block, step, rows @ start)
    names = tuple(element_name(port, i) for port, i in driven)
    goals = tuple(element_name(controller.port("goal"), i) for i in range(controller.port("goal").size))
    quantities = find_roles(diagram).quantities
    tracked = {each.name: (each.goal, rows[each.sensors[0]]) for each in quantities if each.goal is not None}
    return Parts(given, law, rows, tracked, names, goals, step)


# --- where they are --------------------------------------------------------------------------------------------------

_WHOLE = "Linearize the whole loop: loop.to_control(inputs=['controller.u'], ...).linearize(state)."


def _measured(diagram: Diagram, seen: Node) -> tuple[Node, list[Element]]:
    """Return the plant, and its outputs that the sensors read."""
    port = seen.port("u")
    origins = [diagram.source_of(seen, port, i) for i in range(port.size)]
    nodes = {None if origin is None else origin[0].node.name for origin in origins}
    if len(nodes) > 1 or None in nodes:
        raise ModelError(
            f"The sensors {seen.name!r} read signals of {len(nodes)} blocks, so that there is no single plant. {_WHOLE}"
        )
    return origins[0][0].node, [(origin[0].port, origin[1]) for origin in origins if origin is not None]  # type: ignore[index]


def _driven(diagram: Diagram, node: Node, controller: Node) -> list[Element]:
    """Return the inputs of the plant that the controls drive, in the order of ``u``."""
    found: dict[int, Element] = {}
    for port in node.block.inputs:
        for i in range(port.size):
            origin = healthy_source(diagram, node, port, i)
            if origin is not None and origin[0] is controller and origin[1].name == "u":
                if origin[2] in found:
                    raise ModelError(f"Control {origin[2]} drives two inputs of {node.name!r}. {_WHOLE}")
                found[origin[2]] = port, i
    missing = [j for j in range(controller.port("u").size) if j not in found]
    if missing:
        raise ModelError(
            f"Control {missing[0]} of {controller.name!r} does not lead to the plant {node.name!r} through faults alone. {_WHOLE}"
        )
    return [found[j] for j in sorted(found)]


# --- what they are ---------------------------------------------------------------------------------------------------


def _of_block(
    node: Node, driven: Sequence[Element], measured: Sequence[Element], own: Fraction, step: Fraction
) -> tuple[Matrices, Floats]:
    """Return the plant from the controls to the measured signals, linearized where it stands, and these signals there."""
    block: Any = node.block
    inputs = _elements(port for port in block.inputs if port.draw is None)
    outputs = _elements(block.outputs)
    columns = [inputs.index((port.name, i)) for port, i in driven]
    lines = [outputs.index((port.name, i)) for port, i in measured]
    u = np.concatenate([np.zeros(0), *(_defaults(port) for port in block.inputs if port.draw is None)])
    if isinstance(block, StateSpace) and isinstance(block.system, LinearSystem):
        a, b, c, d = block.system.matrices()
        y = c @ np.asarray(block.initial) + d @ u
        if block.system.dt == 0:
            a, b = held(a, b, float(own))
    elif isinstance(block, FMU) and block.kind == "model exchange":
        with ModelEquations(block) as model:
            a, b, c, d = model.jacobians(model.x0, u)
            y = model.outputs(model.x0, u)
        a, b = held(a, b, float(own))
    else:
        system = block.to_control(own, inputs=[port.name for port in block.inputs if port.draw is None], seed=None)
        if system._machine.opaque:
            raise ModelError(
                f"The plant {node.name!r} does not show its states, so that it cannot be linearized where it stands. Give "
                "plant= a linear model of it: loop.linear(plant=LinearModel.from_fmu(...).to_control())."
            )
        x = system.initial_state
        found, y = system.linearize(x, u), system.output(0.0, x, u)
        a, b, c, d = found.A, found.B, found.C, found.D
    ratio = step / own
    if ratio.denominator != 1:
        raise ModelError(
            f"The plant {node.name!r} runs every {show(own)} s, slower than its controller ({show(step)} s), so that no linear "
            "system with a constant step is the loop. Let the controller run as often as the plant."
        )
    a, b = _repeated(a, b, int(ratio))
    return Matrices(a, b[:, columns], c[lines], d[np.ix_(lines, columns)]), np.asarray(y)[lines]


def _elements(ports: Iterable[Port]) -> list[tuple[str, int]]:
    return [(port.name, i) for port in ports for i in range(port.size)]


def _defaults(port: Port) -> Floats:
    return np.broadcast_to(0.0 if port.default is None else port.default, port.shape).ravel().astype(np.float64)


def _repeated(a: Floats, b: Floats, times: int) -> tuple[Floats, Floats]:
    """Return the matrices of several steps with the inputs held."""
    A, B = a, b
    for _ in range(times - 1):
        A, B = a @ A, a @ B + b
    return A, B


def _of_system(system: Any, step: Fraction, rows: Floats) -> Matrices:
    """Return a linear system that is given for the plant, sampled if it is continuous; its outputs may be the sensors."""
    given = normalised(system)
    if not isinstance(given, LinearSystem):
        raise ModelError(f"plant= is {system!r}; it must be a linear system of python-control.")
    a, b, c, d = given.matrices()
    if given.dt == 0:
        a, b = held(a, b, float(step))
    elif given.dt is not None and given.dt is not True and rational_step(given.dt) != step:
        raise ModelError(
            f"plant= has a sample time of {given.dt:g} s, but the controller runs every {show(step)} s. Make the system with "
            "that sample time, or in continuous time."
        )
    if len(c) == len(rows) != rows.shape[1]:  # as of `LinearModel.to_control`
        c, d = (np.asarray(np.linalg.lstsq(rows, matrix)[0], float) for matrix in (c, d))
    return Matrices(a, b, c, d)


def _law(block: Block, step: Fraction, y: Floats) -> Matrices:
    """Return the controller: by its own ``linear_law``, else linearized at its beginning, where it reads `y`."""
    if hasattr(block, "linear_law"):
        return Matrices(*block.linear_law())
    system = block.to_control(step, inputs=["y", "goal"], outputs=["u"], seed=None, engine="interpreted")
    goal = np.zeros(block.port("goal").size)
    C, G = (getattr(block, name, None) for name in ("measurement_matrix", "goal_matrix"))
    if C is not None and G is not None and np.isfinite(C).all():
        goal = G @ np.linalg.lstsq(C, y)[0]
    found = system.linearize(system.initial_state, np.concatenate([y, goal]))
    A, B, C, D = found.A, found.B, found.C, found.D
    keep = np.abs(C).max(axis=0, initial=0.0) > NO_INFLUENCE
    while (more := keep | (np.abs(A[keep]).max(axis=0, initial=0.0) > NO_INFLUENCE)).sum() > keep.sum():
        keep = more
    return Matrices(A[np.ix_(keep, keep)], B[keep], C[:, keep], D)
