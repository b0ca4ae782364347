"""Names, elements of arrays and arithmetic of step functions as expressions of C."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.translate.context import Context
from bayesftc.cosim.stepping.translate.kinds import (
    BOOL,
    FLOAT,
    INT,
    NATURAL,
    Array,
    Constant,
    Kind,
    Number,
    joined,
)
from bayesftc.cosim.stepping.translate.values import (
    ATOM,
    PRODUCT,
    SUM,
    UNARY,
    Value,
    as_float,
    as_whole,
    constant,
    enclosed,
)

_ARITHMETIC: dict[type[ast.operator], tuple[str, int, Callable[[Any, Any], Any]]] = {
    ast.Add: ("+", SUM, operator.add),
    ast.Sub: ("-", SUM, operator.sub),
    ast.Mult: ("*", PRODUCT, operator.mul),
    ast.Div: ("/", PRODUCT, operator.truediv),
    ast.FloorDiv: ("op_quotient", ATOM, operator.floordiv),
    ast.Mod: ("op_remainder", ATOM, operator.mod),
}
_TRUTH = (
    "calculates with two truth values, which NumPy does not treat as numbers; use ops.select, ops.both or ops.either"
)


class Arithmetic(Context):
    """Expressions without conditions and calls."""

    def get_Constant(self, node: ast.Constant) -> Value:
        if not isinstance(node.value, int | float):
            self.refuse(node, f"uses {node.value!r}, which is no number; use a number for each case")
        return self.known(node, node.value)

    def known(self, node: ast.AST, value: Any) -> Value:
        """Return a constant value, if it fits a number of C."""
        if isinstance(value, np.generic) and not isinstance(value, float | np.bool_ | np.int64):
            self.refuse(node, f"uses a number of the type {type(value).__name__}; use a plain Python number")
        if isinstance(value, int | np.integer) and not -(2**63) < value < 2**63:
            self.refuse(
                node, f"uses the whole number {value}, which does not fit 64 bits; write it with a decimal point"
            )
        return constant(value)

    def get_Name(self, node: ast.Name) -> Value:
        name = node.id
        if name in self.constants:
            return self.constants[name]
        kind = self.kinds.get(name, self.arguments.get(name))
        if kind is not None:
            return self._variable(name, kind)
        if name in self.names:
            return self.known(node, self.names[name])
        self.refuse(node, f"uses {name!r} before it has a value; assign it before")

    def _variable(self, name: str, kind: Kind) -> Value:
        """Return a variable, or an argument."""
        if isinstance(kind, Constant):
            return constant(kind.value)
        if isinstance(kind, Array):
            return Value(self.local(name), kind, roots=self.roots.get(name, frozenset({name})))
        return Value(self.local(name), kind)

    def get_Attribute(self, node: ast.Attribute) -> Value:
        owner = self.value(node.value)
        if isinstance(owner.kind, Constant) and node.attr in getattr(owner.kind.value, "_fields", ()):
            return constant(getattr(owner.kind.value, node.attr))
        if isinstance(owner.kind, Array) and node.attr in {"shape", "size", "ndim"}:
            shape = owner.kind.shape
            return constant({"shape": shape, "size": owner.kind.size, "ndim": len(shape)}[node.attr])
        if isinstance(owner.kind, Constant) and owner.kind.value is ops and node.attr in ops.NAMES:
            return constant(getattr(ops, node.attr))
        self.refuse(node, f"uses the attribute {node.attr!r}; of arrays only shape, size and indexing are available")

    def get_Tuple(self, node: ast.Tuple) -> Value:
        values = [self.value(item) for item in node.elts]
        known = [value.kind.value for value in values if isinstance(value.kind, Constant)]
        if len(known) < len(values):
            self.refuse(node, "creates a tuple of numbers that are not constant; use several names")
        return constant(tuple(known))

    def get_Subscript(self, node: ast.Subscript) -> Value:
        return self.element(node)

    def element(self, node: ast.Subscript, *, stored: bool = False) -> Value:
        """Return an element or a row of an array, or an element of a tuple."""
        nodes = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if any(isinstance(n, ast.Slice) for n in nodes):
            self.refuse(node, "uses a slice; write a loop over its elements")
        owner, *indices = self.values([node.value, *nodes])
        indices = [self.whole(node, index) for index in indices]
        if isinstance(owner.kind, Array) and any(self.number(node, index).type == "bool" for index in indices):
            self.refuse(
                node,
                f"uses a truth value as an index ({ast.unparse(node)}), which is a mask in NumPy; use a whole number",
            )
        if isinstance(owner.kind, Constant) and isinstance(owner.kind.value, tuple):
            return self._item(node, owner.kind.value, indices)
        if not isinstance(owner.kind, Array) or len(indices) > len(owner.kind.shape):
            self.refuse(
                node, f"uses an index where there is no element ({ast.unparse(node)}); check the number of indices"
            )
        if stored:
            self.stored |= owner.roots
        shape, total = owner.kind.shape, constant(0)
        for axis, length in enumerate(shape):  # row by row
            total = self.combine(ast.Mult(), total, constant(length))
            if axis < len(indices):
                total = self.combine(ast.Add(), total, self._counted(node, indices[axis], length))
        if len(indices) == len(shape):
            return Value(f"{owner.text}[{total.text}]", FLOAT)
        return Value(f"({owner.text} + {enclosed(total, SUM)})", Array(shape[len(indices) :]), roots=owner.roots)

    def _counted(self, node: ast.AST, index: Value, length: int) -> Value:
        """Return an index from the front; negative ones count from the end in Python."""
        if isinstance(index.kind, Constant):
            at = int(index.kind.value)
            if not -length <= at < length:
                self.refuse(
                    node,
                    f"uses element {at} of {length} ({ast.unparse(node)}); the last one is {length - 1}",
                )
            return constant(at % length)
        if self.number(node, index).natural:
            return as_whole(index)
        return Value(f"op_index({index.text}, {length})", NATURAL)

    def _item(self, node: ast.AST, values: tuple[Any, ...], indices: Sequence[Value]) -> Value:
        if len(indices) != 1 or not values:
            self.refuse(node, "uses an element of a tuple that does not exist; check the index")
        index = self._counted(node, indices[0], len(values))
        if isinstance(index.kind, Constant):
            return constant(values[index.kind.value])
        kind: Kind | None = Constant(values[0])
        for value in values:
            kind = joined(kind, Constant(value)) if kind is not None else None
        if not isinstance(kind, Number):
            self.refuse(node, "uses a variable index into a tuple whose elements are not all numbers; use numbers only")
        table = self.functions.table(values, kind)
        self.called.add(table)
        return Value(f"{table}[{index.text}]", kind)

    def get_UnaryOp(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        kind = FLOAT if self.number(node, value).type == "float" else INT
        if isinstance(node.op, ast.Invert):
            self.refuse(
                node,
                f"has an operation ({ast.unparse(node)}) that cannot be translated to C; use + - * / and cosim.ops",
            )
        if isinstance(value.kind, Constant):
            return self.known(node, -value.kind.value if isinstance(node.op, ast.USub) else +value.kind.value)
        if self.number(node, value) == BOOL:
            self.refuse(node, _TRUTH)
        return value if isinstance(node.op, ast.UAdd) else Value(f"-{enclosed(value, ATOM)}", kind, UNARY)

    def get_BinOp(self, node: ast.BinOp) -> Value:
        if type(node.op) not in _ARITHMETIC:
            self.refuse(
                node,
                f"has an operation ({ast.unparse(node)}) that cannot be translated to C; use + - * / and cosim.ops",
            )
        left, right = self.values([node.left, node.right])
        return self.combine(node.op, left, right, node)

    def combine(self, op: ast.operator, left: Value, right: Value, node: ast.AST | None = None) -> Value:
        """Return the result of an arithmetic operation; of two constants, the constant result."""
        node = node or ast.Pass()
        sign, level, fold = _ARITHMETIC[type(op)]
        one, other = self.number(node, left), self.number(node, right)
        if isinstance(left.kind, Constant) and isinstance(right.kind, Constant):
            try:
                return self.known(node, fold(left.kind.value, right.kind.value))
            except (ZeroDivisionError, OverflowError) as error:
                self.refuse(node, f"has an operation on constants without a result ({error}); correct the numbers")
        if one.type == other.type == "bool":
            self.refuse(node, _TRUTH)
        whole = "float" not in {one.type, other.type}
        left, right = (as_whole(left), as_whole(right)) if whole else (as_float(left), as_float(right))
        natural = all(number.natural or number.type == "bool" for number in (one, other))
        if isinstance(op, ast.FloorDiv | ast.Mod):
            if not whole:
                self.refuse(node, "uses // or % with numbers that are not whole; use ops.floor")
            return Value(f"{sign}({left.text}, {right.text})", NATURAL if natural else INT)
        if isinstance(op, ast.Div):
            left, right = as_float(left), as_float(right)
        elif whole:
            for known, rest in ((left, right), (right, left)):  # common in indices
                value = known.kind.value if isinstance(known.kind, Constant) else None
                if value == 0 and isinstance(op, ast.Mult):
                    return constant(0)
                if (value == 0 and isinstance(op, ast.Add)) or (value == 1 and isinstance(op, ast.Mult)):
                    return rest
        kind = FLOAT if isinstance(op, ast.Div) or not whole else NATURAL if natural and sign != "-" else INT
        return Value(f"{enclosed(left, level)} {sign} {enclosed(right, level - 1)}", kind, level)
