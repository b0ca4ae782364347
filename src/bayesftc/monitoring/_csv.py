"""Columns of CSV files as signals."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import RecordingError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd


class Tables:
    """The CSV files of a recording, each read once.

    Parameters
    ----------
    paths : sequence of path
        Files, or folders with files.
    """

    def __init__(self, paths: Sequence[str | PathLike[str]]):
        self._files = [Path(path).expanduser() for path in paths]
        if not self._files:
            raise RecordingError("There is no recording to read; give at least one CSV file.")
        self._read: dict[Path, pd.DataFrame] = {}

    def find(self, name: str | None, wanted_by: str) -> Path:
        """Return the file that is called `name`, or the only one where no name is given."""
        if name is None:
            files = [f for given in self._files for f in (sorted(given.glob("*.csv")) if given.is_dir() else [given])]
            if len(set(files)) == 1:
                return files[0]
            if not files:
                raise RecordingError(f"There is no CSV file in {self._files[0]}; check the path.")
            raise RecordingError(
                f"{wanted_by} does not say in which file it is; with more than one give it file = 'name.csv'."
            )
        found = [f for f in self._files if f.name == name and not f.is_dir()]
        found += [folder / name for folder in self._files if folder.is_dir() and (folder / name).is_file()]
        if not found:
            known = [f.name for f in self._files if not f.is_dir()]
            known += [f.name for folder in self._files if folder.is_dir() for f in folder.glob("*.csv")]
            raise RecordingError(
                f"{wanted_by} is in {name!r}, which is not among the files; {did_you_mean(name, known)}"
            )
        return found[0]

    def column(self, file: Path, name: str) -> Floats:
        """Return a column as numbers, NaN where a cell is empty."""
        import pandas as pd

        table = self._table(file)
        if name not in table.columns:
            raise RecordingError(f"{file} has no column {name!r}; {did_you_mean(name, map(str, table.columns))}")
        numbers = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=np.float64)
        wrong = np.flatnonzero(np.isnan(numbers) & table[name].notna().to_numpy())
        if len(wrong):
            raise RecordingError(
                f"{file}: {str(table[name].iloc[wrong[0]])!r} in row {wrong[0] + 2} of the column {name!r} is no number; leave a "
                "missing sample empty, and write numbers with a point."
            )
        return np.asarray(numbers)

    def _table(self, file: Path) -> pd.DataFrame:
        import pandas as pd

        if file not in self._read:
            try:
                self._read[file] = pd.read_csv(file, skipinitialspace=True)
            except (OSError, UnicodeDecodeError) as error:
                reason = getattr(error, "strerror", None) or "it is no text in UTF-8"
                raise RecordingError(
                    f"The recording {fspath(file)} cannot be read ({reason}); check the path."
                ) from None
            except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
                reason = str(error).strip().rstrip(".")
                raise RecordingError(
                    f"{fspath(file)} is no table of values with commas and a first row of names: {reason}."
                ) from None
        return self._read[file]
