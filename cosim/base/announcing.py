"""Says once in a process that step functions are compiled: without that, the first run is silent for many seconds.

The sentence goes to the logger ``bayesftc`` (level INFO). Where nobody has set up logging it is written to stderr, which a
notebook shows as well. ``logging.getLogger("bayesftc").setLevel("WARNING")`` turns it off.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from bayesftc.cosim.base.processes import has_host

SENTENCE = "Compiling step functions that are new on this machine, for some seconds; later runs reuse them."
PATIENCE = 1.0
"""Seconds of compiling before it is said: small step functions take less."""


class _Stderr(logging.Handler):
    """Writes to stderr, unless the program has handlers of its own, which then get the same record."""

    def emit(self, record: logging.LogRecord) -> None:
        if not logging.getLogger().handlers:
            sys.stderr.write(f"{record.getMessage()}\n")
            sys.stderr.flush()


class _Announcement:
    """What has been said, and how long this process has compiled."""

    def __init__(self) -> None:
        self.said = has_host  # of several workers each would say it
        self.spent = 0.0

    def say(self) -> None:
        if not self.said():
            self.said = lambda: True
            logger = logging.getLogger("bayesftc")
            if logger.level == logging.NOTSET:
                logger.setLevel(logging.INFO)
            if not any(isinstance(handler, _Stderr) for handler in logger.handlers):
                logger.addHandler(_Stderr())
            logger.info(SENTENCE)


announcement = _Announcement()


@contextmanager
def announced(needed: bool) -> Iterator[None]:
    """Say that step functions are compiled, if what is done inside is that and has taken long."""
    if not needed or announcement.said():
        yield
        return
    timer = threading.Timer(max(0.0, PATIENCE - announcement.spent), announcement.say)
    timer.daemon = True
    begun = time.monotonic()
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        announcement.spent += time.monotonic() - begun


__all__ = ["announced"]
