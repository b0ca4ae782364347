"""What is known of a function while its C is written, and the lines written so far."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import FunctionType
from typing import Any, NoReturn, Protocol

from bayesftc.cosim import ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.source.tree import parameters, place
from bayesftc.cosim.stepping.translate.kinds import Array, Constant, Kind, Number, as_number
from bayesftc.cosim.stepping.translate.values import ATOM, Value, constant

OPERATIONS = {getattr(ops, name): name for name in ops.NAMES}
"""The name of each operation of step functions."""


class Functions(Protocol):
    """All functions of one C file, as one of them sees them: those that it calls, and names and tables that are of the file."""

    def require(self, function: FunctionType, kinds: Sequence[Kind]) -> Any:
        """Return the C function for arguments of these kinds."""

    def allowed(self, name: str) -> str:
        """Return a name as C allows it."""

    def table(self, values: tuple[Any, ...], kind: Number) -> str:
        """Return the name of the file's table of these numbers."""


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
        self.functions, self.function, self.names = functions, function, names
        self.arguments = arguments
        self.kinds: dict[str, Kind] = {}  # of variables that C has, too
        self.constants: dict[str, Value] = {}  # variables that are known now
        self.roots: dict[str, frozenset[str]] = {}
        self.stored: set[str] = set()  # arguments whose elements are assigned
        self.called: set[str] = set()  # names of the file that no variable may hide
        self.spelled: dict[str, str] = {}  # what its names are called in C
        self.lines: list[str] = []
        self.depth = 1
        self.temporaries = 0
        self.kept: set[str] = set()  # names of numbers that Python has no name for

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise the error that this line cannot become C."""
        raise KernelError(f"Step function {place(self.function, node)} {what}.")

    def emit(self, line: str) -> None:
        """Add a line of C."""
        self.lines.append("    " * self.depth + line)

    def local(self, name: str) -> str:
        """Return what a variable is called in C."""
        return self.spelled.get(name, name)

    def spell(self, names: Iterable[str]) -> None:
        """Choose what variables are called in C: no two alike, and none like what the function calls."""
        self.spelled, taken = {}, set(self.called)
        for name in sorted(set(names)):
            plain = self.functions.allowed(name.replace(".", "_"))
            while plain in taken:
                plain += "_"
            taken.add(plain)
            self.spelled[name] = plain

    def new(self, prefix: str) -> str:
        """Return a name for something that Python has no name for."""
        taken = self.called | set(self.spelled.values())
        while True:
            self.temporaries += 1
            if (name := f"{prefix}_{self.temporaries}") not in taken:
                return name

    def temporary(self, value: Value) -> Value:
        """Return the value kept in a variable of its own, so that what comes later does not change it."""
        if isinstance(value.kind, Constant):
            return value
        name = self.new("t")
        if isinstance(value.kind, Array):
            self.emit(f"{self.pointer(value.roots)}{name} = {value.text};")
            return replace(value, text=name, level=ATOM)
        self.kept.add(name)
        self.emit(f"const {value.kind.c} {name} = {value.text};")
        return replace(value, text=name, level=ATOM)

    def pointer(self, roots: frozenset[str]) -> str:
        """Return the declaration, up to its name, of what never points elsewhere: to read only, or to store, too."""
        return "double *const " if roots <= self.stored else "const double *const "

    def values(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Return the values of expressions, each as it was when Python would have come to it."""
        found = []
        for i, node in enumerate(nodes):
            value = self.value(node)
            kept = not isinstance(value.kind, Array) and any(self.calls(later) for later in nodes[i + 1 :])
            found.append(self.temporary(value) if kept else value)
        return found

    def value(self, node: ast.expr) -> Value:
        """Return an expression."""
        method = getattr(self, f"get_{type(node).__name__}", None)
        if method is None:
            self.refuse(
                node,
                f"has an expression ({ast.unparse(node)}) that C is not written for; use numbers, indices and cosim.ops",
            )
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

    def in_order(self, node: ast.Call, function: FunctionType) -> list[Value]:
        """Return the arguments of a call in the function's own order, defaults filled in, computed in the order of the call."""
        names = parameters(function)
        defaults = function.__defaults__ or ()
        if any(isinstance(a, ast.Starred) for a in node.args) or any(k.arg is None for k in node.keywords):
            self.refuse(node, "calls with a star; write the arguments one by one")
        named = [*names[: len(node.args)], *(str(keyword.arg) for keyword in node.keywords)]
        found = dict(zip(names[len(names) - len(defaults) :], map(constant, defaults), strict=True))
        if len(node.args) > len(names) or len(set(named)) < len(named) or set(named) | set(found) != set(names):
            self.refuse(node, f"calls {function.__name__!r} with other arguments than it has ({', '.join(names)})")
        found |= zip(named, self.values([*node.args, *(k.value for k in node.keywords)]), strict=True)
        return [found[name] for name in names]

    def calls(self, node: ast.expr) -> bool:
        """Return whether an expression calls anything that may write into arrays."""
        return any(isinstance(n, ast.Call) and not self._is_pure(n.func) for n in ast.walk(node))

    def _is_pure(self, node: ast.expr) -> bool:
        if isinstance(node, ast.Attribute):
            return node.attr in ops.NAMES
        value = self.names.get(node.id) if isinstance(node, ast.Name) else None
        return value in (len, range) or (callable(value) and value in OPERATIONS)
