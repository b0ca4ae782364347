"""The step of an FMU as compiled functions with the engine's signature, shared by all instances.

The instance's table of 64-bit words is at the address ``parameters``: pointers to the instance and to the FMI functions, the
value references, the step size. The status is 0, or one of `GET`, `SET`, `STEP`, `EVENTS` plus FMI's own status, or another of
the codes below. These functions are for ports that are doubles and may be set at any communication point. `typed_kernels` has
the functions for other ports.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.binaries.codes import (
    ANSWER,
    DISCARD,
    DUE,
    EARLY,
    ENDLESS,
    EVENT,
    EVENTS,
    GET,
    HAS_TERMINATED,
    LAST_TIME,
    NEXT_DEFINED,
    NEXT_TIME,
    NO_RETURN,
    REACHED,
    RETURNED_EARLY,
    SET,
    SMALLEST,
    STEP,
    TERMINATE,
    TERMINATED,
    TOLERANCE,
    TRIES,
    UPDATE,
    UPDATE_TERMINATE,
    failed as _failed,
)
from bayesftc.cosim.stepping.by_address import call_block
from bayesftc.cosim.stepping.numba_called import callee, inlined

# Words of the table.
(
    COMPONENT,
    GET_REAL,
    SET_REAL,
    DO_STEP,
    INPUTS,
    INPUT_COUNT,
    OUTPUTS,
    OUTPUT_COUNT,
    STEP_SIZE,
    SCRATCH,
    INPUT_SIZE,
    OUTPUT_SIZE,
    REAL_STATUS,
    BOOLEAN_STATUS,
    ENTER_EVENT_MODE,
    UPDATE_DISCRETE,
    ENTER_STEP_MODE,
    INPUT_GROUPS,
    INPUT_GROUP_COUNT,
    OUTPUT_GROUPS,
    OUTPUT_GROUP_COUNT,
    GRID,
    SETTLE,
) = range(23)
WORDS = 23

failed = inlined(_failed)

_I32, _I64, _DOUBLE = ir.IntType(32), ir.IntType(64), ir.DoubleType()


def place(builder, args, kind):
    """Return a pointer to an element: the first two arguments of an intrinsic are an address and an index."""
    begin = builder.add(args[0], builder.mul(args[1], ir.Constant(_I64, 8)))
    return builder.inttoptr(begin, kind.as_pointer())


def _loaded(kind, llvm):
    def codegen(context, builder, signature, args):
        return builder.load(place(builder, args, llvm))

    return kind(types.int64, types.int64), codegen


def _stored(kind, llvm):
    def codegen(context, builder, signature, args):
        builder.store(args[2], place(builder, args, llvm))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, kind), codegen


@intrinsic
def word(typingctx, address, index):
    """Load element `index` of the 64-bit integers at an address."""
    return _loaded(types.int64, _I64)


@intrinsic
def number(typingctx, address, index):
    """Load element `index` of the doubles at an address."""
    return _loaded(types.float64, _DOUBLE)


@intrinsic
def put_word(typingctx, address, index, value):
    """Store a 64-bit integer as element `index` at an address."""
    return _stored(types.int64, _I64)


@intrinsic
def put_number(typingctx, address, index, value):
    """Store a double as element `index` at an address."""
    return _stored(types.float64, _DOUBLE)


def call(builder, function, arguments):
    """Call a C function that returns an int, by its address."""
    kind = ir.FunctionType(_I32, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(function, kind.as_pointer()), arguments)


def as_given(*arguments):
    """Return signature and code of an intrinsic that passes its integers and doubles on to a C function."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], args[1:])

    return types.int32(*(types.float64 if a == types.float64 else types.int64 for a in arguments)), codegen


@intrinsic
def values2(typingctx, function, component, references, count, values):
    """int32 (*)(void *, const uint32 *, size_t, double *): fmi2GetReal and fmi2SetReal."""
    return as_given(function, component, references, count, values)


@intrinsic
def values3(typingctx, function, component, references, count, values, size):
    """int32 (*)(void *, const uint32 *, size_t, double *, size_t): fmi3GetFloat64, fmi3SetFloat64 and their relatives."""
    return as_given(function, component, references, count, values, size)


@intrinsic
def step2(typingctx, function, component, t, h, no_return):
    """int32 (*)(void *, double, double, int): fmi2DoStep; the last is noSetFMUStatePriorToCurrentPoint."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [*args[1:4], builder.trunc(args[4], _I32)])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), codegen


@intrinsic
def step3(typingctx, function, component, t, h, no_return, scratch):
    """int32 (*)(void *, double, double, bool, bool *, bool *, bool *, double *): fmi3DoStep.

    The bool by value travels in a register, so it is passed as the int that C would widen it to.
    """

    def codegen(context, builder, signature, args):
        places = [builder.add(args[5], ir.Constant(_I64, 8 * i)) for i in (EVENT, TERMINATE, RETURNED_EARLY, REACHED)]
        return call(builder, args[0], [*args[1:4], builder.trunc(args[4], _I32), *places])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64, types.int64), codegen


@intrinsic
def ask2(typingctx, function, component, kind, place):
    """int32 (*)(void *, int, void *): fmi2GetRealStatus and fmi2GetBooleanStatus."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [args[1], builder.trunc(args[2], _I32), args[3]])

    return types.int32(*[types.int64] * 4), codegen


