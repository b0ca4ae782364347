"""The tables of the compiled loop for all diagrams, as words in memory, and calls of its functions.

Each of these functions has the engine's signature and reads all else from words: of the diagram and the run (`Program`), and for
many runs from further ones. A live run makes a call for each step; passing arrays one by one took longer than the step.
"""

from __future__ import annotations

import ctypes
from functools import cache
from struct import Struct
from typing import Any

import numpy as np

from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.types import ENTRY, Floats

Whole = np.ndarray[Any, np.dtype[np.int64]]
Seeds = np.ndarray[Any, np.dtype[np.uint64]]

# Columns of the table of calls.
FUNCTION, EVERY, STATE, PARAMETERS, INPUTS, OUTPUTS, GATHER_FROM, GATHER_TO, CHECK_FROM, CHECK_TO = range(10)
COLUMNS = 10

# Words of a program; its tables of integers follow, one after the other.
(
    CALLS,
    EVALUATIONS,
    GATHERS,
    FUSED,
    DRAWN,
    RECORDED,
    DECIMATION,
    NUMERATOR,
    DENOMINATOR,
    MEMORY,
    SIZE,
    STREAMS,
    BUFFER,
    SURROUNDINGS,
    FAILED,
    STATUS,
    LAST,
    RECORDING,
    SEED,
    BEFORE,
    FIRST,
    BEGIN,
    END,
    TABLES,
) = range(24)

# Words for many runs, after the program's address: one by one, and in lock step.
PROGRAM, RECORDINGS, STRIDE, SEEDS, RUNS, INITIAL, STATES, STATE_COUNT, FRESH, LENGTH, REACHED, DONE = range(12)
LOOP, ALL_CALLS, BUFFERS, OWN, WIDE, LANES, PIECE, AT = range(12, 20)
UNBEGUN = -1
"""The step AT which runs in lock step are that have not begun."""

_write_piece = Struct("qQqqqq").pack_into
"""Writes the words from RECORDING to END."""

_AT = 8 * RECORDING

_BRIEF = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
"""The first argument of `ENTRY`, for a function that reads no others: to convert all six takes longer than most steps."""

_byte_of, _address_of = ctypes.c_char.from_buffer, ctypes.addressof


class Program:
    """The words of one run of a diagram.

    Parameters
    ----------
    calls : ndarray of int64, calls x COLUMNS
        The calls of step functions: at first those that compute outputs, then those that advance states.
    evaluations : int
        Number of the former.
    gathers : ndarray of int64, gathers x 2
        Copies (target, source) before the calls.
    drawn, recorded : ndarray of int64
        Places in memory of the random numbers, and of what is recorded.
    decimation : int
        Steps between two recorded rows.
    clock : (int, int)
        Numerator and denominator of the step in seconds.
    memory : ndarray
        The run's memory, which stays the same array.
    streams : ndarray of uint64, numbers x 4
        The random streams.
    surroundings : int
        The address of what `advance` restores, or 0; see `bayesftc.cosim.fmi.binaries.surroundings.Surroundings`.

    Attributes
    ----------
    calls : ndarray of int64
        See above.
    words : ndarray of int64
        All tables.
    address : int
        The address of the words.
    """

    def __init__(
        self,
        calls: Whole,
        evaluations: int,
        gathers: Whole,
        drawn: Whole,
        recorded: Whole,
        decimation: int,
        clock: tuple[int, int],
        memory: Floats,
        streams: Seeds,
        surroundings: int,
    ):
        self.calls = calls
        self._kept = memory, streams, np.empty((len(drawn) + SPARE, CHUNK))
        counts = len(calls), evaluations, len(gathers), 0, len(drawn), len(recorded), decimation, *clock
        places = memory.ctypes.data, memory.size, *(array.ctypes.data for array in self._kept[1:])
        head = np.array([*counts, *places, surroundings, -1, *[0] * (TABLES - FAILED - 1)], dtype=np.int64)
        self.words = np.concatenate([head, calls.ravel(), gathers.ravel(), drawn, recorded])
        self.address = self.words.ctypes.data
        self._bytes = memoryview(self.words).cast("B")  # type: ignore[arg-type]
        self._advance, self._place = function("advance", _BRIEF), ctypes.c_void_p(self.address)

    def advance(self, recording: Floats, seed: int, before: int, first: bool, begin: int, end: int) -> bool:
        """Run from t_begin to t_end; return whether that failed, see `failure` and `last`."""
        place = _address_of(_byte_of(recording)) if recording.size else 0  # type: ignore[arg-type]
        _write_piece(self._bytes, _AT, place, seed, before, first, begin, end)
        failed: int = self._advance(self._place)
        return failed != 0

    def make_many(
        self,
        seeds: Seeds,
        initial: Floats,
        states: Whole,
        recordings: Floats,
        reached: Whole,
        end: int,
        *,
        fresh: bool,
    ) -> int:
        """Make runs; see `bayesftc.cosim.run.engines.CompiledEngine.advance_many`. Return how many are complete."""
        places = [array.ctypes.data for array in (seeds, initial, states, reached)]
        many = np.array(
            [
                self.address,
                recordings.ctypes.data,
                recordings.strides[0],
                places[0],
                len(seeds),
                places[1],
                places[2],
                len(states),
                int(fresh),
                end,
                places[3],
                0,
            ],
            dtype=np.int64,
        )
        function("run_many")(many.ctypes.data, 0, 0, 0, 0.0, 0)
        return int(many[DONE])

    def make_calls(self, begin: int, end: int, t: float, k: int) -> tuple[int, int]:
        """Make the calls from row `begin` to `end` at step `k`; return the failure."""
        function("phase")(self.address, 0, begin, end, t, k)
        return self.failure

    @property
    def failure(self) -> tuple[int, int]:
        """The row of the call that failed, or -1, and its status."""
        return int(self.words[FAILED]), int(self.words[STATUS])

    @property
    def last(self) -> int:
        """The last complete step."""
        return int(self.words[LAST])


@cache
def function(name: str, kind: Any = ENTRY) -> Any:
    """Return a function of `bayesftc.cosim.run.general.loop` as one of this type, from the disk if it is there."""
    from bayesftc.cosim.stepping.machine.services import service_address

    def find() -> Any:
        from bayesftc.cosim.run.general import loop

        return getattr(loop, name)

    return kind(service_address(f"loop_{name}", find))
