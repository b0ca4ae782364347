"""The compiled co-simulation loop: one function for all diagrams, which reads tables and calls blocks by address.

The functions without underscore have the engine's signature; the words named in `program` are at the address ``state``.
"""

import numpy as np
from numba import carray

from bayesftc.cosim.diagram.schedule import NOT_FINITE
from bayesftc.cosim.drawing import fill
from bayesftc.cosim.fmi.binaries.surroundings_kernels import noted, restored
from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.run.general.program import (
    ALL_CALLS,
    AT,
    BEFORE,
    BEGIN,
    BUFFER,
    BUFFERS,
    CALLS,
    CHECK_FROM,
    CHECK_TO,
    COLUMNS,
    DECIMATION,
    DENOMINATOR,
    DONE,
    DRAWN,
    END,
    EVALUATIONS,
    EVERY,
    FAILED,
    FIRST,
    FRESH,
    FUNCTION,
    FUSED,
    GATHER_FROM,
    GATHER_TO,
    GATHERS,
    INITIAL,
    INPUTS,
    LANES,
    LAST,
    LENGTH,
    LOOP,
    MEMORY,
    NUMERATOR,
    OUTPUTS,
    OWN,
    PARAMETERS,
    PIECE,
    PROGRAM,
    REACHED,
    RECORDED,
    RECORDING,
    RECORDINGS,
    RUNS,
    SEED,
    SEEDS,
    SIZE,
    STATE,
    STATE_COUNT,
    STATES,
    STATUS,
    STREAMS,
    STRIDE,
    SURROUNDINGS,
    TABLES,
    UNBEGUN,
    WIDE,
)
from bayesftc.cosim.stepping.by_address import as_floats, as_integers, call_block, call_loop, put_back
from bayesftc.cosim.stepping.numba_called import callee, inlined


# Inlined: for a call, numba would pass 32 words of array descriptions, twice a step, which took longer than the FMU.
@inlined
def _calls(calls, begin, end, gathers, memory, base, t, k, words):
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
            calls[c, FUNCTION],
            base + 8 * calls[c, STATE],
            base + 8 * calls[c, PARAMETERS],
            base + 8 * calls[c, INPUTS],
            base + 8 * calls[c, OUTPUTS],
            t,
            count,
        )
        if status != 0:
            words[FAILED], words[STATUS] = c, status
            return False
        for i in range(calls[c, CHECK_FROM], calls[c, CHECK_TO]):
            if memory[np.uint64(i)] - memory[np.uint64(i)] != 0.0:
                words[FAILED], words[STATUS] = c, NOT_FINITE + i
                return False
    return True


@callee
def _advance(address, words):
    """Run from t_begin to t_end; return the last step whose outputs are complete (``begin - 1`` for none).

    Step `begin` is evaluated only if `first` is not 0. The first row of the recording is number `before` of the whole run.
    """
    if words[FUSED] != 0:
        return _advance_fused(address, words)
    calls = carray(as_integers(address + 8 * TABLES), (words[CALLS], COLUMNS))
    gathers = carray(as_integers(address + 8 * (TABLES + words[CALLS] * COLUMNS)), (words[GATHERS], 2))
    memory = carray(as_floats(words[MEMORY]), (words[SIZE],))
    streams = carray(as_integers(words[STREAMS]), (words[DRAWN], 4)).view(np.uint64)
    buffer = carray(as_floats(words[BUFFER]), (words[DRAWN] + SPARE, CHUNK))
    drawn_at = address + 8 * (TABLES + words[CALLS] * COLUMNS + 2 * words[GATHERS])
    drawn = carray(as_integers(drawn_at), (words[DRAWN],))
    recorded = carray(as_integers(drawn_at + 8 * words[DRAWN]), (words[RECORDED],))
    recording = carray(as_floats(words[RECORDING]), (words[END] + 1, words[RECORDED]))
    evaluations, numerator, denominator = words[EVALUATIONS], words[NUMERATOR], words[DENOMINATOR]
    decimation, before, end, seed = words[DECIMATION], words[BEFORE], words[END], np.uint64(words[SEED])
    base, chunk, k, evaluate = words[MEMORY], -1, words[BEGIN], words[FIRST] != 0
    while True:
        t = k * numerator / denominator  # the quotient of two exact integers: the double nearest to k * step
        if evaluate:
            if drawn.size > 0:
                if k // CHUNK != chunk:
                    chunk = k // CHUNK
                    fill(seed, streams, chunk * CHUNK, buffer)
                for j in range(drawn.size):
                    memory[drawn[j]] = buffer[j, k - chunk * CHUNK]
            if not _calls(calls, 0, evaluations, gathers, memory, base, t, k, words):
                return k - 1
            if k % decimation == 0:
                row = k // decimation - before
                for j in range(recorded.size):
                    recording[row, j] = memory[recorded[j]]
        if k == end:
            return k
        if not _calls(calls, evaluations, calls.shape[0], gathers, memory, base, t, k, words):
            return k
        k += 1
        evaluate = True


