"""Runs of one diagram in lock step, with an FMU instance of each for every lane."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.run.engines import compiled_loop
from bayesftc.cosim.types import Floats

Whole = np.ndarray[Any, np.dtype[np.int64]]
Seeds = np.ndarray[Any, np.dtype[np.uint64]]


class SideBySide:
    """Runs that advance together.

    Parameters
    ----------
    function : int
        The address of the compiled loop.
    streams : ndarray
        The table of random streams.
    memories : list of ndarray
        For each run, its memory at the beginning.
    calls : list of ndarray
        For each run, its table of calls.
    states : list of ndarray of shape (instances, 3)
        For each run, how its FMUs return to the beginning.
    """

    def __init__(self, function: int, streams: Seeds, memories: list[Floats], calls: list[Whole], states: list[Whole]):
        self._function, self._streams = function, streams
        self._initial, self._calls, self._states = np.stack(memories), np.stack(calls), np.stack(states)
        lanes, size = self._initial.shape
        self._memories = np.empty((lanes, size)), _aligned(size, lanes)
        self._buffers = np.empty((lanes, len(streams) + SPARE, CHUNK))

    def make(self, seeds: Seeds, recordings: Floats, end: int) -> int:
        """Make runs to step `end`, as many as fill all lanes; return how many are done before the first group with a failure."""
        beginning = self._initial, self._states
        tables = self._function, self._calls, self._streams, self._buffers, self._memories
        return int(compiled_loop("run_lanes")(*tables, recordings, seeds, beginning, end))


def _aligned(rows: int, lanes: int) -> Floats:
    """Return an array that begins at a multiple of a vector's size."""
    space = np.empty(rows * lanes + lanes)
    first = -space.ctypes.data // 8 % lanes
    return space[first : first + rows * lanes].reshape(rows, lanes)
