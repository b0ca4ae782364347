"""A communication step of a model exchange FMU, with all its events, as compiled functions with the engine's signature.

At the address ``parameters`` they find the address of the table of `bayesftc.cosim._exchange.words`, and the step size.
Nothing here returns to Python, so that a right-hand side costs what the FMU's own functions cost.
`bayesftc.cosim._exchange.instance` does the same in Python, for integrators of scipy.
"""

# The checker sees the intrinsics with the typing context that numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc, arg-type"

from numba.extending import register_jitable

from bayesftc.cosim._exchange.calls import at_time, integrate, plain, restart, update2, update3, vector
from bayesftc.cosim._exchange.right import failed, indicators, place, slope, step_is_completed
from bayesftc.cosim._exchange.runge_kutta import runge_kutta
from bayesftc.cosim._exchange.words import (
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
    GET_REALS,
    GET_STATES,
    GIVES_UP,
    IN_COUNT,
    IN_REFERENCES,
    IN_SIZE,
    INFO,
    INPUTS,
    INTEGRATE,
    INTEGRATOR,
    ITERATIONS,
    LIMIT,
    MAJOR,
    MEMORY,
    NEAR,
    NEXT_EVENT,
    NO_TIME,
    NONE,
    NUMERATOR,
    OUT_COUNT,
    OUT_REFERENCES,
    OUT_SIZE,
    QUIET,
    QUIET_EVENTS,
    QUIET_STEP,
    REACHED,
    REASON,
    RESTART,
    ROLE,
    RTOL,
    SAME,
    SET_REALS,
    SET_STOP,
    SET_TIME,
    SET_TOLERANCES,
    STATES,
    STEP_WORD,
    STEPS,
    STOPPED,
    TIME,
    TOLERANCE_VECTOR,
    TOLERANCES,
    TOO_MANY,
    UPDATE_DISCRETE,
    VECTOR,
    WANTS_STEPS,
    X,
)
from bayesftc.cosim._fmi.kernels import number, put_number, put_word, values2, values3, word

_NORMAL, _ONE_STEP = 1, 2
_ROOT = 2
_INFINITY = float("inf")


def cvode_slope(t, y, values, table):
    """CVRhsFn; the third word of a vector's content points to its numbers."""
    return slope(table, t, word(word(y, 0), 2), word(word(values, 0), 2))


def cvode_roots(t, y, values, table):
    """CVRootFn."""
    return indicators(table, t, word(word(y, 0), 2), values)


@register_jitable(error_model="numpy")
def _cvode(table, t, end):
    """Do what `runge_kutta` does, by CVODE."""
    memory, y = word(table, MEMORY), word(table, VECTOR)
    flag = restart(word(table, RESTART), memory, t, y)
    if flag == 0:
        flag = at_time(word(table, SET_STOP), memory, end)
    wants = word(table, WANTS_STEPS) != 0
    put_number(table, REACHED, t)
    for steps in range(word(table, LIMIT)):
        if flag == 0:
            task = _ONE_STEP if wants else _NORMAL
            flag = integrate(word(table, INTEGRATE), memory, end, y, table + 8 * REACHED, task)
        put_word(table, STEPS, steps + 1)
        if flag < 0:
            put_word(table, FLAG, flag)
            put_word(table, REASON, GIVES_UP)
            return -1
        now = number(table, REACHED)
        if place(table, now, word(table, X)) != 0:
            put_word(table, REASON, CALL)
            return -1
        asks = step_is_completed(table, now) if wants else 0
        if asks < 0:
            return -1
        if flag == _ROOT or asks > 0:
            return 1
        if flag != 0 or not wants:
            return 0
    put_word(table, REASON, TOO_MANY)
    return -1


@register_jitable(error_model="numpy", forceinline=True)
def _called(table, role, status):
    if failed(table, number(table, TIME), role, status) == 0:
        return 0
    put_word(table, REASON, CALL)
    return STOPPED


@register_jitable(error_model="numpy")
def _set_tolerances(table):
    """Take absolute tolerances from the nominal values, as they are now."""
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


@register_jitable(error_model="numpy")
def _settle(table):
    """Iterate the discrete states until they stay, and go on to continuous-time mode."""
    component, info, nominals = word(table, COMPONENT), table + 8 * INFO, False
    for turn in range(ITERATIONS + 1):
        if turn == ITERATIONS:
            put_word(table, REASON, ENDLESS)
            return STOPPED
        for i in range(6):
            put_word(info, i, 0)
        if word(table, MAJOR) == 2:  # five 32-bit integers and, aligned, a double
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
    if _called(table, ENTER_CONTINUOUS, plain(word(table, ENTER_CONTINUOUS), component)) != 0:
        return STOPPED
    count = word(table, STATES)
    if count > 0:
        status = vector(word(table, GET_STATES), component, word(table, X), count)
        if _called(table, GET_STATES, status) != 0:
            return STOPPED
    if nominals and word(table, INTEGRATOR) != NONE:
        return _set_tolerances(table)
    return 0


