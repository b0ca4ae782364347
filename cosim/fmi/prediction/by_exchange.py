"""Prediction with a model exchange FMU: the classical Runge-Kutta method, and its exact derivatives."""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

from numba.extending import intrinsic

from bayesftc.cosim.fmi.binaries.codes import DISCARD, GET, SET, STEP as STEP_CODE, UNFIT_INPUT, UNFIT_OUTPUT
from bayesftc.cosim.fmi.exchange.right import get_values, place, set_values, slope
from bayesftc.cosim.fmi.exchange.words import COMPONENT
from bayesftc.cosim.fmi.prediction.words import (
    BROKEN,
    DIRECTIONAL,
    DRIVEN,
    KNOWN_COUNT,
    KNOWNS,
    MAJOR,
    OUTPUTS,
    OWN,
    PARTS,
    PLANT_STATES,
    RATE_COUNT,
    RATES,
    REFUSED,
    SEEN,
    SEEN_COUNT,
    SHOWN,
    STEP,
    VALUES,
    WORK,
)
from bayesftc.cosim.fmi.running.kernels import as_given, number, put_number, word
from bayesftc.cosim.stepping.numba_called import callee, inlined


@intrinsic
def _directional2(typingctx, function, component, unknowns, unknown_count, knowns, known_count, seed, result):
    """int32 (*)(...): fmi2GetDirectionalDerivative."""
    return as_given(function, component, unknowns, unknown_count, knowns, known_count, seed, result)


@intrinsic
def _directional3(
    typingctx, function, component, unknowns, unknown_count, knowns, known_count, seed, seeds, result, results
):
    """int32 (*)(...): fmi3GetDirectionalDerivative."""
    return as_given(function, component, unknowns, unknown_count, knowns, known_count, seed, seeds, result, results)


@inlined
def _outcome(code):
    """Return the result for a code of `right`: 0, 1 if the FMU refused a value, -1 if it failed."""
    if code == 0:
        return 0
    return REFUSED if code > 0 else BROKEN


@inlined
def of_step(code):
    """Return the result for a code of `bayesftc.cosim.fmi.binaries.codes`."""
    if code == 0:
        return 0
    if code in (GET + DISCARD, SET + DISCARD, STEP_CODE + DISCARD, UNFIT_INPUT, UNFIT_OUTPUT):
        return REFUSED
    return BROKEN


@inlined
def _checked(status):
    """Return the result for a status of FMI."""
    if 0 <= status <= 1:
        return 0
    return REFUSED if status == 2 else BROKEN


@callee
def directional(table, unknowns, count, seed, seeds, result, results):
    """Write a directional derivative at the present point of the FMU."""
    function, component = word(table, DIRECTIONAL), word(word(table, OWN), COMPONENT)
    knowns, known = word(table, KNOWNS), word(table, KNOWN_COUNT)
    if word(table, MAJOR) == 2:
        return _checked(_directional2(function, component, unknowns, count, knowns, known, seed, result))
    return _checked(_directional3(function, component, unknowns, count, knowns, known, seed, seeds, result, results))


@callee
def integrate(table, x, following):
    """Write the state one step after the state at the address `x`, with the inputs in ``VALUES`` held."""
    own, n, parts = word(table, OWN), word(table, PLANT_STATES), word(table, PARTS)
    stage = word(table, WORK)
    rate, total = stage + 8 * n, stage + 16 * n
    if set_values(own, word(table, VALUES)) != 0:
        return BROKEN
    h = number(table, STEP) / parts
    for i in range(n):
        put_number(following, i, number(x, i))
    for _ in range(parts):
        for i in range(n):
            put_number(stage, i, number(following, i))
            put_number(total, i, 0.0)
        for s in range(4):
            code = slope(own, 0.0, stage, rate)
            if code != 0:
                return _outcome(code)
            weight = 2.0 if s == 1 or s == 2 else 1.0
            ahead = h if s == 2 else 0.5 * h
            for i in range(n):
                put_number(total, i, number(total, i) + weight * number(rate, i))
                put_number(stage, i, number(following, i) + ahead * number(rate, i))
        for i in range(n):
            put_number(following, i, number(following, i) + h / 6.0 * number(total, i))
    return 0


