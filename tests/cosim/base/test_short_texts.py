"""The texts of results: four digits, units, no arrays of numbers."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from bayesftc import controllers, cosim, fmus, monitoring
from bayesftc.cosim.base.numbers import with_article, with_half


def test_a_result_shows_four_digits_and_units_and_has_all_of_them():
    margins = cosim.Margins(2.059427999239328, 35.59179287407551, float("nan"), 11.537691630200618, 22.16851, np.inf)
    assert str(margins) == (
        "Margins(gain=2.059, phase=35.59 deg, delay=nan s, gain_crossover=11.54 rad/s, phase_crossover=22.17 rad/s, modulus=inf, "
        "lowest_gain=0, highest_gain=inf)"
    )
    assert margins.gain == 2.059427999239328
    finding = controllers.ModelFinding("late", "B acts late.", (1 / 3, 0.0), 20 / 3, ("dt",))
    assert str(finding) == "B acts late."
    assert "B acts late." in finding._repr_html_()
    assert "nan" not in controllers.ModelFinding("unknown", "B is wrong.")._repr_html_()
    assert repr(finding).endswith("values=(0.3333, 0), evidence=6.667, others=('dt',))")
    event = monitoring.FaultEvent("wheel", 10 / 3, 20.0, 0.999999, "Frozen", 3.2999999999999998)
    assert repr(event) == (
        "FaultEvent(sensor='wheel', start=3.333 s, end=20 s, probability=1, kind='Frozen', onset=3.3 s, size=None)"
    )


def test_short_alarms_late_in_a_recording_have_a_length():
    event = monitoring.FaultEvent("wheel", 2907.1000000000004, 2907.3, 1.0, "Frozen", 1764237600.05)
    assert repr(event) == (
        "FaultEvent(sensor='wheel', start=2907.1 s, end=2907.3 s, probability=1, kind='Frozen', onset=1764237600.05 s, size=None)"
    )


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (12.4446, 0.0123, "12.445 ± 0.012"),
        (0.5, 0.0996, "0.50 ± 0.10"),
        (-1.23456, 2.0, "-1.2 ± 2.0"),
        (12345.6, 234.5, "12350 ± 230"),
        (3.21e-7, 4.56e-9, "3.210e-07 ± 4.6e-09"),
        (1.5e9, 2.5e7, "1.500e+09 ± 2.5e+07"),
        (1.0 / 3.0, 1e-16, "0.3333 ± 0"),
        (0.0, 0.05, "0.000 ± 0.050"),
        (1.23456, np.nan, "1.235"),
        (1.23456, 0.0, "1.235 ± 0"),
        (np.nan, 0.1, "nan"),
        (np.inf, 0.1, "inf"),
    ],
)
def test_a_mean_has_as_many_decimals_as_two_digits_of_its_interval(value, half, text):
    assert with_half(value, half) == text


def motion(x, u, x_next):
    for i in range(3):
        x_next[i] = 0.9 * x[i] + u[0]


def first_twice(x, y):
    y[0] = y[1] = x[0]


def test_models_and_controllers_are_printed_in_one_line_and_repr_has_all():
    model = controllers.LinearModel(0.9 * np.eye(3), np.eye(3, 1), np.eye(3)[[0, 0]], 0.01, 1.0, dt=0.1)
    sizes = "of 3 states, 1 control, 2 sensors, dt = 0.1 s"
    nonlinear = controllers.NonlinearModel(motion, first_twice, 3, 1, 2, 1e-3, 1.0, 0.1)
    controller = controllers.LQGController(model, goal_on=[[1.0, 0.0, 0.0]])
    assert f"{model} / {nonlinear}" == f"LinearModel {sizes} / NonlinearModel {sizes}"
    assert str(controller) == (
        f"LQGController {sizes}, with SwitchingPrecision; LQGController.describe() returns gains, poles and accuracy"
    )
    for each, kind in (
        (controllers.NonlinearBayesianController(nonlinear, goal_on=[[1.0, 0.0, 0.0]]), "SwitchingPrecision"),
        (controllers.StateEstimator(model, controllers.GammaPrecision()), "GammaPrecision"),
    ):
        assert str(each) == f"{type(each).__name__} {sizes}, with {kind}"
    places = controllers.Modality("positions", matrix=[[1.0], [1.0]], std=0.1)
    law = controllers.Proportional(gain=2.0)
    paper = controllers.UnbiasedActiveInference(places, law, dt=0.05, belief_rate=4.0, control_rate=2.0)
    assert str(paper) == ("UnbiasedActiveInference of 1 state, 1 control, 2 sensors, dt = 0.05 s, with FixedPrecision")
    assert "goal_covariance=array([[" in repr(controller)
    assert "process_covariance=array([[" in repr(controller)


def test_ipython_shows_models_and_blocks_as_print_does():
    """Their repr has all settings, thousands of characters of matrices; campaigns compare them by it."""
    model = controllers.LinearModel(0.9 * np.eye(3), np.eye(3, 1), np.eye(3)[[0, 0]], 0.01, 1.0, dt=0.1)
    nonlinear = controllers.NonlinearModel(motion, first_twice, 3, 1, 2, 1e-3, 1.0, 0.1)
    pretty = pytest.importorskip("IPython.lib.pretty").pretty
    for each in (model, nonlinear, controllers.LQGController(model, goal_on=[[1.0, 0.0, 0.0]])):
        assert pretty(each) == str(each)
        assert len(pretty(each)) < 160
    assert pretty(cosim.Gain(2.0)) == repr(cosim.Gain(2.0))


def test_a_class_in_place_of_an_object_is_named():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 0.01, 1.0, dt=0.1)
    diagram, sentence = cosim.Diagram(0.1), r"the class {0} \(make an object of it: {0}\(...\)\)"
    for make, name in (
        (lambda: controllers.BayesianController(model, precision=controllers.GammaPrecision), "GammaPrecision"),
        (lambda: controllers.StateEstimator(model, controllers.GammaPrecision), "GammaPrecision"),
        (lambda: controllers.BayesianController(controllers.LinearModel), "LinearModel"),
        (lambda: diagram.add(cosim.Sine), "Sine"),
        (lambda: cosim.closed_loop(cosim.FMU, cosim.Constant(1.0), control="u", measured="y", reference=1.0), "FMU"),
    ):
        with pytest.raises(cosim.ModelError, match=sentence.format(name)):
            make()


def test_a_recording_shows_the_shapes_of_its_samples():
    t = 0.1 * np.arange(30)
    recording = monitoring.align({"a": monitoring.Signal(t, t), "b": monitoring.Signal(t, t)}, {}, 0.1)
    assert recording.dt == Fraction(1, 10)
    assert "dt=0.1 s, sensors=('a', 'b'), y=<30 x 2 numbers>, u=<30 x 1 numbers>, loss=(0.01, 0.01)" in repr(recording)


def test_descriptions_and_fits_are_short_and_have_tables():
    description = cosim.FMU(fmus.path("CruiseControl")).description
    assert repr(description).startswith("FMUDescription('CruiseControl', FMI 2.0, coSimulation, ")
    assert "<td" in description._repr_html_()
    time = 0.1 * np.arange(200)
    recording = pd.DataFrame({"time": time, "v": 20.0 * np.exp(-0.05 * time)})
    fitted = cosim.fit(fmus.path("CruiseControl"), recording, {"m": (50.0, 300.0)}, outputs="v")
    assert repr(fitted).startswith("FittedFMU(m=")
    assert repr(fitted).endswith(" kg)")
    assert "Fitted parameters" in fitted._repr_html_()


def test_the_outputs_of_a_step_have_a_table():
    assert "<td" in cosim.Integrator().online(dt=0.5, compiled=False)(u=2.0)._repr_html_()


@pytest.mark.parametrize(
    ("noun", "article"),
    [
        ("int", "an"),
        ("list", "a"),
        ("FMU", "an"),
        ("LQGController", "an"),
        ("LinearModel", "a"),
        ("PID", "a"),
        ("Offset", "an"),
    ],
)
def test_an_article_is_that_of_the_sound(noun, article):
    assert with_article(noun) == f"{article} {noun}"
