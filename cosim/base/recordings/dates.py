"""Dates as times: a column of ISO 8601 dates becomes seconds, and seconds become dates again in texts."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

LONG = 600.0
"""Seconds between two dates beyond which their texts have no decimals."""

_DATE = re.compile(r"\s*\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?)?\s*(Z|[+-]\d{2}:?\d{2})?\s*")

_OTHER_DATE = re.compile(
    r"(\d{1,2}|\d{4})([./-])(\d{1,2}|[^\W\d_]{3,9})\2(\d{4}|\d{1,2})"
    r"([T, ]+\d{1,2}[:.]\d{2}([:.]\d{2}([.,:]\d+)?)?( ?[A-Za-z][A-Za-z. ]{0,5}| ?[+-]\d{2}:?\d{2})?)?"
)

_LOOKED_AT = 1000
"""About how many cells, spread over a column, show whether most of them are dates."""

ISO = "2026-03-28 08:00:00"
"""A date, as an example for messages."""


def are_dates(cells: Any) -> bool:
    """Return whether a column has dates: as dates of pandas, or as texts of which the first is an ISO date."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(cells):
        return True
    if pd.api.types.is_numeric_dtype(cells):
        return False
    given = cells.dropna()
    return len(given) > 0 and isinstance(given.iloc[0], str) and _DATE.fullmatch(given.iloc[0]) is not None


def other_date(cells: Any) -> str | None:
    """Return the first date of a column if most of its texts are dates in another form than ISO 8601.

    Such a form is ``28.03.2026 08:00:00``. The year has four digits, or two at the end of the date.
    """
    import pandas as pd

    if pd.api.types.is_numeric_dtype(cells) or pd.api.types.is_datetime64_any_dtype(cells):
        return None
    given = cells.dropna()
    if are_dates(given):
        return None
    texts = [str(cell).strip() for cell in given.iloc[:: max(len(given) // _LOOKED_AT, 1)]]
    dates = [text for text in texts if _is_other_date(text)]
    return dates[0] if 2 * len(dates) > len(texts) else None


def _is_other_date(text: str) -> bool:
    """Return whether a text is a date in another form than ISO 8601, with a day and a month that there are."""
    found = _OTHER_DATE.fullmatch(text)
    if found is None or _DATE.fullmatch(text):
        return False
    first, middle, last = found[1], found[3], found[4]
    year_first = len(first) == 4
    year, other = (first, last) if year_first else (last, first)
    if len(year) < 2 or (year_first and len(last) == 4):
        return False
    if not middle.isdecimal():
        return 1 <= int(other) <= 31
    month, day = sorted((int(other), int(middle)))
    return 1 <= month <= 12 and day <= 31


def as_seconds(cells: Any, source: str, origin: pd.Timestamp | None = None) -> tuple[Floats, pd.Timestamp]:
    """Return a column of dates as seconds from an instant, and this instant; NaN where a cell is empty or no date.

    Parameters
    ----------
    cells : pandas.Series
        The dates. Those without a time zone count as UTC, so that only differences matter.
    source : str
        The file and the column, for the message to the user.
    origin : pandas.Timestamp, optional
        The instant; by default the whole second of the first date, of which the user is informed. It has the first date's
        difference from UTC, if any.
    """
    import pandas as pd

    texts = (
        cells if pd.api.types.is_datetime64_any_dtype(cells) else cells.astype(str).str.strip().str.replace(",", ".")
    )
    dates = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    if origin is None:
        first = int(np.argmax(dates.notna()))
        offset = pd.Timestamp(texts.iloc[first]).utcoffset()
        origin = dates.iloc[first].floor("s").tz_convert(None if offset is None else timezone(offset))
        inform(f"The dates in {source} are read as seconds from {origin.tz_localize(None)}.")
    instant = origin.tz_localize("UTC") if origin.tz is None else origin
    return np.asarray((dates - instant) / pd.Timedelta(1, "s"), dtype=np.float64), origin


def epoch_seconds(seconds: Floats, source: str, origin: pd.Timestamp | None = None) -> tuple[Floats, pd.Timestamp]:
    """Return times that count from 1970 as seconds from an instant, and this instant, as `as_seconds` does for dates.

    Parameters
    ----------
    seconds : ndarray
        Seconds since 1970.
    source : str
        The file and the column, for the message to the user.
    origin : pandas.Timestamp, optional
        The instant; by default 1970, of which the user is informed. The seconds then are as in the file.
    """
    import pandas as pd

    epoch = pd.Timestamp(0, tz="UTC")
    if origin is not None:
        instant = origin.tz_localize("UTC") if origin.tz is None else origin
        return np.asarray(seconds - (instant - epoch) / pd.Timedelta(1, "s")), origin
    first = _text(date_at(epoch.to_pydatetime(), float(np.nanmin(seconds))), 0)
    inform(f"The times in {source} count from 1970 in UTC, by their size: the first one is {first}.")
    return seconds, epoch


def date_at(origin: datetime, seconds: float) -> datetime:
    """Return the date that is some seconds after an instant, to the microsecond."""
    return origin + timedelta(microseconds=round(seconds * 1e6))


def time_text(seconds: float, origin: datetime | None, digits: int | None = None) -> str:
    """Return a time as text: seconds, or a date. By default a date has no more decimals than necessary, at most three."""
    if origin is None:
        return f"{seconds:g} s" if digits is None else f"{seconds:.{digits}f} s"
    return _text(date_at(origin, seconds), digits)


def span_text(start: float, end: float, origin: datetime | None, digits: int | None = None) -> str:
    """Return two times as text, as ``0 to 59.9 s``, or two dates; the second one has no day if it is that of the first.

    By default dates that are more than `LONG` seconds apart have no decimals.
    """
    if origin is None:
        if digits is None and end > start:  # as many as make a ten-thousandth of the span visible
            digits = 4 - int(f"{end - start:e}".partition("e")[2])
            start, end = round(start, digits) + 0.0, round(end, digits)
            return f"{start:.10g} to {end:.10g} s"
        return f"{start:g} to {end:g} s" if digits is None else f"{start:.{digits}f} to {end:.{digits}f} s"
    digits = 0 if digits is None and end - start > LONG else digits
    first, last = (time_text(seconds, origin, digits) for seconds in (start, end))
    return f"{first} to {last.removeprefix(first[: len('2026-01-01 ')])}"


def _text(date: datetime, digits: int | None) -> str:
    kept = 3 if digits is None else digits
    unit = 10 ** (6 - kept)
    date += timedelta(microseconds=round(date.microsecond / unit) * unit - date.microsecond)
    decimals = f"{date.microsecond:06}"[:kept]
    decimals = decimals.rstrip("0") if digits is None else decimals
    return date.strftime("%Y-%m-%d %H:%M:%S") + (f".{decimals}" if decimals else "")


def seconds_of(moment: datetime, origin: datetime) -> float:
    """Return the seconds from an instant to a date; without a time zone the date has that of the instant."""
    if origin.tzinfo is not None and moment.tzinfo is None:
        moment = moment.replace(tzinfo=origin.tzinfo)
    return (moment - origin) / timedelta(seconds=1)


__all__ = [
    "ISO",
    "are_dates",
    "as_seconds",
    "date_at",
    "epoch_seconds",
    "other_date",
    "seconds_of",
    "span_text",
    "time_text",
]
