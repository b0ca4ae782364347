"""Start and end of this package's child processes: they end with their host, and messages state how they ended."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable
from types import ModuleType

fcntl: ModuleType | None
resource: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows, where no process is started
    fcntl = None
try:
    import resource
except ImportError:
    resource = None

_BOOT = (
    "import sys; module, function, count = sys.argv[1], sys.argv[2], int(sys.argv[3]); arguments = sys.argv[4:][:count]; "
    "sys.path[:] = sys.argv[4 + count:]; "
    "from importlib import import_module; getattr(import_module(module), function)(*arguments)"
)
_open_lifelines: dict[int, Lifeline] = {}
"""The open lifelines of this process, by descriptor."""

_NAMES = {
    "SIGSEGV": "a segmentation fault",
    "SIGABRT": "abort()",
    "SIGFPE": "an arithmetic exception",
    "SIGILL": "an illegal instruction",
    "SIGBUS": "a bus error",
    "SIGKILL": "the system or a user",
}


def how_it_ended(code: int) -> str:
    """Return the meaning of a process's exit code as text: "was killed by a segmentation fault (SIGSEGV)"."""
    if code >= 0:
        return f"ended itself with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"was killed by signal {-code}"
    return f"was killed by {_NAMES.get(name, 'a signal')} ({name})"


def can_start() -> bool:
    """Return whether processes can be started: on Linux and macOS, if Python runs as a program."""
    return os.name == "posix" and bool(sys.executable)


_is_child = False


class Lifeline:
    """The end of a pipe; while this process keeps it open, the process at the other end runs.

    Each process needs its own pipe, as Linux signals the end of a pipe to one process only: the last one that requested it.
    """

    def __init__(self) -> None:
        self.other, self._own = os.pipe()
        _open_lifelines[self._own] = self

    def close(self) -> None:
        """Close the pipe, which ends the process at the other end."""
        if _open_lifelines.pop(self._own, None) is self:  # else a fork has closed it, and its number may be reused
            os.close(self._own)


def start(
    function: str, descriptors: Iterable[int] = (), arguments: Iterable[str] = ()
) -> tuple[subprocess.Popen[bytes], Lifeline]:
    """Start a program that calls a function of this package, in a separate process group, which Ctrl-C does not reach.

    Parameters
    ----------
    function : str
        As ``"package.module:function"``. Its arguments are strings: its lifeline (for `begin`), then the others.
    descriptors : iterable of int
        Descriptors that it inherits; their numbers are its next arguments.
    arguments : iterable of str
        Its last arguments.
    """
    lifeline = Lifeline()
    try:
        inherited = [lifeline.other, *descriptors]
        texts = [*map(str, inherited), *arguments]
        process = subprocess.Popen(
            [
                *(sys.executable, "-c", _BOOT, *function.split(":"), str(len(texts)), *texts),
                *map(os.path.abspath, sys.path),
            ],
            stdin=subprocess.DEVNULL,
            pass_fds=inherited,
            start_new_session=True,
        )
    except BaseException:
        lifeline.close()
        raise
    finally:
        os.close(lifeline.other)
    return process, lifeline


def has_host() -> bool:
    """Return whether `start` has started this process."""
    return _is_child


def begin(*descriptors: int) -> None:
    """Set up a process that `start` has started; the first descriptor is its lifeline, the others are inherited."""
    global _is_child
    _is_child = True
    for descriptor in descriptors:
        os.set_inheritable(descriptor, False)  # not for programs that this process starts
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the host handles Ctrl-C, and ends this process if necessary
    _die_with_host(descriptors[0])
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a group, and all processes that it has started, unless it was reaped already."""
    if process.returncode is None:  # else its number may have been reused
        for kill in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(process.pid, signal.SIGKILL)


def _die_with_host(lifeline: int) -> None:
    """Make the system kill this process and its group as soon as the host's end of a pipe is closed."""
    if fcntl is not None and hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgrp())  # including processes that it has started
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)  # works even during an endless step of an FMU
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
        poll = select.poll()  # unlike select, for descriptors with any number
        poll.register(lifeline, select.POLLIN)
        if poll.poll(0):
            os._exit(0)  # the host has already ended
        return

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(os.getpgrp(), signal.SIGKILL)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


def _forked() -> None:
    """Close the copies of lifelines in a forked process; else the end of the original process would not be noticed."""
    for descriptor in _open_lifelines:
        with contextlib.suppress(OSError):
            os.close(descriptor)
    _open_lifelines.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


__all__ = ["Lifeline", "begin", "can_start", "how_it_ended", "kill_group", "start"]
