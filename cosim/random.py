"""Random numbers by counter: each draw is a function of (seed, stream, channel, draw, step) and of nothing else.

So a run is the same alone, in a batch and on a cluster. A changed controller or an added block or sensor does not change any
other noise. The generator is Philox4x64-10 (Salmon et al., Parallel random numbers: as easy as 1, 2, 3, 2011), as in
``numpy.random.Philox``. Its key is (seed, hash of the stream's name). Its counter is (step // 4, channel, draw, 0), and the
four words of a block are for four consecutive steps. Each normal number comes from one uniform number, by Wichura's inverse of
the normal distribution (AS 241, relative accuracy 1e-16).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import ENTRY

CHUNK = 64
"""Steps that are drawn at a time."""

SPARE = 2
"""Rows of a buffer of random numbers, after those of the numbers, in which their normal ones are computed."""


def stream_key(name: str) -> int:
    """Return the 64-bit key of a stream: a hash of its name, the same in every process."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")


def check_seed(seed: int) -> int:
    """Return the seed if it is a whole number that fits 64 bits."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**64:
        raise ModelError(f"The seed is {seed!r}; it must be a whole number from 0 to 2**64 - 1.")
    return int(seed)


@cache
def compiled_fill() -> Callable[[int], None]:
    """Return the compiled generator, which takes the address of its words; the first call takes the time to load it."""
    from bayesftc.cosim.stepping.machine.services import service_address

    def find() -> Any:
        from bayesftc.cosim.drawing import draw

        return draw

    entry = ENTRY(service_address("draw", find))
    return lambda words: entry(0, words, 0, 0, 0.0, 0)


def draw_chunk(
    seed: int, streams: np.ndarray[Any, np.dtype[np.uint64]], first: int, buffer: np.ndarray[Any, Any]
) -> None:
    """Fill `buffer` (steps x numbers) from step `first` on, with the same bits as inside the compiled engine."""
    steps, count = buffer.shape
    rows = np.empty((count + SPARE, steps))
    words = np.array([streams.ctypes.data, count, first, rows.ctypes.data, steps, 0], dtype=np.int64)
    words[-1:].view(np.uint64)[:] = seed
    compiled_fill()(words.ctypes.data)
    buffer[:] = rows[:count].T


def numbers(seed: int, stream: str, steps: int, *, channel: int = 0, draw: int = 0, uniform: bool = False) -> Any:
    """Return the first `steps` numbers of one stream, for a script that needs the noise of a run.

    Examples
    --------
    >>> bool((numbers(1, "sensors.noise", 5) == numbers(1, "sensors.noise", 9)[:5]).all())
    True
    """
    streams = np.array([[stream_key(stream), channel, draw, uniform]], dtype=np.uint64)
    buffer = np.empty((-(-steps // 4) * 4, 1))
    draw_chunk(check_seed(seed), streams, 0, buffer)
    return buffer[:steps, 0]
