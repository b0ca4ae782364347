"""Tables of all experiments in one style."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType

Form = str | Callable[[Any], str]
"""The form of a cell: a format of the entries of a mapping, as ``"{auc:.3f}"``, or a function of the value."""

LONGEST = 12
"""Longest class name, in letters, that a column's head has on one line."""


def table(title: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]], *, corner: str = "") -> RenderableType:
    """Return a title and a table, with the names of the rows in the first column."""
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    made.add_column(corner)
    for column in columns:
        made.add_column(Text(broken(column)), justify="right", overflow="fold")
    for name, cells in rows.items():
        made.add_row(Text(name), *(Text(cell) for cell in cells))
    return Group(Text(title, style="bold"), made)


def listed(
    title: str, rows: Mapping[Any, Any], columns: Sequence[tuple[str, Form]], *, corner: str = ""
) -> RenderableType:
    """Return a table with a row for each item; the columns have their heads and forms."""
    cells = {str(name): [written(of, form) for _, form in columns] for name, of in rows.items()}
    return table(title, [head for head, _ in columns], cells, corner=corner)


def crossed(
    title: str,
    cells: Mapping[Any, Mapping[Any, Any]],
    form: Form,
    names: Sequence[Any] | None = None,
    *,
    head: Form = str,
    corner: str = "",
    most: int = 1_000,
) -> Iterator[RenderableType]:
    """Yield the table of cells at rows and columns, in parts of at most `most` columns.

    Parameters
    ----------
    title, corner : str
        Title and corner of each part.
    cells : mapping
        The cells, by row and column.
    form : str or function
        Form of the cells.
    names : sequence, optional
        The columns, by default all.
    head : str or function
        Form of a column's name.
    most : int
        Largest number of columns of a part: class names are long.
    """
    names = list(next(iter(cells.values()))) if names is None else names
    for first in range(0, len(names), most):
        few = names[first : first + most]
        rows = {str(row): [written(of[name], form) for name in few] for row, of in cells.items()}
        yield table(title, [written(name, head) for name in few], rows, corner=corner)


def written(of: Any, form: Form) -> str:
    """Return the text of an item in a form."""
    if callable(form):
        return form(of)
    return form.format(**of) if isinstance(of, Mapping) else form.format(of)


def broken(name: str) -> str:
    """Return a long class name on several lines, one word on each: columns are narrow."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=,) ", "\n", name) if len(name) > LONGEST else name


def sentence_list(names: Sequence[str]) -> str:
    """Return names as in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def interval_widths(cells: Sequence[tuple[str, str, Mapping[str, Any]]]) -> str:
    """Return a sentence on the widths of the confidence intervals, relative to the ratios.

    Each cell has its row and column in a table, and the report's entry with ``ratio`` and ``ratio_ci``.
    """
    halves = {(n, c): (cell["ratio_ci"][1] - cell["ratio_ci"][0]) / 2 / cell["ratio"] for n, c, cell in cells}
    widest = max(halves, key=halves.__getitem__)
    return (
        f"The 95 % intervals are in the JSON file: +-{median(halves.values()):.1%} of the ratio in the median, "
        f"+-{halves[widest]:.0%} at most ({widest[0]}, {widest[1]})."
    )
