"""Step functions without their records: each array that a record holds is an argument of its own.

Records are for whoever writes and reads a step function. numba looks at each access to a field, and hands records on whole: with
them, a controller takes up to half as long again to compile. C has none at all. So both get functions in whose syntax tree the
records are replaced by what they consist of. Each function is made once for the shape of the records that it is called with, and
takes only those of their fields that it uses.
"""

from __future__ import annotations

import ast
import builtins
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any, NoReturn
from weakref import WeakKeyDictionary

from bayesftc.cosim import ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import depends_on, references
from bayesftc.cosim.stepping.records import is_record_class
from bayesftc.cosim.stepping.source.tree import parameters, place, stores, tree_of


@dataclass(frozen=True)
class Shape:
    """What a record is made of, whatever it is called: its class, and for each field None or the shape of another record."""

    record: type
    fields: tuple[Shape | None, ...]


@dataclass(frozen=True)
class _Record:
    """A record as it stands in a function: for each field the name of a variable, or another record."""

    record: Any
    fields: tuple[str | _Record, ...]

    @property
    def shape(self) -> Shape:
        return Shape(self.record, tuple(None if isinstance(field, str) else field.shape for field in self.fields))

    def names(self) -> Iterator[str]:
        """Yield the names of all its variables, in order."""
        for field in self.fields:
            yield from (field,) if isinstance(field, str) else field.names()


@dataclass(frozen=True)
class _Flat:
    """A function without records; for arguments that were, ``taken`` has what each field is called: None if it is not used."""

    function: FunctionType
    taken: Mapping[str, Sequence[str | None]]


_OPERATIONS = frozenset(getattr(ops, name) for name in ops.NAMES)
# None for a function that stays itself: with it as a value, it would live for ever.
_made: WeakKeyDictionary[FunctionType, dict[tuple[Shape | None, ...], tuple[list[Any], _Flat | None]]] = (
    WeakKeyDictionary()
)


def without_records(function: FunctionType) -> FunctionType:
    """Return a step function that takes no records as one that makes none either, nor those that it calls.

    Raises
    ------
    KernelError
        If a record is used for anything but to take its fields, to take it apart and to hand it on, or if the text of a function
        that has to do with records is not at hand.
    """
    return _flat(function, (None,) * len(parameters(function)), ()).function


def _flat(function: FunctionType, shapes: tuple[Shape | None, ...], callers: tuple[FunctionType, ...]) -> _Flat:
    plain = _Flat(function, {})
    if function in callers:  # which is refused elsewhere, with the names of all
        return plain
    known = _made.setdefault(function, {})
    seen = depends_on(function)
    if shapes in known and len(known[shapes][0]) == len(seen) and all(map(operator.is_, known[shapes][0], seen)):
        return known[shapes][1] or plain
    concerned = any(shapes) or _knows_records(function, set())
    found = _Flattening(function, shapes, callers).done() if concerned else None
    known[shapes] = seen, found
    return found or plain


def _knows_records(function: FunctionType, seen: set[FunctionType]) -> bool:
    """Return whether a function, or one that it calls, may make a record."""
    seen.add(function)
    values = [value for _, value in references(function)]
    return any(map(is_record_class, values)) or any(
        _knows_records(value, seen) for value in values if isinstance(value, FunctionType) and value not in seen
    )


