"""Ctrl-C that waits: what is imported for the first time must not be left half done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import FrameType


@contextmanager
def held_back() -> Iterator[None]:
    """Let Ctrl-C wait until the end of the body, and be raised there."""
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    heard: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: heard.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if heard:
            handler(*heard[0])


@cache
def import_engine() -> None:
    """Import what runs diagrams, compiler included, which takes a second.

    A library whose import is broken off is left half imported, and fails in all later runs of the process.
    """
    with held_back():
        from bayesftc.cosim.run import (
            loop as _loop,  # noqa: F401
            session,  # noqa: F401
        )
        from bayesftc.cosim.stepping import compiler as _compiler  # noqa: F401
