"""Translate one step function to one C function, for arguments of given kinds.

The contract of blocks allows numbers, indexed arrays of float64, loops over ranges, conditions, and calls of other such
functions. Each operation becomes the same operation of C in the same order, so a compiler without contraction gives the bits of
Python. Loops stay loops: the length of the C does not depend on the sizes of the arrays.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Sequence
from dataclasses import replace
from types import FunctionType
from typing import TYPE_CHECKING

from bayesftc.cosim.stepping.fingerprint import references
from bayesftc.cosim.stepping.source.tree import stores
from bayesftc.cosim.stepping.translate.expressions import Expressions
from bayesftc.cosim.stepping.translate.kinds import (
    INT,
    NATURAL,
    Array,
    Constant,
    Kind,
    Number,
    Record,
    as_number,
    joined,
)
from bayesftc.cosim.stepping.translate.source import ends, jumps, source_of
from bayesftc.cosim.stepping.translate.values import Value, as_float, as_kind, as_whole, constant

if TYPE_CHECKING:
    from bayesftc.cosim.stepping.translate.functions import Functions


class Translator(Expressions):
    """The statements of one function.

    The translation is repeated until the kinds of all variables are final: a variable that is first a whole number and later a
    float is always a double.
    """

    def __init__(self, functions: Functions, function: FunctionType, kinds: Sequence[Kind]):
        source = source_of(function)
        self.tree = source.tree
        arguments = dict(zip(source.arguments, kinds, strict=True))
        super().__init__(functions, function, arguments, dict(references(function)))
        self.counters, self.once, self.fresh = source.counters, source.once, source.fresh
        #: Names that do not change during a loop, and so may be used in its bounds.
        self.steady = self.counters | self.once | (set(arguments) - set(source.assigned))
        self.declared: dict[str, Kind] = {}
        self.returns: Kind | None = None
        self.nothing = False

    def translate(self) -> None:
        """Determine the lines of C, the kinds of the variables, and the result of the function."""
        before = None
        while before != (present := self._known()):
            before = present
            self.kinds = {name: kind for name, kind in self.declared.items() if name in self.arguments}
            self.constants, self.lines, self.depth, self.temporaries, self.kept = {}, [], 1, 0, set()
            self.spell((*self.arguments, *stores(self.tree)))
            self.block(self.tree.body)
        if self.returns is not None and (self.nothing or not ends(self.tree.body)):
            self.refuse(self.tree, "returns a value on one path and nothing on another; end it with a return")

    def _known(self) -> tuple[object, ...]:
        """Return the results of one pass that the next pass uses."""
        sets = frozenset(self.stored), frozenset(self.called)
        return dict(self.declared), self.returns, dict(self.roots), *sets

    def block(self, body: Sequence[ast.stmt]) -> None:
        """Translate statements."""
        for statement in body:
            method = getattr(self, f"do_{type(statement).__name__}", None)
            if method is None:
                kind = type(statement).__name__.lower()
                self.refuse(
                    statement,
                    f"has a statement ({kind}) that cannot be translated to C; use plain loops and assignments",
                )
            method(statement)

    def inner(self, head: str, body: Sequence[ast.stmt]) -> None:
        """Translate statements between braces."""
        self.emit(f"{head} {{")
        self.depth += 1
        self.block(body)
        self.depth -= 1
        self.emit("}")

    def do_Pass(self, _: ast.Pass) -> None:
        pass

    def do_Break(self, _: ast.Break) -> None:
        self.emit("break;")

    def do_Continue(self, _: ast.Continue) -> None:
        self.emit("continue;")

    def do_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return  # the docstring
        if not isinstance(node.value, ast.Call):
            self.refuse(node, "has a line without effect; leave it out")
        self.call(node.value, wanted=False)

    def do_Return(self, node: ast.Return) -> None:
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            self.nothing = True
            self.emit("return;")
            return
        kind: Kind
        if isinstance(node.value, ast.Tuple):
            values = self.values(node.value.elts)
            kind = Record(tuple(replace(self.number(node, value), natural=False) for value in values))
            record_name = self.new("t")
            texts = (as_kind(value, item).text for value, item in zip(values, kind.items, strict=True))
            self.emit(f"const {kind.c} {record_name} = {{ {', '.join(texts)} }};")
            value = Value(record_name, kind)
        else:
            value = self.value(node.value)
            kind = value.kind if isinstance(value.kind, Record) else self.number(node, value)
        both = joined(self.returns, kind) if self.returns is not None else kind
        if both is None:
            self.refuse(node, "returns values of different kinds; return the same kind everywhere")
        self.returns = both
        self.emit(f"return {as_kind(value, both).text};")

    # Assignments

    def do_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._plain(target)
        if len(node.targets) > 1:
            value = self.temporary(self.value(node.value))
            for target in node.targets:
                self.assign(target, value)
        elif isinstance(node.targets[0], ast.Tuple):
            self._assign_all(node, node.targets[0])
        else:
            self.assign(node.targets[0], self._unnamed(self.value(node.value)))

    def _unnamed(self, value: Value) -> Value:
        """Return the expression of the temporary variable in the last line, and remove that line."""
        begin = f"const {getattr(value.kind, 'c', '')} {value.text} = "
        if value.text not in self.kept or not self.lines or not self.lines[-1].lstrip().startswith(begin):
            return value
        return replace(value, text=self.lines.pop().lstrip().removeprefix(begin).removesuffix(";"))

    def _plain(self, target: ast.expr) -> None:
        """Refuse a call in the target of an assignment: Python makes it after those of the value."""
        if self.calls(target):
            self.refuse(
                target,
                f"calls a function in the target of an assignment ({ast.unparse(target)}); call it in a line before",
            )

    def do_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._plain(node.target)
        if node.value is not None:
            self.assign(node.target, self.value(node.value))

    def do_AugAssign(self, node: ast.AugAssign) -> None:
        self._plain(node.target)
        target = copy.deepcopy(node.target)
        target.ctx = ast.Load()
        changed = ast.copy_location(ast.BinOp(target, node.op, node.value), node)
        self.assign(node.target, self.value(ast.fix_missing_locations(changed)))

    def _assign_all(self, node: ast.Assign, target: ast.Tuple) -> None:
        if isinstance(node.value, ast.Tuple):
            values = self.values(node.value.elts)
        else:
            whole = self.value(node.value)
            if isinstance(whole.kind, Record):
                values = [Value(f"{whole.text}.v{i}", kind) for i, kind in enumerate(whole.kind.items)]
            elif isinstance(whole.kind, Constant) and isinstance(whole.kind.value, tuple):
                values = [constant(item) for item in whole.kind.value]
            else:
                self.refuse(node, "unpacks a value that is no tuple; assign it to one name")
        if len(values) != len(target.elts):
            self.refuse(
                node, f"unpacks {len(values)} values into {len(target.elts)} names; use as many names as values"
            )
        read = {n.id for n in ast.walk(node.value) if isinstance(n, ast.Name)}
        if read & set(stores(target)) or any(isinstance(n, ast.Subscript) for n in ast.walk(target)):
            values = [self.temporary(value) for value in values]  # read all before writing the first
        for element, value in zip(target.elts, values, strict=True):
            if not (isinstance(element, ast.Name) and element.id == "_"):  # never read
                self.assign(element, value)

    def assign(self, target: ast.expr, value: Value) -> None:
        """Translate an assignment."""
        if isinstance(target, ast.Subscript):
            element = self.element(target, stored=True)
            if not isinstance(element.kind, Number):
                self.refuse(target, "assigns to a whole row or a tuple; assign number by number, in a loop")
            self.number(target, value)
            self.emit(f"{element.text} = {as_float(value).text};")
            return
        if not isinstance(target, ast.Name):
            self.refuse(target, "assigns to something other than a name or an element of an array; use one of these")
        name = target.id
        if isinstance(value.kind, Constant) and name in self.once:
            self.constants[name] = value
            return
        if isinstance(value.kind, Constant) and as_number(value.kind) is None:
            self.refuse(target, f"assigns {name!r} more than once, and not always a number; use two names")
        kind = as_number(value.kind) or value.kind
        if isinstance(kind, Array):
            own_root = frozenset({name} if name in self.arguments else ())
            self.roots[name] = self.roots.get(name, own_root) | value.roots
        declared_kind = self._declare(target, name, kind)
        text = as_kind(value, declared_kind).text
        start = ""
        if name in self.fresh:
            start = (
                self.pointer(self.roots[name])
                if isinstance(declared_kind, Array)
                else f"const {getattr(declared_kind, 'c', '')} "
            )
        self.emit(f"{start}{self.local(name)} = {text};")

    def _declare(self, node: ast.AST, name: str, kind: Kind) -> Kind:
        """Declare that a variable may have this kind."""
        if name in self.arguments:
            self.declared.setdefault(name, self.arguments[name])
        both = joined(self.declared.get(name, kind), kind)
        if both is None or (
            name in self.arguments and getattr(both, "c", "") != getattr(self.arguments[name], "c", "")
        ):
            self.refuse(node, f"assigns values of different kinds to {name!r}; use two names")
        self.declared[name] = self.kinds[name] = both
        return both

    # Branches and loops

    def do_If(self, node: ast.If) -> None:
        test = self.truth(node.test)
        if isinstance(test.kind, Constant):
            self.block(node.body if test.kind.value else node.orelse)
            return
        self.inner(f"if ({test.text})", node.body)
        if node.orelse:
            self.lines.pop()
            self.inner("} else", node.orelse)

    def do_While(self, node: ast.While) -> None:
        if node.orelse:
            self.refuse(node, "has an else after a loop; write it without")
        if not self.calls(node.test):
            self.inner(f"while ({self.truth(node.test).text})", node.body)
            return
        leave = ast.If(ast.UnaryOp(ast.Not(), node.test), [ast.Break()], [])
        self.inner("for (;;)", [ast.fix_missing_locations(ast.copy_location(leave, node)), *node.body])

    def do_For(self, node: ast.For) -> None:
        if node.orelse:
            self.refuse(node, "has an else after a loop; write it without")
        call = node.iter
        if not isinstance(node.target, ast.Name) or not isinstance(call, ast.Call) or not self._is_range(call):
            self.refuse(node, "loops over something other than a range; write for i in range(n)")
        begin, end, step = self._bounds(node, call)
        if isinstance(begin.kind, Constant) and isinstance(end.kind, Constant):
            rounds = len(range(begin.kind.value, end.kind.value, step))
            if not rounds:
                return
            if rounds == 1 and node.target.id in self.counters and not jumps(node.body):
                self._one_round(node.target.id, begin, node.body)
                return
        if not self._is_steady(call.args[0 if len(call.args) == 1 else 1]):
            end = self.temporary(end)
        self._loop(node, node.target.id, begin, end, step)

    def _bounds(self, node: ast.For, call: ast.Call) -> tuple[Value, Value, int]:
        """Return the begin, end and step of a range."""
        bounds = [as_whole(self.whole(call, value)) for value in self.values(call.args)]
        begin, end, by = (constant(0), *bounds, constant(1)) if len(bounds) == 1 else (*bounds, constant(1))[:3]
        if not isinstance(by.kind, Constant) or not by.kind.value:
            self.refuse(node, "has a loop whose step is not constant; write the step as a number")
        return begin, end, int(by.kind.value)

    def _one_round(self, name: str, value: Value, body: Sequence[ast.stmt]) -> None:
        """Translate the body of a loop with one pass, where the counter is constant."""
        self.constants[name] = value
        self.block(body)
        del self.constants[name]

    def _loop(self, node: ast.For, name: str, begin: Value, end: Value, step: int) -> None:
        """Translate a loop; its counter is declared outside if it is used there."""
        upward = self.number(node, begin).natural and step > 0
        downward = step < 0 and isinstance(end.kind, Constant) and end.kind.value >= -1
        scoped = name in self.counters
        counter = self.local(name) if scoped else self.new("i")
        turn = f"{'++' if step > 0 else '--'}{counter}" if abs(step) == 1 else f"{counter} += {step}"
        if (
            isinstance(node.iter, ast.Call)
            and isinstance(node.iter.func, ast.Name)
            and node.iter.func.id == "independent"
        ):
            self.emit("/* independent */")
        self.emit(f"for (int64_t {counter} = {begin.text}; {counter} {'<' if step > 0 else '>'} {end.text}; {turn}) {{")
        self.depth += 1
        kind = NATURAL if upward or downward else INT
        if scoped:
            self.kinds[name] = kind
        else:
            self._declare(node, name, kind)
            self.emit(f"{self.local(name)} = {as_kind(Value(counter, kind), self.kinds[name]).text};")
        self.block(node.body)
        self.depth -= 1
        self.emit("}")

    def _is_range(self, node: ast.Call) -> bool:
        if node.keywords or not 1 <= len(node.args) <= 3:
            return False
        called = self.value(node.func).kind
        return isinstance(called, Constant) and called.value is range

    def _is_steady(self, node: ast.expr) -> bool:
        """Return whether an expression does not change during the loop: it reads no arrays, and only steady names."""
        plain = (
            ast.Name,
            ast.Constant,
            ast.BinOp,
            ast.UnaryOp,
            ast.operator,
            ast.unaryop,
            ast.expr_context,
            ast.Attribute,
        )
        return not self.calls(node) and all(
            isinstance(n, plain) and (not isinstance(n, ast.Name) or n.id in self.steady | set(self.names))
            for n in ast.walk(node)
        )
