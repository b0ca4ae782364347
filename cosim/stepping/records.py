"""Records: how a step function takes many arrays as few arguments, which the rest of the house sees one by one.

A record is a ``NamedTuple`` class of arrays. `Definition.records` says, by a record whose fields are *names*, of which ports and
entries an argument consists. What everything else works with is a function written here, whose arguments are these arrays
themselves; compiled, nothing is left of the records.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.written import function_from_text
from bayesftc.cosim.types import Kernel, argument_names


def is_record_class(value: Any) -> bool:
    """Return whether something is a class of records: a NamedTuple."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def named_alike(record: type, prefix: str = "", **others: Any) -> Any:
    """Return a record in which each field is its own name behind a prefix, but for `others`."""
    fields: tuple[str, ...] = record._fields  # type: ignore[attr-defined]
    return record(**{**{field: prefix + field for field in fields}, **others})


def with_arrays(kernel: Kernel | None, records: Mapping[str, Any]) -> Kernel | None:
    """Return the step function that takes, instead of records, all their arrays; itself if it takes none.

    Parameters
    ----------
    kernel : function or None
        A step function.
    records : mapping of str to NamedTuple of str
        For arguments of it that are records, the names of the arrays; a field may itself be such a record.
    """
    if kernel is None or not set(records) & set(argument_names(kernel)):
        return kernel
    return _flat(kernel, tuple(sorted((name, _key(record)) for name, record in records.items())))


def as_written(kernel: Kernel) -> Kernel:
    """Return the step function as its author wrote it, with records: whose file and lines are named where something is wrong."""
    found: Kernel = kernel.__dict__.get("written", kernel)
    return found


def given_to(kernel: Kernel) -> tuple[Any, ...]:
    """Return what `as_written` is given for each of its arguments: names of arrays, and ``(class, fields)`` of records."""
    found: tuple[Any, ...] = kernel.__dict__.get("given", ())
    return found


def written(record: Any) -> str:
    """Return the expression that makes a record of the arrays that a record of names names."""
    fields = (field if isinstance(field, str) else written(field) for field in record)
    return f"{type(record).__name__}({', '.join(fields)})"


def _key(record: Any) -> tuple[Any, ...]:
    """Return a record of names with its class, so that records of two classes are not taken for one."""
    if not is_record_class(type(record)):
        raise KernelError(f"A record must be a NamedTuple whose fields name ports or entries, not {record!r}.")
    return type(record), tuple(field if isinstance(field, str) else _key(field) for field in record)


# The same step function gives the same one, so that it is compiled once for however many blocks.
@lru_cache(maxsize=1024)
def _flat(kernel: Kernel, records: tuple[tuple[str, tuple[Any, ...]], ...]) -> Kernel:
    known = dict(records)
    classes: dict[type, str] = {}
    arrays: dict[str, None] = {}  # a set that keeps the order

    def text(key: tuple[Any, ...]) -> str:
        cls, fields = key
        name = classes.setdefault(cls, f"{cls.__name__}_{len(classes)}")
        parts = []
        for field in fields:
            if isinstance(field, str):
                arrays[field] = None
            parts.append(field if isinstance(field, str) else text(field))
        return f"{name}({', '.join(parts)})"

    given = []
    for name in argument_names(kernel):
        if name in known:
            given.append(text(known[name]))
        else:
            arrays[name] = None
            given.append(name)
    names = {name: cls for cls, name in classes.items()} | {"with_records": kernel}
    made = function_from_text(kernel.__name__, arrays, [f"with_records({', '.join(given)})"], names)
    made.__dict__.update(written=kernel, given=tuple(known.get(name, name) for name in argument_names(kernel)))
    return made


__all__ = ["as_written", "given_to", "is_record_class", "named_alike", "with_arrays", "written"]
