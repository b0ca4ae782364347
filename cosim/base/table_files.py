"""Recordings in files: CSV with a header, or Parquet."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import RecordingError

if TYPE_CHECKING:
    import pandas as pd


def exact_numbers() -> dict[str, Any]:
    """Return the argument with which `pandas.read_csv` reads each number as the nearest double.

    Before 3.1 the default misses it by the last bit in a third of the numbers; since then the argument is deprecated.
    """
    import pandas as pd

    major, minor = (int(part) for part in pd.__version__.split(".")[:2])
    return {"float_precision": "round_trip"} if (major, minor) < (3, 1) else {}


def read_table_file(path: str | PathLike[str]) -> pd.DataFrame:
    """Return the table in a file; one that ends in ``.parquet`` is read as such, every other as CSV with a header.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    import pandas as pd

    try:
        return pd.read_parquet(path) if Path(path).suffix == ".parquet" else pd.read_csv(path, **exact_numbers())
    except (OSError, ValueError, ImportError) as error:  # pandas without a package for Parquet raises the last
        message = getattr(error, "strerror", None) or str(error).strip().rstrip(".")
        raise RecordingError(
            f"The recording {path} cannot be read: {message}; give a CSV file with a header, or a Parquet file."
        ) from None


__all__ = ["exact_numbers", "read_table_file"]
