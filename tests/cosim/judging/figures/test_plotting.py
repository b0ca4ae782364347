"""Figures: that they have the panels, lines and names that they should; how they look was judged by eye."""

import pickle
import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.image import imread
from matplotlib.markers import MarkerStyle

from bayesftc import cosim
from bayesftc.controllers import (
    SERFDI,
    FixedPrecision,
    GammaPrecision,
    LinearModel,
    LQGController,
    SwitchingPrecision,
    design,
)
from bayesftc.cosim.errors import UnknownNameError
from bayesftc.cosim.judging.figures.fault_panels import _logarithmic
from bayesftc.cosim.judging.figures.loop_figure import plot_run
from bayesftc.cosim.judging.figures.plotting import MARKERS, plot_signals
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.judging.signals import InputSignals
from bayesftc.examples.cruise_control.cruise_control import cruise_control
from bayesftc.scenario import load_scenario


def test_the_centre_of_each_mark_is_its_sample():
    """The second sensor's triangles seemed to lie below the belief."""
    for mark in map(MarkerStyle, MARKERS):
        (outline,) = mark.get_path().transformed(mark.get_transform()).to_polygons()
        (x, y), (to_x, to_y) = outline[:-1].T, outline[1:].T
        twice = x * to_y - to_x * y  # the area of the triangles between the centre and each edge
        assert abs(twice.sum()) > 0.1
        np.testing.assert_allclose([twice @ (x + to_x), twice @ (y + to_y)], 0.0, atol=1e-9)
        assert mark.is_filled()


def run_of(loop, duration=8.0, **options):
    return loop_signals(loop, loop.simulate(duration, seed=1, **options))


def names(axis):
    return axis.get_legend_handles_labels()[1]


@pytest.fixture(scope="module")
def signals():
    return run_of(load_scenario("cruise_control").loop())


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_expected_noise_of_metres_and_pascals_has_an_axis_for_each(scale):
    """Without units nothing else tells that they differ: both were on one axis from 1e-4 to 1e5."""
    A, B = [[0.9, 0.0], [0.0, 0.8]], [[0.1], [0.1 * scale]]
    model = LinearModel(
        A, B, np.eye(2)[[0, 0, 1, 1]], [1e-4, 1e-4 * scale**2], [0.01, 0.01, *[0.01 * scale**2] * 2], dt=0.1
    )
    plant = control.ss(A, B, np.eye(2), 0, 0.1, inputs=["u"], outputs=["x", "p"])
    loop = cosim.closed_loop(
        plant, LQGController(model, SwitchingPrecision(), goal_on=[[1.0, 0.0]]), control="u", measured=["x", "p"],
        sensors=cosim.Sensors([2, 2], [0.1, 0.1 * scale]), reference=0.0,
    )  # fmt: skip
    labels = [axis.get_ylabel() for axis in plot_run(run_of(loop, 3.0, engine="interpreted"), "").figure.axes]
    found = [label for label in labels if label.startswith("expected standard")]
    assert found == [f"expected standard\ndeviation{of}" for of in ([""] if scale == 1.0 else [" of x", " of p"])]


def panel(figure, beginning):
    """The only panel whose label begins so."""
    (found,) = [axis for axis in figure.axes if axis.get_ylabel().startswith(beginning)]
    return found


