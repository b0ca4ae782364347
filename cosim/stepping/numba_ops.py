"""What numba puts in place of each function of :mod:`bayesftc.cosim.ops`; imported only when something is compiled."""

from importlib import import_module
from typing import Any

import numba
import numpy as np
from numba import extending

from bayesftc.cosim import ops
from bayesftc.cosim.base.warnings_shown import warn_user


def _of_library(name: str) -> Any:
    """Return a function of C's library, which CPython calls too; where that raises, this returns what IEEE 754 says."""
    function = getattr(np, name)
    return lambda x: function(x)


def _select(condition, a, b):
    return (float(a) if condition else float(b)) + 0.0  # the same number as from two terms, in half the operations


def _both(a, b):
    return bool(a) & bool(b)


def _either(a, b):
    return bool(a) | bool(b)


def _negate(a):
    return not a


def _isnan(x):
    return x != x


OPTIONS = {"error_model": "numpy", "forceinline": True}
"""How every function called from a step function is compiled: 1/0 is infinite, and calls cost nothing."""

KNOWN = (0, 69)
"""The first version of numba whose inside nobody has compared with what our pipelines expect of it."""


def _pipeline(module: str, name: str) -> Any:
    """Return one of our pipelines, which take numba's inside for granted; None, with a warning, where that may be another."""
    reason = f"it is newer than what this bayesftc knows, numba {KNOWN[0]}.{KNOWN[1] - 1}"
    if numba.version_info.short < KNOWN:
        try:
            return getattr(import_module(f"bayesftc.cosim.stepping.{module}"), name)
        except (ImportError, AttributeError) as error:
            reason = f"its inside is not as expected ({error})"
    warn_user(
        f"numba {numba.__version__} compiles step functions in its own way, as {reason}: the numbers are the same, but compiling "
        f"takes longer, and runs may. Take a newer bayesftc, or 'numba<{KNOWN[0]}.{KNOWN[1]}'."
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
