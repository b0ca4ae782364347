"""Blocks that change each element of a signal by itself: limits, dead zone, magnitude, sign, quantizer, polynomial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite
from typing import ClassVar

import numpy as np

from bayesftc.cosim.base.numbers import check_count, real, reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import absolute, floor, isnan, maximum, minimum, select
from bayesftc.cosim.ports import Port

IN = "What comes in"


class Elementwise(Block):
    """Base of blocks with an input ``u`` and an output ``y`` of `size` elements each; a missing sample (NaN) stays missing."""

    size: int
    result: ClassVar[str]
    """Description of the output."""

    def __post_init__(self) -> None:
        self._check()

    def _check(self, *names: str, above: float = -np.inf) -> None:
        """Check the size, and that settings are finite numbers above a bound."""
        check_count(self, "size")
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
        return (Port("u", self.shape, description=IN),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", self.shape, description=self.result),)


class SameUnit(Elementwise):
    """Base of those whose output has the unit of the input."""

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y")


def _saturation(u, low, high, y):
    for i in range(y.shape[0]):
        y[i] = select(isnan(u[i]), u[i], maximum(minimum(u[i], high[0]), low[0]))


@dataclass(frozen=True)
class Saturation(SameUnit):
    """Limits each of the ``size`` elements of ``u`` to [low, high]; a missing sample (NaN) stays missing.

    Parameters
    ----------
    low, high : float
        Limits of each element.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `low` is above `high`, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> limit = cosim.Saturation(-1.0, 1.0).online(dt=0.1, compiled=False)
    >>> [limit(u=u).y for u in (-3.0, 0.5, 2.0)]
    [-1.0, 0.5, 1.0]
    """

    result: ClassVar[str] = "u within its limits"

    low: float = field(metadata={"unit": "{u}"})
    high: float = field(metadata={"unit": "{u}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        if not self.low <= self.high:
            raise ModelError(f"Saturation has low={self.low!r} and high={self.high!r}; low must not be above high.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_saturation, parameters={"low": self.low, "high": self.high})


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

    Raises
    ------
    ModelError
        If the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> magnitude = cosim.Abs().online(dt=0.1, compiled=False)
    >>> [magnitude(u=u).y for u in (-2.0, 0.0, 3.0)]
    [2.0, 0.0, 3.0]
    """

    result: ClassVar[str] = "The magnitude of u"

    size: int = 1

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

    Raises
    ------
    ModelError
        If the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> sign = cosim.Sign(size=3).online(dt=0.1, compiled=False)
    >>> sign(u=[-2.0, 0.0, 3.0]).y.tolist()
    [-1.0, 0.0, 1.0]
    """

    result: ClassVar[str] = "1, 0 or -1"

    size: int = 1

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

    Raises
    ------
    ModelError
        If a limit is not finite, `low` is above `high`, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> zone = cosim.DeadZone(-0.5, 1.0).online(dt=0.1, compiled=False)
    >>> [zone(u=u).y for u in (-2.0, 0.0, 3.0)]
    [-1.5, 0.0, 2.0]
    """

    result: ClassVar[str] = "How far u is beyond the zone"

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

    Raises
    ------
    ModelError
        If the interval is not a positive number, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> converter = cosim.Quantizer(0.25).online(dt=0.1, compiled=False)
    >>> [converter(u=u).y for u in (0.1, 0.2, 0.375)]
    [0.0, 0.25, 0.5]
    """

    result: ClassVar[str] = "The nearest multiple"

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


def finite(owner: Block, name: str, least: int) -> tuple[float, ...]:
    """Return a setting as a tuple of at least so many finite numbers."""
    values = reals(getattr(owner, name))
    if values.ndim != 1 or len(values) < least or not np.isfinite(values).all():
        raise ModelError(
            f"{type(owner).__name__} has {name}={brief(getattr(owner, name))}; give at least {least} finite numbers."
        )
    return tuple(values.tolist())


@dataclass(frozen=True)
class Polynomial(Elementwise):
    """A polynomial of each element by Horner's rule: ``c[0] u**n + c[1] u**(n-1)`` and so on to ``c[n]``.

    Parameters
    ----------
    coefficients : sequence of float
        Of the highest power first, as in ``numpy.polyval``.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If there is no coefficient, one is not finite, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> drag = cosim.Polynomial([0.5, 0.0, 2.0]).online(dt=0.1, compiled=False)  # 0.5 u**2 + 2
    >>> [drag(u=u).y for u in (0.0, 1.0, 4.0)]
    [2.0, 2.5, 10.0]
    """

    result: ClassVar[str] = "The value of the polynomial"

    coefficients: Sequence[float]
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "coefficients", finite(self, "coefficients", 1))

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_polynomial, parameters={"coefficients": np.array(self.coefficients)})


__all__ = ["Abs", "DeadZone", "Polynomial", "Quantizer", "Saturation", "Sign"]
