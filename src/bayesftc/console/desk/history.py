"""The recorded rows of a live run, within a bound of memory, and its saved states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.run.session import RunState

FEWEST_ROWS = 1024


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of consecutive steps; row i is step ``first + i``. They never change, so that any thread can read them."""

    values: Floats
    first: int

    @property
    def last(self) -> int:
        """The step of the last row; ``first - 1`` without rows."""
        return self.first + len(self.values) - 1

    def of(self, begin: int, end: int) -> Rows:
        """Return the rows of the steps from `begin` to `end`, as far as they are here."""
        begin = max(begin, self.first)
        return Rows(self.values[begin - self.first : max(end + 1 - self.first, 0)], begin)


class History:
    """The last rows of a run. One thread writes, others read `rows`.

    Parameters
    ----------
    columns : int
        Numbers in a row.
    most_bytes : int
        Bound of memory. Beyond it the older half is dropped.
    """

    def __init__(self, columns: int, most_bytes: int):
        self._most = max(most_bytes // (8 * max(columns, 1)), FEWEST_ROWS)
        self._buffer = np.empty((min(FEWEST_ROWS, self._most), columns))
        self.rows = Rows(self._buffer[:0], 0)

    def append(self, values: Floats, first: int) -> None:
        """Add the rows from step `first` on; rows of these and of later steps are replaced."""
        rows = self.rows
        if first != rows.last + 1:
            kept = rows.of(rows.first, first - 1).values if rows.first <= first <= rows.last else rows.values[:0]
            self._buffer = np.concatenate([kept, np.empty_like(self._buffer)])  # readers keep the old buffer
            rows = Rows(self._buffer[: len(kept)], rows.first if len(kept) else first)
        if len(values) > self._most:
            first += len(values) - self._most
            values = values[-self._most :]
            rows = Rows(rows.values[:0], first)
        start, needed = rows.first, len(rows.values) + len(values)
        kept = rows.values
        if needed > self._most:
            drop = max(needed - self._most, len(kept) // 2)
            kept, start = kept[drop:], start + drop
        if kept is not rows.values or needed > len(self._buffer):
            room = min(max(2 * (len(kept) + len(values)), FEWEST_ROWS), max(self._most, len(kept) + len(values)))
            self._buffer = np.empty((room, self._buffer.shape[1]))
            self._buffer[: len(kept)] = kept
        self._buffer[len(kept) : len(kept) + len(values)] = values
        self.rows = Rows(self._buffer[: len(kept) + len(values)], start)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        return int(self._buffer.nbytes)


class SavedStates:
    """States of a run at regular steps, within a bound of memory: beyond it every second one is dropped.

    Parameters
    ----------
    interval : int
        Steps between two states at the beginning. It doubles each time that states are dropped.
    most_bytes, most : int
        Bounds of their memory and number.
    """

    def __init__(self, interval: int, most_bytes: int, most: int = 400):
        self.interval = max(interval, 1)
        self._most_bytes, self._most = most_bytes, max(most, 2)
        self._states: dict[int, RunState] = {}

    def is_due(self, k: int) -> bool:
        """Return whether a state of step `k` is missing."""
        return k - max((s for s in self._states if s <= k), default=-self.interval) >= self.interval

    def add(self, state: RunState) -> None:
        """Keep a state."""
        self._states[state.k] = state
        while len(self._states) > 2 and (len(self._states) > self._most or self.bytes > self._most_bytes):
            self._states = {k: self._states[k] for k in sorted(self._states)[::2]}
            self.interval *= 2

    def before(self, k: int) -> RunState | None:
        """Return the last state up to step `k`; None without one."""
        return self._states.get(max((s for s in self._states if s <= k), default=-1))

    @property
    def bytes(self) -> int:
        """Memory of the states, without what FMUs keep in themselves."""
        return sum(state.memory.nbytes + sum(map(_size, state.instances.values())) for state in self._states.values())

    def __len__(self) -> int:
        return len(self._states)


def _size(saved: object) -> int:
    data = getattr(saved, "data", None)
    return len(data) if isinstance(data, bytes | bytearray) else 0


__all__ = ["History", "Rows", "SavedStates"]
