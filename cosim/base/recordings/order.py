"""The order of the times of a recording: rows that are written twice, clocks that are set back, and rows out of order."""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

import numpy as np

from bayesftc.cosim.base.recordings.dates import time_text
from bayesftc.cosim.types import Floats

HOUR = 3600.0
"""Seconds by which clocks are set back at the end of summer."""

ROWS = 2.5
"""Usual intervals by which a jump back may differ from an hour: the next row comes an interval later, or misses one."""

MANY = 20
"""Least number of samples in an hour with which times in seconds show that a clock was set back."""

IN_UTC = 'pd.to_datetime(times).dt.tz_localize("Europe/Berlin", ambiguous="infer").dt.tz_convert("UTC")'
"""The line of pandas for a column of local times in their first order."""


class Once(NamedTuple):
    """Samples without those that repeat the time and the value of the one before, and the times of these."""

    time: Floats
    values: Floats
    repeated: Floats


def without_repeats(time: Floats, values: Floats) -> Once:
    """Return the samples without repetitions: a row that is written twice says nothing new."""
    again = np.concatenate([[False], (np.diff(time) == 0) & (np.diff(values) == 0)])
    return Once(time[~again], values[~again], time[again])


def wrong_order(time: Floats, values: Floats, origin: datetime | None) -> str:
    """Return two sentences on times that do not increase: what is wrong and where, and what to do; empty if they do.

    Parameters
    ----------
    time, values : ndarray
        The samples, without repetitions.
    origin : datetime or None
        The instant of time 0, if the times were dates.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0])
        jump = f"{time_text(time[k + 1], origin)} follows {time_text(time[k], origin)}"
        if _set_back(steps, k, origin):
            return (
                f"A signal's times go back by an hour: {jump}. The clock was probably set back. Write the times in "
                f"UTC or with their offset, as 2026-10-25T02:00:00+01:00. In pandas, with your own column and zone: {IN_UTC}."
            )
        if _written_again(time, values, k):
            return (
                f"A signal's rows are written twice: {jump}, with the same samples as before. Leave out the second ones, in "
                "pandas by table.drop_duplicates()."
            )
        return f"A signal's times do not increase: {jump}. Sort the recording by time."
    same = np.flatnonzero(steps == 0)
    if not len(same):
        return ""
    k, count = int(same[0]), len(np.unique(time[same]))
    where = f"at {time_text(time[k], origin)}: {values[k]:.10g} and {values[k + 1]:.10g}"
    text = f"A signal has different samples {where}"
    text += f" (and so at {count - 1} more times)." if count > 1 else "."
    text += " Keep one row for each time, or write times with more digits if they are rounded."
    if _twice(steps, time[same], origin):
        text += (
            " If this is the hour that comes twice when clocks are set back, write the times in UTC. In pandas, with the rows in "
            f"the order in which they were recorded and your own time zone: {IN_UTC}."
        )
    return text


def _written_again(time: Floats, values: Floats, k: int) -> bool:
    """Return whether all samples after a jump back, up to its time, have stood before it."""
    known = dict(zip(time[: k + 1].tolist(), values[: k + 1].tolist(), strict=True))
    new = time[k + 1 :] > time[k]
    again = slice(k + 1, k + 1 + (int(np.argmax(new)) if new.any() else len(new)))
    return all(known.get(t) == v for t, v in zip(time[again].tolist(), values[again].tolist(), strict=True))


def _set_back(steps: Floats, k: int, origin: datetime | None) -> bool:
    """Return whether a jump back is that of local times when clocks are set back."""
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # Seconds, too, may have been made from local times: if samples are frequent, such a jump is hardly chance.
    local = usual <= HOUR / MANY if origin is None else origin.tzinfo is None
    return local and bool(-HOUR <= steps[k] <= min(ROWS * usual - HOUR, 0.0))


def _twice(steps: Floats, same: Floats, origin: datetime | None) -> bool:
    """Return whether equal times may be the hour that comes twice, in rows that have been sorted, or in hourly ones."""
    if origin is None or origin.tzinfo is not None:
        return False
    return bool(same[-1] - same[0] <= HOUR and (len(np.unique(same)) > 1 or np.median(steps) >= HOUR))


__all__ = ["Once", "without_repeats", "wrong_order"]
