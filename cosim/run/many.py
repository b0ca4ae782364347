"""Many runs of one diagram: the engine is set up once, and compiled code makes run after run without Python in between.

Each run begins with the same memory and with FMUs that are restored to their state after initialization. This takes a
hundredth of the time of new instances. If an FMU cannot be restored, or then gives other results, each run gets new instances.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.diagram.schedule import NOT_FINITE, Schedule
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.isolation.spares import Spares
from bayesftc.cosim.random import CHUNK
from bayesftc.cosim.run.engines import CompiledEngine, Engine, Run
from bayesftc.cosim.run.fused.compiled import LANES, SECONDS
from bayesftc.cosim.run.fused.side_by_side import SideBySide
from bayesftc.cosim.run.raised import reason_of
from bayesftc.cosim.run.recording import Selection
from bayesftc.cosim.run.running import BREATH, advance, choose_engine, explain, open_run, warn_of_arithmetic
from bayesftc.cosim.run.state_functions import StateFunctions
from bayesftc.cosim.types import Floats

ROOM = 4_000_000
"""Bytes of the recordings of the runs that are made in one call, so that they stay in the processor's cache."""
MOST_BESIDE = 8_000_000
"""Bytes of the recording of one run up to which runs are made in lock step: all of a group are in memory."""
LONGEST = 1.0
"""Seconds between two pauses of runs in lock step from which on they are made one by one: a pause is after `CHUNK` steps."""
KeepGoing = Callable[[], bool]
"""Called about twenty times a second; returns whether to continue. From a call on, time counts for the runs."""
Overhead = Callable[[], None]
"""Called before work that counts for no time limit of a run: building, compiling, metrics."""
FEWEST = -(-LANES // 3)
"""Runs from which on a group in lock step pays, even if its other lanes only repeat runs."""
WORTH = 2.0
"""How many times longer than making the FMUs of the other lanes all runs must take, to be made in lock step."""
WELL = (0, 1)
"""FMI's status ``ok`` and ``warning``."""
_STATE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)


class StoppedFromOutside(Exception):
    """The runs are no longer requested."""


class _NotPutBackError(Exception):
    """An FMU could not be restored to the beginning of a run, and is freed."""


@dataclass(frozen=True)
class Block:
    """Some runs; each array has a row for each.

    Attributes
    ----------
    recording : ndarray of shape (runs, rows, recorded)
        The recorded numbers, NaN after the failure of a run. The next block overwrites it.
    steps : ndarray of int of shape (runs,)
        The last complete step.
    reasons : tuple of str
        Why a run has failed; an empty text if it has not.
    """

    recording: Floats
    steps: np.ndarray[Any, np.dtype[np.int64]]
    reasons: tuple[str, ...]


