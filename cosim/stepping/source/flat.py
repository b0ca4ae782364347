"""Step functions without records: each array of a record becomes a separate argument.

Records make step functions readable. But numba analyses each access to a field and passes whole records: a controller with them
takes up to half as long again to compile. C has no records. So both get functions in whose syntax tree records are replaced by
their fields. Each function is generated once for the shape of its record arguments, and takes only the fields that it uses.
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
    """The structure of a record: its class, and for each field None or the shape of another record."""

    record: type
    fields: tuple[Shape | None, ...]


@dataclass(frozen=True)
class _Record:
    """A record in a function: for each field the name of a variable, or another record."""

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
    """A function without records; for former record arguments, ``taken`` has the fields' new names (None if not used)."""

    function: FunctionType
    taken: Mapping[str, Sequence[str | None]]


_OPERATIONS = frozenset(getattr(ops, name) for name in ops.NAMES)
# None for a function that does not change: the function itself as a value would never be freed.
_made: WeakKeyDictionary[FunctionType, dict[tuple[Shape | None, ...], tuple[list[Any], _Flat | None]]] = (
    WeakKeyDictionary()
)


def without_records(function: FunctionType) -> FunctionType:
    """Return a step function without record arguments as one that uses no records inside; callees, too.

    Raises
    ------
    KernelError
        If a record is used other than for its fields, for unpacking or as an argument; or if the source of a function with
        records is not available.
    """
    return _flat(function, (None,) * len(parameters(function)), ()).function


def _flat(function: FunctionType, shapes: tuple[Shape | None, ...], callers: tuple[FunctionType, ...]) -> _Flat:
    plain = _Flat(function, {})
    if function in callers:  # a recursion, which is refused elsewhere
        return plain
    cached = _made.setdefault(function, {})
    dependencies = depends_on(function)
    if (
        shapes in cached
        and len(cached[shapes][0]) == len(dependencies)
        and all(map(operator.is_, cached[shapes][0], dependencies))
    ):
        return cached[shapes][1] or plain
    has_records = any(shapes) or _uses_records(function, set())
    flat = _Flattening(function, shapes, callers).done() if has_records else None
    cached[shapes] = dependencies, flat
    return flat or plain


def _uses_records(function: FunctionType, seen: set[FunctionType]) -> bool:
    """Return whether a function, or one that it calls, may create a record."""
    seen.add(function)
    values = [value for _, value in references(function)]
    return any(map(is_record_class, values)) or any(
        _uses_records(value, seen) for value in values if isinstance(value, FunctionType) and value not in seen
    )


