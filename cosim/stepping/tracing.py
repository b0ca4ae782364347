"""Step functions run on symbols: a copy of a function, and of all it calls, that takes its mathematics from elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import CellType, FunctionType, SimpleNamespace
from typing import Any

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.fingerprint import references


def rebound(function: Callable[..., Any], operations: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    """Return a copy of a step function in which the `operations` stand for those of `bayesftc.cosim.ops`.

    Parameters
    ----------
    function : function
        A step function, or a function that one calls.
    operations : mapping of str to function
        A function for each name in `ops.NAMES` that is called.
    """
    given = {getattr(ops, name): operation for name, operation in operations.items()}
    namespace = SimpleNamespace(**operations)
    copies: dict[FunctionType, FunctionType] = {}

    def replacement(value: Any) -> Any:
        if value is ops:
            return namespace
        if isinstance(value, FunctionType):
            return given.get(value) or copy(value)
        return value

    def copy(original: FunctionType) -> FunctionType:
        if original in copies:
            return copies[original]
        names: dict[str, Any] = {}
        cells = {name: CellType() for name in original.__code__.co_freevars}
        made = FunctionType(
            original.__code__, names, original.__name__, original.__defaults__, tuple(cells.values()) or None
        )
        copies[original] = made  # before what it calls is copied, for that may call it again
        for name, value in references(original):
            if name in cells:
                cells[name].cell_contents = replacement(value)
            else:
                names[name] = replacement(value)
        return made

    assert isinstance(function, FunctionType)
    return copy(function)
