"""Reliable Ctrl-C.

Python raises it at the next line of code: also in a callback of the compiler, in a ``__del__``, at the end of a weak reference,
or in a comparison that C code calls. An exception there is lost, and the program continues; during numba's compilation this
happens to one Ctrl-C in four. Here a lost interrupt is raised again a moment later, until it is handled. A further Ctrl-C during
the clean-up has no effect. This module imports nothing that is not loaded already.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

EXIT_CODE = 130
SENTENCE = "Stopped by Ctrl-C before the end; no half-finished file was left behind."
PAUSE = 0.02
"""Seconds after which a lost interrupt is raised again."""


class Interrupted(BaseException):
    """Ctrl-C. Its message is printed at the end, if it has one.

    It is no `KeyboardInterrupt`, which some libraries handle themselves.

    CPython does, too: after one has passed through an `exec`, the signal ends the process, whatever the requested exit code.
    """


class _Interrupts:
    """The interrupts since the start of the program."""

    def __init__(self, ignored: Callable[[Any], object]):
        self.asked = False
        self._raised = False
        self._ignored = ignored

    def handle(self, *_: object) -> None:
        """Handle the signal."""
        self.asked = True
        if not self._raised:
            self._raised = True
            _thread.start_new_thread(self._watch, ())  # not from threading, whose locks may be held at this moment
            raise Interrupted

    def ignored(self, lost: Any) -> None:
        """Handle an exception that Python ignores (`sys.unraisablehook`); after a Ctrl-C it is a consequence of that."""
        if not self.asked:
            self._ignored(lost)

    def _watch(self) -> None:
        """Send the signal again if the exception is lost."""
        time.sleep(PAUSE)
        while signal.getsignal(signal.SIGINT) == self.handle:
            if not _is_handled():
                self._raised = False
                if hasattr(signal, "pthread_kill"):
                    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # ends a wait as well
                else:
                    _thread.interrupt_main()
                return
            time.sleep(PAUSE)


def _is_handled() -> bool:
    """Return whether the main thread handles an interrupt (in ``finally``, ``with`` or ``except``)."""
    current: Any = sys._current_exceptions().get(threading.main_thread().ident or 0)
    error = current[1] if isinstance(current, tuple) else current  # from Python 3.12 on only the exception
    while error is not None:
        if isinstance(error, Interrupted):
            return True
        error = error.__context__
    return False


def asked() -> bool:
    """Return whether there was a Ctrl-C inside `heard`: then an error may be a consequence of it."""
    handler = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
    return isinstance(handler, _Interrupts) and handler.asked


def ended() -> None:
    """Ignore Ctrl-C from now on: all is done, and the signal would end Python during its clean-up."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def heard() -> Iterator[None]:
    """Raise `Interrupted` at Ctrl-C, at the latest at the end of the block; later ones are then ignored.

    Nothing changes if Python does not handle Ctrl-C itself, as in a background job, or outside of the main thread.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    before = sys.unraisablehook
    interrupts = _Interrupts(before)
    sys.unraisablehook = interrupts.ignored
    signal.signal(signal.SIGINT, interrupts.handle)
    try:
        yield
    except Interrupted:
        raise
    except BaseException:
        if interrupts.asked:
            raise Interrupted from None
        raise
    else:
        if interrupts.asked:
            raise Interrupted
    finally:
        if interrupts.asked:  # the program ends, and cleans up until then
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        else:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = before


@contextmanager
def held_back() -> Iterator[None]:
    """Delay Ctrl-C until the end of the body, and raise it there."""
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: received.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if received:
            handler(*received[0])


def import_whole(*modules: str) -> None:
    """Import modules; Ctrl-C is raised when they are complete.

    If it interrupted an import, a library would remain half imported, and all later runs of the process would fail.
    """
    with held_back():
        for module in modules:
            __import__(module)
