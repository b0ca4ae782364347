"""The two engines: the same schedule with the same memory, once in compiled code and once in plain Python."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, Protocol

import numpy as np

from bayesftc.cosim.block import External
from bayesftc.cosim.diagram.schedule import NOT_FINITE, Call, Schedule
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.isolation.guard import guard_of
from bayesftc.cosim.random import CHUNK, compiled_fill, draw_chunk, stream_key
from bayesftc.cosim.run.coupled.engines import CompiledGroup, GroupRun, InterpretedGroup, address_of, step_function
from bayesftc.cosim.run.fused.compiled import fused, fused_lanes
from bayesftc.cosim.run.general.program import COLUMNS, FUSED, Program
from bayesftc.cosim.run.online import compiled_step
from bayesftc.cosim.run.state_functions import StateFunctions
from bayesftc.cosim.types import Floats

CALLED_COMPILED = 500
"""Steps from which on a loop in Python calls compiled step functions: that of the default controller takes 5 s to compile, and a
hundredth of the 10 ms of a plain step to call."""

LONG = 2.0
"""Seconds of steps in Python after which the rest of a run compiles, too."""

Function = Callable[[float, int], int | None]
"""A step function of time and step count, which returns a status that stops the run, 0 or None."""

WRITES = frozenset({"output", "ahead"})
"""The kinds of calls that write outputs."""


@dataclass(frozen=True)
class Failure:
    """Why a run stopped: the step, the node whose step function failed, and its status.

    `outputs` is the place in memory of the outputs of that function. `note` explains a status of a group of blocks.
    """

    k: int
    node: int
    status: int
    outputs: int = 0
    note: str = ""


@dataclass
class Run:
    """Everything that changes while a diagram runs.

    Attributes
    ----------
    memory : ndarray
        States, parameters, inputs and outputs of all blocks.
    instances : dict
        The running FMU of each external node.
    recorded : ndarray of int
        Places in memory that are recorded.
    recording : ndarray, rows x recorded
        Filled row by row, a row every `decimation` steps.
    before : int
        Number of rows of the whole run before the first row of `recording`.
    k : int
        The last step whose outputs are complete; -1 before the first.
    sound : bool
        Whether memory and FMUs are in the state after that step. False after a failure or an interruption.
    ended : bool
        Whether an FMU has requested the end of the run.
    state_functions : dict
        For each external node that groups save through Python: its functions.
    """

    schedule: Schedule
    seed: int
    memory: Floats
    instances: dict[int, External]
    recorded: np.ndarray[Any, np.dtype[np.int64]]
    recording: Floats
    decimation: int = 1
    before: int = 0
    k: int = -1
    sound: bool = True
    ended: bool = False
    state_functions: dict[int, StateFunctions] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.guard = guard_of(self.instances)

    def streams(self) -> np.ndarray[Any, np.dtype[np.uint64]]:
        """Return the table of random streams."""
        rows = [(stream_key(d.stream), d.channel, d.draw, int(d.uniform)) for d in self.schedule.draws]
        return np.array(rows, dtype=np.uint64).reshape(len(rows), 4)

    def drawn(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Return the places in memory of the random numbers."""
        return np.array([d.offset for d in self.schedule.draws], dtype=np.int64)


class Engine(Protocol):
    """Advances a run from step to step."""

    def advance(self, begin: int, end: int, *, first: bool) -> tuple[int, Failure | None]:
        """Run from t_begin to t_end; return the last complete step and, if the run had to stop, the failure.

        If `first`, compute the outputs at t_begin before; else they are already in memory. The
        engine enters the run's guard itself.
        """

    def prepare(self, steps: float) -> None:
        """Get ready for so many steps, by compiling what pays for them."""

    def evaluate(self, k: int) -> Failure | None:
        """Compute all outputs at t_k from the states, inputs and random numbers in memory."""

    def step(self, k: int) -> Failure | None:
        """Advance the states from t_k to t_k+1, after `evaluate` has computed the outputs and inputs at t_k."""


class Draws:
    """Writes the random numbers of a step into memory, with the same bits as inside the compiled loop."""

    def __init__(self, run: Run):
        self._run, self._streams, self._places = run, run.streams(), run.drawn()
        self._buffer, self._chunk = np.empty((CHUNK, len(self._places))), -1
        if len(self._places):
            compiled_fill()  # load it here, because a first step in real time has no time for it

    def fill(self, k: int) -> None:
        """Draw the numbers of step `k`."""
        if not len(self._places):
            return
        if k // CHUNK != self._chunk:
            self._chunk = k // CHUNK
            draw_chunk(self._run.seed, self._streams, self._chunk * CHUNK, self._buffer)
        self._run.memory[self._places] = self._buffer[k - self._chunk * CHUNK]


