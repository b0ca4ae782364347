"""Processes of isolated FMUs that are used again: to start one takes longer than many a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.isolation.process import WorkerProcess


class Spares:
    """Processes whose instance was freed, for further instances of the same FMU with the same settings; `close` ends them.

    Each still has one instance at a time. What a library keeps beyond its instances stays from one to the next, as it does for
    an FMU in process.
    """

    def __init__(self) -> None:
        self._idle: dict[bytes, list[WorkerProcess]] = {}

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Have instances that are closed here leave their processes, and those that are made here take them."""
        token = _lending.set(self)
        try:
            yield
        finally:
            _lending.reset(token)

    def close(self) -> None:
        """End the processes that nobody has taken."""
        while self._idle:
            for process in self._idle.popitem()[1]:
                process.end()


_lending: ContextVar[Spares | None] = ContextVar("_lending", default=None)


def take(key: bytes) -> WorkerProcess | None:
    """Return a living process for an instance of this kind, if there is one to spare."""
    spares = _lending.get()
    idle = spares._idle.get(key, []) if spares else []
    while idle:
        process = idle.pop()
        if process.is_alive:
            return process
        process.end()
    return None


def give(key: bytes, process: WorkerProcess) -> bool:
    """Keep a process whose instance was freed; return False where nobody wants it."""
    spares = _lending.get()
    if spares is None:
        return False
    spares._idle.setdefault(key, []).append(process)
    return True
