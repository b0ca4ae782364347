"""Dates with the day or the month first, as in ``28.03.2026 08:00:00`` and ``3/28/2026 8:00 AM``: they become ISO 8601.

Only where a column shows which of the two is first.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.recordings.dates import ISO, other_date

if TYPE_CHECKING:
    import pandas as pd

CLOCK = r"(?P<hour>\d{1,2})(?P<rest>:\d{2}(?::\d{2}(?:[.,]\d+)?)?)(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
"""A time of the day, with AM or PM or without."""

_YEAR_LAST = (
    r"\s*(?P<first>\d{1,2})(?P<sign>[./-])(?P<second>\d{1,2})(?P=sign)(?P<year>\d{4})" rf"(?:[T, ]+{CLOCK})?\s*"
)

_MONTHS = 12


def with_iso_dates(cells: pd.Series[Any], source: str) -> pd.Series[Any]:
    """Return a column with its dates in the form of ISO 8601, and inform the user, if day or month stand first; else the column.

    Where a date such as 28.03.2026 is among them, the first number of all is the day; where one such as 03/28/2026 is, the month.
    Where all of them could be read in both ways, as 01.03.2026 can, or a text is no such date, nothing changes.

    Parameters
    ----------
    cells : pandas.Series
        Any column.
    source : str
        The column and the file, for the message to the user.
    """
    import pandas as pd

    given = other_date(cells)
    if given is None or re.fullmatch(_YEAR_LAST, given) is None:
        return cells
    texts = cells.dropna().astype(str)
    parts = texts.str.extract(f"^{_YEAR_LAST}$")
    first, second = (pd.to_numeric(parts[name], errors="coerce") for name in ("first", "second"))
    if first.isna().any() or min(first.max(), second.max()) > _MONTHS or max(first.max(), second.max()) <= _MONTHS:
        return cells
    which, day, month = ("day", "first", "second") if first.max() > _MONTHS else ("month", "second", "first")
    dates = parts["year"] + "-" + parts[month].str.zfill(2) + "-" + parts[day].str.zfill(2)
    clock = clock_of_day(parts)
    written = (dates + clock.where(clock == "", " " + clock)).reindex(cells.index)
    inform(f"The dates in {source} have the {which} first: {given} is read as {written.loc[texts.index[0]]}.")
    return written


def clock_of_day(parts: pd.DataFrame) -> pd.Series[Any]:
    """Return times of the day from 00:00 to 23:59 from the parts of `CLOCK`; an empty text where there are none."""
    import pandas as pd

    hours, half = pd.to_numeric(parts["hour"], errors="coerce"), parts["half"].str.lower()
    twelve = half.notna()
    hours = hours.mask(twelve, hours % 12 + 12 * (half == "p"))
    written = hours.map(lambda hour: "" if hour != hour else f"{hour:02.0f}").astype(str)
    return written + parts["rest"].fillna("").astype(str).str.replace(",", ".")


def day_first_date(text: str) -> str | None:
    """Return a date as ISO 8601 if its day stands first: the numbers have points between them, or the first is above 12."""
    found = re.fullmatch(_YEAR_LAST, text)
    if found is None or found["half"] or (found["sign"] != "." and int(found["first"]) <= _MONTHS):
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


__all__ = ["CLOCK", "clock_of_day", "day_first_date", "iso_of", "with_iso_dates"]
