"""The table of variables: scalars that are the elements of an array, ``R[0,0]`` to ``R[1,1]``, share a row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby, product
from typing import TYPE_CHECKING

from bayesftc.cosim.array_ports import ELEMENT

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.fmu import FMUVariable
    from bayesftc.cosim.fmi.reading.description import Value

COLUMNS = "variable", "causality", "type", "unit", "start", "description"


def rows(variables: Iterable[FMUVariable], *, apart: bool) -> list[tuple[str, ...]]:
    """Return a row of texts for each variable, or (unless `apart`) for all elements of an array with the same meaning."""
    if apart:
        return [_row(v.name, [v]) for v in variables]
    table: list[tuple[str, ...]] = []
    for (array, *_), group in groupby(variables, _alike):
        run = list(group)
        name = _range(array, [v.name for v in run]) if array and len(run) > 1 else None
        table += [_row(name, run)] if name else [_row(v.name, [v]) for v in run]
    return table


def _alike(variable: FMUVariable) -> tuple[str | None, ...]:
    """Return what the elements of one row have in common, first the array's name; a variable that is no element has none."""
    match = None if variable.shape else ELEMENT.fullmatch(variable.name)
    return match and match[1], variable.causality, variable.type, variable.unit, variable.description


def _range(array: str, names: Sequence[str]) -> str | None:
    """Return a name such as ``R[0..1,0..2]``, or None if some elements between the first and the last are missing."""
    indices = [tuple(map(int, name[len(array) + 1 : -1].split(","))) for name in names]
    if len({len(index) for index in indices}) > 1:
        return None
    ends = [(min(column), max(column)) for column in zip(*indices, strict=True)]
    if sorted(indices) != list(product(*(range(first, last + 1) for first, last in ends))):
        return None
    return f"{array}[{','.join(f'{first}' if first == last else f'{first}..{last}' for first, last in ends)}]"


def _row(name: str, run: Sequence[FMUVariable]) -> tuple[str, ...]:
    v = run[0]
    kind = v.type + (f"[{', '.join(map(str, v.shape))}]" if v.shape else "")
    starts = [_short(element.start) for element in run]
    start = starts[0] if len(set(starts)) == 1 else ", ".join(starts)
    return name, v.causality, kind, v.unit or "", start, v.description or ""


def _short(start: Value | None) -> str:
    """Return a start value in few digits; the JSON output has all digits."""
    if start is None:
        return ""
    if isinstance(start, tuple):
        return "[" + ", ".join(map(_short, start)) + "]"
    return f"{start:.10g}" if isinstance(start, float) and len(str(start)) > 12 else f"{start}"