class CompiledEngine:
    """Calls every block by address from one compiled loop; the GIL is free while it runs."""

    def __init__(self, run: Run):
        self._asked_for = 0.0
        self._run = run
        schedule = run.schedule
        self._groups: dict[int, CompiledGroup] = {}
        rows: list[list[int]] = []
        gathers: list[tuple[int, int]] = []
        for call in (*schedule.evaluate, *schedule.advance):
            start = schedule.slots[call.node].start
            checked = call.node in schedule.finite and call.kind in WRITES
            begin = schedule.outputs_start(call)
            outputs = begin, begin + schedule.depended_on(call.node)
            table = start["parameters"]
            if call.group:
                group = self._groups[len(rows)] = CompiledGroup(run, call.group)
                address, table = group.address, group.parameters
            else:
                address = 0 if call.kind == "inputs" else address_of(run, call.node, call.kind)
            rows.append(
                [
                    address,
                    schedule.every(call),
                    start["state"],
                    table,
                    start["inputs"],
                    begin,
                    len(gathers),
                    len(gathers) + len(call.gathers),
                    *(outputs if checked else (0, 0)),
                ]
            )
            gathers += call.gathers
        self._calls = np.array(rows, dtype=np.int64).reshape(len(rows), COLUMNS)
        self._gathers = np.array(gathers, dtype=np.int64).reshape(len(gathers), 2)
        self._clock = schedule.step.numerator, schedule.step.denominator
        self._drawn = run.drawn()
        self._program = Program(
            self._calls,
            len(schedule.evaluate),
            self._gathers,
            self._drawn,
            run.recorded,
            run.decimation,
            self._clock,
            run.memory,
            run.streams(),
            run.guard.inside,
        )

    def prepare(self, steps: float) -> None:
        """See `Engine.prepare`: one function for the whole loop."""
        if steps <= self._asked_for:
            return
        address = self._program.words[FUSED] = fused(self._run.schedule, self._described(), steps)
        self._asked_for = inf if address else steps

    def in_lock_step(self, steps: float, seconds: float = 0.0) -> int | None:
        """Return the address of a function for several runs in lock step; 0 if that does not pay, None while one is compiled."""
        return fused_lanes(self._run.schedule, self._described(), steps, seconds)

    @property
    def program(self) -> Program:
        """The tables of the compiled loop."""
        return self._program

    def _described(self) -> tuple[Any, Any, Any, int, tuple[int, int]]:
        return self._calls, self._drawn, self._run.recorded, self._run.decimation, self._clock

    def advance(self, begin: int, end: int, *, first: bool) -> tuple[int, Failure | None]:
        """See `Engine.advance`."""
        run, program = self._run, self._program
        if run.guard.inside:
            try:
                failed = program.advance(run.recording, run.seed, run.before, first, begin, end)
            finally:  # also after Ctrl-C
                run.guard.settle()
        else:
            with run.guard:
                failed = program.advance(run.recording, run.seed, run.before, first, begin, end)
        if not failed:
            return end, None
        (row, status), last = program.failure, program.last
        return last, self._failure(row, status, last + int(row < len(run.schedule.evaluate)))

    def advance_many(
        self,
        seeds: np.ndarray[Any, np.dtype[np.uint64]],
        initial: Floats,
        states: np.ndarray[Any, np.dtype[np.int64]],
        recordings: Floats,
        reached: np.ndarray[Any, np.dtype[np.int64]],
        end: int,
        *,
        fresh: bool,
    ) -> tuple[int, Failure | None]:
        """Make a whole run for each seed, each from the same beginning, in one compiled call.

        Parameters
        ----------
        seeds : ndarray of shape (runs,)
            Seeds of the runs.
        initial : ndarray
            Memory at the beginning of each run.
        states : ndarray of shape (instances, 3)
            How each FMU is restored to its beginning: the address of the function, of the instance and of the state.
        recordings : ndarray of shape (runs, rows, recorded)
            Filled; for a run that fails only up to its last complete step.
        reached : ndarray of shape (runs,)
            Filled with the last complete step of each run.
        end : int
            The last step of a run.
        fresh : bool
            Whether memory and FMUs are already in their initial state.

        Returns
        -------
        done : int
            Number of complete runs before the first failure.
        failure : Failure or None
            The failure of the next run. Its `node` is -1 if an FMU could not be restored.
        """
        done = self._program.make_many(seeds, initial, states, recordings, reached, end, fresh=fresh)
        row, status = self._program.failure
        if row == -1:
            return done, None
        if row < 0:
            return done, Failure(-1, -1, status)
        return done, self._failure(row, status, int(reached[done]) + (row < len(self._run.schedule.evaluate)))

    def evaluate(self, k: int) -> Failure | None:
        """See `Engine.evaluate`."""
        return self._phase(0, len(self._run.schedule.evaluate), k)

    def step(self, k: int) -> Failure | None:
        """See `Engine.step`."""
        return self._phase(len(self._run.schedule.evaluate), len(self._calls), k)

    def _phase(self, begin: int, end: int, k: int) -> Failure | None:
        step = self._run.schedule.step
        row, status = self._program.make_calls(begin, end, k * step.numerator / step.denominator, k)
        return None if row < 0 else self._failure(row, status, k)

    def _failure(self, row: int, status: int, k: int) -> Failure:
        schedule = self._run.schedule
        call = (*schedule.evaluate, *schedule.advance)[row]
        return _failure(schedule, call, k, status, self._groups.get(row))


