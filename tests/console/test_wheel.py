"""What an installed package needs: the files of the page, and the extra."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from bayesftc.console.web.server import FILES, PAGE
from bayesftc.cosim.base import extras

ROOT = Path(__file__).parents[2]


def test_files_of_the_page_exist():
    assert {file.name for file in PAGE.iterdir()} == {*FILES, "index.html"}
    assert "uPlot" in (ROOT / "THIRD_PARTY.md").read_text()


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "uvicorn" else object())
    sentence = extras.why_missing("starlette", "uvicorn", purpose="bayesftc serve", of="console")
    assert sentence == (
        "bayesftc serve needs the package uvicorn, which is not installed: pip install 'bayesftc[console]'."
    )
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["console"]
    assert {name.split(">")[0] for name in wanted} == {"starlette", "uvicorn", "websockets"}


@pytest.mark.slow
def test_wheel_has_the_page(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "-q", "-w", str(tmp_path), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    for name in (*FILES, "index.html"):
        assert f"bayesftc/console/page/{name}" in names
    assert any(name.endswith("THIRD_PARTY.md") for name in names)
