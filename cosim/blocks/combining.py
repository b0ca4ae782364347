"""Blocks that make one signal of several: product, minimum, maximum, switch, logic, comparison."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

from bayesftc.cosim.base.numbers import check_count
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.elementwise import Elementwise
from bayesftc.cosim.errors import ModelError, did_you_mean
from bayesftc.cosim.ops import both, either, isnan, maximum, minimum, negate, select
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Kernel

TRUE = 0.5
"""Above this a signal counts as true, below and where it is missing as false."""


def _product(u, divides, y):
    total = select(divides[0] > 0.5, 1.0 / u[0], u[0])
    for i in range(1, u.shape[0]):
        total = select(divides[i] > 0.5, total / u[i], total * u[i])
    y[0] = total


@dataclass(frozen=True)
class Product(Block):
    """Multiplies and divides the elements of ``u``: ``Product("*/")`` is a quotient of two signals.

    A division by zero gives an infinity or NaN.

    Parameters
    ----------
    operations : str
        A ``*`` or ``/`` for each element.

    Raises
    ------
    ModelError
        If there is no operation, or another character.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> power = cosim.Product("**/").online(dt=0.1, compiled=False)  # force * speed / efficiency
    >>> power(u=[100.0, 3.0, 0.75]).y
    400.0
    """

    operations: str = "**"

    def __post_init__(self) -> None:
        if not self.operations or set(self.operations) - {"*", "/"}:
            raise ModelError(f"Product has operations={self.operations!r}; give a * or / for each element, as '*/'.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, an element for each operation."""
        return (Port("u", (len(self.operations),), description="What is multiplied or divided by"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description="The product"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_product, parameters={"divides": [1.0 if o == "/" else 0.0 for o in self.operations]})


def _least(u, y):
    least = u[0]
    for i in range(1, u.shape[0]):
        least = select(isnan(least), u[i], select(isnan(u[i]), least, minimum(u[i], least)))
    y[0] = least


def _largest(u, y):
    largest = u[0]
    for i in range(1, u.shape[0]):
        largest = select(isnan(largest), u[i], select(isnan(u[i]), largest, maximum(u[i], largest)))
    y[0] = largest


class _Extreme(Block):
    """Base of blocks that choose among the elements of ``u``."""

    size: int
    _kernel: ClassVar[Kernel]
    result: ClassVar[str]

    def __post_init__(self) -> None:
        check_count(self, "size")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u`` of `size` elements."""
        return (Port("u", (int(self.size),), description="What is compared"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description=self.result),)

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(type(self)._kernel)


@dataclass(frozen=True)
class Minimum(_Extreme):
    """The smallest element of ``u``, of those that are there; NaN if all are missing.

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
    >>> from math import nan
    >>> from bayesftc import cosim
    >>> smallest = cosim.Minimum(3).online(dt=0.1, compiled=False)
    >>> smallest(u=[4.0, nan, 2.5]).y
    2.5
    """

    _kernel: ClassVar[Kernel] = staticmethod(_least)
    result: ClassVar[str] = "The smallest element"

    size: int = 2


@dataclass(frozen=True)
class Maximum(_Extreme):
    """The largest element of ``u``, of those that are there; NaN if all are missing.

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
    >>> from math import nan
    >>> from bayesftc import cosim
    >>> largest = cosim.Maximum(3).online(dt=0.1, compiled=False)
    >>> largest(u=[4.0, nan, 2.5]).y
    4.0
    """

    _kernel: ClassVar[Kernel] = staticmethod(_largest)
    result: ClassVar[str] = "The largest element"

    size: int = 2


def _switch(condition, above, otherwise, threshold, y):
    for i in range(y.shape[0]):
        y[i] = select(condition[0] > threshold[0], above[i], otherwise[i])


@dataclass(frozen=True)
class Switch(Elementwise):
    """``above`` where ``condition`` lies above `threshold`, else ``otherwise``, also where the condition is missing (NaN).

    Parameters
    ----------
    threshold : float
        Where it switches.
    size : int
        Number of elements of ``above``, ``otherwise`` and ``y``.

    Raises
    ------
    ModelError
        If the threshold is not finite, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> switch = cosim.Switch(threshold=10.0).online(dt=0.1, compiled=False)
    >>> [switch(condition=speed, above=1.0, otherwise=-1.0).y for speed in (5.0, 10.0, 15.0)]
    [-1.0, -1.0, 1.0]
    """

    result: ClassVar[str] = "What the condition chooses"

    threshold: float = TRUE
    size: int = 1

    def __post_init__(self) -> None:
        self._check("threshold")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``condition``, ``above`` and ``otherwise``."""
        return (
            Port("condition", description="What decides"),
            Port("above", self.shape, description="What comes out where the condition lies above the threshold"),
            Port("otherwise", self.shape, description="What comes out elsewhere"),
        )

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("above", "otherwise", "y")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_switch, parameters={"threshold": self.threshold})


