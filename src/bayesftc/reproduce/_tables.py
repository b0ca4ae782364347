"""Tables of all experiments in one style."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

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
        made.add_column(Text(_broken(column)), justify="right", overflow="fold")
    for name, cells in rows.items():
        made.add_row(Text(name), *(Text(cell) for cell in cells))
    return Group(Text(title, style="bold"), made)


def _broken(name: str) -> str:
    """Return a long class name on several lines, a word on each: columns are narrow."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "\n", name) if len(name) > LONGEST else name


def sentence_list(names: Sequence[str]) -> str:
    """Return names as they stand in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
