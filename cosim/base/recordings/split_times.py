"""Times in two columns become one: dates and times of the day, as of loggers; whole seconds and the rest, as of ROS.

ROS calls them ``stamp.sec`` and ``stamp.nanosec``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.recordings.dates import are_dates, other_date
from bayesftc.cosim.base.recordings.local_dates import CLOCK, clock_of_day

if TYPE_CHECKING:
    import pandas as pd

_WHOLE = re.compile(r"(.*?)secs?", re.IGNORECASE | re.DOTALL)
_REST = re.compile(r"(.*?)(n|nano|u|micro)secs?", re.IGNORECASE | re.DOTALL)
_DAY = re.compile(r"\s*[\w-]+([./-]\w+[./-]\w+)?\s*")
"""A date without a time of the day."""
_IN_A_SECOND = {"n": 10**9, "nano": 10**9, "u": 10**6, "micro": 10**6}


def joined_times(table: pd.DataFrame, names: Sequence[object], source: str) -> tuple[pd.DataFrame, list[int]]:
    """Return a table whose columns of dates or whole seconds include the rest, and the places of the columns that remain.

    The rest of a date is the first column of times of the day, if the first column of dates has none. That of whole seconds is
    the first column with the same name but for the unit, if it has a number below one second in each row with a whole.

    Parameters
    ----------
    table : pandas.DataFrame
        Any table.
    names : sequence
        The names of its columns.
    source : str
        The file, for the message to the user.
    """
    table, clock = _with_times_of_day(table, names, source)
    rests = {m[1].lower(): (i, _IN_A_SECOND[m[2].lower()]) for i, m in _matches(_REST, names)[::-1]}
    joined = {clock} if clock is not None else set()
    for i, match in _matches(_WHOLE, names):
        j, per_second = rests.get(match[1].lower(), (i, 1))
        if j == i or j in joined:
            continue
        whole, rest = table.iloc[:, i], table.iloc[:, j]
        if _are_numbers(whole) and _are_numbers(rest) and (whole.isna() | ((rest >= 0) & (rest < per_second))).all():
            table = table.copy(deep=False)
            table.isetitem(i, whole.to_numpy(np.float64) + rest.to_numpy(np.float64) / per_second)
            joined.add(j)
    kept = [i for i in range(len(names)) if i not in joined]
    return table.iloc[:, kept], kept


def _with_times_of_day(table: pd.DataFrame, names: Sequence[object], source: str) -> tuple[pd.DataFrame, int | None]:
    """Return the table with the times of the day in its first column of dates, and the place of the column that had them."""
    columns = [(i, table.iloc[:, i]) for i in range(len(names))]
    day = next((i for i, cells in columns if are_dates(cells) or other_date(cells) is not None), None)
    if day is None:
        return table, None
    dates = table.iloc[:, day].dropna().astype(str)
    clocks = (i for i, cells in columns if i != day and _fits(cells, CLOCK))
    if not dates.map(lambda text: _DAY.fullmatch(text) is not None).all() or (clock := next(clocks, None)) is None:
        return table, None
    times = clock_of_day(table.iloc[:, clock].astype(str).str.extract(rf"^\s*{CLOCK}\s*$"))
    if times is None:
        return table, None
    table = table.copy(deep=False)
    given = table.iloc[:, day]
    there = given.notna() & table.iloc[:, clock].notna()
    table.isetitem(day, (given.astype(str).str.strip() + " " + times).where(there).array)
    inform(
        f"The columns {names[day]!r} and {names[clock]!r} of {source} are read together as dates with times of the day."
    )
    return table, clock


def _fits(cells: pd.Series[Any], form: str) -> bool:
    """Return whether all texts of a column have a form."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(cells) or not len(given := cells.dropna()):
        return False
    return bool(given.astype(str).str.fullmatch(rf"\s*{form}\s*").all())


def _matches(form: re.Pattern[str], names: Sequence[object]) -> list[tuple[int, re.Match[str]]]:
    found = ((i, form.fullmatch(str(name).strip())) for i, name in enumerate(names))
    return [(i, match) for i, match in found if match is not None]


def _are_numbers(cells: pd.Series[float]) -> bool:
    import pandas as pd

    return pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells)
