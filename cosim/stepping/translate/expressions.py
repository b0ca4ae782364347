"""Calls of other step functions, each in a separate line of C, in Python's order."""

from __future__ import annotations

import ast
from types import FunctionType

import numpy as np

from bayesftc.cosim.stepping.foreign import Foreign
from bayesftc.cosim.stepping.translate.conditions import Conditions
from bayesftc.cosim.stepping.translate.context import OPERATIONS
from bayesftc.cosim.stepping.translate.kinds import Array, Constant, as_number
from bayesftc.cosim.stepping.translate.values import Value, as_float, constant


class Expressions(Conditions):
    """All expressions."""

    def get_Call(self, node: ast.Call) -> Value:
        value = self.call(node)
        if value is None:
            self.refuse(
                node, f"uses the result of {ast.unparse(node.func)!r}, which returns nothing; return a number from it"
            )
        return value

    def call(self, node: ast.Call, *, wanted: bool = True) -> Value | None:
        """Return the result of a call, or None. Calls are emitted as separate lines, except operations."""
        target = self.value(node.func).kind
        function = target.value if isinstance(target, Constant) else None
        if function is len and len(node.args) == 1:
            owner = self.value(node.args[0]).kind
            if isinstance(owner, Array):
                return constant(owner.shape[0])
            if isinstance(owner, Constant) and isinstance(owner.value, tuple):
                return constant(len(owner.value))
        if function is np.float64 and len(node.args) == 1:
            return as_float(self.value(node.args[0]))
        if callable(function) and function in OPERATIONS:
            return self.operation(node, OPERATIONS[function])
        if isinstance(function, Foreign):
            self.foreign(node, function)
            return None
        if not isinstance(function, FunctionType):
            self.refuse(node, f"calls {ast.unparse(node.func)!r}, which is no step function; call only step functions")
        arguments = self.in_order(node, function)
        written = self.functions.require(function, [as_number(a.kind) or a.kind for a in arguments])
        self.called.add(written.name)
        texts = []
        for argument, name in zip(arguments, written.arguments, strict=True):
            if name in written.passed:
                texts.append(argument.text)
            if name in written.stored:
                self.stored |= argument.roots
        text = f"{written.name}({', '.join(texts)})"
        if written.returns is None or not wanted:
            self.emit(f"{text};")
            return None
        return self.temporary(Value(text, written.returns))

    def foreign(self, node: ast.Call, function: Foreign) -> None:
        """Call a function of other compiled code, which takes arrays only and returns nothing."""
        if node.keywords or len(node.args) != len(function.arguments):
            self.refuse(
                node, f"calls {ast.unparse(node.func)!r} with wrong arguments; they are {', '.join(function.arguments)}"
            )
        arguments = self.values(node.args)
        for name, argument in zip(function.arguments, arguments, strict=True):
            if not isinstance(argument.kind, Array):
                self.refuse(node, f"gives {ast.unparse(node.func)!r} a number for {name!r}; give an array")
            if name in function.stored:
                self.stored |= argument.roots
        self.functions.foreign(function)
        self.called.add(function.symbol)
        self.emit(f"{function.symbol}({', '.join(argument.text for argument in arguments)});")
