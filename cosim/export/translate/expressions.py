"""Calls of other step functions, each in a line of C of its own, in the order in which Python makes them."""

from __future__ import annotations

import ast
from types import FunctionType

from bayesftc.cosim.export.translate.conditions import Conditions
from bayesftc.cosim.export.translate.context import OPERATIONS
from bayesftc.cosim.export.translate.kinds import Array, Constant, Fields
from bayesftc.cosim.export.translate.values import Value, constant, passed_kind
from bayesftc.cosim.stepping.records import is_record_class


class Expressions(Conditions):
    """All expressions."""

    def get_Call(self, node: ast.Call) -> Value:
        value = self.call(node)
        if value is None:
            self.refuse(node, f"uses what {ast.unparse(node.func)!r} returns, which is nothing")
        return value

    def call(self, node: ast.Call, *, wanted: bool = True) -> Value | None:
        """Return what a call returns; None for nothing. It is made in a line of its own, here, but for operations."""
        target = self.value(node.func).kind
        function = target.value if isinstance(target, Constant) else None
        if function is len and len(node.args) == 1:
            owner = self.value(node.args[0]).kind
            if isinstance(owner, Array):
                return constant(owner.shape[0])
            if isinstance(owner, Constant) and isinstance(owner.value, tuple):
                return constant(len(owner.value))
        if callable(function) and function in OPERATIONS:
            return self.operation(node, OPERATIONS[function])
        if isinstance(function, type) and is_record_class(function):
            fields = tuple(self._kept(value) for value in self.in_order(node, function))
            return Value("", Fields(function, tuple(value.kind for value in fields)), fields=fields)
        if not isinstance(function, FunctionType):
            self.refuse(node, f"calls {ast.unparse(node.func)!r}, which is no step function")
        arguments = self.in_order(node, function)
        written = self.functions.require(function, [passed_kind(a) for a in arguments])
        self.called.add(written.name)
        texts = []
        leaves = [leaf for argument in arguments for leaf in argument.leaves]
        for argument, name in zip(leaves, written.arguments, strict=True):
            if name in written.passed:
                texts.append(argument.text)
            if name in written.stored:
                self.stored |= argument.roots
        text = f"{written.name}({', '.join(texts)})"
        if written.returns is None or not wanted:
            self.emit(f"{text};")
            return None
        return self.temporary(Value(text, written.returns))

    def _kept(self, value: Value) -> Value:
        """Return a value as a record keeps it, whatever becomes of the variables that it was computed from."""
        unchanged = self.arguments.keys() - self.assigned
        whole = isinstance(value.kind, Constant | Fields) or value.text in map(self.local, unchanged)
        return value if whole else self.temporary(value)
