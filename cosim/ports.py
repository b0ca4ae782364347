"""Typed, named ports of blocks."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.units import Unit
from bayesftc.cosim.errors import ModelError

DEFAULT_LABEL = re.compile(r"([uy])\[(0|[1-9]\d*)\]")
"""The names that python-control gives to inputs and outputs without names."""


@dataclass(frozen=True)
class Port:
    """One input or output of a block: a float64 scalar, vector or matrix.

    Attributes
    ----------
    name : str
        Name, unique within the block.
    shape : tuple of int
        ``()`` for a scalar, ``(n,)`` for a vector, ``(n, m)`` for a matrix.
    unit : str or None
        For example ``"m/s"``. Connections between different units are refused. None fits all units.
    feedthrough : bool
        For inputs: whether an output at t_k depends on this input at t_k.
    default : float, tuple or None
        For inputs: the value while nothing is connected, one number for all elements or tuples of the port's shape. With None
        the input must be connected.
    draw : {"normal", "uniform"} or None
        For inputs: while nothing is connected, the engine fills the port at every step with standard normal numbers, or with
        numbers uniform in (0, 1).
    meaning : Unit or None
        Definition of the unit by an FMU; without one, pint's definition of the name applies.
    description : str
        What the signal is, in a few words, for the users of an exported FMU.
    units : tuple of (str or None)
        For a vector whose elements have different units: the unit of each element, in place of `unit`.
    element_descriptions : tuple of str
        What each element is, for the users of an exported FMU in which each is a variable; without them, `description`.

    Raises
    ------
    ModelError
        If the shape is not a tuple of whole numbers from 1 on, or there is no such `draw`, or the number of units is another
        than that of the elements.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> force = cosim.Port("force", unit="N", feedthrough=False, default=0.0)
    >>> matrix = cosim.Port("K", shape=(2, 3))
    >>> force.size, matrix.size
    (1, 6)
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str | None = None
    feedthrough: bool = True
    default: float | tuple[Any, ...] | None = None
    draw: Literal["normal", "uniform"] | None = None
    meaning: Unit | None = field(default=None, compare=False, repr=False, metadata={"derived": True})
    description: str = field(default="", compare=False, repr=False)
    units: tuple[str | None, ...] = field(default=(), repr=False)
    element_descriptions: tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.shape, tuple) or not all(isinstance(n, int | np.integer) and n >= 1 for n in self.shape):
            raise ModelError(
                f"Port {self.name!r} has the shape {self.shape!r}; it must be a tuple of whole numbers from 1 on, such as (3,)."
            )
        if self.draw not in {None, "normal", "uniform"}:
            raise ModelError(f"Port {self.name!r} has draw={self.draw!r}; it must be 'normal', 'uniform' or None.")
        if self.units and len(self.units) != self.size:
            raise ModelError(
                f"Port {self.name!r} has units={self.units!r}, but {counted(self.size, 'element')}; give a "
                "unit for each element, or one unit for all: unit=..."
            )

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    def unit_of(self, element: int) -> str | None:
        """Return the unit of one element, counted row by row."""
        return self.units[element] if self.units else self.unit


def listed(ports: Sequence[Port], most: int = 8) -> str:
    """Return a line of text that lists ports: names, shapes and units of the first ones."""
    shown = [
        port.name
        + (f"({'x'.join(map(str, port.shape))})" if port.shape else "")
        + (f" [{port.unit}]" if port.unit else "")
        for port in ports[:most]
    ]
    return ", ".join(shown + ([f"{len(ports) - most} more"] if len(ports) > most else [])) or "nothing"


def without_brackets(label: str, names: Collection[str]) -> str | None:
    """Return the one of the names that stands for a default label of python-control: ``u`` or ``u0`` for ``u[0]``.

    Brackets mean elements of a vector here, so `StateSpace` names the signals of a system without labels ``u0``, ``u1``.
    """
    found = DEFAULT_LABEL.fullmatch(label)
    if not found:
        return None
    letter, number = found.groups()
    name = letter + number
    if name in names:
        return name
    return letter if number == "0" and letter in names else None


def labels(name: str, shape: tuple[int, ...]) -> list[str]:
    """Return a name for each scalar of a signal: ``name``, ``name[i]`` or ``name[i,j]``."""
    return [name + (f"[{','.join(map(str, index))}]" if index else "") for index in np.ndindex(*shape)]
