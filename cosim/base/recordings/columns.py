"""Names of columns that end in a unit in brackets, as in ``T_1 [degC]``: the name before it is enough to find one."""

from __future__ import annotations

import re
from collections.abc import Iterable

from bayesftc.cosim.base.units import parse
from bayesftc.cosim.errors import RecordingError

_BRACKET = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*\Z")


def column_unit(name: str) -> str:
    """Return the unit in brackets at the end of a column's name; empty if there is none that is known."""
    bracket = _BRACKET.search(name)
    return bracket[1] if bracket and parse(bracket[1]) is not None else ""


def bare_name(name: str) -> str:
    """Return a column's name without the unit in brackets at its end."""
    return _BRACKET.sub("", name).rstrip() if column_unit(name) else name


def column_called(name: str, columns: Iterable[str]) -> str | None:
    """Return the column of this name, or the only one with this name before a unit in brackets; None if there is none.

    Raises
    ------
    RecordingError
        If several columns have this name before a unit.
    """
    found = sorted({column for column in columns if name in (column, bare_name(column))})
    if len(found) > 1 and name not in found:
        raise RecordingError(f"{name!r} can be {' or '.join(map(repr, found))}. Give the whole name of the column.")
    return name if name in found else found[0] if found else None


__all__ = ["bare_name", "column_called", "column_unit"]
