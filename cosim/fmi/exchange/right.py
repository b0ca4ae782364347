"""The right-hand side and the event indicators of a model exchange FMU as compiled functions for integrators."""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

from bayesftc.cosim.fmi.exchange.calls import at_time, completed, update2, vector
from bayesftc.cosim.fmi.exchange.words import (
    CALL,
    COMPLETED_STEP,
    COMPONENT,
    ENDS_AFTER_STEP,
    ENTER,
    GET_DERIVATIVES,
    GET_INDICATORS,
    IN_GROUP_COUNT,
    IN_GROUPS,
    INDICATORS,
    MAJOR,
    NAN_DERIVATIVE,
    NAN_INDICATOR,
    NO_RETURN,
    OUT_GROUP_COUNT,
    OUT_GROUPS,
    REASON,
    ROLE,
    SET_STATES,
    SET_TIME,
    STATES,
    STATUS,
    TERMINATE,
    UNFIT,
    WHEN,
)
from bayesftc.cosim.fmi.running.kernels import number, put_number, put_word, word
from bayesftc.cosim.fmi.running.typed_kernels import GROUP_WORDS, put, take
from bayesftc.cosim.stepping.numba_called import callee, inlined


@inlined
def failed(table, t, role, status):
    """Record a failed call; return 0 for success, 1 to try a smaller step (Discard), -1 to give up."""
    if 0 <= status <= 1:
        return 0
    put_word(table, ROLE, role)
    put_word(table, STATUS, status)
    put_number(table, WHEN, t)
    return 1 if status == 2 else -1


@inlined
def place(table, t, x):
    """Set the FMU's time, and its states to those at an address."""
    component, count = word(table, COMPONENT), word(table, STATES)
    status = failed(table, t, SET_TIME, at_time(word(table, SET_TIME), component, t))
    if status != 0 or count == 0:
        return status
    return failed(table, t, SET_STATES, vector(word(table, SET_STATES), component, x, count))


@inlined
def not_finite(values, count):
    """Return whether some of these numbers are NaN or infinite."""
    for i in range(count):
        value = number(values, i)
        if value - value != 0.0:
            return True
    return False


@callee
def slope(table, t, x, values):
    """Write the derivatives; without states, that of the constant that replaces them."""
    status = place(table, t, x)
    if status != 0:
        return status
    count = word(table, STATES)
    if count == 0:
        put_number(values, 0, 0.0)
        return 0
    returned = vector(word(table, GET_DERIVATIVES), word(table, COMPONENT), values, count)
    status = failed(table, t, GET_DERIVATIVES, returned)
    if status == 0 and not_finite(values, count):
        return failed(table, t, NAN_DERIVATIVE, 2)
    return status


@callee
def indicators(table, t, x, values):
    """Write the event indicators."""
    status = place(table, t, x)
    if status != 0:
        return status
    count = word(table, INDICATORS)
    returned = vector(word(table, GET_INDICATORS), word(table, COMPONENT), values, count)
    status = failed(table, t, GET_INDICATORS, returned)
    if status == 0 and not_finite(values, count):
        return failed(table, t, NAN_INDICATOR, 2)
    return status


@callee
def step_is_completed(table, t):
    """Call completedIntegratorStep; return 1 if the FMU requests event mode, -1 if it fails or ends, else 0."""
    put_word(table, ENTER, 0)
    put_word(table, TERMINATE, 0)
    function, component, enter = word(table, COMPLETED_STEP), word(table, COMPONENT), table + 8 * ENTER
    if word(table, MAJOR) == 1:
        status = update2(function, component, enter)
    else:
        status = completed(function, component, word(table, NO_RETURN), enter, table + 8 * TERMINATE)
    if failed(table, t, COMPLETED_STEP, status) != 0:
        put_word(table, REASON, CALL)
        return -1
    if word(table, TERMINATE) != 0:
        put_word(table, REASON, ENDS_AFTER_STEP)
        return -1
    return 1 if word(table, ENTER) != 0 else 0


@callee
def set_values(table, values):
    """Set the inputs in the present mode; return a code of `bayesftc.cosim.fmi.running.typed_kernels.put`."""
    note, first = table + 8 * UNFIT, word(table, IN_GROUPS)
    for i in range(word(table, IN_GROUP_COUNT)):
        code = put(word(table, MAJOR), word(table, COMPONENT), note, values, first + 8 * GROUP_WORDS * i)
        if code != 0:
            return code
    return 0


@callee
def get_values(table, values):
    """Read the outputs; return a code of `bayesftc.cosim.fmi.running.typed_kernels.take`."""
    note, first = table + 8 * UNFIT, word(table, OUT_GROUPS)
    for i in range(word(table, OUT_GROUP_COUNT)):
        code = take(word(table, MAJOR), word(table, COMPONENT), note, values, first + 8 * GROUP_WORDS * i)
        if code != 0:
            return code
    return 0
