"""One processor for host and isolated FMU, which run alternately."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from bayesftc.cosim.block import External


@contextmanager
def one_processor(instances: Iterable[External]) -> Iterator[None]:
    """Keep this thread on its processor, if an FMU in another process follows it there.

    Without this, the system moves a waiting process to an idle processor. Waking that takes several times as long as a step of
    most FMUs: on an idle machine with two processors a loop made a third of the steps per second. It holds for one part of a run,
    so that a thread soon leaves a processor that becomes busy.
    """
    if not any(getattr(instance, "follows", False) for instance in instances):
        yield
        return
    allowed = os.sched_getaffinity(0)
    processor = _present_processor()
    if processor not in allowed:
        yield
        return
    os.sched_setaffinity(0, {processor})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


@cache
def _library() -> Any:
    import ctypes

    return ctypes.CDLL(None)


def _present_processor() -> int:
    """Return the number of the processor that runs this thread."""
    return int(_library().sched_getcpu())
