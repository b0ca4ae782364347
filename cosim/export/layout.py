"""Where the numbers of a program lie in C: what changes in one array, what never does in tables, what can be tuned by name."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.export.names import in_c
from bayesftc.cosim.export.program import Program
from bayesftc.cosim.export.signals import Signal, Tunable
from bayesftc.cosim.stepping.translate.functions import Functions, table_text
from bayesftc.cosim.stepping.translate.kinds import same
from bayesftc.cosim.types import Floats


def member(signal: Signal | Tunable) -> str:
    """Return what a signal or a parameter is called in its structure."""
    return in_c(signal.name)


class Layout:
    """The places of a program's numbers.

    Parameters
    ----------
    program : Program
        The program.
    functions : Functions
        The functions of its file, among whose names the tables have theirs.

    Attributes
    ----------
    initial : ndarray
        The array of what changes, at the beginning.
    tables : dict of str to (str, int)
        The texts of the tables by their names, and how many numbers each has.
    """

    def __init__(self, program: Program, functions: Functions):
        self._slots, self._tuned = program.schedule.slots, {(t.node, t.parameter): t for t in program.tunables}
        self._parts = [t for t in program.tunables if t.parameter is None]
        mixed = {(t.node, name) for t in self._parts for places in t.places for name, _ in places}
        self._places: dict[int, int] = {}  # from the schedule's memory to the array
        self._tables: dict[tuple[int, str], str] = {}
        self._brought: dict[int, str] = {}  # what comes from outside, by its place in the schedule's memory
        self.tables: dict[str, tuple[str, int]] = {}
        values = program.schedule.initial
        for i, node in enumerate(program.schedule.nodes):
            if node.name == OUTSIDE:
                begin = self._slots[i].start["outputs"]
                elements = [f"u->{member(signal)}[{e}]" for signal in program.inputs for e in range(len(signal.places))]
                self._brought = {begin + j: text for j, text in enumerate(elements)}
                continue
            for name, (section, offset, shape) in self._slots[i].sections.items():
                begin, size = self._slots[i].start[section] + offset, _size(shape)
                if section != "parameters" or (i, name) in mixed:
                    if name not in {"inputs", "outputs"}:  # which are all of them once more
                        self._places |= {begin + j: len(self._places) + j for j in range(size)}
                elif size and (i, name) not in self._tuned:
                    table = self._tables[i, name] = functions.name(f"{node.name}_{name}")
                    self.tables[table] = table_text(table, values[begin : begin + size].tolist()), size
        self.initial: Floats = np.zeros(max(len(self._places), 1))
        for place, at in self._places.items():
            self.initial[at] = values[place]

    def runs(self) -> list[tuple[int, int, float]]:
        """Return where the array is not zero at the beginning: places of equal value, as (first, how many, value)."""
        found: list[tuple[int, int, float]] = []
        for at, value in enumerate(self.initial.tolist()):
            if found and sum(found[-1][:2]) == at and same(found[-1][2], value):
                found[-1] = found[-1][0], found[-1][1] + 1, value
            elif not same(value, 0.0):
                found.append((at, 1, value))
        return found

    def tuned(self) -> list[str]:
        """Return the lines that bring tunable numbers to where step functions find them among others."""
        return [
            f"m[{self._places[self._slots[t.node].offset(name) + e]}] = c->parameters.{member(t)}[{j}];"
            for t in self._parts
            for j, places in enumerate(t.places)
            for name, e in places
        ]

    def pointer(self, i: int, name: str) -> str:
        """Return where the numbers of an argument of block `i` begin."""
        section, offset, shape = self._slots[i].sections[name]
        if (i, name) in self._tuned:
            return f"c->parameters.{member(self._tuned[i, name])}"
        if (i, name) in self._tables:
            return self._tables[i, name]
        at = self._places[self._slots[i].start[section] + offset] if _size(shape) else 0
        return f"m + {at}" if at else "m"

    def element(self, place: int) -> str:
        """Return the number at a place of the schedule's memory."""
        return self._brought.get(place) or f"m[{self._places[place]}]"


def _size(shape: tuple[Any, ...]) -> int:
    return int(prod(shape))