def test_the_panels_of_a_run(signals, tmp_path):
    figure = plot_run(signals, "a title")
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == [
        "v (m/s)", "sensor 0\n(m/s)", "sensor 1\n(m/s)", "force (N)", "expected standard\ndeviation (m/s)", "fault probability",
    ]  # fmt: skip
    quantity, first, second, control, deviation, detection = figure.axes
    assert names(quantity) == [
        "reference", "true value", "belief: mean", "belief: 95 % interval", "shaded: sensor fault",
    ]  # fmt: skip
    assert (names(first), names(second), names(control)) == (["belief: mean", "samples"], [], ["control"])
    assert deviation.get_yscale() == "log"
    assert names(deviation) == ["sensor 0", "sensor 0 ignored", "sensor 1"]
    assert detection.get_xlabel() == "time (s)"
    assert [t.get_text() for t in quantity.texts] == ["sensor 0: freeze"]
    lines = {line.get_label(): line.get_ydata() for line in quantity.lines}
    np.testing.assert_array_equal(lines["true value"], signals.quantities[0].truth)
    np.testing.assert_array_equal(second.lines[-1].get_ydata(), signals.sensors[1].samples)
    spread = signals.quantities[0].spread
    assert 0 < spread[-1] < 1
    low, high = np.quantile(quantity.collections[0].get_paths()[0].vertices[:, 1], [0, 1])
    belief = signals.quantities[0].belief
    np.testing.assert_allclose([low, high], [(belief - 1.96 * spread).min(), (belief + 1.96 * spread).max()])
    shown = deviation.lines[0].get_ydata()
    expected = 1 / np.sqrt(signals.sensors[0].precision)
    ignored = np.isnan(shown)
    np.testing.assert_allclose(shown[~ignored], expected[~ignored])
    assert expected[ignored].min() > 50 > np.nanmax(shown)  # a line at a million says less than the word
    assert [t.get_text() for t in deviation.texts] == ["ignored"]
    assert [t.get_text() for t in detection.texts] == ["frozen"]
    for axis, shades in zip(figure.axes[1:5], (1, 0, 0, 1), strict=True):  # where the frozen sensor is concerned
        assert len(axis.collections) == shades
        assert all(len(each.get_paths()) == 1 for each in axis.collections)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # as of panels that do not fit
        warnings.simplefilter("ignore", DeprecationWarning)  # older versions of matplotlib call what pyparsing renames
        figure.savefig(tmp_path / "run.png", dpi=80)
    height, width, _ = imread(tmp_path / "run.png").shape
    assert (width, height) == (640, int(80 * figure.get_figheight()))


def test_where_true_value_and_reference_coincide_their_difference_has_a_panel(signals):
    """Of an axis the panel of the position has one line for all, which says nothing of how well it is tracked and known."""
    assert not [axis for axis in plot_run(signals).axes if "error of" in axis.get_ylabel()]
    axis_of = control.ss([[0, 1], [0, -5.0]], [[0], [2000.0]], [[1, 0]], 0, inputs=["u"], outputs=["x [um]"])
    controller = design(axis_of, measured="x [um]", sensors=2, sensor_std=0.5, dt=0.001, noise={"u": 0.01}, preview=50,
                        acceptable_error=1.0, acceptable_control=100.0)  # fmt: skip
    loop = cosim.closed_loop(plant=axis_of, controller=controller, control="u", measured="x [um]",
                             sensors=cosim.Sensors(2, 0.5), reference=cosim.Sine(500.0, 0.5))  # fmt: skip
    result = loop.simulate(1.2, seed=1)
    errors = panel(plot_run(loop_signals(loop, result)), "error of x")
    assert errors.get_ylabel().endswith("[um]")
    assert names(errors) == ["true value - reference", "belief - true value", "95 % interval of\nthe belief's error"]
    tracking, belief = (line.get_ydata() for line in errors.get_lines()[:2])
    goal = 500.0 * np.sin(4.0 * np.pi * result.time)
    np.testing.assert_allclose(tracking, result["plant.x [um]"] - goal, atol=1e-9)
    np.testing.assert_allclose(belief, result["controller.x_hat"][:, 0] - result["plant.x [um]"], atol=1e-9)
    assert np.abs(errors.get_ylim()).max() < 1.0  # the transient at the start, of 250, does not hide the rest


def test_sensors_of_several_quantities_are_called_by_them(signals):
    speed = signals.quantities[0]
    several = replace(signals, quantities=(replace(speed, sensors=(0,)), replace(speed, name="w", sensors=(1,))))
    *_, deviation, probability = plot_run(several).axes
    assert {"sensor 0 (v)", "sensor 1 (w)"} <= {*names(deviation)} & {*names(probability)}
    assert [s["title"] for s in figures(several).to_dict()["sensors"]] == ["sensor 0 (v)", "sensor 1 (w)"]
    assert [s["title"] for s in figures(signals).to_dict()["sensors"]] == ["sensor 0", "sensor 1"]


