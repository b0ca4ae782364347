"""The layout of a diagram's memory, one flat array: each block's state and scratch, parameters, inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.diagram.contract import RESERVED
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats, Kernel, argument_names

if TYPE_CHECKING:
    from collections.abc import Mapping

Sections = dict[str, tuple[str, int, tuple[int, ...]]]
"""For each argument of a step function: its section, its offset in that section, its shape."""

TABLE = 32
"""Number of places for the table of addresses of an external block."""

SECTIONS = ("state", "parameters", "inputs", "outputs")


@dataclass(frozen=True)
class Slots:
    """The beginning of each section of a node in memory, and the place and shape of each named array."""

    start: dict[str, int]
    sections: Sections

    def offset(self, name: str) -> int:
        """Return the place in memory of the first element of a named array."""
        section, offset, _ = self.sections[name]
        return self.start[section] + offset


def arrange(block: Block, definition: Definition | None, begin: int) -> tuple[Slots, Floats]:
    """Lay out one block's sections from place `begin` on; return the places and the initial values.

    The parameters of an external block, which has no definition, are its table of addresses.
    """
    groups: dict[str, Iterable[tuple[str, Floats]]] = {
        "state": [*_arrays(definition.state), *_arrays(definition.scratch)] if definition else (),
        "parameters": _arrays(definition.parameters) if definition else [("<table>", np.zeros(TABLE))],
        "inputs": [(p.name, _filled(p, 0.0 if p.default is None else p.default)) for p in block.inputs],
        "outputs": [(p.name, _filled(p, np.nan)) for p in block.outputs],
    }
    start: dict[str, int] = {}
    sections: Sections = {}
    pieces: list[Floats] = []
    for section in SECTIONS:
        start[section], offset = begin, 0
        for name, array in groups[section]:
            if name in sections or (definition is not None and name in RESERVED):
                raise KernelError(
                    f"{type(block).__name__} uses the name {name!r} twice among its ports, states, parameters and scratch arrays "
                    f"({', '.join(sorted(RESERVED))} are reserved): rename one."
                )
            sections[name] = (section, offset, array.shape)
            pieces.append(array.ravel())
            offset += array.size
        begin += offset
        if section in {"inputs", "outputs"}:
            sections.setdefault(section, (section, 0, (offset,)))
    return Slots(start, sections), np.concatenate([np.zeros(0), *pieces])


def bind(kernel: Kernel, slots: Slots, memory: Floats) -> Callable[[float, int], None]:
    """Return the plain Python step function with views of memory as its arguments; it still takes ``t`` and ``k``."""
    views: list[Any] = []
    for name in argument_names(kernel):
        if name in {"t", "k"}:
            views.append(name)
        else:
            shape = slots.sections[name][2]
            start = slots.offset(name)
            views.append(memory[start : start + prod(shape)].reshape(shape))

    def step(t: float, k: int) -> None:
        # NumPy's numbers, like array elements: a division by zero gives an infinity, as in compiled code.
        now = {"t": np.float64(t), "k": np.int64(k)}
        try:
            kernel(*[now[v] if isinstance(v, str) else v for v in views])
        except ZeroDivisionError:
            raise KernelError(
                f"Step function {kernel.__name__!r} divides a plain Python number by a plain zero, where compiled code gives "
                "an infinity; take one of the two numbers from an array."
            ) from None

    return step


def _arrays(values: Mapping[str, object]) -> list[tuple[str, Floats]]:
    return [(name, np.atleast_1d(np.asarray(value, dtype=np.float64))) for name, value in values.items()]


def _filled(port: Port, value: float | tuple[Any, ...]) -> Floats:
    return np.full(port.shape or (1,), value, dtype=np.float64)
