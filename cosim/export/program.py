"""What is exported: a block or some blocks of a diagram, as all that their C is written from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from math import gcd
from typing import Literal

import numpy as np

from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block
from bayesftc.cosim.diagram.diagram import Diagram, is_external
from bayesftc.cosim.diagram.opening import OUTSIDE, Names, opened
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.export.names import check, legal, unique
from bayesftc.cosim.export.signals import OneElement, Place, Places, Signal, Tunable, signal_of, tunables_of
from bayesftc.cosim.export.units import units_of
from bayesftc.cosim.ports import labels


@dataclass(frozen=True)
class Program:
    """Blocks that become one step function.

    Parameters
    ----------
    name : str
        What it is called.
    schedule : Schedule
        The order of calls and the layout of memory; the inputs come out of a block called ``<outside>``, element by element.
    inputs, outputs : tuple of Signal
        What goes in and what comes out at each step.
    tunables : tuple of Tunable
        What can be changed between steps.
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
        What to export.
    name : str, optional
        Its name; by default the block's.
    blocks : sequence of str, optional
        Those of a diagram; by default all.
    inputs, outputs : names, optional
        Which of the signals the outside sees, a mapping gives new names; by default all inputs that nothing within feeds, random
        ones too, and all outputs. Called as their ports, with the block's name before it where there are several blocks.
    dt : float, str or Fraction, optional
        The sample time of a block that has none of its own.

    Raises
    ------
    ModelError
        If there is something in it that cannot be exported.
    UnknownNameError
        If there is no block or signal of that name.
    """
    diagram = _as_diagram(exported, dt)
    part, units = _part(diagram, blocks), units_of(diagram)
    alone = len(part.nodes) == 1
    given, shown = _taken_in(part, inputs), _named(_ports(part, "outputs"), outputs, "output")
    whole, _ = opened(part, [place for places in given.values() for place in places], "the exported blocks")
    schedule = whole.schedule
    _refuse_python(schedule)
    program = Program(
        name or (part.nodes[0].name if alone else "diagram"),
        schedule,
        tuple(signal_of(schedule, label, places, units) for label, places in given.items()),
        tuple(signal_of(schedule, label, places, units) for label, places in shown.items()),
        tuple(tunables_of(schedule, alone, units)),
    )
    called = [(names, what) for names, what in ((inputs, "input"), (outputs, "output")) if isinstance(names, Mapping)]
    return _with_names(program, [(new, what) for names, what in called for old, new in names.items() if new != old])


def _ports(part: Diagram, side: Literal["inputs", "outputs"]) -> dict[str, Places]:
    """Return all ports of a side, called as they are in their block, with its name before where there are several blocks."""
    alone = len(part.nodes) == 1
    return {
        port.name if alone else f"{node.name}.{port.name}": tuple((node, port, i) for i in range(port.size))
        for node in part.nodes
        for port in getattr(node.block, side)
    }


def _taken_in(part: Diagram, names: Names | None) -> dict[str, Places]:
    """Return the inputs that the outside sees."""
    unfed: dict[str, Places] = {}
    for label, places in _ports(part, "inputs").items():
        unfed |= _unfed(part, label, places)
    if names is not None:
        found = _named(unfed, names, "input")
    else:  # what has no start value that FMI can write stays what it is, unless it is asked for
        found = {name: at for name, at in unfed.items() if np.isfinite(np.asarray(at[0][1].default or 0.0)).all()}
    brought = {place for places in found.values() for place in places}
    for signal, (place, *_) in unfed.items():
        if place[1].default is None and place[1].draw is None and place not in brought:
            raise ModelError(f"The input {signal} has neither a source nor a start value; leave it among the inputs.")
    return found


def _refuse_python(schedule: Schedule) -> None:
    for node, definition in zip(schedule.nodes, schedule.definitions, strict=True):
        if definition is not None and not definition.compiled:
            raise ModelError(
                f"The block {node.name!r} ({type(node.block).__name__}) calls back into Python, which the exported C has not; "
                "write its step function by the rules of step functions (docs/write-a-block.md), without compiled=False; of "
                "classifiers take one that is linear in its features, of filters filter='own'."
            )


def _as_diagram(exported: Block | Diagram, dt: float | str | Fraction | None) -> Diagram:
    if isinstance(exported, Diagram):
        return exported
    if not isinstance(exported, Block):
        raise ModelError(f"Only a block or a diagram can be exported, not {exported!r}.")
    step = exported.sample_time if dt is None else rational_step(dt)
    if step is None:
        raise ModelError(f"{type(exported).__name__} does not know its sample time; give dt=... in seconds.")
    diagram = Diagram(step)
    diagram.add(exported)
    return diagram


def _part(diagram: Diagram, blocks: Sequence[str] | str | None) -> Diagram:
    """Return a diagram of some blocks of another one, at the slowest step at which all of them run."""
    wanted = [blocks] if isinstance(blocks, str) else list(diagram._nodes if blocks is None else blocks)
    nodes = [diagram[name] for name in diagram._nodes if name in {diagram[each].name for each in wanted}]
    if not nodes:
        raise ModelError("There is no block to export; name at least one.")
    for node in nodes:
        if is_external(node):
            raise ModelError(
                f"The block {node.name!r} is an FMU ({type(node.block).__name__}), which has C of its own; export the blocks "
                "around it, and connect both in the tool that runs them."
            )
    every = gcd(*(node.every for node in nodes))
    part = Diagram(diagram.step * every)
    new = {node.name: part.add(node.block, node.name, node.every // every) for node in nodes}
    for (name, port, element), (source, taken) in diagram._sources.items():
        if name in new and source.node.name in new:
            part._sources[name, port, element] = new[source.node.name][source.port.name], taken
    return part


def _unfed(part: Diagram, label: str, places: Places) -> dict[str, Places]:
    """Return what of an input nothing feeds: all of it as one signal, or its elements one by one."""
    unfed = [place for place in places if part.source_of(*place) is None]
    if len(unfed) == len(places):
        return {label: places}
    names = labels(label, places[0][1].shape)
    return {names[i]: ((node, port, i),) for node, port, i in unfed}


def _named(found: Mapping[str, Places], names: Names | None, what: str) -> dict[str, Places]:
    if names is None:
        return dict(found)
    listed = [names] if isinstance(names, str) else names
    renamed = names if isinstance(names, Mapping) else {name: name for name in listed}
    elements = {element: place for label, places in found.items() for element, place in _elements(label, places)}
    for name in renamed:
        if name not in found and name not in elements:
            raise UnknownNameError(f"What is exported has no {what} {name!r}; {did_you_mean(name, found)}")
    if len(set(renamed.values())) < len(listed):
        raise ModelError(f"Two {what}s of what is exported would have one name ({', '.join(renamed.values())}).")
    chosen = {label: found.get(name) or OneElement((elements[name],)) for name, label in renamed.items()}
    taken: set[tuple[str, str, int]] = set()
    for label, places in chosen.items():
        new = {(node.name, port.name, i) for node, port, i in places}
        if taken & new:
            raise ModelError(
                f"The {what} {label!r} of what is exported is part of another one; name each element once."
            )
        taken |= new
    return chosen


def _elements(label: str, places: Places) -> Iterator[tuple[str, Place]]:
    """Yield the elements of a signal that is a whole port, each with the name that it has alone."""
    _, port, _ = places[0]
    if len(places) == port.size and port.shape:
        yield from zip(labels(label, port.shape), places, strict=True)


def _with_names(program: Program, given: Sequence[tuple[str, str]]) -> Program:
    """Return the program with names for all signals and parameters that FMI and C allow; those that were given stay."""
    for name, what in given:
        check(name, what)
    groups = program.inputs, program.outputs, program.tunables
    everything = [each for group in groups for each in group]
    # What was given keeps its name, then what is legal as it is, and the others make way.
    fixed = {name for name, _ in given}
    names_now = [each.name for each in everything]
    order = sorted(
        range(len(everything)), key=lambda i: (names_now[i] not in fixed, legal(names_now[i]) != names_now[i])
    )
    names = dict(zip(order, unique((everything[i].name, everything[i].shape) for i in order), strict=True))
    renamed = iter([replace(each, name=names[i]) for i, each in enumerate(everything)])
    inputs, outputs, tunables = (tuple(islice(renamed, len(group))) for group in groups)
    kept = {"input": {each.name for each in inputs}, "output": {each.name for each in outputs}}
    for name, what in given:
        if name not in kept[what]:
            raise ModelError(
                f"The {what} of what is exported cannot be called {name!r}: another signal, the time or the C itself has that "
                "name; give it another one."
            )
    return replace(program, inputs=inputs, outputs=outputs, tunables=tunables)  # type: ignore[arg-type]
