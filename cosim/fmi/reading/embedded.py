"""FMUs of PythonFMU, whose model runs in the Python interpreter of this process.

Their binary imports the FMU's Python files by name into this interpreter. If two FMUs have a file of the same name, the second
would run the code of the first. The same holds for two versions of an FMU, and for an FMU and the script that built it. Each
instance also puts its folder in front of ``sys.path``, where it hides the user's modules.
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
_modules_of: dict[Path, dict[str, ModuleType]] = {}


@contextmanager
def in_this_python(resources: Path, binary: Any) -> Iterator[None]:
    """Instantiate an FMU in this context: it imports its own Python files, and the user's modules stay.

    The FMU's folder is moved to the end of ``sys.path``, once, for later imports. The binary releases its Python objects before
    the process ends. Else it would free them twice, which aborts some processes.
    """
    if not (resources / "slavemodule.txt").is_file():
        yield
        return
    with _lock:
        if resources not in _modules_of and hasattr(binary, "finalizePythonInterpreter"):
            atexit.register(binary.finalizePythonInterpreter)
        files = (*resources.glob("*.py"), *resources.glob("*/__init__.py"))
        names = {file.parent.name if file.name == "__init__.py" else file.stem for file in files}
        names -= {"pythonfmu", "pythonfmu3"}
        path, others = list(sys.path), _remove_modules(names)
        sys.modules.update(_modules_of.get(resources, {}))
        try:
            yield
        finally:
            _modules_of[resources] = _remove_modules(names)
            sys.modules.update(_modules_of[resources] | others)
            sys.path[:] = [*path, *dict.fromkeys(folder for folder in sys.path if folder not in path)]


def in_use() -> bool:
    """Return whether the model of an FMU has run in this Python interpreter."""
    return bool(_modules_of)


@contextmanager
def interrupts() -> Iterator[list[int]]:
    """Record each Ctrl-C: an interrupt raised in an FMU's Python code is only an error of the FMU to its binary."""
    signals: list[int] = []
    is_main = in_use() and threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield signals
        return

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield signals
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _remove_modules(names: Container[str]) -> dict[str, ModuleType]:
    """Remove the modules of these names, and their submodules, from ``sys.modules``; return them."""
    loaded = [name for name in sys.modules if name.partition(".")[0] in names]
    return {name: sys.modules.pop(name) for name in loaded}
