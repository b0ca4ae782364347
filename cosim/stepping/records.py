"""Records: how a step function takes many arrays as few arguments, which the rest of the house sees one by one.

A record is a ``NamedTuple`` class of arrays. `Definition.records` says, by a record whose fields are *names*, of which ports and
entries an argument consists. What everything else works with is a function written here, whose arguments are these arrays
themselves. Compiled steps are as fast as without records; to compile them takes longer, for numba looks at each access.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from keyword import iskeyword
from typing import Any

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.types import Kernel, argument_names

MOST_FIELDS = 30
"""Python makes a list of more arguments of a call, which a step function must not; records can stand in records."""


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
    return _flat(
        kernel, argument_names(kernel), tuple(sorted((name, _key(record)) for name, record in records.items()))
    )


def as_written(kernel: Kernel) -> Kernel:
    """Return the step function as its author wrote it, with records: whose file and lines are named where something is wrong."""
    found: Kernel = getattr(kernel, "written", kernel)
    return found


def written(record: Any) -> str:
    """Return the expression that makes a record of the arrays that a record of names names."""
    fields = (field if isinstance(field, str) else written(field) for field in record)
    return f"{type(record).__name__}({', '.join(fields)})"


def _key(record: Any) -> tuple[Any, ...]:
    """Return a record of names with its class, so that records of two classes are not taken for one."""
    cls = type(record)
    if not is_record_class(cls) or cls._field_defaults or len(record) > MOST_FIELDS:
        raise KernelError(
            f"A record must be a NamedTuple of at most {MOST_FIELDS} fields, none with a default, filled with the names of ports "
            f"and entries or with other records, not {record!r}."
        )
    for field in record:
        if isinstance(field, str) and (not field.isidentifier() or iskeyword(field)):
            raise KernelError(
                f"The record {cls.__name__} names {field!r}, as which no port or entry can be an argument."
            )
    return cls, tuple(field if isinstance(field, str) else _key(field) for field in record)


# The same step function gives the same one, so that it is compiled once for however many blocks.
@lru_cache(maxsize=1024)
def _flat(kernel: Kernel, arguments: tuple[str, ...], records: tuple[tuple[str, tuple[Any, ...]], ...]) -> Kernel:
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
    for name in arguments:
        if name in known:
            given.append(text(known[name]))
        else:
            arrays[name] = None
            given.append(name)
    names = {name: cls for cls, name in classes.items()} | {"with_records": kernel}
    made = function_from_text("of_arrays", arrays, [f"with_records({', '.join(given)})"], names)
    made.__name__ = kernel.__name__
    made.__dict__["written"] = kernel
    return made
