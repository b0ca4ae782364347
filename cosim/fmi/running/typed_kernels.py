"""The step of an FMU with ports of several types, or with inputs that may only change at events, as compiled functions.

In the engine all ports are float64 arrays. Here they are in groups, each of one type, and are converted exactly. A value that
does not fit its type is an error; it is never rounded or cut (only a Float32 is the nearest one). A group is a row of 64-bit
words: the FMI function, its value references, the index of its first value among the inputs or outputs, and a buffer.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.binaries.codes import (
    EVENTS,
    EXACT,
    GET,
    SET,
    UNFIT,
    UNFIT_INPUT,
    UNFIT_OUTPUT,
)
from bayesftc.cosim.fmi.binaries.groups import ROUNDED
from bayesftc.cosim.fmi.running.kernels import (
    COMPONENT,
    ENTER_EVENT_MODE,
    INPUT_GROUP_COUNT,
    INPUT_GROUPS,
    OUTPUT_GROUP_COUNT,
    OUTPUT_GROUPS,
    SCRATCH,
    clock_is_due3,
    do_event_step3,
    do_step2,
    do_step3,
    entries,
    failed,
    mode3,
    number,
    put_number,
    put_word,
    settle3,
    values2,
    values3,
    word,
)
from bayesftc.cosim.stepping.numba_called import callee

# Words of a group.
FUNCTION, CODE, REFERENCES, COUNT, BEGIN, SIZE, BUFFER, LOW, LIMIT, DISCRETE, READ, NEGATED, ROUNDING = range(13)
GROUP_WORDS = 13

# Codes of the types of buffers. Booleans and enumerations are integers of their size and range.
FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64 = range(10)

_BITS = {INT8: 8, UINT8: 8, INT16: 16, UINT16: 16, INT32: 32, UINT32: 32, INT64: 64, UINT64: 64}
_UNSIGNED = {UINT8, UINT16, UINT32, UINT64}
_DOUBLE = ir.DoubleType()


def _cases(builder, code):
    """Yield code and type with the builder in the branch of each; in the end, the builder is after all branches."""
    end = builder.append_basic_block()
    switch = builder.switch(code, end)
    for case in (FLOAT32, *_BITS):
        block = builder.append_basic_block()
        switch.add_case(ir.Constant(code.type, case), block)
        builder.position_at_end(block)
        yield case, ir.FloatType() if case == FLOAT32 else ir.IntType(_BITS[case])
        builder.branch(end)
    builder.position_at_end(end)


def _element(builder, address, index, kind, case):
    width = 4 if case == FLOAT32 else _BITS[case] // 8
    place = builder.add(address, builder.mul(index, ir.Constant(index.type, width)))
    return builder.inttoptr(place, kind.as_pointer())


@intrinsic
def load(typingctx, address, index, code):
    """Return element `index` of a buffer whose type has this code, as a double."""

    def codegen(context, builder, signature, args):
        result = builder.alloca(_DOUBLE)
        for case, kind in _cases(builder, args[2]):
            value = builder.load(_element(builder, args[0], args[1], kind, case))
            if case == FLOAT32:
                value = builder.fpext(value, _DOUBLE)
            else:
                value = (builder.uitofp if case in _UNSIGNED else builder.sitofp)(value, _DOUBLE)
            builder.store(value, result)
        return builder.load(result)

    return types.float64(types.int64, types.int64, types.int64), codegen


@intrinsic
def store(typingctx, address, index, code, value):
    """Store a double that fits as element `index` of a buffer whose type has this code."""

    def codegen(context, builder, signature, args):
        for case, kind in _cases(builder, args[2]):
            if case == FLOAT32:
                value = builder.fptrunc(args[3], kind)
            else:
                value = (builder.fptoui if case in _UNSIGNED else builder.fptosi)(args[3], kind)
            builder.store(value, _element(builder, args[0], args[1], kind, case))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.float64), codegen


@callee
def _fits(group, code, value):
    low, limit = number(group, LOW), number(group, LIMIT)
    if code == FLOAT32:
        return not (np.isfinite(value) and (value < low or value > limit))
    return value >= low and value < limit and value == np.floor(value)


@callee
def _call(major, component, group, buffer):
    function = word(group, FUNCTION)
    references, count = word(group, REFERENCES), word(group, COUNT)
    if major == 3:
        return values3(function, component, references, count, buffer, word(group, SIZE))
    return values2(function, component, references, count, buffer)


@callee
def _noted(note, group, status):
    """Store which group's call has failed."""
    if status != 0:
        put_word(note, 0, word(group, BEGIN))
    return status


