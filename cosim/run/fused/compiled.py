"""Compile the loop of a diagram once per machine, or load it; say when that pays."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from math import inf, prod
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.run.fused.lanes import Home, Lanes, text_of_lanes, wide_name
from bayesftc.cosim.run.fused.text import Loop, text_of_loop
from bayesftc.cosim.run.general.program import FUNCTION
from bayesftc.cosim.stepping.machine.code import machine_code
from bayesftc.cosim.stepping.machine.lanes import lowered_to_lanes
from bayesftc.cosim.stepping.machine.lowering import lowered
from bayesftc.cosim.stepping.machine.services import known_text, service_at
from bayesftc.cosim.stepping.machine.steps import environment, load_or_compile, name_of, sentences, text_of
from bayesftc.cosim.stepping.source.tree import Sections
from bayesftc.cosim.types import argument_names

LOADED: float = 50_000
"""Steps from which on a loop that is on the disk pays: loading takes about a millisecond, and a step gains 13 to 40 ns."""

COMPILED: float = 2_000_000
"""The same for each call of a loop that is not on the disk: compiling it takes about 0.05 s a call."""

SECONDS: float = 15.0
"""Time of all runs one by one from which on compiling a loop for several runs pays, however few steps they have. The longest,
with a bank of hypotheses, takes 3 to 5 s, and saves two thirds of the time."""

Whole = np.ndarray[Any, np.dtype[np.int64]]

Tables = tuple[Whole, Whole, Whole, int, tuple[int, int]]

Steps = Mapping[str, tuple[FunctionType, Sections]]
"""The step functions of a loop by name, and the places of their arguments."""

INCLUDED, IN_LANES = 60_000, 20_000
"""Lengths of the text of a service function up to which it is included in a loop, and in one for several runs, where each has its
own copy. The step of an FMU whose ports are plain numbers is shorter; compiling a long one would take seconds."""

LANES = 8
"""Runs that are made in lock step, each in its lane of the processor's vector registers."""

_addresses: dict[str, int] = {}

_compiling = threading.Lock()


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
    loop, functions = _described(schedule, tables, INCLUDED)
    text = text_of_loop(loop, "loop", set(functions))
    return _found(loop, text, steps, lambda name: _compiled(loop, functions, name)) or 0


def fused_lanes(schedule: Schedule, tables: Tables, steps: float, seconds: float = 0.0) -> int | None:
    """Return the address of a function for `LANES` runs of a diagram in lock step; 0 if that does not pay.

    It is None while another thread compiles: then runs one by one pay.

    Parameters are those of `fused`, and `steps` those of all runs together, which take these `seconds` one by one (0: unknown).
    """
    if steps < LOADED * LANES or schedule.groups:  # a group's tables have the address of one run's memory
        return 0
    loop, functions = _described(schedule, tables, IN_LANES)
    calls = (*schedule.evaluate, *schedule.advance)
    begins = [slots.start["state"] for slots in schedule.slots]
    last = schedule.slots[-1].start["outputs"] + sum(port.size for port in schedule.nodes[-1].outputs)
    by_address = {
        c.node for c, f in zip(calls, loop.functions, strict=True) if c.kind != "inputs" and f not in functions
    }
    by_address |= {i for i, definition in enumerate(schedule.definitions) if definition is None}
    lanes = Lanes(
        count=LANES,
        nodes=tuple(call.node for call in calls),
        begins=(*begins, last),
        size=len(schedule.initial),
        by_address=frozenset(by_address),
        sections=tuple(_sections(schedule)),
        lasting=frozenset(_lasting(schedule, loop)),
    )
    text = text_of_lanes(loop, lanes, "loop")
    worth = inf if seconds >= SECONDS else steps
    return _found(loop, text, worth, lambda name: _compiled_lanes(loop, lanes, functions, name), waits=False)


def _sections(schedule: Schedule) -> Iterator[tuple[int, int]]:
    """Return first place and end of each node's inputs and outputs."""
    for node, slots in zip(schedule.nodes, schedule.slots, strict=True):
        for section, ports in (("inputs", node.inputs), ("outputs", node.outputs)):
            begin = slots.start[section]
            yield begin, begin + sum(port.size for port in ports)


