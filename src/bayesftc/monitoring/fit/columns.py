"""Find the columns of times and sensors in CSV files without a model file, and the sample time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.models.checks import as_number
from bayesftc.cosim.base.recordings.columns import column_called, column_unit
from bayesftc.cosim.base.recordings.dates import seconds_of, span_text
from bayesftc.cosim.base.recordings.held import is_held
from bayesftc.cosim.base.recordings.intervals import usual_step
from bayesftc.cosim.base.recordings.table_files import TIMES, time_column
from bayesftc.cosim.base.recordings.turns import find_period
from bayesftc.cosim.errors import RecordingError, brief, did_you_mean
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.csv import Tables, file_of, in_order, warn_of_changes
from bayesftc.monitoring.fit.units import check_one_unit, in_unit
from bayesftc.monitoring.recording import Recording, Signal, align

if TYPE_CHECKING:
    import pandas as pd

MOST_TAGS = 100
"""Largest number of different texts of a column that may say which sensor each row is of."""

IN_ORDER = 0.9
"""Share of rows whose time is later than all before, which the rows of one sensor have: a logger may repeat some."""


@dataclass(frozen=True)
class Place:
    r"""The file and the columns of a signal.

    Parameters
    ----------
    file, column, time : str
        Its file (empty: several that follow each other, as of days), its column and the column of its times.
    invalid : tuple of float or str
        Values that stand for no sample.
    period : float
        Full turn of an angle; 0 for other quantities.
    held : bool
        Whether a value that repeats the one before is no sample.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import monitoring
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "tank.csv")
    ...     _ = file.write_text("time,T_1,T_2\n0.0,20.1,20.0\n0.1,20.2,20.1\n")
    ...     places, signals = monitoring.redundant_signals([file])
    >>> places["T_2"]
    Place(file='tank.csv', column='T_2', time='time', invalid=(), period=0.0, held=False)
    """

    file: str
    column: str
    time: str
    invalid: tuple[float | str, ...] = ()
    period: float = 0.0
    held: bool = False


def redundant_signals(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    names: Sequence[str] = (),
    invalid: Mapping[str, Sequence[float | str]] | None = None,
) -> tuple[dict[str, Place], dict[str, Signal]]:
    r"""Return all signals of CSV files, except the times, and the place of each.

    Parameters
    ----------
    paths : path, or sequence of path
        Files, or folders with files.
    names : sequence of str
        Columns that are sensors, with or without the unit in brackets at the end; by default all. Samples are converted to
        the unit of the first one.
    invalid : mapping of str to sequence of float or str, optional
        Values, or texts such as ``"Bad Input"``, that stand for no sample, by the name of their column; those of ``""`` hold
        for all columns.

    Returns
    -------
    dict of str to Place, dict of str to Signal
        By the name of the column, or by file and column if the name is not unique.

    Raises
    ------
    RecordingError
        If a file is no table, has no times, or lacks one of the named columns, or if the units at the end of two names
        cannot be converted.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import monitoring
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "tank.csv")
    ...     _ = file.write_text("time,T_1,T_2,valve\n0.0,20.1,20.0,1\n0.1,20.2,20.1,1\n")
    ...     places, signals = monitoring.redundant_signals([file], ["T_1", "T_2"])
    >>> {name: signal.values.tolist() for name, signal in signals.items()}
    {'T_1': [20.1, 20.2], 'T_2': [20.0, 20.1]}
    """
    return signals_of(Tables(paths), names, invalid or {})


def signals_of(
    tables: Tables, names: Sequence[str], invalid: Mapping[str, Sequence[float | str]]
) -> tuple[dict[str, Place], dict[str, Signal]]:
    """Return the signals of tables that are read already; see `redundant_signals`."""
    places: dict[str, Place] = {}
    signals: dict[str, Signal] = {}
    cells: dict[str, Floats] = {}
    headers = {file: tables.numeric(file) for file in tables.files()}
    times_of = {file: _time_column(tables, file, header) for file, header in headers.items()}
    columns = [name for file, header in headers.items() for name in header if name != times_of[file]]
    chosen = {_column(name, columns) for name in names} or set(columns)
    values = {_column(name, columns) if name else "": tuple(given) for name, given in invalid.items()}
    check_one_unit(name for name in columns if name in chosen)
    unit = next((given for name in columns if name in chosen and (given := column_unit(name))), "")
    having: dict[str, list[Path]] = {}
    for file, header in headers.items():
        for column in header:
            if column != times_of[file] and column in chosen:
                having.setdefault(column, []).append(file)
    read = {file: tables.times(file, times_of[file]) for files in having.values() for file in files}
    for file, times in read.items():
        _refuse_rows_of_tags(tables, file, times_of[file], times)
    for column, files in having.items():
        order = in_order([read[file] for file in files])
        # Files such as one for each day follow each other; others of the same time have sensors of the same name.
        parts = [[files[i] for i in order]] if order is not None else [[file] for file in files]
        for part in parts:
            file, time = part[0], times_of[part[0]]
            name = column if column not in places else f"{file.stem}_{column}"
            invalid_here = (*values.get("", ()), *values.get(column, ()))
            places[name] = Place(file.name if len(part) == 1 else "", column, time, invalid_here)
            logged = np.concatenate([tables.column(each, column, "a sensor", invalid_here) for each in part])
            cells[name] = logged
            samples = in_unit(logged, column, unit)
            times = np.concatenate([read[each] for each in part])
            try:
                signal = Signal(times, samples, unit=column_unit(column) and unit, origin=tables.origin)
            except RecordingError as error:
                raise RecordingError(f"{file}, the column {column!r}: {error}") from None
            held = is_held(*signal.corrected, signal.resolution or 0.0)
            places[name], signals[name] = replace(places[name], held=held), replace(signal, held=held)
    warn_of_changes(cells)
    if not signals:
        raise RecordingError("There is no column besides the times. Give a file with two or more sensors.")
    if period := find_period(np.asarray(signal.values) for signal in signals.values()):
        places = {name: replace(place, period=period) for name, place in places.items()}
        signals = {name: replace(signal, period=period) for name, signal in signals.items()}
    return places, signals


def without_numbers(tables: Tables) -> list[str]:
    """Return the columns that are no times and have no number, in the order of the files."""
    named = [
        name
        for file in tables.files()
        for name in tables.names(file)
        if name and name not in (*tables.numeric(file), _time_column(tables, file, tables.numeric(file)))
    ]
    return list(dict.fromkeys(named))


def _in_order(times: Floats) -> float:
    """Return the share of times that are later than all before."""
    return float(np.mean(np.diff(np.maximum.accumulate(times)) > 0)) if len(times) > 1 else 1.0


def _refuse_rows_of_tags(tables: Tables, file: Path, time: str, times: Floats) -> None:
    """Refuse a table with a row for each value, as historians export it: the times come again for each text of a column."""
    values = [name for name in tables.numeric(file) if name != time]
    if len(values) != 1 or _in_order(times) >= IN_ORDER:
        return
    for name in tables.names(file):
        texts = tables.texts(file, name) if name not in (time, *values) else {}
        if 1 < len(texts) <= MOST_TAGS and min(_in_order(times[rows]) for rows in texts.values()) >= IN_ORDER:
            what = ", ".join(list(texts)[:3]) + ", ..." * (len(texts) > 3)
            raise RecordingError(
                f"{os.fspath(file)} has a row for each value: its column {name!r} says of what ({what}). Give each a column, for "
                f"example with pandas: table.pivot(index={time!r}, columns={name!r}, values={values[0]!r}).to_csv('wide.csv')."
            )


def _column(name: str, columns: Sequence[str]) -> str:
    """Return the column of this name, with or without its unit."""
    found = column_called(name, columns)
    if found is None:
        raise RecordingError(f"There is no column {name!r} with numbers; {did_you_mean(name, columns)}")
    return found


def _time_column(tables: Tables, file: Path, header: Sequence[str]) -> str:
    """Return the column of times: by its name, else the first one, if that increases."""
    every = tables.names(file)
    named = time_column(every)
    first = every.index(named) if named is not None and every.count(named) == 1 else 0
    if (wrong := tables.wrong_dates(file, first)) is not None:
        raise RecordingError(f"{os.fspath(file)}: the dates in the column {every[first]!r}, such as {wrong}.")
    if (name := time_column(every)) is not None:
        return name
    if tables.has_dates(file, 0):
        return every[0]  # a signal says where dates do not increase, and why
    why = "has no number"
    if every[0] in header:
        why = "does not increase"
        if np.all(np.diff(tables.times(file, every[0])) > 0):
            return every[0]
    raise RecordingError(
        f"{os.fspath(file)} has no column of times: none is called {', '.join(TIMES[:3])}, and the first, {every[0]!r}, {why}. "
        "Name the column of times 't' (in seconds) or by its unit, as 't_ms'."
    )


def sample_time(signals: Mapping[str, Signal]) -> Fraction:
    """Return the interval of the fastest signal, or a part of it if its times jitter, as a short number."""
    return usual_step(min((np.asarray(s.time) for s in signals.values()), key=lambda t: float(np.median(np.diff(t)))))


def stretch_of(
    recording: Recording, start: float | datetime | str | None, stop: float | datetime | str | None
) -> slice:
    """Return the steps between two times.

    Parameters
    ----------
    recording : Recording
        The recording.
    start, stop : float, datetime, str or None
        Times in seconds, or dates if those of the recording are, also as ISO 8601 texts; None for the recording's start or end.

    Returns
    -------
    slice
        The steps from `start` to `stop`, both included.

    Raises
    ------
    RecordingError
        If there is no step between them, or if one is a date but the recording has none.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> signals = {name: monitoring.Signal(0.1 * np.arange(50), np.zeros(50)) for name in "ab"}
    >>> recording = monitoring.recorded(signals)
    >>> monitoring.stretch_of(recording, 1.0, 2.0)
    slice(10, 21, None)
    """
    time = recording.time
    begin, end = (_seconds(recording, *given) for given in (("start (--from)", start), ("end (--to)", stop)))
    first = 0 if begin is None else int(np.searchsorted(time, begin))
    last = len(time) if end is None else int(np.searchsorted(time, end, side="right"))
    if first >= last:
        if begin is not None and end is not None and begin > end:
            raise RecordingError("The start (--from) is later than the end (--to). Exchange the two times.")
        raise RecordingError(
            f"The recording, from {span_text(time[0], time[-1], recording.origin)}, has no samples between the start "
            "(--from) and the end (--to). Choose times in it."
        )
    return slice(first, last)


def _seconds(recording: Recording, which: str, moment: float | datetime | str | None) -> float | None:
    """Return a time in seconds of the recording; None stays None."""
    if isinstance(moment, str):
        try:
            moment = datetime.fromisoformat(moment)
        except ValueError:
            raise RecordingError(
                f"The {which} is {moment!r}; give a number of seconds, or a date such as '2026-05-01T10:00:12'."
            ) from None
    if moment is None:
        return None
    if not isinstance(moment, datetime):
        return as_number(f"The stretch has the {which}", moment)
    span = span_text(recording.time[0], recording.time[-1], recording.origin)
    if recording.origin is None:
        raise RecordingError(f"The {which} is a date, but the times of the recording are {span}. Give seconds.")
    if recording.origin.tzinfo is None and moment.tzinfo is not None:
        raise RecordingError(
            f"The {which} has a time zone, but the dates of the recording, {span}, have none. Leave it out."
        )
    return seconds_of(moment, recording.origin)


def recorded(source: Mapping[str, Signal] | pd.DataFrame | str | os.PathLike[str]) -> Recording:
    """Bring signals to common steps of about their own interval; see `align`.

    Parameters
    ----------
    source : mapping of str to Signal, DataFrame or path
        All of them sensors. Of a table, or a CSV file as in `redundant_signals`, all columns but the times. A table's times are
        its index (seconds or dates), or if that only counts the rows a column, such as ``time``.

    Returns
    -------
    Recording
        The samples at the steps of the fastest sensor.

    Raises
    ------
    RecordingError
        As for `align`, if a signal has only one sample, or if the source is none of these.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> fast = monitoring.Signal(0.02 * np.arange(50), np.zeros(50))
    >>> slow = monitoring.Signal(0.1 * np.arange(10), np.zeros(10))
    >>> recording = monitoring.recorded({"fast": fast, "slow": slow})
    >>> float(recording.dt), np.isfinite(recording.y).sum(axis=0).tolist()
    (0.02, [50, 10])
    """
    return placed(source)[1]


def placed(
    source: Mapping[str, Signal] | pd.DataFrame | str | os.PathLike[str],
) -> tuple[dict[str, Place], Recording]:
    """Return the recording of `recorded`, and the places of its sensors; those of signals have no file."""
    places: dict[str, Place] = {}
    if isinstance(source, str | os.PathLike):
        places, found = redundant_signals(source)
        signals: Mapping[str, Signal] = found
    elif hasattr(source, "to_csv"):
        with file_of(source, TIMES[0]) as (file, origin):  # type: ignore[arg-type]
            places, found = redundant_signals(file)
        signals = {name: replace(signal, origin=origin or signal.origin) for name, signal in found.items()}
    else:
        signals = signals_by_name(source)
        places = {
            name: Place("", name, TIMES[0], tuple(signal.invalid), signal.period, signal.held)
            for name, signal in signals.items()
        }
    if not signals:
        raise RecordingError("There is no sensor to monitor. Name at least one.")
    for name, signal in signals.items():
        if len(np.asarray(signal.time)) < 2:
            raise RecordingError(f"The sensor {name!r} has only one sample. Leave it out.")
    return places, align(signals, {}, sample_time(signals))


def signals_by_name(source: object) -> Mapping[str, Signal]:
    """Return a mapping of signals, or refuse what is none."""
    if isinstance(source, Mapping) and all(isinstance(signal, Signal) for signal in source.values()):
        return source
    raise RecordingError(
        f"A recording is made of signals by name, as {{'left': Signal(times, values)}}, a pandas table or a CSV file, not of "
        f"{brief(source)}."
    )
