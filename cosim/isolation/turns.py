"""Host and FMU take turns: while they do, they share one processor."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from bayesftc.cosim.block import External


@contextmanager
def one_processor(instances: Iterable[External]) -> Iterator[None]:
    """Keep this thread where it is, if an FMU in another process follows it there.

    Left alone, the system moves whoever waits to a processor that is idle, and to wake one that sleeps takes several times what a
    step of most FMUs takes: on an idle machine with two processors a loop made a third of the steps per second. It holds for
    one piece of a run, so that a thread whose processor gets busy leaves it soon.
    """
    if not any(getattr(instance, "follows", False) for instance in instances):
        yield
        return
    everywhere = os.sched_getaffinity(0)
    here = _here()
    if here not in everywhere:
        yield
        return
    os.sched_setaffinity(0, {here})
    try:
        yield
    finally:
        os.sched_setaffinity(0, everywhere)


@cache
def _library() -> Any:
    import ctypes

    return ctypes.CDLL(None)


def _here() -> int:
    """Return the number of the processor that runs this thread."""
    return int(_library().sched_getcpu())
