"""Properties of the syntax tree of a step function."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import CodeType, FunctionType
from weakref import WeakKeyDictionary

from bayesftc.cosim.stepping.source.tree import stores, tree_of

_read: WeakKeyDictionary[FunctionType, tuple[CodeType, Source]] = WeakKeyDictionary()


@dataclass
class Source:
    """The syntax tree of a function and its properties, computed once for all kinds of arguments."""

    tree: ast.FunctionDef

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        """The names of its arguments."""
        return tuple(a.arg for a in self.tree.args.posonlyargs + self.tree.args.args)

    @cached_property
    def assigned(self) -> Counter[str]:
        """How often each variable is assigned to."""
        return Counter(stores(self.tree))

    @cached_property
    def counters(self) -> set[str]:
        """The loop variables that are neither assigned nor read outside their loops."""
        return counters(self.tree)

    @cached_property
    def once(self) -> set[str]:
        """Variables with a single assignment, except counters."""
        return {name for name, times in self.assigned.items() if times == 1} - set(self.arguments) - self.counters

    @cached_property
    def fresh(self) -> set[str]:
        """Those that are read only by later statements of the same block."""
        return within_block(self.tree) & self.once


def source_of(function: FunctionType) -> Source:
    """Return the source of a function."""
    code, source = _read.get(function, (None, None))
    if source is None or code is not function.__code__:  # notebooks replace the code when they reload edited files
        source = Source(tree_of(function))
        _read[function] = function.__code__, source
    return source


def counters(tree: ast.FunctionDef) -> set[str]:
    """Return the loop variables that are neither assigned nor read outside their loops."""
    loops = [n for n in ast.walk(tree) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)]
    result = {_counter(loop) for loop in loops} - {a.arg for a in tree.args.args}
    for name in list(result):
        own_loops = [loop for loop in loops if _counter(loop) == name]
        inside = {id(n) for loop in own_loops for part in loop.body for n in _named(part, name)} | {
            id(o.target) for o in own_loops
        }
        is_nested = any(
            _counter(n) == name for loop in own_loops for part in loop.body for n in ast.walk(part) if n in own_loops
        )
        assigned = stores(tree).count(name) > len(own_loops)
        if is_nested or assigned or any(id(n) not in inside for n in _named(tree, name)):
            result.discard(name)
    return result


def _counter(loop: ast.AST) -> str:
    target = getattr(loop, "target", None)
    return target.id if isinstance(target, ast.Name) else ""


def _named(tree: ast.AST, name: str) -> list[ast.Name]:
    return [n for n in ast.walk(tree) if isinstance(n, ast.Name) and n.id == name]


def within_block(tree: ast.FunctionDef) -> set[str]:
    """Return the variables that are assigned in one statement and read only by later statements of the same block."""
    result, reads = set(), _reads(tree)
    for node in ast.walk(tree):
        for body in (getattr(node, "body", None), getattr(node, "orelse", None)):
            later: Counter[str] = Counter()
            for statement in reversed(body if isinstance(body, list) else []):
                if isinstance(statement, ast.Assign | ast.AnnAssign):
                    result |= {name for name in stores(statement) if later[name] == reads[name]}
                later += _reads(statement)
    return result


def _reads(tree: ast.AST) -> Counter[str]:
    """Return how often each variable is read."""
    return Counter(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Store))


def ends(body: Sequence[ast.stmt]) -> bool:
    """Return whether every path through some statements ends in a return."""
    last = body[-1]
    if isinstance(last, ast.If):
        return ends(last.body) and bool(last.orelse) and ends(last.orelse)
    return isinstance(last, ast.Return)


def jumps(body: Sequence[ast.stmt]) -> bool:
    """Return whether the body of a loop contains a break or continue of that loop."""
    for statement in body:
        if isinstance(statement, ast.Break | ast.Continue):
            return True
        if isinstance(statement, ast.If) and (jumps(statement.body) or jumps(statement.orelse)):
            return True
    return False
