"""The gallery and the notebooks: each runs, and whatever is shipped occurs in them."""

import ast
import re
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from matplotlib import pyplot

from bayesftc import controllers, cosim, fmus
from bayesftc.fmus._compiler import why_no_compiler

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "docs" / "gallery_examples").rglob("plot_*.py"))
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
TEXT = {path: path.read_text(encoding="utf-8") for path in SCRIPTS}
WHOLE = "\n".join(TEXT.values())
LONG = 80
"""Longest program in lines, so that it can be read."""


@pytest.mark.sampled(2)
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_run(path, tmp_path, monkeypatch):
    if "A C compiler is needed" in TEXT[path] and why_no_compiler():
        pytest.skip(why_no_compiler())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pyplot, "show", lambda: None)
    pyplot.close("all")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Animation was deleted")
            runpy.run_path(str(path), run_name="__main__")
            figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
            assert figures
            for figure in figures:
                assert any(axis.get_xlabel() for axis in figure.axes) or figure.get_supxlabel()
            del figures, figure
            pyplot.close("all")
    finally:
        pyplot.close("all")


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_begin_with_a_title_and_a_few_sentences(path):
    text = ast.get_docstring(ast.parse(TEXT[path]))
    title, rule, *rest = text.splitlines()
    assert rule == "=" * len(title)
    assert len(title) < 60
    assert 1 <= len(re.findall(r"[.?](?=\s|$)", "\n".join(rest))) <= 5
    assert len(TEXT[path].splitlines()) <= LONG
    assert "plt.show()" in TEXT[path] or "animation" in TEXT[path]


def test_the_gallery_has_every_plant_fault_and_learner():
    for name in fmus.names():
        assert f'fmus.path("{name}")' in WHOLE, f"no example in docs/gallery_examples has the plant {name}"
    for home, classes in (("cosim", cosim.FAULTS), ("controllers", controllers.LEARNERS)):
        for cls in classes:
            assert f"{home}.{cls.__name__}(" in WHOLE, f"no example in docs/gallery_examples has {cls.__name__}"
    assert len(SCRIPTS) >= 20


def test_every_folder_of_the_gallery_has_a_heading():
    for folder in {path.parent for path in SCRIPTS}:
        assert (folder / "GALLERY_HEADER.rst").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path, tmp_path):
    """In a process of their own, as a user's notebook server runs them; with a figure or a table below most cells."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    book = nbformat.read(path, as_version=4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tools that run notebooks
        done = nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs]
    kinds = {kind for output in outputs for kind in output.get("data", {})}
    assert {"image/png", "text/html"} & kinds


def test_notebooks_are_kept_without_outputs():
    nbformat = pytest.importorskip("nbformat")
    assert len(NOTEBOOKS) >= 3
    for path in NOTEBOOKS:
        for cell in nbformat.read(path, as_version=4).cells:
            assert not cell.get("outputs"), f"{path.name} has outputs; clear them before the commit"


@pytest.mark.slow
def test_a_script_runs_as_a_download(tmp_path):
    """Alone, without a screen."""
    path = next(path for path in SCRIPTS if path.stem == "plot_ten_lines")
    (tmp_path / path.name).write_text(TEXT[path], encoding="utf-8")
    done = subprocess.run([sys.executable, path.name], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
