"""numba's implementations of the functions of :mod:`bayesftc.cosim.ops`; imported only for compiling."""

from importlib import import_module
from typing import Any

import numba
import numpy as np
from numba import extending

from bayesftc.cosim import ops
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

_IMPLEMENTATIONS = {name[1:]: value for name, value in globals().items() if name[1:] in ops.NAMES}
_IMPLEMENTATIONS |= {name: _of_library(name) for name in ops.OF_LIBRARY}
_IMPLEMENTATIONS |= {name: getattr(ops, name) for name in ops.COMPOSED}
for _name in ops.NAMES:
    extending.overload(getattr(ops, _name), jit_options=OPTIONS, strict=False)(
        lambda *arguments, implementation=_IMPLEMENTATIONS[_name]: implementation
    )
