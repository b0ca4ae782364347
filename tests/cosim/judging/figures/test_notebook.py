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
    "figure",
    "result.plot();\nresult.plot_signals();",
    "display(result.plot())",
    "import control\ncontrol.bode_plot(control.tf([1], [1, 1]));",
    "animation = result.animate(frames=2)",
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
    assert [pictures(cell) for cell in outputs[1:4]] == [1, 1, 1]
    assert outputs[9][0]["text"] == "[]\n"


@pytest.mark.slow
def test_a_figure_shows_as_those_of_python_control_do(outputs):
    """After a semicolon, too; and a figure that is kept shows again when it is asked for."""
    assert [pictures(cell) for cell in outputs[4:8]] == [1, 2, 1, 1]


@pytest.mark.slow
def test_an_animation_has_no_picture_beside_its_player(outputs):
    assert outputs[8] == []


def test_a_script_shows_figures_by_pyplot(monkeypatch):
    monkeypatch.setattr("matplotlib.get_backend", lambda: "agg")
    pyplot.close("all")
    result = cosim.Diagram(0.1)
    result.add(cosim.Constant(1.0), "one")
    figure = result.simulate(0.2, engine="interpreted").plot()
    assert [pyplot.figure(number) for number in pyplot.get_fignums()] == [figure]
    pyplot.close("all")
