"""Small blocks that wire others together: gain, sum, unit delay, saturation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import maximum, minimum
from bayesftc.cosim.ports import Port


def _gain(u, gain, offset, y):
    for i in range(y.shape[0]):
        total = offset[i]
        for j in range(u.shape[0]):
            total = total + gain[i, j] * u[j]
        y[i] = total


@dataclass(frozen=True)
class Gain(Block):
    """``y = gain @ u + offset``: a number for a scalar signal, a matrix (rows x inputs) for a vector."""

    gain: float | Sequence[Sequence[float]]
    offset: float = 0.0
    input_unit: str | None = None
    output_unit: str | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.gain) not in {0, 2} or not np.isfinite(np.asarray(self.gain, float)).all():
            raise ModelError(f"Gain is {self.gain!r}; it must be a finite number, or a matrix with a row for each output.")
        if np.ndim(self.gain):
            object.__setattr__(self, "gain", tuple(tuple(row) for row in np.asarray(self.gain, float).tolist()))

    @property
    def _matrix(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.atleast_2d(np.asarray(self.gain, float))

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return (Port("u", () if np.ndim(self.gain) == 0 else (self._matrix.shape[1],), unit=self.input_unit),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", () if np.ndim(self.gain) == 0 else (self._matrix.shape[0],), unit=self.output_unit),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        matrix = self._matrix
        return Definition(_gain, parameters={"gain": matrix, "offset": np.full(len(matrix), self.offset)})


def _sum(u, signs, y):
    total = 0.0 * u[0]
    for i in range(u.shape[0]):
        total = total + signs[i] * u[i]
    y[0] = total


@dataclass(frozen=True)
class Sum(Block):
    """Adds the elements of ``u`` with the given signs: ``Sum("+-")`` is a comparison of two signals."""

    signs: str = "++"

    def __post_init__(self) -> None:
        if not self.signs or set(self.signs) - {"+", "-"}:
            raise ModelError(f"Sum has signs={self.signs!r}; give a + or - for each element, as '+-'.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, an element for each sign."""
        return (Port("u", (len(self.signs),)),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y"),)

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
class UnitDelay(Block):
    """``y`` at t_k is ``u`` at t_k-1: breaks algebraic loops, and makes a delay visible."""

    size: int = 1
    initial: float = 0.0

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, without direct feedthrough."""
        return (Port("u", () if self.size == 1 else (self.size,), feedthrough=False),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", () if self.size == 1 else (self.size,)),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_delay_output, _delay_update, state={"held": np.full(self.size, self.initial)})


def _saturation(u, low, high, y):
    for i in range(y.shape[0]):
        y[i] = maximum(minimum(u[i], high[0]), low[0])


@dataclass(frozen=True)
class Saturation(Block):
    """Limits each element of ``u`` to [low, high]."""

    low: float
    high: float
    size: int = 1

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ModelError(f"Saturation has low={self.low!r} above high={self.high!r}; exchange them.")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return (Port("u", () if self.size == 1 else (self.size,)),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", () if self.size == 1 else (self.size,)),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_saturation, parameters={"low": self.low, "high": self.high})


__all__ = ["Gain", "Saturation", "Sum", "UnitDelay"]
