"""What all processes that this package starts have in common: they die with their host, and a sentence says how they ended."""

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
_held: dict[int, Lifeline] = {}
"""The lifelines that this process holds, by their descriptors."""

_NAMES = {
    "SIGSEGV": "a segmentation fault",
    "SIGABRT": "abort()",
    "SIGFPE": "an arithmetic exception",
    "SIGILL": "an illegal instruction",
    "SIGBUS": "a bus error",
    "SIGKILL": "the system or someone else",
}


def how_it_ended(code: int) -> str:
    """Return in words what an exit code says of a process: "was killed by a segmentation fault (SIGSEGV)"."""
    if code >= 0:
        return f"ended itself with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        return f"was killed by signal {-code}"
    return f"was killed by {_NAMES.get(name, 'a signal')} ({name})"


def can_start() -> bool:
    """Return whether processes can be started here: on Linux and macOS, from a Python that is a program."""
    return os.name == "posix" and bool(sys.executable)


_is_child = False


class Lifeline:
    """The end of a pipe that this process holds as long as another one is to live.

    Each process needs one of its own. Linux tells only one process of a pipe's end: the last that asked.
    """

    def __init__(self) -> None:
        self.other, self._own = os.pipe()
        _held[self._own] = self

    def close(self) -> None:
        """Let go of it, which ends the process at the other end."""
        if _held.pop(self._own, None) is self:  # else a fork has closed it, and the number may be another's
            os.close(self._own)


def start(
    function: str, descriptors: Iterable[int] = (), arguments: Iterable[str] = ()
) -> tuple[subprocess.Popen[bytes], Lifeline]:
    """Start a program that calls a function of this package, in a group of its own, out of reach of Ctrl-C.

    Parameters
    ----------
    function : str
        As ``"package.module:function"``. Its arguments are texts: its lifeline, for `begin`, then the others.
    descriptors : iterable of int
        Which it inherits; their numbers are its next arguments.
    arguments : iterable of str
        Its last ones.
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
    """Return whether this process is a program that `start` has started."""
    return _is_child


def begin(*descriptors: int) -> None:
    """Begin as a program that `start` has started; the first descriptor is its lifeline, the others are those it inherits."""
    global _is_child
    _is_child = True
    for descriptor in descriptors:
        os.set_inheritable(descriptor, False)  # programs that are started from here have no business with them
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the host's, which ends this process as it sees fit
    _die_with_host(descriptors[0])
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a group of its own, and all that it has started, unless it was waited for already."""
    if process.returncode is None:  # else its number may be another's by now
        for kill in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(process.pid, signal.SIGKILL)


def _die_with_host(lifeline: int) -> None:
    """Have this process, which leads a group, killed as soon as the host's end of a pipe is closed, whatever it is doing then."""
    if fcntl is not None and hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgrp())  # with all that it may have started
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)  # needs no cooperation of an FMU in an endless step
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
        gone = select.poll()  # unlike select, of descriptors of any number
        gone.register(lifeline, select.POLLIN)
        if gone.poll(0):
            os._exit(0)  # it was gone before
        return

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(os.getpgrp(), signal.SIGKILL)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


def _forked() -> None:
    """Let go of what is the forked process's: as long as it held the lifelines too, no death of that one would be noticed."""
    for descriptor in _held:
        with contextlib.suppress(OSError):
            os.close(descriptor)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


__all__ = ["Lifeline", "begin", "can_start", "how_it_ended", "kill_group", "start"]
