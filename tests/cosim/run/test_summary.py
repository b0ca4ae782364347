"""The summary of a run: the figures of `bayesftc run` as tables."""

import math

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.scenario import load_scenario


@pytest.fixture(scope="module")
def loop():
    return load_scenario("cruise_control").loop()


@pytest.fixture(scope="module")
def result(loop):
    return loop.simulate(8.0, seed=1)


def test_its_numbers_are_the_figures_of_the_run(loop, result):
    summary = result.summary()
    numbers = figures(loop_signals(loop, result))
    assert list(summary) == ["errors", "sensors"]
    assert summary["errors"].loc["tracking of v (m/s)", "during"] == numbers.tracking["v"].during
    error = result["plant.v"] - result["reference.y"]
    assert summary["errors"].loc["tracking of v (m/s)", "whole run"] == pytest.approx(np.sqrt(np.mean(error**2)))
    sensors = summary["sensors"]
    assert list(sensors.columns) == ["sensor 0", "sensor 1"]
    assert sensors.loc["faults"].tolist() == [1, 0]
    assert sensors.loc["mean precision in fault (1/(m/s)²)", "sensor 0"] == numbers.sensors[0].precision_faulty
    assert math.isnan(sensors.loc["faults missed", "sensor 1"])


def test_it_prints_aligned_tables(result):
    text = repr(result.summary())
    heading, header, tracking, *_ = text.splitlines()
    assert heading.startswith("Root-mean-square errors")
    assert header.split("  ")[-1] == "after"
    assert len(header) == len(tracking.rstrip("–")) + 1  # no time after the fault
    assert "faults missed" in text
    assert "The tracking error uses the reference at the same instant." in text
    html = result.summary()._repr_html_()
    assert "<td" in html
    assert "tracking of v (m/s)" in html


def test_faults_of_inputs_have_a_table(loop):
    car = load_scenario("cruise_control")
    faulty = cosim.closed_loop(
        car.plant, car.controller, control="force", measured="v", sensors=car.sensors, reference=20.0,
        input_faults={"force": cosim.Bias(magnitude=50.0, start=1.0)},
    )  # fmt: skip
    inputs = faulty.simulate(2.0, engine="interpreted").summary()["inputs"]
    assert inputs.loc["received - sent in fault (root mean square)"].tolist() == [pytest.approx(50.0)]


def test_a_diagram_that_is_no_loop_has_none():
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Ramp(1.0), "ramp")
    with pytest.raises(ModelError, match="not one of a closed loop"):
        diagram.simulate(1.0, engine="interpreted").summary()
