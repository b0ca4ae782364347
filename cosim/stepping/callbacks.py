"""Callbacks, by which compiled code steps a block in Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from bayesftc.cosim.types import Floats

_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64)


class Callback:
    """A C function with the engine's signature that calls a Python function.

    Parameters
    ----------
    function : callable
        Takes inputs, outputs and t; returns a status.
    sizes : (int, int)
        Numbers of inputs and outputs.
    resize : callable
        Called with the size of the step before each call.
    step_word : int
        The word of the block's table that holds the step size.
    raised : int
        The status if the function raises an error, which `taken` then returns.
    """

    def __init__(
        self,
        function: Callable[[Floats, Floats, float], int],
        sizes: tuple[int, int],
        resize: Callable[[float], None],
        step_word: int,
        raised: int,
    ):
        self._error: BaseException | None = None
        views: dict[tuple[int, int], Floats] = {}

        def view(address: int, size: int) -> Floats:
            if (address, size) not in views:
                memory: Any = (ctypes.c_double * size).from_address(address) if size else ()
                views[address, size] = np.asarray(memory, dtype=np.float64)
            return views[address, size]

        def entry(state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
            try:
                resize(ctypes.c_double.from_address(parameters + 8 * step_word).value)
                return function(view(inputs, sizes[0]), view(outputs, sizes[1]), t)
            except BaseException as error:  # noqa: BLE001 - it cannot pass through C code; the explanation of the status raises it
                self._error = error
                return raised

        self._entry = _ENTRY(entry)

    def taken(self) -> BaseException | None:
        """Return what the function has raised, once."""
        error, self._error = self._error, None
        return error

    @property
    def address(self) -> int:
        """Address of the function; keep the object as long as it is used."""
        return ctypes.cast(self._entry, ctypes.c_void_p).value or 0
