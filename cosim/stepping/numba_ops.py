"""numba's implementations of the functions of :mod:`bayesftc.cosim.ops`; imported only for compiling."""

from importlib import import_module
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba import extending

from bayesftc.cosim import elementary, ops
from bayesftc.cosim.base.warnings_shown import warn_user


def _of_library(name: str) -> Any:
    """Return a function of the C library, which CPython uses, too; where CPython raises, it returns the IEEE 754 result."""
    function = getattr(np, name)
    return lambda x: function(x)


def _select(condition, a, b):
    return (
        float(a) if condition else float(b)
    ) + 0.0  # the same bits as the sum of two terms, with half the operations


def _both(a, b):
    return bool(a) & bool(b)


def _either(a, b):
    return bool(a) | bool(b)


def _negate(a):
    return not a


def _isnan(x):
    return x != x


def _power_of_two(k):
    return np.int64(np.float64(k + 6755399441056767.0).view(np.int64) << np.int64(52)).view(np.float64)


def _exponent(x):
    bits = np.float64(x).view(np.uint64) + np.uint64(0x00095F619980C433)
    return np.uint64((bits >> np.uint64(52)) | np.uint64(0x4330000000000000)).view(np.float64) - 4503599627371519.0


def _significand(x):
    bits = np.float64(x).view(np.uint64) + np.uint64(0x00095F619980C433)
    return np.uint64((bits & np.uint64(0x000FFFFFFFFFFFFF)) + np.uint64(0x3FE6A09E667F3BCD)).view(np.float64)


OPTIONS = {"error_model": "numpy", "forceinline": True}
"""Compiler options of every function that a step function calls: 1/0 is infinite, and calls are inlined."""

KNOWN = (0, 69)
"""The first version of numba with which our pipelines were not checked."""


def _pipeline(module: str, name: str) -> Any:
    """Return one of our pipelines, which use private parts of numba; None, with a warning, if these may have changed."""
    reason = f"it is newer than numba {KNOWN[0]}.{KNOWN[1] - 1}, the newest that this bayesftc supports"
    if numba.version_info.short < KNOWN:
        try:
            return getattr(import_module(f"bayesftc.cosim.stepping.{module}"), name)
        except (ImportError, AttributeError) as error:
            reason = f"its private parts have changed ({error})"
    warn_user(
        f"numba {numba.__version__} compiles step functions without this package's pipeline, as {reason}. The numbers are the "
        "same, but compiling takes longer, and runs may be slower. Install a newer bayesftc, or "
        f"'numba<{KNOWN[0]}.{KNOWN[1]}'."
    )
    return None


if callee := _pipeline("numba_callee", "Callee"):
    OPTIONS |= {"pipeline_class": callee, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

_IMPLEMENTATIONS = {f: f for f in vars(elementary).values() if isinstance(f, FunctionType)}
_IMPLEMENTATIONS |= {f: globals()[f"_{name}"] for name, f in ops.BITS.items()}
_IMPLEMENTATIONS |= {getattr(ops, name): globals().get(f"_{name}") for name in ops.NAMES}
_IMPLEMENTATIONS |= {getattr(ops, name): _of_library(name) for name in ops.OF_LIBRARY}
_IMPLEMENTATIONS |= {getattr(ops, name): function for name, function in ops.COMPOSED.items()}
for _function, _implementation in _IMPLEMENTATIONS.items():
    extending.overload(_function, jit_options=OPTIONS, strict=False)(
        lambda *arguments, implementation=_implementation: implementation
    )