@pytest.mark.slow
def test_no_legend_covers_anything(signals):
    figure = plot_run(signals)
    figure.canvas.draw()
    for axis in figure.axes:
        if axis.get_legend() is None:
            continue
        assert axis.get_legend().get_window_extent().x0 >= axis.get_window_extent().x1
        assert axis.get_legend().get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.slow
def test_no_state_of_pyplot_is_touched(python):
    code = (
        "import json, sys\nfrom bayesftc.scenario import load_scenario\nfrom bayesftc.cosim.judging.roles import loop_signals\n"
        "from bayesftc.cosim.judging.figures.loop_figure import plot_run\nloop = load_scenario('cruise_control').loop()\n"
        "plot_run(loop_signals(loop, loop.simulate(0.2, engine='interpreted'))).savefig('/dev/null', format='png')\n"
        "print(json.dumps('matplotlib.pyplot' in sys.modules))"
    )
    assert python(code) is False


def test_beta_stands_in_for_a_missing_probability():
    figure = plot_run(run_of(cruise_control(GammaPrecision())))
    beta = panel(figure, "beta")
    assert beta.get_ylabel() == "beta ((m/s)²)"
    assert names(beta) == ["sensor 0", "sensor 1"]


def test_neither_beta_nor_probability():
    figure = plot_run(run_of(cruise_control(FixedPrecision()), 1.0))
    assert figure.axes[-1] is panel(figure, "expected")


def test_ticks_of_logarithmic_panels_are_plain_numbers():
    _, axis = pyplot.subplots()
    for high in (3.0, 3000.0):
        axis.set_ylim(0.01, high)
        _logarithmic(axis, [np.array([0.01, high])])
        axis.figure.canvas.draw()
        texts = [label.get_text() for label in axis.get_yticklabels()]
        assert "0.01" in texts
        assert not any("$" in text for text in texts)


def test_ignored_samples_are_marked():
    signals = run_of(cruise_control(SERFDI(threshold=2.0)))
    deviation = panel(plot_run(signals), "expected")
    marks = next(line for line in deviation.lines if line.get_label() == "sensor 0 ignored")
    bars = marks.get_xdata().reshape(-1, 3)  # begin, end, gap
    marked = np.any([(a <= signals.time) & (signals.time <= b) for a, b, _ in bars], axis=0)
    np.testing.assert_array_equal(marked, signals.sensors[0].precision == 0)
    assert 5 < len(bars) < marked.sum()
    assert marks.get_linewidth() > 3  # periods are bars without gaps ...
    assert marks.get_marker() == "|"  # ... and a single sample has a tick


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("joint", "word"), [(True, "corrected"), (False, "ignored")])
def test_a_sensor_whose_offset_is_subtracted_is_not_called_ignored(joint, word):
    loop = cruise_control(SwitchingPrecision(joint=joint), cosim.Bias(sensor=0, start=1.0, magnitude=8.0))
    run = run_of(loop, 4.0)
    deviation = panel(plot_run(run), "expected")
    assert [t.get_text() for t in deviation.texts] == [word]
    first, second = run.sensors
    first = replace(first, probability=np.append(np.nan, first.probability[1:]))  # no probability yet
    unknown = panel(plot_run(replace(run, sensors=(first, second))), "expected")
    assert [t.get_text() for t in unknown.texts] == [word]
    explained = ["corrected: the inferred\noffset is subtracted"] * joint
    assert names(deviation) == ["sensor 0", f"sensor 0 {word}", "sensor 1", *explained]


def offset_for_a_while(stop):
    """Return the run of a car of which a sensor has an offset from the first to another second, and is corrected."""
    learner = SwitchingPrecision(joint=True)
    return run_of(cruise_control(learner, cosim.Bias(sensor=0, start=1.0, stop=stop, magnitude=8.0)), 10.0)


