"""Ctrl-C that comes through.

Python raises it at its next line, wherever that is: in a callback of the compiler, in a ``__del__`` or where a weak reference
ends. What is raised there is ignored, and the program would go on; while numba compiles that is one Ctrl-C in four. Here
an interrupt that is lost in this way comes again a moment later, until it is raised where it is heard. Once it has been, another
Ctrl-C does not disturb for a while what puts files away. Loads nothing that is not there already.
"""

from __future__ import annotations

import _thread
import math
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
"""Seconds after which a lost interrupt comes again."""
GRACE = 2.0
"""Seconds for which one that was raised is not raised again."""


class Interrupted(BaseException):
    """Ctrl-C. No `KeyboardInterrupt`, to which some libraries have their own answers.

    CPython, too: where one has passed through an `exec`, the process dies of the signal whatever exit code was asked for.
    """


class _Interrupts:
    """What is known of the interrupts since the program began."""

    def __init__(self, ignored: Callable[[Any], object]):
        self.asked = False
        self._raised = -math.inf
        self._ignored = ignored

    def handle(self, *_: object) -> None:
        """Answer the signal."""
        self.asked = True
        if time.monotonic() - self._raised > GRACE:
            self._raised = time.monotonic()
            raise Interrupted

    def ignored(self, lost: Any) -> None:
        """Answer an exception that Python ignores (`sys.unraisablehook`); it cannot be raised from here either."""
        if issubclass(lost.exc_type, Interrupted):
            _thread.start_new_thread(self._again, ())  # not threading's, whose locks may be held at this moment
        else:
            self._ignored(lost)

    def _again(self) -> None:
        time.sleep(PAUSE)
        self._raised = -math.inf
        if signal.getsignal(signal.SIGINT) != self.handle:
            return  # all is over
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # ends a wait as well
        else:
            _thread.interrupt_main()


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
        signal.signal(signal.SIGINT, signal.SIG_IGN if interrupts.asked else signal.default_int_handler)
        sys.unraisablehook = before
