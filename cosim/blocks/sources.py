"""Sources: signals that depend on time alone, and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite, tau
from pathlib import Path

import numpy as np

from bayesftc.cosim.base.numbers import real, reals
from bayesftc.cosim.base.recordings.columns import column_called, column_unit
from bayesftc.cosim.base.recordings.table_files import find_times, read_table_file, times_in
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.tables import place
from bayesftc.cosim.errors import ModelError, RecordingError, brief, did_you_mean
from bayesftc.cosim.ops import select, sin
from bayesftc.cosim.ports import Port

TAU = tau


@dataclass(frozen=True)
class Source(Block):
    """Base of all sources: one scalar output ``y`` with the unit ``unit`` (None fits all units).

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from bayesftc import cosim
    >>> @dataclass(frozen=True)
    ... class Parabola(cosim.Source):
    ...     unit: str | None = None
    ...     def define(self, step):
    ...         def output(t, y):
    ...             y[0] = t * t
    ...         return cosim.Definition(output)
    >>> parabola = Parabola().online(dt=0.5, compiled=False)
    >>> [parabola().y for _ in range(4)]
    [0.0, 0.25, 1.0, 2.25]
    """

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", unit=getattr(self, "unit", None), description="A signal that depends on time alone"),)

    def _check(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            if not isfinite(real(value)):
                raise ModelError(f"{type(self).__name__} has {name}={brief(value)}; it must be a finite number.")


def _constant(value, y):
    y[0] = value[0]


@dataclass(frozen=True)
class Constant(Source):
    """The same ``value`` at all times.

    Parameters
    ----------
    value : float
        Value of the output.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If the value is not finite.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> speed, convert = diagram.add(cosim.Constant(10.0, unit="m/s")), diagram.add(cosim.Gain(3.6, 0.0, "m/s", "km/h"))
    >>> diagram.connect(speed["y"], convert["u"])
    >>> diagram.simulate(0.2, engine="interpreted")["gain.y"].tolist()
    [36.0, 36.0, 36.0]
    """

    value: float = field(metadata={"unit": "{y}"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("value")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_constant, parameters={"value": self.value})


def _step(t, time, before, after, y):
    y[0] = select(t >= time[0], after[0], before[0])


@dataclass(frozen=True)
class Step(Source):
    """`before` until `time` seconds, then `after`.

    Parameters
    ----------
    time : float
        Time in seconds at which the output changes.
    after, before : float
        Value of the output from ``time`` on (``after``), and until then (``before``).
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a setting is not finite.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> step = cosim.Step(time=0.2, after=5.0, before=1.0).online(dt=0.1, compiled=False)
    >>> [step().y for _ in range(4)]
    [1.0, 1.0, 5.0, 5.0]
    """

    time: float = field(metadata={"unit": "s"})
    after: float = field(metadata={"unit": "{y}"})
    before: float = field(default=0.0, metadata={"unit": "{y}"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("time", "after", "before")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_step, parameters={"time": self.time, "before": self.before, "after": self.after})


def _ramp(t, slope, start, offset, y):
    y[0] = offset[0] + slope[0] * select(t > start[0], t - start[0], 0.0)


@dataclass(frozen=True)
class Ramp(Source):
    """`offset` until `start` seconds, then a rise by `slope` each second.

    Parameters
    ----------
    slope : float
        Rise of the output per second.
    offset : float
        Value of the output at the beginning.
    start : float
        Time in seconds at which the output begins to rise.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a setting is not finite.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> ramp = cosim.Ramp(slope=2.0, offset=1.0, start=0.5).online(dt=0.5, compiled=False)
    >>> [ramp().y for _ in range(4)]
    [1.0, 1.0, 2.0, 3.0]
    """

    slope: float = field(metadata={"unit": "{y}/s"})
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    start: float = field(default=0.0, metadata={"unit": "s"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("slope", "offset", "start")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_ramp, parameters={"slope": self.slope, "start": self.start, "offset": self.offset})


def _sine(t, amplitude, period, phase, offset, y):
    y[0] = offset[0] + amplitude[0] * sin(TAU / period[0] * t + phase[0])


@dataclass(frozen=True)
class Sine(Source):
    """``offset + amplitude * sin(2 pi t / period + phase)``.

    Parameters
    ----------
    amplitude : float
        Largest distance of the output from `offset`.
    period : float
        Time from one maximum to the next, in seconds.
    offset : float
        Mean of the output.
    phase : float
        Phase at t = 0, in radians.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a setting is not finite, or the period is not positive.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> sine = cosim.Sine(amplitude=2.0, period=4.0, offset=1.0).online(dt=1.0, compiled=False)
    >>> [round(sine().y, 9) for _ in range(4)]
    [1.0, 3.0, 1.0, -1.0]
    """

    amplitude: float = field(metadata={"unit": "{y}"})
    period: float = field(metadata={"unit": "s"})
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    phase: float = field(default=0.0, metadata={"unit": "rad"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("amplitude", "period", "offset", "phase")
        if self.period <= 0:
            raise ModelError(f"Sine has period={self.period!r}; it must be positive.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        parameters = {
            "amplitude": self.amplitude,
            "period": self.period,
            "phase": self.phase,
            "offset": self.offset,
        }
        return Definition(_sine, parameters=parameters)


def _table(t, times, values, slopes, y):
    i, last = place(times, t), times.shape[0] - 1
    between = select(t >= times[0], values[i] + slopes[i] * (t - times[i]), values[0])
    y[0] = select(t >= times[last], values[last], between)


@dataclass(frozen=True)
class Table(Source):
    """Values at given times: held or linearly interpolated in between, constant outside.

    Parameters
    ----------
    times : sequence of float
        Seconds, strictly rising.
    values : sequence of float
        As many values.
    interpolate : bool
        True for straight lines, False to hold each value until the next.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If times and values are not equally many finite numbers, or the times do not rise.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> profile = cosim.Table(times=[0.0, 1.0, 2.0], values=[0.0, 10.0, 4.0]).online(dt=0.5, compiled=False)
    >>> [profile().y for _ in range(6)]
    [0.0, 5.0, 10.0, 7.0, 4.0, 4.0]
    """

    times: Sequence[float] = field(metadata={"unit": "s"})
    values: Sequence[float] = field(metadata={"unit": "{y}"})
    interpolate: bool = True
    unit: str | None = None

    def __post_init__(self) -> None:
        times, values = reals(self.times), reals(self.values)
        if times.ndim != 1 or times.shape != values.shape or not len(times):
            raise ModelError(
                f"Table needs as many times as values, at least one; it has {times.shape} and {values.shape}."
            )
        if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) > 0).all()):
            raise ModelError(
                "Table needs finite values at strictly rising times; sort the data and drop missing values."
            )
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "values", tuple(values.tolist()))

    @classmethod
    def read(
        cls,
        file: str | Path,
        column: str,
        *,
        time: str | None = None,
        interpolate: bool = True,
        unit: str | None = None,
    ) -> Table:
        """Return the signal in a column of a CSV or Parquet file; rows without a sample are left out.

        Parameters
        ----------
        file : str or Path
            The file; one that ends in ``.parquet`` is read as such, every other as CSV with a header.
        column : str
            Name of the column; a unit in brackets at its end may be left out, as ``"T"`` for ``T [degC]``.
        time : str, optional
            Name of the column of times, in seconds or in the unit that ends its name, as in ``t_ms`` or ``t [min]``; by default
            a column that is called t, time or timestamp, also with a unit, else the first one with dates (ISO 8601).
        interpolate
            As of the class.
        unit : str, optional
            Unit of the output; by default the one in brackets at the end of the column's name, if there is one.

        Raises
        ------
        RecordingError
            If the file cannot be read, has no such column, or has text in one of them.
        ModelError
            If no sample is left, or the times do not rise.
        """
        import pandas as pd

        table = read_table_file(file)
        columns = list(map(str, table.columns))
        column = column_called(column, columns) or column
        time = time or find_times(table, (column,)) or "time"
        for name in (time, column):
            if name not in table:
                raise RecordingError(f"{file} has no column {name!r}; {did_you_mean(name, columns)}")
        try:
            rows = pd.DataFrame({"t": times_in(table, time), "y": table[column].astype(float)}).dropna()
        except RecordingError as error:
            raise RecordingError(f"{file}: {error}") from None
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{file} has text in {time!r} or {column!r}: {error}.") from None
        return cls(rows["t"].tolist(), rows["y"].tolist(), interpolate, unit or column_unit(column) or None)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        times, values = np.array(self.times), np.array(self.values)
        slopes = np.zeros(len(times))
        if self.interpolate and len(times) > 1:
            slopes[:-1] = np.diff(values) / np.diff(times)
        return Definition(_table, parameters={"times": times, "values": values, "slopes": slopes})


def _gaussian(noise, std, mean, y):
    for i in range(y.shape[0]):
        y[i] = mean[i] + std[i] * noise[i]


@dataclass(frozen=True)
class Gaussian(Block):
    """White Gaussian noise: independent numbers at every step.

    Parameters
    ----------
    std : float or sequence of float
        Standard deviation of each step's number; a sequence gives as many channels.
    mean : float
        Mean of every channel.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a setting is not finite, or a standard deviation is negative.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=(1.0, 10.0), mean=5.0), "noise")
    >>> values = diagram.simulate(200.0, seed=1)["noise.y"]  # a row for each step, a column for each channel
    >>> values.mean(axis=0).round(1).tolist(), values.std(axis=0).round(1).tolist()
    ([5.0, 4.9], [1.0, 10.2])
    """

    std: float | Sequence[float] = field(metadata={"unit": "{y}"})
    mean: float = field(default=0.0, metadata={"unit": "{y}"})
    unit: str | None = None

    def __post_init__(self) -> None:
        std = reals(self.std)
        if (
            std.ndim > 1
            or not std.size
            or not np.isfinite(std).all()
            or (std < 0).any()
            or not isfinite(real(self.mean))
        ):
            raise ModelError(
                f"Gaussian has std={brief(self.std)}, mean={brief(self.mean)}; they must be finite and std not negative."
            )
        object.__setattr__(self, "std", tuple(std.tolist()) if std.ndim else float(std))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the output: scalar for a single standard deviation."""
        return (len(self.std),) if isinstance(self.std, tuple) else ()

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Random input ``noise``."""
        return (Port("noise", self.shape, draw="normal"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", self.shape, unit=self.unit, description="Independent normal numbers at each step"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        std = np.atleast_1d(np.asarray(self.std, float))
        return Definition(_gaussian, parameters={"std": std, "mean": np.full(len(std), self.mean)})


__all__ = ["Constant", "Gaussian", "Ramp", "Sine", "Source", "Step", "Table"]
