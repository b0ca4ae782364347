"""Which points a campaign runs: all combinations of values, a list, or samples that fill ranges evenly.

A design has points, one after the other; each gives every factor a value and a label, which stands for the value in tables. Two
designs multiply: ``LatinHypercube(...) * Grid(...)`` has each point of the one with each point of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim._campaign.extras import extra
from bayesftc.cosim._campaign.ranges import checked, scaled
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import ModelError, brief


class Level(NamedTuple):
    """A value of a factor, and how tables call it."""

    label: Any
    value: Any


class Design:
    """Points of a campaign, in order.

    To write a design, define `levels`; what it returns must not depend on anything but the design's own settings, since a
    campaign that is resumed asks again.
    """

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        raise NotImplementedError

    def points(self) -> list[dict[str, Any]]:
        """Return for each point the value of each factor."""
        return [{name: level.value for name, level in point.items()} for point in self.levels()]

    def labels(self) -> list[dict[str, Any]]:
        """Return for each point what stands for each factor's value in tables: a number, a text, True, False or None."""
        return [{name: level.label for name, level in point.items()} for point in self.levels()]

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(self.levels()[0])

    def __len__(self) -> int:
        return len(self.levels())

    def __mul__(self, other: Design) -> Crossed:
        """Return the design of each of these points with each point of another, whose points change first."""
        return Crossed(self, other) if isinstance(other, Design) else NotImplemented


@dataclass(frozen=True)
class Crossed(Design):
    """Each point of one design with each point of another; what ``one * other`` returns.

    Parameters
    ----------
    one, other : Design
        Without a factor in common. The points of `other` change first.
    """

    one: Design
    other: Design

    def __post_init__(self) -> None:
        twice = sorted(set(self.one.factors) & set(self.other.factors))
        if twice:
            raise ModelError(f"Two designs that are multiplied both set {twice[0]!r}; leave it to one of them.")

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        return [{**a, **b} for a, b in product(self.one.levels(), self.other.levels())]


@dataclass(frozen=True)
class Grid(Design):
    """All combinations of the values of factors: a full factorial design. The last factor changes first.

    Parameters
    ----------
    values : mapping
        Factor -> its values, as a sequence, or as a mapping of labels to values where the values are no plain numbers or texts::

            Grid({"controller.precision": {"fixed": FixedPrecision(), "gamma": GammaPrecision()}, "freeze_0.start": [2.0, 6.0]})

    Raises
    ------
    ModelError
        If there is no factor, or a factor without a value or with one label twice.
    """

    values: Mapping[str, Sequence[Any] | Mapping[Any, Any]]

    def __post_init__(self) -> None:
        if not isinstance(self.values, Mapping) or not self.values:
            raise ModelError(
                f"Grid has values={brief(self.values)}; it takes a mapping of each factor's name to its values."
            )
        for name, values in self.values.items():
            _levels(name, values)

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        each = [_levels(name, values) for name, values in self.values.items()]
        return [dict(zip(self.values, levels, strict=True)) for levels in product(*each)]


@dataclass(frozen=True)
class Points(Design):
    """A list of points, in the order of the list.

    Parameters
    ----------
    values : sequence of mapping
        For each point factor -> value; each has the same factors.

    Raises
    ------
    ModelError
        If there is no point, or one has other factors than the first.
    """

    values: Sequence[Mapping[str, Any]]

    def __post_init__(self) -> None:
        if isinstance(self.values, Mapping | str) or not all(isinstance(point, Mapping) for point in self.values):
            raise ModelError(f"Points has {brief(self.values)}; it takes a list of mappings of factors to values.")
        if not len(self.values) or not self.values[0]:
            raise ModelError("Points has no point, or one without a factor; give at least one factor and one point.")
        for number, point in enumerate(self.values):
            if point.keys() != self.values[0].keys():
                raise ModelError(
                    f"Point {number} sets {', '.join(map(repr, point))} and point 0 "
                    f"{', '.join(map(repr, self.values[0]))}; each point of a list has the same factors."
                )

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        names = list(self.values[0])
        return [{name: Level(label_of(point[name]), point[name]) for name in names} for point in self.values]


