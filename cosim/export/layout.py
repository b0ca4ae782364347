"""The memory layout of a program in C: variables in one array, constants in tables, tunable parameters by name."""

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
    """Return the name of a signal or a parameter in its structure."""
    return in_c(signal.name)


class Layout:
    """The places of a program's numbers.

    Parameters
    ----------
    program : Program
        The program.
    functions : Functions
        The functions of its file, which also reserve the names of tables.

    Attributes
    ----------
    initial : ndarray
        The initial values of the array.
    tables : dict of str to (str, int)
        The text and the size of each table, by name.
    """

    def __init__(self, program: Program, functions: Functions):
        self._slots, self._tuned = program.schedule.slots, {(t.node, t.parameter): t for t in program.tunables}
        self._parts = [t for t in program.tunables if t.parameter is None]
        mixed = {(t.node, name) for t in self._parts for places in t.places for name, _ in places}
        self._places: dict[int, int] = {}  # from the schedule's memory to the array
        self._tables: dict[tuple[int, str], str] = {}
        self._brought: dict[int, str] = {}  # inputs of the program, by index in the schedule's memory
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
                    if name not in {"inputs", "outputs"}:  # these contain all ports again
                        self._places |= {begin + j: len(self._places) + j for j in range(size)}
                elif size and (i, name) not in self._tuned:
                    table = self._tables[i, name] = functions.name(f"{node.name}_{name}")
                    self.tables[table] = table_text(table, values[begin : begin + size].tolist()), size
        self.initial: Floats = np.zeros(max(len(self._places), 1))
        for place, at in self._places.items():
            self.initial[at] = values[place]

    def runs(self) -> list[tuple[int, int, float]]:
        """Return the initial values that are not zero, in runs of equal values: (first index, count, value)."""
        result: list[tuple[int, int, float]] = []
        for at, value in enumerate(self.initial.tolist()):
            if result and sum(result[-1][:2]) == at and same(result[-1][2], value):
                result[-1] = result[-1][0], result[-1][1] + 1, value
            elif not same(value, 0.0):
                result.append((at, 1, value))
        return result

    def tuned(self) -> list[str]:
        """Return the lines that copy tunable numbers into parameters that also have other numbers."""
        return [
            f"m[{self._places[self._slots[t.node].offset(name) + e]}] = c->parameters.{member(t)}[{j}];"
            for t in self._parts
            for j, places in enumerate(t.places)
            for name, e in places
        ]

    def pointer(self, i: int, name: str) -> str:
        """Return the C pointer to an argument of block `i`."""
        section, offset, shape = self._slots[i].sections[name]
        if (i, name) in self._tuned:
            return f"c->parameters.{member(self._tuned[i, name])}"
        if (i, name) in self._tables:
            return self._tables[i, name]
        at = self._places[self._slots[i].start[section] + offset] if _size(shape) else 0
        return f"m + {at}" if at else "m"

    def element(self, place: int) -> str:
        """Return the C expression for an index of the schedule's memory."""
        return self._brought.get(place) or f"m[{self._places[place]}]"


def _size(shape: tuple[Any, ...]) -> int:
    return int(prod(shape))
