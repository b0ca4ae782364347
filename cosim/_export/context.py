"""What is known of a function while its C is written, and the lines written so far."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import FunctionType
from typing import TYPE_CHECKING, Any, NoReturn

from bayesftc.cosim import ops
from bayesftc.cosim._export.kinds import Array, Constant, Kind, Number, as_number
from bayesftc.cosim._export.source import place
from bayesftc.cosim._export.values import ATOM, Value
from bayesftc.cosim.errors import KernelError

if TYPE_CHECKING:
    from bayesftc.cosim._export.functions import Functions

OPERATIONS = {getattr(ops, name): name for name in ops.NAMES}
"""The name of each operation of step functions."""


class Context:
    """What a function's variables are so far, and each expression as C.

    Whatever must be computed before the line that an expression stands in goes through `emit`: what a function returns, and
    what was read before that function was called.

    Parameters
    ----------
    functions : Functions
        All functions of the file.
    function : function
        The step function, or one that it calls.
    arguments : mapping of str to Kind
        What its arguments are.
    names : mapping of str to object
        Its global names and those of the functions around it.
    """

    def __init__(
        self, functions: Functions, function: FunctionType, arguments: Mapping[str, Kind], names: Mapping[str, Any]
    ):
        self.functions, self.function, self.arguments, self.names = functions, function, arguments, names
        self.kinds: dict[str, Kind] = {}  # of variables that C has, too
        self.constants: dict[str, Value] = {}  # variables that are known now
        self.roots: dict[str, str | None] = {}
        self.stored: set[str] = set()  # arguments whose elements are assigned
        self.called: set[str] = set()  # names of the file that no variable may hide
        self.renamed: set[str] = set()
        self.lines: list[str] = []
        self.depth = 1
        self.temporaries = 0

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise the error that this line cannot become C."""
        raise KernelError(f"Step function {place(self.function, node)} {what}.")

    def emit(self, line: str) -> None:
        """Add a line of C."""
        self.lines.append("    " * self.depth + line)

    def local(self, name: str) -> str:
        """Return what a variable is called in C."""
        plain = self.functions.allowed(name)
        return f"{plain}_" if name in self.renamed else plain

    def new(self, prefix: str) -> str:
        """Return a name for something that Python has no name for."""
        self.temporaries += 1
        return f"{prefix}_{self.temporaries}"

    def temporary(self, value: Value) -> Value:
        """Return the value kept in a variable of its own, so that what comes later does not change it."""
        if isinstance(value.kind, Constant | Array):
            return value
        name = self.new("t")
        self.emit(f"const {value.kind.c} {name} = {value.text};")
        return replace(value, text=name, level=ATOM)

    def values(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Return the values of expressions, each as it was when Python would have come to it."""
        found = []
        for i, node in enumerate(nodes):
            value = self.value(node)
            found.append(self.temporary(value) if any(self.calls(later) for later in nodes[i + 1 :]) else value)
        return found

    def value(self, node: ast.expr) -> Value:
        """Return an expression."""
        method = getattr(self, f"get_{type(node).__name__}", None)
        if method is None:
            self.refuse(node, f"has an expression ({ast.unparse(node)}) that C is not written for")
        found: Value = method(node)
        return found

    def number(self, node: ast.AST, value: Value) -> Number:
        """Return the kind of number that a value is."""
        kind = as_number(value.kind)
        if kind is None:
            self.refuse(node, "uses an array, a tuple or a function where a number must stand; take an element of it")
        return kind

    def whole(self, node: ast.AST, value: Value) -> Value:
        """Return a value that is a whole number."""
        if self.number(node, value).type == "float":
            self.refuse(node, f"counts with what is no whole number ({ast.unparse(node)})")
        return value

    def calls(self, node: ast.expr) -> bool:
        """Return whether an expression calls anything that may write into arrays."""
        return any(isinstance(n, ast.Call) and not self._is_pure(n.func) for n in ast.walk(node))

    def _is_pure(self, node: ast.expr) -> bool:
        if isinstance(node, ast.Attribute):
            return node.attr in ops.NAMES
        value = self.names.get(node.id) if isinstance(node, ast.Name) else None
        return value in (len, range) or (callable(value) and value in OPERATIONS)
