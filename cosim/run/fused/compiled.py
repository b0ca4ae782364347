"""Compile the loop of a diagram once per machine, or load it; say when that pays."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.run.fused.text import Loop, text_of_loop
from bayesftc.cosim.stepping.machine.code import machine_code
from bayesftc.cosim.stepping.machine.lowering import lowered
from bayesftc.cosim.stepping.machine.steps import environment, load_or_compile, name_of, sentences, text_of
from bayesftc.cosim.stepping.source.tree import Sections

LOADED: float = 50_000
"""Steps from which on a loop that is on the disk pays: loading takes about a millisecond, and a step gains 13 to 40 ns."""

COMPILED: float = 2_000_000
"""The same for each call of a loop that is not on the disk: compiling it takes about 0.05 s a call."""

Whole = np.ndarray[Any, np.dtype[np.int64]]

Tables = tuple[Whole, Whole, Whole, int, tuple[int, int]]

Steps = Mapping[str, tuple[FunctionType, Sections]]
"""The step functions of a loop by name, and the places of their arguments."""

_addresses: dict[str, int] = {}


def fused(schedule: Schedule, tables: Tables, steps: float) -> int:
    """Return the address of a function for a diagram's whole loop; 0 if that does not pay.

    Parameters
    ----------
    schedule : Schedule
        The diagram.
    tables : tuple
        The engine's tables: calls, places of random numbers, places that are recorded, decimation, clock.
    steps : float
        Number of steps to make.
    """
    if steps < LOADED:
        return 0
    loop, functions = _described(schedule, tables)
    text = text_of_loop(loop, "loop", set(functions))
    name = "loop_" + hashlib.sha256((environment() + text).encode()).hexdigest()[:24]
    if name not in _addresses:
        is_kept = (cache_directory("compiled") / f"{name}.o").exists()
        if not is_kept and steps < COMPILED * len(loop.rows):
            return 0
        _addresses[name] = load_or_compile(name, lambda: _compiled(loop, functions, name))
    return _addresses[name]


def _described(schedule: Schedule, tables: Tables) -> tuple[Loop, Steps]:
    rows, drawn, recorded, decimation, clock = tables
    names, functions = [], {}
    calls = (*schedule.evaluate, *schedule.advance)
    for call in calls:
        kernel, sections = None if call.group else schedule.kernel(call), schedule.slots[call.node].sections
        names.append(name_of(kernel, sections) if kernel else "")
        if isinstance(kernel, FunctionType):
            functions[names[-1]] = kernel, sections
    loop = Loop(
        rows=tuple(tuple(row) for row in rows.tolist()),
        gathers=tuple(call.gathers for call in calls),
        functions=tuple(names),
        evaluations=len(schedule.evaluate),
        drawn=tuple(drawn.tolist()),
        recorded=tuple(recorded.tolist()),
        decimation=decimation,
        clock=clock,
    )
    return loop, functions


def _compiled(loop: Loop, functions: Steps, name: str) -> bytes:
    parts = {}
    for function, (kernel, sections) in functions.items():
        with suppress(KernelError), sentences(kernel):  # numba has compiled it then: it is called by its address
            parts[function] = lowered(*text_of(kernel, sections, function))
    return machine_code(text_of_loop(loop, name, parts), parts)
