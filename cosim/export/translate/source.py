"""The text of a step function as a syntax tree, with the lines that a user knows, and what can be told from it at a glance."""

from __future__ import annotations

import ast
import dis
import inspect
import textwrap
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import where


def tree_of(function: FunctionType) -> ast.FunctionDef:
    """Return the syntax tree of a function, numbered by the lines of its file.

    Raises
    ------
    KernelError
        If there is no text of it, the text is not that of the function any more, or it was not made by ``def``.
    """
    try:
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines)))
    except (OSError, TypeError, SyntaxError):
        raise KernelError(
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
    return made is not None and made.co_varnames == code.co_varnames and _gist(made) == _gist(code)


def _gist(code: CodeType) -> list[tuple[str, Any]]:
    """Return what a function does, without what depends on the module around it: how an attribute is called, and places."""
    return [
        (instruction.opname.replace("METHOD", "ATTR"), None if "JUMP" in instruction.opname else instruction.argval)
        for instruction in dis.get_instructions(code)
        if instruction.opname not in {"PUSH_NULL", "PRECALL", "NOP", "EXTENDED_ARG"}
        and "ITER" not in instruction.opname
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


def place(function: FunctionType, node: ast.AST) -> str:
    """Return a readable place in a function, as ``'f' (file.py, line 3)``."""
    return f"{function.__name__!r} ({Path(function.__code__.co_filename).name}, line {getattr(node, 'lineno', '?')})"


def stores(tree: ast.AST) -> list[str]:
    """Return the names of the variables that are assigned to, as often as they are."""
    return [n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


def counters(tree: ast.FunctionDef) -> set[str]:
    """Return the loop variables that are neither assigned otherwise nor read outside of their loops."""
    loops = [n for n in ast.walk(tree) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)]
    found = {_counter(loop) for loop in loops} - {a.arg for a in tree.args.args}
    for name in list(found):
        own = [loop for loop in loops if _counter(loop) == name]
        inside = {id(n) for loop in own for part in loop.body for n in _named(part, name)} | {id(o.target) for o in own}
        begun_within = any(
            _counter(n) == name for loop in own for part in loop.body for n in ast.walk(part) if n in own
        )
        assigned = stores(tree).count(name) > len(own)
        if begun_within or assigned or any(id(n) not in inside for n in _named(tree, name)):
            found.discard(name)
    return found


def _counter(loop: ast.AST) -> str:
    target = getattr(loop, "target", None)
    return target.id if isinstance(target, ast.Name) else ""


def _named(tree: ast.AST, name: str) -> list[ast.Name]:
    return [n for n in ast.walk(tree) if isinstance(n, ast.Name) and n.id == name]


def within_block(tree: ast.FunctionDef) -> set[str]:
    """Return the variables that are assigned in one statement and read only by those that follow it in the same block."""
    found, reads = set(), _reads(tree)
    for node in ast.walk(tree):
        for body in (getattr(node, "body", None), getattr(node, "orelse", None)):
            later: Counter[str] = Counter()
            for statement in reversed(body if isinstance(body, list) else []):
                if isinstance(statement, ast.Assign | ast.AnnAssign):
                    found |= {name for name in stores(statement) if later[name] == reads[name]}
                later += _reads(statement)
    return found


def _reads(tree: ast.AST) -> Counter[str]:
    """Return how often each variable is read."""
    return Counter(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Store))


def ends(body: Sequence[ast.stmt]) -> bool:
    """Return whether every way through some statements ends in a return."""
    last = body[-1]
    if isinstance(last, ast.If):
        return ends(last.body) and bool(last.orelse) and ends(last.orelse)
    return isinstance(last, ast.Return)


def jumps(body: Sequence[ast.stmt]) -> bool:
    """Return whether statements leave the loop that they are the body of, or begin its next round."""
    for statement in body:
        if isinstance(statement, ast.Break | ast.Continue):
            return True
        if isinstance(statement, ast.If) and (jumps(statement.body) or jumps(statement.orelse)):
            return True
    return False