def _lasting(schedule: Schedule, loop: Loop) -> Iterator[int]:
    """Return places from which a later step may read: all inputs, and outputs that anything but their own computation reads."""
    yield from loop.recorded
    yield from (source for gathers in loop.gathers for _, source in gathers)
    for slots in schedule.slots:
        yield from range(slots.start["inputs"], slots.start["outputs"])
    for call in schedule.advance:
        kernel, slots = schedule.kernel(call), schedule.slots[call.node]
        for name in argument_names(kernel) if kernel else ():
            section, _, shape = slots.sections.get(name, ("", 0, ()))
            if section == "outputs":
                yield from range(slots.offset(name), slots.offset(name) + prod(shape))


def _found(loop: Loop, text: str, steps: float, compiled: Callable[[str], bytes], *, waits: bool = True) -> int | None:
    """Return the address of a loop's code, which depends on this `text` and what it includes.

    It is 0 if compiling does not pay, and without `waits` None while another thread compiles.
    """
    parts = [environment(), text, *(known_text(service) for service in loop.services)]
    name = "loop_" + hashlib.sha256("|".join(parts).encode()).hexdigest()[:24]
    if name not in _addresses:
        is_kept = (cache_directory("compiled") / f"{name}.o").exists()
        if not is_kept and steps < COMPILED * len(loop.rows):
            return 0
        if is_kept:
            _addresses[name] = load_or_compile(name, lambda: compiled(name))
        elif _compiling.acquire(blocking=waits):
            try:
                if name not in _addresses:
                    _addresses[name] = load_or_compile(name, lambda: compiled(name))
            finally:
                _compiling.release()
    return _addresses.get(name)


def _described(schedule: Schedule, tables: Tables, longest: int) -> tuple[Loop, Steps]:
    """Return the loop and its step functions; service functions with a text up to this length are included in its code."""
    rows, drawn, recorded, decimation, clock = tables
    names, functions, services = [], {}, []
    calls = (*schedule.evaluate, *schedule.advance)
    for call, address in zip(calls, rows[:, FUNCTION].tolist(), strict=True):
        service = service_at(address)
        services.append(service if len(known_text(service)) <= longest else "")
        kernel, sections = None if call.group else schedule.kernel(call), schedule.slots[call.node].sections
        names.append(name_of(kernel, sections) if kernel else "")
        if isinstance(kernel, FunctionType):
            functions[names[-1]] = kernel, sections
    loop = Loop(
        rows=tuple((int(address != 0), *row) for address, *row in rows.tolist()),  # addresses differ between processes
        gathers=tuple(call.gathers for call in calls),
        functions=tuple(names),
        services=tuple(services),
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
    return machine_code(text_of_loop(loop, name, parts), parts | _service_texts(loop))


def _service_texts(loop: Loop) -> dict[str, str]:
    """Return the texts of the service functions that a loop calls by name."""
    return {service: known_text(service) for service in loop.services if service}


def _compiled_lanes(loop: Loop, lanes: Lanes, functions: Steps, name: str) -> bytes:
    parts: dict[str, str] = {}
    while True:
        failed = set()
        homes = lanes.homes(loop)
        for function, node in zip(loop.functions, lanes.nodes, strict=True):
            if function and homes[node] is not Home.OWN:
                try:
                    _lower(parts, functions[function], function, lanes.count if homes[node] is Home.WIDE else 0)
                except KernelError:  # it is called by its address
                    failed.add(node)
        if not failed:
            wanted = {f if homes[node] is Home.SAME else wide_name(f) for f, node in zip(loop.functions, lanes.nodes)}
            parts = {part: text for part, text in parts.items() if part in wanted}
            return machine_code(text_of_lanes(loop, lanes, name), parts | _service_texts(loop), wide=True)
        lanes = replace(lanes, by_address=lanes.by_address | failed)


def _lower(parts: dict[str, str], function: tuple[FunctionType, Sections], name: str, lanes: int) -> None:
    """Add the text of a step function, for one run or for several."""
    part = wide_name(name) if lanes else name
    if part not in parts:
        kernel, sections = function
        with sentences(kernel):
            c, apart = text_of(kernel, sections, part)
            parts[part] = lowered_to_lanes(c, lanes, apart) if lanes else lowered(c, apart)