def _and(u, y):
    result = u[0] > TRUE
    for i in range(1, u.shape[0]):
        result = both(result, u[i] > TRUE)
    y[0] = select(result, 1.0, 0.0)


def _or(u, y):
    result = u[0] > TRUE
    for i in range(1, u.shape[0]):
        result = either(result, u[i] > TRUE)
    y[0] = select(result, 1.0, 0.0)


def _xor(u, y):
    odd = 0.0
    for i in range(u.shape[0]):
        odd = select(u[i] > TRUE, 1.0 - odd, odd)
    y[0] = odd


def _not(u, y):
    y[0] = select(negate(u[0] > TRUE), 1.0, 0.0)


_LOGIC = {"and": _and, "or": _or, "xor": _xor, "not": _not}


@dataclass(frozen=True)
class Logic(Block):
    """1 or 0 of truth values: an element of ``u`` is true above 0.5, and false where it is missing (NaN).

    Parameters
    ----------
    operation : {"and", "or", "xor", "not"}
        ``"xor"`` is true for an odd number of true elements.
    size : int, optional
        Number of elements; by default one for ``"not"``, else two.

    Raises
    ------
    ModelError
        If there is no such operation, or the size does not fit it.

    Examples
    --------
    >>> from math import nan
    >>> from bayesftc import cosim
    >>> alarm = cosim.Logic("and", size=3).online(dt=0.1, compiled=False)
    >>> alarm(u=[1.0, 1.0, 1.0]).y, alarm(u=[1.0, 1.0, nan]).y
    (1.0, 0.0)
    """

    operation: str
    size: int | None = None

    def __post_init__(self) -> None:
        if self.operation not in _LOGIC:
            raise ModelError(f"Logic has operation={self.operation!r}; {did_you_mean(str(self.operation), _LOGIC)}")
        alone = self.operation == "not"
        if self.size is None:
            object.__setattr__(self, "size", 1 if alone else 2)
        check_count(self, "size")
        if alone and self.size != 1:
            raise ModelError(f"Logic has size={self.size!r}; it must be 1 for 'not'.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u`` of `size` elements."""
        return (Port("u", (self.size or 1,), description="Truth values"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description="1 if true, else 0"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_LOGIC[self.operation])


def _below(u, y):
    y[0] = select(u[0] < u[1], 1.0, 0.0)


def _at_most(u, y):
    y[0] = select(u[0] <= u[1], 1.0, 0.0)


def _equal(u, y):
    y[0] = select(u[0] == u[1], 1.0, 0.0)


def _unequal(u, y):
    y[0] = select(u[0] != u[1], 1.0, 0.0)


def _at_least(u, y):
    y[0] = select(u[0] >= u[1], 1.0, 0.0)


def _above(u, y):
    y[0] = select(u[0] > u[1], 1.0, 0.0)


_COMPARISONS = {"<": _below, "<=": _at_most, "==": _equal, "!=": _unequal, ">=": _at_least, ">": _above}


@dataclass(frozen=True)
class Compare(Block):
    """1 where the first element of ``u`` compares so to the second, else 0; with a missing sample only ``!=`` holds.

    Parameters
    ----------
    relation : {"<", "<=", "==", "!=", ">=", ">"}
        What must hold.

    Raises
    ------
    ModelError
        If there is no such relation.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> hotter = cosim.Compare(">=").online(dt=0.1, compiled=False)
    >>> hotter(u=[80.0, 75.0]).y, hotter(u=[70.0, 75.0]).y
    (1.0, 0.0)
    """

    relation: str

    def __post_init__(self) -> None:
        if self.relation not in _COMPARISONS:
            raise ModelError(f"Compare has relation={self.relation!r}; it must be one of {' '.join(_COMPARISONS)}.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u`` of two elements."""
        return (Port("u", (2,), description="What is compared"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description="1 if it holds, else 0"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_COMPARISONS[self.relation])


__all__ = ["Compare", "Logic", "Maximum", "Minimum", "Product", "Switch"]
