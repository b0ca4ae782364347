"""The engine's own functions as machine code: a process loads it without numba, whose import takes most of its start.

The package has their text in LLVM's format (`shipped`), else numba makes it; LLVM makes an object file of that, and the cache
folder keeps it. The file's name has a hash of the source files, so that it is found before the functions are imported.
"""

from __future__ import annotations

import hashlib
import os
import platform
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import util
from pathlib import Path
from types import FunctionType

import llvmlite
import llvmlite.binding as llvm

from bayesftc._interrupt import import_whole
from bayesftc.cosim.base.announcing import announced
from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.stepping.kept import STATISTICS, read_own, write_whole
from bayesftc.cosim.stepping.machine.code import closed_code, features, load, opened, sealed
from bayesftc.cosim.stepping.machine.shipped import ROOT, digest_of, shipped_text

_lock = threading.RLock()
_addresses: dict[str, int] = {}


_SOURCES_DIGEST = digest_of(sorted(ROOT.rglob("*.py")))
"""A hash of the files with all that the functions use, when this is loaded; they may be edited later."""


def service_address(name: str, find: Callable[[], FunctionType]) -> int:
    """Return the address of a service function, which takes ``(state, parameters, inputs, outputs, t, k)``.

    Parameters
    ----------
    name : str
        A name that no other service function has.
    find : callable
        Imports the function and returns it; called if there is no machine code for it yet.
    """
    with _lock:
        if name not in _addresses:
            _addresses[name] = _found(f"service_{name}", find)
        return _addresses[name]


def service_at(address: int) -> str:
    """Return the name of the service function at an address, if its text can be included elsewhere; else nothing."""
    with _lock:
        names = [f"service_{name}" for name, known in _addresses.items() if known == address]
    return next(filter(known_text, names), "")


@cache
def known_text(name: str) -> str:
    """Return the text of a service function; nothing if the package has none, or one of a newer LLVM."""
    text = shipped_text(name)
    with suppress(RuntimeError):
        if text and llvm.parse_assembly(text, llvm.create_context()):
            return text
    return ""


def _found(name: str, find: Callable[[], FunctionType]) -> int:
    path = cache_directory("compiled") / f"{name}_{hashlib.sha256(_environment().encode()).hexdigest()[:24]}.o"
    content = read_own(path)
    code = None if content is None else opened(content)
    STATISTICS["compiled" if code is None else "loaded"] += 1
    if code is None:
        with announced(True):
            code = _compiled(name, find)
        write_whole(path, sealed(code))
    return load(code, name) if code else _by_numba(find)


def _compiled(name: str, find: Callable[[], FunctionType]) -> bytes:
    if text := shipped_text(name):
        with suppress(RuntimeError):  # an older LLVM may not know the text of a newer one
            return closed_code(text, name)
    return closed_code(_numbas_text(find, name), name)


def _numbas_text(find: Callable[[], FunctionType], name: str) -> str:
    import_whole("bayesftc.cosim.stepping.compiler")

    from bayesftc.cosim.stepping.compiler import service_text

    return service_text(find(), name)


def _by_numba(find: Callable[[], FunctionType]) -> int:
    import_whole("bayesftc.cosim.stepping.compiler")

    from bayesftc.cosim.stepping.compiler import compile_raw

    return int(compile_raw(find()).address or 0)


def _environment() -> str:
    """Return what the machine code depends on: versions, numba's settings, the processor, and the source files."""
    numba = util.find_spec("numba")  # its version, without the import
    version = Path(numba.origin).with_name("_version.py").read_text() if numba and numba.origin else ""
    settings = sorted(f"{key}={value}" for key, value in os.environ.items() if key.startswith("NUMBA_"))
    parts = [platform.python_version(), llvmlite.__version__, version, *settings, llvm.get_process_triple()]
    return "|".join([*parts, llvm.get_host_cpu_name(), features(wide=True), _SOURCES_DIGEST])
