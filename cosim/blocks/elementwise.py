"""Blocks that change each element of a signal by itself: magnitude, sign, dead zone, quantizer, polynomial, table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite

import numpy as np

from bayesftc.cosim.base.numbers import real, reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import absolute, floor, isnan, select
from bayesftc.cosim.ports import Port


class Elementwise(Block):
    """Base of blocks with an input ``u`` and an output ``y`` of `size` elements each; a missing sample (NaN) stays missing."""

    size: int

    def _check(self, *names: str, above: float = -np.inf) -> None:
        """Check the size, and that settings are finite numbers above a bound."""
        size = self.size
        if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
            raise ModelError(f"{type(self).__name__} has size={size!r}; it must be a whole number, at least 1.")
        for name in names:
            value = real(getattr(self, name))
            if not (isfinite(value) and value > above):
                bound = f" above {above:g}" if isfinite(above) else ""
                raise ModelError(
                    f"{type(self).__name__} has {name}={brief(getattr(self, name))}; it must be a finite number{bound}."
                )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of input and output: scalar for a single element."""
        return () if self.size == 1 else (int(self.size),)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return (Port("u", self.shape, description="What comes in"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", self.shape, description=(type(self).__doc__ or "y").partition("\n")[0].strip(".")),)


class SameUnit(Elementwise):
    """Base of those whose output has the unit of the input."""

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y")


def _abs(u, y):
    for i in range(y.shape[0]):
        y[i] = absolute(u[i])


@dataclass(frozen=True)
class Abs(SameUnit):
    """Magnitude of each element.

    Parameters
    ----------
    size : int
        Number of elements.
    """

    size: int = 1

    def __post_init__(self) -> None:
        self._check()

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_abs)


def _sign(u, y):
    for i in range(y.shape[0]):
        y[i] = select(isnan(u[i]), u[i], select(u[i] > 0.0, 1.0, select(u[i] < 0.0, -1.0, 0.0)))


@dataclass(frozen=True)
class Sign(Elementwise):
    """1 for positive elements, -1 for negative ones, 0 for zero.

    Parameters
    ----------
    size : int
        Number of elements.
    """

    size: int = 1

    def __post_init__(self) -> None:
        self._check()

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_sign)


def _dead_zone(u, low, high, y):
    for i in range(y.shape[0]):
        beyond = select(u[i] > high[0], u[i] - high[0], select(u[i] < low[0], u[i] - low[0], 0.0))
        y[i] = select(isnan(u[i]), u[i], beyond)


