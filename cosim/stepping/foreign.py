"""Functions of other compiled code, such as an FMU's, that step functions may call.

A step function calls one like any other: ``move(x, u, x_next)``. In plain Python the call goes through ctypes. In machine code it
goes to a symbol that this process defines before it loads the code, so that the code on the disk contains no address.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np

from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.types import Floats

MOST_ARGUMENTS = 4


class Foreign(ABC):
    """A function outside Python whose arguments are float64 arrays; it has no state, and the same arguments give the same bits.

    To write one you must:

    1. give `arguments`, the names of its arrays, each with its number of elements, and `stored`, those that it writes completely;
    2. give a `symbol` that is a name in C and different for functions that compute different things, in every process;
    3. define the symbol in `defined`, and return its address;
    4. make it picklable.
    """

    arguments: dict[str, int]
    stored: frozenset[str]
    symbol: str
    title: str
    """What it belongs to, for errors: ``"the FMU arm.fmu"``."""

    @abstractmethod
    def defined(self) -> int:
        """Define the symbol for machine code, once in a process, and return the function's address."""

    @cached_property
    def _entry(self) -> Any:
        return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(self.arguments))(self.defined())

    def __call__(self, *arrays: Floats) -> None:
        """Call the function."""
        if len(arrays) != len(self.arguments):
            raise TypeError(f"{self.symbol} takes {', '.join(self.arguments)}.")
        title = self.title[0].upper() + self.title[1:]
        for array, (name, size) in zip(arrays, self.arguments.items(), strict=True):
            if isinstance(array, np.ndarray) and array.dtype == object:
                raise KernelError(
                    f"{title} computes with numbers only, so its step function cannot be traced or differentiated. Give its "
                    "derivatives."
                )
            if not isinstance(array, np.ndarray) or array.dtype != np.float64 or not array.flags.c_contiguous:
                raise KernelError(f"{title} needs a contiguous float64 array for {name}, with {size} elements.")
            if array.size != size:
                raise KernelError(f"{title} needs {size} elements for {name}, not {array.size}.")
            if name in self.stored and not array.flags.writeable:
                raise KernelError(f"{title} writes {name}, but this array cannot be written to.")
        self._entry(*(array.ctypes.data for array in arrays))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_entry"}


__all__ = ["MOST_ARGUMENTS", "Foreign"]
