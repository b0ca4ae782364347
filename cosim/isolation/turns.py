"""Which processors host and isolated FMU use, which run alternately."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from bayesftc.cosim.block import External
from bayesftc.cosim.isolation import protocol

OFTEN = 0.1
"""Share of commands with a sleep from which on host and FMU rather share a processor."""

FIRST_AGAIN, LAST_AGAIN = 16, 1024
"""Thousands of commands until processors of their own are tried again, at first and at last."""


class Turns:
    """Where an FMU's process runs for its next `protocol.PAUSE` commands: ANYWHERE, TOGETHER with the host, or APART from it.

    Apart, both look at the memory that they share, and need not wake each other. On a busy machine they often wait so long for a
    processor that they sleep all the same: then they are better together, and are apart again for a try, ever more rarely.

    Parameters
    ----------
    processors : int
        How many the process may use.
    """

    def __init__(self, processors: int):
        self._can_part, self._home = processors > 1, protocol.ANYWHERE
        self._rest, self._again = 0, FIRST_AGAIN

    def next(self, is_quick: bool, slept: int) -> int:
        """Return where to run next, from whether the last commands were quick and how often one of both slept meanwhile."""
        if not is_quick:
            self._home = protocol.ANYWHERE
        elif self._home == protocol.APART and slept > OFTEN * protocol.PAUSE:
            self._home, self._rest, self._again = protocol.TOGETHER, self._again, min(2 * self._again, LAST_AGAIN)
        elif not self._can_part or self._rest > 0:
            self._home, self._rest = protocol.TOGETHER, self._rest - 1
        else:
            self._home = protocol.APART
        return self._home


@contextmanager
def one_processor(instances: Iterable[External]) -> Iterator[None]:
    """Keep this thread on its processor, if an FMU in another process goes there, or keeps away from there.

    Without this, the system moves host and FMU, which seem idle to it, between processors. Where both share a processor, a loop
    made a third of the steps per second. It holds for one part of a run, so that a thread soon leaves a processor that becomes
    busy.
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
