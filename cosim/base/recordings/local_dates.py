"""Dates in other forms, as in ``28.03.2026 08:00:00``, ``3/28/26 8:00 AM`` and ``2026/3/28 8:00``: they become ISO 8601.

With points between the numbers, the day is first. With other signs a column must show which of the two it is.
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
    r"\s*(?P<first>\d{1,2})(?P<sign>[./-])(?P<second>\d{1,2})(?P=sign)(?P<year>\d{4}|(?<=[./])\d{2})"
    rf"(?:[T, ]+{CLOCK})?\s*"
)

_YEAR_FIRST = (
    rf"\s*(?P<year>\d{{4}})(?P<sign>[./-])(?P<first>\d{{1,2}})(?P=sign)(?P<second>\d{{1,2}})(?:[T, ]+{CLOCK})?\s*"
)

_MONTHS, _DAYS, _NOON, _LAST_HOUR = 12, 31, 12, 24

_CENTURY, _FIRST_YEAR = 100, 69
"""Years with two digits are from 1969 to 2068, as POSIX has it."""


def with_iso_dates(cells: pd.Series[Any], source: str) -> pd.Series[Any]:
    """Return a column with its dates in the form of ISO 8601, and inform the user, if they have another one; else the column.

    The year is first, or last; with two digits it is from 1969 to 2068. If it is last: where a date such as 28/03/2026 is among
    them, the first number of all is the day; where one such as 03/28/2026 is, the month. Else the day is first where points
    separate the numbers, as in 01.03.2026. Where all of them could be read in several ways, as 01/03/2026 can, or a text is no
    such date, nothing changes. So can 28.03.26 alone, which may be a day of 2028: there must be more days than years, or a year
    that is no day.

    Parameters
    ----------
    cells : pandas.Series
        Any column.
    source : str
        The column and the file, for the message to the user.
    """
    import pandas as pd

    given = other_date(cells)
    form = next((form for form in (_YEAR_LAST, _YEAR_FIRST) if given is not None and re.fullmatch(form, given)), None)
    if form is None:
        return cells
    texts = cells.dropna().astype(str)
    parts = texts.str.extract(f"^{form}$")
    first, second, year = (pd.to_numeric(parts[name], errors="coerce") for name in ("first", "second", "year"))
    clock = clock_of_day(parts)
    if clock is None or first.isna().any() or min(first.max(), second.max()) > _MONTHS:
        return cells
    undecided = max(first.max(), second.max()) <= _MONTHS
    if form is _YEAR_LAST and undecided and not (parts["sign"] == ".").all():
        return cells
    day_first = first.max() > _MONTHS or (form is _YEAR_LAST and undecided)
    which, day, month = ("day", "first", "second") if day_first else ("month", "second", "first")
    if which == "day" and year.between(1, _DAYS).all() and first.nunique() <= year.nunique():  # the year may be first
        return cells
    dates = _whole(year).astype(str) + "-" + parts[month].str.zfill(2) + "-" + parts[day].str.zfill(2)
    which = "year" if form is _YEAR_FIRST else which
    written: pd.Series[Any] = (dates + clock.where(clock == "", " " + clock)).reindex(cells.index)
    inform(f"The dates in {source} have the {which} first: {given} is read as {written.loc[texts.index[0]]}.")
    return written


def clock_of_day(parts: pd.DataFrame) -> pd.Series[Any] | None:
    """Return times of the day from 00:00 to 23:59 from the parts of `CLOCK`; None if there is one such as 13:00 AM or 25:00.

    An empty text stands for none. The hour 13 with PM, as some loggers write it, is 13.
    """
    import pandas as pd

    hours, half = pd.to_numeric(parts["hour"], errors="coerce"), parts["half"].str.lower()
    if (hours > half.map({"a": _NOON}).fillna(_LAST_HOUR)).any():
        return None
    hours = hours.mask(half.notna(), hours % _NOON + _NOON * (half == "p"))
    written = hours.map(lambda hour: "" if hour != hour else f"{hour:02.0f}").astype(str)
    times: pd.Series[Any] = written + parts["rest"].fillna("").astype(str).str.replace(",", ".")
    return times


def _whole(year: Any) -> Any:
    """Return years with four digits; `year` is a number or has some."""
    return year + (year < _CENTURY) * (1900 + _CENTURY * (year < _FIRST_YEAR))


def day_first_date(text: str) -> str | None:
    """Return a date as ISO 8601 if its day stands first: the numbers have points between them, or the first is above 12."""
    found = re.fullmatch(_YEAR_LAST, text)
    if found is None or found["half"] or (found["sign"] != "." and int(found["first"]) <= _MONTHS):
        return None
    date = f"{_whole(int(found['year']))}-{found['second']:0>2}-{found['first']:0>2}"
    return f"{date} {found['hour']:0>2}{found['rest'].replace(',', '.')}" if found["hour"] else date


def iso_of(date: str) -> str:
    """Return a date of another form as ISO 8601, as an example for messages; a date of our own if it can be read in two ways."""
    import pandas as pd

    numbers = re.match(r"\s*(\d{1,2})([./-])(\d{1,2})[./-]\d{4}", date)
    if numbers is None or (numbers[2] != "." and max(int(numbers[1]), int(numbers[3])) <= _MONTHS):
        return ISO
    try:
        return f"{pd.to_datetime(date, dayfirst=int(numbers[3]) <= _MONTHS):%Y-%m-%d %H:%M:%S}"
    except ValueError:
        return ISO


def what_is_wrong(cells: pd.Series[Any]) -> str | None:
    """Return why the dates of a column are not read, and what to do; None if it has no dates of another form than ISO 8601.

    It is the end of a sentence that begins with "The dates in 'Zeit', such as ", and one that can go on.
    """
    date = other_date(cells)
    if date is None:
        return None
    parts = cells.dropna().astype(str).str.extract(f"^{_YEAR_LAST}$")
    undecided = parts[["first", "second"]].apply(lambda numbers: numbers.astype(float) <= _MONTHS).all(axis=None)
    why, how = "", ""
    if undecided and (parts["sign"] != ".").any():
        why = ", and no number above 12 shows whether the day or the month is first"
        how = " and its dayfirst"
    remedy = f"Write them as {iso_of(date)}, for example with pandas.to_datetime{how}"
    return f"{date!r}, are not in the form of ISO 8601{why}. {remedy}"


__all__ = ["CLOCK", "clock_of_day", "day_first_date", "iso_of", "what_is_wrong", "with_iso_dates"]
