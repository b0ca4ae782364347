"""Delay Ctrl-C until an import is complete."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import FrameType


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


@cache
def import_engine() -> None:
    """Import the modules that run diagrams, including the compiler. This takes a second.

    If Ctrl-C interrupted the import, a library would remain half imported, and all later runs of the process would fail.
    """
    with held_back():
        from bayesftc.cosim.run import session  # noqa: F401
