"""Ports of an FMU in groups of one type: one FMI call reads or sets a group, with exact conversion to and from float64."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from bayesftc.cosim.fmi.binaries.codes import EXACT
from bayesftc.cosim.fmi.binaries.guards import Guarded
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.reading.versions import prefix
from bayesftc.cosim.types import Floats

VALUES2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
VALUES3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t
)
MAY_ROUND, ROUNDED = 1, 2
"""States of a 64-bit whole number that does not fit a double: it may be rounded (0: it stops the run), and it was rounded."""

_WIDE = 8
_FLOAT32_MAX = float(np.finfo(np.float32).max)
_DTYPES = (
    "f8",
    "f4",
    "i1",
    "u1",
    "i2",
    "u2",
    "i4",
    "u4",
    "i8",
    "u8",
)  # in the order of the codes of typed_kernels


@dataclass(frozen=True)
class NumericType:
    """The memory layout and the range of a numeric type.

    Attributes
    ----------
    code : int
        Code of the type in `bayesftc.cosim.fmi.running.typed_kernels`.
    low, limit : float
        The least number and, for whole numbers, the first that is too large; for a Float32, the largest.
    negated : bool
        Whether the memory contains the negative of the value.
    """

    code: int
    low: float
    limit: float
    negated: bool = False

    @property
    def plain(self) -> bool:
        """Whether values need no conversion for the engine."""
        return self.code == 0 and not self.negated

    @property
    def is_wide(self) -> bool:
        """Whether its values are whole numbers of 64 bits, which may not fit a double."""
        return self.code >= _WIDE

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its buffers."""
        return np.dtype(_DTYPES[self.code])

    def misfit(self, values: Floats) -> int:
        """Return the index of the first value that does not fit the type, or -1."""
        if self.code == 0:
            return -1
        if self.code == 1:
            bad = np.isfinite(values) & ((values < self.low) | (values > self.limit))
        else:
            bad = ~((values >= self.low) & (values < self.limit) & (values == np.floor(values)))
        return int(np.argmax(bad)) if bad.any() else -1


FLOAT64 = NumericType(0, -np.inf, np.inf)


def function_name(variable: FMUVariable, major: int, verb: str) -> str:
    """Return the FMI function that reads ("Get") or sets ("Set") a variable."""
    kind = {"Enumeration": "Int64" if major == 3 else "Integer"}.get(variable.type, variable.type)
    return f"{prefix(major)}{verb}{kind}"


def numeric_type(variable: FMUVariable, major: int) -> NumericType:
    """Return the numeric type of a variable; the range of an enumeration is from its least item to its largest."""
    kind = variable.type
    if kind in {"Real", "Float64"}:
        return replace(FLOAT64, negated=True) if variable.negated else FLOAT64
    if kind == "Float32":
        return NumericType(1, -_FLOAT32_MAX, _FLOAT32_MAX)
    if kind == "Boolean":
        return NumericType(_DTYPES.index("i4" if major == 2 else "u1"), 0.0, 2.0)
    name = {"Integer": "Int32", "Enumeration": "Int64" if major == 3 else "Int32"}.get(kind, kind)
    dtype = np.dtype(name.lower())
    limits = np.iinfo(dtype)
    low, high = limits.min, limits.max
    if variable.items:
        low, high = min(v for _, v in variable.items), max(v for _, v in variable.items)
    return NumericType(_DTYPES.index(dtype.str[1:]), float(low), float(high + 1), variable.negated)


