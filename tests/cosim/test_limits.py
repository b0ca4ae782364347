"""Numbers and sizes that nobody means are refused in a sentence, where they come in."""

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.diagnose import diagnose_recording
from bayesftc.cosim.blocks.linear_system import LinearSystem
from bayesftc.cosim.diagram.closed_loop import MOST_FAULTS
from bayesftc.cosim.errors import BayesFTCError, ModelError, RecordingError, ScenarioError
from bayesftc.monitoring import load_monitor
from bayesftc.monitoring.csv import MOST_COLUMNS, Tables
from bayesftc.scenario import load_scenario
from bayesftc.scenario.campaigns import load_campaign

FREEZE = cosim.Freeze(start=1.0)


def model(**changes):
    parts = {"A": [[0.9]], "B": [[1.0]], "C": [[1.0], [1.0]], "process_covariance": 0.1, "sensor_covariance": 1.0}
    return controllers.LinearModel(**(parts | {"dt": 0.1} | changes))


def delayed():
    diagram = cosim.Diagram(0.02)
    diagram.connect(
        diagram.add(cosim.Constant(1.0), "one")["y"], diagram.add(cosim.Delay(delay=1e9, channels=1), "late")["u"]
    )
    return diagram.simulate(0.1)


def lag():
    return LinearSystem(((0.9,),), ((1.0,),), ((1.0,),), ((0.0,),), 0.1, ("u",), ("y",))


def looped(faults):
    controller = controllers.BayesianController(model())
    wiring = {"control": "u", "measured": "y", "reference": cosim.Constant(1.0)}
    return cosim.closed_loop(
        cosim.StateSpace(lag()), controller, sensors=cosim.Sensors(count=2), faults=faults, **wiring
    )


REFUSED = {
    "an entry that overflows": (lambda: model(B=[[1e300]]), "The model's B has an entry of 1e.300"),
    "a variance that underflows": (lambda: model(sensor_covariance=5e-324), "has a variance of 4.94e-324"),
    "an initial mean that overflows": (
        lambda: controllers.BayesianController(model(), initial_mean=1e300),
        "has an entry of 1e.300",
    ),
    "rows of two lengths": (lambda: model(C=[[1.0], []]), "The model's C is .* must be a matrix of numbers"),
    "a state of two lengths": (
        lambda: cosim.StateSpace(lag(), initial=[[1.0], []]),
        "must be 1 finite numbers",
    ),
    "weights of two lengths": (lambda: cosim.RandomFaults(weights=[[1.0], []]), "RandomFaults has weights"),
    "times of two lengths": (lambda: cosim.Table([[1.0], []], [1.0]), "as many times as values"),
    "a long delay": (delayed, "1e.10 steps|5e.10 steps"),
    "many faults": (lambda: looped([FREEZE] * (MOST_FAULTS + 1)), f"a signal has at most {MOST_FAULTS}"),
    "many modes": (lambda: controllers.SwitchingPrecision(modes=[controllers.Offset()] * 33), "has 33 modes"),
    "many samples": (lambda: cosim.LatinHypercube({"a": (0, 1)}, 10**9), "has 1000000000 points"),
    "many combinations": (
        lambda: cosim.Grid({name: range(2000) for name in "ab"}).points(),
        "The design has 4000000 points",
    ),
    "products of many": (
        lambda: (cosim.Grid({"a": range(2000)}) * cosim.Grid({"b": range(2000)})).points(),
        "The design has 4000000 points",
    ),
    "a range beyond all numbers": (lambda: cosim.LatinHypercube({"a": (0, 10**400)}, 2), "both finite"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_it_is_refused(name):
    make, words = REFUSED[name]
    with pytest.raises(ModelError, match=words) as caught:
        make()
    assert str(caught.value)[-1] in ".?"


def test_whole_numbers_of_any_size_are_drawn():
    points = cosim.LatinHypercube({"a": range(0, 10**30, 10**10)}, 4).points()
    assert all(0 <= point["a"] < 10**30 and point["a"] % 10**10 == 0 for point in points)


def test_a_campaign_of_too_many_runs(tmp_path):
    (tmp_path / "many.toml").write_text('scenario = "cruise_control"\nseeds = 1000000000\n')
    with pytest.raises(BayesFTCError, match=r"seeds is 1000000000 and there are 1 points, .* at most 10,000,000 runs"):
        load_campaign(tmp_path / "many.toml")


def test_a_recording_of_too_many_columns(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text("\n".join([",".join(f"s{i}" for i in range(MOST_COLUMNS + 1)), "1," * MOST_COLUMNS + "1"]))
    with pytest.raises(RecordingError, match=f"has {MOST_COLUMNS + 1} columns"):
        Tables([path]).numeric(path)


@pytest.mark.parametrize("load", [load_scenario, load_campaign, load_monitor])
def test_files_with_a_number_of_thousands_of_digits(tmp_path, load):
    path = tmp_path / "file.toml"
    path.write_text(f"dt = {'9' * 5000}")
    with pytest.raises(ScenarioError, match=r"has a number of thousands of digits\. Round it"):
        load(path)


@pytest.mark.parametrize("load", [load_scenario, load_campaign, load_monitor, cosim.FMU, cosim.Result.load])
@pytest.mark.parametrize("name", ["x" * 5000, "~nobody-of-this-name/x.toml", "a\0b.toml"])
def test_paths_that_no_file_can_have(load, name):
    with pytest.raises(BayesFTCError) as caught:
        load(name)
    assert str(caught.value)[-1] in ".?"


def test_a_plant_that_has_gone_beyond_all_numbers_is_diagnosed_without_a_word():
    rng = np.random.default_rng(0)
    y = rng.normal(size=(200, 2)) + np.linspace(0, 1, 200)[:, None] ** 30 * 1e300
    found = diagnose_recording(model(), y, np.full((200, 1), 1e200))
    assert found is None or np.isfinite(found.values).all()
