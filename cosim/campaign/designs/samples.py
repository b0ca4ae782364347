"""Designs that fill ranges evenly: a Latin hypercube, a Sobol sequence, and the points of Sobol indices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.designs.design import Design, Level, check_points
from bayesftc.cosim.campaign.designs.ranges import checked, scaled
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Sampled(Design):
    """Base of the designs that fill ranges: points in the unit cube, scaled to the ranges of the factors.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: a uniform distribution; ``range(1, 11)``: one of these whole numbers; or a distribution of
        `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Seed of the random numbers; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed is wrong.
    """

    ranges: Mapping[str, Any]
    count: int
    seed: int = 0

    def __post_init__(self) -> None:
        checked(type(self).__name__, self.ranges)
        for name, value, least in (("count", self.count, 1), ("seed", self.seed, 0)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise ModelError(
                    f"{type(self).__name__} has {name}={brief(value)}; it must be a whole number from {least} up."
                )
        check_points(self.count)

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
    """A Latin hypercube: each of `count` equally probable slices of each factor's range contains one point.

    By `scipy.stats.qmc.LatinHypercube` (McKay, Beckman and Conover 1979). It suits any number of points. `sensitivity` needs a
    `SaltelliDesign` instead.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: a uniform distribution; ``range(1, 11)``: one of these whole numbers; or a distribution of
        `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Seed of the random numbers; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> design = cosim.LatinHypercube({"gain.gain": (0.0, 8.0), "delay.size": range(1, 5)}, count=4, seed=1)
    >>> sorted(int(point["gain.gain"] // 2) for point in design.points())  # one point in each quarter
    [0, 1, 2, 3]
    >>> sorted(int(point["delay.size"]) for point in design.points())
    [1, 2, 3, 4]
    """

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(d=len(self.ranges), seed=np.random.default_rng(self.seed))
        return np.asarray(sampler.random(self.count))


@dataclass(frozen=True)
class SobolSequence(Sampled):
    """The first points of a scrambled Sobol sequence, which fill the ranges more evenly than random points.

    By `scipy.stats.qmc.Sobol` (Owen's scrambling). A longer sequence with the same seed begins with the same points, so that a
    design can be extended. It is balanced if `count` is a power of two. For Sobol indices use `SaltelliDesign`.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: a uniform distribution; ``range(1, 11)``: one of these whole numbers; or a distribution of
        `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of points.
    seed : int
        Seed of the scrambling; the same seed gives the same points.

    Raises
    ------
    ModelError
        If a range, the count or the seed is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> ranges = {"gain.gain": (0.0, 8.0), "limit.high": (1.0, 2.0)}
    >>> short, long = cosim.SobolSequence(ranges, count=8, seed=1), cosim.SobolSequence(ranges, count=16, seed=1)
    >>> long.points()[:8] == short.points()
    True
    >>> sorted(int(point["gain.gain"]) for point in short.points())
    [0, 1, 2, 3, 4, 5, 6, 7]
    """

    def unit_points(self) -> Floats:
        """Return the points in the unit cube, of shape (points, factors)."""
        from scipy.stats import qmc

        sampler = qmc.Sobol(d=len(self.ranges), seed=np.random.default_rng(self.seed))
        whole = sampler.random_base2(max(int(self.count) - 1, 0).bit_length())
        return np.asarray(whole[: self.count])


@dataclass(frozen=True)
class SaltelliDesign(Sampled):
    """The points from which `sensitivity` computes Sobol indices: the influence of each factor on a metric.

    By SALib: `count` points of a scrambled Sobol sequence, and for each of them further points in which one factor is changed
    (Saltelli et al. 2010). There are ``count * (factors + 2)`` points, or ``count * (2 * factors + 2)`` with the indices of
    pairs.

    Parameters
    ----------
    ranges : mapping
        Factor -> ``(low, high)``: a uniform distribution; ``range(1, 11)``: one of these whole numbers; or a distribution of
        `scipy.stats` with its parameters, such as ``scipy.stats.lognorm(0.5)``, by its quantiles (``ppf``).
    count : int
        Number of base points, a power of two. Indices of a smooth metric need some hundreds.
    seed : int
        Seed of the scrambling; the same seed gives the same points.
    second_order : bool
        Whether the design also serves for the indices of pairs of factors.

    Raises
    ------
    ModelError
        If a range, the count or the seed is wrong.
    BayesFTCError
        If SALib is not installed, when the points are computed.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> design = cosim.SaltelliDesign({"gain.gain": (0.0, 8.0), "limit.high": (1.0, 2.0)}, count=64)
    >>> len(design.points()), design.block
    (256, 4)
    """

    second_order: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count & (self.count - 1):
            near = 1 << (int(self.count).bit_length() - 1)
            raise ModelError(
                f"SaltelliDesign has count={self.count}, with which its points are not balanced; use {near} or {2 * near}."
            )

    @property
    def block(self) -> int:
        """Number of points that belong together: a base point and those in which one factor is changed."""
        return (2 if self.second_order else 1) * len(self.ranges) + 2

    def __len__(self) -> int:
        return self.count * self.block

    def problem(self) -> dict[str, Any]:
        """Return the problem for SALib: the names of the factors, in the unit cube."""
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


__all__ = ["LatinHypercube", "SaltelliDesign", "Sampled", "SobolSequence"]
