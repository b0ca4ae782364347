"""The protocol of an isolated FMU's process and its host: the words of their shared memory, commands, and statuses.

Both share one block of memory: `WORDS` 64-bit words, then the inputs, then the outputs. A command is the first word of that
memory, sent over a message socket; the answer is a message of the same size. Numbers are exchanged in the shared memory only; the
messages order the access to it. All else (instantiation, saved states, explanations, the FMU's log) uses a second connection, as
Python objects.
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

# Commands: compute the outputs; make a step; read the other connection.
READ, STEP, TALK = 1, 2, 3
MESSAGE = 8
"""Bytes of a message."""

# Phases: what the FMU is doing. They tell the host where the FMU crashed, and whether an answer is valid.
IDLE, STEPPING, READING, STARTING, ASKED = range(5)

GONE, SIGNALLED, PAUSED, ELSEWHERE = 0, -1, -2, -3
"""Why the worker's compiled loop returns without a command: the host has ended; a signal came; `PAUSE` commands were done; the
host runs on another processor."""

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
