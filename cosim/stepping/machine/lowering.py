"""Translate C to LLVM's text format, for the C that `bayesftc.cosim.stepping.translate` writes.

This C is the single definition of a compiled step function: it is exported, and here it becomes machine code. Its types are
double, int64_t, int (only for truth values), pointers to double, structs of numbers that functions return, and constant tables.
A function that is declared but not defined is one of other compiled code (`bayesftc.cosim.stepping.foreign`).
Each variable is placed in memory here; LLVM puts them into registers.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pycparser import c_ast
from pycparser.c_parser import CParser

from bayesftc.cosim import ops

DOUBLE, WHOLE, TRUTH, POINTER, LITERAL = "double", "i64", "i1", "ptr", "literal"
_RANKS = (TRUTH, LITERAL, WHOLE, DOUBLE)
"""Of two operands, the one of the lower rank is converted to the other's type."""

_TYPES = {"double": DOUBLE, "int64_t": WHOLE, "int": TRUTH, "void": "void"}
LIBRARY = {name: f"llvm.{name}.f64" for name in ops.OF_LIBRARY.values()}
_NUMBERS = {"NAN": float("nan"), "HUGE_VAL": float("inf")}
_FLOATING = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_COUNTING = {"+": "add", "-": "sub", "*": "mul", "/": "sdiv", "%": "srem"}
_ORDERED = {"<": "lt", "<=": "le", ">": "gt", ">=": "ge"}

OPERATIONS = {
    # The same bits as C's sum of two terms, with half the operations.
    "op_select": """define internal double @f.op_select(i1 %c, double %a, double %b) {
  %chosen = select i1 %c, double %a, double %b
  %sum = fadd double %chosen, 0.0
  ret double %sum
}""",
    # The others copy the bits of a double to a whole number and back.
    "op_exponent": """define internal double @f.op_exponent(double %x) {
  %bits = bitcast double %x to i64
  %moved = add i64 %bits, 2638147582215219
  %high = lshr i64 %moved, 52
  %number = or i64 %high, 4841369599423283200
  %power = bitcast i64 %number to double
  %exponent = fsub double %power, 4503599627371519.0
  ret double %exponent
}""",
    "op_power_of_two": """define internal double @f.op_power_of_two(double %k) {
  %shifted = fadd double %k, 6755399441056767.0
  %bits = bitcast double %shifted to i64
  %high = shl i64 %bits, 52
  %power = bitcast i64 %high to double
  ret double %power
}""",
    "op_significand": """define internal double @f.op_significand(double %x) {
  %bits = bitcast double %x to i64
  %moved = add i64 %bits, 2638147582215219
  %low = and i64 %moved, 4503599627370495
  %number = add i64 %low, 4604544271217802189
  %part = bitcast i64 %number to double
  ret double %part
}""",
}
"""Operations with an LLVM text of their own."""


@dataclass(frozen=True)
class Term:
    """A value: its type, and its text in LLVM; for a literal, the number."""

    type: str
    text: Any


@dataclass
class Signature:
    """The types that a function returns and takes."""

    returns: str
    arguments: list[str]


@dataclass
class Unit:
    """The declarations of a C file."""

    records: dict[str, str] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)  # element type by name
    functions: dict[str, Signature] = field(default_factory=dict)
    outside: set[str] = field(default_factory=set)  # functions of other compiled code
    calls: dict[str, set[str]] = field(default_factory=dict)  # names of the functions that each one calls
    within: set[str] = field(default_factory=set)  # functions that loops with independent passes call
    groups: int = 0  # number of these loops

    def type_of(self, node: c_ast.Node) -> str:
        """Return the type of a declaration."""
        if isinstance(node, c_ast.PtrDecl | c_ast.ArrayDecl):
            return POINTER
        name = node.type.names[-1]
        return _TYPES.get(name) or f"%{name}"