def test_a_corrected_sensor_has_a_hatched_bar_and_an_ignored_one_a_filled_bar():
    run = offset_for_a_while(4.0)
    deviation = panel(plot_run(run), "expected")
    look = {text: handle for handle, text in zip(*deviation.get_legend_handles_labels(), strict=True)}
    assert look["sensor 0 corrected"].get_hatch() == look["corrected: the inferred\noffset is subtracted"].get_hatch()
    assert look["sensor 0 corrected"].get_hatch()
    ignored = replace(run.sensors[0], corrected_kinds=())
    deviation = panel(plot_run(replace(run, sensors=(ignored, run.sensors[1]))), "expected")
    (bar,) = [line for line in deviation.lines if line.get_label() == "sensor 0 ignored"]
    assert bar.get_linewidth() > 3


def test_a_short_bar_has_its_word_beside_it():
    figure = plot_run(offset_for_a_while(1.4))
    for axis, word in ((panel(figure, "expected"), "corrected"), (panel(figure, "fault"), "offset")):
        (text,) = [each for each in axis.texts if each.get_text() == word]
        assert 1.5 < text.get_position()[0] < 3.0


def test_marks_stand_above_the_ticks_of_the_values():
    deviation = panel(plot_run(offset_for_a_while(4.0)), "expected")
    deviation.figure.canvas.draw()
    _, top = deviation.spines["left"].get_bounds()
    ticks = [*deviation.yaxis.get_majorticklocs(), *deviation.yaxis.get_minorticklocs()]
    values = np.concatenate(
        [line.get_ydata() for line in deviation.lines if line.get_label() in ("sensor 0", "sensor 1")]
    )
    assert max(*ticks, np.nanmax(values)) <= top < 0.8 * deviation.get_ylim()[1]
    (mark,) = [each for each in deviation.collections if each.get_label() == "sensor 0 corrected"]
    lowest = min(path.vertices[:, 1].min() for path in mark.get_paths())  # as a share of the height
    assert deviation.transAxes.transform((0, lowest))[1] > deviation.transData.transform((0, top))[1]


def test_a_second_fault_of_an_input_or_a_sensor_is_numbered_in_words():
    loop = integrator_loop(
        faults=[cosim.Freeze(sensor=0, start=2.0, stop=3.0), cosim.Freeze(sensor=0, start=6.0, stop=7.0)],
        input_faults={
            "u": [cosim.Bias(magnitude=2.0, start=1.0, stop=2.0), cosim.Bias(magnitude=1.0, start=4.0, stop=5.0)]
        },
    )
    named = [text.get_text() for text in plot_run(run_of(loop)).axes[0].texts]
    assert named == ["u: bias", "sensor 0: freeze", "u: bias 2", "sensor 0: freeze 2"]


@pytest.mark.slow
def test_only_a_sensor_with_an_alarm_and_without_weight_for_its_quantity_is_called_ignored(signals):
    first, second = signals.sensors
    coarse = replace(second, precision=1e-6 * second.precision)  # healthy, with a thousand times the noise

    def marked(**changes):
        return names(panel(plot_run(replace(signals, **changes)), "expected"))

    assert marked(sensors=(first, coarse)) == ["sensor 0", "sensor 0 ignored", "sensor 1"]
    speed = signals.quantities[0]
    apart = (replace(speed, sensors=(0,)), replace(speed, name="w", sensors=(1,)))
    blamed = replace(second, precision=np.where(signals.time > 1.0, coarse.precision, second.precision))
    blamed = replace(blamed, probability=np.ones_like(coarse.probability))
    assert marked(sensors=(first, blamed))[-1] == "sensor 1 ignored"
    # Learners without a probability have no alarms. A sensor that always has so little weight is not ignored by them.
    assert marked(sensors=(first, replace(coarse, probability=None)))[-1] == "sensor 1"
    assert marked(sensors=(first, replace(blamed, probability=None)))[-1] == "sensor 1 ignored"
    alone = replace(coarse, probability=blamed.probability)
    assert marked(sensors=(first, alone), quantities=apart)[-1] == "sensor 1 (w)"


def test_times_at_which_the_plant_moves_more_than_its_model_have_a_row(signals):
    moved = np.where((signals.time > 2.0) & (signals.time < 3.0), 0.9, 0.0)
    words = [
        [text.get_text() for text in panel(plot_run(replace(signals, process=process)), "fault").texts]
        for process in (moved, 0.0 * moved, None)
    ]
    assert ["noisier process" in texts for texts in words] == [True, False, False]


