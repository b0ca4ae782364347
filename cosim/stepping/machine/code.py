"""Machine code: compiled by LLVM from its text format, or loaded from the disk."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from typing import Any

import llvmlite.binding as llvm

from bayesftc.cosim.errors import KernelError

_SPEED = 3
LONG = 400_000
"""Length of a module's text from which on LLVM also combines operations on adjacent values (SLP vectorization). This makes chains
of operations longer: short step functions, which wait for them, would take up to 7 % more time. Long ones have many such chains
at once and are limited by the number of instructions: a bank of hypotheses takes 4 to 6 % less."""
_DIGEST = 32
"""Bytes of the hash before the code in a file."""


def machine_code(text: str, parts: Mapping[str, str] | None = None, *, wide: bool = False) -> bytes:
    """Return the object file of a module in LLVM's text format, compiled for this machine's processor.

    Parameters
    ----------
    text : str
        The module.
    parts : mapping of str to str, optional
        Modules that define functions which it calls, by the functions' names. They become part of their callers.
    wide : bool
        Whether the module computes with vectors of several runs; see `features`.
    """
    context = llvm.create_context()
    module = llvm.parse_assembly(text, context)
    for name, part in (parts or {}).items():
        module.link_in(llvm.parse_assembly(part, context))
        function = module.get_function(name)
        function.linkage = llvm.Linkage.internal
        function.add_function_attribute("alwaysinline")
    machine = _machine(wide=wide)
    return _emitted(_optimised(module, max(map(len, (text, *(parts or {}).values()))), machine), machine)


def closed_code(text: str, name: str) -> bytes:
    """Return the object file of a module with one entry, `name`; nothing if its code needs functions of other libraries.

    Only the entry can be called from outside, so LLVM sees which errors of the functions behind it cannot occur, and removes the
    code that would report them.
    """
    machine = _machine(wide=True)  # loops over random numbers become vectors
    module = _optimised(enclosed(text, name), len(text), machine)
    return b"" if outside(module) else _emitted(module, machine)


def enclosed(text: str, name: str) -> Any:
    """Return the module of a text, of which only `name` can be called from outside."""
    module = llvm.parse_assembly(text, llvm.create_context())
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration and value.name != name:
            value.linkage = "internal"
    return module


def outside(module: Any) -> list[str]:
    """Return the names of what a module needs of other libraries."""
    values = (*module.functions, *module.global_variables)
    return [value.name for value in values if value.is_declaration and not value.name.startswith("llvm.")]


def ready_code(text: str) -> bytes:
    """Return the object file of a module that is optimised already."""
    module = llvm.parse_assembly(text, llvm.create_context())
    _placed(module, _machine())
    return _emitted(module)


def optimised_text(text: str, cpu: str) -> str:
    """Return a module optimised for a kind of processor, in LLVM's text format."""
    llvm.initialize_native_target()
    target = llvm.Target.from_default_triple()
    module = llvm.parse_assembly(text, llvm.create_context())
    return str(_optimised(module, len(text), target.create_target_machine(cpu=cpu, features="", opt=_SPEED)))


def _placed(module: Any, machine: Any) -> None:
    module.data_layout = str(machine.target_data)
    module.triple = llvm.get_process_triple()


def _optimised(module: Any, length: int, machine: Any = None) -> Any:
    machine = machine or _machine()
    _placed(module, machine)
    # LLVM unrolls nested loops so late that it no longer finds common parts of the copies. A quick pass before the full one
    # unrolls them earlier.
    for level in (1, _SPEED):
        tuning = llvm.create_pipeline_tuning_options(speed_level=level)
        tuning.loop_vectorization = True
        tuning.slp_vectorization = level == _SPEED and length > LONG
        builder = llvm.create_pass_builder(machine, tuning)
        builder.getModulePassManager().run(module, builder)
    return module


def _emitted(module: Any, machine: Any = None) -> bytes:
    code: bytes = (machine or _machine()).emit_object(module)
    return code


def sealed(code: bytes) -> bytes:
    """Return code with its hash before it, for a file: an incomplete file must never run."""
    return hashlib.sha256(code).digest() + code


def opened(content: bytes) -> bytes | None:
    """Return the code of a file's content; None if it is not complete."""
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def load(code: bytes, name: str) -> int:
    """Return the address of a function of an object file; the code stays loaded until the process ends."""
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    address = int(engine.get_function_address(name))
    if not address:
        raise KernelError(f"The compiled step function {name} cannot be loaded; empty the cache folder.")
    return address


@cache
def features(*, wide: bool = False) -> str:
    """Return this processor's features, with AVX-512 only for code that is `wide`.

    With AVX-512, LLVM uses mask registers for each `select`. Moving values to these registers and back takes several cycles, and
    a controller's step is one long chain of such operations. Several runs in lock step are many chains. There, one instruction
    instead of two for eight runs, and twice as many registers, save 8 to 21 % of the time.
    """
    present_features = llvm.get_host_cpu_features()
    return ",".join(
        f"{'+' if present and (wide or not name.startswith(('avx512', 'avx10'))) else '-'}{name}"
        for name, present in sorted(present_features.items())
    )


@cache
def _machine(*, wide: bool = False) -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=features(wide=wide),
        opt=_SPEED,
        reloc="static" if target.name.startswith("x86") else "default",
        codemodel="jitdefault",
        jit=True,
    )


@cache
def _engine() -> Any:
    return llvm.create_mcjit_compiler(llvm.parse_assembly("", llvm.create_context()), _machine())