class Group:
    """Ports of one type and variability, one after the other, with a buffer that is reused.

    Parameters
    ----------
    name : str
        The FMI function that reads or sets them.
    function : int
        Its address.
    kind : NumericType
        Their type.
    major : int
        1, 2 or 3: the version of FMI.
    references : sequence of int
        Their value references.
    begin, size : int
        Index of their first element among those of all inputs or outputs, and the number of elements.
    read : int
        For inputs that may only change at events: address of the FMI function that reads them; else 0.
    clocks : tuple of int
        Value references of their clocks, of which one must be active when they are set or read; empty if not clocked.
    """

    def __init__(
        self,
        name: str,
        function: int,
        kind: NumericType,
        major: int,
        references: Sequence[int],
        begin: int,
        size: int,
        read: int = 0,
        clocks: tuple[int, ...] = (),
    ):
        self.name, self.function, self.kind, self.major = name, function, kind, major
        self.begin, self.size, self.read, self.clocks = begin, size, read, clocks
        self.references = np.array(references, dtype=np.uint32)
        self.guarded = Guarded(max(size, 1), kind.dtype)
        self.buffer = self.guarded.values
        self.span = slice(begin, begin + size)
        self.rounding = np.zeros(max(size, 1) if kind.is_wide else 1, dtype=np.int64)

    def place(self) -> tuple[int, int, int, int]:
        """Return the addresses of the function and of the value references, their number, and the number of values."""
        return self.function, self.references.ctypes.data, len(self.references), self.size

    def words(self) -> list[int]:
        """Return the group in the layout of the compiled functions."""
        low, limit = (int(np.float64(x).view(np.int64)) for x in (self.kind.low, self.kind.limit))
        return [
            self.function,
            self.kind.code,
            self.references.ctypes.data,
            len(self.references),
            self.begin,
            self.size,
            self.buffer.ctypes.data,
            low,
            limit,
            int(self.discrete),
            self.read,
            int(self.kind.negated),
            self.rounding.ctypes.data,
        ]

    @property
    def discrete(self) -> bool:
        """Whether they may only change at events."""
        return self.read != 0

    @cached_property
    def _call(self) -> Callable[[int], int]:
        references, count, buffer = self.references.ctypes.data, len(self.references), self.buffer.ctypes.data
        call: Any = (VALUES3 if self.major == 3 else VALUES2)(self.function)
        size = (self.size,) if self.major == 3 else ()
        return lambda component: int(call(component, references, count, buffer, *size))

    def put(self, component: int, inputs: Floats) -> tuple[int, int]:
        """Set the group's inputs; return FMI's status, and the index of a value that does not fit the type, or -1."""
        values = -inputs[self.span] if self.kind.negated else inputs[self.span]
        bad = self.kind.misfit(values)
        if bad >= 0:
            return 0, self.begin + bad
        self.buffer[: self.size] = values
        return self._call(component), -1

    def take(self, component: int, outputs: Floats) -> tuple[int, int]:
        """Read the group's outputs; return FMI's status, and the index of a value that does not fit a double, or -1."""
        buffer, code = self.buffer[: self.size], self.kind.code
        if code == 0:
            buffer[:] = outputs[self.span]  # values that a failing FMU does not write stay, as in compiled code
        status = self._call(component)
        if code == 0 or status in {0, 1}:
            values = buffer.astype(np.float64)
            if self.kind.negated and status in {0, 1}:
                values = -values
            exact = (values > -EXACT) & (values < EXACT)
            if self.kind.is_wide and not exact.all():
                may_round = self.rounding != 0
                self.rounding[~exact & may_round] = ROUNDED
                if not (exact | may_round).all():
                    bad = int(np.argmin(exact | may_round))
                    outputs[self.begin : self.begin + bad + 1] = values[: bad + 1]
                    return status, self.begin + bad
            outputs[self.span] = values
        return status, -1

    def unwritten(self, component: int) -> int:
        """Return the index of the first output that the FMU does not write though it returns OK, or -1."""
        values = self.buffer[: self.size]
        unchanged = np.ones(self.size, dtype=bool)
        for filling in (0x5A, 0x25):
            values.view(np.uint8)[:] = filling
            before = values.copy()
            if self._call(component) not in {0, 1}:
                return -1
            unchanged &= values == before
        return self.begin + int(np.argmax(unchanged)) if unchanged.any() else -1

    def alone(self, reference: int, size: int) -> Group:
        """Return a group of a single variable."""
        return Group(self.name, self.function, self.kind, self.major, [reference], 0, size)

    def exceeds(self, component: int) -> bool:
        """Return whether the FMU writes beyond the group's buffer."""
        self._call(component)
        return not self.guarded.intact


def groups(
    variables: Sequence[FMUVariable],
    major: int,
    verb: str,
    address: Callable[[str], int],
    *,
    events: bool = False,
) -> list[Group]:
    """Return variables, in their order, as groups of one type.

    Parameters
    ----------
    variables : sequence of FMUVariable
        The ports of one side.
    major : int
        1, 2 or 3: the version of FMI.
    verb : {"Get", "Set"}
        Whether they are read or set.
    address : callable
        Returns the address of an FMI function by its name.
    events : bool
        Whether inputs that are not continuous may only change at events.
    """
    runs: list[tuple[tuple[str, NumericType, int, tuple[int, ...]], list[int], int, int]] = []
    begin = 0
    for variable in variables:
        size = prod(variable.shape)
        discrete = events and verb == "Set" and variable.variability != "continuous" and not variable.clocked
        read = address(function_name(variable, major, "Get")) if discrete else 0
        key = function_name(variable, major, verb), numeric_type(variable, major), read, variable.clocks
        if runs and runs[-1][0] == key:
            _, references, start, before = runs.pop()
            runs.append((key, [*references, variable.reference], start, before + size))
        else:
            runs.append((key, [variable.reference], begin, size))
        begin += size
    return [
        Group(name, address(name), kind, major, references, start, size, read, clocks)
        for (name, kind, read, clocks), references, start, size in runs
    ]


def type_range(variable: FMUVariable, major: int) -> tuple[float, float]:
    """Return the least and the largest number that fit the type of a variable."""
    kind = numeric_type(variable, major)
    return kind.low, kind.limit - (0.0 if kind.code < 2 else 1.0)


def element_names(variables: Sequence[FMUVariable]) -> list[tuple[str, FMUVariable]]:
    """Return the name, with its index, and the variable of every element of ports."""
    scalar, array = ((),), np.ndindex
    return [
        (v.name + "".join(f"[{i}]" for i in index), v)
        for v in variables
        for index in (array(*v.shape) if v.shape else scalar)
    ]
