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
from typing import Any, Self

_ROOM = 512
"""Bytes for the C library's ``fenv_t`` and ``struct sigaction``, which are smaller everywhere."""

_SIGINT = int(signal.SIGINT)

_ONE, _SMALL, _LEAST, _TINY = 1.0, 1e-20, 2.0**-1022, 2.0**-1074


class Surroundings:
    """Restore this thread's arithmetic, the handler of Ctrl-C and the working directory at the end of a ``with``.

    The object can be used repeatedly, but not nested. The working directory is not restored if other threads run, as they may
    have changed it on purpose. A step of a live run is in between, so that each call here counts.

    Attributes
    ----------
    changed : bool
        Whether the arithmetic was restored at the last end.
    """

    def __init__(self) -> None:
        self.changed = False
        self._folder: str | None = None
        self._arithmetic, self._handler = ctypes.create_string_buffer(_ROOM), (ctypes.c_uint64 * (_ROOM // 8))()
        self._place, self._place_of_handler = ctypes.addressof(self._arithmetic), ctypes.addressof(self._handler)

    def __enter__(self) -> Self:
        self._folder = _folder()
        if _C.fegetenv is not None:
            _C.fegetenv(self._place)
        return self

    def __exit__(self, *error: object) -> None:
        usual = computes_as_usual()
        if _C.fesetenv is not None:
            _C.fesetenv(self._place)
        self.changed = not usual and computes_as_usual()
        if self._folder != _folder() and self._folder is not None and threading.active_count() == 1:
            with suppress(OSError):  # it was deleted meanwhile
                os.chdir(self._folder)
        self._give_back_interrupts()

    def _give_back_interrupts(self) -> None:
        """Set the system's handler of SIGINT to Python's, unless it certainly is."""
        action = _C.sigaction
        if action is not None:
            action(_SIGINT, None, self._place_of_handler)
            if self._handler[0] == _C.pythons_handler:
                return
        if threading.current_thread() is not threading.main_thread():
            return
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
            if action is not None and callable(handler):
                action(_SIGINT, None, self._place_of_handler)
                _C.pythons_handler = self._handler[0]


def computes_as_usual() -> bool:
    """Return whether this thread rounds to the nearest number and supports numbers below 2.2e-308."""
    nearest = _ONE + _SMALL == _ONE == _ONE - _SMALL
    return nearest and _LEAST * 0.5 != 0.0 and _TINY * _ONE != 0.0


def _folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return None


class _Functions:
    """Functions of the C library; None where it has none of that name, as on Windows."""

    def __init__(self) -> None:
        self.pythons_handler = 0  # the first word that sigaction gives once Python has set its handler of SIGINT
        pointer = ctypes.c_void_p
        self.fegetenv = self._function("fegetenv", pointer)
        self.fesetenv = self._function("fesetenv", pointer)
        self.sigaction = self._function("sigaction", ctypes.c_int, pointer, pointer)

    @staticmethod
    def _function(name: str, *arguments: Any) -> Any:
        with suppress(OSError, TypeError, AttributeError):
            function = ctypes.PyDLL(None)[
                name
            ]  # a new object, which nobody else changes; it keeps the GIL, which is faster
            function.argtypes = arguments
            return function
        return None


_C = _Functions()
