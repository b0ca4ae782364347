"""What stands for each function of :mod:`bayesftc.cosim.ops` while a step function works on many runs at once.

Each element of its arrays is then itself an array with an entry for each run. Every operation rounds as its plain form does, but
for `exp`, `log`, `sin` and `cos`, where NumPy may differ from the C library in the last bit.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bayesftc.cosim import ops


def _select(condition: Any, a: Any, b: Any) -> Any:
    return np.where(condition, a, 0.0) + np.where(condition, 0.0, b)


_BATCH: dict[str, Callable[..., Any]] = {
    "absolute": np.abs,
    "both": np.logical_and,
    "cos": np.cos,
    "either": np.logical_or,
    "exp": np.exp,
    "floor": np.floor,
    "isnan": np.isnan,
    "log": np.log,
    "maximum": lambda a, b: _select(np.greater(a, b), a, b),
    "minimum": lambda a, b: _select(np.less(a, b), a, b),
    "negate": np.logical_not,
    "select": _select,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "square": lambda x: x * x,
}

OPERATIONS: dict[str, Callable[..., Any]] = {name: _BATCH[name] for name in ops.NAMES}
"""For each name in `ops.NAMES` a function of arrays with an entry for each run, and of numbers."""
