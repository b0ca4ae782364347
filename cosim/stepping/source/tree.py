"""The text of a step function as a syntax tree, with the lines that a user knows."""

from __future__ import annotations

import ast
import copy
import dis
import inspect
import textwrap
from bisect import bisect_left
from collections.abc import Mapping
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import where

Sections = Mapping[str, tuple[str, int, tuple[int, ...]]]
"""For each argument of a step function but ``t`` and ``k``: its section of memory, its offset there in elements, its shape."""


class NoText(KernelError):
    """The text of a function is not at hand."""


def tree_of(function: FunctionType) -> ast.FunctionDef:
    """Return the syntax tree of a function, numbered by the lines of its file.

    Raises
    ------
    KernelError
        If there is no text of it, the text is not that of the function any more, or it was not made by ``def``.
    """
    if hasattr(function, "tree"):  # made from another one
        return copy.deepcopy(function.tree)  # type: ignore[no-any-return]
    try:
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines)))
    except (OSError, TypeError, SyntaxError):
        raise NoText(
            f"The text of step function {where(function)} is not at hand, so that no C can be written from it; define it with "
            "def in a file or a notebook."
        ) from None
    found = tree.body[0]
    if not isinstance(found, ast.FunctionDef):
        raise KernelError(f"Step function {where(function)} cannot become C as it stands: define it with def.")
    if found.args.vararg or found.args.kwarg or found.args.kwonlyargs:
        raise KernelError(f"Step function {where(function)} takes a starred argument; write the arguments one by one.")
    ast.increment_lineno(tree, first - 1 if first else 0)
    if not _alike(found, function.__code__):
        raise KernelError(
            f"The file of step function {where(function)} has been edited since it was loaded; start Python again, so that "
            "what is exported is what was run."
        )
    return found


def _alike(tree: ast.FunctionDef, code: CodeType) -> bool:
    """Return whether a function of this text has this code: the same arguments, variables and numbers in the same places."""
    bare = ast.Module([_without_decorators(tree)], [])
    if code.co_freevars:
        # Within a function that has them, names of the enclosing function compile to the same instructions.
        outer = ast.parse(f"def outer():\n    {' = '.join(code.co_freevars)} = None\n")
        outer.body[0].body += bare.body  # type: ignore[attr-defined]
        bare = outer
    compiled = compile(ast.fix_missing_locations(bare), code.co_filename, "exec")
    made = _find(compiled, code.co_name)
    if made is None or made.co_varnames != code.co_varnames:
        return False
    # To compare instruction by instruction takes long, and is seldom needed.
    bytes_alike = (made.co_code, made.co_names, made.co_consts) == (code.co_code, code.co_names, code.co_consts)
    return (bytes_alike and repr(made.co_consts) == repr(code.co_consts)) or _gist(made) == _gist(code)


def _gist(code: CodeType) -> list[tuple[str, Any]]:
    """Return what a function does, without what depends on the module around it: how an attribute is called, and places."""
    kept = [
        instruction
        for instruction in dis.get_instructions(code)
        if instruction.opname not in {"PUSH_NULL", "PRECALL", "NOP", "EXTENDED_ARG"}
    ]
    offsets = [instruction.offset for instruction in kept]

    def meant(instruction: dis.Instruction) -> Any:
        if instruction.opcode in dis.hasjrel or instruction.opcode in dis.hasjabs:
            return bisect_left(offsets, instruction.argval)  # the how-manieth instruction it leads to
        return repr(instruction.argval) if "CONST" in instruction.opname else instruction.argval

    return [
        (instruction.opname.replace("METHOD", "ATTR"), meant(instruction))
        for instruction in kept
        if "ITER" not in instruction.opname
    ]


def _without_decorators(tree: ast.FunctionDef) -> ast.FunctionDef:
    return ast.FunctionDef(**{**dict(ast.iter_fields(tree)), "decorator_list": []})


def _find(code: CodeType, name: str) -> CodeType | None:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            found = constant if constant.co_name == name else _find(constant, name)
            if found is not None:
                return found
    return None


def parameters(function: FunctionType) -> tuple[str, ...]:
    """Return the names of a function's arguments, those with a default too."""
    return function.__code__.co_varnames[: function.__code__.co_argcount]


def place(function: FunctionType, node: ast.AST) -> str:
    """Return a readable place in a function, as ``'f' (file.py, line 3)``."""
    return f"{function.__name__!r} ({Path(function.__code__.co_filename).name}, line {getattr(node, 'lineno', '?')})"


def stores(tree: ast.AST) -> list[str]:
    """Return the names of the variables that are assigned to, as often as they are."""
    return [n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
