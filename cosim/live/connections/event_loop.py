"""One event loop in a thread of its own, for all connections that are written with asyncio."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")

_LOOP: asyncio.AbstractEventLoop | None = None
_LOCK = threading.Lock()


def event_loop() -> asyncio.AbstractEventLoop:
    """Return the loop; its thread starts at the first call, and ends with the process."""
    global _LOOP
    with _LOCK:
        if _LOOP is None:
            _LOOP = asyncio.new_event_loop()
            threading.Thread(target=_LOOP.run_forever, name="asyncio of live bridges", daemon=True).start()
        return _LOOP


def submit(coroutine: Coroutine[Any, Any, T]) -> Future[T]:
    """Run a coroutine in the loop, from another thread."""
    return asyncio.run_coroutine_threadsafe(coroutine, event_loop())


async def outcome(coroutine: Coroutine[Any, Any, Any], seconds: float | None = None) -> BaseException | None:
    """Wait for a coroutine, and return the exception that it raised, if any.

    Parameters
    ----------
    coroutine : coroutine
        What to wait for.
    seconds : float, optional
        Longest time; after it the coroutine is cancelled, and the outcome is a `TimeoutError`.
    """
    task = asyncio.ensure_future(coroutine)
    try:
        done, _ = await asyncio.wait([task], timeout=seconds)
    except asyncio.CancelledError:
        task.cancel()
        raise
    if not done:
        task.cancel()
        return TimeoutError("no answer in time")
    return asyncio.CancelledError() if task.cancelled() else task.exception()


__all__ = ["event_loop", "outcome", "submit"]
