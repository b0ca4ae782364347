"""A recording at evenly spaced steps: inputs of an FMU, and the sensors of its outputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from bayesftc.cosim.base.recordings.rows import Steps, rows_at_steps
from bayesftc.cosim.base.recordings.silences import Silence, silences
from bayesftc.cosim.errors import ModelError, RecordingError, brief
from bayesftc.cosim.run.tables import named_columns, read_table
from bayesftc.cosim.types import Floats

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
    silences : tuple of Silence
        Each input's column that has no sample for much longer than usual, although a sensor has.
    """

    step: Fraction
    start: float
    inputs: Mapping[str, Floats]
    sensors: Mapping[str, tuple[str, ...]]
    y: Floats
    unused: tuple[str, ...] = ()
    gaps: tuple[tuple[int, int], ...] = ()
    silences: tuple[Silence, ...] = ()

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
    """Read a recording and bring its rows to steps by `rows_at_steps`; of several rows at a step the last one counts.

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
    rows = rows_at_steps(table, time, dt, named)
    given = {name: rows.placed(table[columns].to_numpy(dtype=np.float64)) for name, columns in into.items()}
    y = rows.placed(table[[c for columns in out.values() for c in columns]].to_numpy(dtype=np.float64))
    unused = tuple(str(column) for column in table.columns if column != rows.time and column not in named)
    held = {name: _held(values, into[name]) for name, values in given.items()}
    samples = Samples(rows.step, rows.start, held, out, y, unused, _gaps(rows.at))
    columns = ((name, values[:, j]) for key, values in given.items() for j, name in enumerate(into[key]))
    t = samples.time
    times = ((name, t[np.isfinite(values)]) for name, values in columns)
    return replace(samples, silences=silences(times, t[np.isfinite(y).any(axis=1)], float(t[-1])))


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


def _gaps(rows: Steps) -> tuple[tuple[int, int], ...]:
    """Return the steps before and after each stretch in which several rows are missing."""
    intervals = np.diff(rows)
    usual = float(np.median(intervals)) if len(intervals) else 0.0
    return tuple((int(rows[k]), int(rows[k + 1])) for k in np.flatnonzero(intervals > LEAST_MISSING * max(usual, 1.0)))


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
