"""Expressions of C on their way: their text, what they are, and how tightly their outermost operator binds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from bayesftc.cosim.stepping.translate.kinds import BOOL, FLOAT, NATURAL, Constant, Kind, Number, as_number

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
    roots : frozenset of str
        Of an array, the arguments whose numbers it may be part of.
    """

    text: str
    kind: Kind
    level: int = ATOM
    roots: frozenset[str] = frozenset()


def literal(value: Any) -> str:
    """Return a number as C reads it back, to the last bit."""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value) if abs(value) < 2**31 else f"INT64_C({value})"
    if math.isnan(value):
        return "(double)NAN"
    return repr(value) if math.isfinite(value) else ("HUGE_VAL" if value > 0 else "-HUGE_VAL")


def constant(value: Any) -> Value:
    """Return a value that is known now."""
    kind = Constant(value)
    if as_number(kind) is None:
        return Value("", kind)
    text = literal(value)
    return Value(text, kind, UNARY if text.startswith(("-", "(")) else ATOM)


def as_float(value: Value) -> Value:
    """Return a number as a double."""
    if isinstance(value.kind, Constant):
        return constant(float(value.kind.value))
    kind = as_number(value.kind)
    if kind is None or kind.type == "float":
        return value
    return Value(f"(double){enclosed(value, UNARY)}", FLOAT, UNARY)


def as_whole(value: Value) -> Value:
    """Return a truth value as a whole number of 64 bits, which it is when Python counts with it; others as they are."""
    if isinstance(value.kind, Constant):
        return constant(int(value.kind.value)) if isinstance(value.kind.value, bool) else value
    return Value(f"(int64_t){enclosed(value, UNARY)}", NATURAL, UNARY) if value.kind == BOOL else value


def as_kind(value: Value, kind: Kind) -> Value:
    """Return a value as what is to hold it."""
    if kind == FLOAT:
        return as_float(value)
    return as_whole(value) if isinstance(kind, Number) and kind.type == "int" else value


def enclosed(value: Value, level: int) -> str:
    """Return the text of an operand for an operator that binds as tightly as `level`."""
    return value.text if value.level <= level else f"({value.text})"