@callee
def _advance_fused(address, words):
    streams = carray(as_integers(words[STREAMS]), (words[DRAWN], 4)).view(np.uint64)
    buffer = carray(as_floats(words[BUFFER]), (words[DRAWN] + SPARE, CHUNK))
    k, evaluate, end, seed = words[BEGIN], words[FIRST], words[END], np.uint64(words[SEED])
    while evaluate != 0 or k != end:
        chunk = (k if evaluate != 0 else k + 1) // CHUNK
        if words[DRAWN] > 0:
            fill(seed, streams, chunk * CHUNK, buffer)
        k = call_loop(
            words[FUSED],
            words[MEMORY],
            address + 8 * TABLES,
            words[BUFFER],
            words[RECORDING],
            address + 8 * FAILED,
            words[BEFORE],
            evaluate,
            k,
            min(end, chunk * CHUNK + CHUNK - 1),
        )
        if words[FAILED] >= 0:
            return k
        evaluate = 0
    return k


def advance(state, parameters, inputs, outputs, t, k):
    """Run a piece of a run; return 1 if it fails. LAST becomes its last complete step, FAILED and STATUS a failure."""
    words = carray(as_integers(state), (TABLES,))
    words[FAILED] = -1
    if words[SURROUNDINGS] != 0:
        noted(words[SURROUNDINGS])
    words[LAST] = _advance(state, words)
    if words[SURROUNDINGS] != 0:
        restored(words[SURROUNDINGS])
    return words[FAILED] >= 0


def phase(state, parameters, inputs, outputs, t, k):
    """Make the calls from row `inputs` to `outputs` at step `k`; FAILED and STATUS become a failure."""
    words = carray(as_integers(state), (TABLES,))
    words[FAILED] = -1
    calls = carray(as_integers(state + 8 * TABLES), (words[CALLS], COLUMNS))
    gathers = carray(as_integers(state + 8 * (TABLES + words[CALLS] * COLUMNS)), (words[GATHERS], 2))
    memory = carray(as_floats(words[MEMORY]), (words[SIZE],))
    _calls(calls, inputs, outputs, gathers, memory, words[MEMORY], t, k, words)
    return 0


@callee
def _put_back(states, count):
    """Restore the FMUs of a run to its beginning; return the row of the first that fails, or -1, and its status."""
    for j in range(count):
        status = put_back(states[j, 0], states[j, 1], states[j, 2])
        if status < 0 or status > 1:  # 1 is FMI's warning
            return j, status
    return -1, 0


