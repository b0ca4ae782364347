"""Step functions run on sets: each number is what it was computed from, and an operation unites its operands.

A number that is known stays a number, so that `select` and a factor of zero among the parameters drop what they drop whenever
the step function runs (for finite numbers: zero times a missing sample is missing). A zero in the text of the step function
drops nothing: it is there just to hand on that something is missing.
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
"""A step function that makes more operations is not followed: that would take seconds."""


class TooLong(Exception):
    """A step function makes too many operations."""


class Origins:
    """A number that is not known now, and what it was computed from.

    Parameters
    ----------
    of : int
        A set, as the bits of a whole number.
    """

    __slots__ = ("of",)
    __array_ufunc__ = None  # numpy's scalars leave arithmetic to this class
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
        raise TypeError("what is not known cannot be branched on")

    __add__ = __radd__ = __sub__ = __rsub__ = __truediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = _with
    __lt__ = __le__ = __gt__ = __ge__ = _with
    __eq__ = __ne__ = _with  # type: ignore[assignment]
    __mul__ = __rmul__ = _times
    __rtruediv__ = _into
    __neg__ = __pos__ = __abs__ = _alone


def _operation(name: str) -> Callable[..., Any]:
    real = getattr(ops, name)

    def operation(*arguments: Any) -> Any:
        found = None
        for argument in arguments:
            if isinstance(argument, Origins):
                found = argument if found is None else found._with(argument)
        return real(*arguments) if found is None else found

    return operation


def _select(condition: Any, a: Any, b: Any) -> Any:
    if isinstance(condition, Origins):
        return condition._with(a)._with(b)
    return a if condition else b


_OPERATIONS: Mapping[str, Callable[..., Any]] = {name: _operation(name) for name in ops.NAMES} | {"select": _select}


def origins(value: Any) -> int:
    """Return what a number was computed from; nothing, if it is known."""
    return value.of if isinstance(value, Origins) else 0


def run(kernel: Kernel, slots: Slots, memory: Memory) -> None:
    """Run a step function on memory in which numbers are `Origins` or known.

    If it branches on what is not known, or takes too long, its outputs are computed from all that it reads.
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
