"""The parts of a run: open its FMUs, choose its engine, run it in pieces with Ctrl-C, progress and time limits in between.

They are used by single runs (`session`) and by many runs of one diagram (`many`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.base.announcing import tell
from bayesftc.cosim.base.timebase import share_of_time, show, spoken
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import External, ExternalBlock
from bayesftc.cosim.diagram.memory import TABLE
from bayesftc.cosim.diagram.schedule import NOT_FINITE, Schedule
from bayesftc.cosim.errors import FMUCrashed, KernelError, ModelError, SimulationError
from bayesftc.cosim.fmi.binaries.surroundings import Surroundings
from bayesftc.cosim.fmi.running.rounding import Roundable, warn_of_rounding
from bayesftc.cosim.run.coupled.engines import check_groups, place_words
from bayesftc.cosim.run.engines import CompiledEngine, Engine, Failure, InterpretedEngine, Run
from bayesftc.cosim.run.pacing import Pacer
from bayesftc.cosim.run.result import Result, at_stop
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.run.recording import Selection

BREATH = 0.05
"""Seconds between two returns of the compiled loop to Python."""

SILENCE, PERIOD = 2.0, 10.0
"""Seconds after the compiler before a message on how far a run without `progress` is, and between two messages."""

_MEMBERS = {name for name in (*vars(External), *External.__annotations__) if not name.startswith("_")}

Progress = Callable[[int, int], None]


def open_run(schedule: Schedule, stack: ExitStack, seed: int, selection: Selection, steps: int, decimation: int) -> Run:
    """Return a run at its beginning, with an empty recording; the stack closes its FMUs.

    Raises
    ------
    ModelError
        If the recording does not fit into memory.
    """
    instances = {}
    memory = schedule.initial.copy()
    for i, node in enumerate(schedule.nodes):
        if isinstance(node.block, ExternalBlock):
            with Surroundings():
                instance = node.block.instantiate(schedule.step * node.every, node.name)
            stack.callback(getattr(instance, "close", lambda: None))  # before the check, which may raise
            _check_instance(node.block, instance)
            instances[i] = instance
            rounding: Roundable | None = getattr(instance, "rounding", None)
            if rounding is not None and rounding.wide_outputs:
                rounding.let_round([name for name in rounding.wide_outputs if (i, name) not in schedule.connected])
                stack.callback(warn_of_rounding, rounding, node.name)
            _take_own_inputs(schedule, i, getattr(instance, "own_inputs", {}), memory)
    run = Run(schedule, seed, memory, instances, selection.places, np.empty((0, 0)), decimation)
    check_groups(run)
    place_tables(run)
    make_room(run, steps)
    return run


def _check_instance(block: ExternalBlock, instance: External) -> None:
    """Refuse an instance that lacks a member of `External`."""
    missing = _MEMBERS - set(dir(type(instance))) - getattr(instance, "__dict__", {}).keys()
    if missing:
        raise KernelError(
            f"The instance of {type(block).__name__}, a {type(instance).__name__}, lacks {' and '.join(sorted(missing))}; "
            "give it all members of the class External in bayesftc.cosim.block."
        )


def _take_own_inputs(schedule: Schedule, node: int, values: Mapping[str, Floats], memory: Floats) -> None:
    """Write into memory the start values that an FMU itself has for inputs; connected inputs overwrite them."""
    begin = schedule.slots[node].start["inputs"]
    for port in schedule.nodes[node].block.inputs:
        if port.name in values:
            memory[begin : begin + port.size] = values[port.name]
        begin += port.size


def place_tables(run: Run) -> None:
    """Write into memory the table of each FMU's instance, for compiled code.

    Raises
    ------
    KernelError
        If a table has too many words.
    """
    place_words(run)
    for i, instance in run.instances.items():
        if len(instance.table) > TABLE:
            node = run.schedule.nodes[i]
            raise KernelError(
                f"The table of {node.name!r}, a {type(node.block).__name__}, has {len(instance.table)} words, but the limit is "
                f"{TABLE}; keep further numbers in memory of the instance, and their address in the table."
            )
        start = run.schedule.slots[i].start["parameters"]
        run.memory[start : start + len(instance.table)] = instance.table.view(np.float64)


def make_room(run: Run, end: int, room: Callable[[int, int], Floats] | None = None) -> None:
    """Give a run an empty recording for the steps from the next one to step `end`.

    Parameters
    ----------
    run : Run
        The run.
    end : int
        The last step.
    room : callable, optional
        Returns the array for a number of rows and of columns; by default a new one.

    Raises
    ------
    ModelError
        If the recording does not fit into memory.
    """
    run.before = run.k // run.decimation + 1
    rows, columns = end // run.decimation + 1 - run.before, len(run.recorded)
    try:
        run.recording = np.empty((rows, columns)) if room is None else room(rows, columns)
    except (MemoryError, ValueError):
        raise too_large(rows, columns) from None
    if room is not None and (run.recording.shape != (rows, columns) or run.recording.dtype != np.float64):
        raise ModelError(
            f"The array for the recording has the shape {run.recording.shape} and the type {run.recording.dtype}; it must be an "
            f"array of float64 of the shape {(rows, columns)}."
        )


def too_large(rows: int, columns: int) -> ModelError:
    """Return the error for a recording that does not fit into memory."""
    return ModelError(
        f"Recording {columns} numbers at {rows} steps takes {8e-9 * rows * columns:.3g} GB, more than this machine has; record "
        "fewer signals with record=..., or every n-th step with decimation=n."
    )


def choose_engine(name: str, run: Run) -> Engine:
    """Return the engine of that name for a run; ``auto`` is compiled if every block allows it.

    Raises
    ------
    ModelError
        If there is no engine of that name.
    KernelError
        If the name is ``compiled`` and a block calls back into Python.
    """
    if name not in {"auto", "compiled", "interpreted"}:
        raise ModelError(f"engine is {name!r}; it must be 'auto', 'compiled' or 'interpreted'.")
    if name == "compiled" and not run.schedule.compiled:
        names = [
            n.name for n, d in zip(run.schedule.nodes, run.schedule.definitions, strict=True) if d and not d.compiled
        ]
        raise KernelError(
            f"{'The blocks' if len(names) > 1 else 'The block'} {', '.join(names)} call{'s' * (len(names) == 1)} back into "
            "Python and cannot be compiled; use engine='auto' or 'interpreted'."
        )
    if name == "interpreted" or not run.schedule.compiled:
        return InterpretedEngine(run, compiles=name == "auto")
    return CompiledEngine(run)


def advance(
    engine: Engine,
    end: int,
    run: Run,
    progress: Progress | None = None,
    time_limit: float | None = None,
    pacer: Pacer | None = None,
) -> str | None:
    """Run to step `end` in pieces of about `BREATH` seconds; return the reason if the run stopped early.

    ``run.k`` is then the last complete step.
    """
    # The first piece is one step: with a slow FMU, Ctrl-C must not wait for many steps.
    begin, piece, started = max(run.k, 0), 1, time.perf_counter()
    origin, due, before = begin, inf, started
    counted, since = begin, started  # the rate counts from there, without the time of the compiler
    while True:
        until = min(begin + (pacer.pack if pacer else piece), end)
        if pacer and run.k < 0:
            until = 0  # compute t_0 without waiting for t_1
        if pacer:
            pacer.wait(until)
        run.sound, run.ended = False, False
        run.k, failure = engine.advance(begin, until, first=run.k < 0)
        if run.guard.changed:
            warn_of_arithmetic(run)
        if failure:
            reason = explain(
                failure, run
            )  # also after Ctrl-C: the failed FMU notes which functions it must not call any more
            if run.guard.interrupted:
                raise KeyboardInterrupt
            return reason
        run.sound = True
        if pacer:
            pacer.done(until)
        if until == end:
            if progress:
                progress(until - origin, end - origin)
            return None
        now = time.perf_counter()
        # The first step may wait for the compiler. An interpreted run compiles later, in a piece that is the longest by far.
        if due == inf or (until - begin > 1 and now - before > max(1.0, before - since)):
            due, counted, since = now + SILENCE, until, now
        if progress:
            progress(until - origin, end - origin)
        elif now > due and not pacer:
            due = now + PERIOD
            t, last = (float(k * run.schedule.step) for k in (until, end))
            tell(
                f"Simulating: {(until - origin) / (end - origin):.0%} ({share_of_time(t, last)}) after "
                f"{spoken(round(now - started))}, about "
                f"{spoken(round((now - since) * (end - until) / (until - counted)))} left."
            )
        if time_limit is not None and now - started > time_limit:
            t = float(until * run.schedule.step)
            return f"The run reached its time limit of {time_limit:g} s of computing at t = {t:g} s (step {until} of {end})."
        if not pacer:
            piece = max(1, int(piece * min(4.0, BREATH / max(now - before, 1e-9))))
        begin, before = until, time.perf_counter()


def warn_of_arithmetic(run: Run) -> None:
    """Warn that an FMU of a run has changed the floating-point mode of this process, which was restored."""
    suspects = " or ".join(repr(run.schedule.nodes[i].name) for i in run.instances)
    warn_user(
        f"The FMU of {suspects} has changed how this process rounds, or that numbers below 2.2e-308 become zero. The setting was "
        "restored, but the results of other blocks may be wrong in their last digits; isolate the FMU (isolate=True).",
        RuntimeWarning,
    )


def explain(failure: Failure, run: Run) -> str:
    """Return the message with the time, the place and the reason at which a run stopped."""
    node = run.schedule.nodes[failure.node]
    t = float(failure.k * run.schedule.step)
    when = f"at t = {t:g} s (step {failure.k})"
    if failure.note:
        for instance in run.instances.values():
            _date_crash(instance, failure.k, t)
        return f"The run stopped {when}: {failure.note}"
    if failure.status >= NOT_FINITE:
        place = failure.status - NOT_FINITE
        value = run.memory[place]
        name = run.schedule.output_name(failure.node, place - failure.outputs)
        h = show(run.schedule.step * node.every)
        steps = f"the step size of {h} s"
        variables = getattr(getattr(node.block, "description", None), "variables", ())
        if any(v.name == "max_substep" for v in variables):  # of the shipped plants
            steps += ", and the substeps in which the FMU integrates (max_substep)"
        came = f"The run stopped {when}: {name} came out {'NaN' if np.isnan(value) else 'infinite'}."
        origin = run.schedule.origin_of_nan(failure.node, run.memory) if np.isnan(value) else None
        if origin is not None:
            return (
                f"{came} The NaN may come from {origin}, which is NaN, too: a missing sample is NaN, so that a block that reads "
                f"a sensor must expect NaN, and for example hold its last output. If not, check the plant's parameters and "
                f"{steps}."
            )
        return f"{came} Check the plant's parameters and {steps}."
    external = run.instances.get(failure.node)
    detail = external.explain(failure.status) if external is not None else ""
    run.ended = external is not None and external.has_ended
    if run.ended:
        return f"The run has ended {when}, as {node.name!r} requested. {detail}"
    if _date_crash(external, failure.k, t):
        return f"The run stopped {when}: t{detail[1:]}"
    what = f"failed. {detail}" if detail.strip() else f"returned status {failure.status}, which is not 0."
    return f"The run stopped {when}: block {node.name!r} {what}".rstrip()


def _date_crash(instance: External | None, k: int, t: float) -> bool:
    """Set step and time of the crash of an isolated FMU, if there is one; return whether there is."""
    crash: FMUCrashed | None = getattr(instance, "crash", None)
    if crash is not None:
        crash.step, crash.time = k, t
    return crash is not None


def failed(stopped: str, result: Result, run: Run) -> SimulationError:
    """Return the error of a run that had to stop: `FMUCrashed` if an isolated FMU was the reason.

    Its message also says what the loop did before. Where the signals are, only the caller knows: a traceback names the error's
    result.
    """
    stopped = f"{stopped} {at_stop(result)}".rstrip()
    error = SimulationError(stopped, result)
    for instance in run.instances.values():
        crash: FMUCrashed | None = getattr(instance, "crash", None)
        if crash is not None and crash.step is not None:
            error = FMUCrashed(stopped, result, step=crash.step, time=crash.time, log=crash.log)
            break
    if len(result.time):
        error.add_note("The signals up to the step before are in the exception's result.")
    return error


__all__ = [
    "advance",
    "choose_engine",
    "explain",
    "failed",
    "make_room",
    "open_run",
    "place_tables",
    "warn_of_arithmetic",
]
