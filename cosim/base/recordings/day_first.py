"""Dates with the day first, as in ``28.03.2026 08:00:00``: they become ISO 8601 where a column shows that the day is first."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.recordings.dates import ISO, other_date

if TYPE_CHECKING:
    import pandas as pd

_DAY_MONTH_YEAR = (
    r"\s*(?P<first>\d{1,2})(?P<sign>[./-])(?P<second>\d{1,2})(?P=sign)(?P<year>\d{4})"
    r"(?:[T, ]+(?P<hour>\d{1,2})(?P<rest>:\d{2}(?::\d{2}(?:[.,]\d+)?)?))?\s*"
)

_MONTHS = 12


def with_iso_dates(cells: pd.Series[Any], source: str) -> pd.Series[Any]:
    """Return a column with its dates in the form of ISO 8601, and inform the user, if their days stand first; else the column.

    Where a date such as 28.03.2026 is among them, the first number of all is the day. Where all of them could be read in both
    ways, as 01.03.2026 can, or a text is no such date, nothing changes.

    Parameters
    ----------
    cells : pandas.Series
        Any column.
    source : str
        The column and the file, for the message to the user.
    """
    import pandas as pd

    given = other_date(cells)
    if given is None or re.fullmatch(_DAY_MONTH_YEAR, given) is None:
        return cells
    texts = cells.dropna().astype(str)
    parts = texts.str.extract(f"^{_DAY_MONTH_YEAR}$")
    days, months = (pd.to_numeric(parts[name], errors="coerce") for name in ("first", "second"))
    if days.isna().any() or days.max() <= _MONTHS or months.max() > _MONTHS:
        return cells
    dates = parts["year"] + "-" + parts["second"].str.zfill(2) + "-" + parts["first"].str.zfill(2)
    times = " " + parts["hour"].str.zfill(2) + parts["rest"].str.replace(",", ".")
    written = (dates + times.fillna("")).reindex(cells.index)
    inform(f"The dates in {source} have the day first: {given} is read as {written.loc[texts.index[0]]}.")
    return written


def day_first_date(text: str) -> str | None:
    """Return a date as ISO 8601 if its day stands first: the numbers have points between them, or the first is above 12."""
    found = re.fullmatch(_DAY_MONTH_YEAR, text)
    if found is None or (found["sign"] != "." and int(found["first"]) <= _MONTHS):
        return None
    date = f"{found['year']}-{found['second']:0>2}-{found['first']:0>2}"
    return f"{date} {found['hour']:0>2}{found['rest'].replace(',', '.')}" if found["hour"] else date


def iso_of(date: str) -> str:
    """Return a date of another form as ISO 8601, as an example for messages; a date of our own if it can be read in two ways."""
    import pandas as pd

    numbers = re.match(r"\s*(\d{1,2})[./-](\d{1,2})[./-]\d{4}", date)
    if numbers is None or max(map(int, numbers.groups())) <= _MONTHS:
        return ISO
    try:
        return f"{pd.to_datetime(date, dayfirst=int(numbers[1]) > _MONTHS):%Y-%m-%d %H:%M:%S}"
    except ValueError:
        return ISO


__all__ = ["day_first_date", "iso_of", "with_iso_dates"]