@callee
def put(major, component, note, inputs, group):
    """Set a group of inputs; return 0, `SET` plus FMI's status, or `UNFIT_INPUT`. `note` receives the failed group or element."""
    begin = inputs + 8 * word(group, BEGIN)
    code, negated, buffer = word(group, CODE), word(group, NEGATED) != 0, begin
    if code != FLOAT64 or negated:
        buffer = word(group, BUFFER)
        for i in range(word(group, SIZE)):
            value = -number(begin, i) if negated else number(begin, i)
            if code == FLOAT64:
                put_number(buffer, i, value)
                continue
            if not _fits(group, code, value):
                put_word(note, 0, word(group, BEGIN) + i)
                return UNFIT_INPUT
            store(buffer, i, code, value)
    return _noted(note, group, failed(SET, _call(major, component, group, buffer)))


@callee
def take(major, component, note, outputs, group):
    """Read a group of outputs; return 0, `GET` plus FMI's status, or `UNFIT_OUTPUT`, with `note` as in `put`."""
    begin = outputs + 8 * word(group, BEGIN)
    code, negated = word(group, CODE), word(group, NEGATED) != 0
    if code == FLOAT64:
        status = _noted(note, group, failed(GET, _call(major, component, group, begin)))
        if negated and status == 0:
            for i in range(word(group, SIZE)):
                put_number(begin, i, -number(begin, i))
        return status
    buffer = word(group, BUFFER)
    status = _noted(note, group, failed(GET, _call(major, component, group, buffer)))
    if status != 0:
        return status
    for i in range(word(group, SIZE)):
        value = -load(buffer, i, code) if negated else load(buffer, i, code)
        put_number(begin, i, value)
        if code >= INT64 and not (value > -EXACT and value < EXACT):
            if word(word(group, ROUNDING), i) == 0:
                put_word(note, 0, word(group, BEGIN) + i)
                return UNFIT_OUTPUT
            put_word(word(group, ROUNDING), i, ROUNDED)
    return 0


@callee
def _changed(parameters, inputs, group):
    """Return 1 if a group of discrete inputs differs from the instance's values, 0 if it does not, else a status.

    The values are read from the instance, because a restored state may have changed them.
    """
    component, buffer, size = word(parameters, COMPONENT), word(group, BUFFER), word(group, SIZE)
    references, count = word(group, REFERENCES), word(group, COUNT)
    status = failed(EVENTS, values3(word(group, READ), component, references, count, buffer, size))
    if status != 0:
        return status
    begin, code = inputs + 8 * word(group, BEGIN), word(group, CODE)
    for i in range(size):
        current = number(buffer, i) if code == FLOAT64 else load(buffer, i, code)
        if number(begin, i) != current:
            return 1
    return 0


@callee
def _set_all(major, parameters, inputs, t):
    """Set the inputs; if a discrete input has changed, set all of them in event mode.

    The instance's values are read before anything is set: afterwards FMI allows no reading before the step.
    """
    events = major == 3 and word(parameters, ENTER_EVENT_MODE) != 0
    changed = events and clock_is_due3(parameters, t)
    component, note = word(parameters, COMPONENT), word(parameters, SCRATCH) + 8 * UNFIT
    first, count = word(parameters, INPUT_GROUPS), word(parameters, INPUT_GROUP_COUNT)
    if events:
        for i in range(count):
            group = first + 8 * GROUP_WORDS * i
            if word(group, DISCRETE) != 0 and not changed:
                difference = _changed(parameters, inputs, group)
                if difference > 1:
                    return difference
                changed = difference == 1
    status = 0
    if changed:
        status = failed(EVENTS, mode3(word(parameters, ENTER_EVENT_MODE), component))
    for i in range(count):
        group = first + 8 * GROUP_WORDS * i
        if status == 0 and (changed or not events or word(group, DISCRETE) == 0):
            status = put(major, component, note, inputs, group)
    if changed and status == 0:
        return settle3(parameters, t)
    return status


@callee
def _get_all(major, parameters, outputs):
    first, component = word(parameters, OUTPUT_GROUPS), word(parameters, COMPONENT)
    note = word(parameters, SCRATCH) + 8 * UNFIT
    for i in range(word(parameters, OUTPUT_GROUP_COUNT)):
        status = take(major, component, note, outputs, first + 8 * GROUP_WORDS * i)
        if status != 0:
            return status
    return 0


@callee
def _advance(major, parameters, inputs, t):
    status = _set_all(major, parameters, inputs, t)
    if status != 0:
        return status
    if major == 2:
        return do_step2(parameters, t)
    if word(parameters, ENTER_EVENT_MODE) != 0:
        return do_event_step3(parameters, t)
    return do_step3(parameters, t)


FUNCTIONS = entries(_get_all, _advance)
