"""Log messages of running FMUs: kept for error messages, forwarded to Python's logging, never printed."""

from __future__ import annotations

import ctypes
import itertools
import logging
from collections import deque
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any

KEPT = 20
"""How many messages of an instance are kept."""

LENGTH = 500
"""How many characters of a message are kept."""

FORWARDED = 10_000
"""How many messages of an instance are forwarded; the limit keeps a verbose FMU from filling disks and slowing runs."""

ENDS = "The FMU asks to end the simulation"
"""Beginning of the message of an FMU that ends a run, which is no failure."""

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
"""The standard's names of the statuses that calls return."""


def status_word(status: int) -> str:
    """Return the standard's name of a status, or say that it is none."""
    return STATUS[status] if 0 <= status < len(STATUS) else f"{status}, which is no status of FMI"


_LEVELS = (logging.INFO, logging.WARNING, logging.WARNING, logging.ERROR, logging.CRITICAL, logging.INFO)

logger = logging.getLogger("bayesftc.fmu")
logger.addHandler(logging.NullHandler())  # else logging prints warnings if the user has not set it up

_numbers = itertools.count(1)
_open: dict[int | bytes, Messages] = {}


class Messages:
    """The last messages of one instance; the FMU's callbacks find them by `key`."""

    #: The key of the newest instance.
    last = 0

    def __init__(self, name: str):
        self.name = name
        self.key = Messages.last = next(_numbers)
        self._lines: deque[bytes] = deque(maxlen=KEPT)
        self._count = 0
        self._more: list[int | bytes] = []
        _open[self.key] = self

    def add(self, status: int, text: bytes) -> None:
        """Keep a message and forward it."""
        line = text[: 8 * LENGTH]  # a message may have megabytes
        self._lines.append(line)
        self._count += 1
        if self._count <= FORWARDED:
            level = _LEVELS[status] if 0 <= status < len(_LEVELS) else logging.WARNING
            logger.log(level, "%s: %s", self.name, _cleaned(line))
        elif self._count == FORWARDED + 1:
            logger.warning(
                "%s: %s", self.name, f"This FMU has logged {FORWARDED} messages; later ones are not forwarded."
            )

    def __iter__(self) -> Iterator[str]:
        return iter([_cleaned(line) for line in self._lines])

    def quoted(self) -> str:
        """Return the messages as a sentence."""
        return quoted(self)

    def add_key(self, key: int | bytes) -> None:
        """Add a key: callbacks of FMI 1 get no key, but the instance's name and address."""
        self._more.append(key)
        _open[key] = self

    def close(self) -> None:
        """Receive no more messages."""
        for key in (self.key, *self._more):
            if _open.get(key) is self:
                del _open[key]


def quoted(messages: Iterable[str]) -> str:
    """Return messages as a sentence, repetitions once."""
    lines = list(dict.fromkeys(line for line in messages if line))
    if not lines:
        return "It logged nothing."
    return "Its log: " + " | ".join(lines)


def _cleaned(line: bytes) -> str:
    return " ".join(line.decode("utf-8", errors="replace").split())[:LENGTH]


def _deliver(key: int | None, status: int, text: bytes | None, name: bytes | None = None) -> bool:
    """Add a message to its instance's; return whether the instance is ours, open or closed."""
    messages = _open.get(key or 0) or _open.get(name or b"")
    if messages is not None:
        messages.add(status, text or b"")
    return messages is not None or 0 < (key or 0) <= Messages.last


@cache
def callback2() -> Any:
    """Return the logger callback of FMI 1 and 2: one for the process, as fmpy's proxy supports only one."""
    from fmpy import fmi2

    def log(key: int | None, name: bytes | None, status: int, category: bytes | None, text: bytes | None) -> None:
        if not _deliver(key, status, text, name) and text is not None and 0 <= status < len(STATUS):
            fmi2.printLogMessage(None, name, status, category, text)  # an FMU that someone runs with fmpy itself

    return fmi2.fmi2CallbackLoggerTYPE(log)


@cache
def callback3() -> Any:
    """Return the logger callback of FMI 3."""
    from fmpy import fmi3

    def log(key: int | None, status: int, category: bytes | None, text: bytes | None) -> None:
        _deliver(key, status, text)

    return fmi3.fmi3LogMessageCallback(log)


def callbacks2(messages: Messages) -> Any:
    """Return the structure of callbacks for an FMI 2 instance; keep it as long as the instance exists."""
    from fmpy import fmi2

    structure = fmi2.fmi2CallbackFunctions()
    structure.componentEnvironment = messages.key
    return _filled(structure)


def callbacks1(messages: Messages, name: str) -> Any:
    """Return the structure of callbacks for an FMI 1 instance of this name; keep it as long as the instance exists."""
    from fmpy import fmi1

    messages.add_key(name.encode())
    return _filled(fmi1.fmi1CallbackFunctions())


def _filled(structure: Any) -> Any:
    """Give a structure of callbacks the functions that FMI 1 and 2 have in common."""
    import fmpy

    kinds = dict(structure._fields_)
    structure.logger = ctypes.cast(callback2(), kinds["logger"])
    # Plain C functions, because an FMU may allocate during a step, when the GIL is not held.
    structure.allocateMemory = ctypes.cast(fmpy.calloc, kinds["allocateMemory"])
    structure.freeMemory = ctypes.cast(fmpy.free, kinds["freeMemory"])
    try:
        from fmpy.logging import addLoggerProxy
    except (ImportError, OSError, AttributeError):  # no proxy for this platform: messages come with their % signs
        return structure
    addLoggerProxy(ctypes.byref(structure))  # formats the message's variable arguments, which ctypes cannot
    return structure
