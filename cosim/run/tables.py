"""Tables of recorded signals: reading them, their columns and their times."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.recordings.columns import column_called
from bayesftc.cosim.base.recordings.dates import are_dates
from bayesftc.cosim.base.recordings.local_dates import what_is_wrong
from bayesftc.cosim.base.recordings.table_files import TIMES, read_table_file, times_in
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, did_you_mean
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

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


def sample_time(table: pd.DataFrame, time: str | None, dt: float | str | Fraction | None) -> Fraction:
    """Return the sample time in seconds: the given one, or that of the evenly spaced times in a column.

    Raises
    ------
    StepSizeError
        If `dt` is not positive, or without it the times are missing or not evenly spaced (within 1 %).
    """
    if dt is not None:
        return rational_step(dt)
    t = times_of(table, time)
    steps = np.diff(t)
    mean = float(t[-1] - t[0]) / len(steps)
    if np.abs(steps - mean).max() > 0.01 * mean:
        raise StepSizeError(
            f"The times in {time!r} are not evenly spaced: steps are from {steps.min():g} to {steps.max():g} s. Resample the "
            "recording, with empty rows where nothing was recorded."
        )
    return Fraction(f"{mean:.6g}")


def times_of(table: pd.DataFrame, time: str | None) -> Floats:
    """Return the times of the rows in seconds; dates count from the first one.

    The name of the column may have another unit (``t_ms``), or be None if unknown.

    Raises
    ------
    StepSizeError
        If there is no such column, or its numbers or dates do not increase.
    RecordingError
        If a cell among dates is none.
    """
    if time is None or time not in table.columns:
        names = f"column of times: none is called {', '.join(TIMES[:3])}" if time is None else f"column {time!r}"
        raise StepSizeError(
            f"The recording has no {names}; give the name of the column of times (time=...), or dt= in seconds. Its "
            f"columns: {', '.join(map(str, table.columns[:12]))}{', ...' * (len(table.columns) > 12)}."
        )
    single = list(table.columns).count(time) == 1
    if single and (wrong := what_is_wrong(table[time])) is not None:
        raise StepSizeError(f"The dates in {time!r}, such as {wrong}, or give only dt= in seconds.")
    if not single or (table[time].dtype.kind not in "fiu" and not are_dates(table[time])):
        raise StepSizeError(
            f"The column {time!r} does not contain numbers. Convert the times to seconds, or give dt= in seconds."
        )
    t = times_in(table, time)
    steps = np.diff(t)
    if len(steps) == 0 or not np.isfinite(steps).all() or steps.min() <= 0:
        raise StepSizeError(
            f"The times in {time!r} do not increase from row to row; sort the recording, or give dt= in seconds."
        )
    return t
