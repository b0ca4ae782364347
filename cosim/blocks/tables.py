"""Tables of numbers: the value at a point, linear between the given points or held from each to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import ClassVar

import numpy as np

from bayesftc.cosim.base.numbers import reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.elementwise import Elementwise, finite
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import isnan, select
from bayesftc.cosim.ports import Port


def place(points, value):
    """Return the place of the last of the rising `points` not above `value`, from the first to the last but one.

    A search branches on data, which the export's dependencies, Jacobians and runs side by side do not follow. Sums of `select`
    over all points would, but they take as long as the table is.
    """
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
    points = finite(owner, name, 2)
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

    Raises
    ------
    ModelError
        If the points do not rise, are less than two, or are not as many as the values.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> valve = cosim.LookupTable(points=[0.0, 0.5, 1.0], values=[0.0, 10.0, 80.0]).online(dt=0.1, compiled=False)
    >>> [valve(u=opening).y for opening in (0.25, 0.75, 2.0)]
    [5.0, 45.0, 80.0]
    """

    result: ClassVar[str] = "The value of the table"

    points: Sequence[float] = field(metadata={"unit": "{u}"})
    values: Sequence[float] = field(metadata={"unit": "{y}"})
    interpolate: bool = True
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "points", rising(self, "points"))
        object.__setattr__(self, "values", finite(self, "values", 2))
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

    Raises
    ------
    ModelError
        If rows or columns do not rise, are less than two, or do not fit the values.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> table = cosim.LookupTable2D(rows=[0.0, 1.0], columns=[0.0, 10.0], values=[[0.0, 20.0], [2.0, 42.0]])
    >>> torque = table.online(dt=0.1, compiled=False)
    >>> torque(u=0.5, v=5.0).y, torque(u=1.0, v=99.0).y
    (16.0, 42.0)
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


__all__ = ["LookupTable", "LookupTable2D"]