@callee
def integrate_slopes(table, x, slopes):
    """Write the exact derivatives of `integrate` by states and controls (n x (n + p)), from the FMU's directional derivatives."""
    own, n, parts = word(table, OWN), word(table, PLANT_STATES), word(table, PARTS)
    c = n + word(table, DRIVEN)
    here = word(table, WORK)
    stage, rate, total, seed, column = here + 8 * n, here + 16 * n, here + 24 * n, here + 32 * n, here + 8 * (4 * n + c)
    staged, rates, totals = column + 8 * n, column + 8 * (n + n * c), column + 8 * (n + 2 * n * c)
    if set_values(own, word(table, VALUES)) != 0:
        return BROKEN
    h = number(table, STEP) / parts
    for i in range(n):
        put_number(here, i, number(x, i))
        for j in range(c):
            put_number(slopes, i * c + j, 1.0 if i == j else 0.0)
    for _ in range(parts):
        for i in range(n):
            put_number(stage, i, number(here, i))
            put_number(total, i, 0.0)
        for i in range(n * c):
            put_number(staged, i, number(slopes, i))
            put_number(totals, i, 0.0)
        for s in range(4):
            code = slope(own, 0.0, stage, rate)
            if code != 0:
                return _outcome(code)
            for j in range(c):
                for i in range(n):
                    put_number(seed, i, number(staged, i * c + j))
                for i in range(n, c):
                    put_number(seed, i, 1.0 if i == j else 0.0)
                result = directional(table, word(table, RATES), word(table, RATE_COUNT), seed, c, column, n)
                if result != 0:
                    return result
                for i in range(n):
                    put_number(rates, i * c + j, number(column, i))
            weight = 2.0 if s == 1 or s == 2 else 1.0
            ahead = h if s == 2 else 0.5 * h
            for i in range(n):
                put_number(total, i, number(total, i) + weight * number(rate, i))
                put_number(stage, i, number(here, i) + ahead * number(rate, i))
            for i in range(n * c):
                put_number(totals, i, number(totals, i) + weight * number(rates, i))
                put_number(staged, i, number(slopes, i) + ahead * number(rates, i))
        for i in range(n):
            put_number(here, i, number(here, i) + h / 6.0 * number(total, i))
        for i in range(n * c):
            put_number(slopes, i, number(slopes, i) + h / 6.0 * number(totals, i))
    return 0


@callee
def show(table, x):
    """Write the outputs at a state into ``SHOWN``."""
    own = word(table, OWN)
    code = place(own, 0.0, x)
    if code != 0:
        return _outcome(code)
    return of_step(get_values(own, word(table, SHOWN)))


@callee
def show_slopes(table, x, slopes):
    """Write the derivatives of the outputs by the states (outputs x n)."""
    own, n, m = word(table, OWN), word(table, PLANT_STATES), word(table, OUTPUTS)
    c = n + word(table, DRIVEN)
    seed = word(table, WORK)
    column = seed + 8 * c
    code = place(own, 0.0, x)
    if code != 0:
        return _outcome(code)
    for j in range(c):
        put_number(seed, j, 0.0)
    for j in range(n):
        put_number(seed, j, 1.0)
        result = directional(table, word(table, SEEN), word(table, SEEN_COUNT), seed, c, column, m)
        if result != 0:
            return result
        put_number(seed, j, 0.0)
        for i in range(m):
            put_number(slopes, i * n + j, number(column, i))
    return 0


def work_size(n: int, c: int, outputs: int) -> int:
    """Return the size of the scratch memory for n states, c states and controls, and a number of outputs."""
    return 5 * n + c + 3 * n * c + outputs
