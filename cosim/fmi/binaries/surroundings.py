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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

_ROOM = 512
"""Bytes for the C library's ``fenv_t``, which is smaller everywhere."""

_ONE, _SMALL, _LEAST, _TINY = 1.0, 1e-20, 2.0**-1022, 2.0**-1074


@contextmanager
def kept() -> Iterator[list[bool]]:
    """Restore this thread's arithmetic, the handler of Ctrl-C and the working directory at the end.

    The yielded list contains True in the end if the arithmetic was restored. The working directory is not restored if other
    threads run, as they may have changed it on purpose.
    """
    folder, usual_before = _folder(), computes_as_usual()
    functions, before, changed = _functions(), ctypes.create_string_buffer(_ROOM), list[bool]()
    if functions is not None:
        functions[0](before)
    try:
        yield changed
    finally:
        if usual_before and not computes_as_usual():
            changed.append(True)
        if functions is not None:
            functions[1](before)
        if folder is not None and folder != _folder():
            with suppress(OSError):  # it was deleted meanwhile
                os.chdir(folder)
        _restore_interrupt_handler()


def computes_as_usual() -> bool:
    """Return whether this thread rounds to the nearest number and supports numbers below 2.2e-308."""
    nearest = _ONE + _SMALL == _ONE == _ONE - _SMALL
    return nearest and _LEAST * 0.5 != 0.0 and _TINY * _ONE != 0.0


def _folder() -> str | None:
    with suppress(OSError):  # it was deleted
        return os.getcwd() if threading.active_count() == 1 else None
    return None


def _restore_interrupt_handler() -> None:
    """Set the system's handler of SIGINT to Python's."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)


@cache
def _functions() -> tuple[Any, Any] | None:
    """Return the C library's ``fegetenv`` and ``fesetenv``, or None if they are not available."""
    with suppress(OSError, TypeError, AttributeError):  # Windows has no library of that name
        library = ctypes.CDLL(None)
        return library.fegetenv, library.fesetenv
    return None
