"""A communication step of a model exchange FMU, with all its events, as compiled functions with the engine's signature.

The address of the table of `bayesftc.cosim.fmi.exchange.words` and the step size are at the address ``parameters``. The compiled
integrators never call Python, so a right-hand side costs no more than the FMU's own functions.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc, arg-type"

from bayesftc.cosim.fmi.binaries.codes import GET, SET, UNFIT_INPUT as UNFIT_IN, UNFIT_OUTPUT as UNFIT_OUT
from bayesftc.cosim.fmi.exchange.calls import at_time, restart, update1, update2, vector
from bayesftc.cosim.fmi.exchange.integrators.cvode_kernels import cvode
from bayesftc.cosim.fmi.exchange.integrators.runge_kutta import runge_kutta
from bayesftc.cosim.fmi.exchange.right import failed, get_values, not_finite, set_values
from bayesftc.cosim.fmi.exchange.words import (
    ATOL,
    CALL,
    CHATTERS,
    COMPONENT,
    CVODE,
    DENOMINATOR,
    ENDLESS,
    ENDS,
    ENTER_CONTINUOUS,
    ENTER_EVENT,
    FLAG,
    GET_NOMINALS,
    GET_STATES,
    GET_VALUES,
    GIVES_UP,
    IN_SIZE,
    INFO,
    INPUTS,
    INTEGRATE,
    INTEGRATOR,
    INTERRUPTED,
    ITERATIONS,
    MAJOR,
    MEMORY,
    MOST_EVENTS,
    NAN_STATE,
    NEAR,
    NEXT_EVENT,
    NO_TIME,
    NONE,
    NUMERATOR,
    QUIET,
    QUIET_EVENTS,
    QUIET_STEP,
    REACHED,
    REASON,
    ROLE,
    RTOL,
    RUNGE_KUTTA,
    SAME,
    SET_TIME,
    SET_TOLERANCES,
    SET_VALUES,
    STATES,
    STEP_WORD,
    STOPPED,
    TIME,
    TOLERANCE_VECTOR,
    TOLERANCES,
    TOO_MANY_EVENTS,
    UNFIT_INPUT,
    UNFIT_OUTPUT,
    UPDATE_DISCRETE,
    X,
)
from bayesftc.cosim.fmi.running.kernels import mode3, number, put_number, put_word, update3, word
from bayesftc.cosim.stepping.by_address import call_block
from bayesftc.cosim.stepping.numba_called import callee, inlined

_INFINITY = float("inf")


@inlined
def _called(table, role, status):
    if failed(table, number(table, TIME), role, status) == 0:
        return 0
    put_word(table, REASON, CALL)
    return STOPPED


@inlined
def _mode(table, role):
    """Enter another mode, if the FMU's version of FMI has modes."""
    if word(table, role) == 0:
        return 0
    return _called(table, role, mode3(word(table, role), word(table, COMPONENT)))


@callee
def _set_tolerances(table):
    """Set absolute tolerances from the present nominal values."""
    count, tolerances = word(table, STATES), word(table, TOLERANCES)
    rtol, atol = number(table, RTOL), number(table, ATOL)
    if count > 0:
        status = vector(word(table, GET_NOMINALS), word(table, COMPONENT), tolerances, count)
        if _called(table, GET_NOMINALS, status) != 0:
            return STOPPED
    else:
        put_number(tolerances, 0, 1.0)
    for i in range(max(count, 1)):
        nominal = abs(number(tolerances, i))
        if not 0.0 < nominal < _INFINITY:
            nominal = 1.0
        put_number(tolerances, i, atol if atol > 0.0 else rtol * nominal)
    if word(table, INTEGRATOR) == CVODE:
        flag = restart(word(table, SET_TOLERANCES), word(table, MEMORY), rtol, word(table, TOLERANCE_VECTOR))
        if flag != 0:
            put_word(table, FLAG, flag)
            put_word(table, REASON, GIVES_UP)
            return STOPPED
    return 0


@callee
def _settle(table):
    """Update the discrete states until they no longer change, then enter continuous-time mode."""
    component, info, nominals = word(table, COMPONENT), table + 8 * INFO, False
    for turn in range(ITERATIONS + 1):
        if turn == ITERATIONS:
            put_word(table, REASON, ENDLESS)
            return STOPPED
        for i in range(6):
            put_word(info, i, 0)
        if word(table, MAJOR) == 1:  # five bytes and, aligned, a double
            status = update1(word(table, UPDATE_DISCRETE), component, info)
            flags, next_event = word(info, 0), number(info, 1)
            needed, changed = 1 if flags & 0xFF == 0 else 0, (flags >> 8) & 0xFF
            ends, defined = (flags >> 24) & 0xFF, (flags >> 32) & 0xFF
        elif word(table, MAJOR) == 2:  # five 32-bit integers and, aligned, a double
            status = update2(word(table, UPDATE_DISCRETE), component, info)
            needed, ends = word(info, 0) & 0xFFFFFFFF, word(info, 0) >> 32
            changed, defined, next_event = word(info, 1) & 0xFFFFFFFF, word(info, 2) & 0xFFFFFFFF, number(info, 3)
        else:
            status = update3(word(table, UPDATE_DISCRETE), component, info)
            needed, ends, changed = word(info, 0), word(info, 1), word(info, 2)
            defined, next_event = word(info, 4), number(info, 5)
        if _called(table, UPDATE_DISCRETE, status) != 0:
            return STOPPED
        nominals = nominals or changed != 0
        if ends != 0:
            put_word(table, REASON, ENDS)
            return STOPPED
        put_number(table, NEXT_EVENT, next_event if defined != 0 else _INFINITY)
        if needed == 0:
            break
    if number(table, NEXT_EVENT) != number(table, NEXT_EVENT):
        put_word(table, REASON, NO_TIME)
        return STOPPED
    if _mode(table, ENTER_CONTINUOUS) != 0:
        return STOPPED
    count = word(table, STATES)
    if count > 0:
        status = vector(word(table, GET_STATES), component, word(table, X), count)
        if _called(table, GET_STATES, status) != 0:
            return STOPPED
        if not_finite(word(table, X), count):
            return _called(table, NAN_STATE, 3)
    if nominals and word(table, INTEGRATOR) != NONE:
        return _set_tolerances(table)
    return 0


