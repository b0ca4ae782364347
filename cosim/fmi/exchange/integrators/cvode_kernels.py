"""Integration by CVODE in compiled code: from the FMU's present point to a time, or to an event before it."""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc, arg-type"

from bayesftc.cosim.fmi.exchange.calls import at_time, integrate, restart
from bayesftc.cosim.fmi.exchange.right import indicators, place, slope, step_is_completed
from bayesftc.cosim.fmi.exchange.words import (
    CALL,
    FLAG,
    GET_INDICATORS,
    GIVES_UP,
    INDICATORS,
    INTEGRATE,
    LIMIT,
    MEMORY,
    NAN_INDICATOR,
    PRECISION,
    REACHED,
    REASON,
    RESTART,
    ROLE,
    SET_STOP,
    STATES,
    STATUS,
    STEPS,
    TOO_MANY,
    VECTOR,
    WANTS_STEPS,
    WHEN,
    WORK,
    X,
)
from bayesftc.cosim.fmi.running.kernels import number, put_number, put_word, word
from bayesftc.cosim.stepping.numba_called import callee, inlined

_NORMAL, _ONE_STEP = 1, 2
_ROOT, _ROOTS_FAILED = 2, -12
_BELOW_ZERO = -1e-100


def cvode_slope(t, y, values, table):
    """CVRhsFn; the third word of a vector's content points to its numbers."""
    return slope(table, t, word(word(y, 0), 2), word(word(values, 0), 2))


def cvode_roots(t, y, values, table):
    """CVRootFn.

    In FMI, zero counts as negative. CVODE ignores an indicator that begins at zero and would miss its crossing.
    """
    status = indicators(table, t, word(word(y, 0), 2), values)
    for i in range(word(table, INDICATORS)):
        if number(values, i) == 0.0:
            put_number(values, i, _BELOW_ZERO)
    return status


@inlined
def _cvode_from(table, t, stop):
    """Restart at the present states, with `stop` as stop time; return CVODE's flag."""
    memory = word(table, MEMORY)
    flag = restart(word(table, RESTART), memory, t, word(table, VECTOR))
    return at_time(word(table, SET_STOP), memory, stop) if flag == 0 else flag


@inlined
def _copy(source, target, count):
    for i in range(count):
        put_word(target, i, word(source, i))


@callee
def cvode(table, t, end):
    """Integrate as `runge_kutta`, but by CVODE."""
    memory, y, x, size = word(table, MEMORY), word(table, VECTOR), word(table, X), word(table, STATES)
    needs_steps = word(table, WANTS_STEPS) != 0
    put_number(table, REACHED, t)
    good, copy, stop = t, word(table, WORK), end
    _copy(x, copy, size)
    flag = _cvode_from(table, t, end)
    for steps in range(word(table, LIMIT)):
        if flag == 0:
            task = _ONE_STEP if needs_steps else _NORMAL
            flag = integrate(word(table, INTEGRATE), memory, stop, y, table + 8 * REACHED, task)
        put_word(table, STEPS, steps + 1)
        if flag == _ROOTS_FAILED and _may_do_with_less(table):
            # The event indicators cannot be computed at this point: repeat from the last good point with a smaller step.
            half = good + 0.5 * (number(table, WHEN) - good)
            if half - good > PRECISION * max(abs(good), abs(end)):
                stop = half
                put_word(table, ROLE, 0)
                _copy(copy, x, size)
                flag = _cvode_from(table, good, stop)
                continue
        if flag < 0:
            put_word(table, FLAG, flag)
            put_word(table, REASON, GIVES_UP)
            return -1
        now = number(table, REACHED)
        if place(table, now, word(table, X)) != 0:
            put_word(table, REASON, CALL)
            return -1
        event = step_is_completed(table, now) if needs_steps else 0
        if event < 0:
            return -1
        if flag == _ROOT or event > 0:
            return 1
        good = now
        _copy(x, copy, size)
        if flag != 0 or not needs_steps:
            if stop == end:
                return 0
            stop = end
            flag = at_time(word(table, SET_STOP), memory, end)
    put_word(table, REASON, TOO_MANY)
    return -1


@inlined
def _may_do_with_less(table):
    role = word(table, ROLE)
    return word(table, STATUS) == 2 and role in (GET_INDICATORS, NAN_INDICATOR)
