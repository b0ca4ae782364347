"""Write `cosim/stepping/machine/engine.json.xz`: the engine's own functions, translated by numba into LLVM's text format.

    python tools/engine_text.py

Run it after a change of one of the files that `bayesftc.cosim.stepping.machine.shipped` names.
"""

from __future__ import annotations

import json
import lzma
import os
import subprocess
import sys
from types import FunctionType

import llvmlite.binding as llvm

from bayesftc.cosim.stepping.machine.code import enclosed, outside
from bayesftc.cosim.stepping.machine.shipped import FILE, sources_digest

GENERIC = {
    "NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_LOOP_VECTORIZE": "0", "NUMBA_SLP_VECTORIZE": "0",
}  # fmt: skip
"""Settings with which numba does not translate for this machine's processor."""


def functions() -> dict[str, FunctionType]:
    """Return the functions by the names under which the engine asks for them."""
    from bayesftc.cosim import drawing
    from bayesftc.cosim.fmi.running import kernels, typed_kernels
    from bayesftc.cosim.isolation import kernels as isolated
    from bayesftc.cosim.run.general import loop

    found: dict[str, FunctionType] = {"draw": drawing.draw}
    found |= {f"loop_{name}": getattr(loop, name) for name in ("advance", "phase", "run_many", "run_lanes")}
    found |= {f"isolated_{name}": getattr(isolated, name) for name in ("output", "update", "serve")}
    for kind, module in (("plain", kernels), ("typed", typed_kernels)):
        found |= {f"fmi{version}_{role}_{kind}": f for (version, role), f in module.FUNCTIONS.items()}
    return {f"service_{name}": function for name, function in found.items()}


def text_of(function: FunctionType, name: str) -> str:
    """Return a function's text for any processor: optimised, so that nothing of numba's is left, but without vectors."""
    from bayesftc.cosim.stepping.compiler import service_text

    module = enclosed(service_text(function, name), name)
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = tuning.loop_unrolling = False
    machine = llvm.Target.from_default_triple().create_target_machine(cpu="x86-64", features="", opt=3)
    builder = llvm.create_pass_builder(machine, tuning)
    builder.getModulePassManager().run(module, builder)
    if others := outside(module):
        raise SystemExit(f"{name} needs functions of other libraries: {', '.join(others)}.")
    return str(module)


def content() -> bytes:
    """Return the content of the file."""
    llvm.initialize_native_target()
    texts = {name: text_of(function, name) for name, function in sorted(functions().items())}
    return json.dumps({"sources": sources_digest(), "texts": texts}).encode()


if __name__ == "__main__":
    if not GENERIC.items() <= os.environ.items():
        sys.exit(subprocess.run([sys.executable, __file__], env={**os.environ, **GENERIC}, check=False).returncode)
    FILE.write_bytes(lzma.compress(content(), preset=9))
