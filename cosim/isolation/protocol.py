"""What an isolated FMU's process and its host agree on: the words of their shared memory, commands, and statuses.

The two share one block of memory: `WORDS` 64-bit words, then the inputs, then the outputs. A command is the first word of that
memory, sent over a socket of whole messages; the answer is a message of the same size. Numbers never travel through the socket:
they stand in the shared memory, which the messages put in order. All else (making the instance, saved states, explanations, the
FMU's log) goes over a second connection, as Python objects.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Words of the shared memory.
COMMAND, ANSWER, STATUS, RESULT, AHEAD, READ_STATUS, LOGGED, PHASE, TIME, SIZE, COUNT, PROCESSOR = range(12)
WORDS = 12

# Commands: compute the outputs; make a step; look at the other connection.
READ, STEP, TALK = 1, 2, 3
MESSAGE = 8
"""Bytes of a message."""

# Phases: what the FMU is doing, for the host to know where it died, and that an answer is one.
IDLE, STEPPING, READING, STARTING, ASKED = range(5)

GONE, SIGNALLED, PAUSED, ELSEWHERE = 0, -1, -2, -3
"""Why the worker's compiled loop returns, if not for a command: the host has gone; a signal came; `PAUSE` commands were done; the
host runs on another processor."""

PAUSE = 1000

CRASHED, INTERRUPTED = 901, 902
"""Statuses of a step beside those of an FMU in process, which stay below 900: its process has ended; a signal came while it was
awaited."""

LOST = 71
"""Exit code of a process that finds its connections to the host closed: the host has gone, or the FMU has closed them."""

ATTENTION = 0.05
"""Seconds that the host waits for an answer before it looks whether all is well."""


_FIXED = 0x10
"""MAP_FIXED of Linux: the new memory takes the place of what is there."""


class Shared:
    """The shared memory of one isolated FMU, seen as arrays.

    Parameters
    ----------
    descriptor : int
        Of a file in memory, which is gone with the last process that holds it.
    inputs, outputs : int
        How many numbers.
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
        """Leave processes that this one forks without it, so that one which goes on as if it were this one comes to an end."""
        if self._keep is not None:
            self._map.madvise(self._keep)

    def part(self) -> None:
        """Put memory of this process alone in its place, at the same address and all zero."""
        import mmap

        place, length = self.words.ctypes.data, len(self._map)
        protection, flags = mmap.PROT_READ | mmap.PROT_WRITE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _FIXED
        if _map_function()(place, length, protection, flags, -1, 0) != place:
            raise OSError("no memory to part from another process with")


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
