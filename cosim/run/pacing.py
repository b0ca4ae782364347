"""Real time: keep a run from getting ahead of the clock, and count the late steps."""

from __future__ import annotations

import time
from fractions import Fraction
from math import inf
from typing import Any

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

PACK = 1e-3
"""Steps shorter than this, in seconds of the clock, are waited for in packs."""


def check_pace(pace: Any) -> float:
    """Return the simulated seconds for each second of the clock.

    Raises
    ------
    ModelError
        If it is not a positive number.
    """
    if not 0 < real(pace) < inf:
        raise ModelError(
            f"pace is {pace!r}; it must be a positive number of simulated seconds for each second, 1.0 for real time."
        )
    return float(pace)


class Pacer:
    """Delays each step of a run until its time.

    Step k is an overrun if it is not done at t_k+1, or at the end of the next pack for steps shorter than `PACK`. After an
    overrun the run continues without a pause until it has caught up.

    Parameters
    ----------
    pace : float
        Simulated seconds for each second of the clock.
    step : Fraction
        The base step in seconds.
    k : int
        The step at which the clock starts.

    Raises
    ------
    ModelError
        If the pace is not a positive number.
    """

    def __init__(self, pace: Any, step: Fraction, k: int):
        self.pace = check_pace(pace)
        self._step, self._k = float(step) / self.pace, k
        self.pack = max(1, int(PACK / self._step))
        self.overruns, self.worst = 0, 0.0
        self._began = time.perf_counter()

    def wait(self, k: int) -> None:
        """Wait until the time of step `k`."""
        rest = self.due(k) - time.perf_counter()
        if rest > 0:
            time.sleep(rest)

    def done(self, k: int) -> None:
        """Record that the steps up to `k` are done now."""
        late = time.perf_counter() - self.due(k + self.pack)
        if late > 0:
            self.overruns += 1
            self.worst = max(self.worst, late)

    def report(self) -> dict[str, float]:
        """Return the pace, the number of late steps, and the largest delay in seconds.

        For packs of steps also the ``tolerance``: the seconds up to which a step is not late.
        """
        packed = {"tolerance": self.pack * self._step} if self.pack > 1 else {}
        return {"pace": self.pace, "overruns": self.overruns, "worst_overrun": self.worst, **packed}

    def due(self, k: int) -> float:
        """Return the time of step `k`, on the clock of `time.perf_counter`."""
        return self._began + (k - self._k) * self._step
