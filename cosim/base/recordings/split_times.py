"""Times in two columns, as ROS writes them: whole seconds (``stamp.sec``), and the rest (``stamp.nanosec``). They become one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

_WHOLE = re.compile(r"(.*?)secs?", re.IGNORECASE | re.DOTALL)
_REST = re.compile(r"(.*?)(n|nano|u|micro)secs?", re.IGNORECASE | re.DOTALL)
_IN_A_SECOND = {"n": 10**9, "nano": 10**9, "u": 10**6, "micro": 10**6}


def joined_times(table: pd.DataFrame, names: Sequence[object]) -> tuple[pd.DataFrame, list[int]]:
    """Return a table whose columns of whole seconds include the rest of the second, and the places of the columns that remain.

    A rest is the first column with the same name but for the unit, if it has a number below one second in each row with a whole.

    Parameters
    ----------
    table : pandas.DataFrame
        Any table.
    names : sequence
        The names of its columns.
    """
    rests = {m[1].lower(): (i, _IN_A_SECOND[m[2].lower()]) for i, m in _matches(_REST, names)[::-1]}
    joined: set[int] = set()
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


def _matches(form: re.Pattern[str], names: Sequence[object]) -> list[tuple[int, re.Match[str]]]:
    found = ((i, form.fullmatch(str(name).strip())) for i, name in enumerate(names))
    return [(i, match) for i, match in found if match is not None]


def _are_numbers(cells: pd.Series[float]) -> bool:
    import pandas as pd

    return pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells)
