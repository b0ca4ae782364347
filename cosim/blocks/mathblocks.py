"""Small blocks that connect others: gain, sum, unit delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite
from typing import ClassVar

import numpy as np

from bayesftc.cosim.base.numbers import real, reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.elementwise import IN, SameUnit
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port


def _gain(u, gain, offset, y):
    for i in range(y.shape[0]):
        total = offset[i]
        for j in range(u.shape[0]):
            total = total + gain[i, j] * u[j]
        y[i] = total


@dataclass(frozen=True)
class Gain(Block):
    """``y = gain @ u + offset``.

    Parameters
    ----------
    gain : float or sequence of sequence of float
        A number for a scalar signal, a matrix (outputs x inputs) for a vector.
    offset : float
        Constant that is added to each element.
    input_unit, output_unit : str or None
        Units of the ports. With two different units the gain is a conversion.

    Raises
    ------
    ModelError
        If the gain is neither a finite number nor a matrix of such, or the offset is not finite.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> rotation = cosim.Gain([[0.0, -1.0], [1.0, 0.0]], offset=10.0).online(dt=0.1, compiled=False)
    >>> rotation(u=[1.0, 2.0]).y.tolist()
    [8.0, 11.0]
    """

    gain: float | Sequence[Sequence[float]]
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    input_unit: str | None = None
    output_unit: str | None = None

    def __post_init__(self) -> None:
        gain = reals(self.gain)
        if gain.ndim not in {0, 2} or not gain.size or not np.isfinite(gain).all():
            raise ModelError(
                f"Gain is {brief(self.gain)}; it must be a finite number, or a matrix with a row for each output."
            )
        if not isfinite(real(self.offset)):
            raise ModelError(f"Gain has offset={brief(self.offset)}; it must be a finite number.")
        object.__setattr__(self, "gain", tuple(tuple(row) for row in gain.tolist()) if gain.ndim else float(gain))

    @property
    def _matrix(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.atleast_2d(np.asarray(self.gain, float))

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return (
            Port("u", () if np.ndim(self.gain) == 0 else (self._matrix.shape[1],), self.input_unit, description=IN),
        )

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (
            Port(
                "y",
                () if np.ndim(self.gain) == 0 else (self._matrix.shape[0],),
                self.output_unit,
                description="gain u + offset",
            ),
        )

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        matrix = self._matrix
        return Definition(_gain, parameters={"gain": matrix, "offset": np.full(len(matrix), self.offset)})


def _sum(u, signs, y):
    total = signs[0] * u[0]
    for i in range(1, u.shape[0]):
        total = total + signs[i] * u[i]
    y[0] = total


@dataclass(frozen=True)
class Sum(Block):
    """Adds the elements of ``u`` with the given signs: ``Sum("+-")`` is the difference of two signals.

    Parameters
    ----------
    signs : str
        A ``+`` or ``-`` for each element.

    Raises
    ------
    ModelError
        If there is no sign, or another character.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> error = cosim.Sum("+-").online(dt=0.1, compiled=False)
    >>> error(u=[5.0, 3.0]).y
    2.0
    """

    signs: str = "++"

    def __post_init__(self) -> None:
        if not self.signs or set(self.signs) - {"+", "-"}:
            raise ModelError(f"Sum has signs={self.signs!r}; give a + or - for each element, such as '+-'.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, an element for each sign."""
        return (Port("u", (len(self.signs),), description="What is added or subtracted"),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", description="The sum"),)

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_sum, parameters={"signs": [1.0 if s == "+" else -1.0 for s in self.signs]})


def _delay_output(held, y):
    for i in range(y.shape[0]):
        y[i] = held[i]


def _delay_update(u, held):
    for i in range(u.shape[0]):
        held[i] = u[i]


@dataclass(frozen=True)
class UnitDelay(SameUnit):
    """``y`` at t_k is ``u`` at t_k-1 (``initial`` at first), for ``size`` elements. It breaks algebraic loops.

    Parameters
    ----------
    size : int
        Number of elements.
    initial : float
        Output at the first step, of each element, in the unit of the signal.

    Raises
    ------
    ModelError
        If the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> delay = cosim.UnitDelay(initial=9.0).online(dt=0.1, compiled=False)
    >>> [delay(u=u).y for u in (1.0, 2.0, 3.0)]
    [9.0, 1.0, 2.0]
    """

    result: ClassVar[str] = "u of the step before"

    size: int = 1
    initial: float = 0.0

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, without direct feedthrough."""
        return (Port("u", self.shape, feedthrough=False, description=IN),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_delay_output, _delay_update, state={"held": np.full(self.size, self.initial)})


__all__ = ["Gain", "Sum", "UnitDelay"]
