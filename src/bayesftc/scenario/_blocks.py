"""Further blocks of a scenario, their connections, and subsystems: ``[blocks.<name>]``, ``[[connections]]``."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from bayesftc.controllers.registry import LAWS
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.faults.kinds import FAULTS, Fault
from bayesftc.cosim.blocks.kinds import BLOCKS
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.subsystem import Subsystem, port_named
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.scenario._fmu_files import fmu_of
from bayesftc.scenario._linear_plant import linear_plant
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build, choose, convert

KINDS = (*BLOCKS, *FAULTS, *LAWS, StateSpace, FMU, Subsystem)
"""Kinds of ``[blocks.<name>]``."""

Added = Mapping[str, tuple[Block, int]]
"""Blocks by name, each with its ``every``."""
Connection = tuple[tuple[str, ...], str]


@dataclass(frozen=True)
class Surroundings:
    """What the blocks of a file depend on: its folder, and the base step of the diagram that gets them."""

    folder: Path
    step: Fraction

    def slower(self, every: int) -> Surroundings:
        """Return the surroundings inside a subsystem that runs at every n-th step."""
        return Surroundings(self.folder, self.step * every)


@dataclass(frozen=True)
class Ports:
    """The ports of a subsystem; see `bayesftc.cosim.Subsystem`.

    Attributes
    ----------
    inputs : table, optional
        For each input its ports inside, one or a list; by default the inputs inside that are not connected.
    outputs : table, optional
        For each output its port inside; by default the outputs inside that are not connected.
    goals : list of text, optional
        Of a controller: the measured quantity of each element of its goal. Not needed where each quantity has a goal.
    """

    inputs: Mapping[str, str | Sequence[str]] | None = None
    outputs: Mapping[str, str | Sequence[str]] | None = None
    goals: Sequence[str] = ()


def blocks(table: object, place: Place, around: Surroundings, taken: Collection[str] = ()) -> Added:
    """Return the blocks of ``[blocks.<name>]``; a name that is `taken` is refused."""
    added = {}
    for name, value in as_table(table, place).items():
        at = place / name
        if not re.fullmatch(r"\w+", name) or name in taken:
            why = "is a section" if name in taken else "has other characters than letters, digits and _"
            raise at.error(f"cannot be the name of a block, because it {why}. Choose another name.")
        rest = dict(as_table(value, at))
        every = _every(rest.pop("every", 1), at / "every")
        added[name] = _block(rest, at, around.slower(every)), every
    return added


def _every(value: object, place: Place) -> int:
    every: int = convert(value, int, place)
    if every < 1:
        raise place.error(f"is {every}; it must be at least 1: the block runs at every n-th step.")
    return every


def _block(table: Mapping[str, Any], place: Place, around: Surroundings) -> Block:
    if "fmu" in table and table.get("kind") != "FMU":  # then `kind` is that of the FMU, such as "model exchange"
        return fmu_of(dict(table), place, around.folder)
    cls, rest = choose(KINDS, table, place)
    if cls is Subsystem:
        return subsystem(rest, place, around)
    if cls is FMU:
        return fmu_of(rest, place, around.folder)
    if cls is StateSpace:
        return linear_plant(rest, place, known=())
    if issubclass(cls, Fault):  # type: ignore[arg-type]
        if "name" in rest:
            raise (place / "name").error("has no effect, because the section names the block. Leave it out.")
        rest.setdefault("channels", 1)
    return build(cls, rest, place, of_kind=True)  # type: ignore[no-any-return]


def subsystem(table: Mapping[str, Any], place: Place, around: Surroundings) -> Subsystem:
    """Return a subsystem: the blocks and connections inside, and its ports."""
    place.refuse_unknown(table, ["inputs", "outputs", "goals", "blocks", "connections"])
    diagram = Diagram(around.step)
    if not table.get("blocks"):
        raise place.error(f"is a subsystem without blocks. Add [{place.key}.blocks.<name>] with its kind.")
    for name, (block, every) in blocks(table["blocks"], place / "blocks", around).items():
        with (place / "blocks" / name).named():
            diagram.add(block, name, every)
    at = place / "connections"
    for i, (sources, target) in enumerate(connections(table.get("connections", []), at)):
        with (at / i).named():
            diagram.connect([port_named(diagram, source) for source in sources], port_named(diagram, target))
    given: Ports = build(Ports, {name: table[name] for name in ("inputs", "outputs", "goals") if name in table}, place)
    with place.named():
        return Subsystem(diagram, _lists(given.inputs), _lists(given.outputs), given.goals)


def _lists(ports: Mapping[str, str | Sequence[str]] | None) -> Mapping[str, Any] | None:
    return None if ports is None else {name: p if isinstance(p, str) else list(p) for name, p in ports.items()}


def connections(value: object, place: Place) -> list[Connection]:
    """Return the connections of ``[[connections]]``: the names of the sources, and that of the input."""
    if not isinstance(value, list):
        raise place.error(f"must be a list of tables. Write [[{place.key}]], with two brackets, above each connection.")
    made = []
    for i, given in enumerate(value):
        at, table = place / i, as_table(given, place / i)
        at.refuse_unknown(table, ["from", "to"])
        for key in ("from", "to"):
            if key not in table:
                raise at.error(f"lacks {key!r}. Write from = 'controller.u' and to = 'limiter.u', with your ports.")
        sources = convert(table["from"], str | Sequence[str], at / "from")
        if not sources:
            raise (at / "from").error("names no output. Name at least one, such as 'controller.u'.")
        made.append(((sources,) if isinstance(sources, str) else tuple(sources), convert(table["to"], str, at / "to")))
    return made


def faults_among(added: Added, place: str = "blocks") -> Iterator[tuple[str, Fault]]:
    """Yield the place and the fault of each block that is one, also inside subsystems."""
    for name, (block, _) in added.items():
        if isinstance(block, Fault):
            yield f"{place}.{name}", block
        if isinstance(block, Subsystem):
            for node in block.diagram.nodes:  # a block of a subsystem inside has a dot in its name
                if isinstance(node.block, Fault):
                    yield f"{place}.{name}.blocks.{node.name.replace('.', '.blocks.')}", node.block
