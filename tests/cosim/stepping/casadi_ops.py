"""What stands for each function of :mod:`bayesftc.cosim.ops` while a step function is traced with CasADi's symbols.

Trace between ``ca.GlobalOptions.setSimplificationOnTheFly(False)`` and ``True``: else ``x != x`` becomes 0 (a missing
sample would no longer be missed) and ``(a - b) + b`` becomes ``a``. CasADi's ``if_else`` is ``(c ? a : 0) + (!c ? b : 0)``,
as `ops.select` is. C code needs ``-ffp-contract=off`` to round as the other forms do.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca

from bayesftc.cosim import ops


def _select(condition: Any, a: Any, b: Any) -> Any:
    return ca.if_else(condition if isinstance(condition, ca.SX) else ca.SX(float(bool(condition))), a, b)


_SYMBOLIC: dict[str, Callable[..., Any]] = {
    "absolute": ca.fabs,
    "both": ca.logic_and,
    "cos": ca.cos,
    "either": ca.logic_or,
    "exp": ca.exp,
    "floor": ca.floor,
    "isnan": lambda x: ca.ne(x, x),
    "log": ca.log,
    "maximum": lambda a, b: _select(ca.gt(a, b), a, b),
    "minimum": lambda a, b: _select(ca.lt(a, b), a, b),
    "negate": ca.logic_not,
    "select": _select,
    "sin": ca.sin,
    "sqrt": ca.sqrt,
    "square": lambda x: x * x,
}


def _operation(name: str) -> Callable[..., Any]:
    def operation(*arguments: Any) -> Any:
        symbols = any(isinstance(a, ca.SX) for a in arguments)
        return (_SYMBOLIC[name] if symbols else getattr(ops, name))(*arguments)

    return operation


OPERATIONS: dict[str, Callable[..., Any]] = {name: _operation(name) for name in ops.NAMES}
"""For each name in `ops.NAMES` a function that takes symbols, and numbers as ever."""
