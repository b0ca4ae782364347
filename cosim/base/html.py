"""What notebooks show instead of a ``repr``: HTML tables, whose text is escaped, and texts of several lines."""

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
"""Most elements of a matrix that is shown in full; larger ones are shown by their size."""
LENGTH = 400
"""Most characters of a text in a cell."""

_CELL = "text-align: left; vertical-align: top; white-space: pre-wrap"


class Printed:
    """What IPython and notebooks show as text is what ``print`` shows, and not the ``repr``, which has all settings."""

    __slots__ = ()

    def __init_subclass__(cls, **settings: Any):
        """Give each class the method itself: IPython prefers the ``__repr__`` of a dataclass to a method of its bases."""
        super().__init_subclass__(**settings)
        if "_repr_pretty_" not in vars(cls):
            cls._repr_pretty_ = Printed._repr_pretty_  # type: ignore[method-assign]

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(str(self))


class Lines(Printed, str):
    """A text that IPython and notebooks show line by line, not as a string in quotes."""

    __slots__ = ()


def table(title: str, rows: Iterable[Sequence[object]], header: Sequence[str] = ()) -> str:
    """Return a table with a title above it.

    Parameters
    ----------
    title : str
        The title, in bold.
    rows : iterable of sequence
        The cells of each row; objects that are no strings are shown by `text_of`.
    header : sequence of str
        Names of the columns.
    """
    lines = [f"<p><b>{escape(title)}</b></p>", "<table>"]
    if header:
        lines.append(_row("th", header))
    lines += [_row("td", row) for row in rows]
    return "\n".join([*lines, "</table>"])


def settings(thing: Any, first: Iterable[Sequence[object]] = ()) -> str:
    """Return the table of a dataclass: its name, the rows `first`, and a row for each setting."""
    first = list(first)
    names = [each.name for each in fields(thing)] if is_dataclass(thing) else []
    further = [(name, getattr(thing, name)) for name in names if name not in [row[0] for row in first]]
    return table(type(thing).__name__, [*first, *further])


def text_of(value: object) -> str:
    """Return a value as a short text: small matrices in full, dataclasses with the settings that differ from defaults."""
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
        changed = [
            f"{name}={brief(setting)}"
            for name, setting, default in _settings(value)
            if brief(setting) != brief(default)
        ]
        return text_of(f"{type(value).__name__}({', '.join(changed)})")
    return brief(value, LENGTH)


def _settings(thing: Any) -> Iterable[tuple[str, object, object]]:
    """Yield name, value and default of each setting of a dataclass."""
    for each in fields(thing):
        default = each.default if each.default_factory is MISSING else each.default_factory()
        yield each.name, getattr(thing, each.name), default


def _row(tag: str, cells: Sequence[object]) -> str:
    return "<tr>" + "".join(f'<{tag} style="{_CELL}">{escape(text_of(cell))}</{tag}>' for cell in cells) + "</tr>"


__all__ = ["Lines", "Printed", "settings", "table", "text_of"]
