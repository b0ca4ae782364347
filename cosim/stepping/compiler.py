"""Compiles step functions to C functions with one signature, once per machine.

Every compiled block is ``int32 f(state, parameters, inputs, outputs, t, k)``: four addresses of float64 arrays, the time in
seconds and the block's integer step count. numba's own disk cache neither notices edits in other files nor hits for closures,
so each block gets a small wrapper module in the user's cache directory whose *name* is a hash of everything its code depends
on (:mod:`bayesftc.cosim.stepping.fingerprint`); numba then caches that module's compiled form beside it.
"""

from __future__ import annotations

import builtins
import gc
import operator
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from llvmlite import ir
from numba import types
from numba.core.ccallback import CFunc
from numba.core.errors import NumbaError
from numba.extending import intrinsic, overload

from bayesftc.cosim.base.cache import cache_directory, is_own
from bayesftc.cosim.errors import BayesFTCError, KernelError
from bayesftc.cosim.stepping import numba_ops as _numba_ops
from bayesftc.cosim.stepping.fingerprint import (
    depends_on,
    fingerprint,
    functions_called,
    references,
    service_fingerprint,
    where,
)
from bayesftc.cosim.types import Kernel

SIGNATURE = types.int32(types.int64, types.int64, types.int64, types.int64, types.float64, types.int64)
"""(state, parameters, inputs, outputs, t, k) -> status; the four addresses travel as integers."""

KERNEL_SIGNATURE = types.int32(*[types.CPointer(types.float64)] * 4, types.float64, types.int64)
"""The same for what is compiled from a step function: to whoever calls it by address, a pointer is an integer."""

LARGE = 16
"""Rows and columns of a matrix from which vector instructions gain more than what LLVM finds out about aliases."""

STATISTICS = {"compiled": 0, "loaded": 0}
"""How many functions this process has compiled, and how many came ready from the disk."""

# Older versions of numba take the time stamp of a source file for its version; here the file's name says it all.
_STAMP = 1_000_000_000.0

_lock = threading.RLock()
_modules: dict[str, ModuleType] = {}
_kernels: WeakKeyDictionary[FunctionType, dict[str, tuple[list[Any], int]]] = WeakKeyDictionary()
_latest_twin: WeakKeyDictionary[FunctionType, tuple[list[Any], FunctionType]] = WeakKeyDictionary()
_registered: set[FunctionType] = set()