def run_many(state, parameters, inputs, outputs, t, k):
    """Make a run to t_end for each seed, each from the same beginning; DONE becomes the number of complete runs.

    STATES has a row for each FMU: the function that restores it, the instance, and the state. If FRESH is not 0, the first run
    starts without restoring. REACHED gets the last complete step of each run. The function stops at the first run that fails,
    with a failure as in `advance`. If an FMU cannot be restored, it is -2 minus its row, and the status.
    """
    many = carray(as_integers(state), (DONE + 1,))
    program = many[PROGRAM]
    words = carray(as_integers(program), (TABLES,))
    memory = carray(as_floats(words[MEMORY]), (words[SIZE],))
    initial = carray(as_floats(many[INITIAL]), (words[SIZE],))
    states = carray(as_integers(many[STATES]), (many[STATE_COUNT], 3))
    seeds = carray(as_integers(many[SEEDS]), (many[RUNS],))
    reached = carray(as_integers(many[REACHED]), (many[RUNS],))
    words[FAILED] = -1
    words[BEFORE], words[FIRST], words[BEGIN], words[END] = 0, 1, 0, many[LENGTH]
    many[DONE] = 0
    for i in range(many[RUNS]):
        if i > 0 or many[FRESH] == 0:
            for j in range(words[SIZE]):
                memory[j] = initial[j]
            row, status = _put_back(states, many[STATE_COUNT])
            if row >= 0:
                words[FAILED], words[STATUS] = -2 - row, status
                reached[i] = -1
                return 0
        words[SEED], words[RECORDING] = seeds[i], many[RECORDINGS] + i * many[STRIDE]
        reached[i] = _advance(program, words)
        if words[FAILED] >= 0:
            return 0
        many[DONE] = i + 1
    return 0


def run_lanes(state, parameters, inputs, outputs, t, k):
    """Make the runs of SEEDS to t_end, LANES of them in lock step, from run DONE on, which becomes the number of complete ones.

    OWN is the memory of the runs, with a row for each, and WIDE the one with all lanes of each number. INITIAL has the first
    content of each run's memory, and STATES for each its table as in `run_many`. After PIECE steps the function pauses: AT is
    then the step of the group of runs that is not complete, and the next call continues it. Else AT is `UNBEGUN`, and all runs
    are complete, or one of the next group has failed.
    """
    many = carray(as_integers(state), (AT + 1,))
    words, lanes = carray(as_integers(many[PROGRAM]), (TABLES,)), many[LANES]
    size, drawn = words[SIZE], words[DRAWN]
    own = carray(as_floats(many[OWN]), (lanes, size))
    initial = carray(as_floats(many[INITIAL]), (lanes, size))
    wide = carray(as_floats(many[WIDE]), (size, lanes))
    states = carray(as_integers(many[STATES]), (lanes, many[STATE_COUNT], 3))
    seeds = carray(as_integers(many[SEEDS]), (many[RUNS],))
    streams = carray(as_integers(words[STREAMS]), (drawn, 4)).view(np.uint64)
    buffers = carray(as_floats(many[BUFFERS]), (lanes, drawn + SPARE, CHUNK))
    i, made = many[DONE], 0
    while i + lanes <= many[RUNS]:
        step, evaluate = many[AT], 0
        many[AT] = UNBEGUN
        if step == UNBEGUN:
            step, evaluate = 0, 1
            for lane in range(lanes):
                for j in range(size):
                    own[lane, j] = initial[lane, j]
                    wide[j, lane] = initial[lane, j]
                row, _ = _put_back(states[lane], many[STATE_COUNT])
                if row >= 0:
                    return 0
        while evaluate != 0 or step != many[LENGTH]:
            if evaluate == 0 and made >= many[PIECE]:
                many[AT] = step
                return 0
            chunk = (step if evaluate != 0 else step + 1) // CHUNK
            for lane in range(lanes):
                fill(np.uint64(seeds[i + lane]), streams, chunk * CHUNK, buffers[lane])
            step = call_loop(
                many[LOOP],
                many[WIDE],
                many[ALL_CALLS],
                many[BUFFERS],
                many[RECORDINGS] + i * many[STRIDE],
                many[OWN],
                many[STRIDE] // 8,
                evaluate,
                step,
                min(many[LENGTH], chunk * CHUNK + CHUNK - 1),
            )
            if step < 0:
                return 0
            evaluate, made = 0, made + CHUNK
        many[DONE] = i = i + lanes
    return 0