@callee
def _take(table, inputs):
    """Set the inputs; if they have changed, this is an event."""
    size, held = word(table, IN_SIZE), word(table, INPUTS)
    changed = False
    for i in range(size):
        if word(inputs, i) != word(held, i):
            changed = True
            put_word(held, i, word(inputs, i))
    if not changed:
        return 0
    if _mode(table, ENTER_EVENT) != 0:
        return STOPPED
    code = set_values(table, held)
    if code != 0:
        return _refused(table, SET_VALUES, code)
    return _settle(table)


@callee
def _read(table, outputs):
    code = get_values(table, outputs)
    return 0 if code == 0 else _refused(table, GET_VALUES, code)


@callee
def _refused(table, role, code):
    """Record why inputs could not be set or outputs read."""
    if code in (UNFIT_IN, UNFIT_OUT):
        put_word(table, REASON, UNFIT_INPUT if code == UNFIT_IN else UNFIT_OUTPUT)
        return STOPPED
    return _called(table, role, code - (SET if role == SET_VALUES else GET))


@callee
def _stretch(table, target):
    """Integrate to a time, or to an event before it; return 1 for an event, 0 for none, less if the reason is in the table."""
    t, which = number(table, TIME), word(table, INTEGRATOR)
    if which == NONE:
        put_number(table, TIME, target)
        status = at_time(word(table, SET_TIME), word(table, COMPONENT), target)
        return 0 if _called(table, SET_TIME, status) == 0 else -1
    put_word(table, ROLE, 0)
    if which == CVODE:
        answer = cvode(table, t, target)
    elif which == RUNGE_KUTTA:
        answer = runge_kutta(table, t, target)
    else:
        answer = call_block(word(table, INTEGRATE), 0, 0, 0, 0, target, 0)
    if answer >= 0:
        put_number(table, TIME, number(table, REACHED))
    return answer


@callee
def _advance(parameters, inputs, t, k):
    """Advance the FMU to the next communication point, from event to event."""
    table, h = word(parameters, 0), number(parameters, STEP_WORD)
    if _take(table, inputs) != 0:
        return STOPPED
    end, point = t + h, (k + 1) * word(table, NUMERATOR) / word(table, DENOMINATOR)
    if abs(end - point) <= SAME * h:
        end = point  # the engine's time; a part of a step ends in between
    near = NEAR * max(abs(end), h)
    quiet, before = 0, number(table, TIME)
    for _ in range(MOST_EVENTS):
        now, next_event = number(table, TIME), number(table, NEXT_EVENT)
        timed = next_event <= end + near
        target = next_event if timed else end
        event = 0
        if target <= now + near:  # too near to integrate, or in the past
            if not timed:
                return 0
            if target > now:
                put_number(table, TIME, target)
                if _called(table, SET_TIME, at_time(word(table, SET_TIME), word(table, COMPONENT), target)) != 0:
                    return STOPPED
        else:
            event = _stretch(table, target)
            if event < 0:
                return STOPPED if event == -1 else INTERRUPTED
        if event == 0 and not timed:
            return 0
        if _mode(table, ENTER_EVENT) != 0 or _settle(table) != 0:
            return STOPPED
        now = number(table, TIME)
        quiet = quiet + 1 if now - before <= QUIET_STEP * h + QUIET * abs(end) else 0
        before = now
        if quiet >= QUIET_EVENTS:
            put_word(table, REASON, CHATTERS)
            return STOPPED
    put_word(table, REASON, TOO_MANY_EVENTS)
    return STOPPED


def read(state, parameters, inputs, outputs, t, k):
    """Read the outputs."""
    return _read(word(parameters, 0), outputs)


def read_direct(state, parameters, inputs, outputs, t, k):
    """Set the inputs (an event if they have changed) and read the outputs."""
    table = word(parameters, 0)
    if _take(table, inputs) != 0:
        return STOPPED
    return _read(table, outputs)


def advance(state, parameters, inputs, outputs, t, k):
    """Set the inputs and advance to the next communication point."""
    return _advance(parameters, inputs, t, k)


def sampled(state, parameters, inputs, outputs, t, k):
    """Set the inputs, advance to the next communication point, and read the outputs there."""
    status = _advance(parameters, inputs, t, k)
    if status != 0:
        return status
    return _read(word(parameters, 0), outputs)


def tolerances(state, parameters, inputs, outputs, t, k):
    """Set the integrator's tolerances again."""
    return _set_tolerances(word(parameters, 0))


FUNCTIONS = {"plant": read, "direct": read_direct, "sampled": sampled, "update": advance, "tolerances": tolerances}
