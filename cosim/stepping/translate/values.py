"""Expressions of C: their text, their kind, and the precedence of their outermost operator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from bayesftc.cosim.stepping.translate.kinds import BOOL, FLOAT, NATURAL, Constant, Kind, Number, as_number

ATOM, UNARY, PRODUCT, SUM, ORDER, EQUAL, AND, OR, CHOICE = range(9)
"""Precedence of operators in C."""


@dataclass(frozen=True)
class Value:
    """An expression of C and its kind.

    Parameters
    ----------
    text : str
        Its text; empty for values that exist only during translation, such as functions.
    kind : Kind
        Its kind.
    level : int
        Precedence of its outermost operator.
    roots : frozenset of str
        For an array, the arguments of which it may be a part.
    """

    text: str
    kind: Kind
    level: int = ATOM
    roots: frozenset[str] = frozenset()


def literal(value: Any) -> str:
    """Return a number as C text that preserves every bit."""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value) if abs(value) < 2**31 else f"INT64_C({value})"
    if math.isnan(value):
        return "(double)NAN"
    return repr(value) if math.isfinite(value) else ("HUGE_VAL" if value > 0 else "-HUGE_VAL")


def constant(value: Any) -> Value:
    """Return a constant value."""
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
    """Return a truth value as a whole number of 64 bits, as in Python's arithmetic; return other values unchanged."""
    if isinstance(value.kind, Constant):
        return constant(int(value.kind.value)) if isinstance(value.kind.value, bool) else value
    return Value(f"(int64_t){enclosed(value, UNARY)}", NATURAL, UNARY) if value.kind == BOOL else value


def as_kind(value: Value, kind: Kind) -> Value:
    """Return a value converted to a kind."""
    if kind == FLOAT:
        return as_float(value)
    return as_whole(value) if isinstance(kind, Number) and kind.type == "int" else value


def enclosed(value: Value, level: int) -> str:
    """Return the text of an operand, in parentheses if an operator of precedence `level` needs them."""
    return value.text if value.level <= level else f"({value.text})"
