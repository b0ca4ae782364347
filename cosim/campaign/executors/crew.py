"""Worker processes that share a job, started as they are needed: what a run does to its process it does to no other run."""

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
from bayesftc.cosim.run.many import StoppedFromOutside, Wanted

GLANCE = 0.1
"""Seconds after which it is seen whether a process that says nothing is alive, and still wanted."""
GRACE = 3.0
"""Seconds beyond the time limit that a run may say nothing: between steps it looks at its time limit itself."""
LEAVING = 5.0
"""Seconds for a process to vanish once it was killed."""
SENDING = 60
"""Seconds for a message to come whole."""


class Lost(Exception):
    """A process is gone, or had to be ended; the text says how, as in "it was killed by ..."."""


class Crew:
    """Workers that have the same job; see `bayesftc.cosim.campaign.executors.base.Work`.

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

    def run(self, piece: Piece, wanted: Wanted = lambda: True) -> Any:
        """Do a piece in one of the processes. Where that dies, each run is made alone, to find out which one has done it.

        Raises
        ------
        StoppedFromOutside
            When it is no longer wanted.
        BayesFTCError
            If no process can begin, or die with something that is no campaign.
        """
        try:
            return self._ask(wanted, "run", piece)
        except Lost as lost:
            if not self._is_recoverable:
                raise BayesFTCError(f"The process of a worker {lost}.") from None
        runs = [Piece(piece.index, run, run + 1) for run in range(piece.begin, piece.end)]
        return joined(piece, [self._alone(run, wanted) for run in runs])

    def close(self) -> None:
        """End all processes."""
        _end_all(self._all)
        with self._lock:
            self._idle.clear()

    def _alone(self, run: Piece, wanted: Wanted) -> Any:
        try:
            return self._ask(wanted, "run", run)
        except Lost as lost:
            reason = str(lost)
        try:
            return self._ask(wanted, "failed", run, reason)
        except Lost as lost:  # which has done nothing but to begin
            raise BayesFTCError(f"The process of a worker {lost}.") from None

    def _ask(self, wanted: Wanted, method: str, *arguments: Any) -> Any:
        worker = self._take(wanted)
        try:
            answer = worker.ask(wanted, method, *arguments)
        except BaseException:
            self._drop(worker)
            raise
        with self._lock:
            self._idle.append(worker)
        return answer

    def _take(self, wanted: Wanted) -> _Worker:
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
            worker.begin(self._payload, wanted)
        except Lost as lost:
            self._drop(worker)
            raise BayesFTCError(f"A worker process cannot begin: it {lost}. What it has printed may say why.") from None
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
            raise ModelError(
                "Worker processes need Linux or macOS and a Python that can be started; use executor=Threads()."
            )
        self.is_recoverable, self._limit = False, None
        with contextlib.ExitStack() as opened:
            ours, theirs = socket.socketpair()
            opened.callback(theirs.close)
            for direction in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
                ours.setsockopt(socket.SOL_SOCKET, direction, struct.pack("ll", SENDING, 0))
            self._talk = Connection(ours.detach())
            self._process, self._lifeline = start("bayesftc.cosim.campaign.executors.child:main", [theirs.fileno()])
        self._lock, self._is_over = threading.Lock(), False

    @property
    def is_alive(self) -> bool:
        return not self._is_over and self._process.poll() is None

    def begin(self, payload: bytes, wanted: Wanted) -> None:
        """Hand over the job.

        Raises
        ------
        ModelError
            If the process cannot make it of its bytes.
        """
        with contextlib.suppress(OSError):  # it is gone, as is seen at once
            self._talk.send_bytes(payload)
        answer = self._next(wanted)
        if answer[0] == "unusable":
            raise ModelError(
                f"The campaign cannot run in other processes: what it is made of is not found there ({answer[1]}). Blocks, "
                "metrics and functions must be of modules that they can import too."
            )
        _, self._limit, self.is_recoverable = answer

    def ask(self, wanted: Wanted, method: str, *arguments: Any) -> Any:
        """Return what a method of the job returns there.

        Raises
        ------
        Lost
            If the process dies, or has to be ended as a run says nothing for longer than the time limit.
        Exception
            What the job raises.
        """
        with contextlib.suppress(OSError):
            self._talk.send((method, *arguments))
        answer = self._next(wanted)
        if answer[0] == "raised":
            error: Exception = answer[1]
            error.add_note(f"In a worker process:\n{answer[2]}")
            raise error
        return answer[1]

    def _next(self, wanted: Wanted) -> tuple[Any, ...]:
        """Return the next message that is an answer."""
        told, is_computing = time.monotonic(), False
        while True:
            if not wanted():
                raise StoppedFromOutside
            message = self._message()
            if message is None:
                silent = time.monotonic() - told
                if is_computing and self._limit is not None and silent > self._limit + GRACE:
                    raise Lost(
                        f"was ended, for it reached its time limit of {self._limit:g} s of computing within a step"
                    )
                continue
            kind = message[0]
            told, is_computing = time.monotonic(), kind == "computing" or (is_computing and kind != "aside")
            if kind == "log":
                logging.getLogger(message[1]).log(message[2], "%s", message[3])
            elif kind == "warning":
                _, text, category, file, line = message
                warnings.warn_explicit(text, category, file, line, registry=_registry)
            elif kind not in {"computing", "aside"}:
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
        except Exception:  # noqa: BLE001 - it is closed, or an FMU has written into it: that may be anything
            raise Lost(self._obituary()) from None

    def _obituary(self) -> str:
        try:
            return how_it_ended(self._process.wait(LEAVING))
        except subprocess.TimeoutExpired:
            return "closed its connection, or wrote what is no answer into it, and was ended"

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
