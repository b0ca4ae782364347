"""Compiled step functions for the interpreted engine: it calls them by address, as compiled code does."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.base.timebase import step_at
from bayesftc.cosim.types import ENTRY, Floats


class ByAddress:
    """An instance whose step functions are called by address; see `bayesftc.cosim.block.External`.

    Attributes
    ----------
    table : ndarray of int64
        The words at the address ``parameters`` of the compiled functions.
    step_word : int
        The word of the table that holds the step size.
    """

    table: NDArray[np.int64]
    step_word: int
    _step: Fraction
    _arrays: tuple[Floats | None, Floats | None] = None, None  # of the last call; mostly those of the next call, too
    _places: tuple[int, int, int]

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        raise NotImplementedError

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 if the output function does everything."""
        raise NotImplementedError

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        return self._entered(self._entries[0], inputs, outputs, t)

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        entry = self._entries[1]
        return self._entered(entry, inputs, outputs, t) if entry else 0

    def resize(self, h: float) -> None:
        """Make steps of `h` seconds from now on; compiled runs change their own copy of the table."""
        self.table.view(np.float64)[self.step_word] = h

    @cached_property
    def _entries(self) -> tuple[Any, Any]:
        return ENTRY(self.output_address), ENTRY(self.update_address)

    def _entered(self, entry: Any, inputs: Floats, outputs: Floats, t: float) -> int:
        if inputs is not self._arrays[0] or outputs is not self._arrays[1]:
            self._arrays = inputs, outputs
            self._places = self.table.ctypes.data, inputs.ctypes.data, outputs.ctypes.data
        status: int = entry(0, *self._places, t, step_at(t, self._step))
        return status
