"""Real time: a run that never goes ahead of the clock, and says how often it fell behind."""

from __future__ import annotations

import time
from fractions import Fraction
from math import inf
from typing import Any

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

PACK = 1e-3
"""Seconds of the clock below which steps are not waited for one by one."""


class Pacer:
    """Lets t_k be computed when its time has come, and not before.

    What is computed at t_k has until t_k+1 (with steps shorter than `PACK`: until the next pack of them) before it counts as an
    overrun. After an overrun the run goes on without a pause until it has caught up.

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
        If the pace is no positive number.
    """

    def __init__(self, pace: Any, step: Fraction, k: int):
        if not 0 < real(pace) < inf:
            raise ModelError(
                f"pace is {pace!r}; it must be a positive number of simulated seconds for each second, 1.0 for real time."
            )
        self.pace = float(pace)
        self._step, self._k = float(step) / self.pace, k
        self.pack = max(1, int(PACK / self._step))
        self.overruns, self.worst = 0, 0.0
        self._began = time.perf_counter()

    def wait(self, k: int) -> None:
        """Wait until the time of step `k` has come."""
        rest = self._due(k) - time.perf_counter()
        if rest > 0:
            time.sleep(rest)

    def done(self, k: int) -> None:
        """Note when the steps up to `k` were done."""
        late = time.perf_counter() - self._due(k + self.pack)
        if late > 0:
            self.overruns += 1
            self.worst = max(self.worst, late)

    def report(self) -> dict[str, float]:
        """Return the pace, how many steps (or packs of them) were late, and by how many seconds at worst."""
        return {"pace": self.pace, "overruns": self.overruns, "worst_overrun": self.worst}

    def _due(self, k: int) -> float:
        return self._began + (k - self._k) * self._step