def lowered(c: str, apart: Iterable[str] = ()) -> str:
    """Return LLVM's text for a file of C.

    Parameters
    ----------
    c : str
        Definitions of types, tables and static functions, and one function that is not static.
    apart : iterable of str
        Functions whose pointers point to memory that does not overlap.
    """
    unit, nodes = Unit(), CParser().parse(plain(c)).ext
    parts = declarations(unit, [node for node in nodes if not isinstance(node, c_ast.FuncDef)])
    for node in nodes:
        if isinstance(node, c_ast.FuncDef):
            parts.append(Function(unit, node, apart=node.decl.name in apart).text())
    return "\n".join([*_included(unit, parts), *_groups(unit)]) + "\n"


def _included(unit: Unit, parts: Iterable[str]) -> Iterator[str]:
    """Mark the functions that become part of loops with independent passes: LLVM makes no vectors of calls."""
    names, found = set(unit.within), set[str]()
    while names - found:
        name = (names - found).pop()
        found.add(name)
        names |= unit.calls.get(name, set())
    for part in parts:
        head = re.match(r"define internal [^@]*@f\.(\w+)\(", part)
        yield part.replace(") {", ") alwaysinline {", 1) if head and head[1] in found else part


def _groups(unit: Unit) -> Iterator[str]:
    """Say that the passes of loops are independent; LLVM decides whether and how many to make at once."""
    for group in range(1, unit.groups + 1):
        access, loop, parallel = range(3 * group, 3 * group + 3)
        yield f"!{access} = distinct !{{}}"
        yield f"!{loop} = distinct !{{!{loop}, !{parallel}}}"
        yield f'!{parallel} = !{{!"llvm.loop.parallel_accesses", !{access}}}'


def declarations(unit: Unit, nodes: Iterable[c_ast.Node]) -> list[str]:
    """Return LLVM's text for the types, tables and outside functions of a file, and note them in `unit`."""
    parts = [f"declare double @{name}(double)" for name in LIBRARY.values()]
    for node in nodes:
        if isinstance(node, c_ast.Typedef):
            parts += _record(unit, node)
        elif isinstance(node.type, c_ast.FuncDecl):
            parts.append(_outside(unit, node))
        else:
            parts.append(_table(unit, node))
    return parts


def plain(c: str) -> str:
    """Return C without comments and macros, except for those before loops with independent passes."""
    c = re.sub(r"/\* independent \*/(?=\s*for \()", "#pragma independent", c)
    text = re.sub(r"/\*.*?\*/", "", c, flags=re.DOTALL)
    return "typedef long int64_t;\ntypedef unsigned long uint64_t;\n" + re.sub(r"INT64_C\((-?\d+)\)", r"\1", text)


def _record(unit: Unit, node: c_ast.Typedef) -> list[str]:
    if not isinstance(node.type.type, c_ast.Struct):
        return []
    types = ", ".join(unit.type_of(item.type) for item in node.type.type.decls)
    unit.records[f"%{node.name}"] = types
    return [f"%{node.name} = type {{ {types} }}"]


def _table(unit: Unit, node: c_ast.Decl) -> str:
    kind = unit.type_of(node.type.type)
    values = ", ".join(f"{kind} {number(kind, _literal(value))}" for value in node.init.exprs)
    unit.tables[node.name] = kind
    return f"@t.{node.name} = internal constant [{len(node.init.exprs)} x {kind}] [{values}]"


def _outside(unit: Unit, node: c_ast.Decl) -> str:
    arguments = [unit.type_of(argument.type) for argument in node.type.args.params]
    unit.functions[node.name] = Signature("void", arguments)
    unit.outside.add(node.name)
    return f"declare void @{node.name}({', '.join(arguments)})"


def _literal(node: c_ast.Node) -> int | float:
    """Return the number of a C expression."""
    if isinstance(node, c_ast.Cast):
        return _literal(node.expr)
    if isinstance(node, c_ast.UnaryOp):
        return -_literal(node.expr)
    if isinstance(node, c_ast.ID):
        return _NUMBERS[node.name]
    return float(node.value) if node.type == "double" else int(node.value)


