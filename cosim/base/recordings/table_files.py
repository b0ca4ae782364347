"""Recordings in files: CSV with a header, or Parquet; and the unit of their times, from the header: ``t_ms``, ``time [ms]``."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.recordings.csv_form import form_of, lines_above
from bayesftc.cosim.base.recordings.dates import ISO, are_dates, as_seconds
from bayesftc.cosim.base.recordings.local_dates import with_iso_dates
from bayesftc.cosim.base.recordings.split_times import joined_times
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

_ALONE = {
    Fraction(1, 10**9): ("ns", "nsec", "nanos", "nanoseconds"),
    Fraction(1, 10**6): ("us", "µs", "μs", "usec", "micros", "microseconds"),
    Fraction(1, 10**3): ("ms", "msec", "millis", "milliseconds"),
    Fraction(1): ("sec", "secs", "second", "seconds"),
    Fraction(60): ("minutes",),
    Fraction(3600): ("hours",),
    Fraction(86400): ("days",),
}
"""Seconds in each unit of time, with its names that may be the whole name of a column."""

UNITS_OF_TIME = {name: unit for unit, names in _ALONE.items() for name in names} | {
    "s": Fraction(1),
    "min": Fraction(60),
    "h": Fraction(3600),
}
"""Seconds in each unit of time, by its names."""

TIMES = ("t", "time", "timestamp", "times", "seconds", "millis", "milliseconds", "microseconds")
"""Names of a column of times, in any case, also with a unit (``t_ms``)."""

_STAMP = "stamp"
"""The word before the unit in a message's time of ROS (``header.stamp.sec``; ``secs`` in ROS 1)."""

EPOCH = 1.0e9, 4.1e9
"""Seconds since 1970 of the years 2001 to 2099: times of this size count from there, and others hardly are so large."""

_SINCE_1970 = Fraction(1), Fraction(1, 10**3), Fraction(1, 10**6), Fraction(1, 10**9)
"""Seconds in the units in which programs count from 1970. The spans of `EPOCH` in these units do not overlap."""

_IN_BRACKETS = re.compile(r".*[\[(]\s*([^\W\d_][^\])]*?)\s*[\])]\s*")
_AT_THE_END = re.compile(r".*(?:[\W_]|[a-z](?=[A-Z]))([^\W\d_]+)\s*")


def time_unit(name: object) -> Fraction:
    """Return the seconds in the unit of a column of times; 1 if its name has no unit.

    Raises
    ------
    RecordingError
        If the name has something in brackets that is no unit of time.
    """
    return _named_unit(name) or Fraction(1)


def _named_unit(name: object) -> Fraction | None:
    """Return the seconds in the unit that the name of a column of times has; None without one."""
    text = str(name)
    if any(text.lower() in names for names in _ALONE.values()):
        return UNITS_OF_TIME[text.lower()]
    bracket, end = _IN_BRACKETS.fullmatch(text), _AT_THE_END.fullmatch(text)
    word = bracket[1].split()[0] if bracket else end[1] if end else ""
    unit = UNITS_OF_TIME.get(word.lower())
    if bracket and unit is None:
        raise RecordingError(
            f"The column of times {text!r} is in {bracket[1]!r}, which is no known unit of time. Call it 't [s]', 't [ms]' or "
            "'t [min]', or convert the times to seconds and call it 't'."
        )
    return unit


def since_1970(seconds: Any) -> bool:
    """Return whether times in seconds count from 1970, by their size; see `EPOCH`."""
    given = np.asarray(seconds, dtype=np.float64)
    given = given[np.isfinite(given)]
    return len(given) > 0 and bool(EPOCH[0] <= given.min() and given.max() <= EPOCH[1])


def time_column(names: Iterable[str]) -> str | None:
    """Return the first of these columns whose name is one of `TIMES`, alone or with a unit, or that of a ROS message's time.

    None if there is none.
    """
    for name in names:
        first, *unit = [word for word in re.split(r"[\W_]+", str(name).lower()) if word] or [""]
        if first in TIMES and (not unit or (len(unit) == 1 and unit[0] in UNITS_OF_TIME)):
            return name
        if unit[-1:] in (["sec"], ["secs"]) and [first, *unit][-2] == _STAMP:
            return name
    return None


def find_times(table: pd.DataFrame, others: Container[str] = ()) -> str | None:
    """Return the column of times: the first whose name says so, else the first one of dates; None if there is none.

    Parameters
    ----------
    table : pandas.DataFrame
        The recording.
    others : container of str
        Columns that are something else.
    """
    import pandas as pd

    names = [name for name in table.columns if name not in others]
    named = time_column(names)
    if named is not None:
        return named
    # A name that occurs twice gives a table.
    return next((name for name in names if isinstance(table[name], pd.Series) and are_dates(table[name])), None)


