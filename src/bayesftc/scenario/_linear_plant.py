"""A linear plant from its matrices, without python-control, whose import takes a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import as_matrix
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.state_space import LinearSystem, StateSpace
from bayesftc.cosim.types import Floats
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import build


@dataclass(frozen=True)
class Matrices:
    """The linear system of ``[plant]``.

    Attributes
    ----------
    A, B, C : matrix
        Matrices of the system: n x n, n x p and m x n numbers.
    dt : float or str
        Sample time in seconds, 0 for continuous time.
    D : matrix, optional
        Direct feedthrough, m x p numbers; zero by default.
    inputs, outputs : sequence of str, optional
        Names of the signals, by default those of python-control's systems: ``u`` and ``y``, or ``u0``, ``u1``, ...
    """

    A: Sequence[Sequence[float]]
    B: Sequence[Sequence[float]]
    C: Sequence[Sequence[float]]
    dt: float | str
    D: Sequence[Sequence[float]] | None = None
    inputs: Sequence[str] | None = None
    outputs: Sequence[str] | None = None

    def system(self, place: Place) -> LinearSystem:
        """Check the sizes and return the system."""
        n = len(self.A)
        with place.named():
            A = as_matrix("The plant's A", self.A, n, n)
            B = as_matrix("The plant's B", self.B, rows=n)
            C = as_matrix("The plant's C", self.C, columns=n)
            D = (
                np.zeros((len(C), B.shape[1]))
                if self.D is None
                else as_matrix("The plant's D", self.D, len(C), B.shape[1])
            )
            dt = 0.0 if self.dt == 0 else float(rational_step(self.dt, "The plant's dt"))
        names = [
            _names(given, size, letter, place / key)
            for given, size, letter, key in [
                (self.inputs, B.shape[1], "u", "inputs"),
                (self.outputs, len(C), "y", "outputs"),
            ]
        ]
        return LinearSystem(_rows(A), _rows(B), _rows(C), _rows(D), dt, *names)


def linear_plant(table: dict[str, Any], place: Place, known: Sequence[str] = ("control", "measured")) -> Block:
    """Return the plant of the matrices, with the settings of `StateSpace`: ``initial``, ``process_noise``, ``units``.

    `known` are further keys that the section may have.
    """
    keys = [f.name for f in fields(Matrices)]
    others = [f.name for f in fields(StateSpace) if f.name in LINEAR]
    place.refuse_unknown(table, [*known, *keys, *others])
    if "dt" not in table:
        raise place.error(
            "lacks 'dt'. Add dt = 0 if A, B and C are of continuous time, else their sample time in seconds."
        )
    matrices: Matrices = build(Matrices, {key: value for key, value in table.items() if key in keys}, place)
    rest = {key: value for key, value in table.items() if key in others}
    return build(StateSpace, rest, place, given={"system": matrices.system(place)})  # type: ignore[no-any-return]


LINEAR = ("initial", "process_noise", "units")
"""Settings of `StateSpace` that concern linear systems."""


def _names(given: Sequence[str] | None, size: int, letter: str, place: Place) -> tuple[str, ...]:
    if given is None:
        return (letter,) if size == 1 else tuple(f"{letter}{i}" for i in range(size))
    if len(given) != size or len(set(given)) != size:
        raise place.error(f"has {len(given)} names for {size} signals. Give each signal a different name.")
    return tuple(given)


def _rows(matrix: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