@dataclass(frozen=True)
class Sampled(Design):
    """Base of the designs that fill ranges: points in the unit cube, scaled to the ranges of the factors.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: any number between them, each as probable; ``range(1, 11)``: one of these whole numbers; or a
        distribution of `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Of the random numbers; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed cannot be one.
    """

    ranges: Mapping[str, Any]
    count: int
    seed: int = 0

    def __post_init__(self) -> None:
        checked(type(self).__name__, self.ranges)
        for name, value, least in (("count", self.count, 1), ("seed", self.seed, 0)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise ModelError(
                    f"{type(self).__name__} has {name}={brief(value)}; it takes a whole number from {least} up."
                )

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        raise NotImplementedError

    def levels(self) -> list[dict[str, Level]]:
        """Return for each point the value of each factor with its label."""
        columns = [scaled(name, given, u) for (name, given), u in zip(self.ranges.items(), self.unit_points().T)]
        return [
            {name: Level(value, value) for name, value in zip(self.ranges, values, strict=True)}
            for values in zip(*columns, strict=True)
        ]

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(self.ranges)


@dataclass(frozen=True)
class LatinHypercube(Sampled):
    """A Latin hypercube: of `count` equally probable slices of each factor's range each holds one point.

    By `scipy.stats.qmc.LatinHypercube` (McKay, Beckman and Conover 1979). It suits any number of points; what `sensitivity`
    asks for is `SaltelliDesign`.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: any number between them, each as probable; ``range(1, 11)``: one of these whole numbers; or a
        distribution of `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Of the random numbers; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed cannot be one.
    """

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(d=len(self.ranges), seed=np.random.default_rng(self.seed))
        return np.asarray(sampler.random(self.count))


@dataclass(frozen=True)
class SobolSequence(Sampled):
    """The first points of a scrambled Sobol sequence, which fill the ranges more evenly than chance does.

    By `scipy.stats.qmc.Sobol` (Owen's scrambling). A longer sequence of the same seed begins with the same points, so that a
    design can be grown; it is balanced where `count` is a power of two. Not to be confused with the indices of the same name, for
    which `SaltelliDesign` makes the points.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: any number between them, each as probable; ``range(1, 11)``: one of these whole numbers; or a
        distribution of `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Of the scrambling; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed cannot be one.
    """

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        from scipy.stats import qmc

        sampler = qmc.Sobol(d=len(self.ranges), seed=np.random.default_rng(self.seed))
        whole = sampler.random_base2(max(int(self.count) - 1, 0).bit_length())
        return np.asarray(whole[: self.count])


@dataclass(frozen=True)
class SaltelliDesign(Sampled):
    """The points from which `sensitivity` finds Sobol indices: which factor drives a metric.

    By SALib: `count` points of a scrambled Sobol sequence, and for each of them further ones in which one factor is changed
    (Saltelli et al. 2010). There are ``count * (factors + 2)`` points, or ``count * (2 * factors + 2)`` with the indices of
    pairs.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: any number between them, each as probable; ``range(1, 11)``: one of these whole numbers; or a
        distribution of `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of base points, a power of two. Indices of a smooth metric want some hundreds.
    seed : int
        Of the scrambling; the same seed gives the same points.
    second_order : bool
        Whether the indices of pairs of factors are wanted as well.

    Raises
    ------
    ModelError
        If a range, the count or the seed cannot be one.
    BayesFTCError
        If SALib is not installed; when the points are asked for.
    """

    second_order: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count & (self.count - 1):
            near = 1 << (int(self.count).bit_length() - 1)
            raise ModelError(
                f"SaltelliDesign has count={self.count}, with which its points are not balanced; take {near} or {2 * near}."
            )

    @property
    def block(self) -> int:
        """How many points belong together: a base point and those in which one factor is changed."""
        return (2 if self.second_order else 1) * len(self.ranges) + 2

    def __len__(self) -> int:
        return self.count * self.block

    def problem(self) -> dict[str, Any]:
        """Return what SALib asks for of the factors: their names, in the unit cube."""
        names = list(self.ranges)
        return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        sobol = extra("SALib.sample.sobol", "SaltelliDesign")
        return np.asarray(
            sobol.sample(
                self.problem(),
                self.count,
                calc_second_order=self.second_order,
                seed=np.random.default_rng(self.seed),
            )
        )


def label_of(value: Any) -> Any:
    """Return what stands for a value in tables: itself if it is a number, a text or None, else its text."""
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
    seen: set[Any] = set()
    for level in levels:
        if level.label in seen:
            raise ModelError(
                f"Factor {name!r} has {brief(level.label)} twice; give each value once, or labels of their own: "
                "{label: value, ...}."
            )
        seen.add(level.label)
    return levels


__all__ = [
    "Crossed",
    "Design",
    "Grid",
    "LatinHypercube",
    "Level",
    "Points",
    "SaltelliDesign",
    "Sampled",
    "SobolSequence",
    "label_of",
]
