"""Common types: arrays of float64, and step functions, whose argument names state what they get."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import FunctionType

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.errors import KernelError

Floats = NDArray[np.float64]
Kernel = Callable[..., None]

ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64)
"""The signature of compiled functions: addresses of state, parameters, inputs and outputs, time, step; they return a status."""


def argument_names(kernel: Kernel) -> tuple[str, ...]:
    """Return the argument names of a step function."""
    if not isinstance(kernel, FunctionType):
        raise KernelError(f"A step function must be a plain Python function, not {kernel!r}.")
    code = kernel.__code__
    if code.co_kwonlyargcount or code.co_flags & 0x0C or kernel.__defaults__:
        raise KernelError(
            f"Step function {kernel.__name__!r} must have plain arguments: no defaults, no *args, no keywords."
        )
    return code.co_varnames[: code.co_argcount]


__all__ = ["ENTRY", "Floats", "Kernel", "argument_names"]
