"""The state of a function's translation to C: its variables, and the lines so far."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import FunctionType
from typing import Any, NoReturn, Protocol

from bayesftc.cosim import ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.foreign import Foreign
from bayesftc.cosim.stepping.instead import INDEX
from bayesftc.cosim.stepping.source.tree import parameters, place
from bayesftc.cosim.stepping.translate.kinds import Array, Constant, Kind, Number, as_number
from bayesftc.cosim.stepping.translate.values import ATOM, Value, constant

OPERATIONS = {getattr(ops, name): name for name in (*ops.NAMES, *ops.BITS)}
"""The name of each operation of step functions."""


class Functions(Protocol):
    """All functions of one C file, as needed by one of them: functions that it calls, and the file's names and tables."""

    def require(self, function: FunctionType, kinds: Sequence[Kind]) -> Any:
        """Return the C function for arguments of these kinds."""

    def allowed(self, name: str) -> str:
        """Return a name that C allows."""

    def table(self, values: tuple[Any, ...], kind: Number) -> str:
        """Return the name of the file's table of these numbers."""

    def foreign(self, function: Foreign) -> None:
        """Declare a function of other compiled code."""


class Context:
    """The variables of a function so far, and the translation of expressions.

    Values that must be computed before the line of an expression are added by `emit`: results of functions, and values that were
    read before these functions are called.

    Parameters
    ----------
    functions : Functions
        All functions of the file.
    function : function
        The step function, or one that it calls.
    arguments : mapping of str to Kind
        The kinds of its arguments.
    names : mapping of str to object
        Its global names and those of enclosing functions.
    """

    def __init__(
        self, functions: Functions, function: FunctionType, arguments: Mapping[str, Kind], names: Mapping[str, Any]
    ):
        self.functions, self.function, self.names = functions, function, names
        self.arguments = arguments
        self.kinds: dict[str, Kind] = {}  # kinds of the variables in C
        self.constants: dict[str, Value] = {}  # variables with constant values
        self.roots: dict[str, frozenset[str]] = {}
        self.stored: set[str] = set()  # arguments whose elements are assigned
        self.called: set[str] = set()  # names of the file that no variable may hide
        self.spelled: dict[str, str] = {}  # names in C
        self._calling: dict[ast.expr, bool] = {}
        self.lines: list[str] = []
        self.depth = 1
        self.temporaries = 0
        self.kept: set[str] = set()  # temporary variables, which have no name in Python

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise an error for a line that cannot be translated."""
        raise KernelError(f"Step function {place(self.function, node)} {what}.")

    def emit(self, line: str) -> None:
        """Add a line of C."""
        self.lines.append("    " * self.depth + line)

    def local(self, name: str) -> str:
        """Return the name of a variable in C."""
        return self.spelled.get(name, name)

    def spell(self, names: Iterable[str]) -> None:
        """Choose the names of variables in C: all different, and different from called functions."""
        self.spelled, taken = {}, set(self.called)
        for name in sorted(set(names)):
            plain = self.functions.allowed(name.replace(".", "_"))
            while plain in taken:
                plain += "_"
            taken.add(plain)
            self.spelled[name] = plain

    def new(self, prefix: str) -> str:
        """Return an unused name for a temporary variable."""
        taken = self.called | set(self.spelled.values())
        while True:
            self.temporaries += 1
            if (name := f"{prefix}_{self.temporaries}") not in taken:
                return name

    def temporary(self, value: Value) -> Value:
        """Return the value in a temporary variable, so that later statements do not change it."""
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
        """Return the declaration, up to the name, of a constant pointer: to read only, or also to store."""
        return "double *const " if roots <= self.stored else "const double *const "

    def values(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Return the values of expressions, computed in Python's order."""
        results = []
        for i, node in enumerate(nodes):
            value = self.value(node)
            needs_copy = not isinstance(value.kind, Array) and any(self.calls(later) for later in nodes[i + 1 :])
            results.append(self.temporary(value) if needs_copy else value)
        return results

    def value(self, node: ast.expr) -> Value:
        """Return the value of an expression."""
        method = getattr(self, f"get_{type(node).__name__}", None)
        if method is None:
            self.refuse(
                node,
                f"has an expression ({ast.unparse(node)}) that cannot be translated to C; use numbers, indices and cosim.ops",
            )
        result: Value = method(node)
        return result

    def number(self, node: ast.AST, value: Value) -> Number:
        """Return the kind of number that a value is."""
        kind = as_number(value.kind)
        if kind is None:
            self.refuse(node, "uses an array, a tuple or a function where a number is needed; use an element of it")
        return kind

    def whole(self, node: ast.AST, value: Value) -> Value:
        """Return a value; refuse it if it is no whole number."""
        if self.number(node, value).type == "float":
            self.refuse(
                node,
                f"uses a number that is not whole as an index or count ({ast.unparse(node)}); use whole numbers. For a place "
                f"that is a float, {INDEX}",
            )
        return value

    def in_order(self, node: ast.Call, function: FunctionType) -> list[Value]:
        """Return the arguments of a call in the function's order, with defaults, computed in the order of the call."""
        names = parameters(function)
        defaults = function.__defaults__ or ()
        if any(isinstance(a, ast.Starred) for a in node.args) or any(k.arg is None for k in node.keywords):
            self.refuse(node, "calls with a star; write the arguments one by one")
        given_names = [*names[: len(node.args)], *(str(keyword.arg) for keyword in node.keywords)]
        arguments = dict(zip(names[len(names) - len(defaults) :], map(constant, defaults), strict=True))
        if (
            len(node.args) > len(names)
            or len(set(given_names)) < len(given_names)
            or set(given_names) | set(arguments) != set(names)
        ):
            self.refuse(node, f"calls {function.__name__!r} with wrong arguments; its arguments are {', '.join(names)}")
        arguments |= zip(given_names, self.values([*node.args, *(k.value for k in node.keywords)]), strict=True)
        return [arguments[name] for name in names]

    def calls(self, node: ast.expr) -> bool:
        """Return whether an expression calls anything that may write into arrays."""
        if node not in self._calling:
            self._calling[node] = any(isinstance(n, ast.Call) and not self._is_pure(n.func) for n in ast.walk(node))
        return self._calling[node]

    def _is_pure(self, node: ast.expr) -> bool:
        if isinstance(node, ast.Attribute):
            return node.attr in ops.NAMES
        value = self.names.get(node.id) if isinstance(node, ast.Name) else None
        return value in (len, range) or (callable(value) and value in OPERATIONS)
