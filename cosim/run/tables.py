"""Tables of recorded signals: reading them, and their columns."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.recordings.columns import column_called
from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.run.result import Result

if TYPE_CHECKING:
    import pandas as pd


def read_table(data: Any, user: str) -> pd.DataFrame:
    """Return a recording as a table with a column for each signal.

    Parameters
    ----------
    data : Result, pandas.DataFrame, str or path
        Signals, a table, or a CSV or Parquet file (``.parquet``).
    user : str
        Who needs it, as the beginning of an error.

    Raises
    ------
    ModelError
        If it is something else.
    RecordingError
        If the file cannot be read.
    """
    import pandas as pd

    if isinstance(data, Result):
        return data.to_pandas().reset_index()
    if isinstance(data, pd.DataFrame):
        named = data.index.name is not None and data.index.name not in data.columns
        return data.reset_index() if named else data
    if not isinstance(data, str | PathLike):
        raise ModelError(
            f"{user} has data of the type {type(data).__name__}; give a Result, a table of pandas or the path of a CSV file."
        )
    return read_table_file(data)


def named_columns(table: pd.DataFrame, names_given: str | Sequence[str], kind: str) -> list[str]:
    """Return the columns of numbers with these names; of a vector signal, the columns of its elements.

    Parameters
    ----------
    table : pandas.DataFrame
        The recording.
    names_given : str or sequence of str
        Names of columns or of vector signals, each once. The unit in brackets at the end of a column's name may be left out.
    kind : str
        What they are, for errors: ``"input"``.

    Raises
    ------
    UnknownNameError
        If there is no such column.
    RecordingError
        If several columns have such a name before their units.
    ModelError
        If a column has text or infinite values, a name is given twice, or there are no rows.
    """
    names = [names_given] if isinstance(names_given, str) else list(names_given)
    if not names or len(set(names)) < len(names):
        raise ModelError(f"{kind}s={names_given!r}; give at least one column, each once.")
    columns = []
    for name in names:
        several = [column for column in map(str, table.columns) if column.startswith(f"{name}[")]
        if name in table.columns:
            columns.append(name)
        elif several:  # a vector signal
            columns += several
        elif (column := column_called(name, list(map(str, table.columns)))) is not None:
            columns.append(column)
        else:
            raise UnknownNameError(
                f"The recording has no column {name!r} for an {kind}; {did_you_mean(name, list(map(str, table.columns)))}"
            )
    if not len(table):
        raise ModelError("The recording has no rows. Check the file, or what the table was made of.")
    for name in columns:
        if list(table.columns).count(name) > 1:
            raise ModelError(f"The recording has several columns {name!r}; give each another name.")
        if table[name].dtype.kind not in "fiub":
            raise ModelError(f"The column {name!r} contains text; give numbers, and empty cells for missing samples.")
        if np.isinf(table[name].to_numpy(dtype=np.float64)).any():
            raise ModelError(f"The column {name!r} contains infinite values; give empty cells for missing samples.")
    if len(set(columns)) < len(columns):
        raise ModelError(f"{kind}s={names_given!r} name a column twice; give each column once.")
    return columns
