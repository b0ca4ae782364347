"""All runs of a campaign, numbered: which point of the design and which seed each has, and how they are cut into pieces.

Runs are counted point by point. A piece is what is run, sent, written and resumed as a whole: some runs in a row, of one point
or of several. The plan depends on nothing but the campaign, so that each executor and each resumption has the same pieces.
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
"""What the table says of a run: that it went to its end, or that it has stopped, for a reason that stands beside it."""


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
        For each point of the design the value of each factor.
    seeds : tuple of tuple of int
        For each point the seeds of its runs.
    size : int
        Runs of a piece; the last one may have fewer.
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
        points = np.repeat(np.arange(len(self.seeds)), [len(own) for own in self.seeds])
        return points, np.array([seed for own in self.seeds for seed in own], dtype=np.int64)

    def groups(self, piece: Piece) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Yield for each point that has runs in a piece its number and the seeds of these runs, in order."""
        point = bisect_right(self._ends, piece.begin)
        at = piece.begin
        while at < piece.end:
            own, first = self.seeds[point], self._ends[point] - len(self.seeds[point])
            end = min(piece.end, self._ends[point])
            if at < end:
                yield point, own[at - first : end - first]
            at, point = end, point + 1

    @cached_property
    def _ends(self) -> list[int]:
        """Return for each point how many runs there are up to its last."""
        return list(accumulate(map(len, self.seeds)))


@dataclass(frozen=True)
class Outcome:
    """What the runs of a piece have come to; each array has a row for each run.

    Attributes
    ----------
    piece : Piece
        Which runs.
    metrics : mapping of str to ndarray of shape (runs,)
        By the name of the metric; NaN for a run that has failed.
    signals : mapping of str to ndarray of shape (runs, rows, ...)
        What was recorded, by the name of the signal; NaN from where a run has failed.
    status, reasons : tuple of str
        `OK` or `FAILED`, and for those that have failed the sentence that says why (else an empty text).
    steps : ndarray of int, of shape (runs,)
        The last complete step of each.
    seconds : float
        Of computing that the piece took.
    """

    piece: Piece
    metrics: Mapping[str, Floats]
    signals: Mapping[str, Floats]
    status: tuple[str, ...]
    reasons: tuple[str, ...]
    steps: np.ndarray[Any, np.dtype[np.int64]]
    seconds: float


def joined(piece: Piece, outcomes: Sequence[Outcome]) -> Outcome:
    """Return as one what the runs of a piece have come to, from outcomes of its parts, in order."""
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
