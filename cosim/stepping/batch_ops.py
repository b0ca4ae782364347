"""Batch versions of the functions of :mod:`bayesftc.cosim.ops`, for step functions that work on many runs at once.

Each element of an array is then itself an array with an entry for each run. Every operation rounds as its scalar version does,
except `exp`, `log`, `sin` and `cos`: there NumPy may differ from the C library in the last bit.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.tracing import rebound


def _select(condition: Any, a: Any, b: Any) -> Any:
    return np.where(condition, a, 0.0) + np.where(condition, 0.0, b)


_BATCH: dict[str, Callable[..., Any]] = {
    "both": np.logical_and,
    "either": np.logical_or,
    "isnan": np.isnan,
    "negate": np.logical_not,
    "select": _select,
}
_BATCH |= {name: getattr(np, name) for name in ops.OF_LIBRARY}
_COMPOSED = {name: rebound(getattr(ops, name), _BATCH) for name in ops.COMPOSED}

OPERATIONS: dict[str, Callable[..., Any]] = {name: (_BATCH | _COMPOSED)[name] for name in ops.NAMES}
"""For each name in `ops.NAMES` a function of arrays with an entry for each run, and of numbers."""
