"""Figures and tables where a user sees them: in a notebook, which is run here, and in a script."""

import warnings

import pytest
from matplotlib import pyplot

from bayesftc import cosim

CELLS = (
    "from fractions import Fraction\nimport numpy as np\nfrom bayesftc import cosim\n"
    "result = cosim.Result(np.arange(6.0).reshape(6, 1), {'one.y': (0, ())}, Fraction(1, 10))",
    "result.plot()",
    "import matplotlib.pyplot as plt\nresult.plot()",
    "figure = result.plot()",
    "print(plt.get_fignums())",
    "result",
)


@pytest.fixture(scope="module")
def outputs():
    """What a notebook shows below each of its cells."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tools that run notebooks
        done = nbclient.NotebookClient(book, timeout=120).execute()
    return [cell.outputs for cell in done.cells]


def pictures(cell):
    return sum("image/png" in output.get("data", {}) for output in cell)


@pytest.mark.slow
def test_a_figure_shows_once_with_and_without_pyplot(outputs):
    assert [pictures(cell) for cell in outputs[1:4]] == [1, 1, 0]
    assert outputs[4][0]["text"] == "[]\n"


def test_a_script_shows_figures_by_pyplot(monkeypatch):
    monkeypatch.setattr("matplotlib.get_backend", lambda: "agg")
    pyplot.close("all")
    result = cosim.Diagram(0.1)
    result.add(cosim.Constant(1.0), "one")
    figure = result.simulate(0.2, engine="interpreted").plot()
    assert [pyplot.figure(number) for number in pyplot.get_fignums()] == [figure]
    pyplot.close("all")
