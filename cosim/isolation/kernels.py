"""Both ends of the connection to an isolated FMU, compiled: a step takes one round trip over a socket.

The host's functions have the engine's signature; the words named below are at the address ``parameters``. The worker's function,
`serve`, answers steps until another command comes.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bayesftc.cosim.fmi.running.kernels import number, put_number, put_word, word
from bayesftc.cosim.isolation import protocol
from bayesftc.cosim.stepping.by_address import call_block
from bayesftc.cosim.stepping.numba_called import inlined

# Words of the host's table.
SEND, RECEIVE, WHERE, SOCKET, SHARED, INPUT_COUNT, OUTPUT_COUNT, ATTEND, STEP_SIZE = range(9)

# Words of the worker's table; the first six are the same.
UPDATE, OUTPUT, TABLE, READS_AHEAD, NUMERATOR, DENOMINATOR, STEP_WORD, FOLLOWS = range(6, 14)

COMMAND, ANSWER, STATUS, RESULT = protocol.COMMAND, protocol.ANSWER, protocol.STATUS, protocol.RESULT
AHEAD, READ_STATUS, LOGGED, PHASE = protocol.AHEAD, protocol.READ_STATUS, protocol.LOGGED, protocol.PHASE
TIME, SIZE, COUNT = protocol.TIME, protocol.SIZE, protocol.COUNT
HEADER, MESSAGE = protocol.WORDS, protocol.MESSAGE
READ, STEP = protocol.READ, protocol.STEP
IDLE, STEPPING, READING, ASKED = protocol.IDLE, protocol.STEPPING, protocol.READING, protocol.ASKED
PROCESSOR, INTERRUPTED = protocol.PROCESSOR, protocol.INTERRUPTED
GONE, SIGNALLED, PAUSED, ELSEWHERE = protocol.GONE, protocol.SIGNALLED, protocol.PAUSED, protocol.ELSEWHERE
PAUSE = protocol.PAUSE
NO_SIGNAL = 0x4000
"""MSG_NOSIGNAL of Linux: if the other process has ended, `send` returns an error instead of raising a signal."""

_I32, _I64 = ir.IntType(32), ir.IntType(64)


@intrinsic
def transfer(typingctx, function, socket, address, count, flags):
    """ssize_t (*)(int, void *, size_t, int): send and recv."""

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(_I64, [_I32, _I64, _I64, _I32])
        socket, flags = (builder.trunc(args[i], _I32) for i in (1, 4))
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), [socket, args[2], args[3], flags])

    return types.int64(*[types.int64] * 5), codegen


@intrinsic
def processor(typingctx, function):
    """Call ``int (*)(void)``: sched_getcpu."""

    def codegen(context, builder, signature, args):
        return builder.call(builder.inttoptr(args[0], ir.FunctionType(_I32, []).as_pointer()), [])

    return types.int32(types.int64), codegen


@inlined
def _exchange(command, parameters, inputs, t, k):
    shared = word(parameters, SHARED)
    for i in range(word(parameters, INPUT_COUNT)):
        put_number(shared, HEADER + i, number(inputs, i))
    put_number(shared, TIME, t)
    put_number(shared, SIZE, number(parameters, STEP_SIZE))
    put_word(shared, COUNT, k)
    put_word(shared, PROCESSOR, processor(word(parameters, WHERE)))
    put_word(shared, PHASE, ASKED)
    put_word(shared, COMMAND, command)
    socket = word(parameters, SOCKET)
    answered = 0
    if transfer(word(parameters, SEND), socket, shared + 8 * COMMAND, MESSAGE, NO_SIGNAL) == MESSAGE:
        answered = transfer(word(parameters, RECEIVE), socket, shared + 8 * ANSWER, MESSAGE, 0)
    if answered != MESSAGE or word(shared, LOGGED) != 0 or word(shared, PHASE) != IDLE:
        put_word(shared, RESULT, INTERRUPTED)  # stays if Ctrl-C comes before the callback sets a result
        call_block(word(parameters, ATTEND), 0, 0, 0, answered, t, k)
        return word(shared, RESULT)
    return word(shared, STATUS)


def output(state, parameters, inputs, outputs, t, k):
    """Copy the outputs that came with the previous step; if none did, request them."""
    shared = word(parameters, SHARED)
    if word(shared, AHEAD) != 0:
        status = word(shared, READ_STATUS)
    else:
        status = _exchange(READ, parameters, inputs, t, k)
    begin = HEADER + word(parameters, INPUT_COUNT)
    for i in range(word(parameters, OUTPUT_COUNT)):
        put_number(outputs, i, number(shared, begin + i))
    return status


def update(state, parameters, inputs, outputs, t, k):
    """Request a step."""
    return _exchange(STEP, parameters, inputs, t, k)


def serve(state, parameters, inputs, outputs, t, k):
    """Answer reads and steps of the host; return any other command, or why there is none."""
    shared, socket, table = word(parameters, SHARED), word(parameters, SOCKET), word(parameters, TABLE)
    send, receive = word(parameters, SEND), word(parameters, RECEIVE)
    make_step, compute, ahead = word(parameters, UPDATE), word(parameters, OUTPUT), word(parameters, READS_AHEAD)
    numerator, denominator = word(parameters, NUMERATOR), word(parameters, DENOMINATOR)
    usual_size, step_word = numerator / denominator, word(parameters, STEP_WORD)
    where, follows = word(parameters, WHERE), word(parameters, FOLLOWS)
    u = shared + 8 * HEADER
    y = u + 8 * word(parameters, INPUT_COUNT)
    for _ in range(PAUSE):
        received = transfer(receive, socket, shared + 8 * COMMAND, MESSAGE, 0)
        if received != MESSAGE:
            return GONE if received == 0 else SIGNALLED
        command = word(shared, COMMAND)
        instant, count = number(shared, TIME), word(shared, COUNT)
        if command == READ:
            put_word(shared, PHASE, READING)
            status = call_block(compute, 0, table, u, y, instant, count)
        elif command == STEP:
            put_word(shared, AHEAD, 0)
            put_word(shared, PHASE, STEPPING)
            size = number(shared, SIZE)
            if step_word != 0:
                put_number(table, step_word, size)
            status = call_block(make_step, 0, table, u, y, instant, count)
            if status == 0 and ahead != 0:
                put_word(shared, PHASE, READING)
                if size == usual_size and instant == count * numerator / denominator:
                    instant = (count + 1) * numerator / denominator  # the engine's next instant, to the last bit
                else:
                    instant = instant + size
                put_word(shared, READ_STATUS, call_block(compute, 0, table, u, y, instant, count + 1))
                put_word(shared, AHEAD, 1)
        else:
            return command
        put_word(shared, STATUS, status)
        put_word(shared, PHASE, IDLE)
        if transfer(send, socket, shared + 8 * STATUS, MESSAGE, NO_SIGNAL) != MESSAGE:
            return GONE
        if follows != 0 and word(shared, PROCESSOR) != processor(where):
            return ELSEWHERE
    return PAUSED
