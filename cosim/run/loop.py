"""The compiled co-simulation loop: one function for all diagrams, which reads tables and calls blocks by address."""

import numpy as np

from bayesftc.cosim.diagram.schedule import NOT_FINITE
from bayesftc.cosim.random import CHUNK, SPARE, fill
from bayesftc.cosim.stepping.by_address import call_block, call_loop, put_back
from bayesftc.cosim.stepping.numba_called import callee, inlined

# Columns of the table of calls.
FUNCTION, EVERY, STATE, PARAMETERS, INPUTS, OUTPUTS, GATHER_FROM, GATHER_TO, CHECK_FROM, CHECK_TO = range(10)
COLUMNS = 10

BEGINNING = (
    "Tuple((float64[::1], int64[:, ::1], int64))"  # memory, saved states of FMUs, whether these are there already
)

# The first words of the table of `advance`; the tables of integers follow, one after the other.
CALLS, EVALUATIONS, GATHERS, FUSED, DRAWN, RECORDED, DECIMATION, NUMERATOR, DENOMINATOR, FAILED, STATUS, TABLES = range(
    12
)

TABLES_OF_RUN = "int64[::1], uint64[:, ::1], float64[:, ::1], float64[::1]"  # words, streams, buffer, memory

SIGNATURES = {
    "advance": f"int64({TABLES_OF_RUN}, float64[:, ::1], uint64, int64, int64, int64, int64)",
    "run_many": f"int64({TABLES_OF_RUN}, float64[:, :, ::1], uint64[::1], {BEGINNING}, int64, int64[::1])",
    "run_lanes": (
        "int64(int64, int64[:, :, ::1], uint64[:, ::1], float64[:, :, ::1], Tuple((float64[:, ::1], float64[:, ::1])), "
        "float64[:, :, ::1], uint64[::1], Tuple((float64[:, ::1], int64[:, :, ::1])), int64)"
    ),
    "phase": "boolean(int64[:, ::1], int64, int64, int64[:, ::1], float64[::1], float64, int64, int64[::1])",
}


# Inlined: for a call, numba would pass 32 words of array descriptions, twice a step, which took longer than the FMU.
@inlined
def _phase(calls, begin, end, gathers, memory, base, t, k, failed):
    # Unsigned, so that numba generates no code for negative indices: this saves a tenth of the time of a small loop.
    for c in range(np.uint64(begin), np.uint64(end)):
        every = calls[c, EVERY]
        count = k
        if every != 1:
            if k % every != 0:
                continue
            count = k // every
        for g in range(np.uint64(calls[c, GATHER_FROM]), np.uint64(calls[c, GATHER_TO])):
            memory[np.uint64(gathers[g, 0])] = memory[np.uint64(gathers[g, 1])]
        if calls[c, FUNCTION] == 0:  # this call only copies inputs
            continue
        status = call_block(
            calls[c, FUNCTION], base + 8 * calls[c, STATE], base + 8 * calls[c, PARAMETERS],
            base + 8 * calls[c, INPUTS], base + 8 * calls[c, OUTPUTS], t, count,
        )  # fmt: skip
        if status != 0:
            failed[0], failed[1] = c, status
            return False
        for i in range(calls[c, CHECK_FROM], calls[c, CHECK_TO]):
            if memory[np.uint64(i)] - memory[np.uint64(i)] != 0.0:
                failed[0], failed[1] = c, NOT_FINITE + i
                return False
    return True


@callee
def phase(calls, begin, end, gathers, memory, t, k, failed):
    """Make the calls from row `begin` to `end` at step `k`; return False if one fails, and write it to ``failed``."""
    return _phase(calls, begin, end, gathers, memory, memory.ctypes.data, t, k, failed)


@callee
def run(program, noise, recorder, clock, memory, recording, seed, before, first, begin, end, failed):
    """Run the loop from t_begin to t_end; return the last step whose outputs are complete (``begin - 1`` for none).

    Evaluates step `begin` only if `first` is not 0. The first row of `recording` is number `before` of the whole run. On failure
    ``failed`` holds the call and its status.
    """
    if program[3] != 0:
        return _run_fused(program, noise, memory, recording, seed, before, first, begin, end, failed)
    calls, evaluations, gathers, _ = program
    streams, drawn, buffer = noise
    recorded, decimation = recorder
    numerator, denominator = clock
    base = memory.ctypes.data
    chunk = -1
    k = begin
    evaluate = first != 0
    while True:
        t = k * numerator / denominator  # the quotient of two exact integers: the double nearest to k * step
        if evaluate:
            if drawn.size > 0:
                if k // CHUNK != chunk:
                    chunk = k // CHUNK
                    fill(seed, streams, chunk * CHUNK, buffer)
                for j in range(drawn.size):
                    memory[drawn[j]] = buffer[j, k - chunk * CHUNK]
            if not _phase(calls, 0, evaluations, gathers, memory, base, t, k, failed):
                return k - 1
            if k % decimation == 0:
                row = k // decimation - before
                for j in range(recorded.size):
                    recording[row, j] = memory[recorded[j]]
        if k == end:
            return k
        if not _phase(calls, evaluations, calls.shape[0], gathers, memory, base, t, k, failed):
            return k
        k += 1
        evaluate = True


