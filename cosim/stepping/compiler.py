"""Compile the engine's functions with numba, once per machine, and the step functions that cannot be translated to C.

numba's disk cache neither notices edits in other files nor works for closures. So each function gets a small wrapper module in
the user's cache directory. Its *name* is a hash of everything its code depends on
(:mod:`bayesftc.cosim.stepping.fingerprint`). numba then caches the module's compiled form beside it.
"""

from __future__ import annotations

import builtins
import gc
import operator
import re
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from numba import cfunc, types
from numba.core.ccallback import CFunc
from numba.core.errors import NumbaError
from numba.extending import overload

from bayesftc.cosim.base.announcing import announced
from bayesftc.cosim.base.cache import cache_directory, is_own
from bayesftc.cosim.errors import BayesFTCError, KernelError
from bayesftc.cosim.stepping import numba_ops as _numba_ops
from bayesftc.cosim.stepping.fingerprint import (
    environment,
    fingerprint,
    functions_called,
    references,
    service_fingerprint,
    where,
)
from bayesftc.cosim.stepping.kept import STATISTICS, unwritable, write_whole
from bayesftc.cosim.stepping.source.tree import NoText, Sections, parameters

SIGNATURE = types.int32(types.int64, types.int64, types.int64, types.int64, types.float64, types.int64)
"""(state, parameters, inputs, outputs, t, k) -> status; the four addresses are passed as integers."""

# Older versions of numba use a source file's time stamp as its version; here the file's name is enough.
_STAMP = 1_000_000_000.0

_lock = threading.RLock()
_modules: dict[str, ModuleType] = {}
_latest_twin: WeakKeyDictionary[FunctionType, tuple[list[Any], FunctionType]] = WeakKeyDictionary()
_registered: set[FunctionType] = set()


def compile_by_numba(kernel: FunctionType, sections: Sections, why: KernelError) -> int:
    """Compile a step function as `compile_kernel` does, but by numba, or load it from the disk.

    Raises
    ------
    KernelError
        If numba cannot compile it: `why`, the reason against C.
    """
    body = _entry_text(kernel, sections)
    name = f"block_{kernel.__name__.strip('<>')[:40]}_{fingerprint(kernel, f'{environment()} {body}')}"
    with _lock:
        if name not in _modules:
            twins = _twins(functions_called(kernel))
            try:
                _load(name, body, {"kernel": twins[-1]}, twins)
            except NumbaError as error:
                raise (_refusal(kernel, error) if isinstance(why, NoText) else why) from None
        return int(_modules[name].entry.address)


def _twins(functions: list[FunctionType]) -> list[FunctionType]:
    """Return copies of functions, callees first, with the present values of the originals' globals and closures.

    numba keeps the code of every function it has seen. After a change of a global it would compile the old value again, and store
    that code under the new fingerprint.
    """
    twins: dict[FunctionType, FunctionType] = {}
    for function in functions:
        values = {name: twins.get(value, value) if callable(value) else value for name, value in references(function)}
        state = [function.__code__, function.__defaults__, function.__kwdefaults__, *values.values()]
        previous, twin = _latest_twin.get(function, ([], function))
        if len(previous) == len(state) and all(map(operator.is_, previous, state)):
            twins[function] = twin  # called by another block, too: numba need not compile it again
            continue
        closure = tuple(CellType(values[name]) for name in function.__code__.co_freevars)
        # Stored code refers to this module, which every process can import; a function made by exec has no such module.
        namespace = {"__name__": __name__, "__builtins__": builtins, **values}
        twin = FunctionType(function.__code__, namespace, function.__name__, function.__defaults__, closure or None)
        twin.__kwdefaults__ = function.__kwdefaults__
        twins[function] = twin
        _latest_twin[function] = state, twin
    return list(twins.values())


def compile_function(function: Any, signature: str, calls: Sequence[Any] = ()) -> Any:
    """Compile a service function of the engine for one numba signature, or load it from the disk.

    Parameters
    ----------
    function : function
        The function to compile, unchanged.
    signature : str
        The only signature of its calls, in numba's notation.
    calls : sequence of functions
        Plain functions that it calls, directly or not, such as those of `controllers._linalg`.
    """
    arguments = ", ".join(parameters(function))
    # Without numba's reference counts (_nrt): such functions borrow their arrays and allocate none. Atomic counting around each
    # call by address took 70 ns a step of the loop, five times as long as the rest of it.
    text = (
        f'from numba import njit\n\n@njit({signature!r}, error_model="numpy", nogil=True, cache=True, _nrt=False)\n'
        f"def entry({arguments}):\n    return kernel({arguments})\n"
    )
    return _load_service(function, text, calls).entry


def compile_raw(function: FunctionType) -> CFunc:
    """Compile a service function with the engine's signature (four addresses), or load it from the disk.

    Parameters
    ----------
    function : function
        Takes ``(state, parameters, inputs, outputs, t, k)`` and returns a status; compiled unchanged.

    Returns
    -------
    numba CFunc
        The engine calls its ``address``; keep the object as long as the address is used.
    """
    arguments = ", ".join(parameters(function))
    text = (
        "from numba import cfunc\nfrom bayesftc.cosim.stepping.compiler import SIGNATURE\n\n"
        f'@cfunc(SIGNATURE, error_model="numpy", cache=True)\ndef entry({arguments}):\n    return kernel({arguments})\n'
    )
    compiled: CFunc = _load_service(function, text).entry
    return compiled