class _Flattening(ast.NodeTransformer):
    """Generate a function without records, for record arguments of these shapes."""

    def __init__(self, function: FunctionType, shapes: Sequence[Shape | None], callers: tuple[FunctionType, ...]):
        self.function, self.callers = function, (*callers, function)
        self.tree = tree_of(function)
        self.names = dict(references(function))
        self.arguments = parameters(function)
        assigned = stores(self.tree)
        self.once = {name for name in assigned if assigned.count(name) == 1}
        #: Arguments that never change, so that a record can refer to them without copies.
        self.steady = set(self.arguments) - set(assigned)
        self.taken = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)} | set(self.arguments)
        self.records: dict[str, _Record] = {}
        self.before: list[ast.stmt] = []  # statements to insert before the present one
        self.now: set[str] = set()  # variables that this statement creates for fields of its records
        self.calls = 0  # number of step functions that this statement calls
        self.copying = False  # whether fields of a record may be computed before this statement
        self.seen: dict[int, tuple[ast.expr, _Record | None]] = {}
        for name, shape in zip(self.arguments, shapes, strict=True):
            if shape is not None:
                if name in assigned:
                    self.refuse(self.tree, f"assigns to {name!r}, which is a record; use another name")
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
        result = namespace[tree.name]
        assert isinstance(result, FunctionType)
        result.__globals__.update(self.names)
        defaults = len(self.function.__defaults__ or ())
        if defaults and any(name in self.records for name in self.arguments[-defaults:]):
            self.refuse(tree, "has a record argument with a default; leave out the default")
        result.__defaults__ = self.function.__defaults__
        result.__dict__["tree"] = tree  # there is no source file
        return result

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise an error for a line from which records cannot be removed."""
        raise KernelError(f"Step function {place(self.function, node)} {what}.")

    def new(self, name: str) -> str:
        """Reserve and return an unused name like this one."""
        unused = name
        while unused in self.taken or unused in self.names:
            unused += "_"
        self.taken.add(unused)
        return unused

    def _as_arguments(self, shape: Shape, name: str) -> _Record:
        """Return a record whose fields are arguments."""
        fields: list[str | _Record] = []
        for field, inner in zip(shape.record._fields, shape.fields, strict=True):  # type: ignore[attr-defined]
            full_name = f"{name}_{field}"
            fields.append(self._as_arguments(inner, full_name) if inner else self.new(full_name))
            self.steady |= {fields[-1]} if isinstance(fields[-1], str) else set()
        return _Record(shape.record, tuple(fields))

    # Statements

    def _statements(self, body: list[ast.stmt]) -> list[ast.stmt]:
        statements: list[ast.stmt] = []
        for statement in body:
            self.before, self.now = [], set()
            self.calls = sum(map(self._is_step, ast.walk(_head(statement))))
            after = self.visit(statement)
            statements += [*self.before, *(after if isinstance(after, list) else [after])]
        return statements or [ast.copy_location(ast.Pass(), body[0])]

    def _blocks(self, node: ast.If | ast.For | ast.While) -> ast.stmt:
        """Convert the inner statements of a statement whose head is converted."""
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
            self.refuse(node, "creates a record in the condition of a loop; create it before the loop")
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
            self.refuse(node, "assigns a record to something other than a name; assign it to one name")
        if isinstance(target, ast.Name):
            self._name(target, record)
            return []
        if len(target.elts) != len(record.fields):
            self.refuse(
                node, f"unpacks {len(record.fields)} values into {len(target.elts)} names; use as many names as values"
            )
        parts: list[ast.stmt] = []
        for element, field in zip(target.elts, record.fields, strict=True):
            if isinstance(field, _Record):
                if not isinstance(element, ast.Name):
                    self.refuse(node, "assigns a record to something other than a name; assign it to one name")
                self._name(element, field)
            elif not (isinstance(element, ast.Name) and element.id == "_"):  # never read
                parts.append(ast.copy_location(ast.Assign([self.visit(element)], _load(field, node)), node))
        return parts

    def _one_by_one(self, node: ast.Assign, targets: ast.Tuple, values: ast.Tuple) -> list[ast.stmt]:
        """Register the records in a tuple assignment; keep the other assignments."""
        if len(targets.elts) != len(values.elts):
            self.refuse(
                node, f"unpacks {len(values.elts)} values into {len(targets.elts)} names; use as many names as values"
            )
        others: list[tuple[ast.expr, ast.expr]] = []
        for target, value in zip(targets.elts, values.elts, strict=True):
            record = self.record(value)
            if record is None:
                others.append((self.visit(target), self.visit(value)))
            elif isinstance(target, ast.Name):
                self._name(target, record)
            else:
                self.refuse(node, "assigns a record to something other than a name; assign it to one name")
        if not others:
            return []
        if len(others) == 1:
            ((targets_left, values_left),) = others
        else:
            targets_left = ast.Tuple([target for target, _ in others], ast.Store())
            values_left = ast.Tuple([value for _, value in others], ast.Load())
        return [ast.copy_location(ast.Assign([targets_left], values_left), node)]

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
            self.refuse(target, f"assigns the record {target.id!r} more than once; use two names")
        self.records[target.id] = self._lasting(record, target)

    def _lasting(self, record: _Record, at: ast.AST) -> _Record:
        """Return a record with separate variables: the fields of the original may change in the next pass of a loop."""
        fields: list[str | _Record] = []
        for field in record.fields:
            if isinstance(field, _Record):
                fields.append(self._lasting(field, at))
            elif field in self.steady or field in self.now:
                fields.append(field)
            else:
                copy_name = self.new(field)
                self.before.append(
                    ast.copy_location(ast.Assign([ast.Name(copy_name, ast.Store())], _load(field, at)), at)
                )
                fields.append(copy_name)
        return _Record(record.record, tuple(fields))

    # Expressions

    def record(self, node: ast.expr | None) -> _Record | None:
        """Return the record of an expression; None if it is no record."""
        if isinstance(node, ast.Name):
            return self.records.get(node.id)
        if isinstance(node, ast.Attribute):
            field = self._field(node)
            return field if isinstance(field, _Record) else None
        if not isinstance(node, ast.Call) or not is_record_class(made := self._called(node)):
            return None
        if id(node) not in self.seen:  # created once, even if this is called repeatedly
            self.seen[id(node)] = node, self._made(node, made)
        return self.seen[id(node)][1]

    def _called(self, node: ast.Call) -> Any:
        return self.names.get(node.func.id) if isinstance(node.func, ast.Name) else None

    def _is_step(self, node: ast.AST) -> bool:
        """Return whether a node is a call of another step function, which may write into arrays."""
        called = self._called(node) if isinstance(node, ast.Call) else None
        return isinstance(called, FunctionType) and called not in _OPERATIONS

    def _field(self, node: ast.Attribute) -> str | _Record | None:
        """Return the record field of an attribute; None if the owner is no record."""
        owner = self.record(node.value)
        if owner is None:
            return None
        if node.attr not in owner.record._fields:
            self.refuse(node, f"uses the attribute {node.attr!r}, but the record has {', '.join(owner.record._fields)}")
        field: str | _Record = owner.fields[owner.record._fields.index(node.attr)]
        return field

    def _made(self, node: ast.Call, record_class: Any) -> _Record:
        """Return the record that a call creates, with the present values of its fields."""
        arguments = self._in_order(node, record_class, record_class._fields)
        fields: list[str | _Record] = []
        for name, value in arguments.items():
            inner = self.record(value)
            value = value if inner else self.visit(value)
            if inner is not None:
                fields.append(inner)
            elif isinstance(value, ast.Name) and value.id in self.steady:
                fields.append(value.id)
            else:
                fields.append(self._kept(value, name))
        return _Record(record_class, tuple(fields[list(arguments).index(name)] for name in record_class._fields))

    def _kept(self, value: ast.expr, name: str) -> str:
        """Return a new variable with this value, assigned before the present statement."""
        if not self.copying:
            self.refuse(value, "creates a record in a line with other calls; assign it to a name in a line before")
        variable = self.new(name)
        self.now.add(variable)
        self.before.append(ast.copy_location(ast.Assign([ast.Name(variable, ast.Store())], value), value))
        return variable

    def _in_order(self, node: ast.Call, function: Any, names: Sequence[str]) -> dict[str, ast.expr]:
        """Return the arguments of a call by name, in the order of the call."""
        if any(isinstance(a, ast.Starred) for a in node.args) or any(k.arg is None for k in node.keywords):
            self.refuse(node, "calls with a star; write the arguments one by one")
        items = [*zip(names, node.args, strict=False), *((str(k.arg), k.value) for k in node.keywords)]
        defaults = names[len(names) - len(getattr(function, "__defaults__", None) or ()) :]
        arguments = dict(items)
        is_wrong = len(node.args) > len(names) or len(arguments) < len(items)
        if is_wrong or not set(names) - set(defaults) <= arguments.keys() <= set(names):
            called = function.__name__
            self.refuse(node, f"calls {called!r} with wrong arguments; its arguments are {', '.join(names)}")
        return arguments

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.records:
            self.refuse(node, f"uses the record {node.id!r} as a whole; use its fields, or pass it to a step function")
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        field = self._field(node)
        if isinstance(field, _Record):
            self.refuse(node, f"uses the record {ast.unparse(node)!r} as a whole; use its fields")
        return self.generic_visit(node) if field is None else _load(field, node)  # type: ignore[return-value]

    def visit_Call(self, node: ast.Call) -> ast.expr:
        called = self._called(node)
        if is_record_class(called):
            self.refuse(node, "creates a record where a number or an array is needed; use one of its fields")
        if not self._is_step(node):
            return self.generic_visit(node)  # type: ignore[return-value]
        names = parameters(called)
        before, self.copying = self.copying, self.copying or self.calls == 1
        records = {name: self.record(value) for name, value in self._in_order(node, called, names).items()}
        self.copying = before
        shapes = tuple(record.shape if (record := records.get(name)) else None for name in names)
        flat = _flat(called, shapes, self.callers)
        if flat.function is called:
            return self.generic_visit(node)  # type: ignore[return-value]

        def flat_arguments(name: str, value: ast.expr) -> list[tuple[str, ast.expr]]:
            if (record := records[name]) is None:
                return [(name, self.visit(value))]
            fields = zip(flat.taken[name], record.names(), strict=True)
            return [(field_name, _load(field, value)) for field_name, field in fields if field_name is not None]

        arguments = [
            item for name, value in zip(names, node.args, strict=False) for _, item in flat_arguments(name, value)
        ]
        keywords = [ast.keyword(*item) for k in node.keywords for item in flat_arguments(str(k.arg), k.value)]
        function = next((n for n, value in self.names.items() if value is flat.function), None) or self.new(
            called.__name__
        )
        self.names[function] = flat.function
        return ast.copy_location(ast.Call(ast.Name(function, ast.Load()), arguments, keywords), node)


def _head(statement: ast.stmt) -> ast.AST:
    """Return the part of a statement that is computed at once, without inner statements."""
    if isinstance(statement, ast.If | ast.While):
        return statement.test
    return statement.iter if isinstance(statement, ast.For) else statement


def _load(name: str, instead_of: ast.AST) -> ast.Name:
    return ast.copy_location(ast.Name(name, ast.Load()), instead_of)