@intrinsic
def as_floats(typingctx, address):
    """Return the float64 array that begins at an integer address."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), codegen


@intrinsic
def floats(typingctx, section, offset):
    """Return the float64 array that begins at a place in a section of memory: LLVM then knows what lies beside it."""

    def codegen(context, builder, signature, args):
        return builder.gep(args[0], [args[1]])

    return section(section, types.int64), codegen


def compile_kernel(kernel: Kernel, sections: dict[str, tuple[str, int, tuple[int, ...]]]) -> int:
    """Compile `kernel` for the given sizes, or load it from the disk.

    Parameters
    ----------
    kernel : function
        A step function that keeps the block contract.
    sections : dict
        For each of its arguments except ``t`` and ``k``: the section it lies in (state, parameters, inputs, outputs), its
        offset there in elements, and its shape.

    Returns
    -------
    int
        The address that the engine calls; the code behind it lives as long as the process.
    """
    if not isinstance(kernel, FunctionType):
        raise KernelError(f"A step function must be a plain Python function, not {kernel!r}.")
    body = _entry_text(kernel, sections)
    with _lock:
        known = _kernels.setdefault(kernel, {})
        if body in known:
            seen, address = known[body]
            if all(map(operator.is_, seen, depends_on(kernel))):
                return address
        seen = depends_on(kernel)
        name = f"block_{kernel.__name__.strip('<>')[:40]}_{fingerprint(kernel, body)}"
        if name not in _modules:
            twins = _twins(functions_called(kernel))
            _load(name, body, {"kernel": twins[-1]}, twins)
        address = int(_modules[name].entry.address)
        known[body] = seen, address
    return address


def _twins(functions: list[FunctionType]) -> list[FunctionType]:
    """Return copies of functions, callees first, that hold what the originals' globals and closures hold now.

    numba keeps the code of a function it has seen: after a change of a global it would compile the old value again, and that
    code would be stored under the new one's fingerprint.
    """
    twins: dict[FunctionType, FunctionType] = {}
    for function in functions:
        now = {name: twins.get(value, value) if callable(value) else value for name, value in references(function)}
        seen = [function.__code__, function.__defaults__, function.__kwdefaults__, *now.values()]
        before, twin = _latest_twin.get(function, ([], function))
        if len(before) == len(seen) and all(map(operator.is_, before, seen)):
            twins[function] = twin  # another block calls it too: numba need not compile it again
            continue
        closure = tuple(CellType(now[name]) for name in function.__code__.co_freevars)
        # The name of a module that any process can import, which stored code refers to; a function made by exec has none.
        namespace = {"__name__": __name__, "__builtins__": builtins, **now}
        twin = FunctionType(function.__code__, namespace, function.__name__, function.__defaults__, closure or None)
        twin.__kwdefaults__ = function.__kwdefaults__
        twins[function] = twin
        _latest_twin[function] = seen, twin
    return list(twins.values())


def compile_function(function: Any, signature: str, calls: Sequence[Any] = ()) -> Any:
    """Compile a service function of the engine for one numba signature, or load it from the disk.

    Parameters
    ----------
    function : function
        What to compile; numba sees it as it stands.
    signature : str
        The only signature it is called with, in numba's notation.
    calls : sequence of functions
        Plain functions that it calls, and that these call, such as those of `controllers._linalg`.
    """
    arguments = ", ".join(_arguments(function))
    # Without numba's reference counts (_nrt): such functions borrow their arrays and allocate none, and counting atomically
    # around each call by address took 70 ns a step of the loop, five times what the rest of it takes.
    text = (
        f'from numba import njit\n\n@njit({signature!r}, error_model="numpy", nogil=True, cache=True, _nrt=False)\n'
        f"def entry({arguments}):\n    return kernel({arguments})\n"
    )
    return _load_service(function, text, calls).entry


def compile_raw(function: FunctionType) -> CFunc:
    """Compile a service function with the engine's own signature, which gets the four addresses, or load it from the disk.

    Parameters
    ----------
    function : function
        Takes ``(state, parameters, inputs, outputs, t, k)`` and returns a status; numba sees it as it stands.

    Returns
    -------
    numba CFunc
        Its ``address`` is what the engine calls; keep it alive as long as the address is used.
    """
    arguments = ", ".join(_arguments(function))
    text = (
        "from numba import cfunc\nfrom bayesftc.cosim.stepping.compiler import SIGNATURE\n\n"
        f'@cfunc(SIGNATURE, error_model="numpy", cache=True)\ndef entry({arguments}):\n    return kernel({arguments})\n'
    )
    compiled: CFunc = _load_service(function, text).entry
    return compiled


def compile_callback(function: FunctionType, signature: str) -> CFunc:
    """Compile a service function as a C function of another signature, or load it from the disk.

    Parameters
    ----------
    function : function
        What a C library calls back; numba sees it as it stands.
    signature : str
        Its signature in numba's notation, as ``"int32(float64, int64)"``.

    Returns
    -------
    numba CFunc
        Its ``address`` is what the library gets; keep it alive as long as that is used.
    """
    arguments = ", ".join(_arguments(function))
    text = (
        f'from numba import cfunc\n\n@cfunc({signature!r}, error_model="numpy", cache=True)\n'
        f"def entry({arguments}):\n    return kernel({arguments})\n"
    )
    compiled: CFunc = _load_service(function, text).entry
    return compiled


def _load_service(function: FunctionType, text: str, calls: Sequence[FunctionType] = ()) -> ModuleType:
    name = f"engine_{function.__name__}_{service_fingerprint(function, text)}"
    return _load(name, text, {"kernel": function}, [*calls, function])


def _arguments(function: FunctionType) -> tuple[str, ...]:
    return function.__code__.co_varnames[: function.__code__.co_argcount]


def _entry_text(kernel: FunctionType, sections: dict[str, tuple[str, int, tuple[int, ...]]]) -> str:
    names = _arguments(kernel)
    # Loops over matrices of one section LLVM does not turn into vector instructions, for it cannot prove them apart; where it
    # knows nothing of two addresses, it has that checked before the loop. Small ones are unrolled, and need no check.
    shapes = [sections[name][2] for name in names if name not in {"t", "k"}]
    apart = any(len(shape) > 1 and min(shape[-2:]) >= LARGE for shape in shapes)
    signature, array = ("SIGNATURE", "as_floats") if apart else ("KERNEL_SIGNATURE", "floats")
    arguments = []
    for name in names:
        if name in {"t", "k"}:
            arguments.append(name)
        else:
            section, offset, shape = sections[name]
            place = f"{section} + {8 * offset}" if apart else f"{section}, {offset}"
            arguments.append(f"carray({array}({place}), {shape!r})")
    return (
        "from numba import carray, cfunc\n"
        f"from bayesftc.cosim.stepping.compiler import {signature}, {array}\n"
        "from bayesftc.cosim.stepping.numba_ops import ENTRY_OPTIONS\n\n"
        f"@cfunc({signature}, cache=True, **ENTRY_OPTIONS)\n"
        "def entry(state, parameters, inputs, outputs, t, k):\n"
        f"    kernel({', '.join(arguments)})\n"
        "    return 0\n"
    )


def _load(name: str, text: str, namespace: dict[str, Any], functions: list[FunctionType]) -> ModuleType:
    with _lock:
        if name not in _modules:
            _register(functions)
            path = cache_directory("compiled") / f"{name}.py"
            _drop_what_others_left(path)
            _write_once(path, text)
            try:
                module = _execute(path, text, namespace)
            except OSError as error:
                _forget(path)
                raise _unwritable(path, error) from None
            except Exception as error:
                if not _forget(path):
                    raise _refusal(namespace["kernel"], error) from error
                try:  # what another run has left in the cache may have been damaged
                    module = _execute(path, text, namespace)
                except Exception as again:
                    raise _refusal(namespace["kernel"], again) from again
            hits = _cache_hits(module.entry)
            STATISTICS["loaded" if hits else "compiled"] += 1
            _modules[name] = module
        return _modules[name]


def _execute(path: Path, text: str, namespace: dict[str, Any]) -> ModuleType:
    module = ModuleType(f"bayesftc_compiled_{path.stem}")
    module.__file__ = str(path)
    module.__dict__.update(namespace)
    sys.modules[module.__name__] = module  # numba looks the module up by name while it compiles
    try:
        with _no_collection():
            exec(compile(text, str(path), "exec"), module.__dict__)  # our own text, the same as in the file
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module


@contextmanager
def _no_collection() -> Iterator[None]:
    """Let numba make its many objects without a look, again and again, at which are garbage: a seventh of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _drop_what_others_left(path: Path) -> None:
    """Remove the files of a module if one of them is not the user's own: the folder may have been open to others before."""
    beside = path.parent / "__pycache__"
    if beside.exists() and not is_own(beside):
        raise BayesFTCError(
            f"The folder {beside} belongs to another user, and what lies in it would be run here; remove it, or set "
            "BAYESFTC_CACHE to another folder of your own."
        )
    if not all(is_own(file) for file in (path, *_of_numba(path)) if file.exists()):
        _forget(path)
        path.unlink(missing_ok=True)


