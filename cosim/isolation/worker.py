"""The process of an isolated FMU: creates the instance, and steps it on commands of the host.

It ends with its host, whatever the FMU is doing: the kernel kills it when the other end of a pipe is closed.
"""

from __future__ import annotations

import ctypes
import errno
import logging
import os
import pickle
import select
import socket
import threading
import time
import traceback
from contextlib import suppress
from fractions import Fraction
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from bayesftc.cosim.base.processes import begin
from bayesftc.cosim.block import External, ExternalBlock
from bayesftc.cosim.errors import BayesFTCError, FMUError
from bayesftc.cosim.fmi.reading import messages
from bayesftc.cosim.isolation import protocol
from bayesftc.cosim.isolation.turns import Turns
from bayesftc.cosim.types import ENTRY

_LOST = {errno.EPIPE, errno.ECONNRESET, errno.EBADF, errno.ENOTSOCK}

LINE_BUFFERED = 1
"""C's _IOLBF."""

HEARING = 1.0
"""Most seconds to wait, after an FMU is freed, until its printed output is logged."""

QUICK = 2e-4
"""Most seconds of a step, with the host's work between steps, for which the FMU's process chooses its processor."""


def main(*descriptors: str) -> None:
    """Run one FMU for the host, over the descriptors that the host has opened."""
    lifeline, memory, step_socket, connection = map(int, descriptors)
    begin(lifeline, memory, step_socket, connection)
    talk = Connection(connection)
    steps = socket.socket(fileno=step_socket)
    status = 0
    try:
        import bayesftc.cosim.fmi.fmu  # noqa: F401 - imported before the FMU's time limit begins

        talk.send(("done", None))
        status = _Worker(memory, steps, talk, *talk.recv()).run()
    except BaseException as error:  # noqa: BLE001 - every error is reported to the host
        if isinstance(error, EOFError) or (isinstance(error, OSError) and error.errno in _LOST):
            status = protocol.LOST
        else:
            traceback.print_exc()
            status = 70
    os._exit(status)  # the FMU's library could hang at a regular exit


class _Forward(logging.Handler):
    """Send log records to the host."""

    def __init__(self, talk: Connection, shared: protocol.Shared):
        super().__init__()
        self._talk, self._shared = talk, shared

    def emit(self, record: logging.LogRecord) -> None:
        is_line = record.name == messages.logger.name and isinstance(record.args, tuple) and len(record.args) == 2
        line = record.args[1] if is_line else None  # type: ignore[index]
        self.send(("log", record.name, record.levelno, record.getMessage(), line))
        self._shared.words[protocol.LOGGED] = 1  # the host checks this after the step

    def send(self, message: tuple[Any, ...]) -> None:
        """Send a whole message: an FMU may log from its own threads while an answer is sent."""
        self.acquire()
        try:
            self._talk.send(message)
        finally:
            self.release()


def _caught_output() -> int:
    """Redirect everything printed in this process, in any language, into a pipe; return its other end."""
    reading, writing = os.pipe()
    for descriptor in (1, 2):
        os.dup2(writing, descriptor)
    os.close(writing)
    with suppress(OSError, ValueError):  # C would buffer whole pages for a pipe, and lose them in a crash
        library = ctypes.CDLL(None)
        library.setvbuf(ctypes.c_void_p.in_dll(library, "stdout"), None, LINE_BUFFERED, 0)
    return reading


