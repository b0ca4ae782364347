"""The controller of a scenario without its plant: names, references, refusals, and the same bits as in the simulation."""

import re
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import BayesianController, GammaPrecision, LinearModel, LQGController
from bayesftc.cosim.errors import ConnectionError, ModelError, ScenarioError
from bayesftc.scenario import load_scenario
from bayesftc.scenario._files import shipped_files
from bayesftc.scenario.live import live_controller

ALONE = """
[simulation]
dt = 0.02
[reference]
kind = "Constant"
value = 20.0
[model]
A = [[0.999]]
B = [[2e-4]]
C = [[1.0], [1.0]]
process_covariance = 0.001
sensor_covariance = 1.0
dt = 0.02
[controller]
kind = "BayesianController"
initial_mean = 20.0
precision = { kind = "GammaPrecision" }
"""


@pytest.fixture
def load(tmp_path):
    def load(text, received=()):
        (tmp_path / "car.toml").write_text(text, encoding="utf-8")
        return live_controller(tmp_path / "car.toml", received)

    return load


def run(loaded, samples, goals=None):
    """Return the outputs of each step, the first of which is made without samples."""
    with loaded.stepper() as stepper:
        stepper.prepare()
        inputs, outputs = stepper.start(), []
        for k, y in enumerate(samples):
            inputs[stepper.input_places("controller.y")] = y
            if goals is not None:
                inputs[stepper.input_places("controller.goal")] = goals[k]
            outputs.append(stepper.advance(inputs))
        rows = np.array(outputs)
        return {name: rows[:, stepper.output_places(name)] for name in stepper.outputs}


def test_it_computes_as_the_controller_alone(same_bits):
    """The samples of a simulation of the shipped car, whose sensor freezes at 6 s, with the file's own reference."""
    scenario = load_scenario("live_car")
    result = scenario.loop().simulate(8.0, seed=1, record=["*", "controller.y", "controller.goal"])
    samples, goals = result["controller.y"][1:], result["controller.goal"]
    out = run(live_controller("live_car", ["controller.y"]), samples)
    online = scenario.controller.online()
    steps = [online(y=y, goal=goal) for y, goal in zip([[np.nan] * 2, *samples], goals, strict=True)][1:]
    for name in ("u", "x_hat", "fault_probability"):
        same_bits(out[f"controller.{name}"], np.array([step[name] for step in steps]))
    assert out["controller.fault_probability"][-1, 0] > 0.99


def test_sensors_and_modes_are_those_of_the_alarms():
    loaded = live_controller("live_car")
    assert list(loaded.sensors) == ["sensor 0", "sensor 1"]
    assert "Frozen" in {type(mode).__name__ for mode in loaded.modes}
    assert dict(loaded.names) == {"controller.y": "plant.received"}
    with loaded.stepper() as stepper:
        stepper.prepare()
        assert list(stepper.inputs) == ["controller.y"]
        assert stepper.bears_missing("controller.y")
        assert not [name for name in stepper.outputs if name.startswith("plant.")]
        assert float(stepper.step) == 0.02


def test_a_controller_without_a_plant(load, same_bits):
    loaded = load(ALONE)
    assert len(loaded.modes) == 0
    out = run(loaded, np.full((100, 2), 18.0))
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, dt=0.02)
    online = BayesianController(model, precision=GammaPrecision(), initial_mean=20.0).online(compiled=False)
    steps = [online(y=[y, y], goal=[20.0]) for y in (np.nan, *np.full(100, 18.0))][1:]
    for name in ("u", "x_hat", "precision"):
        same_bits(out[f"controller.{name}"], np.array([step[name] for step in steps]))


def test_a_received_goal_replaces_the_reference(load):
    loaded = load(ALONE, ["controller.y", "controller.goal"])
    assert dict(loaded.names) == {"controller.y": "plant.received", "controller.goal": "reference.u"}
    with loaded.stepper() as stepper:
        stepper.prepare()
        assert not stepper.bears_missing("controller.goal")
        assert stepper.start()[stepper.input_places("controller.goal")].tolist() == [0.0]
    samples = np.full((100, 2), 20.0)
    low, high = (run(load(ALONE, ["controller.goal"]), samples, np.full(100, goal)) for goal in (15.0, 25.0))
    assert low["controller.u"][-1, 0] < 0 < high["controller.u"][-1, 0]
    without = load(re.sub(r"\[reference\]\n.*\n.*\n", "", ALONE), ["controller.goal[0]"])
    np.testing.assert_array_equal(run(without, samples, np.full(100, 25.0))["controller.u"], high["controller.u"])


