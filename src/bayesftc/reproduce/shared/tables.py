"""Tables of all experiments in one style."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType

LONGEST = 12
"""Letters of a class name that a column's head takes on one line."""


def table(title: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]], *, corner: str = "") -> RenderableType:
    """Return a table below its title, names of the rows in the first column, and cells to the right."""
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


def broken(name: str) -> str:
    """Return a long class name on several lines, a word on each, and what follows it: columns are narrow."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=,) ", "\n", name) if len(name) > LONGEST else name


def sentence_list(names: Sequence[str]) -> str:
    """Return names as they stand in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def interval_widths(cells: Sequence[tuple[str, str, Mapping[str, Any]]]) -> str:
    """Return in words how wide the confidence intervals of ratios are, beside the ratios.

    Parameters
    ----------
    cells : sequence of tuple
        Row and column of a table, and what the report has of the cell: ``ratio`` and ``ratio_ci``.
    """
    halves = {(n, c): (cell["ratio_ci"][1] - cell["ratio_ci"][0]) / 2 / cell["ratio"] for n, c, cell in cells}
    widest = max(halves, key=halves.__getitem__)
    return (
        f"The 95 % intervals are in the JSON file: +-{median(halves.values()):.1%} of the ratio in the median, "
        f"+-{halves[widest]:.0%} at most ({widest[0]}, {widest[1]})."
    )
