"""Tables of HTML, as notebooks show them in place of a ``repr``; every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import MISSING, fields, is_dataclass
from fractions import Fraction
from html import escape
from pathlib import PurePath
from typing import Any

import numpy as np

from bayesftc.cosim.errors import brief

LARGEST = 64
"""A matrix of more elements than this is shown by its size."""
LENGTH = 400
"""Letters of a text in a cell."""

_CELL = "text-align: left; vertical-align: top; white-space: pre-wrap"


def table(title: str, rows: Iterable[Sequence[object]], header: Sequence[str] = ()) -> str:
    """Return a table with a title above it.

    Parameters
    ----------
    title : str
        Stands above in bold.
    rows : iterable of sequence
        The cells of each row; of an object that is no text `text_of` is shown.
    header : sequence of str
        Names of the columns.
    """
    lines = [f"<p><b>{escape(title)}</b></p>", "<table>"]
    if header:
        lines.append(_row("th", header))
    lines += [_row("td", row) for row in rows]
    return "\n".join([*lines, "</table>"])


def settings(thing: Any, first: Iterable[Sequence[object]] = ()) -> str:
    """Return the table of a dataclass: its name, some rows, and a row for each of its settings."""
    first = list(first)
    names = [each.name for each in fields(thing)] if is_dataclass(thing) else []
    own = [(name, getattr(thing, name)) for name in names if name not in [row[0] for row in first]]
    return table(type(thing).__name__, [*first, *own])


def text_of(value: object) -> str:
    """Return a value as a short text: small matrices in full, dataclasses by the settings that are not the usual ones."""
    if isinstance(value, str):
        return value if len(value) <= LENGTH else f"{value[: LENGTH - 3]}..."
    if isinstance(value, Fraction | PurePath):
        return str(value)
    if isinstance(value, tuple) and any(map(is_dataclass, value)):
        return text_of(", ".join(map(text_of, value)))
    if isinstance(value, np.ndarray):
        if value.size == 1:
            return f"{value.item():.6g}"
        if value.size > LARGEST:
            return " x ".join(map(str, value.shape)) + " numbers"
        return np.array2string(value, precision=4, suppress_small=False, max_line_width=100)
    if isinstance(sizes := getattr(value, "sizes", None), str):
        return f"{type(value).__name__}: {sizes}"
    if is_dataclass(value) and not isinstance(value, type):
        changed = [f"{name}={brief(own)}" for name, own, default in _settings(value) if brief(own) != brief(default)]
        return text_of(f"{type(value).__name__}({', '.join(changed)})")
    return brief(value, LENGTH)


def _settings(thing: Any) -> Iterable[tuple[str, object, object]]:
    """Yield name, value and default of each setting of a dataclass."""
    for each in fields(thing):
        default = each.default if each.default_factory is MISSING else each.default_factory()
        yield each.name, getattr(thing, each.name), default


def _row(tag: str, cells: Sequence[object]) -> str:
    return "<tr>" + "".join(f'<{tag} style="{_CELL}">{escape(text_of(cell))}</{tag}>' for cell in cells) + "</tr>"


__all__ = ["settings", "table", "text_of"]
