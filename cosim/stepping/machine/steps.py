"""Compile step functions to C functions with one signature, once per machine.

Every compiled block is ``int32 f(state, parameters, inputs, outputs, t, k)``: four addresses of float64 arrays, the time in
seconds and the block's integer step count. A step function is translated to the same C as in exports, and LLVM compiles it. Some
long ones stand in the package in LLVM's format already (`shipped`). The machine code is stored in the user's cache folder, in a
file whose *name* is a hash of everything it depends on (:mod:`bayesftc.cosim.stepping.fingerprint`). Functions that cannot be
translated to C are compiled by numba, which supports more of Python and takes ten times as long.
"""

from __future__ import annotations

import operator
import platform
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import pairwise
from math import prod
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary

import llvmlite
import llvmlite.binding as llvm
import pycparser
from pycparser.c_parser import ParseError

from bayesftc._interrupt import import_whole
from bayesftc.cosim import ops
from bayesftc.cosim.base.announcing import announced
from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import composed, depends_on, fingerprint, foreign_functions, where
from bayesftc.cosim.stepping.kept import STATISTICS, read_own, write_whole
from bayesftc.cosim.stepping.machine.code import features, load, machine_code, opened, ready_code, sealed
from bayesftc.cosim.stepping.machine.lowering import lowered
from bayesftc.cosim.stepping.machine.shipped import compiler_files, digest_of, places_of, shipped_step
from bayesftc.cosim.stepping.source.tree import Sections, parameters
from bayesftc.cosim.stepping.translate.functions import Functions
from bayesftc.cosim.types import Kernel

lenient = True
"""Whether numba is also used after an error of this compiler, and not only for unsupported Python; False in tests."""

_lock = threading.RLock()
_addresses: dict[str, int] = {}
_kernels: WeakKeyDictionary[FunctionType, dict[str, tuple[list[Any], str]]] = WeakKeyDictionary()


_COMPILER_DIGEST = digest_of(compiler_files())
"""A hash of the compiler's files when they are loaded; they may be edited later."""


def compile_kernel(kernel: Kernel, sections: Sections) -> int:
    """Compile `kernel` for the given sizes, or load it from the disk.

    Parameters
    ----------
    kernel : function
        A step function that keeps the block contract.
    sections : dict
        For each of its arguments except ``t`` and ``k``: its section (state, parameters, inputs, outputs), its offset there in
        elements, and its shape.

    Returns
    -------
    int
        The address of the function; its code stays loaded until the process ends.
    """
    name = name_of(kernel, sections)
    with _lock:
        if name not in _addresses:
            _addresses[name] = _address(_plain(kernel), sections, name)
    return _addresses[name]


def _plain(kernel: Kernel) -> FunctionType:
    if not isinstance(kernel, FunctionType):
        raise KernelError(f"A step function must be a plain Python function, not {kernel!r}.")
    return kernel


def name_of(kernel: Kernel, sections: Sections) -> str:
    """Return the name of a compiled step function: a hash of everything that its code depends on."""
    function = _plain(kernel)
    places = places_of(kernel, sections)
    with _lock:
        cached = _kernels.setdefault(function, {})
        present = depends_on(function)
        if places in cached:
            dependencies, name = cached[places]
            if len(dependencies) == len(present) and all(map(operator.is_, dependencies, present)):
                return name
        name = f"step_{Functions.allowed(kernel.__name__)[:40]}_{fingerprint(function, f'{environment()} {places}')}"
        cached[places] = present, name
    return name


def _address(kernel: FunctionType, sections: Sections, name: str) -> int:
    foreign = foreign_functions(kernel)
    for function in foreign:
        function.defined()
    try:
        return load_or_compile(name, lambda: _compiled(kernel, sections, name))
    except KernelError as reason:
        if foreign:
            raise
        import_whole("bayesftc.cosim.stepping.compiler")

        from bayesftc.cosim.stepping.compiler import compile_by_numba

        return compile_by_numba(kernel, sections, reason)


def load_or_compile(name: str, compiled: Callable[[], bytes]) -> int:
    """Return the address of the function `name`: from the disk, or else from the code that `compiled` makes."""
    path = cache_directory("compiled") / f"{name}.o"
    content = read_own(path)
    code = None if content is None else opened(content)
    if code is None:
        with announced(True):
            code = compiled()
        write_whole(path, sealed(code))
        STATISTICS["compiled"] += 1
    else:
        STATISTICS["loaded"] += 1
    return load(code, name)


def _compiled(kernel: FunctionType, sections: Sections, name: str) -> bytes:
    if ready := shipped_step(kernel, sections, name):
        with suppress(RuntimeError):  # an older LLVM may not know the text of a newer one
            return ready_code(ready)
    with sentences(kernel):
        return machine_code(lowered(*text_of(kernel, sections, name)))


@contextmanager
def sentences(kernel: FunctionType) -> Iterator[None]:
    """Turn the errors of this compiler at a step function into `KernelError`, upon which numba is used."""
    try:
        yield
    except (RuntimeError, RecursionError, ValueError, LookupError, ParseError) as error:  # RuntimeError is LLVM's
        if not lenient:
            raise
        raise KernelError(
            f"Step function {where(kernel)} cannot be compiled by way of C ({error}); please report this error."
        ) from error


def text_of(kernel: FunctionType, sections: Sections, name: str) -> tuple[str, list[str]]:
    """Return the C of a step function with a wrapper of the engine's signature, and which of the two have disjoint arrays.

    Raises
    ------
    KernelError
        If it cannot be translated to C.
    """
    functions = Functions([name])
    function = functions.step(kernel, sections)
    arguments = [
        n if n in {"t", "k"} else "{} + {}".format(*sections[n]) for n in function.arguments if n in function.passed
    ]
    call = f"{function.name}({', '.join(arguments)});"
    declaration = f"int {name}(double *state, double *parameters, double *inputs, double *outputs, double t, int64_t k)"
    text = "\n".join([functions.text([call]), declaration, "{", f"    {call}", "    return 0;", "}", ""])
    # An argument may be a port, and another the whole section with it: then only the sections are disjoint.
    ranges = sorted((sections[n][0], sections[n][1], prod(sections[n][2])) for n in parameters(kernel) if n in sections)
    overlap = any(a[0] == b[0] and a[1] + a[2] > b[1] for a, b in pairwise(ranges))
    return text, [name] if overlap else [name, function.name]


@cache
def environment() -> str:
    """Return what else machine code depends on: versions, the processor, and this compiler."""
    parts = [platform.python_version(), llvmlite.__version__, pycparser.__version__, llvm.get_process_triple()]
    parts += [llvm.get_host_cpu_name(), features(wide=True), str(ops.OF_LIBRARY), composed(), _COMPILER_DIGEST]
    return "|".join(parts)
