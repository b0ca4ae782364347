"""A recording at evenly spaced steps: inputs of an FMU, and the sensors of its outputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from bayesftc.cosim.base.recordings.dates import other_date
from bayesftc.cosim.base.recordings.local_dates import what_is_wrong
from bayesftc.cosim.base.recordings.table_files import find_times
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import ModelError, RecordingError, brief
from bayesftc.cosim.run.tables import named_columns, read_table, sample_time, times_of
from bayesftc.cosim.types import Floats

MOST_STEPS = 20_000_000
"""Largest number of steps: a longer recording more likely has a wrong unit of time."""

UNEVEN = 0.01
"""Share of a step by which evenly spaced times may differ from a whole number of steps."""

LEAST_MISSING = 4
"""Usual intervals without a row from which on there is a gap: over fewer, inputs that keep their values hardly matter."""

Columns = str | Sequence[str] | Mapping[str, str | Sequence[str]]
"""Variables of an FMU with their columns; a variable alone has the column of its name."""


@dataclass(frozen=True, eq=False)
class Samples:
    """A recording, a row for each step.

    Attributes
    ----------
    step : Fraction
        Seconds between two steps.
    start : float
        Time of the first step in the recording, in seconds.
    inputs : mapping of str to ndarray, steps x columns
        Values of each input, held until the next sample.
    sensors : mapping of str to tuple of str
        The columns of each output.
    y : ndarray, steps x sensors
        Samples of all sensors, in this order; NaN where there is none.
    unused : tuple of str
        Columns that are neither times nor named among the inputs and outputs.
    gaps : tuple of (int, int)
        The last step before each gap, in which there is no row, and the first one after it.
    """

    step: Fraction
    start: float
    inputs: Mapping[str, Floats]
    sensors: Mapping[str, tuple[str, ...]]
    y: Floats
    unused: tuple[str, ...] = ()
    gaps: tuple[tuple[int, int], ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all sensors."""
        return tuple(name for names in self.sensors.values() for name in names)

    @property
    def output_of(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """For each sensor, the number of its output."""
        return np.repeat(np.arange(len(self.sensors)), [len(names) for names in self.sensors.values()])

    @property
    def time(self) -> Floats:
        """Times of the steps in the recording, in seconds."""
        return np.asarray(self.start + np.arange(len(self.y)) * float(self.step), dtype=np.float64)


def sample(
    recording: Any, inputs: Columns, outputs: Columns, time: str | None, dt: float | str | Fraction | None
) -> Samples:
    """Read a recording and bring its rows to steps. Nothing is interpolated: each row goes to the nearest step.

    Without `dt` the times must be evenly spaced, but rows may be missing. With `dt` the times may be uneven, and of several rows
    at a step the last one counts. With `dt` and no column of times there is a row for each step.

    Raises
    ------
    RecordingError, ModelError, UnknownNameError, StepSizeError
        If the recording cannot be used.
    """
    table = read_table(recording, "fit()")
    read, sensed = _by_variable(inputs, "inputs"), _by_variable(outputs, "outputs")
    if not sensed:
        raise ModelError("fit() has no outputs; name at least one output of the FMU, with its columns.")
    into = {name: named_columns(table, columns, "input") for name, columns in read.items()}
    out = {name: tuple(named_columns(table, columns, "output")) for name, columns in sensed.items()}
    _refuse_twice([column for columns in out.values() for column in columns])
    named = {column for columns in (*into.values(), *out.values()) for column in columns}
    time = time or find_times(table, named)
    rows, start = np.arange(len(table)), 0.0
    if dt is not None and time not in table.columns:
        step = rational_step(dt)
        _warn_of_dates(table, named)
    else:
        time = time or next((column for column in table.columns if _has_other_dates(table, column)), None)
        t = times_of(table, time)
        step = _usual_step(t) or sample_time(table, time, None) if dt is None else rational_step(dt)
        start, rows = float(t[0]), _nearest(t, step)
    steps = int(rows[-1]) + 1
    given = {name: _at(rows, steps, table[columns].to_numpy(dtype=np.float64)) for name, columns in into.items()}
    y = _at(rows, steps, table[[c for columns in out.values() for c in columns]].to_numpy(dtype=np.float64))
    unused = tuple(str(column) for column in table.columns if column != time and column not in named)
    return Samples(step, start, {n: _held(values, into[n]) for n, values in given.items()}, out, y, unused, _gaps(rows))


def _by_variable(given: Columns, what: str) -> dict[str, list[str]]:
    if isinstance(given, str):
        given = [given]
    if not isinstance(given, Mapping):
        given = {name: name for name in given}
    found = {}
    for name, columns in given.items():
        found[name] = (
            [columns] if isinstance(columns, str) else list(columns) if isinstance(columns, Iterable) else [columns]
        )
        if not all(isinstance(text, str) for text in (name, *found[name])):
            raise ModelError(f"fit() has {what}={brief(given)}; give names of variables with names of columns.")
    if what == "outputs":
        _refuse_twice([column for columns in found.values() for column in columns])
    return found


def _refuse_twice(columns: Sequence[str]) -> None:
    """Refuse a column that is given for the outputs twice."""
    for column in columns:
        if columns.count(column) > 1:
            raise ModelError(f"The column {column!r} is given for the outputs twice; give each column once.")


def _has_other_dates(table: Any, column: str) -> bool:
    return list(table.columns).count(column) == 1 and other_date(table[column]) is not None


def _warn_of_dates(table: Any, named: set[str]) -> None:
    """Warn of a column of dates that cannot be read, and so does not count."""
    for column in table.columns:
        if column not in named and _has_other_dates(table, column):
            warn_user(
                f"The dates in {column!r} do not count: each row is one step of dt, and gaps are lost. The dates, such as "
                f"{what_is_wrong(table[column])}."
            )


def _usual_step(t: Floats) -> Fraction | None:
    """Return the step of times that are evenly spaced except for missing rows; None for any others."""
    steps = np.diff(t)
    counts = np.rint(steps / np.median(steps))
    step = float(t[-1] - t[0]) / float(counts.sum())
    even = np.abs(steps - counts * step).max() <= UNEVEN * step
    return Fraction(f"{step:.6g}") if even and counts.min() == 1 < counts.max() else None


def _nearest(t: Floats, step: Fraction) -> np.ndarray[Any, np.dtype[np.int64]]:
    span = float(t[-1] - t[0])
    if span / float(step) > MOST_STEPS:
        raise RecordingError(
            f"The recording of {span:g} s has more than {MOST_STEPS:,} steps of {float(step):g} s. Check the unit of its "
            "times: without one in the name of their column, such as t_ms, they are in seconds."
        )
    if span < float(step):
        raise RecordingError(
            f"The recording of {span:g} s is shorter than a step of {float(step):g} s. Give a smaller dt."
        )
    return np.asarray(np.rint((t - t[0]) / float(step)), dtype=np.int64)


def _gaps(rows: np.ndarray[Any, np.dtype[np.int64]]) -> tuple[tuple[int, int], ...]:
    """Return the steps before and after each stretch in which several rows are missing."""
    intervals = np.diff(rows)
    usual = float(np.median(intervals)) if len(intervals) else 0.0
    return tuple((int(rows[k]), int(rows[k + 1])) for k in np.flatnonzero(intervals > LEAST_MISSING * max(usual, 1.0)))


def _at(rows: np.ndarray[Any, np.dtype[np.int64]], steps: int, values: Floats) -> Floats:
    """Return the values at their steps, NaN elsewhere; the last finite one of each step counts."""
    placed = np.full((steps, values.shape[1]), np.nan)
    for j, column in enumerate(values.T):
        there = np.isfinite(column)
        placed[rows[there], j] = column[there]
    return placed


def _held(values: Floats, names: Sequence[str]) -> Floats:
    """Return inputs that keep their last value where there is no sample."""
    there = np.isfinite(values)
    for name, column in zip(names, there.T, strict=True):
        if not column[0]:
            raise RecordingError(
                f"The input {name!r} has no value in the first row, so that the run cannot begin. Remove the rows before its "
                "first value."
            )
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], 0), axis=0)
    return np.take_along_axis(values, last, axis=0)
