"""Runs of one diagram in lock step, with an FMU instance of each for every lane."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.run.general.program import DONE, DRAWN, Program, Seeds, Whole, function
from bayesftc.cosim.types import Floats


class SideBySide:
    """Runs that advance together.

    Parameters
    ----------
    loop : int
        The address of the compiled loop.
    programs : list of Program
        The tables of each run.
    memories : list of ndarray
        For each run, its memory at the beginning.
    states : list of ndarray of shape (instances, 3)
        For each run, how its FMUs return to the beginning.
    """

    def __init__(self, loop: int, programs: list[Program], memories: list[Floats], states: list[Whole]):
        self._loop, self._program = loop, programs[0]
        self._initial, self._calls = np.stack(memories), np.stack([program.calls for program in programs])
        self._states = np.stack(states)
        lanes, size = self._initial.shape
        self._own, self._wide = np.empty((lanes, size)), _aligned(size, lanes)
        self._buffers = np.empty((lanes, int(self._program.words[DRAWN]) + SPARE, CHUNK))

    def make(self, seeds: Seeds, recordings: Floats, end: int) -> int:
        """Make runs to step `end`, as many as fill all lanes; return how many are done before the first group with a failure."""
        many = np.array(
            [
                self._program.address, recordings.ctypes.data, recordings.strides[0], seeds.ctypes.data, len(seeds),
                self._initial.ctypes.data, self._states.ctypes.data, self._states.shape[1], 0, end, 0, 0,
                self._loop, self._calls.ctypes.data, self._buffers.ctypes.data, self._own.ctypes.data, self._wide.ctypes.data,
                len(self._own),
            ],
            dtype=np.int64,
        )  # fmt: skip
        function("run_lanes")(many.ctypes.data, 0, 0, 0, 0.0, 0)
        return int(many[DONE])


def _aligned(rows: int, lanes: int) -> Floats:
    """Return an array that begins at a multiple of a vector's size."""
    space = np.empty(rows * lanes + lanes)
    first = -space.ctypes.data // 8 % lanes
    return space[first : first + rows * lanes].reshape(rows, lanes)
