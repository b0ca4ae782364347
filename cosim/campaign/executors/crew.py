"""Worker processes for one job, started as they are needed: a run that crashes its process does not affect other runs."""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import subprocess
import threading
import time
import warnings
import weakref
from multiprocessing.connection import Connection
from typing import Any

from bayesftc.cosim.base.processes import can_start, how_it_ended, kill_group, start
from bayesftc.cosim.campaign.designs.plan import Piece, joined
from bayesftc.cosim.campaign.executors.child import receive
from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.run.many import KeepGoing, StoppedFromOutside

GLANCE = 0.1
"""Seconds between two checks whether a silent process is alive and still needed."""
GRACE = 3.0
"""Seconds of silence beyond the time limit after which a process is ended; between steps a run checks its limit itself."""
LEAVING = 5.0
"""Seconds for a process to end after it was killed."""
SENDING = 60
"""Seconds for a complete message to arrive."""


class Lost(Exception):
    """A process has ended, or had to be ended; the text continues a sentence: "was killed by ..."."""


class Crew:
    """Workers with the same job; see `bayesftc.cosim.campaign.executors.base.Work`.

    Parameters
    ----------
    payload : bytes
        The job, pickled.
    """

    def __init__(self, payload: bytes):
        self._payload, self._lock = payload, threading.Lock()
        self._idle: list[_Worker] = []
        self._all: set[_Worker] = set()
        self._end = weakref.finalize(self, _end_all, self._all)

    def run(self, piece: Piece, keep_going: KeepGoing = lambda: True) -> Any:
        """Do a piece in one of the processes. If that dies, make each run alone, to find the run that is responsible.

        Raises
        ------
        StoppedFromOutside
            If the piece is no longer needed.
        BayesFTCError
            If no process can start, or one dies with a job that is no campaign.
        """
        try:
            return self._ask(keep_going, "run", piece)
        except Lost as lost:
            if not self._is_recoverable:
                raise BayesFTCError(f"The process of a worker {lost}.") from None
        runs = [Piece(piece.index, run, run + 1) for run in range(piece.begin, piece.end)]
        return joined(piece, [self._alone(run, keep_going) for run in runs])

    def close(self) -> None:
        """End all processes."""
        _end_all(self._all)
        with self._lock:
            self._idle.clear()

    def _alone(self, run: Piece, keep_going: KeepGoing) -> Any:
        try:
            return self._ask(keep_going, "run", run)
        except Lost as lost:
            reason = str(lost)
        try:
            return self._ask(keep_going, "failed", run, reason)
        except Lost as lost:  # the process died without making a run
            raise BayesFTCError(f"The process of a worker {lost}.") from None

    def _ask(self, keep_going: KeepGoing, method: str, *arguments: Any) -> Any:
        worker = self._take(keep_going)
        try:
            answer = worker.ask(keep_going, method, *arguments)
        except BaseException:
            self._drop(worker)
            raise
        with self._lock:
            self._idle.append(worker)
        return answer

    def _take(self, keep_going: KeepGoing) -> _Worker:
        while self._idle:
            with self._lock:
                worker = self._idle.pop() if self._idle else None
            if worker is not None:
                if worker.is_alive:
                    return worker
                self._drop(worker)
        worker = _Worker()
        self._all.add(worker)
        try:
            worker.begin(self._payload, keep_going)
        except Lost as lost:
            self._drop(worker)
            raise BayesFTCError(
                f"A worker process cannot start: it {lost}. See its printed output for the reason."
            ) from None
        except BaseException:
            self._drop(worker)
            raise
        self._is_recoverable = worker.is_recoverable
        return worker

    def _drop(self, worker: _Worker) -> None:
        worker.end()
        self._all.discard(worker)

    _is_recoverable = False


