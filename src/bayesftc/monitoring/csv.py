"""Columns of CSV files as signals."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from itertools import islice, pairwise
from os import PathLike, fspath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.invalid import invalid_values, numbers_of, without_texts
from bayesftc.cosim.base.paths import exists, expanded, is_file, is_folder
from bayesftc.cosim.base.recordings.columns import column_called
from bayesftc.cosim.base.recordings.csv_form import CsvForm, cells_of, form_of
from bayesftc.cosim.base.recordings.dates import are_dates, as_seconds, epoch_seconds, other_date
from bayesftc.cosim.base.recordings.held import least_change
from bayesftc.cosim.base.recordings.local_dates import iso_of, what_is_wrong, with_iso_dates
from bayesftc.cosim.base.recordings.split_times import joined_times
from bayesftc.cosim.base.recordings.table_files import exact_numbers, in_seconds, since_1970, time_column
from bayesftc.cosim.errors import RecordingError, did_you_mean
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.recording import LARGEST, absurd_values

if TYPE_CHECKING:
    import pandas as pd


ABOVE = " If lines stand above the row of names, begin each with #, or delete it."
"""The end of a message about a first row with a single cell."""

MOST_COLUMNS = 10_000

MOST_TEXTS = 5
"""Most texts of a column that an error names."""


@contextmanager
def file_of(table: pd.DataFrame, time: str) -> Iterator[tuple[Path, datetime | None]]:
    """Give a table as a CSV file, so that both have the same rules, and the instant of time 0 if its index has dates.

    Parameters
    ----------
    table : pandas.DataFrame
        Its times are its index, in seconds, dates or durations; or one of its columns if the index only counts the rows.
    time : str
        The name of an index without one.
    """
    import pandas as pd

    origin, index = None, table.index
    counts = isinstance(index, pd.RangeIndex) and (index.start, index.step) == (0, 1)
    timed = isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex) or index.name is not None
    counts = not timed and (counts or time_column(map(str, table.columns)) is not None)
    if isinstance(index, pd.DatetimeIndex) and len(index):
        origin = index[0].to_pydatetime()
        index = index - index[0]
    if isinstance(index, pd.TimedeltaIndex):
        table = table.set_axis(index.total_seconds())
    with TemporaryDirectory() as folder:
        file = Path(folder, "table.csv")
        if counts:
            table.to_csv(file, index=False)
        else:
            table.to_csv(file, index_label=str(table.index.name or time))
        try:
            yield file, origin
        except RecordingError as error:
            raise RecordingError(str(error).replace(fspath(file), "The table")) from None


class Tables:
    """The CSV files of a recording, each read once.

    Parameters
    ----------
    paths : path, or sequence of path
        Files, or folders with files.
    """

    def __init__(self, paths: str | PathLike[str] | Sequence[str | PathLike[str]]):
        self._files = [expanded(path) for path in ([paths] if isinstance(paths, str | PathLike) else paths)]
        if not self._files:
            raise RecordingError("There is no recording to read. Give at least one CSV file.")
        for path in self._files:
            if not exists(path):
                raise RecordingError(f"The recording {fspath(path)} does not exist. Check the path.")
        self._read: dict[Path, tuple[list[str], pd.DataFrame]] = {}
        self._forms: dict[Path, CsvForm] = {}
        # Where a column with decimal commas has a point, which may separate thousands.
        self._points: dict[tuple[Path, Any], NDArray[np.bool_]] = {}
        self._origin: pd.Timestamp | None = None  # of all dates, so that files fit together

    @property
    def origin(self) -> datetime | None:
        """The instant from which the dates that were read count in seconds; None if no times were dates."""
        return None if self._origin is None else self._origin.to_pydatetime()

    def files(self) -> list[Path]:
        """Return all CSV files, including those in folders."""
        files = [f for given in self._files for f in (sorted(given.glob("*.csv")) if is_folder(given) else [given])]
        if not files:
            raise RecordingError(f"There is no CSV file in {self._files[0]}. Check the path.")
        return list(dict.fromkeys(files))

    def names(self, file: PathLike[str]) -> list[str]:
        """Return the names of all columns."""
        return self._table(Path(file))[0]

    def numeric(self, file: Path) -> list[str]:
        """Return the names of the columns that contain a number."""
        import pandas as pd

        header, table = self._table(file)
        return [name for i, name in enumerate(header) if pd.to_numeric(table[i], errors="coerce").notna().any()]

    def texts(self, file: Path, name: str) -> dict[str, NDArray[np.bool_]]:
        """Return the rows of each different text of a column, in the order of their first rows."""
        cells = self._cells(file, name, "texts")
        return {text: (cells == text).to_numpy() for text in cells.dropna().unique() if isinstance(text, str)}

    def has_dates(self, file: Path, column: int) -> bool:
        """Return whether a column, by its number, has dates."""
        return are_dates(self._table(file)[1][column])

    def wrong_dates(self, file: Path, column: int) -> str | None:
        """Return why the dates of a column, by its number, are not read, if they have another form than ISO 8601."""
        return what_is_wrong(self._table(file)[1][column])

    def find(self, name: str | None, signal: str) -> Path:
        """Return the file with this name, or the only file if no name is given; `signal` begins the error message."""
        if name is None:
            files = self.files()
            if len(files) == 1:
                return files[0]
            raise RecordingError(f"{signal} has no file, but there are {len(files)} files. Add file = 'name.csv'.")
        matches = [f for f in self._files if f.name == name and not is_folder(f)]
        matches += [folder / name for folder in self._files if is_folder(folder) and is_file(folder / name)]
        if not matches:
            names = [f.name for f in self._files if not is_folder(f)]
            names += [f.name for folder in self._files if is_folder(folder) for f in folder.glob("*.csv")]
            raise RecordingError(f"{signal} is in {name!r}, which is not among the files; {did_you_mean(name, names)}")
        return matches[0]

    def called(self, name: str, file: str | None, signal: str) -> str:
        """Return a column's name in the file of this name, or in any: it may have a unit in brackets that `name` lacks.

        Raises
        ------
        RecordingError
            If several columns have this name before a unit, or the file does not exist.
        """
        files = self.files() if file is None else [self.find(file, signal)]
        return column_called(name, dict.fromkeys(each for file in files for each in self.names(file))) or name

    def having(self, name: str | None, column: str, signal: str) -> list[Path]:
        """Return the file with this name; without one the files that have a column, whose rows follow each other."""
        files = self.files() if name is None else []
        if len(files) < 2:
            return [self.find(name, signal)]
        found = [file for file in files if column in self.names(file)]
        if not found:
            names = dict.fromkeys(each for file in files for each in self.names(file))
            raise RecordingError(
                f"None of the {len(files)} files has a column {column!r} for {signal}; {did_you_mean(column, names)}"
            )
        return found

    def times(self, file: Path, name: str, whose: str = "") -> Floats:
        """Return a column of times in seconds; its name may have another unit (``t_ms``). Dates become seconds, too."""
        signal, source = f"the times{whose}", f"column {name!r} of {fspath(file)}"
        cells = self._cells(file, name, signal)
        if not are_dates(cells):
            seconds = in_seconds(name, self._numbers(cells, file, name, signal))
            if since_1970(seconds):
                seconds, self._origin = epoch_seconds(seconds, source, self._origin)
            return seconds
        seconds, self._origin = as_seconds(cells, source, self._origin)
        self._refuse_wrong(cells, np.isnan(seconds), file, name, signal)
        return seconds

    def column(self, file: Path, name: str, signal: str, invalid: Sequence[float | str] = ()) -> Floats:
        """Return a column as numbers, NaN where a cell is empty or invalid. The user is informed of values that are too large."""
        cells = without_texts(self._cells(file, name, signal), invalid)
        numbers = self._numbers(cells, file, name, signal)
        numbers[np.isin(numbers, invalid_values("A signal", numbers_of(invalid), 1))] = np.nan
        absurd = absurd_values(numbers)
        if absurd and np.any(np.abs(numbers) <= LARGEST):  # else there is nothing to read, which is an error
            inform(
                f"{fspath(file)}, column {name!r}, has {absurd}. No quantity is so large: they count as missing samples. "
                "Empty these cells, or correct the program that wrote them."
            )
        return numbers

    def _cells(self, file: Path, name: str, signal: str) -> pd.Series[Any]:
        header, table = self._table(file)
        places = [i for i, title in enumerate(header) if title == name]
        if not places:
            raise RecordingError(f"{fspath(file)} has no column {name!r} for {signal}; {did_you_mean(name, header)}")
        if len(places) > 1:
            raise RecordingError(
                f"{fspath(file)} has {len(places)} columns {name!r}: the first is number {places[0] + 1}, the last number "
                f"{places[-1] + 1}. Give each a different name."
            )
        return table[places[0]]

    def _numbers(self, cells: pd.Series[Any], file: Path, name: str, signal: str) -> Floats:
        import pandas as pd

        points = self._points.get((file, cells.name))
        if not pd.api.types.is_numeric_dtype(cells) or pd.api.types.is_bool_dtype(cells):
            cells = cells.astype(str).where(cells.notna())  # otherwise true would become 1
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, copy=True)
        if not pd.api.types.is_numeric_dtype(cells):  # such as +.5; before pandas 3.1 the last bit can be wrong
            right = np.isfinite(numbers)
            numbers[right] = cells.to_numpy()[right].astype(np.float64)
        if points is not None:
            numbers[points] = np.nan
        self._refuse_wrong(cells, np.isnan(numbers), file, name, signal)
        return np.asarray(numbers)

    def _refuse_wrong(
        self, cells: pd.Series[Any], missing: NDArray[np.bool_], file: Path, name: str, signal: str
    ) -> None:
        """Refuse cells that are neither numbers nor empty."""
        wrong = np.flatnonzero(missing & cells.notna().to_numpy())
        if not len(wrong):
            return
        line, _ = next(islice(cells_of(file, self._forms[file]), int(wrong[0]) + 1, None))
        sign, form = ("point", "12.5") if self._forms[file].decimal == "." else ("comma", "12,5")
        if not signal.startswith("the times"):
            remedy = f"An empty cell is a missing sample. {_remedy(cells.iloc[wrong])}"
            remedy += f"Numbers have a decimal {sign} here, such as {form}."
        elif (date := other_date(cells)) is not None:
            remedy = f"Write dates in the form of ISO 8601, such as {iso_of(date)}."
        else:
            remedy = f"Write times as seconds, such as {form}, or as dates, such as 2026-05-01T10:00:12.5."
        if wrong.tolist() == [0]:
            remedy += f" If line {line} has units or other texts below the names, remove that line."
        raise RecordingError(
            f"{fspath(file)}: {str(cells.iloc[wrong[0]])!r} in line {line}, column {name!r}, is no number. {remedy}"
        )

    def _table(self, file: Path) -> tuple[list[str], pd.DataFrame]:
        import pandas as pd

        if file not in self._read:
            try:
                form = self._forms[file] = form_of(file)
                header, begin = _check(file, form)
                table = pd.read_csv(
                    file,
                    skipinitialspace=True,
                    header=None,
                    skiprows=begin,
                    index_col=False,
                    encoding=form.encoding,
                    sep=form.separator,
                    decimal=form.decimal,
                    **exact_numbers(),
                )
            except UnicodeDecodeError:
                raise RecordingError(f"{fspath(file)} is no text in UTF-8. Save it as CSV in UTF-8.") from None
            except OSError as error:
                raise RecordingError(
                    f"The recording {fspath(file)} cannot be read ({error.strerror}). Check the path."
                ) from None
            except (csv.Error, pd.errors.ParserError) as error:
                reason = str(error).strip().rstrip(".")
                raise RecordingError(
                    f"{fspath(file)} is no CSV table with commas and a first row of names: {reason}."
                ) from None
            table, kept = joined_times(table, header, fspath(file))
            table.columns, header = pd.RangeIndex(len(kept)), [header[i] for i in kept]
            if form.decimal != ".":  # pandas leaves decimal commas in a column with a text
                for column in table.select_dtypes(exclude=["number", "bool"]).columns:
                    cells = list(table[column])
                    table[column] = [form.number(cell) if isinstance(cell, str) else cell for cell in cells]
                    if any(_is_fraction(cell, form) for cell in cells):
                        self._points[file, column] = np.array(
                            [isinstance(cell, str) and form.has_other_sign(cell) for cell in cells]
                        )
            for i, name in enumerate(header):
                if (written := with_iso_dates(table[i], f"column {name!r} of {fspath(file)}")) is not table[i]:
                    table[i] = written
            self._read[file] = header, table
        return self._read[file]


def in_order(times: Sequence[Floats]) -> list[int] | None:
    """Return the order of files, by their times, whose rows follow each other; None if two of them overlap."""
    order = sorted(range(len(times)), key=lambda i: float(np.nanmin(times[i], initial=np.inf)))
    spans = [(float(np.nanmin(times[i])), float(np.nanmax(times[i]))) for i in order if np.isfinite(times[i]).any()]
    overlap = any(later[0] < earlier[1] for earlier, later in pairwise(spans))
    return None if overlap else order


def warn_of_changes(columns: Mapping[str, Floats]) -> None:
    """Inform the user of sensors that seem to be logged only where they have changed: empty cells are no missing samples.

    Parameters
    ----------
    columns : mapping of str to ndarray
        The cells of each column, NaN where one is empty.
    """
    found = [name for name, cells in columns.items() if least_change(cells) is not None]
    if found:
        share = np.mean([np.isnan(columns[name]).mean() for name in found])
        who = f"The columns {', '.join(map(repr, found))}" if len(found) > 1 else f"The column {found[0]!r}"
        inform(
            f"{who} seem{'s' if len(found) == 1 else ''} to have a value only where it has changed: {share:.0%} of the cells are "
            "empty. An empty cell is read as a missing sample, so that this looks like dropouts. If it stands for the value "
            "before, fill it in first, such as with pandas: table.ffill()."
        )


def _check(file: Path, form: CsvForm) -> tuple[list[str], int]:
    """Return the names of the columns and the line where they end, if all rows have as many cells.

    pandas would fill a row that is too short. If all rows are too long, it would use the first columns as an index.
    """
    rows = cells_of(file, form)
    begin, cells = next(rows, (0, []))
    names = [cell.strip() for cell in cells]
    if not names:
        raise RecordingError(f"{fspath(file)} is empty. It needs a first row of names and a row for each time.")
    if len(names) > MOST_COLUMNS:
        raise RecordingError(
            f"{fspath(file)} has {len(names)} columns, but a recording has at most {MOST_COLUMNS}. Keep those of the sensors."
        )
    if all(_is_number(form.number(name)) for name in names):
        raise RecordingError(f"{fspath(file)} begins with numbers. Add a first row with the names of the columns.")
    row = None
    for row in rows:
        if len(row[1]) != len(names):
            raise RecordingError(
                f"{fspath(file)}: line {row[0]} has {len(row[1])} cell(s), but the first row has {len(names)} name(s). Each row "
                f"needs as many cells; some may be empty.{ABOVE if len(names) == 1 else ''}"
            )
    if row is None:
        raise RecordingError(f"{fspath(file)} has a row of names, but no row of samples below it.")
    return names, begin


def _remedy(wrong: pd.Series[Any]) -> str:
    """Return what to do with texts that a device or a historian writes in place of a sample; empty if numbers are misspelt."""
    texts = [text for text in dict.fromkeys(str(cell).strip() for cell in wrong) if text[:1].isalpha() or " " in text]
    if not texts:
        return ""
    named = texts[:MOST_TEXTS]
    options = " ".join(f"--invalid {shlex.quote(text)}" for text in named)
    listed = ", ".join(json.dumps(text, ensure_ascii=False) for text in named)
    subject = "this text stands" if len(texts) == 1 else f"its {len(texts)} texts stand"
    return f"If {subject} for missing samples, add {options} to --fit, or invalid = [{listed}] to a model file. "


def _is_fraction(cell: Any, form: CsvForm) -> bool:
    """Return whether a cell of a file with decimal commas has one, also if pandas has read it as a number."""
    if isinstance(cell, str):
        return form.number(cell) != cell
    return isinstance(cell, float) and np.isfinite(cell) and not cell.is_integer()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
