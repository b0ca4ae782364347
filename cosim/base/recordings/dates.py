"""Dates as times: a column of ISO 8601 dates becomes seconds."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

_DATE = re.compile(r"\s*\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?)?\s*(Z|[+-]\d{2}:?\d{2})?\s*")


def are_dates(cells: Any) -> bool:
    """Return whether a column has dates: as dates of pandas, or as texts of which the first is an ISO date."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(cells):
        return True
    if pd.api.types.is_numeric_dtype(cells):
        return False
    given = cells.dropna()
    return len(given) > 0 and isinstance(given.iloc[0], str) and _DATE.fullmatch(given.iloc[0]) is not None


def as_seconds(cells: Any, source: str, origin: pd.Timestamp | None = None) -> tuple[Floats, pd.Timestamp]:
    """Return a column of dates as seconds from an instant, and this instant; NaN where a cell is empty or no date.

    Parameters
    ----------
    cells : pandas.Series
        The dates. Those without a time zone count as UTC, so that only differences matter.
    source : str
        The file and the column, for the message to the user.
    origin : pandas.Timestamp, optional
        The instant; by default the whole second of the first date, of which the user is informed.
    """
    import pandas as pd

    texts = (
        cells if pd.api.types.is_datetime64_any_dtype(cells) else cells.astype(str).str.strip().str.replace(",", ".")
    )
    dates = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    if origin is None:
        origin = dates.dropna().iloc[0].floor("s")
        shown = str(origin.tz_localize(None))
        inform(f"The dates in {source} are read as seconds from {shown}.")
    return np.asarray((dates - origin) / pd.Timedelta(1, "s"), dtype=np.float64), origin


__all__ = ["are_dates", "as_seconds"]
