"""The engine of the console: a thread that advances the desk by the clock, and carries out commands in between."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from math import inf
from queue import Empty, SimpleQueue
from typing import Any

from bayesftc.console.desk.ahead import compile_ahead
from bayesftc.console.desk.desk import Desk
from bayesftc.console.desk.events import Events
from bayesftc.cosim.errors import ModelError, brief

SLICE = 0.02
"""Seconds of computing between two looks at the commands."""
SHORTEST = 0.004
"""Seconds of the clock between two pieces: shorter steps are computed in packs."""
SLOWEST, FASTEST = 0.1, 100.0
BEHIND = 0.25
"""Seconds by which the run may be late before the clock is set anew."""


class Engine:
    """Advances a desk in a thread of its own; all else happens in that thread, by `call`.

    Parameters
    ----------
    make : callable
        Called with `events`, where the desk notes what happens; returns the desk. It is called in the thread, because a scenario
        may take seconds to load.
    show : callable, optional
        Returns what others may read of a desk. It is called in the thread at each change of `Desk.epoch`; `view` has the result.
    """

    only_shows = False

    def __init__(self, make: Callable[[Events], Desk], show: Callable[[Desk], Any] | None = None):
        self._make, self._show = make, show
        self.events = Events()
        self.view: Any = None
        self.desk: Desk | None = None
        self.failure: str | None = None
        self.error: Exception | None = None
        self.pace = 1.0
        self.running = False
        self.late = 0
        self.busy: tuple[str, float] | None = None
        self._commands: SimpleQueue[tuple[Callable[[Desk], Any], Future[Any]] | None] = SimpleQueue()
        self._clock = (0.0, 0)
        self._piece = 1
        self._published = 0
        self._stops = threading.Event()
        self._thread = threading.Thread(target=self._work, name="bayesftc-console", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self, timeout: float = 10.0) -> None:
        """End the thread and all runs; a long command ends early."""
        self._stops.set()
        self._commands.put(None)
        self._thread.join(timeout)

    def call(self, function: Callable[[Desk], Any]) -> Future[Any]:
        """Carry out a function of the desk between two steps; return the future of its result."""
        future: Future[Any] = Future()
        self._commands.put((function, future))
        return future

    def set_pace(self, pace: float) -> None:
        """Set simulated seconds for each second of the clock; infinity for as fast as possible.

        Raises
        ------
        ModelError
            If it is not from 0.1 to 100, or infinity.
        """
        if not (SLOWEST <= pace <= FASTEST or pace == inf):
            raise ModelError(f"The pace is {brief(pace)}; use a number from {SLOWEST:g} to {FASTEST:g}, or infinity.")
        self.pace = pace
        self._set_clock()

    def set_running(self, running: bool) -> None:
        """Let the run continue, or pause it."""
        self.running = running
        self._set_clock()

    def progress(self, what: str, end: int) -> Callable[[int], None]:
        """Return a function that shows how far a long command is."""

        def show(k: int) -> None:
            self.busy = what, k / max(end, 1)
            if self._stops.is_set():
                raise ModelError("The console ends.")

        return show

    def wires(self) -> list[dict[str, Any]]:
        """Return no wires; see `LiveRun`."""
        return []

    def actions(self) -> list[dict[str, Any]]:
        """Return none: those of a desk are in its layout."""
        return []

    def _set_clock(self) -> None:
        if self.desk is not None:
            self._clock = time.perf_counter(), self.desk.k

    def _work(self) -> None:
        try:
            desk = self._make(self.events)
        except Exception as error:  # noqa: BLE001 - the page shows it
            self.error, self.failure = error, str(error) or type(error).__name__
            self._refuse_all()
            return
        self.desk = desk
        self._publish(desk)
        self._set_clock()
        ahead = threading.Thread(
            target=compile_ahead, args=(desk.step, self._stops), name="bayesftc-ahead", daemon=True
        )
        ahead.start()
        with desk:
            wait = 0.0
            while True:
                try:
                    command = self._commands.get(timeout=wait) if wait > 0 else self._commands.get_nowait()
                except Empty:
                    wait = self._advance(desk)
                    continue
                if command is None:
                    break
                self._carry_out(desk, *command)
                wait = 0.0
        ahead.join(5.0)
        self._refuse_all()

    def _advance(self, desk: Desk) -> float:
        """Advance by what is due; return the seconds until the next step is due."""
        if not self.running:
            return 3600.0
        if desk.branch.stopped:
            self.running = False
            return 3600.0
        began, first = self._clock
        now, k, step = time.perf_counter(), desk.k, float(desk.step)
        if self.pace == inf:
            desk.advance_to(k + self._piece)
            taken = time.perf_counter() - now
            self._piece = max(1, min(int(self._piece * min(2.0, SLICE / max(taken, 1e-6))), 100_000))
            return 0.0
        due = first + int((now - began) * self.pace / step + 1e-6)
        if (due - k) * step > BEHIND * self.pace:
            self.late += 1
            due = k + max(int(BEHIND * self.pace / step), 1)
            self._clock = now, due
        if due > k:
            desk.advance_to(due)
            k = due
        began, first = self._clock
        pack = max(1, int(SHORTEST * self.pace / step))
        return max(began + (k + pack - first) * step / self.pace - time.perf_counter(), 1e-5)

    def _carry_out(self, desk: Desk, function: Callable[[Desk], Any], future: Future[Any]) -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            result = function(desk)
        except Exception as error:  # noqa: BLE001 - whoever called gets it
            future.set_exception(error)
        else:
            future.set_result(result)
        finally:
            self.busy = None
            self._publish(desk)
            self._set_clock()

    def _publish(self, desk: Desk) -> None:
        if self._show is not None and desk.epoch != self._published:
            self.view, self._published = self._show(desk), desk.epoch

    def _refuse_all(self) -> None:
        while True:
            try:
                command = self._commands.get_nowait()
            except Empty:
                return
            if command is not None and command[1].set_running_or_notify_cancel():
                command[1].set_exception(ModelError(self.failure or "The console ends."))


__all__ = ["Engine"]
