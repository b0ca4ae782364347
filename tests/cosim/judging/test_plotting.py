"""Figures: that they have the panels, lines and names that they should; how they look was judged by eye."""

import warnings

import numpy as np
import pytest
from matplotlib.image import imread

from bayesftc import cosim
from bayesftc.controllers import SERFDI, FixedPrecision, GammaPrecision
from bayesftc.cosim.errors import UnknownNameError
from bayesftc.cosim.judging.plotting import plot_run, plot_signals
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.examples.cruise_control.cruise_control import cruise_control
from bayesftc.scenario import load_scenario


def run_of(loop, duration=8.0, **options):
    return loop_signals(loop, loop.simulate(duration, seed=1, engine="interpreted", **options))


def names(axis):
    return axis.get_legend_handles_labels()[1]


@pytest.fixture(scope="module")
def signals():
    return run_of(load_scenario("cruise_control").loop())


def test_the_panels_of_a_run(signals, tmp_path):
    figure = plot_run(signals, "a title")
    quantity, deviation, detection = figure.axes
    assert quantity.get_ylabel() == "v (m/s)"
    assert names(quantity) == ["sensor 0", "sensor 1", "reference", "true value", "belief"]
    assert "standard" in deviation.get_ylabel()
    assert deviation.get_yscale() == "log"
    assert names(deviation) == ["sensor 0", "sensor 1"]
    assert detection.get_ylabel() == "fault probability"
    assert detection.get_xlabel() == "time (s)"
    assert [t.get_text() for t in quantity.texts] == ["sensor 0: freeze"]
    lines = {line.get_label(): line.get_ydata() for line in quantity.lines}
    np.testing.assert_array_equal(lines["true value"], signals.quantities[0].truth)
    np.testing.assert_array_equal(lines["sensor 1"], signals.sensors[1].samples)
    shown = deviation.lines[0].get_ydata()
    np.testing.assert_allclose(shown, 1 / np.sqrt(signals.sensors[0].precision))
    for axis in figure.axes:  # the frozen sensor is shaded in every panel
        assert len(axis.collections) == 1
        assert len(axis.collections[0].get_paths()) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # as of panels that do not fit
        warnings.simplefilter("ignore", DeprecationWarning)  # older versions of matplotlib call what pyparsing renames
        figure.savefig(tmp_path / "run.png", dpi=80)
    height, width, _ = imread(tmp_path / "run.png").shape
    assert (width, height) == (640, round(80 * figure.get_figheight()))


def test_no_legend_covers_anything(signals):
    figure = plot_run(signals)
    figure.canvas.draw()
    for axis in figure.axes:
        assert axis.get_legend().get_window_extent().x0 >= axis.get_window_extent().x1
        assert axis.get_legend().get_window_extent().x1 <= figure.bbox.x1


def test_no_state_of_pyplot_is_touched(python):
    code = (
        "import json, sys\nfrom bayesftc.scenario import load_scenario\nfrom bayesftc.cosim.judging.roles import loop_signals\n"
        "from bayesftc.cosim.judging.plotting import plot_run\nloop = load_scenario('cruise_control').loop()\n"
        "plot_run(loop_signals(loop, loop.simulate(0.2, engine='interpreted'))).savefig('/dev/null', format='png')\n"
        "print(json.dumps('matplotlib.pyplot' in sys.modules))"
    )
    assert python(code) is False


def test_beta_stands_in_for_a_missing_probability():
    figure = plot_run(run_of(cruise_control(GammaPrecision())))
    assert figure.axes[2].get_ylabel() == "beta"
    assert names(figure.axes[2]) == ["sensor 0", "sensor 1"]


def test_neither_beta_nor_probability():
    figure = plot_run(run_of(cruise_control(FixedPrecision()), 1.0))
    assert [t.get_text() for t in figure.axes[2].texts] == ["no fault probability and no beta in this run"]


