"""Runge-Kutta of order 5(4) by Dormand and Prince (1980), compiled, with roots found on its interpolant of order 4.

It restarts with full order at every communication point and after every event; multi-step methods restart with order one.
Tableau, error norm, first step and interpolant (Shampine 1986) are those of ``scipy.integrate.RK45``.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

import numpy as np
from numba import carray

from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.fmi.exchange.right import indicators, place, slope, step_is_completed
from bayesftc.cosim.fmi.exchange.words import (
    CALL,
    EPS,
    INDICATORS,
    LIMIT,
    PRECISION,
    REACHED,
    REASON,
    RTOL,
    STATES,
    STEPS,
    TOLERANCES,
    TOO_MANY,
    TOO_SMALL,
    WANTS_STEPS,
    WORK,
    X,
)
from bayesftc.cosim.fmi.running.kernels import number, put_number, put_word, word
from bayesftc.cosim.stepping.by_address import as_floats
from bayesftc.cosim.stepping.numba_called import callee

NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
STAGES = (
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0),
    (3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0),
    (44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
ERRORS = (-71 / 57600, 0.0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40)
BETWEEN = (
    (1.0, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432),
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799),
    (0.0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072),
    (0.0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632),
    (0.0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844),
    (0.0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423),
)
# The functions below also use the lengths of the tuples, so that the cache of compiled code depends on the tuples' values.
_STAGES, _ERRORS, _BETWEEN = np.array(STAGES), np.array(ERRORS), np.array(BETWEEN)

VECTORS = 11
"""Vectors in the scratch memory: seven slopes; the states of a stage, of the step's end, and in between; the error scale."""


@callee
def _norm(values, scale):
    total = 0.0
    for i in range(len(values)):
        total += (values[i] / scale[i]) ** 2
    return np.sqrt(total / max(len(values), 1))


@callee
def _first_step(table, t, span, x, k, stage, scale, direct):
    """Return a first step size by Hairer, Norsett and Wanner (1993), II.4; `direct` has the addresses of `stage` and k[1]."""
    n = len(x)
    d0, d1 = _norm(x, scale), _norm(k[0], scale)
    h = 1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1
    h = min(h, span)
    for i in range(n):
        stage[i] = x[i] + h * k[0, i]
    code = slope(table, t + h, direct[0], direct[1])
    if code != 0:
        return h
    for i in range(n):
        stage[i] = k[1, i] - k[0, i]
    d2 = _norm(stage, scale) / h
    largest = max(d1, d2)
    other = max(1e-6, h * 1e-3) if largest <= 1e-15 else exponential(0.2 * logarithm(0.01 / largest))
    return min(100 * h, other, span)


@callee
def _same_signs(a, b):
    changes = 0
    for i in range(len(a)):
        changes += (a[i] > 0.0) != (b[i] > 0.0)
    return changes == 0


@callee
def _interpolate(x, k, h, part, between):
    for i in range(len(x)):
        total = 0.0
        for s in range(len(BETWEEN)):
            b = _BETWEEN[s]
            total += k[s, i] * part * (b[0] + part * (b[1] + part * (b[2] + part * b[3])))
        between[i] = x[i] + h * total


@callee
def _stop(table, reason, flag):
    put_word(table, REASON, reason)
    return flag