class ManyRuns:
    """Runs of one diagram, of the same length and with the same recording; `close` frees its FMUs.

    Parameters
    ----------
    schedule : Schedule
        The schedule of the diagram.
    selection : Selection
        The signals to record.
    steps : int
        Length of each run in base steps.
    decimation : int
        Every `decimation`-th step is recorded.
    time_limit : float, optional
        Seconds of computing after which a run is stopped and counts as failed.
    """

    def __init__(
        self,
        schedule: Schedule,
        selection: Selection,
        steps: int,
        decimation: int = 1,
        time_limit: float | None = None,
    ):
        self._schedule, self._selection, self._steps, self._decimation = schedule, selection, steps, decimation
        self._limit = time_limit
        self._spares, self._stack = Spares(), ExitStack()
        self._run: Run
        self._engine: Engine
        self._initial: Floats
        self._states: np.ndarray[Any, np.dtype[np.int64]] | None = None
        self._free: list[tuple[int, int, ctypes.c_int64]] = []
        self._beside: SideBySide | None = None
        self._agrees = not any(
            d is None for d in schedule.definitions
        )  # whether they have given what runs one by one give
        self._function = 0  # address of the loop for runs in lock step
        self._alone = 0  # number of runs to make one by one before the next ones in lock step
        self._failures = 0  # groups of runs in lock step of which one has failed
        self._opened = False  # whether there are FMUs and an engine
        self._fresh = False  # whether they are at the beginning of a run
        self._repeats: bool | None = None  # whether restored FMUs give the same bits again
        self._pace = 0.0  # duration of a run in seconds
        self._measured = False  # whether that was considered in the search for a function for runs in lock step
        self._asks_again = False  # whether the compiler was busy then
        self._opening = 0.0  # time to make the FMUs in seconds
        self._of = 1  # expected number of all runs
        rows = steps // decimation + 1
        self._buffer = np.empty((0, rows, len(selection.places)))
        size = 8 * rows * len(selection.places)
        self._few = max(1, ROOM // max(size, 1))
        self._beside_allowed = size <= MOST_BESIDE  # whether runs in lock step may be tried

    def run(
        self, seeds: Sequence[int], keep_going: KeepGoing = lambda: True, overhead: Overhead = lambda: None, of: int = 1
    ) -> Iterator[Block]:
        """Make a run for each seed; yield them in order, several at a time.

        Parameters
        ----------
        seeds : sequence of int
            One for each run.
        keep_going : callable
            Called about twenty times a second; returns whether to continue.
        overhead : callable
            Called before work that is not part of a run, such as compiling.
        of : int
            The number of all runs, if this is not the only call.

        Raises
        ------
        StoppedFromOutside
            If `keep_going` returns False.
        """
        done, self._of = 0, max(of, len(seeds))
        while done < len(seeds):
            _go_on(keep_going)
            few, more = self._how_many(len(seeds) - done), self._of > 1
            try:
                self._ready(overhead, more=more)
                slow = not self._measured and self._states is not None and self._pace * self._of >= SECONDS
                if self._asks_again or slow:
                    self._measured = True
                    overhead()
                    self._look_for_lock_step()
                _go_on(keep_going)
                block = self._some(np.array(seeds[done : done + few], dtype=np.uint64), keep_going, more=more)
            except _NotPutBackError:  # make the run again, with new instances
                continue
            except (StoppedFromOutside, MemoryError):
                raise
            except Exception as error:  # noqa: BLE001 - an FMU may refuse its parameters, a block in Python may raise anything
                block = self._nothing(reason_of(error, "The run could not be made"))
            done += len(block.steps)
            yield block

    def close(self) -> None:
        """Free the FMUs and end their processes."""
        self._shut()
        self._spares.close()

    def _how_many(self, left: int) -> int:
        if self._pace == 0.0 or self._repeats is None:
            return 1  # the run may be repeated, to compare the memory after it
        few = max(1, min(left, self._few, int(BREATH / self._pace)))
        if self._alone:
            return min(few, self._alone)
        if not self._function:
            return few
        return min(left, max(few // LANES, 1) * LANES)  # a group in lock step takes a third of the time of its runs

    def _some(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], keep_going: KeepGoing, *, more: bool) -> Block:
        """Make the first of the runs, or all of them."""
        began = time.perf_counter()
        # The first run is made piece by piece, because its duration is not known yet.
        if self._goes_from_run_to_run and self._pace > 0.0:
            block = self._compiled(seeds, keep_going)
        else:
            block = self._single(int(seeds[0]), keep_going)
        self._pace = (time.perf_counter() - began) / len(block.steps)
        if more and self._repeats is None and not block.reasons[0]:
            self._repeats = self._once_more(int(seeds[0]), block.recording[0], keep_going)
        return block

    @property
    def _goes_from_run_to_run(self) -> bool:
        return isinstance(self._engine, CompiledEngine)

    def _ready(self, overhead: Overhead = lambda: None, *, more: bool) -> None:
        """Make FMUs and an engine; with `more`, save the FMUs' states for further runs."""
        if self._opened and (self._fresh or self._states is not None):
            return
        self._shut()
        began = time.perf_counter()
        with self._spares.lent():
            self._run = open_run(self._schedule, self._stack, 0, self._selection, self._steps, self._decimation)
        self._opening = time.perf_counter() - began
        overhead()
        self._engine = choose_engine("auto", self._run)
        self._function = 0
        self._engine.prepare(self._steps * self._of)
        self._look_for_lock_step()
        self._opened = self._fresh = True
        self._initial = self._run.memory.copy()
        if more and self._repeats is not False and all(i.can_save for i in self._run.instances.values()):
            self._states = self._saved(self._run)

    def _look_for_lock_step(self) -> None:
        """Find the function for runs in lock step, if it pays."""
        beside = self._beside_allowed and all(hasattr(i, "state_functions") for i in self._run.instances.values())
        if beside and isinstance(self._engine, CompiledEngine):
            found = self._engine.in_lock_step(self._steps * self._of, self._pace * self._of)
            self._function, self._asks_again = found or 0, found is None

    def _saved(self, run: Run) -> np.ndarray[Any, np.dtype[np.int64]] | None:
        """Save each FMU's state; return the table for restoring in compiled code, or None if an FMU fails to save.

        The FMUs still get the information that no run returns to an earlier step. Without it some repeat their first step for
        ever. The comparison of two runs detects an FMU that therefore cannot return to the beginning.
        """
        rows = []
        for instance in run.instances.values():
            addresses = getattr(instance, "state_functions", None)
            if addresses is None:
                functions = StateFunctions(instance)
                self._stack.callback(functions.take)  # this keeps the functions alive
                addresses = functions.addresses
            component, save, restore, free = addresses
            place = ctypes.c_int64(0)
            status = _STATE(save)(component, ctypes.addressof(place))
            if status not in WELL:
                self._repeats = False
                return None
            self._free.append((free, component, place))
            rows.append((restore, component, place.value))
        return np.array(rows, dtype=np.int64).reshape(len(rows), 3)

    def _compiled(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], keep_going: KeepGoing) -> Block:
        """Make runs in lock step if possible; else one by one, all by one call if they are quick, or one piece by piece."""
        # A group takes at most as long as its runs one by one, and must not reach the limit of one run.
        group = self._pace * LANES
        may_pause = group * CHUNK < LONGEST * max(self._steps, 1)
        if len(seeds) >= FEWEST and group < (self._limit or inf) and may_pause and self._opens_beside():
            return self._in_lock_step(seeds, keep_going)
        if self._quick:
            block = self._one_by_one(seeds, self._room(len(seeds)))
        else:
            block = self._single(int(seeds[0]), keep_going)
        self._alone = max(self._alone - len(block.steps), 0)
        return block

    @property
    def _quick(self) -> bool:
        """Whether a run is so short that it need not be made piece by piece."""
        return self._pace < min(BREATH, self._limit or BREATH)

    def _each(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], recording: Floats, keep_going: KeepGoing) -> Block:
        """Make runs piece by piece, up to the first one that fails."""
        steps: list[int] = []
        reason = ""
        while len(steps) < len(seeds) and not reason:
            i = len(steps)
            block = self._single(int(seeds[i]), keep_going, recording[i : i + 1])
            steps.append(int(block.steps[0]))
            (reason,) = block.reasons
        reasons = ("",) * (len(steps) - 1) + (reason,)
        return Block(recording[: len(steps)], np.array(steps, dtype=np.int64), reasons)

    def _one_by_one(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], recording: Floats) -> Block:
        engine, run = self._engine, self._run
        assert isinstance(engine, CompiledEngine)
        if self._states is None:
            seeds, recording = seeds[:1], recording[:1]
        states = np.empty((0, 3), dtype=np.int64) if self._states is None else self._states
        reached = np.empty(len(seeds), dtype=np.int64)
        with run.guard as guard:
            done, failure = engine.advance_many(
                seeds, self._initial, states, recording, reached, self._steps, fresh=self._fresh
            )
        self._fresh = False
        if guard.changed:
            warn_of_arithmetic(run)
        reasons = [""] * done
        if failure is not None:
            run.k, run.sound = int(reached[done]), False
            if failure.node < 0:
                self._give_up()
            else:
                reasons.append(explain(failure, run))
                recording[done, reached[done] // self._decimation + 1 :] = np.nan
                self._shut(broken=failure.status < NOT_FINITE)
        if guard.interrupted:
            raise KeyboardInterrupt
        if not reasons:
            raise _NotPutBackError
        return Block(recording[: len(reasons)], reached[: len(reasons)], tuple(reasons))

    def _opens_beside(self) -> bool:
        """Return whether runs can be made in lock step, after making the FMUs of the other lanes."""
        if self._beside is not None:
            return True
        if not self._function or self._alone or self._states is None:
            return False
        if self._pace * self._of < WORTH * LANES * self._opening:
            return False
        assert isinstance(self._engine, CompiledEngine)
        runs, states, engines = [self._run], [self._states], [self._engine]
        try:
            for _ in range(LANES - 1):
                with self._spares.lent():
                    run = open_run(self._schedule, self._stack, 0, self._selection, 0, self._decimation)
                kept = self._saved(run)
                if kept is None:
                    raise FMUError("An FMU cannot save its state.")
                runs.append(run)
                states.append(kept)
                engines.append(CompiledEngine(run))
        except Exception:  # noqa: BLE001 - such as an FMU of which a process can have one instance only
            self._function, self._beside_allowed = 0, False
            return False
        memory = [self._initial, *(run.memory for run in runs[1:])]
        self._beside = SideBySide(self._function, [engine.program for engine in engines], memory, states)
        return True

    def _in_lock_step(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], keep_going: KeepGoing) -> Block:
        """Make runs in lock step; the lanes that are left over repeat runs. If one fails, its group is made one by one."""
        if not self._agrees:
            return self._twice(seeds[:LANES], keep_going)
        rest = len(seeds) % LANES
        count = len(seeds) - (rest if rest < FEWEST else 0)
        recording = self._room(-(-count // LANES) * LANES)
        done = min(self._together(np.resize(seeds[:count], len(recording)), recording, keep_going), count)
        if done < count:
            self._failures += 1
            # A campaign in which many runs fail soon makes all of them one by one.
            self._alone = LANES * 2**self._failures
            self._shut(broken=True)
        if not done:
            raise _NotPutBackError
        return Block(recording[:done], np.full(done, self._steps), ("",) * done)

    def _together(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], recording: Floats, keep_going: KeepGoing) -> int:
        """Return the number of complete runs before the first group of which one fails, or that takes too long."""
        assert self._beside is not None
        self._fresh = False
        # A group takes at most the time of its runs one by one.
        self._beside.begin(seeds, recording, self._steps, max(int(self._steps * BREATH / (self._pace * LANES)), 1))
        going, began, before = True, time.perf_counter(), 0
        while going:
            with self._run.guard as guard:
                going = self._beside.go_on()
            if guard.changed:
                warn_of_arithmetic(self._run)
            if guard.interrupted:
                raise KeyboardInterrupt
            if going:
                _go_on(keep_going)
            if self._beside.done > before:
                began, before = time.perf_counter(), self._beside.done
            elif self._limit and time.perf_counter() - began > self._limit:
                break
        return self._beside.done

    def _twice(self, seeds: np.ndarray[Any, np.dtype[np.uint64]], keep_going: KeepGoing) -> Block:
        """Make the first runs one by one, and then in lock step: instances of an FMU may share something that they hide."""
        recording, count = self._room(LANES), len(seeds)
        if self._quick:
            block = self._one_by_one(seeds, recording[:count])
        else:
            block = self._each(seeds, recording[:count], keep_going)
        if len(block.steps) == count and not any(block.reasons):
            alone = block.recording.copy()
            self._agrees = self._together(np.resize(seeds, LANES), recording, keep_going) == LANES
            self._agrees = self._agrees and recording[:count].tobytes() == alone.tobytes()
            block = replace(block, recording=alone)
            if not self._agrees:
                self._beside_allowed = False
                self._shut()
        return block

    def _single(
        self, seed: int, keep_going: KeepGoing, recording: Floats | None = None, *, limited: bool = True
    ) -> Block:
        """Make one run piece by piece, because it is long, slow or interpreted."""
        run, recording = self._run, self._room(1) if recording is None else recording
        if not self._fresh and not self._put_back():
            self._give_up()
            raise _NotPutBackError
        run.recording, run.before, run.k, run.sound = recording[0], 0, -1, True
        if run.seed != seed:
            run.seed = seed
            if not self._goes_from_run_to_run:  # an interpreted engine holds random numbers of the old seed
                self._engine = choose_engine("auto", run)
                self._engine.prepare(self._steps * self._of)
        self._fresh = False

        limit = self._limit if limited else None
        stopped = advance(self._engine, self._steps, run, lambda step, steps: _go_on(keep_going), limit)
        if stopped:
            recording[0, max(run.k // self._decimation + 1, 0) :] = np.nan
            self._shut(broken=True)
        return Block(recording, np.array([run.k], dtype=np.int64), (stopped or "",))

    def _put_back(self) -> bool:
        """Restore memory and FMUs to the beginning; return whether that succeeded."""
        self._run.memory[:] = self._initial
        assert self._states is not None
        return all(_STATE(int(r))(int(component), int(place)) in WELL for r, component, place in self._states)

    def _give_up(self) -> None:
        """Restore no FMU from now on, because one could not be restored."""
        self._repeats = False
        self._shut(broken=True)

    def _once_more(self, seed: int, first: Floats, keep_going: KeepGoing) -> bool:
        """Return whether a repeated run with restored FMUs has the bits of the first; if not, each run gets new FMUs."""
        if self._states is None or not self._opened:
            return False
        if not len(self._states):
            return True  # without FMUs there is no hidden state
        if self._pace > self._opening * self._of:  # the comparison would take longer than new FMUs for all runs
            self._shut()
            return False
        ends, kept_ = self._run.memory.copy(), first.copy()
        try:
            again = (
                self._one_by_one(np.array([seed], dtype=np.uint64), self._room(1))
                if self._goes_from_run_to_run and self._quick
                else self._single(seed, keep_going, limited=False)
            )
        except _NotPutBackError:
            first[:] = kept_
            return False
        same = again.recording[0].tobytes() == kept_.tobytes()
        same = same and self._opened and self._run.memory.tobytes() == ends.tobytes()
        first[:] = kept_  # the repetition has overwritten it
        if not same:
            self._shut()
            warn_user(
                "An FMU gives other results after its initial state is restored; each run gets new "
                "instances of it, which is slower.",
                RuntimeWarning,
            )
        return same

    def _room(self, runs: int) -> Floats:
        if len(self._buffer) < runs:
            self._buffer = np.empty((runs, *self._buffer.shape[1:]))
        return self._buffer[:runs]

    def _nothing(self, reason: str) -> Block:
        """Return the block of a run that could not begin."""
        recording = self._room(1)
        recording[:] = np.nan
        self._shut()
        return Block(recording, np.array([-1], dtype=np.int64), (reason,))

    def _shut(self, *, broken: bool = False) -> None:
        """Free the FMUs. No function of a broken FMU may be called any more, not even to free a saved state."""
        if self._opened and not broken:
            for free, component, place in self._free:
                _STATE(free)(component, ctypes.addressof(place))
        self._free.clear()
        self._states, self._opened, self._fresh, self._beside = None, False, False, None
        with self._spares.lent():
            self._stack.close()


def _go_on(keep_going: KeepGoing) -> None:
    if not keep_going():
        raise StoppedFromOutside


__all__ = ["Block", "KeepGoing", "ManyRuns", "Overhead", "StoppedFromOutside"]
