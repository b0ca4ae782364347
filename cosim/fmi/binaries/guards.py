"""Memory with guard zones: writing beyond a buffer is detected, and damages nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.fmi.reading.description import FMUVariable

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.binaries.groups import Group

ZONE = 4096
"""Bytes before and after the array."""

_FILLING = 0xA5


class Guarded:
    """An array between two guard zones.

    Parameters
    ----------
    size : int
        Number of elements.
    dtype : numpy.dtype
        Their type.

    Attributes
    ----------
    values : ndarray
        The array, of zeros at first.
    """

    def __init__(self, size: int, dtype: np.dtype[Any]):
        self._memory = np.full(2 * ZONE + size * dtype.itemsize, _FILLING, dtype=np.uint8)
        self.values: np.ndarray[Any, Any] = self._memory[ZONE:-ZONE].view(dtype)
        self.values[:] = 0

    @property
    def intact(self) -> bool:
        """Whether nothing was written beyond the array."""
        return bool((self._memory[:ZONE] == _FILLING).all() and (self._memory[-ZONE:] == _FILLING).all())

    def mend(self) -> None:
        """Restore the guard zones."""
        self._memory[:ZONE] = self._memory[-ZONE:] = _FILLING


def beyond(groups: Sequence[Group], component: int, elements: Sequence[tuple[str, FMUVariable]]) -> str | None:
    """Return which variables an FMU has written beyond their buffers, or None.

    Parameters
    ----------
    groups : sequence of Group
        Outputs that have been read.
    component : int
        The instance.
    elements : sequence of (str, FMUVariable)
        Name and variable of each element of the outputs.
    """
    group = next((g for g in groups if not g.guarded.intact), None)
    if group is None:
        return None
    sizes: dict[str, int] = {}
    for _, variable in elements[group.span]:
        sizes[variable.name] = sizes.get(variable.name, 0) + 1
    alone = [
        name
        for name, reference, size in zip(sizes, group.references, sizes.values(), strict=True)
        if group.alone(int(reference), size).exceeds(component)
    ]
    group.guarded.mend()
    return " and ".join(map(repr, alone[:3] or list(sizes)[:3]))
