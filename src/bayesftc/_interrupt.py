"""Ctrl-C that comes through.

Python raises it at its next line, wherever that is: in a callback of the compiler, in a ``__del__``, where a weak reference ends,
in a comparison that C code asks for. What is raised there is lost, and the program would go on; while numba compiles that is one
Ctrl-C in four. Here an interrupt that is lost comes again a moment later, until it is raised where it is heard; and while what
was begun is put away, another Ctrl-C does not disturb. Loads nothing that is not there already.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

EXIT_CODE = 130
SENTENCE = "Stopped by Ctrl-C before the end; no half-finished file was left behind."
PAUSE = 0.02
"""Seconds after which an interrupt that was lost comes again."""


class Interrupted(BaseException):
    """Ctrl-C. No `KeyboardInterrupt`, to which some libraries have their own answers.

    CPython, too: where one has passed through an `exec`, the process dies of the signal whatever exit code was asked for.
    """


class _Interrupts:
    """What is known of the interrupts since the program began."""

    def __init__(self, ignored: Callable[[Any], object]):
        self.asked = False
        self._raised = False
        self._ignored = ignored

    def handle(self, *_: object) -> None:
        """Answer the signal."""
        self.asked = True
        if not self._raised:
            self._raised = True
            _thread.start_new_thread(self._watch, ())  # not threading's, whose locks may be held at this moment
            raise Interrupted

    def ignored(self, lost: Any) -> None:
        """Answer an exception that Python ignores (`sys.unraisablehook`); after a Ctrl-C it comes of that."""
        if not self.asked:
            self._ignored(lost)

    def _watch(self) -> None:
        """Send the signal again if what was raised is lost."""
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
    """Return whether the main thread is on its way out: in what an interrupt makes it do (``finally``, ``with``, ``except``)."""
    found: Any = sys._current_exceptions().get(threading.main_thread().ident or 0)
    error = found[1] if isinstance(found, tuple) else found  # from Python 3.12 on the exception alone
    while error is not None:
        if isinstance(error, Interrupted):
            return True
        error = error.__context__
    return False


def asked() -> bool:
    """Return whether there was a Ctrl-C inside `heard`: then an error may be no more than what came of it."""
    answer = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
    return isinstance(answer, _Interrupts) and answer.asked


def ended() -> None:
    """Hear no Ctrl-C any more: all is done, and Python, while it clears away, would die of the signal."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def heard() -> Iterator[None]:
    """Raise `Interrupted` at Ctrl-C, at the latest at the end of what is done inside; later ones are ignored then.

    Where Ctrl-C is not Python's own affair (it is ignored in a job in the background, and comes to the main thread only), nothing
    is changed.
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
        if interrupts.asked:  # the program ends, and what was half made is put away until then
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        else:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = before
