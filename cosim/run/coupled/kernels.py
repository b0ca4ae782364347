"""A group as a compiled function with the engine's signature; like the loop, it reads tables."""

# mypy checks the intrinsics with the typing context as an argument, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

from numba import carray

from bayesftc.cosim.diagram.schedule import NOT_FINITE
from bayesftc.cosim.fmi.running.kernels import number, put_word, word
from bayesftc.cosim.run.coupled.steps import PART, RECORD_WORDS, SAVING, STATUS, WORK_ROWS, Doubling, Iteration, build
from bayesftc.cosim.run.general.program import (
    CHECK_FROM,
    CHECK_TO,
    COLUMNS as LOOP_COLUMNS,
    EVERY,
    FUNCTION,
    GATHER_FROM,
    GATHER_TO,
    INPUTS,
    OUTPUTS,
    PARAMETERS,
    STATE,
)
from bayesftc.cosim.stepping.by_address import as_floats, as_integers, call_block, put_back as call_state
from bayesftc.cosim.stepping.numba_called import callee

# The table of parts has the columns of the loop's table of calls, and one more: whether time is that at the end of the step.
LATE = LOOP_COLUMNS
COLUMNS = LOOP_COLUMNS + 1

# Words of the table at the address of the function's parameters.
(
    BASE,
    MEMORY,
    PARTS,
    PART_COUNT,
    GATHERS,
    GATHER_COUNT,
    FMUS,
    FMU_COUNT,
    STATES,
    STATE_COUNT,
    KEPT,
    KEPT_SIZE,
    TORN,
    TORN_COUNT,
    GUESSES,
    DOUBLING,
    DOUBLING_COUNT,
    SIZE_AT,
    WORK,
    NUMBERS,
    NUMBER_COUNT,
    RECORD,
    LIMIT,
    METHOD,
    TOLERANCE,
    ERROR,
    DIVISOR,
    GROWTH,
    LENGTH,
) = range(29)

# Words of memory for each FMU that is restored.
COMPONENT, SAVE, RESTORE, FREE, SAVED = range(5)


@callee
def _sweep(machine, memory, t, h, k, record):
    base, parts, gathers, _, _, _ = machine
    for c in range(parts.shape[0]):
        every = parts[c, EVERY]
        if k % every != 0:
            continue
        for g in range(parts[c, GATHER_FROM], parts[c, GATHER_TO]):
            value = memory[gathers[g, 1]]
            if gathers[g, 2] >= 0:
                value = 0.5 * (memory[gathers[g, 2]] + value)
            memory[gathers[g, 0]] = value
        status = call_block(
            parts[c, FUNCTION],
            base + 8 * parts[c, STATE],
            base + 8 * parts[c, PARAMETERS],
            base + 8 * parts[c, INPUTS],
            base + 8 * parts[c, OUTPUTS],
            t + h if parts[c, LATE] != 0 else t,
            k // every,
        )
        if status != 0:
            record[PART], record[STATUS] = c, status
            return 1
        for i in range(parts[c, CHECK_FROM], parts[c, CHECK_TO]):
            if memory[i] - memory[i] != 0.0:
                record[PART], record[STATUS] = c, NOT_FINITE + i
                return 1
    return 0


@callee
def _each_fmu(machine, role, slot):
    base, fmus = machine[0], machine[3]
    for f in range(fmus.shape[0]):
        place = base + 8 * fmus[f, 0]
        state = place + 8 * (SAVED + slot)
        function, component = word(place, role), word(place, COMPONENT)
        status = call_state(function, component, word(state, 0) if role == RESTORE else state)
        if role == FREE:
            put_word(state, 0, 0)  # no state, even if the FMU has left a pointer there
        if status > 1 or status < 0:
            return SAVING + status
    return 0


@callee
def _save(machine, memory, slot):
    states, kept, at = machine[4], machine[5], 0
    for s in range(states.shape[0]):
        for i in range(states[s, 0], states[s, 1]):
            kept[slot, at] = memory[i]
            at += 1
    return _each_fmu(machine, SAVE, slot)


@callee
def _restore(machine, memory, slot):
    states, kept, at = machine[4], machine[5], 0
    for s in range(states.shape[0]):
        for i in range(states[s, 0], states[s, 1]):
            memory[i] = kept[slot, at]
            at += 1
    return _each_fmu(machine, RESTORE, slot)


@callee
def _forget(machine, memory, slot):
    return _each_fmu(machine, FREE, slot)


@callee
def _resize(machine, memory, h):
    _, _, _, fmus, _, _ = machine
    for f in range(fmus.shape[0]):
        memory[fmus[f, 1]] = h


_compute = build(_sweep, _save, _restore, _forget, _resize, callee)


def group(state, parameters, inputs, outputs, t, k):
    """Compute a group."""
    base = word(parameters, BASE)
    memory = carray(as_floats(base), (word(parameters, MEMORY),))
    torn = carray(as_integers(word(parameters, TORN)), (word(parameters, TORN_COUNT),))
    guesses = carray(as_integers(word(parameters, GUESSES)), (word(parameters, TORN_COUNT),))
    machine = (
        base,
        carray(as_integers(word(parameters, PARTS)), (word(parameters, PART_COUNT), COLUMNS)),
        carray(as_integers(word(parameters, GATHERS)), (word(parameters, GATHER_COUNT), 3)),
        carray(as_integers(word(parameters, FMUS)), (word(parameters, FMU_COUNT), 2)),
        carray(as_integers(word(parameters, STATES)), (word(parameters, STATE_COUNT), 2)),
        carray(as_floats(word(parameters, KEPT)), (2, word(parameters, KEPT_SIZE))),
    )
    iteration = Iteration(
        torn,
        guesses,
        carray(as_floats(word(parameters, WORK)), (WORK_ROWS, word(parameters, TORN_COUNT))),
        carray(as_floats(word(parameters, NUMBERS)), (word(parameters, NUMBER_COUNT),)),
        number(parameters, TOLERANCE),
        word(parameters, LIMIT),
        word(parameters, METHOD),
    )
    doubling = Doubling(
        carray(as_integers(word(parameters, DOUBLING)), (word(parameters, DOUBLING_COUNT), 5)),
        word(parameters, SIZE_AT),
        number(parameters, ERROR),
        number(parameters, DIVISOR),
        number(parameters, GROWTH),
    )
    record = carray(as_integers(word(parameters, RECORD)), (RECORD_WORDS,))
    return _compute(machine, memory, iteration, doubling, t, number(parameters, LENGTH), k, record)