class _Worker:
    """One instance, and the loop that steps it."""

    def __init__(
        self,
        memory: int,
        steps: socket.socket,
        talk: Connection,
        block: ExternalBlock,
        step: Fraction,
        name: str,
    ):
        self._steps, self._talk = steps, talk
        self._block, self._step, self._name = block, step, name
        counts = (sum(port.size for port in ports) for ports in (block.inputs, block.outputs))
        self._shared = protocol.Shared(memory, *counts)
        self._shared.keep_from_children()
        self._reads_ahead = block.timing == "plant"
        self._serve: Any = None
        self._saved: dict[int, Any] = {}
        self._instance: External | None = None
        log = logging.getLogger("bayesftc")
        log.setLevel(logging.DEBUG)
        log.propagate = False
        self._forward = _Forward(talk, self._shared)
        log.addHandler(self._forward)
        self._printed, self._overhearing, self._rest = _caught_output(), threading.Lock(), b""
        self._listener = threading.Thread(target=self._overhear, daemon=True)
        self._listener.start()

    def _overhear(self) -> None:
        """Log what the FMU prints, line by line, until it closes its output."""
        with suppress(OSError):  # an FMU may close this process's descriptors, and the host may end
            while self._is_printed(wait=None):
                with self._overhearing:
                    piece = os.read(self._printed, messages.LENGTH)
                    if not piece:
                        return
                    *lines, self._rest = (self._rest + piece).split(b"\n")
                    if len(self._rest) >= messages.LENGTH:
                        lines, self._rest = [*lines, self._rest], b""
                    for line in lines:
                        self._log(line)

    def _hear_out(self) -> None:
        """Wait until everything that the FMU has printed is logged: the logging thread may be late on a busy machine."""
        end = time.monotonic() + HEARING
        while self._listener.is_alive() and time.monotonic() < end:
            with self._overhearing:
                if not self._is_printed(wait=0):
                    break
            time.sleep(0.001)
        with self._overhearing:
            if self._rest:  # an unfinished last line, which must not become part of the next instance's lines
                self._log(self._rest)
            self._rest = b""

    def _log(self, line: bytes) -> None:
        messages.logger.info("%s: %s", self._name, line.decode("utf-8", errors="replace").rstrip())

    def _is_printed(self, wait: float | None) -> bool:
        with suppress(OSError, ValueError):  # an FMU may close this process's descriptors
            return bool(select.select([self._printed], [], [], wait)[0])
        return False

    def run(self) -> int:
        """Answer until the host has ended; return the exit code."""
        allowed = os.sched_getaffinity(0)
        while True:
            self._answer(self._open)
            while self._instance is not None:
                command = self._serve() if self._serve else self._await_talk()
                if command == protocol.TALK:
                    what, *arguments = self._talk.recv()
                    self._answer(getattr(self, f"_do_{what}"), *arguments)
                elif command == protocol.GONE:
                    return protocol.LOST
            self._block, self._step, self._name = self._talk.recv()  # the next instance, of the same FMU
            self._serve, self._saved = None, {}
            os.sched_setaffinity(0, allowed)

    def _answer(self, function: Any, *arguments: Any) -> None:
        message: tuple[Any, ...]
        try:
            message = "done", function(*arguments)
        except BayesFTCError as error:
            message = "refused", type(error).__name__, str(error)
        self._forward.send(message)

    def _open(self) -> dict[str, Any]:
        words = self._shared.words
        words[protocol.PHASE] = protocol.STARTING
        instance = self._instance = self._block.instantiate(self._step, self._name)
        words[protocol.PHASE] = protocol.IDLE
        can_resize = bool(getattr(instance, "can_resize", False)) and getattr(instance, "step_word", 0) > 0
        own_inputs = getattr(instance, "own_inputs", {})
        rounding = getattr(instance, "rounding", None)
        wide = rounding.wide_outputs if rounding is not None else ()
        return {"can_save": instance.can_save, "can_resize": can_resize, "own_inputs": own_inputs, "wide": wide}

    def _await_talk(self) -> int:
        """Return a command that comes before the first step, when compiled code is not yet loaded."""
        return int(self._shared.words[protocol.COMMAND]) if self._steps.recv(protocol.MESSAGE) else protocol.GONE

    def _do_compile(self) -> None:
        """Load the compiled loop, for steps."""
        self._serve = _CompiledLoop(self._running, self._shared, self._steps, self._step, self._reads_ahead)

    def _do_expect_return(self) -> None:
        self._running.expect_return()

    def _do_let_round(self, names: tuple[str, ...]) -> None:
        self._running.rounding.let_round(names)  # type: ignore[attr-defined]

    def _do_rounded(self) -> tuple[str, ...]:
        names: tuple[str, ...] = self._running.rounding.rounded_outputs()  # type: ignore[attr-defined]
        return names

    def _do_explain(self, status: int) -> tuple[str, bool]:
        if self._instance is None:
            return "", False
        return self._instance.explain(status), self._instance.has_ended

    def _do_close(self) -> None:
        instance, self._instance = self._instance, None
        if instance is not None:
            instance.close()
            self._hear_out()

    def _do_save(self, token: int) -> None:
        self._saved[token] = self._running.save()

    def _do_restore(self, state: int | bytes) -> None:
        self._running.restore(self._saved[state] if isinstance(state, int) else pickle.loads(state))
        self._shared.words[protocol.AHEAD] = 0

    def _do_forget(self, token: int) -> None:
        self._running.forget(self._saved.pop(token))

    def _do_pickle(self, token: int) -> bytes:
        return pickle.dumps(self._saved[token])

    @property
    def _running(self) -> External:
        if self._instance is None:
            raise FMUError(f"The instance {self._name!r} is closed.")
        return self._instance


