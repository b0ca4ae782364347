"""Statistics of deadlines: how late each step began and ended. They need the same memory after any time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

EDGES = np.concatenate([[0.0], np.logspace(-5, 2, 141)])
"""Edges of the histogram in seconds: twenty for each factor of ten, from 10 us to 100 s."""

SHARES = (0.5, 0.9, 0.99, 0.999)


class Deadlines:
    """Jitter and overruns of a paced run.

    A step is due at its time, and overruns if it is not done when the next one is due.

    Parameters
    ----------
    period : float
        Seconds of the clock between two steps.

    Attributes
    ----------
    steps, overruns : int
        Number of steps, and of overruns.
    skipped : int
        Number of steps that were left out after a long stop, because the clock was set anew.
    worst : float
        Largest delay between the time at which a step was due and its beginning, in seconds.
    longest : float
        Longest computation of a step, in seconds.
    counts : ndarray of int
        Number of steps for each delay between two of `EDGES`, in seconds; the last one is for longer delays.

    Examples
    --------
    >>> from bayesftc.cosim.live import Deadlines
    >>> deadlines = Deadlines(period=0.001)
    >>> for delay in (0.0001, 0.0001, 0.0002, 0.0007):
    ...     deadlines.add(delay, delay + 0.0004)
    >>> deadlines.steps, deadlines.overruns, deadlines.share_within(0.0005)
    (4, 1, 0.75)
    """

    def __init__(self, period: float):
        self.period = period
        self.steps = self.overruns = self.skipped = 0
        self.worst = self.longest = self._sum = 0.0
        self.counts = np.zeros(len(EDGES), dtype=np.int64)

    def add(self, begin: float, end: float) -> None:
        """Count a step.

        Parameters
        ----------
        begin, end : float
            Seconds from the time at which the step was due to its beginning and to its end.
        """
        self.steps += 1
        self.overruns += end > self.period
        self.worst = max(self.worst, begin)
        self.longest = max(self.longest, end - begin)
        self._sum += begin
        self.counts[EDGES.searchsorted(begin, "right") - 1 if begin > 0 else 0] += 1

    def share_within(self, seconds: float) -> float:
        """Return the share of the steps that began at most about so many seconds late; NaN without steps."""
        inside = self.counts[: int(EDGES.searchsorted(seconds * (1 + 1e-9), "right")) - 1].sum()
        return float(inside / self.steps) if self.steps else np.nan

    def quantile(self, share: float) -> float:
        """Return the delay in seconds that a share of the steps does not exceed, to 12 % of it; NaN without steps."""
        if not self.steps:
            return np.nan
        at = int(np.searchsorted(np.cumsum(self.counts), share * self.steps))
        return min(float(EDGES[min(at + 1, len(EDGES) - 1)]), self.worst)

    def report(self) -> dict[str, Any]:
        """Return the statistics as plain data: times in seconds."""
        quantiles: Mapping[str, float] = {f"delay_{share:g}": self.quantile(share) for share in SHARES}
        return {
            "period": self.period,
            "steps": self.steps,
            "overruns": self.overruns,
            "skipped": self.skipped,
            "mean_delay": self._sum / self.steps if self.steps else np.nan,
            **quantiles,
            "worst_delay": self.worst,
            "longest_step": self.longest,
            "histogram": [
                (float(EDGES[i]), float(EDGES[i + 1]) if i + 1 < len(EDGES) else None, int(count))
                for i, count in enumerate(self.counts)
                if count
            ],
        }


__all__ = ["EDGES", "Deadlines"]
