"""Runs of one diagram in lock step, with an FMU instance of each for every lane."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.random import CHUNK, SPARE
from bayesftc.cosim.run.general.program import AT, DONE, DRAWN, UNBEGUN, Program, Seeds, Whole, function
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

    def begin(self, seeds: Seeds, recordings: Floats, end: int, piece: int) -> None:
        """Begin runs to step `end`, as many as fill all lanes, with pauses after every `piece` steps."""
        self._seeds, self._recordings = seeds, recordings  # keeps their memory
        self._words = np.array(
            [
                self._program.address,
                recordings.ctypes.data,
                recordings.strides[0],
                seeds.ctypes.data,
                len(seeds),
                self._initial.ctypes.data,
                self._states.ctypes.data,
                self._states.shape[1],
                0,
                end,
                0,
                0,
                self._loop,
                self._calls.ctypes.data,
                self._buffers.ctypes.data,
                self._own.ctypes.data,
                self._wide.ctypes.data,
                len(self._own),
                piece,
                UNBEGUN,
            ],
            dtype=np.int64,
        )

    def go_on(self) -> bool:
        """Make runs to the next pause; return whether there is more to do.

        There is not if all are done, or one of the first group that is not has failed.
        """
        function("run_lanes")(self._words.ctypes.data, 0, 0, 0, 0.0, 0)
        return bool(self._words[AT] != UNBEGUN)

    @property
    def done(self) -> int:
        """Number of complete runs, from the first one on."""
        return int(self._words[DONE])


def _aligned(rows: int, lanes: int) -> Floats:
    """Return an array that begins at a multiple of a vector's size."""
    space = np.empty(rows * lanes + lanes)
    first = -space.ctypes.data // 8 % lanes
    return space[first : first + rows * lanes].reshape(rows, lanes)
