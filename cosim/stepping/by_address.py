"""Arrays and calls by address, for compiled code."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def as_floats(typingctx, address):
    """Return the float64 array that begins at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), codegen


@intrinsic
def as_integers(typingctx, address):
    """Return the int64 array that begins at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.IntType(64).as_pointer())

    return types.CPointer(types.int64)(types.int64), codegen


@intrinsic
def call_block(typingctx, address, state, parameters, inputs, outputs, t, k):
    """int32 (*)(double *, double *, double *, double *, double, int64_t), given as integers."""
    signature = types.int32(types.int64, types.int64, types.int64, types.int64, types.int64, types.float64, types.int64)

    def codegen(context, builder, sig, args):
        i64 = ir.IntType(64)
        function = ir.FunctionType(ir.IntType(32), [i64, i64, i64, i64, ir.DoubleType(), i64])
        return builder.call(builder.inttoptr(args[0], function.as_pointer()), args[1:])

    return signature, codegen


@intrinsic
def put_back(typingctx, function, instance, state):
    """int32 (*)(void *, void *), given as integers: FMI's function that restores a saved state of an instance."""
    signature = types.int32(types.int64, types.int64, types.int64)

    def codegen(context, builder, sig, args):
        i64 = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [i64, i64])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return signature, codegen


@intrinsic
def call_loop(typingctx, address, memory, calls, buffer, recording, failed, before, first, begin, end):
    """Call the loop of one diagram (`bayesftc.cosim.run.fused`), all given as integers."""
    signature = types.int64(*[types.int64] * 10)

    def codegen(context, builder, sig, args):
        i64, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
        function = ir.FunctionType(i64, [*[pointer] * 5, *[i64] * 4])
        pointers = [builder.inttoptr(word, pointer) for word in args[1:6]]
        return builder.call(builder.inttoptr(args[0], function.as_pointer()), [*pointers, *args[6:]])

    return signature, codegen
