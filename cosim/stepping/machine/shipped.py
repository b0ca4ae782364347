"""The engine's own functions in LLVM's text format, which stand in the package: a first run need not wait for numba.

numba takes seconds to translate them, LLVM a tenth of that to compile the text. `tools/engine_text.py` writes the file. It is for
64-bit x86 only, where it is tested; elsewhere, and after an edit of the sources, numba translates them.
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

ROOT = Path(str(resources.files("bayesftc.cosim")))

FILE = ROOT / "stepping" / "machine" / "engine.json.xz"

MACHINES = ("x86_64", "AMD64")

SOURCES = (
    "drawing.py", "elementary.py", "ops.py", "random.py", "diagram/schedule.py", "fmi/binaries/codes.py",
    "fmi/running/kernels.py", "fmi/running/typed_kernels.py", "isolation/kernels.py", "isolation/protocol.py",
    "run/general/loop.py", "run/general/program.py", "stepping/by_address.py", "stepping/numba_called.py",
    "stepping/numba_callee.py", "stepping/numba_ops.py",
)  # fmt: skip
"""The files on which the text depends."""


def digest_of(files: Iterable[Path]) -> str:
    """Return a hash of the content of files."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


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
