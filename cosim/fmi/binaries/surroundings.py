"""Settings of this process that an FMU may change, and that are restored.

A library that was built with ``-ffast-math`` makes the whole thread replace numbers below 2.2e-308 by zero once it is loaded.
Others change the direction of rounding, or make arithmetic exceptions end the process. The runtimes of some languages replace
the handler of Ctrl-C; some tools change the working directory. This would affect the numbers of other blocks, the interruption
of runs, and the meaning of relative paths.
"""

from __future__ import annotations

import ctypes
import os
import signal
import threading
from contextlib import suppress
from functools import cache
from typing import Any, Self

import numpy as np

# Words for the compiled functions in `surroundings_kernels`: addresses of functions of the C library, 0 for one that it lacks.
FEGETENV, FESETENV, GETCWD, STRCMP, SIGACTION = range(5)

USUAL, SIGINT, HANDLER, CHANGED = range(5, 9)
"""USUAL: whether arithmetic is as usual. SIGINT: the number of the signal. HANDLER: the first word of the signal's action while
Python handles it. CHANGED: what has changed."""

ONE, SMALL, LEAST, TINY = range(9, 13)
"""Numbers that show how arithmetic rounds. They are read from memory, because LLVM computes with constants as usual."""

_ROOM = 64
"""Words for the C library's ``fenv_t`` or ``struct sigaction``, which are smaller everywhere."""

PATH = 4096
"""Bytes for a path. A longer working directory is not restored."""

ENVIRONMENT = 16
ACTION = ENVIRONMENT + _ROOM
BEFORE = ACTION + _ROOM
AFTER = BEFORE + PATH // 8
WORDS = AFTER + PATH // 8
"""Places of the arithmetic, of the signal's action and of the working directory before and after, and the number of words."""

ARITHMETIC, FOLDER, INTERRUPTS = 1, 2, 4
"""What has changed, or may have where the C library lacks a function; CHANGED is the sum."""

_SIGINT = int(signal.SIGINT)

_NUMBERS = (1.0, 1e-20, 2.0**-1022, 2.0**-1074)

_FUNCTION = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
"""The first argument of the engine's signature. The GIL is kept, which is faster."""


class Surroundings:
    """Restore this thread's arithmetic, the handler of Ctrl-C and the working directory at the end of a ``with``.

    The object can be used repeatedly, but not nested. The working directory is not restored if other threads run, as they may
    have changed it on purpose. These calls surround every step of a live run, so their time matters.

    Attributes
    ----------
    changed : bool
        Whether the arithmetic was restored at the last end.
    inside : int
        The address with which compiled code itself calls `surroundings_kernels.noted` and `restored`; then call `settle`. It is 0
        where the C library has no function for the working directory; then use the ``with``.
    """

    def __init__(self) -> None:
        self.changed = False
        self._words = np.zeros(WORDS, dtype=np.int64)
        self._words[FEGETENV : SIGACTION + 1] = _C.addresses()
        self._words[SIGINT], self._words[HANDLER] = _SIGINT, _C.pythons_handler
        self._words[ONE : TINY + 1].view(np.float64)[:] = _NUMBERS
        self._view = memoryview(self._words)  # type: ignore[arg-type]
        self._place = ctypes.c_void_p(self._words.ctypes.data)
        self.inside: int = 0 if _C.getcwd is None else self._words.ctypes.data
        self._folder: str | None = None
        self._note, self._restore = _compiled("note"), _compiled("restore")

    def __enter__(self) -> Self:
        if _C.getcwd is None:
            self._folder = _folder()
        self._note(self._place)
        return self

    def __exit__(self, *error: object) -> None:
        self._restore(self._place)
        self.settle()

    def settle(self) -> None:
        """Do what compiled code leaves to Python, after it has called `surroundings_kernels.restored`."""
        changed = self._view[CHANGED]
        self._view[CHANGED] = 0  # after Ctrl-C before the compiled code, this would be that of the piece before
        self.changed = changed & ARITHMETIC != 0
        if changed & FOLDER:
            self._go_back()
        if changed & INTERRUPTS:
            self._give_back_interrupts()

    def _go_back(self) -> None:
        """Return to the working directory, if that is known and no other thread can have changed it."""
        folder = self._folder
        if _C.getcwd is not None:
            folder = os.fsdecode(self._words[BEFORE:AFTER].tobytes().partition(b"\0")[0])
        if folder and folder != _folder() and threading.active_count() == 1:
            with suppress(OSError):  # it was deleted meanwhile
                os.chdir(folder)

    def _give_back_interrupts(self) -> None:
        """Set the system's handler of SIGINT to Python's, unless it certainly is."""
        if threading.current_thread() is not threading.main_thread():
            return
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
            if _C.sigaction is not None and callable(handler):
                _C.sigaction(_SIGINT, None, self._words[ACTION:].ctypes.data)
                self._words[HANDLER] = _C.pythons_handler = self._words[ACTION]


def _folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return None


@cache
def _compiled(name: str) -> Any:
    """Return one of the compiled functions."""
    from bayesftc.cosim.stepping.machine.services import service_address

    def find() -> Any:
        from bayesftc.cosim.fmi.binaries import surroundings_kernels

        return surroundings_kernels.FUNCTIONS[name]

    return _FUNCTION(service_address(f"surroundings_{name}", find))


class _Functions:
    """Functions of the C library; None where it has none of that name, as on Windows."""

    def __init__(self) -> None:
        self.pythons_handler = 0  # the first word that sigaction gives once Python has set its handler of SIGINT
        pointer = ctypes.c_void_p
        self.fegetenv = self._function("fegetenv", pointer)
        self.fesetenv = self._function("fesetenv", pointer)
        self.getcwd = self._function("getcwd", pointer, ctypes.c_size_t)
        self.strcmp = self._function("strcmp", pointer, pointer)
        self.sigaction = self._function("sigaction", ctypes.c_int, pointer, pointer)
        if self.fegetenv is None:
            self.fesetenv = None
        if self.strcmp is None:
            self.getcwd = None

    def addresses(self) -> list[int]:
        """Return the address of each function, 0 for none, in the order of the words."""
        functions = self.fegetenv, self.fesetenv, self.getcwd, self.strcmp, self.sigaction
        return [0 if f is None else ctypes.cast(f, ctypes.c_void_p).value or 0 for f in functions]

    @staticmethod
    def _function(name: str, *arguments: Any) -> Any:
        with suppress(OSError, TypeError, AttributeError):
            function = ctypes.PyDLL(None)[name]  # a new object, which nobody else changes
            function.argtypes = arguments
            return function
        return None


_C = _Functions()
