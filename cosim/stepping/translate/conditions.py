"""Conditions, choices and the operations of `bayesftc.cosim.ops` as expressions of C."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from typing import Any

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.translate.arithmetic import Arithmetic
from bayesftc.cosim.stepping.translate.kinds import BOOL, FLOAT, Constant, Number, joined
from bayesftc.cosim.stepping.translate.values import (
    AND,
    ATOM,
    CHOICE,
    EQUAL,
    OR,
    ORDER,
    SUM,
    UNARY,
    Value,
    as_float,
    as_kind,
    constant,
    enclosed,
)

_COMPARISONS: dict[type[ast.cmpop], tuple[str, int, Callable[[Any, Any], Any]]] = {
    ast.Lt: ("<", ORDER, operator.lt),
    ast.LtE: ("<=", ORDER, operator.le),
    ast.Gt: (">", ORDER, operator.gt),
    ast.GtE: (">=", ORDER, operator.ge),
    ast.Eq: ("==", EQUAL, operator.eq),
    ast.NotEq: ("!=", EQUAL, operator.ne),
}


class Conditions(Arithmetic):
    """Expressions without calls of step functions."""

    def truth(self, node: ast.expr) -> Value:
        """Return the truth value of an expression."""
        return self._logic(node) if isinstance(node, ast.BoolOp) else self._true(node, self.value(node))

    def _true(self, node: ast.AST, value: Value) -> Value:
        if isinstance(value.kind, Constant):
            return constant(bool(value.kind.value))
        kind = self.number(node, value)
        if kind.type == "bool":
            return value
        return Value(f"{enclosed(value, ORDER)} != {'0.0' if kind.type == 'float' else '0'}", BOOL, EQUAL)

    def get_Compare(self, node: ast.Compare) -> Value:
        if any(type(op) not in _COMPARISONS for op in node.ops):
            self.refuse(
                node, f"has a comparison ({ast.unparse(node)}) that cannot be translated to C; use < <= > >= == !="
            )
        if any(self.calls(later) for later in node.comparators[1:]):
            self.refuse(node, "calls a function after a second comparison; call it in a line before")
        values = self.values([node.left, *node.comparators])
        results = []
        for op, left, right in zip(node.ops, values, values[1:], strict=False):
            sign, level, fold = _COMPARISONS[type(op)]
            types = {self.number(node, left).type, self.number(node, right).type}
            if isinstance(left.kind, Constant) and isinstance(right.kind, Constant):
                results.append(constant(bool(fold(left.kind.value, right.kind.value))))
            else:
                if "float" in types:
                    left, right = as_float(left), as_float(right)
                results.append(Value(f"{enclosed(left, SUM)} {sign} {enclosed(right, SUM)}", BOOL, level))
        return _all(results)

    def get_BoolOp(self, node: ast.BoolOp) -> Value:
        return self._logic(node, chosen=True)

    def _logic(self, node: ast.BoolOp, *, chosen: bool = False) -> Value:
        """Return the value of ``and`` or ``or``; with `chosen`, one of the operands is the result."""
        if any(self.calls(part) for part in node.values[1:]):
            self.refuse(node, "calls a function within 'and' or 'or'; call it in a line before")
        parts = [self.value(part) if chosen else self.truth(part) for part in node.values]
        if any(self.number(node, part).type != "bool" for part in parts):
            self.refuse(node, "uses a number in 'and' or 'or'; use ops.select")
        return _all(parts) if isinstance(node.op, ast.And) else _any(parts)

    def get_IfExp(self, node: ast.IfExp) -> Value:
        test = self.truth(node.test)
        if isinstance(test.kind, Constant):
            return self.value(node.body if test.kind.value else node.orelse)
        if self.calls(node.body) or self.calls(node.orelse):
            self.refuse(node, "calls a function within 'a if b else c'; call it in a line before, or write if and else")
        one, other = self.value(node.body), self.value(node.orelse)
        kind = joined(one.kind, other.kind)
        if not isinstance(kind, Number):
            self.refuse(node, "chooses between values that are not numbers; choose between numbers")
        one, other = as_kind(one, kind), as_kind(other, kind)
        if kind.type == "int" and isinstance(one.kind, Constant) and isinstance(other.kind, Constant):
            one = Value(
                f"(int64_t){enclosed(one, UNARY)}", kind, UNARY
            )  # in C, a choice between two literals is an int
        return Value(f"{enclosed(test, OR)} ? {enclosed(one, OR)} : {enclosed(other, OR)}", kind, CHOICE)

    def get_UnaryOp(self, node: ast.UnaryOp) -> Value:
        if not isinstance(node.op, ast.Not):
            return super().get_UnaryOp(node)
        value = self.truth(node.operand)
        if isinstance(value.kind, Constant):
            return constant(not value.kind.value)
        return Value(f"!{enclosed(value, ATOM)}", BOOL, UNARY)

    def operation(self, node: ast.Call, name: str) -> Value:
        """Return the result of an operation."""
        operands = self.in_order(node, getattr(ops, name))
        conditions = len(operands) if name in {"both", "either", "negate"} else int(name == "select")
        results = [operand if isinstance(operand, Value) else constant(operand) for operand in operands]
        values = [self._true(node, value) for value in results[:conditions]] + results[conditions:]
        for value in values:
            self.number(node, value)
        known = [value.kind.value for value in values if isinstance(value.kind, Constant)]
        if len(known) == len(values):
            return constant(getattr(ops, name)(*known).item())
        values[conditions:] = map(as_float, values[conditions:])
        if name in {"both", "either"}:
            return _all(values) if name == "both" else _any(values)
        if name == "negate":
            return Value(f"!{enclosed(values[0], ATOM)}", BOOL, UNARY)
        if name in ops.COMPOSED:
            called = self.functions.require(ops.COMPOSED[name], [FLOAT] * len(values)).name
            self.called.add(called)
        else:
            called = ops.OF_LIBRARY.get(name, f"op_{name}")
        return Value(f"{called}({', '.join(value.text for value in values)})", BOOL if name == "isnan" else FLOAT)


def _all(parts: Sequence[Value]) -> Value:
    if any(isinstance(part.kind, Constant) and not part.kind.value for part in parts):
        return constant(False)
    rest = [part for part in parts if not isinstance(part.kind, Constant)]
    if len(rest) < 2:
        return rest[0] if rest else constant(True)
    return Value(" && ".join(enclosed(part, EQUAL) for part in rest), BOOL, AND)


def _any(parts: Sequence[Value]) -> Value:
    if any(isinstance(part.kind, Constant) and part.kind.value for part in parts):
        return constant(True)
    rest = [part for part in parts if not isinstance(part.kind, Constant)]
    if len(rest) < 2:
        return rest[0] if rest else constant(False)
    return Value(" || ".join(enclosed(part, EQUAL) for part in rest), BOOL, OR)
