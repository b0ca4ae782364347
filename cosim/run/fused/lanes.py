"""The loop of one diagram for several runs in lock step, as a function in LLVM's text format.

The runs have the same diagram and parameters, and different seeds. Each is in one lane of the vector registers
(`bayesftc.cosim.stepping.machine.lanes`), with the same bits as a run alone. What no random number and no FMU reaches is the same
in all runs and computed once. FMUs, and all else that is called by address, are called run by run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.run.fused.text import STEP_FUNCTION, Loop, Text
from bayesftc.cosim.run.general.program import (
    CHECK_FROM,
    CHECK_TO,
    COLUMNS,
    FUNCTION,
    INPUTS,
    OUTPUTS,
    PARAMETERS,
    STATE,
)

FAILED = -1
"""What the function returns if any run fails. It does not tell which: these runs are then made one by one."""

_HEAD = """define i64 @{name}(ptr noalias %wide, ptr noalias readonly %calls, ptr noalias readonly %buffer,
    ptr noalias %recording, ptr noalias %memory, i64 %stride, i64 %first, i64 %begin, i64 %end) {{"""


class Home(Enum):
    """Where the numbers of a node are."""

    SAME = "in the first run's memory, as they are the same in all runs"
    WIDE = "side by side, in an array with all lanes of each number"
    OWN = "in each run's own memory"


@dataclass(frozen=True)
class Lanes:
    """What the text of such a loop depends on, beside the loop.

    Attributes
    ----------
    count : int
        Number of runs.
    nodes : tuple of int
        For each call, its node.
    begins : tuple of int
        For each node, its first place in memory; then the end of the last.
    size : int
        Number of places in memory.
    by_address : frozenset of int
        Nodes of which a step function is called by address.
    sections : tuple of (int, int)
        First place and end of each node's inputs and outputs.
    lasting : frozenset of int
        Places in these sections from which a later step may read.
    """

    count: int
    nodes: tuple[int, ...]
    begins: tuple[int, ...]
    size: int
    by_address: frozenset[int]
    sections: tuple[tuple[int, int], ...]
    lasting: frozenset[int]

    def homes(self, loop: Loop) -> list[Home]:
        """Return the home of each node."""
        homes = [Home.OWN if i in self.by_address else Home.SAME for i in range(len(self.begins) - 1)]
        differ = {self.node_of(place) for place in loop.drawn} | self.by_address | {len(self.begins) - 1}
        while True:
            before = len(differ)
            for node, gathers in zip(self.nodes, loop.gathers, strict=True):
                if any(self.node_of(source) in differ for _, source in gathers):
                    differ.add(node)
            if len(differ) == before:
                break
        return [Home.WIDE if home is Home.SAME and i in differ else home for i, home in enumerate(homes)]

    def node_of(self, place: int) -> int:
        """Return the node to which a place in memory belongs; the number of nodes for what belongs to none."""
        return bisect_right(self.begins, place) - 1


def text_of_lanes(loop: Loop, lanes: Lanes, name: str) -> str:
    """Return the function `name` for several runs of a loop; it calls step functions that `wide_name` names."""
    return _LanesText(loop, lanes).text(name)


def wide_name(function: str) -> str:
    """Return the name of a step function's form for several runs."""
    return f"{function}_lanes"


class _LanesText(Text):
    head = _HEAD

    def __init__(self, loop: Loop, lanes: Lanes):
        super().__init__(loop, ())
        self._lanes, self._homes = lanes, [*lanes.homes(loop), Home.OWN]
        self._count, self._vector = lanes.count, f"<{lanes.count} x double>"
        # Inputs and outputs are in arrays of this function alone: LLVM then leaves out what nobody reads. States are not: they
        # would need more registers than there are.
        self._local = [
            (begin, end)
            for begin, end in lanes.sections
            if begin < end and self._homes[lanes.node_of(begin)] is Home.WIDE
        ]
        self._begins = [begin for begin, _ in self._local]

    def _declared(self) -> list[str]:
        used = set()
        for function, node in zip(self._loop.functions, self._lanes.nodes, strict=True):
            if function and self._homes[node] is not Home.OWN:
                used.add(function if self._homes[node] is Home.SAME else wide_name(function))
        return [f"declare {STEP_FUNCTION.format(function)}" for function in sorted(used)]

    def _home(self, place: int) -> Home:
        return self._homes[self._lanes.node_of(place)]

    # Arrays of this function alone

    def _begin(self) -> None:
        for i, (begin, end) in enumerate(self._local):
            self._lines.append(f"  %local.{i} = alloca [{end - begin} x {self._vector}], align 64")
        self._move(self._shared_element, self._wide_element)
        super()._begin()

    def _finish(self) -> None:
        self._move(self._wide_element, self._shared_element)

    def _move(self, source: Callable[[int], str], target: Callable[[int], str]) -> None:
        """Copy what lasts between the caller's array and those of this function."""
        for begin, end in self._local:
            for place in range(begin, end):
                if place in self._lanes.lasting:
                    number = self._value(f"load {self._vector}, ptr {source(place)}")
                    self._lines.append(f"  store {self._vector} {number}, ptr {target(place)}")

    # Numbers

    def _wide_element(self, place: int) -> str:
        i = bisect_right(self._begins, place) - 1
        if i >= 0 and place < self._local[i][1]:
            return self._element(f"%local.{i}", place - self._begins[i], self._vector)
        return self._shared_element(place)

    def _shared_element(self, place: int) -> str:
        return self._element("%wide", place, self._vector)

    def _own_element(self, place: int, lane: int) -> str:
        return self._element("%memory", lane * self._lanes.size + place)

    def _read(self, place: int) -> str:
        """Return a number of all runs as a vector."""
        home = self._home(place)
        if home is Home.WIDE:
            return self._value(f"load {self._vector}, ptr {self._wide_element(place)}")
        if home is Home.OWN:
            return self._joined(self._own(place))
        one = self._value(f"insertelement {self._vector} poison, double {self._load(place)}, i64 0")
        zeros = f"<{self._count} x i32> zeroinitializer"
        return self._value(f"shufflevector {self._vector} {one}, {self._vector} poison, {zeros}")

    def _own(self, place: int) -> list[str]:
        """Return a number of each run."""
        home = self._home(place)
        if home is Home.SAME:
            return [self._load(place)] * self._count
        if home is Home.OWN:
            return [self._value(f"load double, ptr {self._own_element(place, lane)}") for lane in range(self._count)]
        vector = self._read(place)
        return [self._value(f"extractelement {self._vector} {vector}, i64 {lane}") for lane in range(self._count)]

    def _joined(self, numbers: Sequence[str]) -> str:
        vector = "poison"
        for lane, number in enumerate(numbers):
            vector = self._value(f"insertelement {self._vector} {vector}, double {number}, i64 {lane}")
        return vector

    def _write(self, place: int, numbers: Sequence[str]) -> None:
        """Store a number of each run."""
        if self._home(place) is Home.WIDE:
            self._lines.append(f"  store {self._vector} {self._joined(numbers)}, ptr {self._wide_element(place)}")
            return
        for lane, number in enumerate(numbers):
            self._lines.append(f"  store double {number}, ptr {self._own_element(place, lane)}")

    # Parts of a step

    def _gather(self, target: int, source: int) -> None:
        home = self._home(target)
        if home is Home.SAME:
            super()._gather(target, source)
        elif home is Home.WIDE:
            self._lines.append(f"  store {self._vector} {self._read(source)}, ptr {self._wide_element(target)}")
        else:
            self._write(target, self._own(source))

    def _draw(self) -> None:
        if not self._loop.drawn:
            return
        column = self._value(f"and i64 %k.e, {CHUNK - 1}")
        for j, place in enumerate(self._loop.drawn):
            numbers = []
            for lane in range(self._count):
                first = (lane * (len(self._loop.drawn) + SPARE) + j) * CHUNK
                at = self._element("%buffer", self._value(f"add i64 {column}, {first}"))
                numbers.append(self._value(f"load double, ptr {at}"))
            self._write(place, numbers)

    def _record_row(self, row: str) -> None:
        begin = self._value(f"mul i64 {row}, {len(self._loop.recorded)}")
        rows = []
        for lane in range(self._count):
            first = self._value(f"add i64 {begin}, {self._value(f'mul i64 %stride, {lane}')}")
            rows.append(self._element("%recording", first))
        for j, place in enumerate(self._loop.recorded):
            for at, number in zip(rows, self._own(place), strict=True):
                self._copy(number, at, j)

    def _function(self, c: int, phase: str, count: str) -> None:
        row, home = self._loop.rows[c], self._homes[self._lanes.nodes[c]]
        if home is Home.OWN:
            for lane in range(self._count):
                sections = [self._own_element(row[s], lane) for s in (STATE, PARAMETERS, INPUTS, OUTPUTS)]
                place = (lane * len(self._loop.rows) + c) * COLUMNS + FUNCTION
                self._by_address(place, sections, (c, phase, count), f"{c}.{lane}")
            return
        function = self._loop.functions[c]
        if home is Home.WIDE:
            function = wide_name(function)
            parameters = self._element("%memory", row[PARAMETERS])
            state, inputs, outputs = (self._wide_element(row[section]) for section in (STATE, INPUTS, OUTPUTS))
            sections = [state, parameters, inputs, outputs]
        else:
            sections = [self._element("%memory", row[s]) for s in (STATE, PARAMETERS, INPUTS, OUTPUTS)]
        self._by_name(function, sections, phase, count)

    def _check(self, c: int, phase: str) -> None:
        row = self._loop.rows[c]
        for place in range(row[CHECK_FROM], row[CHECK_TO]):
            home = self._home(place)
            kind = self._vector if home is not Home.SAME else "double"
            value = self._read(place) if home is not Home.SAME else self._load(place)
            zero = self._value(f"fsub {kind} {value}, {value}")
            fails = self._value(f"fcmp une {kind} {zero}, {'zeroinitializer' if home is not Home.SAME else '0.0'}")
            if home is not Home.SAME:
                bits = self._value(f"bitcast <{self._count} x i1> {fails} to i{self._count}")
                fails = self._value(f"icmp ne i{self._count} {bits}, 0")
            self._fail_if(fails, c, phase, "", f"{c}.{place}")

    def _fail_if(self, condition: str, c: int, phase: str, status: str, label: str) -> None:
        self._branch(condition, "failed", f"well.{label}.{phase}")
        self._label(f"well.{label}.{phase}")

    def _end(self) -> list[str]:
        return ["failed:", f"  ret i64 {FAILED}"]
