"""The numbered runs of a campaign: the point and the seed of each, and their division into pieces.

Runs are counted point by point. A piece is run, sent, written and resumed as a whole: several consecutive runs, of one point
or of more. The plan depends only on the campaign, so that each executor and each resumption has the same pieces.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from bayesftc.cosim.types import Floats

OK = "ok"
FAILED = "failed"
"""The status of a run in the table: complete, or stopped early; then the table has the reason."""


@dataclass(frozen=True)
class Piece:
    """Runs ``begin`` to ``end - 1``, the piece of number ``index``."""

    index: int
    begin: int
    end: int

    def __len__(self) -> int:
        return self.end - self.begin


@dataclass(frozen=True)
class Plan:
    """Points, seeds and pieces of a campaign.

    Attributes
    ----------
    points : tuple of mapping of str to object
        The value of each factor, for each point of the design.
    seeds : tuple of tuple of int
        The seeds of the runs, for each point.
    size : int
        Number of runs in a piece; the last piece may have fewer.
    """

    points: tuple[Mapping[str, Any], ...]
    seeds: tuple[tuple[int, ...], ...]
    size: int

    @property
    def runs(self) -> int:
        """Number of all runs."""
        return self._ends[-1] if self.seeds else 0

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All pieces, in the order of their runs."""
        runs = self.runs
        return tuple(Piece(i, begin, min(begin + self.size, runs)) for i, begin in enumerate(range(0, runs, self.size)))

    def of_runs(self) -> tuple[np.ndarray[Any, np.dtype[np.int64]], np.ndarray[Any, np.dtype[np.int64]]]:
        """Return for each run the number of its point, and its seed."""
        points = np.repeat(np.arange(len(self.seeds)), [len(seeds) for seeds in self.seeds])
        return points, np.array([seed for seeds in self.seeds for seed in seeds], dtype=np.int64)

    def groups(self, piece: Piece) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Yield the number of each point with runs in a piece, and the seeds of these runs, in order."""
        point = bisect_right(self._ends, piece.begin)
        at = piece.begin
        while at < piece.end:
            seeds, first = self.seeds[point], self._ends[point] - len(self.seeds[point])
            end = min(piece.end, self._ends[point])
            if at < end:
                yield point, seeds[at - first : end - first]
            at, point = end, point + 1

    @cached_property
    def _ends(self) -> list[int]:
        """Return for each point the number of runs up to its last one."""
        return list(accumulate(map(len, self.seeds)))


@dataclass(frozen=True)
class Outcome:
    """The outcomes of the runs of a piece; each array has a row for each run.

    Attributes
    ----------
    piece : Piece
        The runs.
    metrics : mapping of str to ndarray of shape (runs,)
        By the name of the metric; NaN for a run that has failed.
    signals : mapping of str to ndarray of shape (runs, rows, ...)
        The recorded signals by name; NaN after the failure of a run.
    status, reasons : tuple of str
        `OK` or `FAILED`, and for failed runs the reason (else an empty text).
    steps : ndarray of int, of shape (runs,)
        The last complete step of each run.
    seconds : float
        Computing time of the piece in seconds.
    """

    piece: Piece
    metrics: Mapping[str, Floats]
    signals: Mapping[str, Floats]
    status: tuple[str, ...]
    reasons: tuple[str, ...]
    steps: np.ndarray[Any, np.dtype[np.int64]]
    seconds: float


def joined(piece: Piece, outcomes: Sequence[Outcome]) -> Outcome:
    """Return the outcome of a piece from the outcomes of its parts, in order."""
    first = outcomes[0]
    return Outcome(
        piece,
        {name: np.concatenate([o.metrics[name] for o in outcomes]) for name in first.metrics},
        {name: np.concatenate([o.signals[name] for o in outcomes]) for name in first.signals},
        tuple(status for o in outcomes for status in o.status),
        tuple(reason for o in outcomes for reason in o.reasons),
        np.concatenate([o.steps for o in outcomes]),
        sum(o.seconds for o in outcomes),
    )


__all__ = ["FAILED", "OK", "Outcome", "Piece", "Plan", "joined"]
