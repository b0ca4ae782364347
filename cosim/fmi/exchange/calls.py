"""Calls, by address, of the functions of model exchange FMUs and of CVODE, for compiled code."""

# The checker sees the intrinsics with the typing context that numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_I32, _I64 = ir.IntType(32), ir.IntType(64)


def _call(builder, function, arguments):
    kind = ir.FunctionType(_I32, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(function, kind.as_pointer()), arguments)


@intrinsic
def plain(typingctx, function, component):
    """int32 (*)(void *): enter event mode, enter continuous-time mode."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64), codegen


@intrinsic
def at_time(typingctx, function, component, t):
    """int32 (*)(void *, double): fmi2SetTime, fmi3SetTime, CVodeSetStopTime."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.float64), codegen


@intrinsic
def vector(typingctx, function, component, values, count):
    """int32 (*)(void *, double *, size_t): states, derivatives, event indicators, nominal values."""

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
def update1(typingctx, function, component, info):
    """int32 (*)(void *, char, fmiEventInfo *): fmiEventUpdate, to the end of the event iteration."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [args[1], ir.Constant(_I32, 0), args[2]])

    return types.int32(types.int64, types.int64, types.int64), codegen


@intrinsic
def update2(typingctx, function, component, info):
    """int32 (*)(void *, fmi2EventInfo *): fmi2NewDiscreteStates; fmiCompletedIntegratorStep."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.int64), codegen


@intrinsic
def update3(typingctx, function, component, info):
    """int32 (*)(void *, bool * (5), double *): fmi3UpdateDiscreteStates, which writes to six words one after the other."""

    def codegen(context, builder, signature, args):
        places = [builder.add(args[2], ir.Constant(_I64, 8 * i)) for i in range(6)]
        return _call(builder, args[0], [args[1], *places])

    return types.int32(types.int64, types.int64, types.int64), codegen


@intrinsic
def integrate(typingctx, function, memory, t, y, reached, task):
    """int32 (*)(void *, double, N_Vector, double *, int): CVode."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], [*args[1:5], builder.trunc(args[5], _I32)])

    return types.int32(types.int64, types.int64, types.float64, types.int64, types.int64, types.int64), codegen


@intrinsic
def restart(typingctx, function, memory, t, y):
    """int32 (*)(void *, double, N_Vector): CVodeReInit, CVodeSVtolerances."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], args[1:])

    return types.int32(types.int64, types.int64, types.float64, types.int64), codegen
