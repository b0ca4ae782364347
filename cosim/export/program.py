"""The program to export: a block, or some blocks of a diagram, with everything that its C needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from types import FunctionType
from typing import Literal

import numpy as np

from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block, sample_time_of
from bayesftc.cosim.diagram.diagram import Diagram, is_external
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.diagram.opening import OUTSIDE, Names, opened, part_of
from bayesftc.cosim.diagram.roles import units_of_elements, units_of_settings
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.diagram.subsystem import Subsystem, with_inside
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.export.names import check, legal, unique
from bayesftc.cosim.export.signals import OneElement, Place, Places, Signal, Tunable, signal_of, tunables_of
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.stepping.fingerprint import foreign_functions


@dataclass(frozen=True)
class Program:
    """Blocks that become one step function.

    Parameters
    ----------
    name : str
        Its name.
    schedule : Schedule
        The order of calls and the layout of memory. The inputs are outputs of a block named ``<outside>``, element by element.
    inputs, outputs : tuple of Signal
        The signals that it reads and writes at each step.
    tunables : tuple of Tunable
        The parameters that can change between steps.
    """

    name: str
    schedule: Schedule
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    tunables: tuple[Tunable, ...]

    @property
    def blocks(self) -> tuple[str, ...]:
        """The names of the blocks."""
        return tuple(node.name for node in self.schedule.nodes if node.name != OUTSIDE)

    @property
    def step(self) -> Fraction:
        """The sample time in seconds."""
        return self.schedule.step


@reported("Translating the blocks to C, for some seconds.")
def program_of(
    exported: Block | Diagram,
    *,
    name: str | None = None,
    blocks: Sequence[str] | str | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    dt: float | str | Fraction | None = None,
) -> Program:
    """Return the program of a block, or of some blocks of a diagram.

    Parameters
    ----------
    exported : Block or Diagram
        The block, or the diagram with the blocks, to export.
    name : str, optional
        Its name; by default the block's.
    blocks : sequence of str, optional
        Names of blocks of the diagram; by default all.
    inputs, outputs : names, optional
        Its inputs and outputs; a mapping gives new names. By default all unconnected inputs, including random ones, and all
        outputs. They have the names of their ports, with the block's name before it if there are several blocks.
    dt : float, str or Fraction, optional
        The sample time, for a block that does not define one.

    Raises
    ------
    ModelError
        If something cannot be exported.
    UnknownNameError
        If there is no block or signal of that name.
    """
    diagram = _as_diagram(exported, dt)
    part, units, of_elements = _part(diagram, blocks), units_of_settings(diagram), units_of_elements(diagram)
    alone = len(part.nodes) == 1
    prefix = ""
    if isinstance(exported, Subsystem):
        prefix = f"{part.nodes[0].name}."
        name = name or part.nodes[0].name
        inputs, outputs = (
            _within(part.nodes[0], inputs, exported.inputs),
            _within(part.nodes[0], outputs, exported.outputs),
        )
    input_places, output_places = _program_inputs(part, inputs), _named(_ports(part, "outputs"), outputs, "output")
    whole, _ = opened(part, [place for places in input_places.values() for place in places], "the exported blocks")
    schedule = whole.schedule
    _refuse_python(schedule)
    program = Program(
        name or (part.nodes[0].name if alone else "diagram"),
        schedule,
        tuple(signal_of(schedule, label, places, of_elements) for label, places in input_places.items()),
        tuple(signal_of(schedule, label, places, of_elements) for label, places in output_places.items()),
        tuple(replace(each, name=each.name.removeprefix(prefix)) for each in tunables_of(schedule, alone, units)),
    )
    named_sides = [
        (names, what) for names, what in ((inputs, "input"), (outputs, "output")) if isinstance(names, Mapping)
    ]
    return _with_names(
        program, [(new, what) for names, what in named_sides for old, new in names.items() if new != old]
    )


def _within(subsystem: Node, names: Names | None, ports: Sequence[Port]) -> dict[str, str]:
    """Return the names of signals of a subsystem in its diagram, each with its name in the export; by default of its ports."""
    if names is None:
        names = [port.name for port in ports]
    given = [names] if isinstance(names, str) else names
    renamed = given if isinstance(given, Mapping) else {name: name for name in given}
    return {f"{subsystem.name}.{name}": new for name, new in renamed.items()}


def _ports(part: Diagram, side: Literal["inputs", "outputs"]) -> dict[str, Places]:
    """Return all ports of a side by name, with the block's name before it if there are several blocks."""
    alone = len(part.nodes) == 1
    return {
        port.name if alone else f"{node.name}.{port.name}": tuple((node, port, i) for i in range(port.size))
        for node in part.nodes
        for port in getattr(node.block, side)
    }


def _program_inputs(part: Diagram, names: Names | None) -> dict[str, Places]:
    """Return the inputs of the program."""
    unfed: dict[str, Places] = {}
    for label, places in _ports(part, "inputs").items():
        unfed |= _unfed(part, label, places)
    if names is not None:
        result = _named(unfed, names, "input")
    else:  # inputs whose start value FMI cannot write keep it, unless they are requested
        result = {name: at for name, at in unfed.items() if np.isfinite(np.asarray(at[0][1].default or 0.0)).all()}
    included = {place for places in result.values() for place in places}
    for signal, (place, *_) in unfed.items():
        if place[1].default is None and place[1].draw is None and place not in included:
            raise ModelError(f"The input {signal} has neither a source nor a start value; include it in the inputs.")
    return result


