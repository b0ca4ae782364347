"""Replacements for names that a step function may not use."""

from __future__ import annotations

import dis
from types import FunctionType, ModuleType
from typing import Any

from bayesftc.cosim import ops

INDEX = "write a loop: for k in range(n): x[k] = ops.select(k == place, new, x[k])"
"""How to write an element whose place is a float, such as one kept in the state."""

_SAME = {name: f"ops.{name}" for name in ops.NAMES}
_INSTEAD = _SAME | {
    "abs": "ops.absolute",
    "all": "a loop",
    "any": "a loop",
    "array": "a state, a parameter or scratch space of the block",
    "bool": "a comparison",
    "clip": "ops.minimum and ops.maximum",
    "dot": "loops",
    "empty": "scratch space of the block",
    "enumerate": "range(len(...))",
    "fabs": "ops.absolute",
    "float": "the number itself: all are floats",
    "fmax": "ops.maximum",
    "fmin": "ops.minimum",
    "int": f"ops.floor, which gives a float. For an index, {INDEX}",
    "matmul": "loops",
    "max": "ops.maximum",
    "min": "ops.minimum",
    "open": "a parameter of the block with the content of the file",
    "pi": "a parameter of the block, or a number of the file: PI = math.pi",
    "pow": "ops.square, ops.sqrt, ops.exp or products",
    "power": "ops.square, ops.sqrt, ops.exp or products",
    "print": "an output of the block",
    "round": "ops.floor(x + 0.5)",
    "sum": "a loop",
    "tan": "ops.sin and ops.cos",
    "tanh": "ops.exp",
    "trunc": "ops.floor",
    "where": "ops.select",
    "zeros": "scratch space of the block",
    "zip": "range(len(...))",
}


def line_of(function: FunctionType, name: str) -> int:
    """Return the line in which a function first reads a global or enclosing name."""
    for instruction in dis.get_instructions(function.__code__):
        if instruction.argval == name and instruction.positions and instruction.positions.lineno:
            return instruction.positions.lineno
    return function.__code__.co_firstlineno


def instead_of(function: FunctionType, name: str, value: Any) -> str:
    """Return a sentence with the replacement for a name that a step function may not use; empty if there is none."""
    if isinstance(value, type) and issubclass(value, BaseException):
        return " Errors cannot be raised or caught; use ops.select, or return NaN."
    if not callable(value) and not isinstance(value, ModuleType):
        return " Give its content to the step function as a parameter of the block."
    if isinstance(value, ModuleType):
        member = _member(function, name)
        if value.__name__.partition(".")[0] == "random" or member == "random":
            return ' Random numbers are inputs: Port("noise", draw="normal").'
        replacement, original = _INSTEAD.get(member), f"{name}.{member}"
    else:
        replacement, original = _INSTEAD.get(name), name
    return f" Instead of {original} use {replacement}." if replacement else ""


def _member(function: FunctionType, module: str) -> str:
    """Return the first attribute of a module that a function uses."""
    before = None
    for instruction in dis.get_instructions(function.__code__):
        if before == module and instruction.opname in {"LOAD_ATTR", "LOAD_METHOD"}:
            return str(instruction.argval)
        before = instruction.argval
    return ""
