"""Messages to the user: that step functions are being compiled, what a slow call does, and how a file is read.

A message goes to the logger ``bayesftc`` (level INFO). If logging is not set up, it is written to stderr, which a notebook
shows, too. ``logging.getLogger("bayesftc").setLevel("WARNING")`` turns them off.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bayesftc.cosim.base.processes import has_host

SENTENCE = "Compiling step functions that are new on this machine, for some seconds; later runs reuse them."
PATIENCE = 1.0
"""Seconds before a message: small step functions take less."""


class _Stderr(logging.Handler):
    """Write to stderr, unless the program has its own handlers, which receive the same record."""

    def emit(self, record: logging.LogRecord) -> None:
        if not logging.getLogger().handlers:
            sys.stderr.write(f"{record.getMessage()}\n")
            sys.stderr.flush()


class _Announcement:
    """Whether the message was given, and how long this process has compiled."""

    def __init__(self) -> None:
        self.said = has_host  # else each of several workers would give the message
        self.spent = 0.0

    def say(self) -> None:
        if not self.said():
            self.said = lambda: True
            _log(SENTENCE)


def _log(sentence: str) -> None:
    logger = logging.getLogger("bayesftc")
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.INFO)
    if not any(isinstance(handler, _Stderr) for handler in logger.handlers):
        logger.addHandler(_Stderr())
    logger.info(sentence)


announcement = _Announcement()


@contextmanager
def announced(needed: bool) -> Iterator[None]:
    """Give the message if the code in this context compiles step functions (`needed`) and takes long."""
    if not needed or announcement.said():
        yield
        return
    begun = time.monotonic()
    try:
        with _after(PATIENCE - announcement.spent, announcement.say):
            yield
    finally:
        announcement.spent += time.monotonic() - begun


_informed: set[str] = set()


def inform(sentence: str) -> None:
    """Give a message now, unless this process has given it."""
    if sentence not in _informed:
        _informed.add(sentence)
        tell(sentence)


@contextmanager
def reported(sentence: str) -> Iterator[None]:
    """Give a message if the code in this context takes long."""
    if has_host():  # else each of several workers would give the message
        yield
        return
    with _after(PATIENCE, lambda: _log(sentence)):
        yield


def tell(sentence: str) -> None:
    """Give a message now."""
    if not has_host():  # else each of several workers would give the message
        _log(sentence)


@contextmanager
def _after(seconds: float, say: Callable[[], None]) -> Iterator[None]:
    timer = threading.Timer(max(0.0, seconds), say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


__all__ = ["announced", "inform", "reported", "tell"]
