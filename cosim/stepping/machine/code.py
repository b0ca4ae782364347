"""Machine code: LLVM makes it of its own text, and it is loaded from the disk where it was made before."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

import llvmlite.binding as llvm

from bayesftc.cosim.errors import KernelError

_SPEED = 3
_DIGEST = 32
"""Bytes of the hash before the code in a file."""


def machine_code(text: str) -> bytes:
    """Return the object file of a module in LLVM's text, made for this machine's processor."""
    machine = _machine()
    module = llvm.parse_assembly(text, llvm.create_context())
    module.data_layout = str(machine.target_data)
    module.triple = llvm.get_process_triple()
    # LLVM unrolls nested loops late, when it looks no more for what the copies have in common. A quick pass before the full one
    # has them unrolled by then.
    for level in (1, _SPEED):
        tuning = llvm.create_pipeline_tuning_options(speed_level=level)
        tuning.loop_vectorization = True  # but not of single operations side by side: it makes chains longer
        builder = llvm.create_pass_builder(machine, tuning)
        builder.getModulePassManager().run(module, builder)
    found: bytes = machine.emit_object(module)
    return found


def sealed(code: bytes) -> bytes:
    """Return code with its hash before it, as it is kept in a file: half a file must never run."""
    return hashlib.sha256(code).digest() + code


def opened(kept: bytes) -> bytes | None:
    """Return the code out of a file; None if it is not whole."""
    digest, code = kept[:_DIGEST], kept[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def load(code: bytes, name: str) -> int:
    """Return the address of a function of an object file; the code lives as long as the process."""
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    address = int(engine.get_function_address(name))
    if not address:
        raise KernelError(f"The compiled step function {name} cannot be loaded; empty the cache folder.")
    return address


@cache
def features() -> str:
    """Return what this processor can do, without AVX-512, with which LLVM compares into mask registers for each `select`.

    The way there and back is several cycles long, and a step of a controller is one long chain of such operations.
    """
    found = llvm.get_host_cpu_features()
    return ",".join(
        f"{'+' if present and not name.startswith(('avx512', 'avx10')) else '-'}{name}"
        for name, present in sorted(found.items())
    )


@cache
def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=features(),
        opt=_SPEED,
        reloc="static" if target.name.startswith("x86") else "default",
        codemodel="jitdefault",
        jit=True,
    )


@cache
def _engine() -> Any:
    return llvm.create_mcjit_compiler(llvm.parse_assembly("", llvm.create_context()), _machine())
