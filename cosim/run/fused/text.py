"""The loop of one diagram as a function in LLVM's text format: its calls one after the other, all places in memory constant.

It does the same as `bayesftc.cosim.run.general.loop` between two chunks of random numbers, in the same order and with the same
bits. What that function reads from tables at every step is written out here, so that LLVM puts the step functions into the loop,
keeps signals in registers, and finds what is computed twice.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

from bayesftc.cosim.diagram.schedule import NOT_FINITE
from bayesftc.cosim.random import CHUNK
from bayesftc.cosim.run.general.program import (
    CHECK_FROM,
    CHECK_TO,
    COLUMNS,
    EVERY,
    FUNCTION,
    INPUTS,
    OUTPUTS,
    PARAMETERS,
    STATE,
)

STEP_FUNCTION = "i32 @{}(ptr, ptr, ptr, ptr, double, i64)"
SERVICE = "i32 @{}(i64, i64, i64, i64, double, i64)"

_HEAD = """define i64 @{name}(ptr noalias %memory, ptr noalias readonly %calls, ptr noalias readonly %buffer,
    ptr noalias %recording, ptr noalias %failed, i64 %before, i64 %first, i64 %begin, i64 %end) {{"""


@dataclass(frozen=True)
class Loop:
    """What the text of a loop depends on.

    Attributes
    ----------
    rows : tuple of tuple of int
        The table of calls, with the columns of `bayesftc.cosim.run.general.program`.
    gathers : tuple of tuple of (int, int)
        For each call, the copies (target, source) before it.
    functions : tuple of str
        For each call, the name of its step function; empty for those that are called by the address in the table.
    services : tuple of str
        For each call, the name of the service function at that address, such as an FMU's, if its text is known; else empty.
    evaluations : int
        Number of calls that compute outputs; the others advance states.
    drawn, recorded : tuple of int
        Places in memory of the random numbers, and of what is recorded.
    decimation : int
        Steps between two recorded rows.
    clock : (int, int)
        Numerator and denominator of the step in seconds.
    """

    rows: tuple[tuple[int, ...], ...]
    gathers: tuple[tuple[tuple[int, int], ...], ...]
    functions: tuple[str, ...]
    services: tuple[str, ...]
    evaluations: int
    drawn: tuple[int, ...]
    recorded: tuple[int, ...]
    decimation: int
    clock: tuple[int, int]


def text_of_loop(loop: Loop, name: str, inlined: Container[str]) -> str:
    """Return the function `name` for a loop, in which the step functions of these names are called by name, others by address."""
    return Text(loop, inlined).text(name)


class Text:
    """The text of a loop for a single run."""

    head = _HEAD

    def __init__(self, loop: Loop, inlined: Container[str]):
        self._loop, self._inlined = loop, inlined
        self._lines: list[str] = []
        self._values = 0

    def text(self, name: str) -> str:
        """Return the function `name`."""
        loop = self._loop
        self._begin()
        self._label("evaluate")
        self._clock("e")
        self._draw()
        for c in range(loop.evaluations):
            self._call(c, "e")
        self._record()
        self._branch(self._value("icmp eq i64 %k.e, %end"), "finish", "step")
        self._label("finish")
        self._finish()
        self._lines.append("  ret i64 %end")
        self._label("step")
        self._clock("a")
        for c in range(loop.evaluations, len(loop.rows)):
            self._call(c, "a")
        self._lines += [f"  store i64 {self._value('add i64 %k.a, 1')}, ptr %place.k", "  br label %evaluate"]
        services = [f"declare {SERVICE.format(service)}" for service in sorted(set(loop.services) - {""})]
        return "\n".join(
            [*self._declared(), *services, self.head.format(name=name), *self._lines, *self._end(), "}", ""]
        )

    def _begin(self) -> None:
        """Go to the first thing to do. What follows a step's evaluation is one block, into which LLVM can follow its numbers."""
        self._lines += ["  %place.k = alloca i64", "  store i64 %begin, ptr %place.k"]
        if self._loop.decimation != 1:
            since = self._value(f"add i64 {self._value('sub i64 %begin, %first')}, {self._loop.decimation}")
            row = self._value(f"sdiv i64 {since}, {self._loop.decimation}")
            self._lines += ["  %place.row = alloca i64", f"  store i64 {row}, ptr %place.row"]
        self._branch(self._value("icmp ne i64 %first, 0"), "evaluate", "begun")
        self._label("begun")
        self._branch(self._value("icmp eq i64 %begin, %end"), "finish", "step")

    def _finish(self) -> None:
        """Write down what the next steps need."""

    def _declared(self) -> list[str]:
        used = sorted({f for f in self._loop.functions if f in self._inlined})
        return [f"declare {STEP_FUNCTION.format(function)}" for function in used]

    def _end(self) -> list[str]:
        return []

    def _value(self, operation: str) -> str:
        self._values += 1
        self._lines.append(f"  %v{self._values} = {operation}")
        return f"%v{self._values}"

    def _label(self, name: str) -> None:
        self._lines.append(f"{name}:")

    def _branch(self, condition: str, yes: str, no: str) -> None:
        self._lines.append(f"  br i1 {condition}, label %{yes}, label %{no}")

    def _element(self, array: str, place: int | str, kind: str = "double") -> str:
        return self._value(f"getelementptr {kind}, ptr {array}, i64 {place}")

    def _load(self, place: int) -> str:
        return self._value(f"load double, ptr {self._element('%memory', place)}")

    def _copy(self, value: str, array: str, place: int) -> None:
        self._lines.append(f"  store double {value}, ptr {self._element(array, place)}")

    def _clock(self, phase: str) -> None:
        """Load k, and compute the double nearest to the time of step k: the quotient of two exact integers."""
        numerator, denominator = self._loop.clock
        self._lines.append(f"  %k.{phase} = load i64, ptr %place.k")
        ticks = self._value(f"mul i64 %k.{phase}, {numerator}")
        self._lines += [
            f"  %ticks.{phase} = sitofp i64 {ticks} to double",
            f"  %t.{phase} = fdiv double %ticks.{phase}, {float(denominator)!r}",
        ]

    def _draw(self) -> None:
        if not self._loop.drawn:
            return
        column = self._value(f"and i64 %k.e, {CHUNK - 1}")  # CHUNK is a power of two
        for j, place in enumerate(self._loop.drawn):
            number = self._element("%buffer", self._value(f"add i64 {column}, {j * CHUNK}"))
            self._copy(self._value(f"load double, ptr {number}"), "%memory", place)

    def _record(self) -> None:
        """Record a row when it is due, and count rows: the rest of a division at each step would take longer."""
        decimation = self._loop.decimation
        if decimation == 1:
            self._record_row("%k.e")
            return
        row = self._value("load i64, ptr %place.row")
        due = self._value(f"mul i64 {row}, {decimation}")
        self._branch(self._value(f"icmp eq i64 %k.e, {due}"), "record", "recorded")
        self._label("record")
        self._record_row(row)
        self._lines += [f"  store i64 {self._value(f'add i64 {row}, 1')}, ptr %place.row", "  br label %recorded"]
        self._label("recorded")

    def _record_row(self, row: str) -> None:
        first = self._value(f"mul i64 {self._value(f'sub i64 {row}, %before')}, {len(self._loop.recorded)}")
        begin = self._element("%recording", first)
        for j, place in enumerate(self._loop.recorded):
            self._copy(self._load(place), begin, j)

    def _gather(self, target: int, source: int) -> None:
        self._copy(self._load(source), "%memory", target)

    def _call(self, c: int, phase: str) -> None:
        row, count = self._loop.rows[c], f"%k.{phase}"
        if row[EVERY] != 1:
            rest = self._value(f"srem i64 {count}, {row[EVERY]}")
            self._branch(self._value(f"icmp eq i64 {rest}, 0"), f"call.{c}", f"done.{c}")
            self._label(f"call.{c}")
            count = self._value(f"sdiv i64 {count}, {row[EVERY]}")
        for target, source in self._loop.gathers[c]:
            self._gather(target, source)
        if row[FUNCTION]:
            self._function(c, phase, count)
        self._check(c, phase)
        if row[EVERY] != 1:
            self._lines.append(f"  br label %done.{c}")
            self._label(f"done.{c}")

    def _check(self, c: int, phase: str) -> None:
        row = self._loop.rows[c]
        for place in range(row[CHECK_FROM], row[CHECK_TO]):
            value = self._load(place)
            zero = self._value(f"fsub double {value}, {value}")
            fails = self._value(f"fcmp une double {zero}, 0.0")
            self._fail_if(fails, c, phase, str(NOT_FINITE + place), f"{c}.{place}")

    def _function(self, c: int, phase: str, count: str) -> None:
        row, function = self._loop.rows[c], self._loop.functions[c]
        sections = [self._element("%memory", row[section]) for section in (STATE, PARAMETERS, INPUTS, OUTPUTS)]
        if function in self._inlined:
            self._by_name(function, sections, phase, count)
        else:
            self._by_address(c * COLUMNS + FUNCTION, sections, (c, phase, count), str(c))

    def _by_name(self, function: str, sections: list[str], phase: str, count: str) -> None:
        arguments = ", ".join(f"ptr {section}" for section in sections)
        self._value(f"call i32 @{function}({arguments}, double %t.{phase}, i64 {count})")  # its status is always 0

    def _by_address(self, place: int, sections: list[str], call: tuple[int, str, str], label: str) -> None:
        """Call the function whose address is at this place of the table; `call` is its row, phase and count of steps."""
        c, phase, count = call
        if service := self._loop.services[c]:
            pointer = f"@{service}"
        else:
            address = self._value(f"load i64, ptr {self._element('%calls', place, 'i64')}")
            pointer = self._value(f"inttoptr i64 {address} to ptr")
        arguments = ", ".join(f"i64 {self._value(f'ptrtoint ptr {section} to i64')}" for section in sections)
        status = self._value(f"call i32 {pointer}({arguments}, double %t.{phase}, i64 {count})")
        fails = self._value(f"icmp ne i32 {status}, 0")
        self._fail_if(fails, c, phase, self._value(f"sext i32 {status} to i64"), label)

    def _fail_if(self, condition: str, c: int, phase: str, status: str, label: str) -> None:
        """Return the last step whose outputs are complete, after writing down the call and its status."""
        self._branch(condition, f"fail.{label}", f"well.{label}")
        self._label(f"fail.{label}")
        self._lines.append(f"  store i64 {c}, ptr %failed")
        self._lines.append(f"  store i64 {status}, ptr {self._element('%failed', 1, 'i64')}")
        last = self._value("sub i64 %k.e, 1") if phase == "e" else "%k.a"
        self._lines.append(f"  ret i64 {last}")
        self._label(f"well.{label}")
