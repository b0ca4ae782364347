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
    found: set[str] = set()
    others = {a.arg for a in tree.args.args}

    def visit(node: ast.AST, active: frozenset[str]) -> None:
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            name = node.target.id
            (others if name in active else found).add(name)
            for part in (node.iter, *node.orelse):
                visit(part, active)
            for part in node.body:
                visit(part, active | {name})
            return
        if isinstance(node, ast.Name) and (isinstance(node.ctx, ast.Store) or node.id not in active):
            others.add(node.id)
        for child in ast.iter_child_nodes(node):
            visit(child, active)

    for statement in tree.body:
        visit(statement, frozenset())
    return found - others


def within_block(tree: ast.FunctionDef) -> set[str]:
    """Return the variables that are assigned in one statement and read only by later statements of the same block."""
    reads: list[str] = []  # in the order of the text
    assigned: list[
        tuple[str, int, list[int]]
    ] = []  # a variable, the number of reads before and in the statement, the block's

    def visit(node: ast.AST, ends: list[int]) -> None:
        if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Store):
            reads.append(node.id)
        for _, value in ast.iter_fields(node):
            if isinstance(value, list):
                block: list[int] = []
                for child in value:
                    if isinstance(child, ast.AST):
                        visit(child, block)
                block.append(len(reads))
            elif isinstance(value, ast.AST):
                visit(value, [])
        if isinstance(node, ast.Assign | ast.AnnAssign):
            assigned.extend((name, len(reads), ends) for name in stores(node))

    visit(tree, [])
    first = {name: i for i, name in reversed(list(enumerate(reads)))}
    last = {name: i for i, name in enumerate(reads)}
    return {
        name for name, after, end in assigned if name not in first or (after <= first[name] and last[name] < end[0])
    }


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
