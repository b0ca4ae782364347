"""A thread that sends safe values if the steps stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from math import inf

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.wires import Outgoing

LOOK = 1.0
"""Most seconds between two looks at the steps."""


class Watchdog:
    """Sends the safe values if no step has ended for some time, and repeats them until one does.

    It is a thread of the same process: it works if a step takes too long, or hangs in an FMU. It cannot work if the whole process
    is stopped or killed. So an actuator needs a time limit of its own as well.

    Parameters
    ----------
    limit : float
        Seconds without a step.
    wires : sequence of Outgoing
        The wires.
    clock : callable
        The clock in seconds.

    Attributes
    ----------
    trips : int
        How often the steps have stopped.
    """

    def __init__(self, limit: float, wires: Sequence[Outgoing], clock: Callable[[], float] = time.monotonic):
        if not 0 < limit < inf:
            raise ModelError(f"The watchdog has a limit of {limit!r} s; it must be positive and finite.")
        self.trips = 0
        self._limit, self._wires, self._clock = limit, wires, clock
        self._fed = clock()
        self._late = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def start(self) -> None:
        """Start the thread; the time counts from now."""
        self.feed()
        self._thread.start()

    def feed(self) -> None:
        """Note that a step has ended."""
        self._fed = self._clock()

    def stop(self) -> None:
        """End the thread."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def check(self) -> None:
        """Send the safe values if the last step has ended too long ago."""
        late = self._clock() - self._fed > self._limit
        self.trips += late and not self._late
        self._late = late
        if late:
            for wire in self._wires:
                wire.make_safe(timeout=self._limit)

    def _run(self) -> None:
        while not self._ended.wait(min(self._limit / 4, LOOK)):
            self.check()
