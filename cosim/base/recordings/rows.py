"""The rows of a recording at evenly spaced steps."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.recordings.dates import are_dates
from bayesftc.cosim.base.recordings.intervals import first_step, typical_interval, usual_step
from bayesftc.cosim.base.recordings.local_dates import what_is_wrong
from bayesftc.cosim.base.recordings.table_files import TIMES, find_times, times_in
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import RecordingError, StepSizeError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

Steps = np.ndarray[Any, np.dtype[np.int64]]

MOST_STEPS = 20_000_000
"""Largest number of steps: a longer recording more likely has a wrong unit of time."""

UNEVEN = 0.01
"""Share of a step by which evenly spaced times may differ from a whole number of steps."""

COLLIDING = 0.1
"""Share of rows at the step of a later row from which on there is a warning: jitter of the times makes fewer collide."""


@dataclass(frozen=True, eq=False)
class Rows:
    """At which step each row of a recording is.

    Attributes
    ----------
    step : Fraction
        Seconds between two steps.
    start : float
        Time of the first step, in seconds.
    at : ndarray, rows
        The step of each row; the first one is 0.
    time : str or None
        The column of times.
    """

    step: Fraction
    start: float
    at: Steps
    time: str | None

    def placed(self, values: Floats) -> Floats:
        """Return values of the rows at their steps, NaN elsewhere; the last finite one of each step counts."""
        placed = np.full((int(self.at[-1]) + 1, values.shape[1]), np.nan)
        for j, column in enumerate(values.T):
            there = np.isfinite(column)
            placed[self.at[there], j] = column[there]
        return placed

    def held(self, values: Floats) -> Floats:
        """Return values of the rows at their steps; steps without a row have those of the last row."""
        steps = np.arange(int(self.at[-1]) + 1)
        return np.asarray(self.placed(values)[self.at[np.searchsorted(self.at, steps, side="right") - 1]])


def rows_at_steps(
    table: pd.DataFrame, time: str | None, dt: float | str | Fraction | None, others: Container[str]
) -> Rows:
    """Bring the rows of a recording to steps. Nothing is interpolated: each row goes to the nearest step.

    Without `dt` the times must be evenly spaced, but rows may be missing. With `dt` the times may be uneven. With `dt` and no
    column of times there is a row for each step.

    Parameters
    ----------
    table : pandas.DataFrame
        The recording.
    time : str or None
        The column of times; None for the one that `find_times` finds.
    dt : float, str, Fraction or None
        Seconds between two steps.
    others : container of str
        Columns that are something else.

    Raises
    ------
    StepSizeError
        If `dt` is not positive, or the times are missing, do not increase, or are uneven without `dt`.
    RecordingError
        If a cell among dates is none, or the recording does not fit the step.
    """
    time = time or find_times(table, others)
    if time is None:
        columns = (column for column in table.columns if column not in others)
        unread = {column: wrong for column in columns if (wrong := _unread(table, column))}
        if dt is not None:
            for column, wrong in unread.items():
                warn_user(
                    f"The dates in {column!r} do not count: each row is one step of dt, and gaps are lost. The dates, such as "
                    f"{wrong}."
                )
            return Rows(rational_step(dt), 0.0, np.arange(len(table)), None)
        time = next(iter(unread), None)
    t = _times(table, time, "give dt= in seconds" if dt is None else "leave it out")
    if dt is None:
        step, at = _evenly(t, time)
        return Rows(step, float(t[0]), at, time)
    return Rows(*_nearest(t, rational_step(dt)), time)


def _unread(table: pd.DataFrame, column: str) -> str | None:
    """Return why the dates of a column are not read; None if it has no such dates."""
    return what_is_wrong(table[column]) if list(table.columns).count(column) == 1 else None


def _times(table: pd.DataFrame, time: str | None, otherwise: str) -> Floats:
    """Return the times of the rows in seconds; dates count from the first one. `otherwise` is the other remedy."""
    if time is None or time not in table.columns:
        names = f"column of times: none is called {', '.join(TIMES[:3])}" if time is None else f"column {time!r}"
        raise StepSizeError(
            f"The recording has no {names}; give the name of the column of times (time=...), or dt= in seconds. Its "
            f"columns: {', '.join(map(str, table.columns[:12]))}{', ...' * (len(table.columns) > 12)}."
        )
    single = list(table.columns).count(time) == 1
    if wrong := _unread(table, time):
        raise StepSizeError(f"The dates in {time!r}, such as {wrong}, or {otherwise.replace('dt=', 'only dt=')}.")
    if not single or (table[time].dtype.kind not in "fiu" and not are_dates(table[time])):
        raise StepSizeError(
            f"The column {time!r} does not contain numbers. Convert the times to seconds, or {otherwise}."
        )
    t = times_in(table, time)
    steps = np.diff(t)
    if len(steps) == 0 or not np.isfinite(steps).all() or steps.min() <= 0:
        raise StepSizeError(
            f"The times in {time!r} do not increase from row to row; sort the recording, or {otherwise}."
        )
    return t


def _evenly(t: Floats, time: str | None) -> tuple[Fraction, Steps]:
    """Return the step of times that are evenly spaced except for missing rows, and the step of each row."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    counts = np.rint(steps / usual)
    step = float(t[-1] - t[0]) / float(max(counts.sum(), 1.0))
    if counts.min() < 1 or np.abs(steps - counts * step).max() > UNEVEN * step:
        raise StepSizeError(
            f"The times in {time!r} are not evenly spaced: steps are from {steps.min():g} to {steps.max():g} s. Give "
            f"dt={float(usual_step(t)):.10g}, the usual step in seconds: each row then belongs to the nearest step."
        )
    _refuse_many(float(t[-1] - t[0]), step)
    return Fraction(f"{step:.6g}"), np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _nearest(t: Floats, step: Fraction) -> tuple[Fraction, float, Steps]:
    """Return the step, the time of the first one, and the step of each row."""
    span, interval = float(t[-1] - t[0]), float(step)
    _refuse_many(span, interval)
    if span < interval:
        raise RecordingError(
            f"The recording of {span:g} s is shorter than a step of {interval:g} s. Give a smaller dt."
        )
    start = first_step(t, float(t[0]), interval)
    at = np.asarray(np.rint((t - start) / interval), dtype=np.int64)
    if (share := float(np.mean(np.diff(at) == 0))) > COLLIDING:
        warn_user(
            f"{share:.0%} of the rows are at the step of a later row, whose values count instead: dt is {interval:g} s, and the "
            f"usual time between two rows is {typical_interval(t):.4g} s. Give a smaller dt."
        )
    return step, start, at


def _refuse_many(span: float, step: float) -> None:
    if span / step > MOST_STEPS:
        raise RecordingError(
            f"The recording of {span:g} s has more than {MOST_STEPS:,} steps of {step:g} s. Check the unit of its "
            "times: without one in the name of their column, such as t_ms, they are in seconds."
        )
