"""The process of a worker: it gets a job from its host process, and runs piece after piece of it.

It reports when it begins to compute, so that the host can distinguish an FMU that hangs from compiling. It ends with its host.
"""

from __future__ import annotations

import logging
import os
import pickle
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from typing import Any, TextIO

from bayesftc.cosim.base.processes import begin
from bayesftc.cosim.errors import BayesFTCError

PULSE = 0.1
"""Seconds between two reports while runs are computed."""


def main(*descriptors: str) -> None:
    """Serve one job over the descriptors that the host has opened."""
    lifeline, connection = map(int, descriptors)
    begin(lifeline, connection)
    talk = Connection(connection)
    status = 0
    try:
        _serve(talk)
    except (EOFError, ConnectionError):  # the host has ended
        pass
    except BaseException:  # noqa: BLE001 - the host sees only that this process ended; print the reason
        traceback.print_exc()
        status = 70
    os._exit(status)  # at a regular exit, the library of an FMU could hang


def _serve(talk: Connection) -> None:
    try:
        job = pickle.loads(talk.recv_bytes())
    except Exception as error:  # noqa: BLE001 - unpickling may raise anything
        talk.send(("unusable", f"{type(error).__name__}: {error}"))
        return
    _forward(talk)
    signs = _Signs(talk)
    talk.send(("ready", getattr(job, "time_limit", None), hasattr(job, "failed")))
    while True:
        method, *arguments = talk.recv()
        try:
            if method == "run":
                signs.overhead()
                answer = (
                    job.run(*arguments, signs.keep_going, signs.overhead)
                    if hasattr(job, "failed")
                    else job.run(*arguments)
                )
            else:
                answer = getattr(job, method)(*arguments)
        except Exception as error:  # noqa: BLE001 - it is raised again in the host
            talk.send(("raised", _portable(error), traceback.format_exc()))
            continue
        send(talk, answer)


def send(talk: Connection, answer: Any) -> None:
    """Send an answer, without copying its arrays."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(answer, protocol=5, buffer_callback=buffers.append)
    views = [buffer.raw() for buffer in buffers]
    talk.send(("done", [view.nbytes for view in views]))
    talk.send_bytes(head)
    for view in views:
        if view.nbytes:
            talk.send_bytes(view)


def receive(talk: Connection, sizes: list[int]) -> Any:
    """Return an answer from `send`, after its first message was received."""
    head = talk.recv_bytes()
    buffers = [bytearray(size) for size in sizes]
    for buffer in buffers:
        if buffer:
            talk.recv_bytes_into(buffer)
    return pickle.loads(head, buffers=buffers)


class _Signs:
    """Reports to the host while a piece is done."""

    def __init__(self, talk: Connection):
        self._talk, self._last, self._is_overhead = talk, 0.0, False

    def keep_going(self) -> bool:
        now = time.monotonic()
        if self._is_overhead or now - self._last > PULSE:
            self._talk.send(("computing",))
            self._last, self._is_overhead = now, False
        return True  # to stop, the host ends this process

    def overhead(self) -> None:
        if not self._is_overhead:
            self._talk.send(("overhead",))
            self._is_overhead = True


def _forward(talk: Connection) -> None:
    """Send log messages and warnings to the host, whose settings determine what is shown."""

    class Forward(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            talk.send(("log", record.name, record.levelno, record.getMessage()))

    log = logging.getLogger("bayesftc")
    log.setLevel(logging.INFO)
    log.propagate = False
    log.addHandler(Forward())

    def warn(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        portable = category if category.__module__ == "builtins" else UserWarning
        talk.send(("warning", str(message), portable, filename, lineno))

    warnings.showwarning = warn


def _portable(error: Exception) -> Exception:
    """Return an error that can be pickled: the error itself, or an error with its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - pickling a user's error may raise anything
        return BayesFTCError(f"{type(error).__name__}: {error}")
    return error


__all__ = ["main", "receive", "send"]
