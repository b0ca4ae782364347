"""The recorded rows of a live run, within a bound of memory, and its saved states."""

from __future__ import annotations

import pickle
from bisect import bisect_right
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesftc.cosim.run.session import RunState

BLOCK = 8 * 2**20
"""Bytes of a block of rows. Blocks are never copied to a larger place, and so large that huge pages hold them (Linux)."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of consecutive steps; row i is step ``first + i``."""

    values: Floats
    first: int

    @property
    def last(self) -> int:
        """The step of the last row; ``first - 1`` without rows."""
        return self.first + len(self.values) - 1


@dataclass(frozen=True, eq=False)
class Recorded:
    """All rows of a run at one moment, in blocks. They never change, so that any thread can read them.

    Attributes
    ----------
    blocks : tuple of Rows
        One after the other, none of them empty.
    first : int
        The step of the first row.
    columns : int
        Numbers in a row.
    """

    blocks: tuple[Rows, ...]
    first: int
    columns: int

    @property
    def last(self) -> int:
        """The step of the last row; ``first - 1`` without rows."""
        return self.blocks[-1].last if self.blocks else self.first - 1

    @property
    def newest(self) -> Floats | None:
        """The last row; None without rows."""
        return self.blocks[-1].values[-1] if self.blocks else None

    @property
    def values(self) -> Floats:
        """All rows side by side, as a copy."""
        return self.of(self.first, self.last).values

    def of(self, begin: int, end: int, columns: Sequence[int] | slice = slice(None)) -> Rows:
        """Return the rows of the steps from `begin` to `end`, as far as they are here, or some of their columns."""
        begin = max(begin, self.first)
        first = max(bisect_right(self.blocks, begin, key=lambda block: block.first) - 1, 0)
        parts = [np.empty((0, self.columns))[:, columns]]
        for block in self.blocks[first:]:
            if block.first > end:
                break
            parts.append(block.values[max(begin - block.first, 0) : max(end + 1 - block.first, 0)][:, columns])
        return Rows(parts[1] if len(parts) == 2 else np.concatenate(parts), begin)


class History:
    """The last rows of a run. One thread writes, others read `rows`.

    Parameters
    ----------
    columns : int
        Numbers in a row.
    most_bytes : int
        Bound of memory. Beyond it the oldest rows are dropped.
    """

    def __init__(self, columns: int, most_bytes: int):
        self._columns, self._most = columns, most_bytes
        self._blocks: deque[tuple[Rows, int]] = deque()
        self._open, self._used = np.empty((0, columns)), 0
        self.bytes = 0
        self.rows = Recorded((), 0, columns)

    def room(self, rows: int, columns: int) -> Floats:
        """Return an array for the next rows. If they are written there, `append` does not copy them."""
        if self._used + rows > len(self._open):
            return np.empty((rows, columns))
        return self._open[self._used : self._used + rows]

    def append(self, values: Floats, first: int) -> None:
        """Add the rows from step `first` on; rows of these and of later steps are replaced."""
        if first != self.rows.last + 1:
            self._cut(first)
        size = max(min(BLOCK, self._most // 4) // (8 * max(self._columns, 1)), 1)
        at = first
        while len(values):
            if self._used == len(self._open):
                self._open, self._used = np.empty((size, self._columns)), 0
                self._add(Rows(self._open[:0], at), self._open.nbytes)
            part = values[: len(self._open) - self._used]
            if part.base is not self._open:
                self._open[self._used : self._used + len(part)] = part
            self._used += len(part)
            block, used = self._blocks[-1]
            self._blocks[-1] = Rows(self._open[: self._used], block.first), used
            values, at = values[len(part) :], at + len(part)
        self._publish(first)

    def bound(self, most_bytes: int) -> None:
        """Set another bound of memory."""
        self._most = most_bytes
        self._drop()
        self._publish(self.rows.first)

    def _add(self, rows: Rows, size: int) -> None:
        self._blocks.append((rows, size))
        self.bytes += size
        self._drop()

    def _drop(self) -> None:
        while len(self._blocks) > 1 and self.bytes > self._most:
            self.bytes -= self._blocks.popleft()[1]

    def _cut(self, first: int) -> None:
        """Drop the rows from step `first` on; all of them, if the step before it has no row."""
        if not self.rows.first <= first <= self.rows.last:
            first = self.rows.first
        while self._blocks and self._blocks[-1][0].last >= first:
            block, size = self._blocks.pop()
            self.bytes -= size
            if block.first < first:
                kept = block.values[: first - block.first].copy()  # readers keep the old block
                self._add(Rows(kept, block.first), kept.nbytes)
        self._open, self._used = np.empty((0, self._columns)), 0

    def _publish(self, first: int) -> None:
        blocks = tuple(block for block, _ in self._blocks)
        self.rows = Recorded(blocks, blocks[0].first if blocks else first, self._columns)


class SavedStates:
    """States of a run, within a bound of memory: beyond it every second one is dropped.

    Parameters
    ----------
    interval : int
        Fewest steps between two states at the beginning. It doubles each time that states are dropped.
    most_bytes, most : int
        Bounds of their memory and number.
    """

    def __init__(self, interval: int, most_bytes: int, most: int = 400):
        self.interval = max(interval, 1)
        self._most_bytes, self._most = most_bytes, max(most, 2)
        self._states: dict[int, RunState] = {}  # with rising steps
        self._size: int | None = None

    def is_due(self, k: int) -> bool:
        """Return whether a state of step `k` is missing."""
        newest = next(reversed(self._states), None)
        if newest is not None and newest > k:  # after going back
            newest = max((s for s in self._states if s <= k), default=None)
        return newest is None or k - newest >= self.interval

    def add(self, state: RunState) -> None:
        """Keep a state."""
        if self._size is None:
            self._size = _size(state)
        is_last = not self._states or next(reversed(self._states)) < state.k
        self._states[state.k] = state
        if not is_last:
            self._states = dict(sorted(self._states.items()))
        self._thin()

    def bound(self, most_bytes: int, most: int) -> None:
        """Set other bounds of memory and number."""
        self._most_bytes, self._most = most_bytes, max(most, 2)
        self._thin()

    def _thin(self) -> None:
        while len(self._states) > 2 and (len(self._states) > self._most or self.bytes > self._most_bytes):
            self._states = {k: self._states[k] for k in [*self._states][::2]}
            self.interval *= 2

    def before(self, k: int) -> RunState | None:
        """Return the last state up to step `k`; None without one."""
        return self._states.get(max((s for s in self._states if s <= k), default=-1))

    @property
    def bytes(self) -> int:
        """Memory of the states: that of the first one, for each. FMUs that cannot write their states count nothing."""
        return len(self._states) * (self._size or 0)

    def __len__(self) -> int:
        return len(self._states)


def _size(state: RunState) -> int:
    size = state.memory.nbytes
    for saved in state.instances.values():
        with suppress(FMUError):
            size += len(pickle.dumps(saved))
    return size


__all__ = ["History", "Recorded", "Rows", "SavedStates"]