@dataclass(frozen=True)
class DeadZone(SameUnit):
    """Zero between `low` and `high`, beyond them the distance to the nearer one.

    Parameters
    ----------
    low, high : float
        Limits of the zone.
    size : int
        Number of elements.
    """

    low: float = field(metadata={"unit": "{u}"})
    high: float = field(metadata={"unit": "{u}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("low", "high")
        if self.low > self.high:
            raise ModelError(f"DeadZone has low={self.low!r} and high={self.high!r}; low must not lie above high.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_dead_zone, parameters={"low": self.low, "high": self.high})


def _quantizer(u, interval, y):
    for i in range(y.shape[0]):
        y[i] = interval[0] * floor(u[i] / interval[0] + 0.5)


@dataclass(frozen=True)
class Quantizer(SameUnit):
    """The nearest multiple of `interval`; the upper one halfway between two.

    Parameters
    ----------
    interval : float
        Distance of two neighbours.
    size : int
        Number of elements.
    """

    interval: float = field(metadata={"unit": "{u}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("interval", above=0.0)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_quantizer, parameters={"interval": self.interval})


def _polynomial(u, coefficients, y):
    for i in range(y.shape[0]):
        value = coefficients[0]
        for j in range(1, coefficients.shape[0]):
            value = value * u[i] + coefficients[j]
        y[i] = select(isnan(u[i]), u[i], value)


def _finite(owner: Block, name: str, least: int) -> tuple[float, ...]:
    """Return a setting as a tuple of at least so many finite numbers."""
    values = reals(getattr(owner, name))
    if values.ndim != 1 or len(values) < least or not np.isfinite(values).all():
        raise ModelError(
            f"{type(owner).__name__} has {name}={brief(getattr(owner, name))}; give at least {least} finite numbers."
        )
    return tuple(values.tolist())


@dataclass(frozen=True)
class Polynomial(Elementwise):
    """A polynomial of each element, ``c[0] u**n + ... + c[n]``, by Horner's rule.

    Parameters
    ----------
    coefficients : sequence of float
        Of the highest power first, as in ``numpy.polyval``.
    size : int
        Number of elements.
    """

    coefficients: Sequence[float]
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "coefficients", _finite(self, "coefficients", 1))

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_polynomial, parameters={"coefficients": np.array(self.coefficients)})


def place(points, value):
    """Return the last of the rising `points` that is not above `value`, but the last of all; the first if all are above."""
    low, high = 0, points.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if points[middle] <= value:
            low = middle
        else:
            high = middle
    return low


def _linear_table(u, points, values, y):
    last = points.shape[0] - 1
    for i in range(y.shape[0]):
        j = place(points, u[i])
        share = (u[i] - points[j]) / (points[j + 1] - points[j])
        between = values[j] + share * (values[j + 1] - values[j])
        held = select(u[i] >= points[last], values[last], select(u[i] <= points[0], values[0], between))
        y[i] = select(isnan(u[i]), u[i], held)


def _held_table(u, points, values, y):
    last = points.shape[0] - 1
    for i in range(y.shape[0]):
        held = select(u[i] >= points[last], values[last], values[place(points, u[i])])
        y[i] = select(isnan(u[i]), u[i], held)


def rising(owner: Block, name: str) -> tuple[float, ...]:
    """Return a setting as a tuple of at least two strictly rising numbers.

    Raises
    ------
    ModelError
        If it is something else.
    """
    points = _finite(owner, name, 2)
    if not (np.diff(points) > 0).all():
        raise ModelError(f"{type(owner).__name__} has {name}={brief(points)}; the points must rise strictly.")
    return points


@dataclass(frozen=True)
class LookupTable(Elementwise):
    """The value of a table at each element: linear between the points, or held from each point to the next.

    Outside of the table it is the first or the last value.

    Parameters
    ----------
    points : sequence of float
        Where the values hold, strictly rising; at least two.
    values : sequence of float
        As many values.
    interpolate : bool
        True for straight lines, False to hold each value until the next point.
    size : int
        Number of elements.
    """

    points: Sequence[float] = field(metadata={"unit": "{u}"})
    values: Sequence[float] = field(metadata={"unit": "{y}"})
    interpolate: bool = True
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "points", rising(self, "points"))
        object.__setattr__(self, "values", _finite(self, "values", 2))
        if len(self.points) != len(self.values):
            raise ModelError(
                f"LookupTable has {len(self.points)} points and {len(self.values)} values; give one value for each point."
            )

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        parameters = {"points": np.array(self.points), "values": np.array(self.values)}
        return Definition(_linear_table if self.interpolate else _held_table, parameters=parameters)


def _cells(u, v, rows, columns, values, y):
    i, j = place(rows, u[0]), place(columns, v[0])
    a = (u[0] - rows[i]) / (rows[i + 1] - rows[i])
    b = (v[0] - columns[j]) / (columns[j + 1] - columns[j])
    a = select(a > 1.0, 1.0, select(a < 0.0, 0.0, a))
    b = select(b > 1.0, 1.0, select(b < 0.0, 0.0, b))
    upper = (1.0 - b) * values[i, j] + b * values[i, j + 1]
    lower = (1.0 - b) * values[i + 1, j] + b * values[i + 1, j + 1]
    y[0] = (1.0 - a) * upper + a * lower


@dataclass(frozen=True)
class LookupTable2D(Block):
    """The value of a table of two inputs, bilinear between its points; outside, that of the nearest point of its edge.

    Parameters
    ----------
    rows, columns : sequence of float
        Values of ``u`` at the rows and of ``v`` at the columns, strictly rising; at least two of each.
    values : sequence of sequence of float
        A row for each of `rows`, with a number for each of `columns`.
    """

    rows: Sequence[float] = field(metadata={"unit": "{u}"})
    columns: Sequence[float] = field(metadata={"unit": "{v}"})
    values: Sequence[Sequence[float]] = field(metadata={"unit": "{y}"})

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            object.__setattr__(self, name, rising(self, name))
        values, shape = reals(self.values), (len(self.rows), len(self.columns))
        if values.shape != shape or not np.isfinite(values).all():
            raise ModelError(
                f"LookupTable2D has values of the shape {values.shape}; give {shape[0]} rows of {shape[1]} finite numbers."
            )
        object.__setattr__(self, "values", tuple(map(tuple, values.tolist())))

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``u`` and ``v``."""
        return Port("u", description="What chooses the row"), Port("v", description="What chooses the column")

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description="The value of the table"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(
            _cells, parameters={name: np.array(getattr(self, name)) for name in ("rows", "columns", "values")}
        )


__all__ = ["Abs", "DeadZone", "LookupTable", "LookupTable2D", "Polynomial", "Quantizer", "Sign"]
