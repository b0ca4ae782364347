"""What an FMU in this process has to leave as it was, and is put back where it does not.

A library that was built with ``-ffast-math`` sets numbers below 2.2e-308 to zero for the whole thread once it is loaded; others
change the direction of rounding or have arithmetic exceptions end the process; the runtime of some languages takes Ctrl-C for
itself; tools go to another folder. Each would change what is none of the FMU's business: the numbers of other blocks, the way to
stop a run, the files that relative paths name.
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
    """Put back this thread's arithmetic, Ctrl-C and the working directory at the end.

    What is yielded holds a single True then, if the arithmetic had to be put back. The working directory is left alone where
    other threads run: they may be on their way through another one.
    """
    here, usual = _folder(), computes_as_usual()
    functions, before, changed = _functions(), ctypes.create_string_buffer(_ROOM), list[bool]()
    if functions is not None:
        functions[0](before)
    try:
        yield changed
    finally:
        if usual and not computes_as_usual():
            changed.append(True)
        if functions is not None:
            functions[1](before)
        if here is not None and here != _folder():
            with suppress(OSError):  # it is gone meanwhile
                os.chdir(here)
        _hear_ctrl_c()


def computes_as_usual() -> bool:
    """Return whether this thread rounds to the nearest number and knows numbers below 2.2e-308."""
    nearest = _ONE + _SMALL == _ONE == _ONE - _SMALL
    return nearest and _LEAST * 0.5 != 0.0 and _TINY * _ONE != 0.0


def _folder() -> str | None:
    with suppress(OSError):  # of one that was deleted
        return os.getcwd() if threading.active_count() == 1 else None
    return None


def _hear_ctrl_c() -> None:
    """Make the handler of SIGINT that Python knows the one that the system knows."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)


@cache
def _functions() -> tuple[Any, Any] | None:
    """Return the C library's ``fegetenv`` and ``fesetenv``, where it can be asked for them."""
    with suppress(OSError, TypeError, AttributeError):  # Windows has no library of that name
        library = ctypes.CDLL(None)
        return library.fegetenv, library.fesetenv
    return None
