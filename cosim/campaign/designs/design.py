"""The points of a campaign: all combinations of values, a list, or (`samples`) points that fill ranges evenly.

A design is a list of points. Each point has a value and a label for every factor; tables show the label. Two designs can be
multiplied: ``LatinHypercube(...) * Grid(...)`` combines each point of the one with each point of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim.errors import ModelError, brief

MOST = 1_000_000
"""Largest number of points of a design; more do not fit into memory."""


def check_points(count: int) -> None:
    """Refuse a design with too many points for a campaign.

    Raises
    ------
    ModelError
        If there are too many.
    """
    if count > MOST:
        raise ModelError(
            f"The design has {brief(count)} points, but a campaign has at most {MOST:,}; use fewer values."
        )


class Level(NamedTuple):
    """A value of a factor, and its label in tables."""

    label: Any
    value: Any


class Design:
    """Points of a campaign, in order.

    To write a design, define `levels`. Its result must depend only on the settings of the design, because a resumed campaign
    calls it again.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> design = cosim.Points([{"fault.start": 2.0}, {"fault.start": 6.0}]) * cosim.Grid({"gain.gain": [1.0, 2.0, 4.0]})
    >>> design.factors, len(design), design.points()[1]
    (('fault.start', 'gain.gain'), 6, {'fault.start': 2.0, 'gain.gain': 2.0})
    """

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        raise NotImplementedError

    def points(self) -> list[dict[str, Any]]:
        """Return for each point the value of each factor."""
        return [{name: level.value for name, level in point.items()} for point in self.levels()]

    def labels(self) -> list[dict[str, Any]]:
        """Return for each point the label of each factor in tables: a number, a text, True, False or None."""
        return [{name: level.label for name, level in point.items()} for point in self.levels()]

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(self.levels()[0])

    def __len__(self) -> int:
        return len(self.levels())

    def __mul__(self, other: Design) -> Crossed:
        """Return the design of all combinations with the points of another design, which change first."""
        return Crossed(self, other) if isinstance(other, Design) else NotImplemented


@dataclass(frozen=True)
class Crossed(Design):
    """All combinations of the points of two designs, the result of ``one * other``.

    Parameters
    ----------
    one, other : Design
        Designs without a common factor. The points of `other` change first.
    """

    one: Design
    other: Design

    def __post_init__(self) -> None:
        twice = sorted(set(self.one.factors) & set(self.other.factors))
        if twice:
            raise ModelError(f"Two designs that are multiplied both set {twice[0]!r}; remove it from one of them.")

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        one, other = self.one.levels(), self.other.levels()
        check_points(len(one) * len(other))
        return [{**a, **b} for a, b in product(one, other)]


@dataclass(frozen=True)
class Grid(Design):
    """All combinations of the values of factors: a full factorial design. The last factor changes first.

    Parameters
    ----------
    values : mapping
        Factor -> its values, as a sequence, or as a mapping of labels to values if they are not plain numbers or texts::

            Grid({"controller.precision": {"fixed": FixedPrecision(), "gamma": GammaPrecision()}, "freeze_0.start": [2.0, 6.0]})

    Raises
    ------
    ModelError
        If there is no factor, or a factor without a value or with one label twice.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> grid = cosim.Grid({"fault.start": [2.0, 6.0], "plant": {"light": 80.0, "heavy": 120.0}})
    >>> [point["plant"] for point in grid.labels()]
    ['light', 'heavy', 'light', 'heavy']
    >>> grid.points()[-1]
    {'fault.start': 6.0, 'plant': 120.0}
    """

    values: Mapping[str, Sequence[Any] | Mapping[Any, Any]]

    def __post_init__(self) -> None:
        if not isinstance(self.values, Mapping) or not self.values:
            raise ModelError(
                f"Grid has values={brief(self.values)}; give a mapping from the names of factors to their values."
            )
        for name, values in self.values.items():
            _levels(name, values)

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        each = [_levels(name, values) for name, values in self.values.items()]
        check_points(prod(map(len, each)))
        return [dict(zip(self.values, levels, strict=True)) for levels in product(*each)]


@dataclass(frozen=True)
class Points(Design):
    """A list of points, in the order of the list.

    Parameters
    ----------
    values : sequence of mapping
        For each point factor -> value. All points have the same factors.

    Raises
    ------
    ModelError
        If there is no point, or a point has other factors than the first.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> points = cosim.Points([{"gain.gain": 1.0, "limit.high": 5.0}, {"gain.gain": 2.0, "limit.high": 9.0}])
    >>> len(points), points.factors
    (2, ('gain.gain', 'limit.high'))
    """

    values: Sequence[Mapping[str, Any]]

    def __post_init__(self) -> None:
        if isinstance(self.values, Mapping | str) or not all(isinstance(point, Mapping) for point in self.values):
            raise ModelError(f"Points has {brief(self.values)}; give a list of mappings from factors to values.")
        if not len(self.values) or not self.values[0]:
            raise ModelError(
                "Points has no point, or a point without a factor; give at least one point and one factor."
            )
        for number, point in enumerate(self.values):
            if point.keys() != self.values[0].keys():
                raise ModelError(
                    f"Point {number} sets {', '.join(map(repr, point))} and point 0 "
                    f"{', '.join(map(repr, self.values[0]))}; give all points of a list the same factors."
                )

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        names = list(self.values[0])
        return [{name: Level(label_of(point[name]), point[name]) for name in names} for point in self.values]


def label_of(value: Any) -> Any:
    """Return the label of a value in tables: the value if it is a number, a text or None, else its text."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if value is None or isinstance(value, bool | int | float | str) else brief(value, 120)


def _levels(name: str, values: Any) -> list[Level]:
    """Return the values of a factor of a grid with their labels."""
    if isinstance(values, Mapping):
        levels = [Level(label_of(label), value) for label, value in values.items()]
    elif isinstance(values, str) or not hasattr(values, "__iter__"):
        raise ModelError(
            f"Factor {name!r} has the values {brief(values)}; give a list, or a mapping of labels to values."
        )
    else:
        levels = [Level(label_of(value), value) for value in values]
    if not levels:
        raise ModelError(f"Factor {name!r} has no value; give at least one, or leave the factor out.")
    labels: set[Any] = set()
    for level in levels:
        if level.label in labels:
            raise ModelError(
                f"Factor {name!r} has {brief(level.label)} twice; give each value once, or different labels: "
                "{label: value, ...}."
            )
        labels.add(level.label)
    return levels


__all__ = ["Crossed", "Design", "Grid", "Level", "Points", "label_of"]