def test_missing_samples_are_gaps_and_marks():
    loop = integrator_loop(
        faults=[cosim.Dropout(sensor=0, start=2.0, stop=3.0)],
    )
    signals = run_of(loop, 4.0)
    figure = plot_run(signals)
    deviation, detection = panel(figure, "expected"), panel(figure, "fault")
    # The learner infers the dropout, whose probability has no gap; other learners only relax meanwhile.
    assert detection.lines[0].get_ydata()[105:145].min() > 0.9
    sensors = tuple(replace(sensor, kinds=(), kind=None) for sensor in signals.sensors)
    others = panel(plot_run(replace(signals, sensors=sensors)), "fault")
    assert np.isnan(others.lines[0].get_ydata()).sum() == 50
    marks = {line.get_label(): line.get_xdata() for line in deviation.lines}
    assert len(marks["sensor 0 missing"]) == 50
    assert "sensor 1 missing" not in marks
    assert "dropped out" in [t.get_text() for t in detection.texts]


def test_a_slow_sensor_has_a_line_through_its_samples_and_only_its_losses_are_missing(signals):
    first, second = signals.sensors
    steps = np.arange(len(signals.time))
    due = steps % 10 == 0
    lost = (steps >= 300) & (steps < 400)
    slow = replace(second, samples=np.where(due, second.samples, np.nan), kinds=(), kind=None)
    figure = plot_run(replace(signals, sensors=(first, slow)))
    deviation, detection = panel(figure, "expected"), panel(figure, "fault")
    assert names(deviation) == ["sensor 0", "sensor 0 ignored", "sensor 1"]
    for axis, values in ((deviation, 1 / np.sqrt(slow.precision)), (detection, slow.probability)):
        (line,) = [each for each in axis.lines if each.get_label() == "sensor 1"]
        assert np.array_equal(line.get_ydata(), values[steps - steps % 10])
    (strip,) = [each for each in panel(figure, "sensor 1").lines if each.get_marker() != "None"]
    assert len(strip.get_xdata()) == due.sum()
    stopped = replace(slow, samples=np.where(lost, np.nan, slow.samples))
    marks = {
        line.get_label(): line for line in panel(plot_run(replace(signals, sensors=(first, stopped))), "expected").lines
    }
    assert np.array_equal(marks["sensor 1 missing"].get_xdata(), signals.time[lost])
    assert 10 < len(marks["sensor 1 missing"].get_markevery()) < 50  # crosses that one can tell apart


def test_many_faults_are_not_named_one_by_one():
    loop = integrator_loop(
        faults=[cosim.RandomFaults(sensor=i, mean_time_to_fault=0.2, mean_time_to_recovery=0.1) for i in range(2)],
        input_faults={"u": [cosim.Bias(magnitude=0.1, start=0.5, stop=0.6)]},
    )
    signals = run_of(loop)
    texts = [t.get_text() for t in plot_run(signals).axes[0].texts]
    faults = sum(int(np.sum(np.diff(active, prepend=0.0) > 0)) for _, active in signals.faults.values())
    assert texts == [f"shaded: {faults} faults, in the colour of their sensor; hatched: 1"]


def test_a_run_of_one_row(tmp_path):
    with pytest.warns(UserWarning, match="starts at 6 s"):
        run = run_of(cruise_control(GammaPrecision()), 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_run(run).savefig(tmp_path / "one.png")


def test_long_runs_are_thinned(signals):
    n = 100_000
    recording = np.random.default_rng(0).normal(size=(n, 1))
    result = cosim.Result(recording, {"a.y": (0, ())}, cosim.Diagram(0.1).step)
    assert 10_000 < len(plot_signals(result).axes[0].lines[0].get_xdata()) <= 20_000


@pytest.mark.slow
def test_a_long_title_fits_the_figure(signals):
    figure = plot_run(
        signals, "model of controller suspect from t = 1510 s, all 3 sensors of level agree but are blamed " * 3
    )
    figure.draw_without_rendering()
    title = figure.get_suptitle()
    assert title.count("\n") == 2
    assert figure._suptitle.get_window_extent().x1 < figure.bbox.x1


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("controls", "label"),
    [((0,), "actuator fault"), ((None,), "process fault"), ((0, None), "actuator or process fault"), ((), None)],
)
def test_the_legend_names_hatching(signals, controls, label):
    late = signals.time > 4.0
    inputs = tuple(InputSignals(f"u{i}", None, None, late + 0.0, {"bias_0": late}, j) for i, j in enumerate(controls))
    lines = names(plot_run(replace(signals, inputs=inputs)).axes[0])
    assert [line for line in lines if line.startswith("hatched")] == ([f"hatched: {label}"] if label else [])
    assert "shaded: sensor fault" in lines
    assert "shaded: sensor fault" not in names(plot_run(replace(signals, inputs=inputs, faults={})).axes[0])


