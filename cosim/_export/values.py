"""Expressions of C on their way: their text, what they are, and how tightly their outermost operator binds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from bayesftc.cosim._export.kinds import Constant, Kind, as_number

ATOM, UNARY, PRODUCT, SUM, ORDER, EQUAL, AND, OR, CHOICE = range(9)
"""How tightly an operator binds, as C has it."""


@dataclass(frozen=True)
class Value:
    """An expression of C, and what it is.

    Parameters
    ----------
    text : str
        Its text; empty for what only has a meaning while the C is written, such as a function.
    kind : Kind
        What it is.
    level : int
        How tightly its outermost operator binds.
    root : str or None
        Of an array, the argument whose numbers it is part of.
    """

    text: str
    kind: Kind
    level: int = ATOM
    root: str | None = None


def literal(value: Any) -> str:
    """Return a number as C reads it back, to the last bit."""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value) if abs(value) < 2**31 else f"INT64_C({value})"
    if math.isnan(value):
        return "NAN"
    return repr(value) if math.isfinite(value) else ("INFINITY" if value > 0 else "-INFINITY")


def constant(value: Any) -> Value:
    """Return a value that is known now."""
    kind = Constant(value)
    if as_number(kind) is None:
        return Value("", kind)
    text = literal(value)
    return Value(text, kind, UNARY if text.startswith("-") else ATOM)


def enclosed(value: Value, level: int) -> str:
    """Return the text of an operand for an operator that binds as tightly as `level`."""
    return value.text if value.level <= level else f"({value.text})"