def _of_numba(path: Path) -> list[Path]:
    return [*path.parent.glob(f"__pycache__/{path.stem}.*.nb[ic]")]


def _forget(path: Path) -> bool:
    """Remove numba's files for a module; return whether there were any."""
    files = _of_numba(path)
    for file in files:
        file.unlink(missing_ok=True)
    return bool(files)


def _refusal(kernel: FunctionType, error: Exception) -> Exception:
    """Return what to raise for an error of numba's compiler: a sentence, where it is about the user's step function."""
    if not isinstance(error, NumbaError):
        return error
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
    """Let compiled code call these plain functions by their own name."""
    for function in functions:
        if function not in _registered:
            overload(function, jit_options=_numba_ops.OPTIONS, strict=False)(
                lambda *arguments, implementation=function: implementation
            )
            _registered.add(function)


def _write_once(path: Path, text: str) -> None:
    """Bring the file that numba's cache belongs to into being, whole, and with the same time stamp whoever writes it."""
    try:
        stat = path.stat()
        if (stat.st_size, stat.st_mtime) == (len(text.encode()), _STAMP):
            return
    except FileNotFoundError:
        pass
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.utime(temporary, (_STAMP, _STAMP))
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> BayesFTCError:
    return BayesFTCError(
        f"The cache folder {path.parent} cannot be written ({error.strerror}); set BAYESFTC_CACHE to a folder that can be, "
        "or make room there."
    )
