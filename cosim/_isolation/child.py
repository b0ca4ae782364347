"""What all processes that this package starts have in common: they die with who has started them, and it is said how."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading

try:
    import fcntl
    import select
except ImportError:  # not on Windows, where none is started
    pass

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


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a group of its own, and all that it has started, unless it was waited for already."""
    if process.returncode is None:  # else its number may be another's by now
        for kill in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(process.pid, signal.SIGKILL)


def die_with_host(lifeline: int) -> None:
    """Have this process, which leads a group, killed as soon as the other end of a pipe is closed, whatever it is doing then."""
    if hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgrp())  # with all that it may have started
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)  # needs no cooperation of an FMU in an endless step
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
        if select.select([lifeline], [], [], 0)[0]:
            os._exit(0)  # it was gone before
        return

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(os.getpgrp(), signal.SIGKILL)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


__all__ = ["die_with_host", "how_it_ended", "kill_group"]
