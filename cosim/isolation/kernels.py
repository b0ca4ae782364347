"""Both ends of the connection to an isolated FMU, compiled: a step takes one round trip through shared memory, or over a socket.

The host's functions have the engine's signature; the words named below are at the address ``parameters``. The worker's function,
`serve`, answers steps until another command comes.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated"

import platform

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from bayesftc.cosim.fmi.running.kernels import number, place, put_number, put_word, word
from bayesftc.cosim.isolation import protocol
from bayesftc.cosim.stepping.by_address import call_block
from bayesftc.cosim.stepping.numba_called import inlined

# Words of the host's table.
SEND, RECEIVE, WHERE, SOCKET, SHARED, INPUT_COUNT, OUTPUT_COUNT, ATTEND, STEP_SIZE = range(9)

# Words of the worker's table; the first six are the same.
UPDATE, OUTPUT, TABLE, READS_AHEAD, NUMERATOR, DENOMINATOR, STEP_WORD, HOME = range(6, 14)

COMMAND, TIME, SIZE, COUNT, PROCESSOR, ASKED = (
    protocol.COMMAND,
    protocol.TIME,
    protocol.SIZE,
    protocol.COUNT,
    protocol.PROCESSOR,
    protocol.ASKED,
)
STATUS, READ_STATUS, AHEAD, PHASE, DONE, HEARD = (
    protocol.STATUS,
    protocol.READ_STATUS,
    protocol.AHEAD,
    protocol.PHASE,
    protocol.DONE,
    protocol.HEARD,
)
HOST, WORKER, SLEPT, LOOKS = protocol.HOST, protocol.WORKER, protocol.SLEPT, protocol.LOOKS
LOGGED, RESULT, ANSWER = protocol.LOGGED, protocol.RESULT, protocol.ANSWER
ASLEEP, AWAKE, WOKEN = protocol.ASLEEP, protocol.AWAKE, protocol.WOKEN
HEADER, MESSAGE = protocol.WORDS, protocol.MESSAGE
READ, STEP, TALK = protocol.READ, protocol.STEP, protocol.TALK
IDLE, STEPPING, READING, WANTED = protocol.IDLE, protocol.STEPPING, protocol.READING, protocol.WANTED
INTERRUPTED = protocol.INTERRUPTED
GONE, SIGNALLED, PAUSED, ELSEWHERE = protocol.GONE, protocol.SIGNALLED, protocol.PAUSED, protocol.ELSEWHERE
ANYWHERE, TOGETHER, PAUSE = protocol.ANYWHERE, protocol.TOGETHER, protocol.PAUSE
MOST_LOOKS = protocol.MOST_LOOKS
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


@intrinsic
def look(typingctx, address, index):
    """Load a word that the other process writes; nothing after it is loaded before it."""

    def codegen(context, builder, signature, args):
        return builder.load_atomic(place(builder, args, _I64), "seq_cst", 8)

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def show(typingctx, address, index, value):
    """Store a word that the other process looks at, after all that was stored before."""

    def codegen(context, builder, signature, args):
        builder.store_atomic(args[2], place(builder, args, _I64), "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


@intrinsic
def swap(typingctx, address, index, old, new):
    """Store `new` if the word is still `old`; return whether it was."""

    def codegen(context, builder, signature, args):
        pair = builder.cmpxchg(place(builder, args, _I64), args[2], args[3], "seq_cst", "seq_cst")
        return builder.extract_value(pair, 1)

    return types.boolean(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def rest(typingctx):
    """Tell the processor that this is a waiting loop, so that its other thread goes on."""

    def codegen(context, builder, signature, args):
        name = {"x86_64": "llvm.x86.sse2.pause", "AMD64": "llvm.x86.sse2.pause"}.get(platform.machine())
        if name is not None:
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [])
        return context.get_dummy_value()

    return types.void(), codegen


@inlined
def _await(shared, mine, theirs, count, receive, socket, answer):
    """Wait until the word `theirs` has this count, or the worker hears TALK; return what `recv` did, MESSAGE without it.

    `mine` is HOST or WORKER: what this process does. A message is received into the word `answer`.
    """
    while True:
        if look(shared, mine) == AWAKE or swap(shared, mine, ASLEEP, AWAKE):  # else a message is on its way
            for _ in range(min(word(shared, LOOKS), MOST_LOOKS)):  # a faulty FMU may write any number there
                if look(shared, theirs) == count:
                    return MESSAGE
                rest()
            show(shared, mine, ASLEEP)
            # The other may have stored its count before it could see that this process sleeps.
            if look(shared, theirs) == count and swap(shared, mine, ASLEEP, AWAKE):
                return MESSAGE
        put_word(shared, mine + SLEPT, word(shared, mine + SLEPT) + 1)
        received = transfer(receive, socket, shared + 8 * answer, MESSAGE, 0)
        if received != MESSAGE:
            return received
        show(shared, mine, AWAKE)
        if look(shared, theirs) == count or (mine == WORKER and word(shared, answer) == TALK):
            return MESSAGE  # else it was sent for an earlier count


@inlined
def _tell(shared, theirs, count, yours, send, socket):
    """Store a count that the other process waits for, and wake it if it sleeps; return whether that was possible."""
    show(shared, theirs, count)
    if look(shared, yours) == ASLEEP and swap(shared, yours, ASLEEP, WOKEN):
        return transfer(send, socket, shared + 8 * COMMAND, MESSAGE, NO_SIGNAL) == MESSAGE
    return True


@inlined
def _exchange(command, parameters, inputs, t, k):
    shared, socket = word(parameters, SHARED), word(parameters, SOCKET)
    for i in range(word(parameters, INPUT_COUNT)):
        put_number(shared, HEADER + i, number(inputs, i))
    put_number(shared, TIME, t)
    put_number(shared, SIZE, number(parameters, STEP_SIZE))
    put_word(shared, COUNT, k)
    put_word(shared, PROCESSOR, processor(word(parameters, WHERE)))
    put_word(shared, PHASE, WANTED)
    put_word(shared, COMMAND, command)
    put_word(shared, HOST, AWAKE)
    count = word(shared, ASKED) + 1
    answered = 0
    if _tell(shared, ASKED, count, WORKER, word(parameters, SEND), socket):
        answered = _await(shared, HOST, DONE, count, word(parameters, RECEIVE), socket, ANSWER)
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
    where, home = word(parameters, WHERE), word(parameters, HOME)
    u = shared + 8 * HEADER
    y = u + 8 * word(parameters, INPUT_COUNT)
    for _ in range(PAUSE):
        done = word(shared, DONE)
        received = _await(shared, WORKER, ASKED, done + 1, receive, socket, HEARD)
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
        if not _tell(shared, DONE, done + 1, HOST, send, socket):
            return GONE
        if home != ANYWHERE and (word(shared, PROCESSOR) == processor(where)) != (home == TOGETHER):
            return ELSEWHERE
    return PAUSED
