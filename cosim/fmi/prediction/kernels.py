"""The functions of a prediction, compiled: they take an instance from the pool, compute, and give it back.

Where the FMU has no finite value, all results are NaN. The first argument is the address of the pool's table
(`bayesftc.cosim.fmi.prediction.words`); the others are addresses of arrays.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.exchange.right import not_finite
from bayesftc.cosim.fmi.prediction.by_exchange import integrate, integrate_slopes, show, show_slopes
from bayesftc.cosim.fmi.prediction.by_steps import show_begin, step
from bayesftc.cosim.fmi.prediction.words import (
    ADD,
    BROKEN,
    CONTROLS,
    COUNT,
    DIRECTIONAL,
    DRIVEN,
    EXCHANGE,
    HEAD,
    HELD,
    INPUTS,
    LOADS,
    LOCK,
    MOVED,
    ORDER,
    PLACE,
    PLANT_STATES,
    REFUSED,
    REPLACE,
    SCALES,
    SENSORS,
    SHOWN,
    SLOPES,
    STATES,
    TABLE,
    VALUES,
)
from bayesftc.cosim.fmi.running.kernels import number, put_number, word
from bayesftc.cosim.stepping.by_address import call_block
from bayesftc.cosim.stepping.numba_called import callee

NAN = float("nan")
CENTRAL = 6.055454452393343e-06
"""The cube root of the rounding error: the best step of a central difference, as a share of the size."""


@intrinsic
def _locks(typingctx, address):
    """Set the word at an address from 0 to 1, atomically; return whether it was 0."""

    def codegen(context, builder, signature, args):
        i64 = ir.IntType(64)
        pointer = builder.inttoptr(args[0], i64.as_pointer())
        pair = builder.cmpxchg(pointer, ir.Constant(i64, 0), ir.Constant(i64, 1), "acq_rel", "monotonic")
        return builder.extract_value(pair, 1)

    return types.boolean(types.int64), codegen


@intrinsic
def _unlock(typingctx, address):
    """Set the word at an address to 0, atomically."""

    def codegen(context, builder, signature, args):
        i64 = ir.IntType(64)
        builder.atomic_rmw("xchg", builder.inttoptr(args[0], i64.as_pointer()), ir.Constant(i64, 0), "release")
        return context.get_dummy_value()

    return types.void(types.int64), codegen


@callee
def _taken(pool):
    """Return the number of a free instance, which no other thread uses until `_given_back`; -1 if none can be made."""
    while True:
        for i in range(word(pool, COUNT)):
            if _locks(pool + 8 * (HEAD + PLACE * i + LOCK)):
                return i
        if call_block(word(pool, ADD), 0, pool, 0, 0, 0.0, 0) != 0:
            return -1


@callee
def _table_of(pool, i):
    return word(pool, HEAD + PLACE * i + TABLE)


@callee
def _given_back(pool, i, result):
    if result != BROKEN or call_block(word(pool, REPLACE), 0, pool, 0, 0, 0.0, i) == 0:
        _unlock(pool + 8 * (HEAD + PLACE * i + LOCK))


@callee
def _fill(address, count):
    for i in range(count):
        put_number(address, i, NAN)


@callee
def _finite(address, count):
    return not not_finite(address, count)


@callee
def _inputs(table, x, u):
    """Write the inputs: those at rest, the controls, and the loads on them that are states."""
    n, p, loads = word(table, PLANT_STATES), word(table, DRIVEN), word(table, LOADS)
    held, values = word(table, HELD), word(table, VALUES)
    for j in range(word(table, INPUTS)):
        put_number(values, j, number(held, j))
    for j in range(p):
        load = number(x, n + j) if j < loads else 0.0
        put_number(values, j, number(u, j) + load)


@callee
def _move(table, x, u, following):
    n, loads = word(table, PLANT_STATES), word(table, LOADS)
    if not (_finite(x, n + loads) and _finite(u, word(table, DRIVEN))):
        return REFUSED
    _inputs(table, x, u)
    result = integrate(table, x, following) if word(table, EXCHANGE) != 0 else step(table, x, following)
    for i in range(loads):
        put_number(following, n + i, number(x, n + i))
    if result == 0 and not _finite(following, n):
        return REFUSED
    return result


@callee
def _read(table, pool, x, readings):
    n = word(table, PLANT_STATES)
    if not _finite(x, n):
        return REFUSED
    shown, order = word(table, SHOWN), word(table, ORDER)
    result = show(table, x) if word(table, EXCHANGE) != 0 else show_begin(table, x)
    for i in range(word(pool, SENSORS)):
        put_number(readings, i, number(shown, word(order, i)))
    return result


@callee
def _move_slopes(table, x, u, F, B):
    n, p, loads = word(table, PLANT_STATES), word(table, DRIVEN), word(table, LOADS)
    if not (_finite(x, n + loads) and _finite(u, p)):
        return REFUSED
    slopes, c, whole = word(table, SLOPES), n + p, n + loads
    if word(table, EXCHANGE) != 0 and word(table, DIRECTIONAL) != 0:
        _inputs(table, x, u)
        result = integrate_slopes(table, x, slopes)
    else:
        result = _differences(table, x, u, slopes)
    for i in range(whole):
        for j in range(whole):
            put_number(F, i * whole + j, number(slopes, i * c + j) if i < n else 1.0 if i == j else 0.0)
        for j in range(p):
            put_number(B, i * p + j, number(slopes, i * c + n + j) if i < n else 0.0)
    return result


@callee
def _differences(table, x, u, slopes):
    """Write the derivatives of the next state by states and controls, by central differences."""
    n, p, loads = word(table, PLANT_STATES), word(table, DRIVEN), word(table, LOADS)
    at, scales, c = word(table, MOVED), word(table, SCALES), n + p
    controls, above, below = at + 8 * (n + loads), at + 8 * (n + loads + p), at + 8 * (2 * (n + loads) + p)
    for i in range(n + loads):
        put_number(at, i, number(x, i))
    for i in range(p):
        put_number(controls, i, number(u, i))
    for j in range(c):
        place, index = (at, j) if j < n else (controls, j - n)
        here = number(place, index)
        change = CENTRAL * max(abs(here), number(scales, j))
        put_number(place, index, here + change)
        high = number(place, index)
        result = _move(table, at, controls, above)
        if result != 0:
            return result
        put_number(place, index, here - change)
        low = number(place, index)
        result = _move(table, at, controls, below)
        if result != 0:
            return result
        put_number(place, index, here)
        for i in range(n):
            put_number(slopes, i * c + j, (number(above, i) - number(below, i)) / (high - low))
    return 0


@callee
def _read_slopes(table, pool, x, C):
    n, loads, sensors = word(table, PLANT_STATES), word(table, LOADS), word(pool, SENSORS)
    if not _finite(x, n):
        return REFUSED
    whole, order, slopes = n + loads, word(table, ORDER), word(table, SLOPES)
    if word(table, EXCHANGE) != 0 and word(table, DIRECTIONAL) != 0:
        result = show_slopes(table, x, slopes)
        for i in range(sensors):
            for j in range(whole):
                put_number(C, i * whole + j, number(slopes, word(order, i) * n + j) if j < n else 0.0)
        return result
    at, scales = word(table, MOVED), word(table, SCALES)
    above, below = at + 8 * n, at + 8 * (n + sensors)
    for i in range(n):
        put_number(at, i, number(x, i))
    for j in range(whole):
        if j >= n:
            for i in range(sensors):
                put_number(C, i * whole + j, 0.0)
            continue
        here = number(at, j)
        change = CENTRAL * max(abs(here), number(scales, j))
        put_number(at, j, here + change)
        high = number(at, j)
        result = _read(table, pool, at, above)
        if result != 0:
            return result
        put_number(at, j, here - change)
        low = number(at, j)
        result = _read(table, pool, at, below)
        if result != 0:
            return result
        put_number(at, j, here)
        for i in range(sensors):
            put_number(C, i * whole + j, (number(above, i) - number(below, i)) / (high - low))
    return 0


def move(pool, x, u, following, unused):
    """Write the state one step later."""
    i = _taken(pool)
    result = BROKEN
    if i >= 0:
        result = _move(_table_of(pool, i), x, u, following)
        _given_back(pool, i, result)
    if result != 0:
        _fill(following, word(pool, STATES))


def move_slopes(pool, x, u, F, B):
    """Write the derivatives of the state one step later by the state and by the control."""
    n, i = word(pool, STATES), _taken(pool)
    result = BROKEN
    if i >= 0:
        result = _move_slopes(_table_of(pool, i), x, u, F, B)
        _given_back(pool, i, result)
    if result != 0:
        _fill(F, n * n)
        _fill(B, n * word(pool, CONTROLS))


def read(pool, x, readings, unused, unused_too):
    """Write the reading of each sensor."""
    i = _taken(pool)
    result = BROKEN
    if i >= 0:
        result = _read(_table_of(pool, i), pool, x, readings)
        _given_back(pool, i, result)
    if result != 0:
        _fill(readings, word(pool, SENSORS))


def read_slopes(pool, x, C, unused, unused_too):
    """Write the derivatives of the readings by the state."""
    i = _taken(pool)
    result = BROKEN
    if i >= 0:
        result = _read_slopes(_table_of(pool, i), pool, x, C)
        _given_back(pool, i, result)
    if result != 0:
        _fill(C, word(pool, SENSORS) * word(pool, STATES))


FUNCTIONS = {"move": move, "move_slopes": move_slopes, "read": read, "read_slopes": read_slopes}
SIGNATURE = "void(int64, int64, int64, int64, int64)"
