"""Calls, by address, of the functions of model exchange FMUs and of CVODE, for compiled code."""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.running.kernels import as_given, call

_I32 = ir.IntType(32)


@intrinsic
def at_time(typingctx, function, component, t):
    """int32 (*)(void *, double): fmi2SetTime, fmi3SetTime, CVodeSetStopTime."""
    return as_given(function, component, t)


@intrinsic
def vector(typingctx, function, component, values, count):
    """int32 (*)(void *, double *, size_t): states, derivatives, event indicators, nominal values."""
    return as_given(function, component, values, count)


@intrinsic
def completed(typingctx, function, component, no_return, enter, terminate):
    """int32 (*)(void *, int, int *, int *): fmi2CompletedIntegratorStep and, with bools, fmi3CompletedIntegratorStep."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [args[1], builder.trunc(args[2], _I32), *args[3:]])

    return types.int32(*[types.int64] * 5), codegen


@intrinsic
def update1(typingctx, function, component, info):
    """int32 (*)(void *, char, fmiEventInfo *): fmiEventUpdate, to the end of the event iteration."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [args[1], ir.Constant(_I32, 0), args[2]])

    return types.int32(types.int64, types.int64, types.int64), codegen


@intrinsic
def update2(typingctx, function, component, info):
    """int32 (*)(void *, fmi2EventInfo *): fmi2NewDiscreteStates; fmiCompletedIntegratorStep."""
    return as_given(function, component, info)


@intrinsic
def integrate(typingctx, function, memory, t, y, reached, task):
    """int32 (*)(void *, double, N_Vector, double *, int): CVode."""

    def codegen(context, builder, signature, args):
        return call(builder, args[0], [*args[1:5], builder.trunc(args[5], _I32)])

    return types.int32(types.int64, types.int64, types.float64, types.int64, types.int64, types.int64), codegen


@intrinsic
def restart(typingctx, function, memory, t, y):
    """int32 (*)(void *, double, N_Vector): CVodeReInit, CVodeSVtolerances."""
    return as_given(function, memory, t, y)