def service_text(function: FunctionType, name: str) -> str:
    """Return a service function as `compile_raw` compiles it in LLVM's text format, with its entry named `name`."""
    compiled = cfunc(SIGNATURE, error_model="numpy")(function)
    text: str = compiled.inspect_llvm()
    # The entry does nothing but call the function, which numba does not let it include. (LLVM refuses an empty group.)
    text = re.sub(r"(?m)^(attributes .*)\bnoinline\b", r"\1nounwind", text)
    return text.replace(compiled.native_name, name)


def compile_callback(function: FunctionType, signature: str) -> CFunc:
    """Compile a service function as a C function of another signature, or load it from the disk.

    Parameters
    ----------
    function : function
        The callback of a C library; compiled unchanged.
    signature : str
        Its signature in numba's notation, as ``"int32(float64, int64)"``.

    Returns
    -------
    numba CFunc
        The library calls its ``address``; keep the object as long as the address is used.
    """
    arguments = ", ".join(parameters(function))
    text = (
        f'from numba import cfunc\n\n@cfunc({signature!r}, error_model="numpy", cache=True)\n'
        f"def entry({arguments}):\n    return kernel({arguments})\n"
    )
    compiled: CFunc = _load_service(function, text).entry
    return compiled


def _load_service(function: FunctionType, text: str, calls: Sequence[FunctionType] = ()) -> ModuleType:
    name = f"engine_{function.__name__}_{service_fingerprint(function, text)}"
    return _load(name, text, {"kernel": function}, [*calls, function])


def _entry_text(kernel: FunctionType, sections: Sections) -> str:
    names = parameters(kernel)
    arguments = []
    for name in names:
        if name in {"t", "k"}:
            arguments.append(name)
        else:
            section, offset, shape = sections[name]
            arguments.append(f"carray(as_floats({section} + {8 * offset}), {shape!r})")
    return (
        "from numba import carray, cfunc\n"
        "from bayesftc.cosim.stepping.by_address import as_floats\nfrom bayesftc.cosim.stepping.compiler import SIGNATURE\n\n"
        '@cfunc(SIGNATURE, cache=True, error_model="numpy")\n'
        "def entry(state, parameters, inputs, outputs, t, k):\n"
        f"    kernel({', '.join(arguments)})\n"
        "    return 0\n"
    )


def _load(name: str, text: str, namespace: dict[str, Any], functions: list[FunctionType]) -> ModuleType:
    with _lock:
        if name not in _modules:
            _register(functions)
            path = cache_directory("compiled") / f"{name}.py"
            _remove_foreign_files(path)
            _write_once(path, text)
            try:
                module = _execute(path, text, namespace)
            except OSError as error:
                _remove_numba_files(path)
                raise unwritable(path, error) from None
            except Exception:
                if not _remove_numba_files(path):
                    raise
                module = _execute(path, text, namespace)  # the cached files may have been damaged
            hits = _cache_hits(module.entry)
            STATISTICS["loaded" if hits else "compiled"] += 1
            _modules[name] = module
        return _modules[name]


def _execute(path: Path, text: str, namespace: dict[str, Any]) -> ModuleType:
    module = ModuleType(f"bayesftc_compiled_{path.stem}")
    module.__file__ = str(path)
    module.__dict__.update(namespace)
    sys.modules[module.__name__] = module  # numba finds the module by name while it compiles
    try:
        with _no_collection(), announced(not _numba_files(path)):
            exec(compile(text, str(path), "exec"), module.__dict__)  # generated here, the same text as in the file
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module


@contextmanager
def _no_collection() -> Iterator[None]:
    """Switch off garbage collection while numba creates many objects; it would take a seventh of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _remove_foreign_files(path: Path) -> None:
    """Remove a module's files if one of them belongs to another user: the folder may have been writable for others before."""
    beside = path.parent / "__pycache__"
    if beside.exists() and not is_own(beside):
        raise BayesFTCError(
            f"The folder {beside} belongs to another user, but its content would be run here. Remove it, or set BAYESFTC_CACHE "
            "to a folder of your own."
        )
    if not all(is_own(file) for file in (path, *_numba_files(path)) if file.exists()):
        _remove_numba_files(path)
        path.unlink(missing_ok=True)


def _numba_files(path: Path) -> list[Path]:
    return [*path.parent.glob(f"__pycache__/{path.stem}.*.nb[ic]")]


def _remove_numba_files(path: Path) -> bool:
    """Remove numba's files for a module; return whether there were any."""
    files = _numba_files(path)
    for file in files:
        file.unlink(missing_ok=True)
    return bool(files)


def _refusal(kernel: FunctionType, error: NumbaError) -> KernelError:
    """Return the error with numba's reason."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Failed in")]
    return KernelError(
        f"Step function {where(kernel)} cannot be compiled: {' '.join(lines[:3])} Write plain loops over float64 numbers, or set "
        "Definition(compiled=False) to run the diagram interpreted."
    )


def _cache_hits(entry: Any) -> bool:
    if isinstance(entry, CFunc):
        return bool(entry.cache_hits)
    return bool(sum(entry.stats.cache_hits.values()))


def _register(functions: list[FunctionType]) -> None:
    """Allow compiled code to call these plain functions by name."""
    for function in functions:
        if function not in _registered:
            overload(function, jit_options=_numba_ops.OPTIONS, strict=False)(
                lambda *arguments, implementation=function: implementation
            )
            _registered.add(function)


def _write_once(path: Path, text: str) -> None:
    """Write the source file of numba's cache, if it does not exist."""
    try:
        stat = path.stat()
        if (stat.st_size, stat.st_mtime) == (len(text.encode()), _STAMP):
            return
    except FileNotFoundError:
        pass
    write_whole(path, text.encode(), _STAMP)
