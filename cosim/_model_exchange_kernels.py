"""What CVODE calls of a model exchange FMU, and one stretch of integration between events, as compiled functions.

CVODE's user data is the address of a table of 64-bit words: the instance, the FMI functions, CVODE's own, and room for what
went wrong. Nothing here returns to Python, so a right-hand side costs what the FMU's own functions cost.
"""

# The checker sees the intrinsics with the typing context that numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable

from bayesftc.cosim._fmi_kernels import number, word

# Words of the table: the FMU ...
COMPONENT, SET_TIME, SET_STATES, GET_DERIVATIVES, GET_INDICATORS, COMPLETED_STEP = range(6)
STATES, INDICATORS, WANTS_STEPS, NO_RETURN = range(6, 10)
# ... CVODE ...
MEMORY, VECTOR, INTEGRATE, RESTART, SET_STOP, LIMIT = range(10, 16)
# ... and what they write: time reached, flags of a completed step, which function failed, with which status, and when.
REACHED, ENTER, TERMINATE, ROLE, STATUS, WHEN, STEPS = range(16, 23)
WORDS = 23

# Roles: functions that can fail; `NOT_A_NUMBER` is a derivative or an event indicator that is none.
TIME_ROLE, STATES_ROLE, DERIVATIVES_ROLE, INDICATORS_ROLE, STEP_ROLE, NAN_DERIVATIVE, NAN_INDICATOR = range(1, 8)

# What a stretch returns besides CVODE's own flags: CVODE's success, its stop, its root; its own: the FMU wants event mode, it
# wants the end, a call failed after a step, the limit of steps was reached.
DONE, STOPPED, ROOT = 0, 1, 2
WANTS_EVENT, WANTS_END, CALL_FAILED, TOO_MANY = 1001, 1002, -1001, -1002

NORMAL, ONE_STEP = 1, 2

_I32, _I64, _DOUBLE = ir.IntType(32), ir.IntType(64), ir.DoubleType()


def _call(builder, function, arguments):
    kind = ir.FunctionType(_I32, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(function, kind.as_pointer()), arguments)


@intrinsic
def store(typingctx, address, index, value):
    """Store an integer or a double as the 64-bit word number `index` of those that begin at an address."""

    def codegen(context, builder, signature, args):
        place = builder.add(args[0], builder.mul(args[1], ir.Constant(_I64, 8)))
        builder.store(args[2], builder.inttoptr(place, args[2].type.as_pointer()))
        return context.get_dummy_value()

    kind = types.float64 if isinstance(value, types.Float) else types.int64
    return types.void(types.int64, types.int64, kind), codegen


@intrinsic
def at_time(typingctx, function, component, t):
    """int32 (*)(void *, double): fmi2SetTime, fmi3SetTime, CVodeSetStopTime."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.float64), codegen


@intrinsic
def vector(typingctx, function, component, values, count):
    """int32 (*)(void *, double *, size_t): states, derivatives and event indicators."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def completed(typingctx, function, component, no_return, enter, terminate):
    """int32 (*)(void *, int, int *, int *): fmi2CompletedIntegratorStep and, with bools, fmi3CompletedIntegratorStep."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [args[1], builder.trunc(args[2], _I32), *args[3:]])

    return types.int32(*[types.int64] * 5), codegen


@intrinsic
def integrate(typingctx, function, memory, t, y, reached, task):
    """int32 (*)(void *, double, N_Vector, double *, int): CVode."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [*args[1:5], builder.trunc(args[5], _I32)])

    return types.int32(types.int64, types.int64, types.float64, types.int64, types.int64, types.int64), codegen


@intrinsic
def restart(typingctx, function, memory, t, y):
    """int32 (*)(void *, double, N_Vector): CVodeReInit."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.float64, types.int64), codegen


@register_jitable(error_model="numpy", forceinline=True)
def _failed(table, t, role, status):
    """Note what failed; return CVODE's word for it: 0 for nothing, 1 to try a smaller step (Discard), -1 to give up."""
    if 0 <= status <= 1:
        return 0
    store(table, ROLE, role)
    store(table, STATUS, status)
    store(table, WHEN, t)
    return 1 if status == 2 else -1


@register_jitable(error_model="numpy", forceinline=True)
def _place(table, t, y):
    """Bring the FMU to a time and to the states in CVODE's vector `y`: its content's third word points to them."""
    component, count = word(table, COMPONENT), word(table, STATES)
    failed = _failed(table, t, TIME_ROLE, at_time(word(table, SET_TIME), component, t))
    if failed != 0 or count == 0:
        return failed
    values = word(word(y, 0), 2)
    return _failed(table, t, STATES_ROLE, vector(word(table, SET_STATES), component, values, count))


@register_jitable(error_model="numpy", forceinline=True)
def _not_finite(values, count):
    for i in range(count):
        value = number(values, i)
        if value - value != 0.0:
            return True
    return False


def derivatives(t, y, slope, table):
    """CVRhsFn: the derivatives at a time and states; without any states, those of the constant that stands for them."""
    failed = _place(table, t, y)
    if failed != 0:
        return failed
    values, count = word(word(slope, 0), 2), word(table, STATES)
    if count == 0:
        store(values, 0, 0.0)
        return 0
    failed = _failed(
        table, t, DERIVATIVES_ROLE, vector(word(table, GET_DERIVATIVES), word(table, COMPONENT), values, count)
    )
    if failed == 0 and _not_finite(values, count):
        return _failed(table, t, NAN_DERIVATIVE, 2)
    return failed


def indicators(t, y, values, table):
    """CVRootFn: the event indicators at a time and states."""
    failed = _place(table, t, y)
    if failed != 0:
        return failed
    count = word(table, INDICATORS)
    failed = _failed(
        table, t, INDICATORS_ROLE, vector(word(table, GET_INDICATORS), word(table, COMPONENT), values, count)
    )
    if failed == 0 and _not_finite(values, count):
        return _failed(table, t, NAN_INDICATOR, 3)
    return failed


def stretch(_state, table, _inputs, _outputs, t, end):
    """Integrate afresh from time `t` and the states in the vector to `end`, or to an event before it; bring the FMU there.

    In the shape of a step function, so that it is compiled as one; `end` is a place in memory with a double.
    """
    until = number(end, 0)
    memory, y = word(table, MEMORY), word(table, VECTOR)
    store(table, ROLE, 0)
    flag = restart(word(table, RESTART), memory, t, y)
    if flag == 0:
        flag = at_time(word(table, SET_STOP), memory, until)
    if flag != 0:
        return flag
    reached, wants = table + 8 * REACHED, word(table, WANTS_STEPS)
    task = ONE_STEP if wants != 0 else NORMAL
    for step in range(word(table, LIMIT)):
        flag = integrate(word(table, INTEGRATE), memory, until, y, reached, task)
        store(table, STEPS, step + 1)
        if flag < 0:
            return flag
        now = number(table, REACHED)
        if _place(table, now, y) != 0:
            return CALL_FAILED
        if wants == 0:
            return flag
        store(table, ENTER, 0)
        store(table, TERMINATE, 0)
        status = completed(
            word(table, COMPLETED_STEP), word(table, COMPONENT), word(table, NO_RETURN), table + 8 * ENTER,
            table + 8 * TERMINATE,
        )  # fmt: skip
        if _failed(table, now, STEP_ROLE, status) != 0:
            return CALL_FAILED
        if word(table, TERMINATE) != 0:
            return WANTS_END
        if word(table, ENTER) != 0:
            return WANTS_EVENT
        if flag != DONE:
            return flag
    return TOO_MANY
