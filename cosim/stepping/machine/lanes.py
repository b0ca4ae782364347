"""Translate the same C such that one call makes a step of several runs at once, each in its lane of a vector register.

A value is *wide* if it can differ between lanes, and then a vector with a number for each. All others stay single numbers:
counters of loops, parameters, the time. Both sides of a branch whose condition is wide are computed if any lane needs them, and
only the lanes on that side (the *mask*) store. Each lane rounds as a single run does, so it has the same bits.

Arrays of wide numbers are stored element by element, each with all its lanes side by side.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from pycparser import c_ast
from pycparser.c_parser import CParser

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.machine.lowering import (
    DOUBLE,
    LIBRARY,
    LITERAL,
    OPERATIONS,
    POINTER,
    TRUTH,
    WHOLE,
    Function,
    Term,
    Unit,
    common,
    declarations,
    number,
    operator,
    plain,
)

LANES = "lanes"
"""The type of a pointer to wide numbers; `POINTER` is one to single numbers."""

CHOSEN = "Whole arrays are chosen by numbers that differ between runs."

_JUMPS = (c_ast.Return, c_ast.Break, c_ast.Continue)


def lowered_to_lanes(c: str, lanes: int, apart: Sequence[str] = ()) -> str:
    """Return LLVM's text for a file of C, with an entry whose state, inputs and outputs are wide.

    Parameters
    ----------
    c : str
        Definitions of types, tables and static functions, and one function that is not static.
    lanes : int
        Number of runs.
    apart : sequence of str
        Functions whose pointers point to memory that does not overlap.

    Raises
    ------
    KernelError
        If it calls functions of other compiled code, or chooses whole arrays by wide numbers.
    """
    file = _File(lanes, frozenset(apart))
    nodes = CParser().parse(plain(c)).ext
    file.parts += declarations(file.unit, [node for node in nodes if not isinstance(node, c_ast.FuncDef)])
    file.nodes = {node.decl.name: node for node in nodes if isinstance(node, c_ast.FuncDef)}
    for name, types in list(file.unit.records.items()):
        wide = ", ".join(map(file.wide, types.split(", ")))
        file.unit.records[f"{name}.w"] = wide
        file.parts.append(f"{name}.w = type {{ {wide} }}")
    entry = next(name for name, node in file.nodes.items() if "static" not in node.decl.storage)
    file.made(entry, (LANES, POINTER, LANES, LANES, DOUBLE, WHOLE), masked=False)
    kinds = {DOUBLE: f"v{lanes}f64"}
    file.parts += [f"declare {file.wide(DOUBLE)} @llvm.{f}.{kinds[DOUBLE]}({file.wide(DOUBLE)})" for f in LIBRARY]
    return "\n".join(file.parts) + "\n"


@dataclass
class _File:
    """A file of C, and the functions made from it so far: one for each combination of wide and other arguments."""

    lanes: int
    apart: frozenset[str]
    unit: Unit = field(default_factory=Unit)
    nodes: dict[str, c_ast.FuncDef] = field(default_factory=dict)
    parts: list[str] = field(default_factory=list)
    done: dict[tuple[str, tuple[str, ...], bool], tuple[str, str]] = field(default_factory=dict)

    def wide(self, kind: str) -> str:
        """Return the wide form of a type."""
        if kind.startswith("%"):
            return kind if kind.endswith(".w") else f"{kind}.w"
        if kind == POINTER:
            return LANES
        return kind if self.is_wide(kind) or kind == "void" else f"<{self.lanes} x {kind}>"

    @staticmethod
    def is_wide(kind: str) -> bool:
        """Return whether a type is a vector."""
        return kind.startswith("<")

    def made(self, name: str, kinds: tuple[str, ...], *, masked: bool) -> tuple[str, str]:
        """Return the name in LLVM, and the returned type, of a function for arguments of these types."""
        key = name, kinds, masked
        if key not in self.done:
            if name in OPERATIONS:
                self.done[key] = self._operation(name, wide=any(map(self.is_wide, kinds)))
            else:
                function = _Lanes(self, self.nodes[name], kinds, masked=masked)
                text = function.text()
                self.parts.append(text)
                self.done[key] = function.llvm_name, function.signature.returns
        return self.done[key]

    def _operation(self, name: str, *, wide: bool) -> tuple[str, str]:
        text, of_file = OPERATIONS[name], f"f.{name}.w" if wide else f"f.{name}"
        if wide:
            text = re.sub(r", (\d+)$", r", splat (i64 \1)", text, flags=re.M)
            text = re.sub(r", (\d+\.\d+)$", r", splat (double \1)", text, flags=re.M)
            kinds = rf"(?<!splat \()\b({DOUBLE}|{WHOLE}|{TRUTH})\b"
            text = re.sub(kinds, lambda m: self.wide(m[1]), text).replace(f"@f.{name}", f"@{of_file}")
        if text not in self.parts:
            self.parts.append(text)
        return of_file, self.wide(DOUBLE) if wide else DOUBLE


@dataclass
class _Loop:
    """A loop: where `continue` and `break` lead, how deep in wide branches its body is, and for a wide one its masks in memory.

    `lanes` are those that are still in the loop, `pass_` those that are still in this pass.
    """

    following: str
    after: str
    depth: int
    key: int
    lanes: str = ""
    pass_: str = ""


class _Lanes(Function):
    """One function of C for several runs.

    Which variables and loops are wide shows only later in the text. So each pass over the function notes them, and another one
    follows until none is added.
    """

    def __init__(self, file: _File, node: c_ast.FuncDef, kinds: tuple[str, ...], *, masked: bool):
        super().__init__(file.unit, node, apart=node.decl.name in file.apart)
        self.file, self.masked = file, masked
        self.returned_kind = self.signature.returns
        self.signature.arguments = list(kinds)
        self.llvm_name = f"f.{self.name}.{len(file.done)}.{len(file.parts)}" if self.own else self.name
        self.noted: set[object] = set()  # declarations and loops that are wide, and "return"
        self.reset()

    def reset(self) -> None:
        """Begin another pass."""
        self.places, self.lines, self.scopes, self.count, self.open = [], [], [{}], 0, True
        self.mask = "%mask" if self.masked else ""
        self.depth = 0
        self.around: list[_Loop] = []
        self.variables: dict[str, tuple[object, int]] = {}  # for each place: its declaration and its depth
        self.returned = self.result_place = ""
        self.refusal = ""  # it counts in the last pass only

    def text(self) -> str:
        """Return the function as LLVM text."""
        before = -1
        while len(self.noted) > before:
            before = len(self.noted)
            self.reset()
            wide = "return" in self.noted or self.returned_kind.startswith("%")
            self.signature.returns = self.file.wide(self.returned_kind) if wide else self.returned_kind
            self._body()
        if self.refusal:
            raise KernelError(self.refusal)
        marks = {POINTER: " noalias" if self.apart else "", LANES: " noalias" if self.apart else ""}
        arguments = [f"{_in_llvm(kind)}{marks.get(kind, '')} %a{i}" for i, kind in enumerate(self.signature.arguments)]
        arguments += [f"{self.all_of(TRUTH)} %mask"] * self.masked
        scope = "internal " if self.own else ""
        head = f"define {scope}{self.signature.returns} @{self.llvm_name}({', '.join(arguments)}) {{"
        return "\n".join([head, *self.places, *self.lines, "}"])

    def _body(self) -> None:
        for i, (parameter, kind) in enumerate(zip(self.parameters, self.signature.arguments, strict=True)):
            wide = id(parameter) in self.noted
            place = self.variable(parameter.name, self.file.wide(kind) if wide else kind, parameter)
            self.emit(f"store {_in_llvm(place.type)} {self.turned(Term(kind, f'%a{i}'), place.type)}, ptr {place.text}")
        self.block(self.node.body)
        if self.open:
            self._leave()
        if self.returned:
            self.begin("exit")
            self._leave()

    def _leave(self) -> None:
        kind = self.signature.returns
        if kind == "void":
            self.end("ret void")
        elif self.result_place:
            self.end(f"ret {kind} {self.loaded(Term(kind, self.result_place)).text}")
        else:
            self.end("unreachable")

    # Values and masks

    def all_of(self, kind: str) -> str:
        """Return the wide form of a type."""
        return self.file.wide(kind)

    def is_wide(self, value: Term) -> bool:
        """Return whether a value can differ between lanes."""
        return self.file.is_wide(value.type)

    def note(self, what: object) -> None:
        """Note that something is wide, for the next pass."""
        self.noted.add(what)

    def variable(self, name: str, kind: str, key: object = None) -> Term:
        self.count += 1
        place = Term(kind, f"%v{self.count}")
        self.places.append(f"  {place.text} = alloca {_in_llvm(kind)}")
        self.scopes[-1][name] = place
        self.variables[place.text] = (key, self.depth)
        return place

    def loaded(self, place: Term) -> Term:
        if isinstance(place.text, list):  # an element of each lane's own
            value, base = "poison", self._base(place.type)
            for lane, at in enumerate(place.text):
                one = self.result(base, f"load {base}, ptr {at}").text
                value = self.result(place.type, f"insertelement {place.type} {value}, {base} {one}, i64 {lane}").text
            return Term(place.type, value)
        return self.result(place.type, f"load {_in_llvm(place.type)}, ptr {place.text}")

    @staticmethod
    def _base(kind: str) -> str:
        return kind.split(" x ")[1][:-1] if kind.startswith("<") else kind

    def turned(self, value: Term, kind: str) -> str:
        if not self.file.is_wide(kind):
            if self.is_wide(value):
                self.note(("narrowed", kind))  # only in a pass that is not the last
                return "poison"
            return super().turned(value, kind)
        if self.is_wide(value):
            return self._converted(value, kind)
        base = self._base(kind)
        if value.type == LITERAL:
            return f"splat ({base} {number(base, value.text)})"
        one = super().turned(value, base)
        first = self.result(kind, f"insertelement {kind} poison, {base} {one}, i64 0").text
        return str(
            self.result(kind, f"shufflevector {kind} {first}, {kind} poison, {self.all_of('i32')} zeroinitializer").text
        )

    def _converted(self, value: Term, kind: str) -> str:
        have, want = self._base(value.type), self._base(kind)
        if have == want:
            return str(value.text)
        if want == TRUTH:
            compare = f"fcmp une {value.type}" if have == DOUBLE else f"icmp ne {value.type}"
            return str(self.result(kind, f"{compare} {value.text}, zeroinitializer").text)
        if want == DOUBLE:
            turn = "uitofp" if have == TRUTH else "sitofp"
        else:
            turn = "zext" if have == TRUTH else "fptosi"
        return str(self.result(kind, f"{turn} {value.type} {value.text} to {kind}").text)

    def inverse(self, mask: str) -> str:
        """Return the other lanes."""
        kind = self.all_of(TRUTH)
        return str(self.result(kind, f"xor {kind} {mask}, splat (i1 true)").text)

    def within(self, mask: str) -> str:
        """Return the lanes of a mask that are active now."""
        kind = self.all_of(TRUTH)
        return str(self.result(kind, f"and {kind} {self.mask}, {mask}").text) if self.mask else mask

    def any(self, mask: str) -> str:
        """Return whether a mask has any lane."""
        bits = self.result("", f"bitcast {self.all_of(TRUTH)} {mask} to i{self.file.lanes}").text
        return str(self.result(TRUTH, f"icmp ne i{self.file.lanes} {bits}, 0").text)

    def chosen(self, mask: str, one: str, other: str, kind: str) -> str:
        """Return the first value in the lanes of a mask, and the second in the others."""
        if not kind.startswith("%"):
            return str(self.result(kind, f"select {self.all_of(TRUTH)} {mask}, {kind} {one}, {kind} {other}").text)
        value = other
        for i, inner in enumerate(self.unit.records[kind].split(", ")):
            a, b = (self.result(inner, f"extractvalue {kind} {record}, {i}").text for record in (one, other))
            value = self.result(kind, f"insertvalue {kind} {value}, {inner} {self.chosen(mask, a, b, inner)}, {i}").text
        return value

    # Statements

    def do_Decl(self, node: c_ast.Decl) -> None:
        kind = self.unit.type_of(node.type)
        if kind.startswith("%"):
            record = self._record(node.init, self.file.wide(kind))
            place = self.variable(node.name, record.type, node)
            self.emit(f"store {record.type} {record.text}, ptr {place.text}")
            return
        value = self.value(node.init)
        if id(node) in self.noted or self.is_wide(value) or value.type == LANES:
            kind = self.file.wide(kind)
        start = "null" if value.type == LITERAL and kind == LANES else self.turned(value, kind)
        self.emit(f"store {_in_llvm(kind)} {start}, ptr {self.variable(node.name, kind, node).text}")

    def _record(self, node: c_ast.Node, kind: str) -> Term:
        """Return the value of a record, whose numbers are all wide."""
        if not isinstance(node, c_ast.InitList):
            return self.value(node)
        record = Term(kind, "zeroinitializer")
        for i, (inner, item) in enumerate(zip(self.unit.records[kind].split(", "), node.exprs, strict=False)):
            value = self.turned(self.value(item), inner)
            record = self.result(kind, f"insertvalue {kind} {record.text}, {inner} {value}, {i}")
        return record

    def do_Assignment(self, node: c_ast.Assignment) -> None:
        value = self.value(node.rvalue)
        place = self.place(node.lvalue)
        if node.op != "=":
            value = self.combined(node.op[:-1], self.loaded(place), value)
        self.store(value, place)

    def do_UnaryOp(self, node: c_ast.UnaryOp) -> None:
        place = self.place(node.expr)
        self.store(self.combined("+" if node.op == "++" else "-", self.loaded(place), Term(LITERAL, 1)), place)

    def store(self, value: Term, place: Term) -> None:
        """Assign a value in the active lanes."""
        if isinstance(place.text, list):
            self._store_apart(self.turned(value, place.type), place)
            return
        is_variable = place.text in self.variables
        declared, depth = self.variables.get(place.text, (None, 0))
        masked = self.depth > depth if is_variable else bool(self.mask)
        if place.type == LANES or place.type == POINTER:
            if value.type == LANES and place.type == POINTER:
                self.note(id(declared))
                return
            if masked or value.type != place.type:
                self.refusal = self.refusal or CHOSEN
                return
        elif not self.file.is_wide(place.type) and not place.type.startswith("%") and (masked or self.is_wide(value)):
            if is_variable:
                self.note(id(declared))
            else:
                self.refusal = self.refusal or "A parameter is written."
            return
        new = self.turned(value, place.type) if not place.type.startswith("%") else value.text
        if masked:
            new = self.chosen(self.mask, new, self.loaded(place).text, place.type)
        self.emit(f"store {_in_llvm(place.type)} {new}, ptr {place.text}")

    def _store_apart(self, value: str, place: Term) -> None:
        base = self._base(place.type)
        if self.mask:
            value = self.chosen(self.mask, value, self.loaded(place).text, place.type)
        for lane, at in enumerate(place.text):
            one = self.result(base, f"extractelement {place.type} {value}, i64 {lane}").text
            self.emit(f"store {base} {one}, ptr {at}")

    def do_Return(self, node: c_ast.Return) -> None:
        kind = self.signature.returns
        value = self.value(node.expr) if node.expr is not None else None
        if value is not None and (self.depth or self.is_wide(value)):
            self.note("return")
        text = "" if value is None else value.text if kind.startswith("%") else self.turned(value, kind)
        if not self.depth and not self.returned:
            self.end(f"ret {kind} {text}".rstrip())
            return
        if value is not None:
            if not self.result_place:
                self.result_place = self._memory(kind)
            if self.mask:
                text = (
                    self.chosen(self.mask, text, self.loaded(Term(kind, self.result_place)).text, kind)
                    if self.file.is_wide(kind) or kind.startswith("%")
                    else text
                )
            self.emit(f"store {kind} {text}, ptr {self.result_place}")
        if not self.depth:
            self.end("br label %exit")
            return
        if not self.returned:
            self.returned = self._memory(self.all_of(TRUTH))
        self._add(self.returned)
        for loop in self.around:
            self._leave_loop(loop)

    def _memory(self, kind: str) -> str:
        self.count += 1
        self.places += [f"  %v{self.count} = alloca {kind}", f"  store {kind} zeroinitializer, ptr %v{self.count}"]
        return f"%v{self.count}"

    def _add(self, place: str) -> None:
        kind = self.all_of(TRUTH)
        now = self.result(kind, f"or {kind} {self.loaded(Term(kind, place)).text}, {self.mask}").text
        self.emit(f"store {kind} {now}, ptr {place}")

    def _remove(self, place: str) -> None:
        kind = self.all_of(TRUTH)
        now = self.result(kind, f"and {kind} {self.loaded(Term(kind, place)).text}, {self.inverse(self.mask)}").text
        self.emit(f"store {kind} {now}, ptr {place}")

    def _leave_loop(self, loop: _Loop) -> None:
        """Remove the active lanes from a loop; it must be wide."""
        if not loop.lanes:
            self.note(loop.key)
            return
        self._remove(loop.lanes)
        self._remove(loop.pass_)

    def do_Break(self, _: c_ast.Break) -> None:
        loop = self.around[-1]
        if self.depth == loop.depth:
            self.end(f"br label %{loop.after}")
        else:
            self._leave_loop(loop)

    def do_Continue(self, _: c_ast.Continue) -> None:
        loop = self.around[-1]
        if self.depth == loop.depth:
            self.end(f"br label %{loop.following}")
        elif loop.lanes:
            self._remove(loop.pass_)
        else:
            self.note(loop.key)

    def do_If(self, node: c_ast.If) -> None:
        condition, outer = self.value(node.cond), self.mask
        if not self.is_wide(condition):
            then, other, after = self.label(), self.label(), self.label()
            self.end(f"br i1 {self.turned(condition, TRUTH)}, label %{then}, label %{other}")
            for label, part in ((then, node.iftrue), (other, node.iffalse)):
                self.begin(label)
                self.block(part)
                self.mask = outer
                if self.open:
                    self.end(f"br label %{after}")
            self.begin(after)
        else:
            holds = self.turned(condition, self.all_of(TRUTH))
            sides = [(self.within(holds), node.iftrue)]
            if node.iffalse is not None:
                sides.append((self.within(self.inverse(holds)), node.iffalse))
            self.depth += 1
            for mask, part in sides:
                inside, after = self.label(), self.label()
                self.end(f"br i1 {self.any(mask)}, label %{inside}, label %{after}")
                self.begin(inside)
                self.mask = mask
                self.block(part)
                self.mask = outer
                self.begin(after)
            self.depth -= 1
        if _jumps(node):
            self.narrow()

    def narrow(self) -> None:
        """Leave out the lanes that have returned or left this pass of a loop; jump if there are none left."""
        kind = self.all_of(TRUTH)
        loop = self.around[-1] if self.around else None
        left = loop.pass_ if loop else ""
        if not self.returned and not left:
            return
        mask = self.mask or "splat (i1 true)"
        if loop and left:
            mask = self.result(kind, f"and {kind} {mask}, {self.loaded(Term(kind, loop.pass_)).text}").text
        elif self.returned:
            gone = self.loaded(Term(kind, self.returned)).text
            mask = self.result(kind, f"and {kind} {mask}, {self.inverse(gone)}").text
        self.mask = mask
        target = loop.following if loop and self.depth == loop.depth else "exit" if not self.depth else ""
        if target:
            go_on = self.label()
            self.end(f"br i1 {self.any(mask)}, label %{go_on}, label %{target}")
            self.begin(go_on)

    def do_Pragma(self, _: c_ast.Pragma) -> None:
        """Make one pass after the other: vectors are for the runs."""

    def loop(self, condition: c_ast.Node | None, turn: c_ast.Node | None, body: c_ast.Node, _: str = "") -> None:
        test, inside, following, after = (self.label() for _ in range(4))
        loop, outer, kind = _Loop(following, after, self.depth, id(body)), self.mask, self.all_of(TRUTH)
        if loop.key in self.noted:
            loop.lanes, loop.pass_, loop.depth = self._memory(kind), self._memory(kind), self.depth + 1
            self.emit(f"store {kind} {self.mask or 'splat (i1 true)'}, ptr {loop.lanes}")
        self.begin(test)
        self.depth = loop.depth
        if loop.lanes:
            self.mask = str(self.loaded(Term(kind, loop.lanes)).text)
        go_on = self.value(condition) if condition is not None else Term(LITERAL, 1)
        if loop.lanes:
            mask = self.within(self.turned(go_on, kind))
            self.emit(f"store {kind} {mask}, ptr {loop.lanes}")
            self.emit(f"store {kind} {mask}, ptr {loop.pass_}")
            self.mask = mask
            self.end(f"br i1 {self.any(mask)}, label %{inside}, label %{after}")
        else:
            if self.is_wide(go_on):
                self.note(loop.key)
            self.end(f"br i1 {self.turned(go_on, TRUTH)}, label %{inside}, label %{after}")
        self.begin(inside)
        self.around.append(loop)
        self.block(body)
        self.around.pop()
        self.mask, self.depth = outer, loop.depth - bool(loop.lanes)
        self.begin(following)
        self.block(turn)
        self.end(f"br label %{test}")
        self.begin(after)
        if loop.lanes and self.returned:
            self.narrow()

    # Expressions

    def get_UnaryOp(self, node: c_ast.UnaryOp) -> Term:
        value = self.value(node.expr)
        if not self.is_wide(value):
            return super().get_UnaryOp(node)
        if node.op == "!":
            return Term(self.all_of(TRUTH), self.inverse(self.turned(value, self.all_of(TRUTH))))
        if self._base(value.type) == DOUBLE:
            return self.result(value.type, f"fneg {value.type} {value.text}")
        kind = self.all_of(WHOLE)
        return self.result(kind, f"sub {kind} zeroinitializer, {self.turned(value, kind)}")

    def get_Cast(self, node: c_ast.Cast) -> Term:
        value = self.value(node.expr)
        if not self.is_wide(value):
            return super().get_Cast(node)
        kind = self.all_of(self.unit.type_of(node.to_type.type))
        return Term(kind, self.turned(value, kind))

    def get_TernaryOp(self, node: c_ast.TernaryOp) -> Term:
        condition, outer = self.value(node.cond), self.mask
        if not self.is_wide(condition):
            return self._choice(node, self.turned(condition, TRUTH))
        holds = self.turned(condition, self.all_of(TRUTH))
        self.mask = self.within(holds)
        one = self.value(node.iftrue)
        self.mask = outer
        self.mask = self.within(self.inverse(holds))
        other = self.value(node.iffalse)
        self.mask = outer
        kind = self.all_of(self._common(one, other))
        return Term(kind, self.chosen(holds, self.turned(one, kind), self.turned(other, kind), kind))

    def _choice(self, node: c_ast.TernaryOp, condition: str) -> Term:
        """Return one of two values by a condition that is the same in all lanes; only that one is computed."""
        one, other = self._tried(node.iftrue), self._tried(node.iffalse)
        kind = self._common(one, other)
        if self.is_wide(one) or self.is_wide(other):
            kind = self.all_of(kind)
        place, then, otherwise, after = self.variable("", kind), self.label(), self.label(), self.label()
        self.end(f"br i1 {condition}, label %{then}, label %{otherwise}")
        for label, part in ((then, node.iftrue), (otherwise, node.iffalse)):
            self.begin(label)
            self.emit(f"store {kind} {self.turned(self.value(part), kind)}, ptr {place.text}")
            self.end(f"br label %{after}")
        self.begin(after)
        return self.loaded(place)

    def _tried(self, node: c_ast.Node) -> Term:
        """Return the value of an expression, for its type, without the lines that compute it."""
        lines, places, is_open = list(self.lines), list(self.places), self.open
        value = self.value(node)
        self.lines, self.places, self.open = lines, places, is_open
        return value

    def _common(self, one: Term, other: Term) -> str:
        return common(*(Term(self._base(value.type), value.text) for value in (one, other)))

    def logic(self, node: c_ast.BinaryOp) -> Term:
        first = self.value(node.left)
        if not self.is_wide(first):
            return self._logic_of_one(node, self.turned(first, TRUTH))
        kind, outer = self.all_of(TRUTH), self.mask
        a = self.turned(first, kind)
        self.mask = self.within(a if node.op == "&&" else self.inverse(a))
        b = self.turned(self.value(node.right), kind)
        self.mask = outer
        return self.result(kind, f"{'and' if node.op == '&&' else 'or'} {kind} {a}, {b}")

    def _logic_of_one(self, node: c_ast.BinaryOp, first: str) -> Term:
        """Return && or || whose first operand is the same in all lanes; the second is computed only if needed."""
        wide, key = id(node) in self.noted, id(node)
        kind = self.all_of(TRUTH) if wide else TRUTH
        place, further, after = self.variable("", kind), self.label(), self.label()
        self.emit(f"store {kind} {self.turned(Term(TRUTH, first), kind)}, ptr {place.text}")
        targets = (further, after) if node.op == "&&" else (after, further)
        self.end(f"br i1 {first}, label %{targets[0]}, label %{targets[1]}")
        self.begin(further)
        second = self.value(node.right)
        if self.is_wide(second) and not wide:
            self.note(key)
        self.emit(f"store {kind} {self.turned(second, kind)}, ptr {place.text}")
        self.begin(after)
        return self.loaded(place)

    def combined(self, op: str, left: Term, right: Term) -> Term:
        if LANES in {left.type, right.type}:
            if self.is_wide(right):
                self.refusal = self.refusal or CHOSEN
                return left
            element = self.all_of(DOUBLE)
            at = f"getelementptr inbounds {element}, ptr {left.text}, i64 {super().turned(right, WHOLE)}"
            return self.result(LANES, at)
        if not self.is_wide(left) and not self.is_wide(right):
            return super().combined(op, left, right)
        base = self._common(left, right)
        kind = self.all_of(WHOLE if base == TRUTH and op in "+-*/%" else base)
        a, b = self.turned(left, kind), self.turned(right, kind)
        if self._base(kind) == WHOLE and op in "/%" and self.mask:  # in the other lanes the divisor may be zero
            b = self.chosen(self.mask, b, "splat (i64 1)", kind)
        line, compares = operator(op, self._base(kind))
        return self.result(self.all_of(TRUTH) if compares else kind, f"{line} {kind} {a}, {b}")

    def called(self, node: c_ast.FuncCall) -> Term:
        values = [self.value(argument) for argument in node.args.exprs] if node.args else []
        name = node.name.name
        if name in LIBRARY:
            kind = values[0].type if self.is_wide(values[0]) else DOUBLE
            if self.is_wide(values[0]):
                kind = self.all_of(DOUBLE)
                function = f"llvm.{name}.v{self.file.lanes}f64"
            else:
                function = LIBRARY[name]
            return self.result(kind, f"call {kind} @{function}({kind} {self.turned(values[0], kind)})")
        if name in self.unit.outside:
            raise KernelError(f"The function {name} of other compiled code is called.")
        bases = (
            [self.unit.type_of(p.type) for p in self.file.nodes[name].decl.type.args.params if p.name] if values else []
        )
        if name in OPERATIONS and any(map(self.is_wide, values)):
            kinds = [self.all_of(base) for base in bases]
        else:
            kinds = [self._passed(value, base) for value, base in zip(values, bases, strict=True)]
        needs_mask = any(base in {POINTER, WHOLE} for base in bases) and bool(self.mask)
        try:
            called, returns = self.file.made(name, tuple(kinds), masked=needs_mask)
        except KernelError as error:  # it need not be the last pass
            self.refusal = self.refusal or str(error)
            return Term(self.all_of(self.unit.functions[name].returns), "poison")
        given = [f"{_in_llvm(k)} {self.turned(v, k)}" for k, v in zip(kinds, values, strict=True)]
        given += [f"{self.all_of(TRUTH)} {self.mask}"] * needs_mask
        line = f"call {returns} @{called}({', '.join(given)})"
        if returns == "void":
            self.emit(line)
            return Term("void", "")
        return self.result(returns, line)

    def _passed(self, value: Term, base: str) -> str:
        if base == POINTER:
            return LANES if value.type == LANES else POINTER
        return self.all_of(base) if self.is_wide(value) else base

    def place(self, node: c_ast.Node) -> Term:
        if not isinstance(node, c_ast.ArrayRef):
            return super().place(node)
        owner = self.value(node.name)
        single = self.unit.tables[node.name.name] if self.is_table(node.name) else DOUBLE
        kind = self.all_of(single) if owner.type == LANES else single
        index = self.value(node.subscript)
        if not self.is_wide(index):
            at = f"getelementptr inbounds {kind}, ptr {owner.text}, i64 {self.turned(index, WHOLE)}"
            return Term(kind, self.result(POINTER, at).text)
        whole = self.turned(index, self.all_of(WHOLE))
        if self.mask:  # in the other lanes the index may lead anywhere
            whole = self.chosen(self.mask, whole, "zeroinitializer", self.all_of(WHOLE))
        places = []
        for lane in range(self.file.lanes):
            at = self.result(WHOLE, f"extractelement {self.all_of(WHOLE)} {whole}, i64 {lane}").text
            row = owner.text
            if owner.type == LANES:
                row = self.result(POINTER, f"getelementptr inbounds {kind}, ptr {row}, i64 {at}").text
                at = str(lane)
            places.append(self.result(POINTER, f"getelementptr inbounds {single}, ptr {row}, i64 {at}").text)
        return Term(self.all_of(single), places)


def _in_llvm(kind: str) -> str:
    return POINTER if kind == LANES else kind


def _jumps(node: c_ast.Node) -> bool:
    return isinstance(node, _JUMPS) or any(_jumps(child) for _, child in node.children())
