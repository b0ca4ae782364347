"""The step of an FMU as compiled functions with the engine's signature, shared by all instances.

At the address ``parameters`` they find the instance's table of 64-bit words: pointers to the instance and to the FMI
functions, the value references, the step size. Status: 0, or a number of `GET`, `SET`, `STEP` plus FMI's own status, or
`EARLY`, `TERMINATED`.
"""

# The checker sees the intrinsics with the typing context that numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable

GET, SET, STEP = 100, 200, 300
EARLY, TERMINATED = 401, 402

# Words of the table.
COMPONENT, GET_REAL, SET_REAL, DO_STEP, INPUTS, INPUT_COUNT, OUTPUTS, OUTPUT_COUNT, STEP_SIZE, SCRATCH = range(10)
WORDS = 10

# Words of the scratch memory for what fmi3DoStep returns; a C bool takes the lowest byte of its word.
EVENT, TERMINATE, RETURNED_EARLY, REACHED = range(4)
SCRATCH_WORDS = 4

TOLERANCE = 1e-9
"""Part of a step that an FMU may fall short of its end before it counts as an early return."""

_I32, _I64, _DOUBLE = ir.IntType(32), ir.IntType(64), ir.DoubleType()


@intrinsic
def word(typingctx, address, index):
    """Load the 64-bit integer number `index` of those that begin at an address."""

    def codegen(context, builder, signature, args):
        place = builder.add(args[0], builder.mul(args[1], ir.Constant(_I64, 8)))
        return builder.load(builder.inttoptr(place, _I64.as_pointer()))

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def number(typingctx, address, index):
    """Load the double number `index` of those that begin at an address."""

    def codegen(context, builder, signature, args):
        place = builder.add(args[0], builder.mul(args[1], ir.Constant(_I64, 8)))
        return builder.load(builder.inttoptr(place, _DOUBLE.as_pointer()))

    return types.float64(types.int64, types.int64), codegen


def _call(builder, function, arguments):
    kind = ir.FunctionType(_I32, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(function, kind.as_pointer()), arguments)


@intrinsic
def values2(typingctx, function, component, references, count, values):
    """int32 (*)(void *, const uint32 *, size_t, double *): fmi2GetReal and fmi2SetReal."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(*[types.int64] * 5), codegen


@intrinsic
def values3(typingctx, function, component, references, count, values):
    """int32 (*)(void *, const uint32 *, size_t, double *, size_t): fmi3GetFloat64 and fmi3SetFloat64."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [*args[1:], args[3]])

    return types.int32(*[types.int64] * 5), codegen


@intrinsic
def step2(typingctx, function, component, t, h):
    """int32 (*)(void *, double, double, int): fmi2DoStep, never to go back before this point."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [*args[1:], ir.Constant(_I32, 1)])

    return types.int32(types.int64, types.int64, types.float64, types.float64), codegen


@intrinsic
def step3(typingctx, function, component, t, h, scratch):
    """int32 (*)(void *, double, double, bool, bool *, bool *, bool *, double *): fmi3DoStep.

    The bool by value travels in a register, so it is passed as the int that C would widen it to.
    """

    def codegen(context, builder, signature, args):
        places = [builder.add(args[4], ir.Constant(_I64, 8 * i)) for i in range(SCRATCH_WORDS)]
        return _call(builder, args[0], [*args[1:4], ir.Constant(_I32, 1), *places])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), codegen


@register_jitable(error_model="numpy", forceinline=True)
def _failed(where, status):
    return where + status if status > 1 or status < 0 else 0


@register_jitable(error_model="numpy", forceinline=True)
def _get2(parameters, outputs):
    count = word(parameters, OUTPUT_COUNT)
    if count == 0:
        return 0
    references = word(parameters, OUTPUTS)
    return _failed(GET, values2(word(parameters, GET_REAL), word(parameters, COMPONENT), references, count, outputs))


@register_jitable(error_model="numpy", forceinline=True)
def _get3(parameters, outputs):
    count = word(parameters, OUTPUT_COUNT)
    if count == 0:
        return 0
    references = word(parameters, OUTPUTS)
    return _failed(GET, values3(word(parameters, GET_REAL), word(parameters, COMPONENT), references, count, outputs))


@register_jitable(error_model="numpy", forceinline=True)
def _step2(parameters, inputs, t):
    component = word(parameters, COMPONENT)
    count = word(parameters, INPUT_COUNT)
    if count > 0:
        status = _failed(SET, values2(word(parameters, SET_REAL), component, word(parameters, INPUTS), count, inputs))
        if status != 0:
            return status
    return _failed(STEP, step2(word(parameters, DO_STEP), component, t, number(parameters, STEP_SIZE)))


@register_jitable(error_model="numpy", forceinline=True)
def _step3(parameters, inputs, t):
    component = word(parameters, COMPONENT)
    count = word(parameters, INPUT_COUNT)
    if count > 0:
        status = _failed(SET, values3(word(parameters, SET_REAL), component, word(parameters, INPUTS), count, inputs))
        if status != 0:
            return status
    h = number(parameters, STEP_SIZE)
    scratch = word(parameters, SCRATCH)
    status = _failed(STEP, step3(word(parameters, DO_STEP), component, t, h, scratch))
    if status != 0:
        return status
    if word(scratch, TERMINATE) != 0:
        return TERMINATED
    if word(scratch, RETURNED_EARLY) != 0 and not number(scratch, REACHED) >= t + h - TOLERANCE * h:
        return EARLY
    return 0


def get2(state, parameters, inputs, outputs, t, k):
    """Read the outputs of an FMI 2 instance."""
    return _get2(parameters, outputs)


def advance2(state, parameters, inputs, outputs, t, k):
    """Set the inputs of an FMI 2 instance and make its step."""
    return _step2(parameters, inputs, t)


def get3(state, parameters, inputs, outputs, t, k):
    """Read the outputs of an FMI 3 instance."""
    return _get3(parameters, outputs)


def advance3(state, parameters, inputs, outputs, t, k):
    """Set the inputs of an FMI 3 instance and make its step."""
    return _step3(parameters, inputs, t)


def sampled2(state, parameters, inputs, outputs, t, k):
    """Set the inputs of an FMI 2 instance, make its step, read its outputs."""
    status = _step2(parameters, inputs, t)
    if status != 0:
        return status
    return _get2(parameters, outputs)


def sampled3(state, parameters, inputs, outputs, t, k):
    """Set the inputs of an FMI 3 instance, make its step, read its outputs."""
    status = _step3(parameters, inputs, t)
    if status != 0:
        return status
    return _get3(parameters, outputs)


FUNCTIONS = {
    (2, "get"): get2,
    (2, "advance"): advance2,
    (2, "sampled"): sampled2,
    (3, "get"): get3,
    (3, "advance"): advance3,
    (3, "sampled"): sampled3,
}