@register_jitable(error_model="numpy", forceinline=True)
def _enter_event_mode(table):
    return _called(table, ENTER_EVENT, plain(word(table, ENTER_EVENT), word(table, COMPONENT)))


@register_jitable(error_model="numpy")
def _take(table, inputs):
    """Let the inputs jump to what they are now, which is an event."""
    size, held = word(table, IN_SIZE), word(table, INPUTS)
    changed = False
    for i in range(size):
        if word(inputs, i) != word(held, i):
            changed = True
            put_word(held, i, word(inputs, i))
    if not changed:
        return 0
    if _enter_event_mode(table) != 0:
        return STOPPED
    component, references, count = word(table, COMPONENT), word(table, IN_REFERENCES), word(table, IN_COUNT)
    if word(table, MAJOR) == 2:
        status = values2(word(table, SET_REALS), component, references, count, held)
    else:
        status = values3(word(table, SET_REALS), component, references, count, held, size)
    if _called(table, SET_REALS, status) != 0:
        return STOPPED
    return _settle(table)


@register_jitable(error_model="numpy")
def _read(table, outputs):
    component, references, count = word(table, COMPONENT), word(table, OUT_REFERENCES), word(table, OUT_COUNT)
    if count == 0:
        return 0
    if word(table, MAJOR) == 2:
        status = values2(word(table, GET_REALS), component, references, count, outputs)
    else:
        status = values3(word(table, GET_REALS), component, references, count, outputs, word(table, OUT_SIZE))
    return _called(table, GET_REALS, status)


@register_jitable(error_model="numpy")
def _stretch(table, target):
    """Go to a time, or to an event before it; return 1 for an event, 0 for none, -1 if the reason is in the table."""
    t, which = number(table, TIME), word(table, INTEGRATOR)
    if which == NONE:
        put_number(table, TIME, target)
        status = at_time(word(table, SET_TIME), word(table, COMPONENT), target)
        return 0 if _called(table, SET_TIME, status) == 0 else -1
    put_word(table, ROLE, 0)
    answer = _cvode(table, t, target) if which == CVODE else runge_kutta(table, t, target)
    if answer >= 0:
        put_number(table, TIME, number(table, REACHED))
    return answer


@register_jitable(error_model="numpy")
def _advance(parameters, inputs, t, k):
    """Take the FMU to the next communication point, from event to event."""
    table, h = word(parameters, 0), number(parameters, STEP_WORD)
    if _take(table, inputs) != 0:
        return STOPPED
    end, point = t + h, (k + 1) * word(table, NUMERATOR) / word(table, DENOMINATOR)
    if abs(end - point) <= SAME * h:
        end = point  # as the engine counts time; a part of a step ends in between
    near = NEAR * max(abs(end), h)
    quiet, before = 0, number(table, TIME)
    while True:
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
                return STOPPED
        if event == 0 and not timed:
            return 0
        if _enter_event_mode(table) != 0 or _settle(table) != 0:
            return STOPPED
        now = number(table, TIME)
        quiet = quiet + 1 if now - before <= QUIET_STEP * h + QUIET * abs(end) else 0
        before = now
        if quiet >= QUIET_EVENTS:
            put_word(table, REASON, CHATTERS)
            return STOPPED


def read(state, parameters, inputs, outputs, t, k):
    """Read the outputs."""
    return _read(word(parameters, 0), outputs)


def read_direct(state, parameters, inputs, outputs, t, k):
    """Set the inputs, which is an event where they have changed, and read the outputs."""
    table = word(parameters, 0)
    if _take(table, inputs) != 0:
        return STOPPED
    return _read(table, outputs)


def advance(state, parameters, inputs, outputs, t, k):
    """Set the inputs and go to the next communication point."""
    return _advance(parameters, inputs, t, k)


def sampled(state, parameters, inputs, outputs, t, k):
    """Set the inputs, go to the next communication point, and read the outputs there."""
    if _advance(parameters, inputs, t, k) != 0:
        return STOPPED
    return _read(word(parameters, 0), outputs)


def tolerances(state, parameters, inputs, outputs, t, k):
    """Set the integrator's tolerances anew."""
    return _set_tolerances(word(parameters, 0))


FUNCTIONS = {"plant": read, "direct": read_direct, "sampled": sampled, "update": advance, "tolerances": tolerances}