def test_signals_by_unit():
    result = load_scenario("cruise_control").simulate(duration=1.0, engine="interpreted")
    figure = result.plot(["plant.v", "reference.y", "controller.u", "controller.precision"])
    assert [axis.get_ylabel() for axis in figure.axes] == ["m/s", "N", "controller.precision"]
    assert names(figure.axes[0]) == ["plant.v", "reference.y"]
    assert names(figure.axes[2]) == ["controller.precision[0]", "controller.precision[1]"]
    assert len(result.plot("plant.v").axes) == 1
    assert sum(len(axis.lines) for axis in result.plot_signals().axes) == sum(
        result[name].size // len(result.time)
        for name in result
        if result[name].ndim < 3 and np.isfinite(result[name]).any()
    )
    with pytest.raises(UnknownNameError, match=r"known names: plant\.v"):
        result.plot(["plant.w"])


@pytest.mark.parametrize("unit", [None, ("m", "degC")])
def test_a_vector_of_several_quantities_has_a_panel_for_each(unit, tmp_path):
    """A level of 1 m and a temperature of 50 degC would be unreadable on one axis."""
    a, b, c = np.diag([0.9, 0.8]), np.eye(2), np.repeat(np.eye(2), [2, 1], axis=0)
    model = LinearModel(a, b, c, 1e-4 * np.eye(2), np.diag([1e-4, 1e-4, 0.04]), dt=0.1)
    plant = cosim.StateSpace(
        control.ss(a, b, np.eye(2), 0, 0.1, inputs=["inflow", "heater"], outputs=["level", "temperature"])
    )
    loop = cosim.closed_loop(
        plant, LQGController(model, goal_covariance=0.01, control_covariance=4.0), control=["inflow", "heater"],
        measured=["level", "temperature"], sensors=cosim.Sensors(count=[2, 1], std=[0.01, 0.2], unit=unit),
        faults=[cosim.Drift(sensor=0, start=0.5, slope=0.1)], reference=[1.0, 50.0],
    )  # fmt: skip
    loop.simulate(1.0, seed=1, engine="interpreted").save(tmp_path / "run.npz")
    result = cosim.Result.load(tmp_path / "run.npz")
    figure = result.plot_signals(["sensors.y", "drift_0.y", "controller.u", "controller.innovation"])
    readings = ["sensors.y\nlevel", "sensors.y\ntemperature", "drift_0.y\nlevel", "drift_0.y\ntemperature"]
    sensors = ["sensors in m", "sensors in degC"] if unit else ["level", "temperature"]
    controls = [f"controller.u\n{name}" for name in ("inflow", "heater")]
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == [*(unit or readings), *controls, *(f"controller.innovation\n{name}" for name in sensors)]
    assert names(figure.axes[0])[:2] == ["sensors.y[0]", "sensors.y[1]"]
    assert names(figure.axes[-1]) == ["controller.innovation[2]"]


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


def test_a_result_knows_its_loop_in_every_copy(tmp_path):
    result = load_scenario("cruise_control").simulate(duration=0.4, engine="interpreted")
    shown = [axis.get_ylabel() for axis in result.plot().axes]
    assert shown[-1] == "fault probability"
    for copy in (pickle.loads(pickle.dumps(result)), cosim.Result.load(result.save(tmp_path / "run.npz"))):
        assert copy.roles == result.roles
        assert [axis.get_ylabel() for axis in copy.plot().axes] == shown