@callee
def _run_fused(program, noise, memory, recording, seed, before, first, begin, end, failed):
    calls, _, _, fused = program
    streams, drawn, buffer = noise
    k = begin
    evaluate = first
    while evaluate != 0 or k != end:
        chunk = (k if evaluate != 0 else k + 1) // CHUNK
        if drawn.size > 0:
            fill(seed, streams, chunk * CHUNK, buffer)
        k = call_loop(
            fused, memory.ctypes.data, calls.ctypes.data, buffer.ctypes.data, recording.ctypes.data, failed.ctypes.data,
            before, evaluate, k, min(end, chunk * CHUNK + CHUNK - 1),
        )  # fmt: skip
        if failed[0] >= 0:
            return k
        evaluate = 0
    return k


@callee
def advance(words, streams, buffer, memory, recording, seed, before, first, begin, end):
    """Run the loop as `run` does, with its tables in `words`, in which FAILED and STATUS get a failure.

    A step of a live run is one call: to pass the arrays and tuples of `run` one by one took longer than all the rest.
    """
    gathers_at = TABLES + words[CALLS] * COLUMNS
    drawn_at = gathers_at + 2 * words[GATHERS]
    recorded_at = drawn_at + words[DRAWN]
    calls = words[TABLES:gathers_at].reshape((words[CALLS], COLUMNS))
    gathers = words[gathers_at:drawn_at].reshape((words[GATHERS], 2))
    recorder = words[recorded_at : recorded_at + words[RECORDED]], words[DECIMATION]
    program, noise = (calls, words[EVALUATIONS], gathers, words[FUSED]), (streams, words[drawn_at:recorded_at], buffer)
    clock = words[NUMERATOR], words[DENOMINATOR]
    words[FAILED] = -1
    failed = words[FAILED:TABLES]
    return run(program, noise, recorder, clock, memory, recording, seed, before, first, begin, end, failed)


@callee
def run_many(words, streams, buffer, memory, recordings, seeds, beginning, end, reached):
    """Make a run to t_end for each seed, each from the same `beginning`; return how many are done.

    Each row of its states has the function that restores an FMU, the instance, and the state. If its last number is not 0, the
    first run starts without restoring. ``reached`` gets the last complete step of each run. The function stops at the first run
    that fails, with a failure in `words` as in `advance`. If an FMU cannot be restored, it is -2 minus its row, and the status.
    """
    initial, states, fresh = beginning
    words[FAILED] = -1
    for i in range(seeds.size):
        if i > 0 or fresh == 0:
            for j in range(memory.size):
                memory[j] = initial[j]
            for j in range(states.shape[0]):
                status = put_back(states[j, 0], states[j, 1], states[j, 2])
                if status < 0 or status > 1:  # 1 is FMI's warning
                    words[FAILED], words[STATUS] = -2 - j, status
                    reached[i] = -1
                    return i
        reached[i] = advance(words, streams, buffer, memory, recordings[i], seeds[i], 0, 1, 0, end)
        if words[FAILED] >= 0:
            return i
    return seeds.size


@callee
def run_lanes(function, calls, streams, buffers, memories, recordings, seeds, beginning, end):
    """Make the runs of `seeds` to t_end, as many in lock step as `calls` has tables; return how many are done.

    `memories` are those of the runs, with a row for each, and the one with all lanes of each number. `beginning` has the first
    content of each run's memory, and for each its table of saved states as in `run_many`. The function stops at the first group
    of runs of which one fails.
    """
    own, wide = memories
    initial, states = beginning
    lanes, size = own.shape
    stride = recordings.shape[1] * recordings.shape[2]
    for i in range(0, seeds.size - lanes + 1, lanes):
        for lane in range(lanes):
            for j in range(size):
                own[lane, j] = initial[lane, j]
                wide[j, lane] = initial[lane, j]
            for j in range(states.shape[1]):
                status = put_back(states[lane, j, 0], states[lane, j, 1], states[lane, j, 2])
                if status < 0 or status > 1:
                    return i
        k, evaluate = 0, 1
        while evaluate != 0 or k != end:
            chunk = (k if evaluate != 0 else k + 1) // CHUNK
            for lane in range(lanes):
                fill(seeds[i + lane], streams, chunk * CHUNK, buffers[lane])
            k = call_loop(
                function, wide.ctypes.data, calls.ctypes.data, buffers.ctypes.data, recordings[i].ctypes.data,
                own.ctypes.data, stride, evaluate, k, min(end, chunk * CHUNK + CHUNK - 1),
            )  # fmt: skip
            if k < 0:
                return i
            evaluate = 0
    return seeds.size // lanes * lanes


def empty_chunk(numbers):
    """Return a buffer of random numbers for `run`."""
    return np.empty((numbers + SPARE, CHUNK))


def words(calls, evaluations, gathers, drawn, recorded, decimation, clock):
    """Return the table of `advance`: of calls, of gathers, of places of random numbers and of what is recorded."""
    sizes = len(calls), evaluations, len(gathers), 0, len(drawn), len(recorded)
    tables = calls.ravel(), gathers.ravel(), drawn, recorded
    return np.concatenate([np.array([*sizes, decimation, *clock, -1, 0], dtype=np.int64), *tables])
