"""FMUs whose model runs in the Python of this process, as PythonFMU makes them, and what they share in it.

Their binary imports the FMU's Python files by name into the interpreter that is there. So of two FMUs with a file of one name,
of two versions of one FMU, or of an FMU and the script from which it was just made, the second would run the code of the first;
and each instance puts its folder once more in front of ``sys.path``, where it hides the user's own modules.
"""

from __future__ import annotations

import atexit
import signal
import sys
import threading
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

_lock = threading.RLock()
_own: dict[Path, dict[str, ModuleType]] = {}


@contextmanager
def in_this_python(resources: Path, binary: Any) -> Iterator[None]:
    """Let an FMU be instantiated that may import Python files of its own: it finds these, and the user's modules stay.

    Its folder goes to the end of ``sys.path``, once, for what it imports later. What the binary holds of Python it lets go of
    before the process ends, for after that it would free it twice, which ends some processes with an abort.
    """
    if not (resources / "slavemodule.txt").is_file():
        yield
        return
    with _lock:
        if resources not in _own and hasattr(binary, "finalizePythonInterpreter"):
            atexit.register(binary.finalizePythonInterpreter)
        files = (*resources.glob("*.py"), *resources.glob("*/__init__.py"))
        names = {file.parent.name if file.name == "__init__.py" else file.stem for file in files}
        names -= {"pythonfmu", "pythonfmu3"}
        path, others = list(sys.path), _taken_out(names)
        sys.modules.update(_own.get(resources, {}))
        try:
            yield
        finally:
            _own[resources] = _taken_out(names)
            sys.modules.update(_own[resources] | others)
            sys.path[:] = [*path, *dict.fromkeys(folder for folder in sys.path if folder not in path)]


@contextmanager
def interrupts() -> Iterator[list[int]]:
    """Note each Ctrl-C: one that is raised in an FMU's Python is no more than an error of the FMU to its binary."""
    heard: list[int] = []
    usual = _own and threading.current_thread() is threading.main_thread()
    if not usual or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield heard
        return

    def note(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield heard
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _taken_out(names: Container[str]) -> dict[str, ModuleType]:
    """Return the modules of these names, and those within them, which Python then knows no more."""
    found = [name for name in sys.modules if name.partition(".")[0] in names]
    return {name: sys.modules.pop(name) for name in found}
