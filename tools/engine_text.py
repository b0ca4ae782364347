"""Write functions in LLVM's text format into `cosim/stepping/machine`, so that a first run need not wait for compilers.

    python tools/engine_text.py

`engine.json.xz` has the engine's own functions, which numba translates. `steps.json.xz` has the long step functions of shipped
scenarios, optimised by LLVM. Run it after a change of one of their sources; tests say when.
"""

from __future__ import annotations

import json
import lzma
import os
import subprocess
import sys
from collections.abc import Iterator
from types import FunctionType

import llvmlite.binding as llvm

from bayesftc.cosim.stepping.machine.code import enclosed, optimised_text, outside
from bayesftc.cosim.stepping.machine.lowering import lowered
from bayesftc.cosim.stepping.machine.shipped import ENTRY, FILE, STEPS, digest_of, sources_digest, step_key
from bayesftc.cosim.stepping.machine.steps import text_of as step_text
from bayesftc.cosim.stepping.source.tree import Sections

GENERIC = {
    "NUMBA_CPU_NAME": "x86-64",
    "NUMBA_CPU_FEATURES": "",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
}
"""Settings with which numba does not translate for this machine's processor."""

CPU = "x86-64-v3"
"""The processor for which step functions are optimised: vectors of four numbers. LLVM splits them for smaller ones."""

LONG = 100_000
"""Length of the text from which on a step function is shipped: others are compiled in less than a fifth of a second."""

SCENARIOS = ("cruise_control", "position_servo")


def functions() -> dict[str, FunctionType]:
    """Return the functions by the names under which the engine asks for them."""
    from bayesftc.cosim import drawing
    from bayesftc.cosim.fmi.binaries import surroundings_kernels
    from bayesftc.cosim.fmi.running import kernels, typed_kernels
    from bayesftc.cosim.isolation import kernels as isolated
    from bayesftc.cosim.run.general import loop

    found: dict[str, FunctionType] = {"draw": drawing.draw}
    found |= {f"loop_{name}": getattr(loop, name) for name in ("advance", "phase", "run_many", "run_lanes")}
    found |= {f"isolated_{name}": getattr(isolated, name) for name in ("output", "update", "serve")}
    found |= {f"surroundings_{name}": f for name, f in surroundings_kernels.FUNCTIONS.items()}
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


def kernels(scenario: str) -> Iterator[tuple[FunctionType, Sections]]:
    """Yield the step functions of a shipped scenario, with the places of their arguments."""
    from bayesftc.scenario import load_scenario

    schedule = load_scenario(scenario).loop().schedule
    for call in (*schedule.evaluate, *schedule.advance):
        kernel = schedule.kernel(call)
        if isinstance(kernel, FunctionType):
            yield kernel, schedule.slots[call.node].sections


def steps() -> dict[str, dict[str, str]]:
    """Return the optimised text of each long step function, and the hash of its sources, by its key."""
    found = {}
    for scenario in SCENARIOS:
        for kernel, sections in kernels(scenario):
            text = lowered(*step_text(kernel, sections, ENTRY))
            if len(text) > LONG:
                key, files = step_key(kernel, sections)
                found[key] = {"sources": digest_of(files), "text": optimised_text(text, CPU)}
    return found


def content() -> bytes:
    """Return the content of the file."""
    llvm.initialize_native_target()
    texts = {name: text_of(function, name) for name, function in sorted(functions().items())}
    return json.dumps({"sources": sources_digest(), "texts": texts}).encode()


if __name__ == "__main__":
    if not GENERIC.items() <= os.environ.items():
        sys.exit(subprocess.run([sys.executable, __file__], env={**os.environ, **GENERIC}, check=False).returncode)
    FILE.write_bytes(lzma.compress(content(), preset=9))
    STEPS.write_bytes(lzma.compress(json.dumps(steps()).encode(), preset=9))
