"""The inputs and parameters on which outputs depend at the same time, element by element."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.export.program import Program
from bayesftc.cosim.export.sets import Memory, Origins, origins, run
from bayesftc.cosim.export.signals import Signal, Tunable
from bayesftc.cosim.ports import labels

Elements = dict[str, tuple[frozenset[str], ...]]
"""For each element of each output, the elements of inputs and parameters."""


def feeding(program: Program, elements: Elements) -> dict[str, frozenset[str]]:
    """Return, for each output, the names of the inputs and parameters on which its value at t_k depends."""
    signals: tuple[Signal | Tunable, ...] = (*program.inputs, *program.tunables)
    whole = {element: signal.name for signal in signals for element in labels(signal.name, signal.shape)}
    return {output: frozenset(whole[name] for of in each for name in of) for output, each in elements.items()}


def feeding_elements(program: Program) -> Elements:
    """Return, for each element of each output, the elements of inputs and parameters on which its value at t_k depends.

    Step functions are run on sets. If one branches on data, each of its outputs depends on everything that it reads. Factors of
    a number that is always zero are no dependencies.
    """
    schedule = program.schedule
    memory, names = _memory(program)
    for call in schedule.evaluate:
        kernel = schedule.kernel(call)
        if schedule.nodes[call.node].name == OUTSIDE or kernel is None:
            continue
        for to, origin in call.gathers:
            memory[to] = memory[origin]
        run(kernel, schedule.slots[call.node], memory)
    return {signal.name: tuple(_named(memory[at], names) for at in signal.places) for signal in program.outputs}


def _memory(program: Program) -> tuple[Memory, list[str]]:
    """Return the schedule's memory before a step, with inputs and parameters as their own origins, and their names."""
    schedule = program.schedule
    memory: Memory = np.array([*map(np.float64, schedule.initial.tolist()), None], dtype=object)[:-1]
    names: list[str] = []
    Origins.made = 0  # counted for another program
    nothing = Origins(0)

    def new_origins(name: str, shape: tuple[int, ...]) -> list[Origins]:
        before = len(names)
        names.extend(labels(name, shape))
        return [Origins(1 << i) for i in range(before, len(names))]

    for node, slots in zip(schedule.nodes, schedule.slots, strict=True):
        for section, offset, shape in slots.sections.values():
            if section in {"state", "outputs"}:
                begin = slots.start[section] + offset
                memory[begin : begin + int(np.prod(shape, dtype=int))] = nothing
        if node.name == OUTSIDE:
            elements = [element for signal in program.inputs for element in new_origins(signal.name, signal.shape)]
            for place, element in enumerate(elements, slots.start["outputs"]):
                memory[place] = element
    for tunable in program.tunables:
        for element, places in zip(new_origins(tunable.name, tunable.shape), tunable.places, strict=True):
            for parameter, j in places:
                memory[schedule.slots[tunable.node].offset(parameter) + j] = element
    return memory, names


def _named(number: object, names: list[str]) -> frozenset[str]:
    of, result = origins(number), []
    while of:
        lowest = of & -of
        result.append(names[lowest.bit_length() - 1])
        of ^= lowest
    return frozenset(result)