def times_in(table: pd.DataFrame, name: str) -> Floats:
    """Return a column of times in seconds: of numbers by the unit in its name, of dates from the first one on.

    Raises
    ------
    RecordingError
        If a text is no date.
    ValueError
        If a text is no number.
    """
    cells = table[name]
    if not are_dates(cells):
        return in_seconds(name, cells)
    seconds, _ = as_seconds(cells, f"column {name!r}")
    wrong = np.flatnonzero(np.isnan(seconds) & cells.notna().to_numpy())
    if len(wrong):
        raise RecordingError(
            f"{str(cells.iloc[wrong[0]])!r} in the column of times {name!r}, row {wrong[0] + 1}, is no date of ISO 8601. Write "
            f"dates as {ISO}."
        )
    return seconds


def in_seconds(name: object, times: Any) -> Floats:
    """Return the times of a column in seconds, by the unit in its name; see `time_unit`.

    Without a unit in the name, numbers of about 1e12, 1e15 or 1e18 are milli-, micro- or nanoseconds since 1970.
    """
    given, named = np.asarray(times, dtype=np.float64), _named_unit(name)
    if named is not None:
        return _times(given, named)
    return next((seconds for unit in _SINCE_1970 if since_1970(seconds := _times(given, unit))), given)


def _times(numbers: Floats, unit: Fraction) -> Floats:
    # 35 / 1000 is the nearest number to 0.035; 35 * 0.001 is not.
    return np.asarray(numbers * unit.numerator / unit.denominator)


def exact_numbers() -> dict[str, Any]:
    """Return the argument with which `pandas.read_csv` reads each number as the nearest double.

    Before 3.1 the default misses it by the last bit in a third of the numbers; since then the argument is deprecated.
    """
    import pandas as pd

    major, minor = (int(part) for part in pd.__version__.split(".")[:2])
    return {"float_precision": "round_trip"} if (major, minor) < (3, 1) else {}


def _read_csv(path: str | PathLike[str]) -> pd.DataFrame:
    import pandas as pd

    form = form_of(path)
    table: pd.DataFrame = pd.read_csv(
        path,
        encoding=form.encoding,
        sep=form.separator,
        decimal=form.decimal,
        skiprows=lines_above(path, form),
        **exact_numbers(),
    )
    return table


def _with_iso_dates(table: pd.DataFrame, path: str | PathLike[str]) -> pd.DataFrame:
    """Return the table with dates that have the day first in the form of ISO 8601."""
    for i, (name, cells) in enumerate(list(table.items())):
        if (written := with_iso_dates(cells, f"column {str(name)!r} of {path}")) is not cells:
            table.isetitem(i, written.array)
    return table


def _with_seconds(table: pd.DataFrame, path: str | PathLike[str]) -> pd.DataFrame:
    """Return the table with the dates in columns of times as numbers in the unit of the column's name."""
    seconds = {}
    for name in table.columns:
        if time_column([str(name)]) and are_dates(table[name]):
            unit = time_unit(name)
            seconds[name] = as_seconds(table[name], f"column {name!r} of {path}")[0] * unit.denominator / unit.numerator
    return table.assign(**seconds)


def read_table_file(path: str | PathLike[str]) -> pd.DataFrame:
    """Return the table in a file; one that ends in ``.parquet`` is read as such, every other as CSV with a header.

    Columns of a CSV file may be separated by semicolons, tabs or bars; then numbers may have decimal commas. Lines that
    begin with ``#`` may stand above the names. Dates (ISO 8601, or with the day first) in a column of times become
    the unit of its name, by default seconds, from the first one on.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    import pandas as pd

    try:
        table = pd.read_parquet(path) if Path(path).suffix == ".parquet" else _read_csv(path)
        table, _ = joined_times(table, list(table.columns), str(path))
        return _with_seconds(_with_iso_dates(table, path), path)
    except (OSError, ValueError, ImportError) as error:  # pandas without a package for Parquet raises the last
        message = getattr(error, "strerror", None) or str(error).strip().rstrip(".")
        raise RecordingError(
            f"The recording {path} cannot be read: {message}; give a CSV file with a header, or a Parquet file."
        ) from None


__all__ = [
    "TIMES",
    "exact_numbers",
    "find_times",
    "in_seconds",
    "read_table_file",
    "since_1970",
    "time_column",
    "time_unit",
    "times_in",
]