class _Flattening(ast.NodeTransformer):
    """Makes one function anew, for records of these shapes as its arguments."""

    def __init__(self, function: FunctionType, shapes: Sequence[Shape | None], callers: tuple[FunctionType, ...]):
        self.function, self.callers = function, (*callers, function)
        self.tree = tree_of(function)
        self.names = dict(references(function))
        self.arguments = parameters(function)
        assigned = stores(self.tree)
        self.once = {name for name in assigned if assigned.count(name) == 1}
        #: Arguments that mean the same all along, so that a record of them needs no copies of these names.
        self.steady = set(self.arguments) - set(assigned)
        self.taken = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)} | set(self.arguments)
        self.records: dict[str, _Record] = {}
        self.before: list[ast.stmt] = []  # what must stand before the statement at hand
        self.now: set[str] = set()  # the variables that this statement makes for the fields of its records
        self.calls = 0  # how many step functions this statement calls
        self.copying = False  # whether what a record is made of may be computed before this statement
        self.seen: dict[int, tuple[ast.expr, _Record | None]] = {}
        for name, shape in zip(self.arguments, shapes, strict=True):
            if shape is not None:
                if name in assigned:
                    self.refuse(self.tree, f"assigns to {name!r}, which is a record; take another name")
                self.records[name] = self._as_arguments(shape, name)

    def done(self) -> _Flat:
        """Return the function."""
        self.tree.body = self._statements(self.tree.body)
        used = {n.id for n in ast.walk(ast.Module(self.tree.body, [])) if isinstance(n, ast.Name)}
        taken = {
            name: [leaf if leaf in used else None for leaf in self.records[name].names()]
            for name in self.arguments
            if name in self.records
        }
        names = [leaf for name in self.arguments for leaf in taken.get(name, [name]) if leaf is not None]
        arguments = [ast.copy_location(ast.arg(name), self.tree) for name in names]
        self.tree.args = ast.arguments(posonlyargs=[], args=arguments, kwonlyargs=[], kw_defaults=[], defaults=[])
        self.tree.decorator_list, self.tree.returns = [], None
        return _Flat(self._compiled(), taken)

    def _compiled(self) -> FunctionType:
        tree = ast.fix_missing_locations(self.tree)
        namespace = {"__name__": self.function.__module__, "__builtins__": builtins}
        exec(compile(ast.Module([tree], []), self.function.__code__.co_filename, "exec"), namespace)
        made = namespace[tree.name]
        assert isinstance(made, FunctionType)
        made.__globals__.update(self.names)
        defaults = len(self.function.__defaults__ or ())
        if defaults and any(name in self.records for name in self.arguments[-defaults:]):
            self.refuse(tree, "takes a record where it has a default; leave out the default")
        made.__defaults__ = self.function.__defaults__
        made.__dict__["tree"] = tree  # its text is nowhere to be read
        return made

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise the error that this line cannot be written without records."""
        raise KernelError(f"Step function {place(self.function, node)} {what}.")

    def new(self, wanted: str) -> str:
        """Return a name like this one that nothing has yet, and take it."""
        found = wanted
        while found in self.taken or found in self.names:
            found += "_"
        self.taken.add(found)
        return found

    def _as_arguments(self, shape: Shape, name: str) -> _Record:
        """Return a record whose fields are arguments."""
        fields: list[str | _Record] = []
        for field, inner in zip(shape.record._fields, shape.fields, strict=True):  # type: ignore[attr-defined]
            each = f"{name}_{field}"
            fields.append(self._as_arguments(inner, each) if inner else self.new(each))
            self.steady |= {fields[-1]} if isinstance(fields[-1], str) else set()
        return _Record(shape.record, tuple(fields))

    # Statements

    def _statements(self, body: list[ast.stmt]) -> list[ast.stmt]:
        made: list[ast.stmt] = []
        for statement in body:
            self.before, self.now = [], set()
            self.calls = sum(map(self._is_step, ast.walk(_head(statement))))
            after = self.visit(statement)
            made += [*self.before, *(after if isinstance(after, list) else [after])]
        return made or [ast.copy_location(ast.Pass(), body[0])]

    def _blocks(self, node: ast.If | ast.For | ast.While) -> ast.stmt:
        """Make the statements inside of one anew, whose head is done."""
        before = self.before
        node.body = self._statements(node.body)
        node.orelse = self._statements(node.orelse) if node.orelse else []
        self.before = before
        return node

    def visit_If(self, node: ast.If) -> ast.stmt:
        node.test = self.visit(node.test)
        return self._blocks(node)

    def visit_For(self, node: ast.For) -> ast.stmt:
        node.iter = self.visit(node.iter)
        return self._blocks(node)

    def visit_While(self, node: ast.While) -> ast.stmt:
        node.test = self.visit(node.test)
        if self.before:
            self.refuse(node, "makes a record in the condition of a loop; make it before the loop")
        return self._blocks(node)

    def visit_Assign(self, node: ast.Assign) -> ast.stmt | list[ast.stmt]:
        first = node.targets[0]
        if isinstance(first, ast.Tuple) and isinstance(node.value, ast.Tuple) and len(node.targets) == 1:
            return self._one_by_one(node, first, node.value)
        self.copying = True
        record = self.record(node.value)
        self.copying = False
        if record is None:
            return self.generic_visit(node)  # type: ignore[return-value]
        target = node.targets[0]
        if len(node.targets) > 1 or not isinstance(target, ast.Name | ast.Tuple):
            self.refuse(node, "assigns a record to what is no single name")
        if isinstance(target, ast.Name):
            self._name(target, record)
            return []
        if len(target.elts) != len(record.fields):
            self.refuse(node, f"takes {len(target.elts)} values out of {len(record.fields)}")
        parts: list[ast.stmt] = []
        for element, field in zip(target.elts, record.fields, strict=True):
            if isinstance(field, _Record):
                if not isinstance(element, ast.Name):
                    self.refuse(node, "assigns a record to what is no single name")
                self._name(element, field)
            elif not (isinstance(element, ast.Name) and element.id == "_"):  # whom nobody reads
                parts.append(ast.copy_location(ast.Assign([self.visit(element)], _load(field, node)), node))
        return parts

    def _one_by_one(self, node: ast.Assign, targets: ast.Tuple, values: ast.Tuple) -> list[ast.stmt]:
        """Name the records among several values that are assigned at once; the others stay as they are."""
        if len(targets.elts) != len(values.elts):
            self.refuse(node, f"takes {len(targets.elts)} values out of {len(values.elts)}")
        left: list[tuple[ast.expr, ast.expr]] = []
        for target, value in zip(targets.elts, values.elts, strict=True):
            record = self.record(value)
            if record is None:
                left.append((self.visit(target), self.visit(value)))
            elif isinstance(target, ast.Name):
                self._name(target, record)
            else:
                self.refuse(node, "assigns a record to what is no single name")
        if not left:
            return []
        if len(left) == 1:
            ((one, other),) = left
        else:
            one = ast.Tuple([target for target, _ in left], ast.Store())
            other = ast.Tuple([value for _, value in left], ast.Load())
        return [ast.copy_location(ast.Assign([one], other), node)]

    def visit_AnnAssign(self, node: ast.AnnAssign) -> Any:
        if node.value is None:
            return node
        return self.visit_Assign(ast.copy_location(ast.Assign([node.target], node.value), node))

    def visit_Return(self, node: ast.Return) -> ast.stmt:
        if node.value is not None and self.record(node.value) is not None:
            self.refuse(node, "returns a record; return numbers, or write into arrays")
        return self.generic_visit(node)  # type: ignore[return-value]

    def _name(self, target: ast.Name, record: _Record) -> None:
        if target.id not in self.once or target.id in self.arguments:
            self.refuse(target, f"assigns the record {target.id!r} more than once; take two names")
        self.records[target.id] = self._lasting(record, target)

    def _lasting(self, record: _Record, at: ast.AST) -> _Record:
        """Return a record with variables of its own: what another one is made of may change in the next round of a loop."""
        fields: list[str | _Record] = []
        for field in record.fields:
            if isinstance(field, _Record):
                fields.append(self._lasting(field, at))
            elif field in self.steady or field in self.now:
                fields.append(field)
            else:
                own = self.new(field)
                self.before.append(ast.copy_location(ast.Assign([ast.Name(own, ast.Store())], _load(field, at)), at))
                fields.append(own)
        return _Record(record.record, tuple(fields))

    # Expressions

    def record(self, node: ast.expr | None) -> _Record | None:
        """Return the record that an expression is; None if it is none."""
        if isinstance(node, ast.Name):
            return self.records.get(node.id)
        if isinstance(node, ast.Attribute):
            found = self._field(node)
            return found if isinstance(found, _Record) else None
        if not isinstance(node, ast.Call) or not is_record_class(made := self._called(node)):
            return None
        if id(node) not in self.seen:  # it is made once, however often it is asked for
            self.seen[id(node)] = node, self._made(node, made)
        return self.seen[id(node)][1]

    def _called(self, node: ast.Call) -> Any:
        return self.names.get(node.func.id) if isinstance(node.func, ast.Name) else None

    def _is_step(self, node: ast.AST) -> bool:
        """Return whether something is a call of another step function, which may write into arrays."""
        called = self._called(node) if isinstance(node, ast.Call) else None
        return isinstance(called, FunctionType) and called not in _OPERATIONS

    def _field(self, node: ast.Attribute) -> str | _Record | None:
        """Return the field of a record that an attribute is; None if it is none."""
        owner = self.record(node.value)
        if owner is None:
            return None
        if node.attr not in owner.record._fields:
            self.refuse(node, f"uses the attribute {node.attr!r}; the record has {', '.join(owner.record._fields)}")
        found: str | _Record = owner.fields[owner.record._fields.index(node.attr)]
        return found

    def _made(self, node: ast.Call, made: Any) -> _Record:
        """Return the record that a call makes, its fields kept as they are now."""
        given = self._in_order(node, made, made._fields)
        fields: list[str | _Record] = []
        for name, value in given.items():
            inner = self.record(value)
            value = value if inner else self.visit(value)
            if inner is not None:
                fields.append(inner)
            elif isinstance(value, ast.Name) and value.id in self.steady:
                fields.append(value.id)
            else:
                fields.append(self._kept(value, name))
        return _Record(made, tuple(fields[list(given).index(name)] for name in made._fields))

    def _kept(self, value: ast.expr, name: str) -> str:
        """Return a new variable that has this value, assigned before the statement at hand."""
        if not self.copying:
            self.refuse(value, "makes a record beside other calls; make it in a line before, with a name of its own")
        kept = self.new(name)
        self.now.add(kept)
        self.before.append(ast.copy_location(ast.Assign([ast.Name(kept, ast.Store())], value), value))
        return kept

    def _in_order(self, node: ast.Call, function: Any, names: Sequence[str]) -> dict[str, ast.expr]:
        """Return the arguments of a call by their names, in the order in which they stand there."""
        if any(isinstance(a, ast.Starred) for a in node.args) or any(k.arg is None for k in node.keywords):
            self.refuse(node, "calls with a star; write the arguments one by one")
        given = [*zip(names, node.args, strict=False), *((str(k.arg), k.value) for k in node.keywords)]
        defaults = names[len(names) - len(getattr(function, "__defaults__", None) or ()) :]
        found = dict(given)
        many = len(node.args) > len(names) or len(found) < len(given)
        if many or not set(names) - set(defaults) <= found.keys() <= set(names):
            called = function.__name__
            self.refuse(node, f"calls {called!r} with other arguments than it has ({', '.join(names)})")
        return found

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.records:
            self.refuse(
                node, f"uses the record {node.id!r} as a whole; take its fields, or hand it on to a step function"
            )
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        field = self._field(node)
        if isinstance(field, _Record):
            self.refuse(node, f"uses the record {ast.unparse(node)!r} as a whole; take its fields")
        return self.generic_visit(node) if field is None else _load(field, node)  # type: ignore[return-value]

    def visit_Call(self, node: ast.Call) -> ast.expr:
        called = self._called(node)
        if is_record_class(called):
            self.refuse(node, "makes a record where a number or an array must stand")
        if not self._is_step(node):
            return self.generic_visit(node)  # type: ignore[return-value]
        names = parameters(called)
        before, self.copying = self.copying, self.copying or self.calls == 1
        records = {name: self.record(value) for name, value in self._in_order(node, called, names).items()}
        self.copying = before
        shapes = tuple(record.shape if (record := records.get(name)) else None for name in names)
        found = _flat(called, shapes, self.callers)
        if found.function is called:
            return self.generic_visit(node)  # type: ignore[return-value]

        def given(name: str, value: ast.expr) -> list[tuple[str, ast.expr]]:
            if (record := records[name]) is None:
                return [(name, self.visit(value))]
            fields = zip(found.taken[name], record.names(), strict=True)
            return [(own, _load(field, value)) for own, field in fields if own is not None]

        arguments = [item for name, value in zip(names, node.args, strict=False) for _, item in given(name, value)]
        keywords = [ast.keyword(*item) for k in node.keywords for item in given(str(k.arg), k.value)]
        function = next((n for n, value in self.names.items() if value is found.function), None) or self.new(
            called.__name__
        )
        self.names[function] = found.function
        return ast.copy_location(ast.Call(ast.Name(function, ast.Load()), arguments, keywords), node)


def _head(statement: ast.stmt) -> ast.AST:
    """Return what of a statement is computed at once: without the statements inside of it."""
    if isinstance(statement, ast.If | ast.While):
        return statement.test
    return statement.iter if isinstance(statement, ast.For) else statement


def _load(name: str, instead_of: ast.AST) -> ast.Name:
    return ast.copy_location(ast.Name(name, ast.Load()), instead_of)
