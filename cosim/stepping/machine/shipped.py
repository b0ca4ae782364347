"""Functions in LLVM's text format, which stand in the package: a first run need not wait for a compiler.

They are the engine's own functions, which numba takes seconds to translate, and the long step functions of the shipped scenarios.
`tools/engine_text.py` writes the files. They are for 64-bit x86 only, where they are tested; elsewhere, and after an edit of the
sources, the functions are translated as all others.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import platform
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from types import FunctionType
from typing import Any

from bayesftc.cosim import ops
from bayesftc.cosim.stepping.fingerprint import fingerprint_of_files
from bayesftc.cosim.stepping.source.tree import Sections
from bayesftc.cosim.types import Kernel, argument_names

ROOT = Path(str(resources.files("bayesftc.cosim")))

FILE = ROOT / "stepping" / "machine" / "engine.json.xz"

STEPS = FILE.with_name("steps.json.xz")

ENTRY = "shipped_step"
"""The name of step functions in their text."""

COMPILER = ("machine", "source", "translate")
"""The folders of the compiler of step functions."""

MACHINES = ("x86_64", "AMD64")

SOURCES = (
    "drawing.py",
    "elementary.py",
    "ops.py",
    "random.py",
    "diagram/schedule.py",
    "fmi/binaries/codes.py",
    "fmi/binaries/surroundings.py",
    "fmi/binaries/surroundings_kernels.py",
    "fmi/running/kernels.py",
    "fmi/running/typed_kernels.py",
    "isolation/kernels.py",
    "isolation/protocol.py",
    "run/general/loop.py",
    "run/general/program.py",
    "stepping/by_address.py",
    "stepping/numba_called.py",
    "stepping/numba_callee.py",
    "stepping/numba_ops.py",
)
"""The files on which the text depends."""


def digest_of(files: Iterable[Path]) -> str:
    """Return a hash of the content of files."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def compiler_files() -> list[Path]:
    """Return the files of the compiler of step functions."""
    return sorted(file for part in COMPILER for file in (ROOT / "stepping" / part).glob("*.py"))


def places_of(kernel: Kernel, sections: Sections) -> str:
    """Return the places of a step function's arguments, as text."""
    return repr([(name, sections.get(name)) for name in argument_names(kernel)])


def sources_digest() -> str:
    """Return a hash of the sources of the text."""
    return digest_of(ROOT / name for name in SOURCES)


@cache
def _texts() -> dict[str, str]:
    if platform.machine() not in MACHINES or not FILE.exists():
        return {}
    content = json.loads(lzma.decompress(FILE.read_bytes()))
    texts: dict[str, str] = content["texts"] if content["sources"] == sources_digest() else {}
    return texts


def shipped_text(name: str) -> str | None:
    """Return the text of a service function of this name; None if the package has none for this machine."""
    return _texts().get(name)


@cache
def _steps() -> dict[str, dict[str, Any]]:
    if platform.machine() not in MACHINES or not STEPS.exists():
        return {}
    steps: dict[str, dict[str, Any]] = json.loads(lzma.decompress(STEPS.read_bytes()))
    return steps


def shipped_step(kernel: FunctionType, sections: Sections, name: str) -> str | None:
    """Return the optimised text of a step function, with the name `name`; None if the package has none for this machine."""
    if not _steps():
        return None
    key, files = step_key(kernel, sections)
    found = _steps().get(key)
    try:
        is_present = found is not None and found["sources"] == digest_of(files)
    except OSError:  # a package without its sources
        return None
    return str(found["text"]).replace(ENTRY, name) if found and is_present else None


def step_key(kernel: FunctionType, sections: Sections) -> tuple[str, list[Path]]:
    """Return a hash of a step function and its places, the same in several versions of Python, and all its sources."""
    key, files = fingerprint_of_files(kernel, f"{ops.OF_LIBRARY} {places_of(kernel, sections)}")
    others = ("ops.py", "elementary.py", "stepping/fingerprint.py", "stepping/foreign.py", "stepping/records.py")
    return key, sorted({*files, *compiler_files(), *(ROOT / name for name in others)})