@pytest.mark.slow
def test_a_loop_of_too_many_faults_is_pickled_all_the_same(signals):
    loop = integrator_loop(
        faults=[cosim.Freeze(sensor=0, start=1.0, name=f"freeze_{i}") for i in range(990)],
    )
    result = cosim.Result(np.zeros((1, 1)), {"a.y": (0, ())}, loop.step, parts=loop)
    assert pickle.loads(pickle.dumps(result)).roles is None


def test_what_is_no_loop_has_the_figure_of_its_signals():
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Constant(1.0), "one")
    result = diagram.simulate(0.5, engine="interpreted")
    assert result.roles is None
    assert [axis.get_ylabel() for axis in result.plot().axes] == ["one.y"]
    without = load_scenario("cruise_control").simulate(duration=0.4, engine="interpreted", record=["plant.v"])
    assert [axis.get_ylabel() for axis in without.plot().axes] == ["m/s"]


def test_the_limits_of_a_control_and_what_the_plant_received():
    controller = replace(load_scenario("cruise_control").controller, u_min=-800.0, u_max=900.0)
    limited = cosim.closed_loop(
        plant=cosim.StateSpace(_integrator()),
        controller=controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=1.0),
        input_faults={"u": cosim.GainFault(factor=0.5, start=1.0)},
        reference=1.0,
    )
    signals = run_of(limited, 2.0)
    control = panel(plot_run(signals), "u")
    assert names(control) == ["control", "received by u", "limits of the control"]
    assert [line.get_ydata()[0] for line in control.lines[2:]] == [-800.0, 900.0]
    sent, received = (line.get_ydata() for line in control.lines[:2])
    np.testing.assert_array_equal(received[60:], 0.5 * sent[60:])


@pytest.mark.parametrize(("low", "high", "label"), [(-1e4, 1e4, []), (-1e4, 150.0, ["limit of the control"])])
def test_only_limits_within_the_panel_are_in_the_legend(signals, low, high, label):
    sent = np.where(signals.time < 0.1, 1e4, 100.0 * np.sin(signals.time))  # the start is cut off
    sent[-1] = 160.0
    (control,) = signals.controls
    axis = panel(plot_run(replace(signals, controls=(replace(control, sent=sent, low=low, high=high),))), "force")
    assert names(axis) == ["control", *label]


@pytest.mark.slow
def test_samples_of_many_sensors_leave_room_for_the_rest():
    controller = load_scenario("cruise_control").controller
    model = replace(controller.model, C=np.ones((14, 1)), sensor_covariance=1.0)
    loop = cosim.closed_loop(
        plant=cosim.StateSpace(_integrator()),
        controller=replace(controller, model=model, precision=FixedPrecision()),
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=14, std=1.0),
        reference=1.0,
    )
    figure = plot_run(run_of(loop, 0.2))
    assert sum(axis.get_ylabel().startswith("sensor ") for axis in figure.axes) == 12
    assert names(figure.axes[1])[-1] == "samples\n(2 more sensors are not drawn)"


def _integrator():
    import control

    return control.ss([[1.0]], [[2e-4]], [[1.0]], 0, 0.02, inputs=["u"], outputs=["y"])


def integrator_loop(**parts):
    """A loop with two sensors and some faults."""
    return cosim.closed_loop(
        plant=cosim.StateSpace(_integrator()),
        controller=load_scenario("cruise_control").controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=1.0),
        reference=1.0,
        **parts,
    )


@pytest.mark.parametrize(
    ("hours", "label", "last"), [(1.0, "time (s)", "3500"), (8.0, "time (h)", "8"), (240.0, "time (d)", "10")]
)
def test_long_times_are_in_hours_or_days(hours, label, last):
    diagram = cosim.Diagram(dt=36.0)
    diagram.add(cosim.Gaussian(std=1.0), "noise")
    figure = diagram.simulate(hours * 3600.0, seed=1).plot_signals()
    figure.canvas.draw()
    axis = figure.axes[-1]
    low, high = axis.get_xlim()
    ticks = [text.get_text() for text in axis.get_xticklabels() if low <= text.get_position()[0] <= high]
    assert axis.get_xlabel() == label
    assert ticks[-1] == last
