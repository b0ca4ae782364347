"""The minimal state of a diagram: the places in memory that a step reads before it writes them.

Scratch of a block is no state. A declared state that is always written before it is read is no state either. A step function
never branches on data, so that observing one step is sufficient.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.cosim.diagram.diagram import is_external
from bayesftc.cosim.diagram.memory import Slots
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.types import Floats, Kernel, argument_names

Places = np.ndarray[Any, np.dtype[np.int64]]


def state_places(schedule: Schedule) -> list[tuple[int, str]]:
    """Return the places in memory whose values pass from a step to the next, each with its name (``car.x[0]``).

    The states of external blocks are not in memory. For a block that runs at every n-th step, the outputs are included, because
    other blocks read them in between.
    """
    places: list[tuple[int, str]] = []
    for i, (node, slots) in enumerate(zip(schedule.nodes, schedule.slots, strict=True)):
        carried = set() if is_external(node) else _carried(schedule, i)
        outputs = slots.start["outputs"]
        held = set(
            range(outputs, outputs + sum(port.size for port in node.block.outputs) if node.every > 1 else outputs)
        )
        for name, (section, _, shape) in slots.sections.items():
            if name in {"inputs", "outputs"}:
                continue  # the same places as those of the ports
            begin, size = slots.offset(name), int(np.prod(shape))
            for j in range(size if section in {"state", "outputs"} else 0):
                if begin + j in carried | held:
                    index = f"[{','.join(map(str, np.unravel_index(j, shape)))}]" if size > 1 else ""
                    kept = "_held" if begin + j in held else ""
                    places.append((begin + j, f"{node.name}.{name}{kept}{index}"))
    return places


def _carried(schedule: Schedule, i: int) -> set[int]:
    definition, slots = schedule.definitions[i], schedule.slots[i]
    assert definition is not None
    everything = {
        slots.offset(name) + j
        for name, (section, _, shape) in slots.sections.items()
        if section == "state" and name not in definition.scratch
        for j in range(int(np.prod(shape)))
    }
    if not definition.compiled:
        return everything  # Python code may use its arrays in any way
    watch, memory = _Watch(), schedule.initial.copy()
    try:
        with np.errstate(all="ignore"):
            for kernel in (definition.output, definition.update):
                if kernel is not None:
                    kernel(*_arguments(kernel, slots, memory, watch))
    except Exception:  # noqa: BLE001 - a step function that cannot be observed may still be valid
        return everything
    return watch.carried & watch.written


def _arguments(kernel: Kernel, slots: Slots, memory: Floats, watch: _Watch) -> list[Any]:
    arguments: list[Any] = []
    for name in argument_names(kernel):
        if name in {"t", "k"}:
            arguments.append(np.float64(0.0) if name == "t" else np.int64(0))
            continue
        shape, begin = slots.sections[name][2], slots.offset(name)
        size = int(np.prod(shape))
        array = memory[begin : begin + size].reshape(shape).view(_Watched)
        array.watch, array.places = watch, np.arange(begin, begin + size).reshape(shape)
        arguments.append(array)
    return arguments


class _Watch:
    """Records reads and writes of memory."""

    def __init__(self) -> None:
        self.carried: set[int] = set()
        self.written: set[int] = set()

    def read(self, places: Any) -> None:
        self.carried |= set(np.ravel(places).tolist()) - self.written

    def write(self, places: Any) -> None:
        self.written |= set(np.ravel(places).tolist())


class _Watched(np.ndarray):  # type: ignore[type-arg]
    """An array that records reads and writes; if it, or a part of it, is used as a whole, that counts as both."""

    watch: _Watch | None = None
    places: Places

    def __getitem__(self, index: Any) -> Any:
        if self.watch is None:
            return super().__getitem__(index)
        places = self.places[index]
        self.watch.read(places)
        if np.ndim(places):
            self.watch.write(places)
        return self.view(np.ndarray)[index]

    def __setitem__(self, index: Any, value: Any) -> None:
        if self.watch is not None:
            self.watch.write(self.places[index])
        self.view(np.ndarray)[index] = value

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*map(_plain, inputs), **options)


def _plain(value: Any) -> Any:
    if isinstance(value, _Watched) and value.watch is not None:
        value.watch.read(value.places)
        value.watch.write(value.places)
        return value.view(np.ndarray)
    return value
