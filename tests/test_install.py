"""What an installation needs of a clone."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_a_clone_without_symbolic_links_is_a_package(tmp_path):
    """As git makes it on Windows, where a link is a small file with the path that it leads to."""
    package = tmp_path / "src" / "bayesftc"
    package.mkdir(parents=True)
    shutil.copy(ROOT / "hatch_build.py", tmp_path)
    for file in (ROOT / "src" / "bayesftc").glob("*.py"):
        shutil.copy(file, package)
    for name in ("cosim", "controllers", "fmus", "examples"):
        (package / name).write_text(f"../../{name}", encoding="utf-8")
        (tmp_path / name).symlink_to(ROOT / name)
    done = subprocess.run(
        [sys.executable, "-c", "from bayesftc import cosim, fmus; print(fmus.path('CruiseControl')); print(cosim.__file__)"],
        env={**os.environ, "PYTHONPATH": str(tmp_path / "src")}, cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1] == str(tmp_path / "cosim" / "__init__.py")