def _refuse_python(schedule: Schedule) -> None:
    for node, definition in zip(schedule.nodes, schedule.definitions, strict=True):
        if definition is not None and not definition.compiled:
            raise ModelError(
                f"The block {node.name!r} ({type(node.block).__name__}) calls Python, which is not available in the exported C. "
                "Write a plant or a block of your own as step functions (docs/how-to/own-plant-in-python.md). For detection use "
                "a classifier that is linear in its features; for filters, filter='own'."
            )
        for kernel in (definition.output, definition.update) if definition is not None else ():
            for function in foreign_functions(kernel) if isinstance(kernel, FunctionType) else ():
                raise ModelError(
                    f"The block {node.name!r} ({type(node.block).__name__}) calls {function.title} in its step, and the "
                    "exported C cannot contain it. Export a block whose model is written as step functions, "
                    "NonlinearModel(f, g, ...), or linear (LinearModel.from_fmu)."
                )


def _as_diagram(exported: Block | Diagram, dt: float | str | Fraction | None) -> Diagram:
    if isinstance(exported, Diagram):
        return exported
    if not isinstance(exported, Block):
        raise ModelError(f"Only a block or a diagram can be exported, not {exported!r}.")
    step = sample_time_of(exported) if dt is None else rational_step(dt)
    if step is None:
        raise ModelError(f"{type(exported).__name__} has no sample time; give dt=... in seconds.")
    diagram = Diagram(step)
    diagram.add(exported)
    return diagram


def _part(diagram: Diagram, blocks: Sequence[str] | str | None) -> Diagram:
    """Return a diagram of some blocks of another one, with the largest possible base step."""
    requested = [blocks] if isinstance(blocks, str) else list(diagram._nodes if blocks is None else blocks)
    nodes = [diagram[name] for name in with_inside(diagram, requested)]
    if not nodes:
        raise ModelError("There is no block to export; name at least one.")
    for node in nodes:
        if is_external(node):
            raise ModelError(
                f"The block {node.name!r} is an FMU, which cannot be exported again. Export the blocks around it, and connect "
                "both in the tool that runs them."
            )
    return part_of(diagram, requested)


def _unfed(part: Diagram, label: str, places: Places) -> dict[str, Places]:
    """Return the unconnected part of an input: all of it as one signal, or its elements one by one."""
    unfed = [place for place in places if next(part.origins_of(*place), None) is None]
    if len(unfed) == len(places):
        return {label: places}
    names = labels(label, places[0][1].shape)
    return {names[i]: ((node, port, i),) for node, port, i in unfed}


def _named(available: Mapping[str, Places], names: Names | None, what: str) -> dict[str, Places]:
    if names is None:
        return dict(available)
    requested = [names] if isinstance(names, str) else names
    renamed = names if isinstance(names, Mapping) else {name: name for name in requested}
    elements = {element: place for label, places in available.items() for element, place in _elements(label, places)}
    for name in renamed:
        if name not in available and name not in elements:
            raise UnknownNameError(f"The export has no {what} {name!r}; {did_you_mean(name, available)}")
    if len(set(renamed.values())) < len(requested):
        raise ModelError(
            f"Two {what}s of the export have one name ({', '.join(renamed.values())}); rename one of them."
        )
    chosen = {label: available.get(name) or OneElement((elements[name],)) for name, label in renamed.items()}
    used: set[tuple[str, str, int]] = set()
    for label, places in chosen.items():
        places_used = {(node.name, port.name, i) for node, port, i in places}
        if used & places_used:
            raise ModelError(f"The {what} {label!r} of the export is part of another one; name each element once.")
        used |= places_used
    return chosen


def _elements(label: str, places: Places) -> Iterator[tuple[str, Place]]:
    """Yield the elements of a signal that is a whole port, each with its name."""
    _, port, _ = places[0]
    if len(places) == port.size and port.shape:
        yield from zip(labels(label, port.shape), places, strict=True)


def _with_names(program: Program, given: Sequence[tuple[str, str]]) -> Program:
    """Return the program with names that FMI and C allow, for all signals and parameters; the user's names stay."""
    for name, what in given:
        check(name, what)
    groups = program.inputs, program.outputs, program.tunables
    signals = [each for group in groups for each in group]
    # First the user's names are reserved, then legal names; the others are changed.
    fixed = {name for name, _ in given}
    names_now = [each.name for each in signals]
    order = sorted(range(len(signals)), key=lambda i: (names_now[i] not in fixed, legal(names_now[i]) != names_now[i]))
    names = dict(zip(order, unique((signals[i].name, signals[i].shape) for i in order), strict=True))
    renamed = iter([replace(each, name=names[i]) for i, each in enumerate(signals)])
    inputs, outputs, tunables = (tuple(islice(renamed, len(group))) for group in groups)
    final_names = {"input": {each.name for each in inputs}, "output": {each.name for each in outputs}}
    for name, what in given:
        if name not in final_names[what]:
            raise ModelError(
                f"An {what} of the export cannot be named {name!r}: another signal, the time or the C code has that name. Give "
                "it another name."
            )
    return replace(program, inputs=inputs, outputs=outputs, tunables=tunables)  # type: ignore[arg-type]
