"""The syntax tree of a step function, with the line numbers of its file."""

from __future__ import annotations

import ast
import copy
import dis
import inspect
import textwrap
import threading
from bisect import bisect_left
from collections.abc import Mapping
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import where

Sections = Mapping[str, tuple[str, int, tuple[int, ...]]]
"""For each argument of a step function except ``t`` and ``k``: its section of memory, its offset in elements, its shape."""


_parsing = threading.RLock()


class NoText(KernelError):
    """The source of a function is not available."""


def parsed(text: str) -> ast.Module:
    """Return the syntax tree of some Python, in one thread at a time.

    Python 3.11 counts the depth of the trees that all threads build in one number. Two threads at once can raise a SystemError.
    """
    with _parsing:
        return ast.parse(text)


def tree_of(function: FunctionType) -> ast.FunctionDef:
    """Return the syntax tree of a function, with the line numbers of its file.

    Raises
    ------
    KernelError
        If its source is not available or has changed, or it was not defined by ``def``.
    """
    if hasattr(function, "tree"):  # a generated function
        return copy.deepcopy(function.tree)  # type: ignore[no-any-return]
    try:
        lines, first = inspect.getsourcelines(function)
        tree = parsed(textwrap.dedent("".join(lines)))
    except (OSError, TypeError, SyntaxError):
        raise NoText(
            f"The source of step function {where(function)} is not available, so it cannot be translated to C. Define it with "
            "def in a file or a notebook."
        ) from None
    definition = tree.body[0]
    if not isinstance(definition, ast.FunctionDef):
        raise KernelError(f"Step function {where(function)} is not defined with def, so it cannot become C; use def.")
    if definition.args.vararg or definition.args.kwarg or definition.args.kwonlyargs:
        raise KernelError(
            f"Step function {where(function)} has a starred or keyword-only argument; write plain arguments one by one."
        )
    ast.increment_lineno(tree, first - 1 if first else 0)
    if not _alike(definition, function.__code__):
        raise KernelError(
            f"The file of step function {where(function)} has changed since it was loaded. Restart Python, so that the exported "
            "code is the code that was run."
        )
    return definition


def _alike(tree: ast.FunctionDef, code: CodeType) -> bool:
    """Return whether a tree compiles to this code: with the same arguments, variables and numbers."""
    bare = ast.Module([_without_decorators(tree)], [])
    if code.co_freevars:
        # An outer function with these variables makes them compile to the same instructions.
        outer = parsed(f"def outer():\n    {' = '.join(code.co_freevars)} = None\n")
        outer.body[0].body += bare.body  # type: ignore[attr-defined]
        bare = outer
    compiled = compile(ast.fix_missing_locations(bare), code.co_filename, "exec")
    candidate = _find(compiled, code.co_name)
    if candidate is None or candidate.co_varnames != code.co_varnames:
        return False
    # Comparing instruction by instruction is slow, and rarely needed.
    same_bytes = (candidate.co_code, candidate.co_names, candidate.co_consts) == (
        code.co_code,
        code.co_names,
        code.co_consts,
    )
    return (same_bytes and repr(candidate.co_consts) == repr(code.co_consts)) or _gist(candidate) == _gist(code)


def _gist(code: CodeType) -> list[tuple[str, Any]]:
    """Return a function's instructions without details that depend on the surrounding module, such as offsets."""
    instructions = [
        instruction
        for instruction in dis.get_instructions(code)
        if instruction.opname not in {"PUSH_NULL", "PRECALL", "NOP", "EXTENDED_ARG"}
    ]
    offsets = [instruction.offset for instruction in instructions]

    def argument(instruction: dis.Instruction) -> Any:
        if instruction.opcode in dis.hasjrel or instruction.opcode in dis.hasjabs:
            return bisect_left(offsets, instruction.argval)  # index of the target instruction
        return repr(instruction.argval) if "CONST" in instruction.opname else instruction.argval

    return [
        (instruction.opname.replace("METHOD", "ATTR"), argument(instruction))
        for instruction in instructions
        if "ITER" not in instruction.opname
    ]


def _without_decorators(tree: ast.FunctionDef) -> ast.FunctionDef:
    return ast.FunctionDef(**{**dict(ast.iter_fields(tree)), "decorator_list": []})


def _find(code: CodeType, name: str) -> CodeType | None:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            inner = constant if constant.co_name == name else _find(constant, name)
            if inner is not None:
                return inner
    return None


def parameters(function: FunctionType) -> tuple[str, ...]:
    """Return the names of a function's arguments, including those with a default."""
    return function.__code__.co_varnames[: function.__code__.co_argcount]


def place(function: FunctionType, node: ast.AST) -> str:
    """Return a position in a function as text, as ``'f' (file.py, line 3)``."""
    return f"{function.__name__!r} ({Path(function.__code__.co_filename).name}, line {getattr(node, 'lineno', '?')})"


def stores(tree: ast.AST) -> list[str]:
    """Return the names of assigned variables, once for each assignment."""
    return [n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
