"""Recordings in files: CSV with a header, or Parquet."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import RecordingError

if TYPE_CHECKING:
    import pandas as pd


def read_table_file(path: str | PathLike[str]) -> pd.DataFrame:
    """Return the table in a file; one that ends in ``.parquet`` is read as such, every other as CSV with a header.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    import pandas as pd

    try:
        return pd.read_parquet(path) if Path(path).suffix == ".parquet" else pd.read_csv(path)
    except (OSError, ValueError, ImportError) as error:  # pandas without a package for Parquet raises the last
        message = getattr(error, "strerror", None) or str(error).strip().rstrip(".")
        raise RecordingError(
            f"The recording {path} cannot be read: {message}; give a CSV file with a header, or a Parquet file."
        ) from None


__all__ = ["read_table_file"]