class _Worker:
    """One process, and the connection to it."""

    def __init__(self) -> None:
        if not can_start():
            raise ModelError("Worker processes need Linux or macOS and a Python executable; use executor=Threads().")
        self.is_recoverable, self._limit = False, None
        with contextlib.ExitStack() as opened:
            host_end, worker_end = socket.socketpair()
            opened.callback(worker_end.close)
            for direction in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
                host_end.setsockopt(socket.SOL_SOCKET, direction, struct.pack("ll", SENDING, 0))
            self._talk = Connection(host_end.detach())
            self._process, self._lifeline = start("bayesftc.cosim.campaign.executors.child:main", [worker_end.fileno()])
        self._lock, self._is_over = threading.Lock(), False

    @property
    def is_alive(self) -> bool:
        return not self._is_over and self._process.poll() is None

    def begin(self, payload: bytes, keep_going: KeepGoing) -> None:
        """Send the job.

        Raises
        ------
        ModelError
            If the process cannot unpickle it.
        """
        with contextlib.suppress(OSError):  # if the process has ended, `_next` notices it
            self._talk.send_bytes(payload)
        answer = self._next(keep_going)
        if answer[0] == "unusable":
            raise ModelError(
                f"The campaign cannot run in other processes, because they cannot load it ({answer[1]}); put its blocks, "
                "metrics and functions into modules that these processes can import."
            )
        _, self._limit, self.is_recoverable = answer

    def ask(self, keep_going: KeepGoing, method: str, *arguments: Any) -> Any:
        """Call a method of the job in the process and return its result.

        Raises
        ------
        Lost
            If the process dies, or is ended because a run is silent for longer than the time limit.
        Exception
            The exception of the job.
        """
        with contextlib.suppress(OSError):
            self._talk.send((method, *arguments))
        answer = self._next(keep_going)
        if answer[0] == "raised":
            error: Exception = answer[1]
            error.add_note(f"In a worker process:\n{answer[2]}")
            raise error
        return answer[1]

    def _next(self, keep_going: KeepGoing) -> tuple[Any, ...]:
        """Return the next message that is an answer."""
        heard, is_computing = time.monotonic(), False
        while True:
            if not keep_going():
                raise StoppedFromOutside
            message = self._message()
            if message is None:
                silent = time.monotonic() - heard
                if is_computing and self._limit is not None and silent > self._limit + GRACE:
                    raise Lost(
                        f"was ended, because it reached its time limit of {self._limit:g} s of computing within a step"
                    )
                continue
            kind = message[0]
            heard, is_computing = time.monotonic(), kind == "computing" or (is_computing and kind != "overhead")
            if kind == "log":
                logging.getLogger(message[1]).log(message[2], "%s", message[3])
            elif kind == "warning":
                _, text, category, file, line = message
                warnings.warn_explicit(text, category, file, line, registry=_registry)
            elif kind not in {"computing", "overhead"}:
                return message

    def _message(self) -> tuple[Any, ...] | None:
        """Return the next message; None if none comes for a while."""
        try:
            if not self._talk.poll(GLANCE):
                if self._process.poll() is None:
                    return None
                if not self._talk.poll(0):
                    raise EOFError
            message: tuple[Any, ...] = self._talk.recv()
            return ("done", receive(self._talk, message[1])) if message[0] == "done" else message
        except Exception:  # noqa: BLE001 - it is closed, or an FMU has written into it: that may raise anything
            raise Lost(self._cause_of_death()) from None

    def _cause_of_death(self) -> str:
        try:
            return how_it_ended(self._process.wait(LEAVING))
        except subprocess.TimeoutExpired:
            return "closed its connection, or wrote invalid data into it, and was ended"

    def end(self) -> None:
        """End the process at once."""
        with self._lock:
            if self._is_over:
                return
            self._is_over = True
        kill_group(self._process)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVING)
        self._talk.close()
        self._lifeline.close()


_registry: dict[Any, Any] = {}


def _end_all(workers: set[_Worker]) -> None:
    for worker in list(workers):
        worker.end()
    workers.clear()


__all__ = ["GLANCE", "Crew"]
