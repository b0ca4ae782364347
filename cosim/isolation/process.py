"""Starts, watches and ends the process of an isolated FMU."""

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
"""Seconds after which it is seen whether a process that does not answer is alive."""

SOON = 0.01
"""Seconds within which most answers come."""

LEAVING = 5.0
"""Seconds for a process to end by itself, or to vanish once it was killed."""


class WorkerProcess:
    """The process, the memory that is shared with it, and the two ways to talk to it.

    Parameters
    ----------
    inputs, outputs : int
        How many numbers are exchanged in a step.
    attention : float
        Seconds after which the receipt of an answer comes back empty, for someone to look after the process.

    Raises
    ------
    FMUError
        If this system cannot do it.
    """

    def __init__(self, inputs: int, outputs: int, attention: float):
        if sys.platform != "linux" or not can_start():
            raise FMUError(
                "isolate=True needs Linux and a Python that can be started as a program; leave it out, and the FMU runs in this "
                "process."
            )
        with contextlib.ExitStack() as opened:
            memory = os.memfd_create("bayesftc")
            opened.callback(os.close, memory)
            os.ftruncate(memory, protocol.size(inputs, outputs))
            self.shared = protocol.Shared(memory, inputs, outputs)
            self.steps, steps = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            opened.callback(steps.close)
            seconds, part = divmod(max(round(attention * 1e6), 1), 1_000_000)
            self.steps.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", seconds, part))
            ours, talk = socket.socketpair()
            for direction in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):  # once a message has begun, all of it comes
                ours.setsockopt(socket.SOL_SOCKET, direction, struct.pack("ll", int(LEAVING), 0))
            opened.callback(talk.close)
            self.talk = Connection(ours.detach())
            theirs = memory, steps.fileno(), talk.fileno()
            self._process, lifeline = start("bayesftc.cosim.isolation.worker:main", theirs)
        # Where nobody closes it. In a forked process, which runs what is registered as well, it is let go of (`_forked`).
        self._end = weakref.finalize(self, _end, self._process, self.talk, self.steps, lifeline)
        self.is_anothers = False
        """Whether a fork has made this a copy, in a process that has not started it."""
        _alive.add(self)

    @property
    def is_over(self) -> bool:
        """Whether it was ended."""
        return not self._end.alive

    @property
    def is_alive(self) -> bool:
        """Whether it runs, and is this process's own."""
        return not self.is_over and not self._is_dead()

    def wait(self, end: float) -> Collection[object]:
        """Return which of `talk` and `steps` can be read, as soon as one can; nothing if none can until `end`."""
        if self.is_anothers:
            return [self.steps]
        while True:
            left = max(end - time.monotonic(), 0.0)
            ready = wait([self.talk, self.steps], min(left, GLANCE))
            if ready or left == 0.0:
                return ready
            if self._is_dead():  # and something that the FMU has started holds the other ends open
                return [self.steps]

    def queued(self) -> float:
        """Return for how many seconds in all the process could not run, for others had the processors; 0 if nobody says."""
        try:
            with open(f"/proc/{self._process.pid}/schedstat", encoding="ascii") as file:
                return int(file.read().split()[1]) * 1e-9
        except (OSError, ValueError, IndexError):
            return 0.0

    def kill(self) -> None:
        """Kill the process and all that it has started, if it is this process's own."""
        if not self.is_anothers:
            kill_group(self._process)

    def obituary(self) -> str:
        """Return how the process ended, in words; it has closed its connections."""
        end = time.monotonic() + LEAVING
        while not self._is_dead():
            if time.monotonic() > end:
                self.kill()
                return "it closed its connections, or wrote what is no answer into them, and had to be ended"
            time.sleep(0.001)
        kill_group(self._process)  # what it has started, while its number is still its own
        code = self._process.wait()
        if code == protocol.LOST:
            return "its connections to this process were closed"
        if code >= 0:
            return f"it ended its own process with exit code {code}"
        return f"its process {how_it_ended(code)}"

    def _is_dead(self) -> bool:
        """Return whether the process has ended, which leaves it to be waited for."""
        try:
            return os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return True

    def end(self) -> None:
        """End the process at once, if it is not over, and give back all that it had."""
        self._end()
        _alive.discard(self)

    def let_go(self) -> None:
        """Take away this process's copies after a fork: the FMU belongs to the process that started it.

        Compiled code knows the socket by its number and the memory by its address. Both stay taken, by a socket that nobody
        hears and by memory of this process alone, so that what it does with them reaches neither that process nor a stranger.
        """
        self.is_anothers = True
        self._end.detach()
        self.talk.close()
        self.shared.part()
        deaf, gone = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        gone.close()
        os.dup2(deaf.fileno(), self.steps.fileno(), inheritable=False)
        deaf.close()


class Patience:
    """Waits for a process as long as it may take: time in which it was not given a processor does not count.

    Parameters
    ----------
    process : WorkerProcess
        Whose answer is awaited.
    limit : float
        Seconds that it may take.
    """

    def __init__(self, process: WorkerProcess, limit: float):
        self._process, self._end = process, time.monotonic() + limit
        self._queued: float | None = None

    def wait(self) -> Collection[object]:
        """Return what of the process can be read, see `WorkerProcess.wait`; nothing once its time is over."""
        if self._queued is None:  # most answers come before it is worth while to look at this
            ready = self._process.wait(min(self._end, time.monotonic() + SOON))
            if ready:
                return ready
            self._queued = self._process.queued()
        while True:
            ready = self._process.wait(self._end)
            more = self._process.queued() - self._queued
            if ready or more <= 0.0:
                return ready
            self._end += more
            self._queued += more


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
