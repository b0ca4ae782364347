"""Reuse of processes of isolated FMUs: starting one takes longer than a short run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.isolation.process import WorkerProcess


class Spares:
    """Processes whose instance was freed, for further instances of the same FMU with the same settings; `close` ends them.

    Each has one instance at a time. Data that a library keeps beyond its instances stays, as for an FMU in process.
    """

    def __init__(self) -> None:
        self._idle: dict[bytes, list[WorkerProcess]] = {}

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Reuse processes in this context: closed instances leave their processes, new instances take them."""
        token = _lending.set(self)
        try:
            yield
        finally:
            _lending.reset(token)

    def close(self) -> None:
        """End the unused processes."""
        while self._idle:
            for process in self._idle.popitem()[1]:
                process.end()


_lending: ContextVar[Spares | None] = ContextVar("_lending", default=None)


def take(key: bytes) -> WorkerProcess | None:
    """Return a spare process for an instance of this kind, or None."""
    spares = _lending.get()
    idle = spares._idle.get(key, []) if spares else []
    while idle:
        process = idle.pop()
        if process.is_alive:
            return process
        process.end()
    return None


def give(key: bytes, process: WorkerProcess) -> bool:
    """Keep a process whose instance was freed; return False if processes are not reused."""
    spares = _lending.get()
    if spares is None:
        return False
    spares._idle.setdefault(key, []).append(process)
    return True