@intrinsic
def mode3(typingctx, function, component):
    """int32 (*)(void *): fmi3EnterEventMode, fmi3EnterStepMode and their relatives."""
    return as_given(function, component)


@intrinsic
def update3(typingctx, function, component, place):
    """int32 (*)(void *, bool * (5), double *): fmi3UpdateDiscreteStates, which writes six consecutive words."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [args[1], *(builder.add(args[2], ir.Constant(_I64, 8 * i)) for i in range(6))])

    return types.int32(*[types.int64] * 3), codegen


@inlined
def _get(major, parameters, outputs):
    function, component, count = word(parameters, GET_REAL), word(parameters, COMPONENT), word(parameters, OUTPUT_COUNT)
    if count == 0:
        return 0
    if major == 2:
        return failed(GET, values2(function, component, word(parameters, OUTPUTS), count, outputs))
    size = word(parameters, OUTPUT_SIZE)
    return failed(GET, values3(function, component, word(parameters, OUTPUTS), count, outputs, size))


@inlined
def _set(major, parameters, inputs):
    function, component, count = word(parameters, SET_REAL), word(parameters, COMPONENT), word(parameters, INPUT_COUNT)
    if count == 0:
        return 0
    if major == 2:
        return failed(SET, values2(function, component, word(parameters, INPUTS), count, inputs))
    size = word(parameters, INPUT_SIZE)
    return failed(SET, values3(function, component, word(parameters, INPUTS), count, inputs, size))


@inlined
def _advance(major, parameters, inputs, t):
    status = _set(major, parameters, inputs)
    if status != 0:
        return status
    return do_step2(parameters, t) if major == 2 else do_step3(parameters, t)


@inlined
def do_step2(parameters, t):
    """Make a step of an FMI 2 instance; if it is discarded, in parts where the instance supports that."""
    h = number(parameters, STEP_SIZE)
    no_return = word(word(parameters, SCRATCH), NO_RETURN)
    status = step2(word(parameters, DO_STEP), word(parameters, COMPONENT), t, h, no_return)
    if status == DISCARD and word(parameters, REAL_STATUS) != 0:
        return _in_parts2(parameters, t, h)
    return failed(STEP, status)


@callee
def _in_parts2(parameters, t, h):
    component, scratch = word(parameters, COMPONENT), word(parameters, SCRATCH)
    no_return = word(scratch, NO_RETURN)
    answer = scratch + 8 * ANSWER
    now, end, part, status = t, t + h, h, DISCARD
    for _ in range(TRIES):
        if status == DISCARD:
            put_word(scratch, ANSWER, 0)
            if (
                ask2(word(parameters, BOOLEAN_STATUS), component, HAS_TERMINATED, answer) <= 1
                and word(scratch, ANSWER) != 0
            ):
                return STEP + DISCARD
            put_number(scratch, ANSWER, now)
            if ask2(word(parameters, REAL_STATUS), component, LAST_TIME, answer) > 1:
                return STEP + DISCARD
            reached = number(scratch, ANSWER)
            if not (reached >= now and reached <= now + part):
                return STEP + DISCARD
            now = reached
            part = 0.5 * part
            if part < SMALLEST * h:
                return STEP + DISCARD
        elif status != 0 and status != 1:
            return failed(STEP, status)
        else:
            now = now + part
        left = end - now
        if left <= TOLERANCE * h:
            return 0
        if part > left - TOLERANCE * h:
            part = left
        status = step2(word(parameters, DO_STEP), component, now, part, no_return)
    return ENDLESS


@inlined
def do_step3(parameters, t):
    """Make a step of an FMI 3 instance without event mode; continue it if it returns early or is discarded."""
    h = number(parameters, STEP_SIZE)
    scratch = word(parameters, SCRATCH)
    no_return = word(scratch, NO_RETURN)
    status = step3(word(parameters, DO_STEP), word(parameters, COMPONENT), t, h, no_return, scratch)
    if status != 0 and status != 1:
        return _go_on3(parameters, t, h, h, status)
    if word(scratch, TERMINATE) != 0:
        return TERMINATED
    if word(scratch, RETURNED_EARLY) != 0:
        return _go_on3(parameters, t, h, h, 0)
    return 0


@callee
def do_event_step3(parameters, t):
    """Make a step of an FMI 3 instance that uses event mode, with the events within it and at its end."""
    h = number(parameters, STEP_SIZE)
    slack = TOLERANCE * h
    size = _part3(parameters, t, h, slack, t + h - slack)
    scratch = word(parameters, SCRATCH)
    no_return = word(scratch, NO_RETURN)
    status = step3(word(parameters, DO_STEP), word(parameters, COMPONENT), t, size, no_return, scratch)
    return _go_on3(parameters, t, h, size, status)


@callee
def _go_on3(parameters, t, h, size, status):
    """Complete a step whose first part, of this size, has returned this status."""
    component, scratch = word(parameters, COMPONENT), word(parameters, SCRATCH)
    no_return = word(scratch, NO_RETURN)
    events = word(parameters, ENTER_EVENT_MODE) != 0
    now, end, most, slack = t, t + h, h, TOLERANCE * h
    for _ in range(TRIES):
        if status == DISCARD and number(parameters, GRID) == 0.0:
            most = 0.5 * size  # the FMU has made no progress
            if most < SMALLEST * h:
                return STEP + DISCARD
        elif status != 0 and status != 1:
            return failed(STEP, status)
        elif word(scratch, TERMINATE) != 0:
            return TERMINATED
        else:
            reached = number(scratch, REACHED) if word(scratch, RETURNED_EARLY) != 0 else now + size
            event = events and (word(scratch, EVENT) != 0 or _next_event3(scratch, end - slack) <= reached + slack)
            if not (reached > now or (event and reached == now)):
                return EARLY
            now = reached
            if event:
                status = failed(EVENTS, mode3(word(parameters, ENTER_EVENT_MODE), component))
                if status == 0:
                    status = settle3(parameters, now)
                if status != 0:
                    return status
        left = end - now
        if left <= slack:
            return 0
        size = _part3(parameters, now, most if most < left - slack else left, slack, end - slack)
        status = step3(word(parameters, DO_STEP), component, now, size, no_return, scratch)
    return ENDLESS


@callee
def _next_event3(scratch, last):
    """Return the time of the next event: from the last fmi3UpdateDiscreteStates, or of a clock that ticks before `last`."""
    event = number(scratch, NEXT_TIME) if word(scratch, NEXT_DEFINED) != 0 else np.inf
    due = number(scratch, DUE)
    return min(event, due) if due < last else event


@callee
def clock_is_due3(parameters, t):
    """Return whether a clock ticks at the beginning of the step from `t`."""
    h, due = number(parameters, STEP_SIZE), number(word(parameters, SCRATCH), DUE)
    return due <= t + TOLERANCE * h and due < t + h - TOLERANCE * h


@callee
def _part3(parameters, now, size, slack, last):
    """Return the size of the next part of a step: up to the next time event, if the step may be cut there."""
    if word(parameters, ENTER_EVENT_MODE) == 0:
        return size
    event = _next_event3(word(parameters, SCRATCH), last)
    if not (event > now + slack and event < now + size - slack):
        return size
    grid = number(parameters, GRID)
    part = event - now
    if grid > 0.0:
        part = math.ceil(part / grid - TOLERANCE) * grid
    return part if part < size - slack else size


@callee
def settle3(parameters, now):
    """Update the discrete states of an FMI 3 instance in event mode until they no longer change, then return to step mode.

    For instances with clocks this is done in Python, by a callback: see `Instance._settle`.
    """
    if word(parameters, SETTLE) != 0:
        return call_block(word(parameters, SETTLE), 0, parameters, 0, 0, now, 0)
    component, scratch = word(parameters, COMPONENT), word(parameters, SCRATCH)
    for _ in range(TRIES):
        status = failed(EVENTS, update3(word(parameters, UPDATE_DISCRETE), component, scratch + 8 * UPDATE))
        if status != 0:
            return status
        if word(scratch, UPDATE_TERMINATE) != 0:
            return TERMINATED
        if word(scratch, UPDATE) == 0:
            return failed(EVENTS, mode3(word(parameters, ENTER_STEP_MODE), component))
    return ENDLESS


def entries(get, advance):
    """Return the functions that the engine calls, by version of FMI and role.

    Parameters
    ----------
    get : callable
        Reads the outputs: ``get(major, parameters, outputs)`` returns a status.
    advance : callable
        Sets the inputs and makes a step: ``advance(major, parameters, inputs, t)``.
    """

    def of(major):
        def read(state, parameters, inputs, outputs, t, k):
            return get(major, parameters, outputs)

        def update(state, parameters, inputs, outputs, t, k):
            return advance(major, parameters, inputs, t)

        def sampled(state, parameters, inputs, outputs, t, k):
            status = advance(major, parameters, inputs, t)
            if status != 0:
                return status
            return get(major, parameters, outputs)

        return {(major, "get"): read, (major, "advance"): update, (major, "sampled"): sampled}

    return {**of(2), **of(3)}


FUNCTIONS = entries(_get, _advance)