class InterpretedEngine:
    """Calls the plain Python step functions, which you can step through in a debugger.

    Parameters
    ----------
    run : Run
        The run.
    compiles : bool
        Whether compiled step functions may be called where they pay: the loop then runs in Python only because one of its blocks
        calls back into Python.
    """

    def __init__(self, run: Run, *, compiles: bool = False):
        self._run, self._compiles, self._spent = run, compiles, 0.0
        self._evaluate = [self._bind(call) for call in run.schedule.evaluate]
        self._advance = [self._bind(call) for call in run.schedule.advance]
        self._draws = Draws(run)

    def _bind(self, call: Call) -> tuple[Call, Function]:
        if call.kind == "inputs":
            return call, lambda t, k: 0
        if call.group:
            return call, InterpretedGroup(self._run, call.group)
        return call, step_function(self._run, call.node, call.kind, self._run.schedule.outputs_start(call))

    def prepare(self, steps: float) -> None:
        """See `Engine.prepare`: compiled step functions of the blocks that have them."""
        if self._compiles and steps >= CALLED_COMPILED:
            self._compiles = False
            self._evaluate, self._advance = (
                [(call, self._compiled(call) or plain) for call, plain in calls]
                for calls in (self._evaluate, self._advance)
            )

    def _compiled(self, call: Call) -> Function | None:
        schedule = self._run.schedule
        kernel, definition = None if call.group else schedule.kernel(call), schedule.definitions[call.node]
        if kernel is None or definition is None or not definition.compiled:
            return None
        slots = schedule.slots[call.node]
        with suppress(KernelError):  # what cannot be compiled stays as it is
            return compiled_step(
                kernel, replace(slots, start={**slots.start, "outputs": schedule.outputs_start(call)}), self._run.memory
            )
        return None

    def advance(self, begin: int, end: int, *, first: bool) -> tuple[int, Failure | None]:
        """See `Engine.advance`. A run that takes long compiles, however few its steps are."""
        if self._compiles and self._spent > LONG:
            self.prepare(CALLED_COMPILED)
        begun = time.perf_counter()
        try:
            with self._run.guard:
                return self._steps(begin, end, first=first)
        finally:
            self._spent += time.perf_counter() - begun

    def _steps(self, begin: int, end: int, *, first: bool) -> tuple[int, Failure | None]:
        run = self._run
        with np.errstate(all="ignore"):  # once for all steps
            for k in range(begin, end + 1):
                if first or k > begin:
                    self._draws.fill(k)
                    failure = self._phase(self._evaluate, k)
                    if failure:
                        return k - 1, failure
                    if k % run.decimation == 0:
                        run.recording[k // run.decimation - run.before] = run.memory[run.recorded]
                if k < end:
                    failure = self._phase(self._advance, k)
                    if failure:
                        return k, failure
        return end, None

    def evaluate(self, k: int) -> Failure | None:
        """See `Engine.evaluate`."""
        with np.errstate(all="ignore"):
            return self._phase(self._evaluate, k)

    def step(self, k: int) -> Failure | None:
        """See `Engine.step`."""
        with np.errstate(all="ignore"):
            return self._phase(self._advance, k)

    def _phase(self, calls: list[tuple[Call, Function]], k: int) -> Failure | None:
        """Make the calls of a phase, under IEEE 754 as in compiled code: infinities and NaNs are values."""
        schedule, memory = self._run.schedule, self._run.memory
        t = k * schedule.step.numerator / schedule.step.denominator
        for call, function in calls:
            every = schedule.every(call)
            if k % every:
                continue
            for target, origin in call.gathers:
                memory[target] = memory[origin]
            status = function(t, k // every)
            if status:
                return _failure(schedule, call, k, status, function if isinstance(function, GroupRun) else None)
            if call.node in schedule.finite and call.kind in WRITES:
                start = schedule.outputs_start(call)
                for i in range(start, start + schedule.depended_on(call.node)):
                    if not np.isfinite(memory[i]):
                        return _failure(schedule, call, k, NOT_FINITE + i)
        return None


def _failure(schedule: Schedule, call: Call, k: int, status: int, group: GroupRun | None = None) -> Failure:
    """Return the failure for a status that a call has returned at step `k`.

    The failure of an output at the end of a step belongs to the next step.
    """
    if group is None:
        instant = k + schedule.every(call) if call.kind == "ahead" else k
        return Failure(instant, call.node, status, schedule.outputs_start(call))
    part, status = group.culprit()
    if part is None:
        return Failure(k, call.node, status, note=group.explain(status))
    return Failure(k + schedule.every(call) if part.kind == "ahead" else k, part.node, status, part.outputs)
