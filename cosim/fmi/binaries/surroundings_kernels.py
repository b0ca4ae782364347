"""Note and restore what surrounds calls of an FMU, compiled, because these calls surround every step of a live run.

The words named below are at the address `place`. The functions with the engine's signature have it in ``state``.
"""

from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.binaries.surroundings import (
    ACTION,
    AFTER,
    ARITHMETIC,
    BEFORE,
    CHANGED,
    ENVIRONMENT,
    FEGETENV,
    FESETENV,
    FOLDER,
    GETCWD,
    HANDLER,
    INTERRUPTS,
    LEAST,
    ONE,
    PATH,
    SIGACTION,
    SIGINT,
    SMALL,
    STRCMP,
    TINY,
    USUAL,
    WORDS,
)
from bayesftc.cosim.stepping.by_address import as_floats, as_integers
from bayesftc.cosim.stepping.numba_called import callee, inlined

_I32, _I64 = ir.IntType(32), ir.IntType(64)


def _call(builder, address, result, arguments):
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(address, kind.as_pointer()), arguments)


@intrinsic
def environment(typingctx, function, place):
    """int32 (*)(void *): fegetenv and fesetenv."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], _I32, args[1:])

    return types.int32(types.int64, types.int64), codegen


@intrinsic
def folder(typingctx, function, place, size):
    """int8 *(*)(int8 *, size_t): getcwd."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], _I64, args[1:])

    return types.int64(types.int64, types.int64, types.int64), codegen


@intrinsic
def difference(typingctx, function, first, second):
    """int32 (*)(const char *, const char *): strcmp."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], _I32, args[1:])

    return types.int32(types.int64, types.int64, types.int64), codegen


@intrinsic
def action(typingctx, function, number, change, place):
    """int32 (*)(int, const struct sigaction *, struct sigaction *): sigaction."""

    def codegen(context, builder, signature, args):
        return _call(builder, args[0], _I32, [builder.trunc(args[1], _I32), *args[2:]])

    return types.int32(types.int64, types.int64, types.int64, types.int64), codegen


@inlined
def _find_folder(words, place):
    """Write the working directory; an empty path if it was deleted."""
    if folder(words[GETCWD], place, PATH) == 0:
        carray(as_integers(place), (1,))[0] = 0


@inlined
def _find_whether_usual(words, address):
    """Write whether this thread computes as usual: into memory, so that LLVM computes it before the next call."""
    x = carray(as_floats(address), (WORDS,))
    nearest = x[ONE] + x[SMALL] == x[ONE] and x[ONE] - x[SMALL] == x[ONE]
    words[USUAL] = nearest and x[LEAST] * 0.5 != 0.0 and x[TINY] * x[ONE] != 0.0


@callee
def noted(place):
    """Note the working directory and this thread's arithmetic."""
    words = carray(as_integers(place), (WORDS,))
    words[CHANGED] = 0
    if words[GETCWD] != 0:
        _find_folder(words, place + 8 * BEFORE)
    if words[FEGETENV] != 0:
        environment(words[FEGETENV], place + 8 * ENVIRONMENT)


@callee
def restored(place):
    """Restore this thread's arithmetic; CHANGED becomes what is left to Python: ARITHMETIC, FOLDER, INTERRUPTS."""
    words = carray(as_integers(place), (WORDS,))
    _find_whether_usual(words, place)
    was_usual = words[USUAL]
    if words[FESETENV] != 0:
        environment(words[FESETENV], place + 8 * ENVIRONMENT)
    if was_usual == 0:
        _find_whether_usual(words, place)
        if words[USUAL] != 0:
            words[CHANGED] += ARITHMETIC
    if words[GETCWD] != 0:
        _find_folder(words, place + 8 * AFTER)
    if words[GETCWD] == 0 or difference(words[STRCMP], place + 8 * BEFORE, place + 8 * AFTER) != 0:
        words[CHANGED] += FOLDER
    if words[SIGACTION] != 0:
        action(words[SIGACTION], words[SIGINT], 0, place + 8 * ACTION)
    if words[SIGACTION] == 0 or words[ACTION] != words[HANDLER]:
        words[CHANGED] += INTERRUPTS


def note(state, parameters, inputs, outputs, t, k):
    """See `noted`."""
    noted(state)
    return 0


def restore(state, parameters, inputs, outputs, t, k):
    """See `restored`."""
    restored(state)
    return 0


FUNCTIONS = {"note": note, "restore": restore}
