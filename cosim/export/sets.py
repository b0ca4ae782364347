"""Step functions on sets: each number is replaced by its origins, and an operation unites the origins of its operands.

A constant stays a number, so that `select` and parameters of zero remove dependencies as they do in a run (for finite numbers:
zero times a missing sample is missing). A zero in the text of the step function removes none: its purpose is to pass on that
a sample is missing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim import ops
from bayesftc.cosim.diagram.memory import Slots
from bayesftc.cosim.stepping.tracing import rebound
from bayesftc.cosim.types import Kernel, argument_names

Memory = NDArray[Any]
"""An array of objects."""

MOST = 200_000
"""Most operations of a step function; following more would take seconds."""


class TooLong(Exception):
    """A step function makes too many operations."""


class Origins:
    """A number that is not constant, and its origins.

    Parameters
    ----------
    of : int
        A set, as the bits of a whole number.
    """

    __slots__ = ("of",)
    __array_ufunc__ = None  # makes NumPy's scalars use this class's operators
    __hash__ = None  # type: ignore[assignment]

    made = 0

    def __init__(self, of: int):
        self.of = of
        Origins.made += 1
        if Origins.made > MOST:
            raise TooLong

    def _with(self, other: Any) -> Origins:
        return Origins(self.of | other.of) if isinstance(other, Origins) else self

    def _times(self, other: Any) -> Any:
        return other if type(other) is np.float64 and other == 0.0 else self._with(other)

    def _into(self, other: Any) -> Any:
        """Return a number divided by this one."""
        return other if type(other) is np.float64 and other == 0.0 else self

    def _alone(self) -> Origins:
        return self

    def __bool__(self) -> NoReturn:
        raise TypeError("a number that is not constant cannot be used in a branch")

    __add__ = __radd__ = __sub__ = __rsub__ = __truediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = _with
    __lt__ = __le__ = __gt__ = __ge__ = _with
    __eq__ = __ne__ = _with  # type: ignore[assignment]
    __mul__ = __rmul__ = _times
    __rtruediv__ = _into
    __neg__ = __pos__ = __abs__ = _alone


def _operation(name: str) -> Callable[..., Any]:
    real = getattr(ops, name)

    def operation(*arguments: Any) -> Any:
        united = None
        for argument in arguments:
            if isinstance(argument, Origins):
                united = argument if united is None else united._with(argument)
        return real(*arguments) if united is None else united

    return operation


def _select(condition: Any, a: Any, b: Any) -> Any:
    if isinstance(condition, Origins):
        return condition._with(a)._with(b)
    return a if condition else b


_OPERATIONS: Mapping[str, Callable[..., Any]] = {name: _operation(name) for name in ops.NAMES} | {"select": _select}


def origins(value: Any) -> int:
    """Return the origins of a number; the empty set of a constant."""
    return value.of if isinstance(value, Origins) else 0


def run(kernel: Kernel, slots: Slots, memory: Memory) -> None:
    """Run a step function on memory of `Origins` and constants.

    If it branches on numbers that are not constant, or takes too long, its outputs depend on everything that it reads.
    """
    read = [name for name in argument_names(kernel) if name not in {"t", "k"}]
    before = 0
    for name in read:
        section, _, _ = slots.sections[name]
        if section != "outputs":
            for value in _view(name, slots, memory).flat:
                before |= origins(value)
    Origins.made = 0
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            views = {name: _view(name, slots, memory) for name in read}
            rest = {name: Origins(0) for name in argument_names(kernel) if name in {"t", "k"}}
            rebound(kernel, _OPERATIONS)(**views, **rest)
    except (TypeError, ArithmeticError, IndexError, ValueError, TooLong):
        Origins.made = 0
        anything = Origins(before)
        for name in read:
            if slots.sections[name][0] == "outputs":
                _view(name, slots, memory)[...] = anything


def _view(name: str, slots: Slots, memory: Memory) -> Memory:
    _, _, shape = slots.sections[name]
    begin = slots.offset(name)
    return memory[begin : begin + int(np.prod(shape, dtype=int))].reshape(shape)