def test_ignored_samples_are_marked():
    signals = run_of(cruise_control(SERFDI(threshold=2.0)))
    deviation = plot_run(signals).axes[1]
    marks = {line.get_label(): line.get_xdata() for line in deviation.lines}
    np.testing.assert_array_equal(marks["sensor 0 ignored"], signals.time[signals.sensors[0].precision == 0])
    assert len(marks["sensor 0 ignored"]) > 5


def test_missing_samples_are_gaps_and_marks():
    loop = cosim.closed_loop(
        plant=cosim.StateSpace(_integrator()),
        controller=load_scenario("cruise_control").controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.Dropout(sensor=0, start=2.0, stop=3.0)],
        reference=1.0,
    )
    _, deviation, detection = plot_run(run_of(loop, 4.0)).axes
    assert np.isnan(detection.lines[0].get_ydata()).sum() == 50
    marks = {line.get_label(): line.get_xdata() for line in deviation.lines}
    assert len(marks["sensor 0 missing"]) == 50
    assert "sensor 1 missing" not in marks


def test_many_faults_are_not_named_one_by_one():
    loop = cosim.closed_loop(
        plant=cosim.StateSpace(_integrator()),
        controller=load_scenario("cruise_control").controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.RandomFaults(sensor=i, mean_time_to_fault=0.2, mean_time_to_recovery=0.1) for i in range(2)],
        reference=1.0,
    )
    texts = [t.get_text() for t in plot_run(run_of(loop)).axes[0].texts]
    assert len(texts) == 1
    assert "faults, in the colour of their sensor" in texts[0]


def test_a_run_of_one_row(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_run(run_of(cruise_control(GammaPrecision()), 0.0)).savefig(tmp_path / "one.png")


def test_long_runs_are_thinned(signals):
    n = 100_000
    recording = np.random.default_rng(0).normal(size=(n, 1))
    result = cosim.Result(recording, {"a.y": (0, ())}, cosim.Diagram(0.1).step)
    assert len(plot_signals(result).axes[0].lines[0].get_xdata()) == 20_000


def test_signals_by_unit():
    result = load_scenario("cruise_control").simulate(duration=1.0, engine="interpreted")
    figure = result.plot(["plant.v", "reference.y", "controller.u", "controller.precision"])
    assert [axis.get_ylabel() for axis in figure.axes] == ["m/s", "controller.u", "controller.precision"]
    assert names(figure.axes[0]) == ["plant.v", "reference.y"]
    assert names(figure.axes[2]) == ["controller.precision[0]", "controller.precision[1]"]
    assert len(result.plot("plant.v").axes) == 1
    assert sum(len(axis.lines) for axis in result.plot().axes) == sum(
        result[name].size // len(result.time)
        for name in result
        if result[name].ndim < 3 and np.isfinite(result[name]).any()
    )
    with pytest.raises(UnknownNameError, match=r"did you mean 'plant\.v'"):
        result.plot(["plant.w"])


def test_signals_without_a_number_long_names_and_small_changes():
    rows = np.array([[1000.0 + 0.001 * k, np.nan, k] for k in range(5)])
    names_of = {"a.actuator_fault_probability": (2, ()), "a.none": (1, ()), "a.large": (0, ())}
    result = cosim.Result(rows, names_of, cosim.Diagram(0.1).step)
    figure = result.plot()
    figure.draw_without_rendering()
    assert [axis.get_ylabel() for axis in figure.axes] == ["a.actuator_fault_\nprobability", "a.large"]
    assert figure.axes[1].yaxis.get_offset_text().get_text() == ""
    assert figure.axes[1].yaxis.get_ticklabels()[1].get_text().startswith("1000.0")
    heights = [(axis.yaxis.label.get_window_extent().height, axis.bbox.height) for axis in figure.axes]
    assert all(label < 1.1 * panel for label, panel in heights)
    (panel,) = result.plot("a.none").axes
    assert [t.get_text() for t in panel.texts] == ["no value"]


def _integrator():
    import control

    return control.ss([[1.0]], [[2e-4]], [[1.0]], 0, 0.02, inputs=["u"], outputs=["y"])
