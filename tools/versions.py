"""Run the tests with the oldest or the newest versions of the dependencies that pyproject.toml allows, on any Python.

    python tools/versions.py oldest
    python tools/versions.py newest --python python3.13
    python tools/versions.py oldest --folder ../oldest -- tests/cosim/fmi/test_fmu.py -n 2

Arguments after ``--`` are for pytest. The package is this checkout. Needs uv (``python -m pip install uv``).
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESOLUTION = {"oldest": "lowest-direct", "newest": "highest"}
"""The names of uv: ``oldest`` applies to the dependencies in pyproject.toml, not to their own dependencies."""


def environment(folder: Path, which: str, python: str) -> Path:
    """Make or update an environment; return its interpreter."""
    uv = shutil.which("uv") or shutil.which("uv", path=os.path.dirname(sys.executable))
    if uv is None:
        raise SystemExit("uv was not found. Install it with: python -m pip install uv")
    interpreter = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not interpreter.exists():
        subprocess.run([uv, "venv", "--quiet", "--python", python, str(folder)], check=True)
    install = [uv, "pip", "install", "--python", str(interpreter), "--resolution", RESOLUTION[which]]
    subprocess.run([*install, "--editable", f"{ROOT}[test,export]"], check=True)
    return interpreter


def main() -> int:
    """Run the command line; return pytest's exit code."""
    given = sys.argv[1:]
    options, tests = (given[: given.index("--")], given[given.index("--") + 1 :]) if "--" in given else (given, [])
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("which", choices=RESOLUTION)
    parser.add_argument("--python", default=sys.executable, help="an interpreter, or a version that uv finds")
    parser.add_argument(
        "--folder", type=Path, help="folder of the environment, which may exist; by default a temporary folder"
    )
    arguments = parser.parse_args(options)
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        interpreter = environment(arguments.folder or scratch / "environment", arguments.which, arguments.python)
        # A separate cache, so that no code from other versions can affect the tests.
        settings = {**os.environ, "BAYESFTC_CACHE": str(scratch / "cache")}
        return subprocess.run(
            [str(interpreter), "-m", "pytest", *tests], cwd=ROOT, env=settings, check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
