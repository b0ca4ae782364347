"""Start, watch and end the process of an isolated FMU."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import subprocess
import sys
import time
import weakref
from collections.abc import Collection
from multiprocessing.connection import Connection, wait

from bayesftc.cosim.base.processes import Lifeline, can_start, how_it_ended, kill_group, start
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.isolation import protocol

GLANCE = 0.5
"""Seconds between checks whether a process that does not answer is alive."""

SOON = 0.01
"""Seconds in which most answers arrive."""

LEAVING = 5.0
"""Seconds for a process to end by itself, or after it was killed."""


class WorkerProcess:
    """The process, its shared memory, and the two connections to it.

    Parameters
    ----------
    inputs, outputs : int
        Numbers of inputs and outputs, which are exchanged in each step.
    attention : float
        Seconds after which waiting for an answer is interrupted to check the process.

    Raises
    ------
    FMUError
        If this system does not support isolation.
    """

    def __init__(self, inputs: int, outputs: int, attention: float):
        if sys.platform != "linux" or not can_start():
            raise FMUError(
                "isolate=True needs Linux and a Python that can be started as a program. Leave it out to run the FMU in this "
                "process."
            )
        with contextlib.ExitStack() as opened:
            memory = os.memfd_create("bayesftc")
            opened.callback(os.close, memory)
            os.ftruncate(memory, protocol.size(inputs, outputs))
            self.shared = protocol.Shared(memory, inputs, outputs)
            self.steps, steps = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            opened.callback(steps.close)
            seconds, microseconds = divmod(max(round(attention * 1e6), 1), 1_000_000)
            self.steps.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", seconds, microseconds))
            host_socket, talk = socket.socketpair()
            for direction in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):  # a message that has begun arrives completely
                host_socket.setsockopt(socket.SOL_SOCKET, direction, struct.pack("ll", int(LEAVING), 0))
            opened.callback(talk.close)
            self.talk = Connection(host_socket.detach())
            descriptors = memory, steps.fileno(), talk.fileno()
            self._process, lifeline = start("bayesftc.cosim.isolation.worker:main", descriptors)
        # Ends the process if it is not closed. A forked process would run this, too, and so detaches it (`_forked`).
        self._end = weakref.finalize(self, _end, self._process, self.talk, self.steps, lifeline)
        self.is_anothers = False
        """Whether this is a copy, made by a fork, in a process that has not started it."""
        _alive.add(self)

    @property
    def is_over(self) -> bool:
        """Whether it was ended."""
        return not self._end.alive

    @property
    def is_alive(self) -> bool:
        """Whether it runs, and this process has started it."""
        return not self.is_over and not self._is_dead()

    def wait(self, end: float) -> Collection[object]:
        """Wait until `talk` or `steps` can be read, at most until `end`; return those that can."""
        if self.is_anothers:
            return [self.steps]
        while True:
            left = max(end - time.monotonic(), 0.0)
            ready = wait([self.talk, self.steps], min(left, GLANCE))
            if ready or left == 0.0:
                return ready
            if self._is_dead():  # but a process that the FMU has started holds the other ends open
                return [self.steps]

    def queued(self) -> float:
        """Return the total time in seconds in which the process waited for a processor; 0 if not known."""
        try:
            with open(f"/proc/{self._process.pid}/schedstat", encoding="ascii") as file:
                return int(file.read().split()[1]) * 1e-9
        except (OSError, ValueError, IndexError):
            return 0.0

    def kill(self) -> None:
        """Kill the process and all processes that it has started, unless this is a forked copy."""
        if not self.is_anothers:
            kill_group(self._process)

    def obituary(self) -> str:
        """Return how a process that has closed its connections ended, as text."""
        end = time.monotonic() + LEAVING
        while not self._is_dead():
            if time.monotonic() > end:
                self.kill()
                return "it closed its connections, or wrote invalid data into them, and was ended"
            time.sleep(0.001)
        kill_group(self._process)  # processes that it has started, before its number can be reused
        code = self._process.wait()
        if code == protocol.LOST:
            return "its connections to this process were closed"
        if code >= 0:
            return f"it ended its own process with exit code {code}"
        return f"its process {how_it_ended(code)}"

    def _is_dead(self) -> bool:
        """Return whether the process has ended, without reaping it."""
        try:
            return os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return True

    def end(self) -> None:
        """End the process at once, if it runs, and free its resources."""
        self._end()
        _alive.discard(self)

    def let_go(self) -> None:
        """Replace this process's copies of the connections after a fork: the FMU belongs to the process that started it.

        Compiled code uses the socket by its number and the memory by its address. Both are replaced, by an unconnected socket
        and by private memory, so that using them affects neither the FMU's process nor unrelated files.
        """
        self.is_anothers = True
        self._end.detach()
        self.talk.close()
        self.shared.part()
        unconnected, peer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        peer.close()
        os.dup2(unconnected.fileno(), self.steps.fileno(), inheritable=False)
        unconnected.close()


class Patience:
    """A time limit for answers of a process; time in which the process waits for a processor does not count.

    Parameters
    ----------
    process : WorkerProcess
        The process.
    limit : float
        Time limit in seconds.
    """

    def __init__(self, process: WorkerProcess, limit: float):
        self._process, self._end = process, time.monotonic() + limit
        self._queued: float | None = None

    def wait(self) -> Collection[object]:
        """Wait for an answer, see `WorkerProcess.wait`; return nothing if the time limit is exceeded."""
        if self._queued is None:  # most answers come so soon that reading this is not worth while
            ready = self._process.wait(min(self._end, time.monotonic() + SOON))
            if ready:
                return ready
            self._queued = self._process.queued()
        while True:
            ready = self._process.wait(self._end)
            newly_queued = self._process.queued() - self._queued
            if ready or newly_queued <= 0.0:
                return ready
            self._end += newly_queued
            self._queued += newly_queued


_alive: weakref.WeakSet[WorkerProcess] = weakref.WeakSet()


def _forked() -> None:
    for process in tuple(_alive):
        process.let_go()
    _alive.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _end(process: subprocess.Popen[bytes], talk: Connection, steps: socket.socket, lifeline: Lifeline) -> None:
    talk.close()
    steps.close()
    kill_group(process)
    lifeline.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(LEAVING)