class _CompiledLoop:
    """The compiled loop over commands, and on which processor it runs.

    To wake a process takes many times as long as a step of most FMUs. So host and FMU look at the memory that they share, each
    on a processor of its own. On a busy machine they would wait for processors: then both use the same one, and wake each other.
    An FMU with longer steps may use all processors, as it may have its own threads.
    """

    def __init__(
        self, instance: External, shared: protocol.Shared, steps: socket.socket, step: Fraction, reads_ahead: bool
    ):
        from bayesftc.cosim.isolation.compiled import address

        words = [
            *protocol.system_functions(),
            steps.fileno(),
            shared.words.ctypes.data,
            shared.inputs.size,
            instance.update_address,
            instance.output_address,
            instance.table.ctypes.data,
            reads_ahead,
            step.numerator,
            step.denominator,
            getattr(instance, "step_word", 0),
            protocol.ANYWHERE,
        ]
        self._table = np.array(words, dtype=np.int64)
        self._entry = ENTRY(address("serve"))
        self._shared, self._steps = shared, steps
        self._everywhere, self._paused = os.sched_getaffinity(0), time.monotonic()
        self._slept, self._turns = 0, Turns(len(self._everywhere))

    def __call__(self) -> int:
        """Answer steps until another command comes; return it, or why there is none."""
        while True:
            reason: int = self._entry(0, self._table.ctypes.data, 0, 0, 0.0, 0)
            if reason == protocol.ELSEWHERE:
                self._move()
            elif reason == protocol.PAUSED:
                now = time.monotonic()
                self._choose(now - self._paused < QUICK * protocol.PAUSE)
                self._paused = now
            elif reason == protocol.SIGNALLED:
                self._steps.getsockopt(socket.SOL_SOCKET, socket.SO_TYPE)  # raises an error if the FMU has closed it
            else:
                return reason

    def _choose(self, is_quick: bool) -> None:
        """Choose where to run for the next commands, from how long the last ones took and how often somebody slept."""
        words, before = self._shared.words, self._table[-1]
        total = int(words[protocol.HOST_SLEPT] + words[protocol.WORKER_SLEPT])
        home = self._turns.next(is_quick, total - self._slept)
        self._slept = total
        if home == protocol.ANYWHERE and before != protocol.ANYWHERE:
            os.sched_setaffinity(0, self._everywhere)
        words[protocol.LOOKS] = protocol.MOST_LOOKS if home == protocol.APART else 0
        self._table[-1] = home

    def _move(self) -> None:
        """Go to the processor of the host, or away from it."""
        host = {int(self._shared.words[protocol.PROCESSOR])}
        is_apart = self._table[-1] == protocol.APART
        os.sched_setaffinity(0, (self._everywhere - host or self._everywhere) if is_apart else host)