@callee
def runge_kutta(table, t, end):
    """Integrate to `end`, or to an event before it; return 1 for an event, 0 for none, -1 if the reason is in the table."""
    n, m, work, rtol = word(table, STATES), word(table, INDICATORS), word(table, WORK), number(table, RTOL)
    k = carray(as_floats(work), (7, n))
    stage = carray(as_floats(work + 8 * 7 * n), (n,))
    new = carray(as_floats(work + 8 * 8 * n), (n,))
    between = carray(as_floats(work + 8 * 9 * n), (n,))
    scale = carray(as_floats(work + 8 * 10 * n), (n,))
    before = carray(as_floats(work + 8 * VECTORS * n), (m,))
    after = carray(as_floats(work + 8 * (VECTORS * n + m)), (m,))
    x, tolerances = carray(as_floats(word(table, X)), (n,)), carray(as_floats(word(table, TOLERANCES)), (n,))
    at_stage, at_new, at_between = work + 8 * 7 * n, work + 8 * 8 * n, work + 8 * 9 * n
    at_before, at_after = work + 8 * VECTORS * n, work + 8 * (VECTORS * n + m)
    if m > 0 and indicators(table, t, word(table, X), at_before) != 0:
        return _stop(table, CALL, -1)
    if n > 0 and slope(table, t, word(table, X), work) != 0:
        return _stop(table, CALL, -1)
    for i in range(n):
        scale[i] = tolerances[i] + rtol * abs(x[i])
    h = _first_step(table, t, end - t, x, k, stage, scale, (at_stage, work + 8 * n)) if n > 0 else end - t
    rejected = False
    for steps in range(word(table, LIMIT)):
        put_word(table, STEPS, steps + 1)
        put_number(table, REACHED, t)
        rest = end - t
        last = h >= rest * (1.0 - 1e-12)
        h = rest if last else h
        if h <= 10.0 * EPS * max(abs(t), abs(end)) and not last:
            return _stop(table, TOO_SMALL, -1)
        code = 0
        for s in range(1, len(STAGES)):
            if n == 0:
                break
            for i in range(n):
                total = 0.0
                for j in range(s):
                    total += _STAGES[s, j] * k[j, i]
                stage[i] = x[i] + h * total
            at = end if last and s >= 5 else t + NODES[s] * h
            code = slope(table, at, at_stage, work + 8 * n * s)
            if code != 0:
                break
        if code < 0:
            return _stop(table, CALL, -1)
        error = 0.0
        if code == 0:
            for i in range(n):
                new[i] = stage[i]  # the last stage is the solution of order 5
                total = 0.0
                for s in range(len(ERRORS)):
                    total += _ERRORS[s] * k[s, i]
                between[i] = h * total
                scale[i] = tolerances[i] + rtol * max(abs(x[i]), abs(new[i]))
            error = _norm(between, scale)
        now, event = end if last else t + h, False
        if m > 0 and code == 0 and error < 1.0:
            code = indicators(table, now, at_new, at_after)
            if code < 0:
                return _stop(table, CALL, -1)
        if code > 0 or not error < 1.0:  # the equations do not hold there, or the step is too large
            if code > 0 and h <= 100.0 * EPS * max(abs(t), abs(end)):
                return _stop(table, CALL, -1)
            h *= 0.2 if code > 0 or not error < np.inf else max(0.2, 0.9 * exponential(-0.2 * logarithm(error)))
            rejected = True
            continue
        if m > 0 and not _same_signs(before, after):
            event = True
            low, high = 0.0, 1.0
            while (high - low) * h > PRECISION * (abs(now) + h):
                middle = 0.5 * (low + high)
                if not low < middle < high:
                    break
                _interpolate(x, k, h, middle, between)
                if indicators(table, t + middle * h, at_between, at_after) != 0:
                    return _stop(table, CALL, -1)
                if _same_signs(before, after):
                    low = middle
                else:
                    high = middle
            if high < 1.0:
                now = t + high * h
                _interpolate(x, k, h, high, new)
        if place(table, now, at_new) != 0:
            return _stop(table, CALL, -1)
        for i in range(n):
            x[i] = new[i]
        put_number(table, REACHED, now)
        if word(table, WANTS_STEPS) != 0:
            request = step_is_completed(table, now)
            if request < 0:
                return -1
            event = event or request > 0
        if event:
            return 1
        if last:
            return 0
        t = now
        for i in range(n):
            k[0, i] = k[6, i]
        for i in range(m):
            before[i] = after[i]
        growth = 5.0 if error == 0.0 else min(5.0, 0.9 * exponential(-0.2 * logarithm(error)))
        h *= min(1.0, growth) if rejected else max(growth, 0.2)
        rejected = False
    return _stop(table, TOO_MANY, -1)