@pytest.mark.parametrize("exported", [False, True])
def test_a_received_goal_of_a_controller_with_preview_is_the_later_one(load, tmp_path, same_bits, exported, c_compiler):
    model = LinearModel([[0.999]], [[2e-4]], [[1], [1]], 0.001, 1.0, dt=0.02)
    lqg = LQGController(model, GammaPrecision(), goal_covariance=0.1, initial_mean=20.0, preview=20)
    text = ALONE.replace('kind = "BayesianController"', 'kind = "LQGController"\ngoal_covariance = 0.1\npreview = 20')
    if exported:
        path = cosim.export_fmu(lqg, tmp_path / "lqg.fmu")
        text = f"{text[: text.index('[controller]')]}[controller]\nfmu = {str(path)!r}\n"
        text = re.sub(r"\[model\]\n(.+\n)+?(?=\[)", "", text)
    samples, goals = np.full((100, 2), 20.0), 20.0 + np.sin(np.arange(100) / 10.0)
    out = run(load(text, ["controller.goal"]), samples, goals)
    online = lqg.online()
    online(y=[np.nan] * 2, goal=[0.0])
    same_bits(out["controller.u"], np.array([online(y=y, goal=[g]).u for y, g in zip(samples, goals, strict=True)]))
    assert load(text).diagram["reference"].block.time == Fraction(2, 5)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda t: re.sub(r"\[reference\]\n.*\n.*\n", "", t), ScenarioError, r"lacks the section \[reference\]. Add it"),
        (lambda t: re.sub(r"\[simulation\]\n.*\n", "", t), ScenarioError, r"lacks the section \[simulation\]"),
        (lambda t: t[: t.index("[controller]")], ScenarioError, r"lacks the section \[controller\]"),
        (lambda t: t + "[sensors]\ncount = 2\n", ScenarioError, r"'sensors' has no effect without \[plant\]"),
        (lambda t: t + '[[faults]]\nkind = "Freeze"\n', ScenarioError, r"'faults' has no effect without \[plant\]"),
        (lambda t: t + "[noise]\n", ScenarioError, r"'noise' has no effect without \[plant\]"),
        (lambda t: t + "[plants]\n", ScenarioError, r"has the unknown section 'plants'; did you mean 'plant'"),
        (lambda t: t.replace("initial_mean", "initial_men"), ScenarioError, r"key 'initial_men'; did you mean 'initial_mean'"),
        (lambda t: t.replace('kind = "BayesianController"', 'kind = "design"'), ScenarioError, r"designed for a plant, but"),
        (lambda t: t.replace("1.0\ndt = 0.02", "-1.0\ndt = 0.02"), ModelError, r"'model'.*sensor_covariance"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_place(load, tmp_path, change, error, words):
    text = change(ALONE)
    assert text != ALONE
    with pytest.raises(error, match=words) as raised:
        load(text)
    assert str(raised.value).startswith(str(tmp_path / "car.toml"))


def test_a_step_of_blocks_that_is_not_that_of_the_controller_is_refused(load):
    blocks = '[blocks.twice]\nkind = "Gain"\ngain = 2.0\n[[connections]]\nfrom = "controller.u[0]"\nto = "twice.u"\n'
    out = run(load(ALONE + blocks), np.full((50, 2), 18.0))
    np.testing.assert_array_equal(out["twice.y"], 2.0 * out["controller.u"])
    with pytest.raises(
        ScenarioError, match=r"'simulation.dt' is 0.01, but a live run with \[blocks\] has the sample time"
    ):
        load(ALONE.replace("[simulation]\ndt = 0.02", "[simulation]\ndt = 0.01") + blocks)


TANK = """
reference = [{ kind = "Constant", value = 1.0, unit = "m" }, { kind = "Constant", value = 20.0, unit = "degC" }]
[simulation]
duration = 1.0
dt = 0.1
[plant]
A = [[-0.1, 0.0], [0.02, -0.05]]
B = [[0.1, 0.0], [0.0, 0.1]]
C = [[1.0, 0.0], [0.0, 1.0]]
dt = 0
inputs = ["valve", "heater"]
outputs = ["h", "T"]
control = ["valve", "heater"]
measured = ["h", "T"]
[sensors]
count = [1, 2]
std = 0.01
unit = ["m", "degC"]
[controller]
kind = "design"
"""


def test_a_goal_in_another_unit_than_its_sensors_is_refused(load):
    assert load(TANK).diagram["plant"].port("samples").units == ("m", "degC", "degC")
    with pytest.raises(ConnectionError, match=r"reference_1\.y is in m, but .* is in degC"):
        load(TANK.replace('20.0, unit = "degC"', '20.0, unit = "m"'))
    car = shipped_files("scenario")["cruise_control"].read_text().replace('unit = "m/s"\n', "")
    with pytest.raises(ConnectionError, match=r"is in rad, but .* is in m/s"):  # the unit of the FMU
        load(car.replace("[reference]", '[reference]\nunit = "rad"'))


@pytest.mark.parametrize("name", sorted(shipped_files("scenario")))
def test_every_shipped_scenario_has_a_controller_to_run(name):
    loaded = live_controller(name)
    assert "controller.y" in loaded.names
    with loaded.stepper() as stepper:
        assert stepper.inputs["controller.y"].size == len(loaded.sensors)
