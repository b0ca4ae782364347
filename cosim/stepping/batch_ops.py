"""Batch versions of the functions of :mod:`bayesftc.cosim.ops`, for step functions that work on many runs at once.

Each element of an array is then itself an array with an entry for each run. Every operation rounds as its scalar version does.
NumPy's exponential and the like do not, so a compiled loop calls the scalar versions of these.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.compiler import compile_function
from bayesftc.cosim.stepping.tracing import rebound


def _select(condition: Any, a: Any, b: Any) -> Any:
    return np.where(condition, a, 0.0) + np.where(condition, 0.0, b)


def _one_by_one(operation: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that applies an operation to each element by compiled code."""

    def fill(x, y):  # type: ignore[no-untyped-def]
        for i in range(x.shape[0]):
            y[i] = operation(x[i])

    def apply(x: Any) -> Any:
        flat = np.ascontiguousarray(x, float).ravel()
        result = np.empty_like(flat)
        compile_function(fill, "void(float64[::1], float64[::1])")(flat, result)
        return result.reshape(np.shape(x))[()]

    return apply


_BATCH: dict[str, Callable[..., Any]] = {
    "both": np.logical_and,
    "either": np.logical_or,
    "isnan": np.isnan,
    "negate": np.logical_not,
    "select": _select,
}
_BATCH |= {name: getattr(np, name) for name in ops.OF_LIBRARY}
_BATCH |= {name: _one_by_one(getattr(ops, name)) for name in ("cos", "exp", "log", "sin")}
_COMPOSED = {name: rebound(function, _BATCH) for name, function in ops.COMPOSED.items() if name not in _BATCH}

OPERATIONS: dict[str, Callable[..., Any]] = {name: (_BATCH | _COMPOSED)[name] for name in ops.NAMES}
"""For each name in `ops.NAMES` a function of arrays with an entry for each run, and of numbers."""