def number(kind: str, value: float) -> str:
    """Return a number as LLVM text that preserves every bit."""
    if kind == POINTER:  # a row that is chosen later
        return "null"
    if kind == DOUBLE:
        return "0x" + struct.pack(">d", float(value)).hex().upper()
    return str(int(bool(value)) if kind == TRUTH else int(value))


def common(one: Term, other: Term) -> str:
    """Return the type in which C combines two values."""
    kind = max(one.type, other.type, key=_RANKS.index)
    if kind in {LITERAL, WHOLE}:  # a literal is a double if it has a point
        return DOUBLE if float in {type(one.text), type(other.text)} else WHOLE
    return kind


def operator(op: str, kind: str) -> tuple[str, bool]:
    """Return LLVM's instruction for an operator on numbers of a type, and whether it compares."""
    if op in _COUNTING:
        return (_FLOATING if kind == DOUBLE else _COUNTING)[op], False
    if kind == DOUBLE:
        return "fcmp " + ({"==": "oeq", "!=": "une"}.get(op) or f"o{_ORDERED[op]}"), True
    return "icmp " + ({"==": "eq", "!=": "ne"}.get(op) or f"{'u' if kind == TRUTH else 's'}{_ORDERED[op]}"), True


class Function:
    """One function of C."""

    def __init__(self, unit: Unit, node: c_ast.FuncDef, *, apart: bool):
        self.unit, self.node = unit, node
        self.name, declared = node.decl.name, node.decl.type
        self.parameters = [p for p in declared.args.params if p.name] if declared.args else []
        self.own = "static" in node.decl.storage
        returns = unit.type_of(declared.type) if self.own else "i32"  # for the engine an int is no truth value
        self.signature = Signature(returns, [unit.type_of(p.type) for p in self.parameters])
        unit.functions[self.name] = self.signature
        self.apart = apart
        self.places: list[str] = []  # allocations of its variables, at the beginning
        self.lines: list[str] = []
        self.scopes: list[dict[str, Term]] = [{}]
        self.loops: list[tuple[str, str]] = []  # targets of `continue` and `break`
        self.count = 0
        self.open = True  # whether control can reach the next line
        self.is_independent = False  # whether the passes of the next loop are
        self.group = 0  # number of the loop with independent passes around the next line
        unit.calls[self.name] = set()

    def text(self) -> str:
        """Return the function as LLVM text."""
        if self.name in OPERATIONS:
            return OPERATIONS[self.name]
        for i, (parameter, kind) in enumerate(zip(self.parameters, self.signature.arguments, strict=True)):
            self.emit(f"store {kind} %a{i}, ptr {self.variable(parameter.name, kind).text}")
        self.block(self.node.body)
        if self.open:
            self.emit("ret void" if self.signature.returns == "void" else "unreachable")
        mark = " noalias" if self.apart else ""
        arguments = ", ".join(
            f"{kind}{mark if kind == POINTER else ''} %a{i}" for i, kind in enumerate(self.signature.arguments)
        )
        # The prefix avoids names of the C library, as LLVM may insert calls of its functions, such as sincos.
        name = (
            f"internal {self.signature.returns} @f.{self.name}"
            if self.own
            else f"{self.signature.returns} @{self.name}"
        )
        head = f"define {name}({arguments}) {{"
        return "\n".join([head, *self.places, *self.lines, "}"])

    # Lines

    def emit(self, line: str) -> None:
        """Add an instruction."""
        if not self.open:  # unreachable code; LLVM needs a separate block for it
            self.begin(self.label())
        if self.group and re.match(r"store |call |\S+ = (load|call) ", line):
            line += f", !llvm.access.group !{3 * self.group}"
        self.lines.append(f"  {line}")

    def end(self, line: str) -> None:
        """Add the last instruction of a block."""
        self.emit(line)
        self.open = False

    def begin(self, label: str) -> None:
        """Begin a block."""
        if self.open:
            self.lines.append(f"  br label %{label}")
        self.lines.append(f"{label}:")
        self.open = True

    def label(self) -> str:
        """Return a name for a block."""
        self.count += 1
        return f"b{self.count}"

    def result(self, kind: str, line: str) -> Term:
        """Add an instruction that has a result; return the result."""
        self.count += 1
        name = f"%r{self.count}"  # before `emit`, which may increase the count for a label
        self.emit(f"{name} = {line}")
        return Term(kind, name)

    def variable(self, name: str, kind: str) -> Term:
        """Allocate memory for a variable."""
        self.count += 1
        place = Term(kind, f"%v{self.count}")
        self.places.append(f"  {place.text} = alloca {kind}")
        self.scopes[-1][name] = place
        return place

    # Statements

    def block(self, node: c_ast.Node | None) -> None:
        """Add statements."""
        self.scopes.append({})
        for statement in (node.block_items or []) if isinstance(node, c_ast.Compound) else [node]:
            if statement is not None:
                getattr(self, f"do_{type(statement).__name__}")(statement)
        self.scopes.pop()

    def do_Compound(self, node: c_ast.Compound) -> None:
        self.block(node)

    def do_Decl(self, node: c_ast.Decl) -> None:
        kind = self.unit.type_of(node.type)
        if isinstance(node.init, c_ast.InitList):
            place = self.variable(node.name, kind)
            kinds = self.unit.records[kind].split(", ")
            values = [self.value(item) for item in node.init.exprs]
            values += [Term(LITERAL, 0)] * (len(kinds) - len(values))
            for i, (inner, value) in enumerate(zip(kinds, values, strict=True)):
                at = self.result(POINTER, f"getelementptr inbounds {kind}, ptr {place.text}, i32 0, i32 {i}")
                self.emit(f"store {inner} {self.turned(value, inner)}, ptr {at.text}")
            return
        start = self.turned(self.value(node.init), kind)  # before its name hides another variable
        self.emit(f"store {kind} {start}, ptr {self.variable(node.name, kind).text}")

    def do_Assignment(self, node: c_ast.Assignment) -> None:
        value = self.value(node.rvalue)
        place = self.place(node.lvalue)
        if node.op != "=":
            value = self.combined(node.op[:-1], self.loaded(place), value)
        self.emit(f"store {place.type} {self.turned(value, place.type)}, ptr {place.text}")

    def do_UnaryOp(self, node: c_ast.UnaryOp) -> None:
        place = self.place(node.expr)
        step = "1" if node.op == "++" else "-1"
        after = self.result(WHOLE, f"add nsw i64 {self.loaded(place).text}, {step}")
        self.emit(f"store i64 {after.text}, ptr {place.text}")

    def do_FuncCall(self, node: c_ast.FuncCall) -> None:
        self.called(node)

    def do_Return(self, node: c_ast.Return) -> None:
        if node.expr is None:
            self.end("ret void")
            return
        kind = self.signature.returns
        self.end(f"ret {kind} {self.turned(self.value(node.expr), kind)}")

    def do_Break(self, _: c_ast.Break) -> None:
        self.end(f"br label %{self.loops[-1][1]}")

    def do_Continue(self, _: c_ast.Continue) -> None:
        self.end(f"br label %{self.loops[-1][0]}")

    def do_If(self, node: c_ast.If) -> None:
        then, other, after = self.label(), self.label(), self.label()
        self.branch(node.cond, then, other)
        self.begin(then)
        self.block(node.iftrue)
        if self.open:
            self.end(f"br label %{after}")
        self.begin(other)
        self.block(node.iffalse)
        self.begin(after)

    def do_While(self, node: c_ast.While) -> None:
        self.loop(node.cond, None, node.stmt)

    def do_For(self, node: c_ast.For) -> None:
        self.scopes.append({})
        for declaration in node.init.decls if node.init else []:
            self.do_Decl(declaration)
        around, mark = self.group, ""
        if self.is_independent:
            self.is_independent = False
            self.unit.groups = self.group = self.unit.groups + 1
            mark = f", !llvm.loop !{3 * self.group + 1}"
        self.loop(node.cond, node.next, node.stmt, mark)
        self.group = around
        self.scopes.pop()

    def do_Pragma(self, _: c_ast.Pragma) -> None:
        """Note that the passes of the next loop are independent: no other pragma is written."""
        self.is_independent = True

    def loop(self, condition: c_ast.Node | None, turn: c_ast.Node | None, body: c_ast.Node, mark: str = "") -> None:
        """Add a loop, with a mark for LLVM."""
        test, inside, following, after = (self.label() for _ in range(4))
        self.begin(test)
        if condition is None:
            self.end(f"br label %{inside}")
        else:
            self.branch(condition, inside, after)
        self.begin(inside)
        self.loops.append((following, after))
        self.block(body)
        self.loops.pop()
        self.begin(following)
        self.block(turn)
        self.end(f"br label %{test}{mark}")
        self.begin(after)

    def branch(self, condition: c_ast.Node, then: str, other: str) -> None:
        """End a block with a conditional branch."""
        self.end(f"br i1 {self.turned(self.value(condition), TRUTH)}, label %{then}, label %{other}")

    # Expressions

    def value(self, node: c_ast.Node) -> Term:
        """Return the value of an expression."""
        term: Term = getattr(self, f"get_{type(node).__name__}")(node)
        return term

    def get_Constant(self, node: c_ast.Constant) -> Term:
        return Term(LITERAL, _literal(node))

    def get_ID(self, node: c_ast.ID) -> Term:
        if node.name in _NUMBERS:
            return Term(LITERAL, _NUMBERS[node.name])
        return Term(POINTER, f"@t.{node.name}") if self.is_table(node) else self.loaded(self.place(node))

    def get_ArrayRef(self, node: c_ast.ArrayRef) -> Term:
        return self.loaded(self.place(node))

    def get_StructRef(self, node: c_ast.StructRef) -> Term:
        return self.loaded(self.place(node))

    def get_FuncCall(self, node: c_ast.FuncCall) -> Term:
        return self.called(node)

    def get_Cast(self, node: c_ast.Cast) -> Term:
        kind = self.unit.type_of(node.to_type.type)
        value = self.value(node.expr)
        if value.type == LITERAL:
            return Term(LITERAL, float(value.text) if kind == DOUBLE else int(value.text))
        return Term(kind, self.turned(value, kind))

    def get_UnaryOp(self, node: c_ast.UnaryOp) -> Term:
        value = self.value(node.expr)
        if node.op == "!":
            return self.result(TRUTH, f"xor i1 {self.turned(value, TRUTH)}, true")
        if value.type == LITERAL:
            return Term(LITERAL, -value.text)
        if value.type == DOUBLE:
            return self.result(DOUBLE, f"fneg double {value.text}")
        return self.result(WHOLE, f"sub i64 0, {self.turned(value, WHOLE)}")

    def get_BinaryOp(self, node: c_ast.BinaryOp) -> Term:
        if node.op in {"&&", "||"}:
            return self.logic(node)
        left = self.value(node.left)
        return self.combined(node.op, left, self.value(node.right))

    def get_TernaryOp(self, node: c_ast.TernaryOp) -> Term:
        then, other, after = self.label(), self.label(), self.label()
        self.branch(node.cond, then, other)
        values = []
        for label, part in ((then, node.iftrue), (other, node.iffalse)):
            self.begin(label)
            values.append((self.value(part), self.label()))
            self.begin(values[-1][1])  # the end of this alternative, where its conversion is inserted
            self.open = False  # until both types are known
        kind = common(*(value for value, _ in values))
        place = self.variable("", kind)
        for value, label in values:
            lines_before, self.lines, self.open = self.lines, [], True
            self.emit(f"store {kind} {self.turned(value, kind)}, ptr {place.text}")
            self.end(f"br label %{after}")
            at = lines_before.index(f"{label}:") + 1
            self.lines = [*lines_before[:at], *self.lines, *lines_before[at:]]
        self.begin(after)
        return self.loaded(place)

    def logic(self, node: c_ast.BinaryOp) -> Term:
        """Return the value of && or ||; the second operand is computed only if the first does not decide."""
        place, further, after = self.variable("", TRUTH), self.label(), self.label()
        first = self.turned(self.value(node.left), TRUTH)
        self.emit(f"store i1 {first}, ptr {place.text}")
        targets = (further, after) if node.op == "&&" else (after, further)
        self.end(f"br i1 {first}, label %{targets[0]}, label %{targets[1]}")
        self.begin(further)
        self.emit(f"store i1 {self.turned(self.value(node.right), TRUTH)}, ptr {place.text}")
        self.begin(after)
        return self.loaded(place)

    def combined(self, op: str, left: Term, right: Term) -> Term:
        """Return the result of an operator on two values."""
        if POINTER in {left.type, right.type}:  # a row of an array
            return self.result(
                POINTER, f"getelementptr inbounds double, ptr {left.text}, i64 {self.turned(right, WHOLE)}"
            )
        kind = common(left, right)
        if kind == TRUTH and op in _COUNTING:
            kind = WHOLE
        instruction, compares = operator(op, kind)
        a, b = self.turned(left, kind), self.turned(right, kind)
        return self.result(TRUTH if compares else kind, f"{instruction} {kind} {a}, {b}")

    def called(self, node: c_ast.FuncCall) -> Term:
        """Return the value of a call."""
        values = [self.value(argument) for argument in node.args.exprs] if node.args else []
        name = node.name.name
        if name in LIBRARY:
            return self.result(DOUBLE, f"call double @{LIBRARY[name]}(double {self.turned(values[0], DOUBLE)})")
        signature = self.unit.functions[name]
        self.unit.calls[self.name].add(name)
        if self.group:
            self.unit.within.add(name)
        given = ", ".join(f"{k} {self.turned(v, k)}" for k, v in zip(signature.arguments, values, strict=True))
        line = f"call {signature.returns} @{'' if name in self.unit.outside else 'f.'}{name}({given})"
        if signature.returns == "void":
            self.emit(line)
            return Term("void", "")
        return self.result(signature.returns, line)

    def place(self, node: c_ast.Node) -> Term:
        """Return the memory location of an expression, with the type of its content."""
        if isinstance(node, c_ast.ID):
            return next(scope[node.name] for scope in reversed(self.scopes) if node.name in scope)
        if isinstance(node, c_ast.StructRef):
            owner = self.place(node.name)
            i = int(node.field.name[1:])
            at = self.result(POINTER, f"getelementptr inbounds {owner.type}, ptr {owner.text}, i32 0, i32 {i}")
            return Term(self.unit.records[owner.type].split(", ")[i], at.text)
        owner = self.value(node.name)
        kind = self.unit.tables[node.name.name] if self.is_table(node.name) else DOUBLE
        index = self.turned(self.value(node.subscript), WHOLE)
        return Term(kind, self.result(POINTER, f"getelementptr inbounds {kind}, ptr {owner.text}, i64 {index}").text)

    def is_table(self, node: c_ast.Node) -> bool:
        """Return whether an expression is the name of a table that no variable hides."""
        name = node.name if isinstance(node, c_ast.ID) else None
        return name in self.unit.tables and not any(name in scope for scope in self.scopes)

    def loaded(self, place: Term) -> Term:
        """Return the value at a memory location."""
        return self.result(place.type, f"load {place.type}, ptr {place.text}")

    def turned(self, value: Term, kind: str) -> str:
        """Return a value converted to another type."""
        if value.type == LITERAL:
            return number(kind, value.text)
        if value.type == kind:
            return str(value.text)
        if kind == TRUTH:
            compare = "fcmp une double" if value.type == DOUBLE else f"icmp ne {value.type}"
            return str(self.result(TRUTH, f"{compare} {value.text}, {number(value.type, 0)}").text)
        if kind == DOUBLE:
            turn = "uitofp" if value.type == TRUTH else "sitofp"
        else:
            turn = "zext" if value.type == TRUTH else "fptosi"
        return str(self.result(kind, f"{turn} {value.type} {value.text} to {kind}").text)
