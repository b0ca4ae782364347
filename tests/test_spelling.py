"""Spelling of pages, docstrings, comments and messages: common mistakes, by codespell.

The few words that it takes for mistakes are in ``pyproject.toml``. Tests are left out: they misspell names on purpose.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("docs", "src", "cosim", "controllers", "fmus", "examples", "tools", "benchmarks")
MADE = {"api", "drawn", "gallery", ".executed", "project"}
"""Folders in ``docs`` that the site writes."""
KINDS = {".md", ".rst", ".py", ".pyi", ".toml", ".ipynb", ".css", ".js", ".c", ".h"}


def misspelt(paths):
    """Return what codespell finds, a line for each mistake."""
    command = [sys.executable, "-m", "codespell_lib", "--toml", str(ROOT / "pyproject.toml"), *map(str, paths)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert not done.stderr, done.stderr
    return done.stdout


def test_spelling():
    pytest.importorskip("codespell_lib")
    files = [p for folder in FOLDERS for p in (ROOT / folder).rglob("*") if p.suffix in KINDS]
    files = [p for p in files if not MADE & set(p.relative_to(ROOT).parts) and ".min." not in p.name] + sorted(
        ROOT.glob("*.md")
    )
    assert len(files) > 500
    found = misspelt(files)
    assert not found, found


def test_a_mistake_is_found(tmp_path):
    pytest.importorskip("codespell_lib")
    page = tmp_path / "page.md"
    page.write_text("The contoller recieves a sample.\n")
    assert len(misspelt([page]).splitlines()) == 2
