"""Records group many arrays into few arguments of a step function; the rest of the package uses the arrays one by one.

A record is a ``NamedTuple`` class of arrays. `Definition.records` has records whose fields are *names*: the ports and entries of
which an argument consists. The rest of the package uses a generated function whose arguments are the arrays themselves. Compiled
steps are as fast as without records, but compiling takes longer, as numba analyses each access.
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
"""With more arguments, Python builds a list for a call, which a step function must not do. Records can contain records."""


def is_record_class(value: Any) -> bool:
    """Return whether something is a class of records: a NamedTuple."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def named_alike(record: type, prefix: str = "", **others: Any) -> Any:
    """Return a record of names: each field is a prefix and the field's name, except `others`."""
    fields: tuple[str, ...] = record._fields  # type: ignore[attr-defined]
    return record(**{**{field: prefix + field for field in fields}, **others})


def with_arrays(kernel: Kernel | None, records: Mapping[str, Any]) -> Kernel | None:
    """Return a step function that takes the arrays of records instead of records; `kernel` itself if it has no records.

    Parameters
    ----------
    kernel : function or None
        A step function.
    records : mapping of str to NamedTuple of str
        For its record arguments, the names of the arrays; a field may itself be such a record.
    """
    if kernel is None or not set(records) & set(argument_names(kernel)):
        return kernel
    return _flat(
        kernel, argument_names(kernel), tuple(sorted((name, _key(record)) for name, record in records.items()))
    )


def as_written(kernel: Kernel) -> Kernel:
    """Return the author's step function, with records; errors name its file and lines."""
    original: Kernel = getattr(kernel, "written", kernel)
    return original


def written(record: Any) -> str:
    """Return the expression that builds a record of arrays, from a record of their names."""
    fields = (field if isinstance(field, str) else written(field) for field in record)
    return f"{type(record).__name__}({', '.join(fields)})"


def _key(record: Any) -> tuple[Any, ...]:
    """Return a record of names with its class, to distinguish records of two classes."""
    cls = type(record)
    if not is_record_class(cls) or cls._field_defaults or len(record) > MOST_FIELDS:
        raise KernelError(
            f"{record!r} is no valid record. Use a NamedTuple of at most {MOST_FIELDS} fields without defaults; fill it with the "
            "names of ports and entries, or with other records."
        )
    for field in record:
        if isinstance(field, str) and (not field.isidentifier() or iskeyword(field)):
            raise KernelError(
                f"The record {cls.__name__} has the name {field!r}, which cannot be an argument; use a plain identifier."
            )
    return cls, tuple(field if isinstance(field, str) else _key(field) for field in record)


# The same step function gives the same result, so that it is compiled once for any number of blocks.
@lru_cache(maxsize=1024)
def _flat(kernel: Kernel, arguments: tuple[str, ...], records: tuple[tuple[str, tuple[Any, ...]], ...]) -> Kernel:
    record_keys = dict(records)
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

    expressions = []
    for name in arguments:
        if name in record_keys:
            expressions.append(text(record_keys[name]))
        else:
            arrays[name] = None
            expressions.append(name)
    names = {name: cls for cls, name in classes.items()} | {"with_records": kernel}
    result = function_from_text("of_arrays", arrays, [f"with_records({', '.join(expressions)})"], names)
    result.__name__ = kernel.__name__
    result.__dict__["written"] = kernel
    return result
