"""The protocol of an isolated FMU's process and its host: the words of their shared memory, commands, and statuses.

Both share one block of memory: `WORDS` 64-bit words, then the inputs, then the outputs. Steps and reads are asked for by a count
in that memory, ASKED, and answered by another, DONE. Whoever waits watches the count of the other for a short while, and then
sleeps until a message comes over a socket. HOST and WORKER say which of both each does, so that a message is sent only to
who sleeps. It may come late: on a busy machine a process can be stopped between seeing that the other sleeps and waking it, while
the other sees the count by itself, and sleeps again. So whoever is woken looks at the count, and sleeps on if it is not there.

All else (instantiation, saved states, explanations, the FMU's log) uses a second connection, as Python objects, each announced
by a message.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Words of the shared memory. Those that the host writes at each step, those that the worker writes, and those that change rarely
# are apart by 64 bytes: processors exchange so many at once.
COMMAND, TIME, SIZE, COUNT, PROCESSOR, ASKED = range(6)
STATUS, READ_STATUS, AHEAD, PHASE, DONE, HEARD = range(8, 14)
HOST, WORKER, HOST_SLEPT, WORKER_SLEPT, LOOKS, LOGGED, RESULT, ANSWER = range(16, 24)
WORDS = 24
SLEPT = HOST_SLEPT - HOST
"""From the word HOST or WORKER to the one that counts how often it slept."""

# What host and worker do, in HOST and WORKER.
ASLEEP, AWAKE, WOKEN = range(3)
"""Waiting for a message; looking at the memory; a message is on its way."""

# Commands: compute the outputs; make a step; read the other connection.
READ, STEP, TALK = 1, 2, 3
MESSAGE = 8
"""Bytes of a message."""

# Phases: what the FMU is doing. They tell the host where the FMU crashed, and whether an answer is valid.
IDLE, STEPPING, READING, STARTING, WANTED = range(5)

GONE, SIGNALLED, PAUSED, ELSEWHERE = 0, -1, -2, -3
"""Why the worker's compiled loop returns without a command: the host has ended; a signal came; `PAUSE` commands were done; the
worker is on the host's processor and should not be, or the other way round."""

ANYWHERE, TOGETHER, APART = range(3)
"""Where the worker runs: on any processor; on the host's; on any but the host's."""

MOST_LOOKS = 1000
"""How often host and FMU look at the shared memory before they sleep: for some 20 us, about as long as waking takes."""

PAUSE = 1000

CRASHED, INTERRUPTED = 901, 902
"""Further statuses of a step (those of FMUs in process are below 900): the FMU's process has ended; a signal interrupted the
wait."""

LOST = 71
"""Exit code of a process whose connections to the host are closed: the host has ended, or the FMU has closed them."""

ATTENTION = 0.05
"""Seconds that the host waits for an answer before it checks the process."""


_FIXED = 0x10
"""MAP_FIXED of Linux: the new memory replaces what is at the address."""


class Shared:
    """The shared memory of one isolated FMU, seen as arrays.

    Parameters
    ----------
    descriptor : int
        Descriptor of a file in memory, which is freed with the last process that uses it.
    inputs, outputs : int
        Numbers of inputs and outputs.
    """

    def __init__(self, descriptor: int, inputs: int, outputs: int):
        import mmap

        self._map = mmap.mmap(descriptor, size(inputs, outputs))
        self._keep = getattr(mmap, "MADV_DONTFORK", None)
        self.words: NDArray[np.int64] = np.frombuffer(self._map, dtype=np.int64, count=WORDS)
        numbers = np.frombuffer(self._map, dtype=np.float64)
        self.time, self.size = numbers[TIME : TIME + 1], numbers[SIZE : SIZE + 1]
        self.inputs = numbers[WORDS : WORDS + inputs]
        self.outputs = numbers[WORDS + inputs : WORDS + inputs + outputs]

    def keep_from_children(self) -> None:
        """Do not pass it to forked processes, so that a fork which continues as this process ends."""
        if self._keep is not None:
            self._map.madvise(self._keep)

    def part(self) -> None:
        """Replace it by private memory, at the same address and all zero."""
        import mmap

        place, length = self.words.ctypes.data, len(self._map)
        protection, flags = mmap.PROT_READ | mmap.PROT_WRITE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _FIXED
        if _map_function()(place, length, protection, flags, -1, 0) != place:
            raise OSError("the memory shared with another process cannot be replaced")


def size(inputs: int, outputs: int) -> int:
    """Return the size of the shared memory in bytes."""
    return 8 * (WORDS + inputs + outputs)


@cache
def _map_function() -> Any:
    function = ctypes.CDLL(None).mmap
    function.restype = ctypes.c_size_t
    function.argtypes = [ctypes.c_size_t, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    return function


@cache
def system_functions() -> tuple[int, ...]:
    """Return the addresses of the C library's ``send``, ``recv`` and ``sched_getcpu``."""
    library = ctypes.CDLL(None)
    functions = (getattr(library, name) for name in ("send", "recv", "sched_getcpu"))
    return tuple(ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions)
