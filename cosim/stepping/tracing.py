"""Step functions that run on symbols: copies of a function, and of all functions that it calls, with other operations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import CellType, FunctionType, SimpleNamespace
from typing import Any

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.fingerprint import references


def rebound(function: Callable[..., Any], operations: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    """Return a copy of a step function in which `operations` replace those of `bayesftc.cosim.ops`.

    Parameters
    ----------
    function : function
        A step function, or a function that one calls.
    operations : mapping of str to function
        A function for each called name in `ops.NAMES`.
    """
    replacements = {getattr(ops, name): operation for name, operation in operations.items()}
    namespace = SimpleNamespace(**operations)
    copies: dict[FunctionType, FunctionType] = {}

    def replacement(value: Any) -> Any:
        if value is ops:
            return namespace
        if isinstance(value, FunctionType):
            return replacements.get(value) or copy(value)
        return value

    def copy(original: FunctionType) -> FunctionType:
        if original in copies:
            return copies[original]
        names: dict[str, Any] = {}
        cells = {name: CellType() for name in original.__code__.co_freevars}
        result = FunctionType(
            original.__code__, names, original.__name__, original.__defaults__, tuple(cells.values()) or None
        )
        copies[original] = result  # before its callees are copied, as they may call it again
        for name, value in references(original):
            if name in cells:
                cells[name].cell_contents = replacement(value)
            else:
                names[name] = replacement(value)
        return result

    assert isinstance(function, FunctionType)
    return copy(function)
