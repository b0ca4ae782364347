"""The kinds of values in a step function: the types of the Python subset that is translated to C."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Number:
    """A number that the running program computes.

    Parameters
    ----------
    type : {"float", "int", "bool"}
        A float64, a whole number (64 bits) or a truth value.
    natural : bool
        Whether a whole number is certainly not negative.
    """

    type: str
    natural: bool = False

    @property
    def c(self) -> str:
        """Its type in C."""
        return {"float": "double", "int": "int64_t", "bool": "int"}[self.type]


@dataclass(frozen=True)
class Array:
    """An array of float64, by its shape."""

    shape: tuple[int, ...]
    c = "double *"

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)


@dataclass(frozen=True)
class Record:
    """Several numbers, returned by a function."""

    items: tuple[Number, ...]

    @property
    def c(self) -> str:
        """Its type in C."""
        return "Record_" + "".join(item.type[0] for item in self.items)


@dataclass(frozen=True)
class Constant:
    """A value that is known at translation: a number, a tuple of such, a function, a module."""

    value: Any

    def __hash__(self) -> int:
        return hash((type(self.value), repr(self.value)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and same(self.value, other.value)


def same(a: Any, b: Any) -> bool:
    """Return whether two constants are equal and of the same type; NaN equals NaN."""
    if a is b:
        return True
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and repr(a) == repr(b)


Kind = Number | Array | Record | Constant

FLOAT, INT, BOOL, NATURAL = Number("float"), Number("int"), Number("bool"), Number("int", natural=True)


def number_of(value: Any) -> Number | None:
    """Return the kind of a constant number; None if it is no number."""
    if isinstance(value, bool):
        return BOOL
    if isinstance(value, np.generic):
        return number_of(value.item())
    if isinstance(value, int):
        return NATURAL if value >= 0 else INT
    return FLOAT if isinstance(value, float) else None


def as_number(kind: Kind) -> Number | None:
    """Return the kind of a number; None if it is no number."""
    if isinstance(kind, Number):
        return kind
    return number_of(kind.value) if isinstance(kind, Constant) else None


def joined(a: Kind, b: Kind) -> Kind | None:
    """Return the kind of a variable for values of both kinds; None if there is none."""
    if a == b and not isinstance(a, Constant):
        return a
    left, right = as_number(a), as_number(b)
    if left is None or right is None:
        return None
    if left.type == right.type:
        return replace(left, natural=left.natural and right.natural)
    if "float" in {left.type, right.type}:
        return FLOAT
    return replace(INT, natural=all(n.natural or n.type == "bool" for n in (left, right)))
