"""Scenario files: what they may say, what comes of it, and what is said of a file that is wrong."""

import re
import tomllib
from dataclasses import fields
from importlib import import_module

import numpy as np
import pytest
from block_kinds import SIZES

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import ACTUATOR_MODES, LAWS, LEARNERS
from bayesftc.cosim.blocks.faults.kinds import FAULTS
from bayesftc.cosim.errors import (
    BayesFTCError,
    ConnectionError,
    FMUError,
    ModelError,
    ScenarioError,
    SimulationError,
    StepSizeError,
    UnknownNameError,
)
from bayesftc.monitoring import load_monitor
from bayesftc.scenario import find_scenario, load_scenario, shipped_scenarios
from bayesftc.scenario.campaigns import load_campaign
from bayesftc.scenario.live.wires import load_wires

CAR = shipped_scenarios()["cruise_control"].read_text()


@pytest.fixture
def write(tmp_path):
    """Write the shipped scenario with some text replaced; return the file."""

    def write(*changes, name="car.toml", text=CAR):
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        file = tmp_path / name
        file.write_text(text)
        return file

    return write


def short(scenario, **options):
    return scenario.simulate(duration=options.pop("duration", 0.2), engine="interpreted", **options)


def test_the_shipped_scenario_is_the_loop_of_the_python_example(same_bits):
    from bayesftc.examples.cruise_control.cruise_control import cruise_control

    scenario = load_scenario("cruise_control")
    other = cruise_control(scenario.controller.precision).simulate(7.0, seed=scenario.simulation.seed)
    result = scenario.simulate(duration=7.0)
    assert list(result) == list(other)
    # The file gives numbers where the script computes them: equal but for rounding.
    np.testing.assert_allclose(result["plant.v"], other["plant.v"], rtol=1e-12)
    assert scenario.simulation.duration == 20.0
    assert [(f.sensor, f.start, f.stop) for f in scenario.faults] == [(0, 6.0, 14.0)]
    assert scenario.controller.precision == controllers.SwitchingPrecision()


def test_a_slow_sensor(write):
    scenario = load_scenario(write(("count = 2\n", "count = 2\nevery = [10, 1]\n")))
    assert scenario.sensors.rates == (10, 1)
    assert scenario.controller.precision.loss == pytest.approx((0.901, 0.01))
    assert scenario.loop()["freeze_0"].block.spacing == 10
    samples = short(scenario)["freeze_0.y"][:, 0]
    assert np.flatnonzero(~np.isnan(samples)).tolist() == [0, 10]


def test_without_a_learner_it_is_the_default(write):
    text = CAR[: CAR.index("[controller.precision]")]
    assert load_scenario(write(text=text)).controller.precision == controllers.SwitchingPrecision()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.__name__)
def test_every_fault_can_be_said(write, fault):
    extra = "".join(f"\n{name} = {value}" for name, value in SIZES.get(fault.__name__, {}).items())
    scenario = load_scenario(write(('kind = "Freeze"', f'kind = "{fault.__name__}"{extra}')))
    assert type(scenario.faults[0]) is fault


def test_faults_on_a_condition(write, same_bits):
    start = "start = { signal = 'plant.v', relation = '>', value = 22 }"
    stop = "stop = { signal = 'controller.u', relation = '<', value = 0.0, delayed = true }\nduration = 2"
    scenario = load_scenario(write(("start = 6.0", start), ("stop = 14.0", f"{stop}\nlatching = false")))
    condition, other = cosim.when("plant.v", ">", 22.0), cosim.when("controller.u", "<", 0.0, delayed=True)
    assert scenario.faults == [cosim.Freeze(start=condition, stop=other, duration=2.0, latching=False)]
    as_text = load_scenario(write(("start = 6.0", "start = 'plant.v > 22'"), ("stop = 14.0", "duration = 2")))
    assert as_text.faults == [cosim.Freeze(start=condition, duration=2.0)]
    result = as_text.simulate(duration=4.0)
    first = int(np.argmax(result["plant.v"] > 22.0))
    assert 0 < first < 100
    same_bits(result["freeze_0.active"], (np.abs(np.arange(201) - first - 49.5) < 50).astype(float))


@pytest.mark.parametrize("learner", LEARNERS, ids=lambda c: c.__name__)
@pytest.mark.parametrize("spelling", ["{}", "lower"])
def test_every_learner_can_be_said(write, learner, spelling):
    text = CAR[: CAR.index("[controller.precision]")] + "[controller.precision]\nkind = "
    name = learner.__name__.lower() if spelling == "lower" else learner.__name__
    assert type(load_scenario(write(text=f'{text}"{name}"')).controller.precision) is learner


@pytest.mark.parametrize("mode", ACTUATOR_MODES, ids=lambda c: c.__name__)
def test_every_actuator_mode_can_be_said(write, mode):
    text = CAR[: CAR.index("[controller.precision]")] + '[controller.precision]\nkind = "SwitchingPrecision"\n'
    scenario = load_scenario(write(text=f'{text}actuator_modes = [{{ kind = "{mode.__name__}", time_to_fault = 9 }}]'))
    assert scenario.controller.precision.actuator_modes == (mode(time_to_fault=9.0),)
    assert load_scenario(write(text=f"{text}actuator_modes = []")).controller.precision.actuator_modes == ()


@pytest.mark.parametrize(
    "table", ['{ kind = "NoisierProcess", scale = 9 }', '{ kind = "noisier_process", scale = 9 }', "{ scale = 9 }"]
)
def test_process_modes_can_be_said_and_left_out(write, table):
    text = CAR[: CAR.index("[controller.precision]")] + '[controller.precision]\nkind = "SwitchingPrecision"\n'
    scenario = load_scenario(write(text=f"{text}process_modes = [{table}, {{ time_to_recovery = 2.5 }}]"))
    of_process = scenario.controller.precision.process_modes
    assert of_process == (controllers.NoisierProcess(scale=9.0), controllers.NoisierProcess(time_to_recovery=2.5))
    assert load_scenario(write(text=f"{text}process_modes = []")).controller.precision.process_modes == ()


def test_nested_tables_become_blocks(write):
    fault = """kind = "random_faults"
kinds = [{ kind = "freeze" }, { kind = "drift", slope = 2 }]
mean_time_to_fault = 3
mean_time_to_recovery = 1
name = "any"
"""
    scenario = load_scenario(write(('kind = "Freeze"\n', fault)))
    assert scenario.faults[0].kinds == (cosim.Freeze(), cosim.Drift(slope=2.0))
    assert short(scenario)["any.kind"].shape == (11,)


INPUT_FAULTS = """
[[input_faults.force]]
kind = "GainFault"
factor = 0.6
start = 0.1
[[input_faults.force]]
kind = "stuck"
at = 100
start = 0.15
[[input_faults.disturbance]]
kind = "random_faults"
kinds = [{ kind = "bias", magnitude = -0.05 }, { kind = "drift", slope = 0.1 }]
"""


def test_faults_of_actuators_and_process(write):
    scenario = load_scenario(write(text=CAR + INPUT_FAULTS))
    assert scenario.input_faults == {
        "force": [cosim.GainFault(factor=0.6, start=0.1), cosim.Stuck(at=100.0, start=0.15)],
        "disturbance": [cosim.RandomFaults(kinds=(cosim.Bias(magnitude=-0.05), cosim.Drift(slope=0.1)))],
    }
    result = short(scenario, record=["*", "plant.force"])
    np.testing.assert_allclose(result["plant.force"][5:8], 0.6 * result["controller.u"][5:8, 0], rtol=1e-12)
    np.testing.assert_array_equal(result["plant.force"][8:], np.full(3, 100.0))
    assert result["disturbance_random_faults_0.kind"].shape == (11,)


@pytest.mark.parametrize(
    ("section", "value"),
    [
        ("[reference]\nkind = 'Constant'\nvalue = 21", 21.0),
        ("[[reference]]\nkind = 'Step'\ntime = 0\nafter = 19", 19.0),
    ],
)
def test_references(write, section, value):
    start, end = CAR.index("[reference]"), CAR.index("[model]")
    scenario = load_scenario(write(text=CAR[:start] + section + "\n" + CAR[end:]))
    assert short(scenario)["reference.y"][-1] == value


def test_a_reference_may_be_a_number(write):
    start, end = CAR.index("[reference]"), CAR.index("[model]")
    scenario = load_scenario(write(text="reference = 18\n" + CAR[:start] + CAR[end:]))
    assert scenario.reference == [cosim.Constant(18.0)]


def test_sensors_faults_and_noise_may_be_left_out(write):
    text = CAR[: CAR.index("[noise.")] + CAR[CAR.index("[reference]") :]
    scenario = load_scenario(write(("C = [[1.0], [1.0]]", "C = [[1.0]]"), text=text))
    result = short(scenario)
    np.testing.assert_array_equal(result["sensors.y"][:, 0], result["plant.v"])


def test_a_linear_plant_runs_as_the_fmu_does(write):
    """The plant's matrices are the FMU's map, so the loop is the same."""
    plant = """A = [[0.999]]
B = [[2e-4, 1.0]]
C = [[1.0]]
dt = 0.02
inputs = ["force", "disturbance"]
outputs = ["v"]
initial = [20.0]
units = { force = "N", v = "m/s" }
"""
    linear = load_scenario(
        write(('fmu = "CruiseControl"', plant), ("parameters = { v0 = 20.0 }", "#"), name="linear.toml")
    )
    ours, theirs = (short(s, duration=1.0)["plant.v"] for s in (linear, load_scenario("cruise_control")))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    assert [port.unit for port in (*linear.plant.inputs, *linear.plant.outputs)] == ["N", None, "m/s"]
    with pytest.raises(ScenarioError, match=r"'plant.units' is {'v': 3}; it must be a table of texts in quotes\."):
        load_scenario(
            write(('fmu = "CruiseControl"', plant.replace('force = "N", v = "m/s"', "v = 3")), ("parameters =", "#"))
        )


def test_a_controller_may_be_designed_for_another_plant_and_other_sensors(write):
    """As in Python: the design for one, the loop with another."""
    text = find_scenario("position_servo").read_text()
    text = text.replace('fmu = "PositionServo"', 'fmu = "PositionServo"\nparameters = { J = 0.03 }')
    known = '[known.plant]\nfmu = "PositionServo"\ncontrol = "voltage"\nmeasured = "angle"\n'
    wrong = load_scenario(write(text=f"{text}\n{known}\n[known.sensors]\ncount = 2\nstd = 0.05\n"))
    design = load_scenario("position_servo").controller
    assert wrong.plant.parameters == {"J": 0.03}
    np.testing.assert_array_equal(wrong.controller.model.matrix("A"), design.model.matrix("A"))
    np.testing.assert_allclose(wrong.controller.model.matrix("sensor_covariance"), np.diag([0.05**2] * 2))
    with pytest.raises(ScenarioError, match=r"'known' has the unknown key 'noise'; known names: plant, sensors"):
        load_scenario(write(text=f"{text}\n[known.noise]\nstd = 1\n"))
    with pytest.raises(ScenarioError, match=r"'known' gives the controller 3 sensors, but the run has 2\. Repeat in"):
        load_scenario(write(text=f"{text}\n[known.sensors]\ncount = 3\nstd = 0.05\n"))
    with pytest.warns(UserWarning, match=r"The section \[known\] has no effect: the controller is not designed"):
        load_scenario(write(text=f"{find_scenario('cruise_control').read_text()}\n[known.sensors]\ncount = 7\n"))
    with pytest.raises(ScenarioError, match=r"'known\.plant' lacks 'measured'"):
        load_scenario(write(text=text + '\n[known.plant]\nfmu = "PositionServo"\ncontrol = "voltage"\n'))


def test_a_design_is_for_the_units_of_the_plant(write):
    """The samples of sensors in degrees would be 57 times as large as the model expects."""
    text = find_scenario("position_servo").read_text()
    assert "[sensors]\n" in text
    degrees = text.replace("[sensors]\n", '[sensors]\nunit = "deg"\n')
    sentence = r"'controller' cannot be a design, because angle is in rad in the plant, .* in deg in \[sensors\]\. Give"
    with pytest.raises(ScenarioError, match=sentence):
        load_scenario(write(text=degrees))
    load_scenario(write(text=text.replace("[sensors]\n", '[sensors]\nunit = "rad"\n')))
    own = degrees.replace('kind = "design"\n', 'kind = "design"\nsensor_std = 0.01\n')
    assert own != degrees
    with pytest.raises(ScenarioError, match=sentence):  # whoever gives the noise has not converted the samples by that
        load_scenario(write(text=own))
    blocks = '\n[blocks.deg]\nkind = "Gain"\ngain = 57.2957795131\n'
    blocks += '\n[blocks.rad]\nkind = "Gain"\ngain = [[0.0174532925199, 0.0], [0.0, 0.0174532925199]]\n'
    links = (("plant.angle", "deg.u"), ("deg.y", "sensors.u"), ("sensors.y", "rad.u"), ("rad.y", "controller.y"))
    blocks += "".join(f'\n[[connections]]\nfrom = "{a}"\nto = "{b}"\n' for a, b in links)
    faults = own.index("[[faults]]")
    end = own.index("\n[", own.index("\n", faults)) + 1
    assert load_scenario(write(text=f"{own[:faults]}{own[end:]}{blocks}")).loop()["rad"].block.gain


def test_a_source_may_be_a_column_of_a_file(write, tmp_path, monkeypatch):
    (tmp_path / "drive.csv").write_text("t,speed\n0,20\n10,25\n")
    text = find_scenario("cruise_control").read_text()
    begin = text.index("[reference]")
    end = text.index("\n[", begin) + 1
    table = '[reference]\nkind = "Table"\nfile = "drive.csv"\ncolumn = "speed"\n'
    file = write(text=f"{text[:begin]}{table}\n{text[end:]}")
    monkeypatch.chdir("/")
    (source,) = load_scenario(file).reference
    assert (source.times, source.values) == ((0.0, 10.0), (20.0, 25.0))
    with pytest.raises(cosim.RecordingError, match=r"has no column 'sped'; did you mean 'speed'"):
        load_scenario(write(text=file.read_text().replace('"speed"', '"sped"')))
    with pytest.raises(cosim.RecordingError, match=r"drive2\.csv"):
        load_scenario(write(text=file.read_text().replace("drive.csv", "drive2.csv").replace("sped", "speed")))
    with pytest.raises(ScenarioError, match="unknown key 'values'; known names: column, file, interpolate, time, unit"):
        load_scenario(write(text=f"{text[:begin]}{table}values = [1.0]\n\n{text[end:]}"))


def test_continuous_linear_plant_with_process_noise(write):
    plant = "A = [[-0.05]]\nB = [[0.01]]\nC = [[1.0]]\ndt = 0\nprocess_noise = [[1e-4]]\ninitial = [20.0]\n"
    text = CAR[: CAR.index("[noise.")] + CAR[CAR.index("[sensors]") :]
    changes = [
        ('fmu = "CruiseControl"', plant),
        ("parameters = { v0 = 20.0 }", "#"),
        ('"force"', '"u"'),
        ('"v"', '"y"'),
    ]
    values = short(load_scenario(write(*changes, text=text)))["plant.y"]
    assert values[0] == 20.0
    assert len(np.unique(values)) == len(values)


def test_paths_are_relative_to_the_file(write, monkeypatch, tmp_path):
    folder = tmp_path / "sub"
    folder.mkdir()
    (folder / "my.fmu").write_bytes(fmus.path("CruiseControl").read_bytes())
    file = write(('"CruiseControl"', '"sub/my.fmu"'))
    monkeypatch.chdir(folder)
    assert load_scenario(file).plant.path == folder / "my.fmu"


def test_the_version_of_a_shipped_fmu(write):
    file = write(('fmu = "CruiseControl"', 'fmu = "CruiseControl"\nfmi = "3.0"'))
    assert load_scenario(file).plant.description.fmi_version == "3.0"


def test_dt_may_stand_with_the_simulation(write):
    file = write(("dt = 0.02 # s", ""), ("seed = 1", 'dt = "1/50"'))
    assert load_scenario(file).loop().step == cosim.Diagram(0.02).step


def test_delays_and_preview(write):
    """The car's own control is late by three samples, and its second sensor by two; its goals are known ahead."""
    file = write(
        (
            "sensor_covariance = 1.0",
            "sensor_covariance = 1.0\ndisturbance = 1e-4\ninput_delays = 3\nsensor_delays = [0, 2]",
        ),
        ('kind = "BayesianController"', 'kind = "LQGController"\npreview = 5'),
    )
    scenario = load_scenario(file)
    model = scenario.controller.model
    assert model.state_names == ("x[0]", "u[-1]", "u[-2]", "u[-3]", "y1[-1]", "y1[-2]", "disturbance[0]")
    result = scenario.simulate(duration=0.4)
    np.testing.assert_array_equal(result["reference.ahead"][:-5], result["reference.y"][5:])
    late = write(("sensor_covariance = 1.0", 'sensor_covariance = 1.0\ninput_delays = "3"'))
    with pytest.raises(ScenarioError, match=r"'model.input_delays' is '3'; it must be a whole number or a list"):
        load_scenario(late)


def test_disturbance(write):
    file = write(("sensor_covariance = 1.0", "sensor_covariance = 1.0\ndisturbance = 1e-4"))
    assert load_scenario(file).controller.model.disturbances == 1


def test_options_stand_above_the_file(write):
    scenario = load_scenario(write(("seed = 1", 'seed = 1\nrecord = ["plant.*"]\ndecimation = 2')))
    result = short(scenario, seed=5, duration=0.4)
    assert result.metadata["seed"] == 5
    assert list(result) == ["plant.v"]
    assert len(result.time) == 11
    assert len(short(scenario, decimation=1, seed=None).time) == 11


WRONG = {
    "unknown key": (("std = 1.0", "sdt = 1.0"), ScenarioError, ["'sensors'", "'sdt'", "did you mean 'std'"]),
    "unknown nested key": (
        ('"SwitchingPrecision"', '"GammaPrecision"\ncalibration = { slop = 1.0, intercept = 0.0 }'),
        ScenarioError, ["controller.precision.calibration", "'slope'"],
    ),
    "unknown section": (("[sensors]", "[sensor]"), ScenarioError, ["section 'sensor'", "'sensors'"]),
    "text for number": (("start = 6.0", "start = 'six'"), ScenarioError, ["faults[0].start", "'six'", "a number"]),
    "bool for number": (("start = 6.0", "start = true"), ScenarioError, ["faults[0].start", "true", "a number"]),
    "float for count": (("count = 2", "count = 2.0"), ScenarioError, ["sensors.count", "whole number"]),
    "choice": (("seed = 1", "engine = 'fast'"), ScenarioError, ["simulation.engine", "'auto', 'compiled' or 'interpreted'"]),
    "unknown kind": (('"Freeze"', '"Freze"'), ScenarioError, ["faults[0].kind", "'Freze'", "did you mean 'Freeze'"]),
    "far kind": (('"Freeze"', "7"), ScenarioError, ["faults[0].kind", "known kinds: ", "Freeze", "Injection"]),
    "no kind": (('kind = "Freeze"\n', ""), ScenarioError, ["faults[0]", "lacks 'kind'", "'Freeze'"]),
    "no section": (("[reference]", "[model.x]"), ScenarioError, ["lacks the section [reference]"]),
    "no model": (
        (CAR[CAR.index("[model]") : CAR.index("[controller]")], ""),
        ScenarioError, ["lacks the section [model]", "BayesianController needs"],
    ),
    "text for settings": (
        ('"SwitchingPrecision"', '"GammaPrecision"\ncalibration = "mine"'),
        ScenarioError, ["precision.calibration", "a table with the settings of"],
    ),
    "text for list": (
        ('kind = "Freeze"', 'kind = "RandomFaults"\nkinds = ["drift"] #'), ScenarioError, ["kinds", '[{ kind = "Drift" }]'],
    ),
    "no key": (("amplitude = 5.0\n", ""), ScenarioError, ["'reference'", "amplitude", "Sine", "a number"]),
    "no plant": (('fmu = "CruiseControl"', "#"), ScenarioError, ["'plant'", "fmu = ", "A, B, C"]),
    "one bracket": (("[[faults]]", "[faults]"), ScenarioError, ["'faults'", "[[faults]]"]),
    "one bracket of an input": (
        ("[[faults]]", "[input_faults.force]"), ScenarioError, ["'input_faults.force'", "Write [[input_faults.force]], with two"],
    ),
    "no input": (("[[faults]]", "[[input_faults]]"), ScenarioError, ["'input_faults'", "Write [[input_faults.<input>]]"]),
    "faulty input": (("[[faults]]", "[[input_faults.froce]]"), UnknownNameError, ["'froce'", "did you mean 'force'"]),
    "setting of an input fault": (
        ("[[faults]]", "[[input_faults.force]]\nbegin = 1"), ScenarioError, ["'input_faults.force[0]'", "'begin'"],
    ),
    "function": (("count = 2", "count = 2\nfunction = 'sin'"), ScenarioError, ["sensors.function", "Python script"]),
    "syntax": (("count = 2", "count = "), ScenarioError, ["no valid TOML", "line 21"]),
    "decimal comma": (("seed = 1", "seed = 0,5"), ScenarioError, ["no valid TOML", "decimal point: write 0.5 for 0,5."]),
    "decimal comma in a table": (
        ("seed = 1", "a = { b = -1,25, c = 2 }"), ScenarioError, ["decimal point: write -1.25 for -1,25."]
    ),
    "twice": (("seed = 1", "seed = 1\nseed = 2"), ScenarioError, ["no valid TOML", "line 9"]),
    "fmi of a file": (('"CruiseControl"', '"a.fmu"\nfmi = "2.0"'), ScenarioError, ["plant.fmi", "Leave out 'fmi'"]),
    "fmu name": (('"CruiseControl"', '"CruseControl"'), FMUError, ["plant.fmu", "CruiseControl", ".fmu"]),
    "fmu file": (('"CruiseControl"', '"nope.fmu"'), FMUError, ["'plant'", "nope.fmu"]),
    "parameter": (("v0 = 20.0", "v00 = 20.0"), UnknownNameError, ["'plant'", "'v00'", "did you mean 'v0'"]),
    "control": (('"force"', '"forces"'), UnknownNameError, ["'forces'", "did you mean 'force'"]),
    "noise input": (("[noise.disturbance]", "[noise.disturb]"), UnknownNameError, ["'disturb'"]),
    "sensor count": (("C = [[1.0], [1.0]]", "C = [[1.0]]"), ConnectionError, ["1 sensor,", "2"]),
    "duration": (("duration = 20.0", "duration = '20 s'"), StepSizeError, ["'simulation'", "'20 s'"]),
    "dt": (("dt = 0.02", "dt = 'x'"), StepSizeError, ["'model'", "'x'"]),
    "dt of the simulation": (("seed = 1", "dt = 0"), StepSizeError, ["'simulation': dt is 0.0 s"]),
    "setting": (
        ('"SwitchingPrecision"', '"GammaPrecision"\nforgetting = 1.5'), ModelError, ["controller.precision", "forgetting=1.5"],
    ),
    "window": (("stop = 14.0", "stop = 4.0"), ModelError, ["faults[0]", "stop=4.0"]),
    "text for a condition": (
        ("start = 6.0", "start = 'plant.v => 22'"), ScenarioError,
        ["faults[0].start", 'a number, a condition such as "plant.v > 22" or a table', "of When (signal, relation, value)"],
    ),
    "signal of a text": (("start = 6.0", "start = 'v > 22'"), ModelError, ["faults[0].start", "signal='v'", "with its block"]),
    "value of a text": (("start = 6.0", "start = 'plant.v > nan'"), ModelError, ["faults[0].start", "a finite number"]),
    "relation": (
        ("start = 6.0", "start = { signal = 'plant.v', relation = '=>', value = 22 }"), ModelError, ["faults[0].start", "'=>'"],
    ),
    "entry of a condition": (
        ("start = 6.0", "start = { signal = 'plant.v', relaton = '>', value = 22 }"), ScenarioError, ["did you mean 'relation'"],
    ),
    "signal of a condition": (
        ("start = 6.0", "start = { signal = 'plant.w', relation = '>', value = 22 }"), UnknownNameError,
        ["'freeze_0'", "'plant.w'", "known names: plant.disturbance, plant.force, plant.v."],
    ),
    "matrix": (("A = [[0.999]]", "A = [[0.999, 1.0]]"), ModelError, ["'model'", "square"]),
    "kind of a linear plant": (
        ('fmu = "CruiseControl"', 'kind = "StateSpace"\nA = [[0.9]]'), ScenarioError,
        ["'plant.kind' is not needed for a linear plant", "Leave kind out"],
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "words"), [("a.fmu", "is an FMU, .* bayesftc inspect"), ("a.csv", "is a recording, .* bayesftc monitor")]
)
def test_files_of_other_kinds_are_named(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"PK\xff")
    with pytest.raises(ScenarioError, match=words):
        load_scenario(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "kind", "command"),
    [
        ("position_servo", "scenario", "run"),
        ("tracking", "campaign", "campaign"),
        ("car_by_udp", "wires", "live SCENARIO --bridge"),
        ("model", "monitor's model", "monitor RECORDING --model"),
    ],
)
def test_a_toml_file_of_another_kind_is_named_with_its_command(name, kind, command):
    file = find_scenario(name, kind)
    readers = {"scenario": load_scenario, "monitor's model": load_monitor, "wires": load_wires}
    for read in (reader for reads, reader in readers.items() if reads != kind):
        with pytest.raises(ScenarioError, match=re.escape(f": bayesftc {command} {file}.") + "$"):
            read(file)


def test_a_wrong_section_of_a_right_file_has_no_such_hint(write):
    with pytest.raises(ScenarioError, match=r"unknown section 'dt'; known names: [^.]*\.$"):
        load_scenario(write(text=f"dt = 0.1\n{CAR}"))


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.bayesian.linear.UnstableLoopWarning")
def test_goals_without_a_reference_are_named(write):
    text = LINEAR.replace('kind = "Design"', 'kind = "BayesianController"\n[model]\n' + MODEL_OF_TWO)
    with pytest.raises(ConnectionError, match=r"The goal has 2 elements \(x\[0\], x\[1\]\), .* one \[\[reference\]\]"):
        load_scenario(write(text=text)).loop()


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_its_place(write, case):
    change, error, words = WRONG[case]
    file = write(change)
    with pytest.raises(error) as caught:
        load_scenario(file).loop()
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.startswith(str(file))
    assert message.endswith((".", "?"))
    for word in words:
        assert word in message, message


def test_what_the_run_has_against_the_file_names_the_file(write):
    scenario = load_scenario(write(("duration = 20.0", "duration = 20.01")))
    with pytest.raises(StepSizeError, match=r"car\.toml: The duration"):
        scenario.simulate()
    with pytest.raises(StepSizeError, match=r"^The duration of 0\.03"):  # not the file's fault
        scenario.simulate(duration=0.03)


def test_a_failing_run_keeps_its_result(write):
    scenario = load_scenario(write(("v0 = 20.0", "m = 1e-320, v0 = 20.0")))
    with pytest.raises(SimulationError) as caught:
        short(scenario)
    assert len(caught.value.result.time) == 1


def test_finding_files(tmp_path, monkeypatch, write):
    file = write()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cruise_control").mkdir()  # a folder of the example's name does not hide it
    assert find_scenario("car.toml").resolve() == file
    assert find_scenario("cruise_control") == shipped_scenarios()["cruise_control"]
    for name, words in {
        "kar.toml": "did you mean 'car.toml'",
        "nowhere/car.toml": "does not exist",
        "cruise": "did you mean 'cruise_control'",
        str(tmp_path): "is a folder",
    }.items():
        with pytest.raises(ScenarioError, match=words):
            find_scenario(name)


OTHER_KINDS = {
    (
        "tracking",
        "scenario",
    ): "'tracking' is a shipped campaign, not a scenario file. To use it: bayesftc example tracking > "
    "tracking.toml && bayesftc campaign tracking.toml.",
    (
        "cruise_control",
        "campaign",
    ): "'cruise_control' is a shipped scenario, not a campaign file. To use it: bayesftc run "
    "cruise_control. For a campaign, write a file with scenario = 'cruise_control'; bayesftc example tracking prints one.",
    (
        "model",
        "scenario",
    ): "'model' is a shipped monitor's model, not a scenario file. To use it: bayesftc example model > "
    "model.toml && bayesftc monitor . --model model.toml.",
    (
        "tracking",
        "monitor's model",
    ): "'tracking' is a shipped campaign, not a model file. To use it: bayesftc example tracking > "
    "tracking.toml && bayesftc campaign tracking.toml.",
}


@pytest.mark.parametrize(("name", "kind"), OTHER_KINDS)
def test_the_name_of_a_shipped_file_of_another_kind_says_how_to_use_it(name, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    read = {"scenario": load_scenario, "campaign": load_campaign, "monitor's model": load_monitor}[kind]
    with pytest.raises(ScenarioError) as raised:
        read(name)
    assert str(raised.value) == OTHER_KINDS[name, kind]


def test_a_shipped_campaign_and_monitor_are_found_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_campaign("tracking").runs == 600
    assert load_monitor("model").time == "t"


def test_files_that_are_no_text(tmp_path):
    file = tmp_path / "car.toml"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="UTF-8"):
        load_scenario(file)
    file.write_bytes(b"\xef\xbb\xbf" + CAR.encode())  # as Windows editors save it
    assert load_scenario(file).simulation.seed == 1
    file.write_text("x = " + "[" * 3000)
    with pytest.raises(ScenarioError):
        load_scenario(file)


def test_every_setting_of_every_kind_can_be_written_in_toml():
    """A new field with a type that TOML cannot express must be left out knowingly."""
    from typing import get_type_hints

    from bayesftc.controllers.registry import CONTROLLERS
    from bayesftc.scenario._schema import _dataclasses, _writable
    from bayesftc.scenario._sections import SOURCES

    unsaid = set()
    for cls in (*FAULTS, *LEARNERS, *SOURCES, *CONTROLLERS, cosim.Sensors, controllers.LinearModel):
        hints = get_type_hints(cls)
        for field in fields(cls):
            if field.init and _writable(hints[field.name]) is type(None) and not _dataclasses(hints[field.name]):
                unsaid.add(f"{cls.__name__}.{field.name}")
    assert unsaid == {"Sensors.function"}
    arguments = get_type_hints(controllers.design)
    del arguments["plant"], arguments["return"]
    assert all(_writable(hint) is not type(None) or _dataclasses(hint) for hint in arguments.values())
    assert set(tomllib.loads(CAR)) == {
        "simulation", "plant", "noise", "sensors", "faults", "reference", "model", "controller",
    }  # fmt: skip


THREE_ON_TWO = """
[simulation]
duration = 5
[plant]
A = [[1, 0.1], [0, 0.9]]
B = [[0], [0.1]]
C = [[1, 0], [0, 1]]
dt = 0.1
control = "u"
measured = ["y0", "y1"]
[sensors]
count = 3
std = [0.1, 0.1, 0.2]
matrix = [[1, 0], [0, 1], [1, 0]]
[reference]
kind = "Table"
times = [0, 2.5, 5]
values = [1, 2, 1]
[model]
A = [[1, 0.1], [0, 0.9]]
B = [[0], [0.1]]
C = [[1, 0], [0, 1], [1, 0]]
process_covariance = 1e-4
sensor_covariance = [0.01, 0.01, 0.04]
dt = 0.1
[controller]
kind = "BayesianController"
goal_on = [[1, 0]]
control_covariance = 10.0
goal_covariance = 0.1
"""


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
def test_three_sensors_on_two_variables(write):
    """The matrix that the error for an uneven share asks for is all that is needed."""
    scenario = load_scenario(write(text=THREE_ON_TWO))
    assert scenario.sensors.signals == 2
    assert scenario.simulate(engine="interpreted")["sensors.y"].shape == (51, 3)
    for matrix, error in (("", "share 2 signals evenly"), ("matrix = [[1], [0], [1]]", "row of 2 finite numbers")):
        text = THREE_ON_TWO.replace("matrix = [[1, 0], [0, 1], [1, 0]]", matrix)
        with pytest.raises(ModelError, match=error):
            load_scenario(write(text=text))


SOME_OF_EACH = """
[simulation]
duration = 5
[plant]
A = [[-0.1, 0], [0.02, -0.05]]
B = [[0.1, 0], [0, 0.1]]
C = [[1, 0], [0, 1]]
dt = 0
inputs = ["valve", "heater"]
outputs = ["h", "T"]
control = ["valve", "heater"]
measured = ["h", "T"]
[sensors]
count = [1, 3]
std = [0.01, 0.2]
[controller]
kind = "design"
dt = 1
[[reference]]
kind = "Constant"
value = 1
[[reference]]
kind = "Constant"
value = 5
"""


def test_a_design_has_as_many_sensors_of_each_variable_as_the_loop(write):
    scenario = load_scenario(write(text=SOME_OF_EACH))
    assert scenario.controller.model.names.sensors == ("h", "T", "T", "T")
    np.testing.assert_allclose(np.diag(scenario.controller.model.matrix("sensor_covariance")), [1e-4, 0.04, 0.04, 0.04])
    assert scenario.simulate(engine="interpreted")["sensors.y"].shape == (6, 4)


ACTIVE = """
[simulation]
duration = 1
engine = "interpreted"
dt = 0.02
[plant]
fmu = "CruiseControl"
control = "force"
measured = "v"
[sensors]
count = 2
std = 1.0
[reference]
kind = "Constant"
value = 5
[controller]
kind = "UnbiasedActiveInference"
belief_rate = 5
control = "law"
law = { kind = "Proportional", gain = 2000 }
precision = { kind = "GammaPrecision" }
[[controller.modalities]]
name = "speed"
matrix = [[1], [1]]
std = 1.0
"""


@pytest.mark.parametrize("brackets", ["[[controller.modalities]]", "[controller.modalities]"])
def test_active_inference_needs_no_model(write, brackets):
    """Its modalities say what is measured, the simulation says how often; one modality may be a table of its own."""
    scenario = load_scenario(write(text=ACTIVE.replace("[[controller.modalities]]", brackets)))
    assert scenario.controller.model is None
    assert float(scenario.controller.sample_time) == 0.02
    assert scenario.simulate(duration=0.2)["controller.x_hat"].shape == (11, 1)


LAW_TABLES = {
    controllers.Proportional: "gain = 2000, states = 2",
    controllers.ProportionalDerivative: "gain = 2000, derivative_gain = 50",
    controllers.PID: "gain = 2000, derivative_gain = 50, integral_gain = [100], anti_windup = 'both', tracking_time = 0.5",
}
"""A table for each law, one that reads two states for one goal."""


@pytest.mark.parametrize("law", LAWS, ids=lambda c: c.__name__)
def test_every_law_can_be_said(write, law):
    said = f'kind = "{law.__name__}", {LAW_TABLES[law]}'
    text = ACTIVE.replace('kind = "Proportional", gain = 2000', said).replace("[[1], [1]]", "[[1, 0], [1, 0]]")
    expected = law(**tomllib.loads(f"law = {{ {LAW_TABLES[law]} }}")["law"])
    assert load_scenario(write(text=text)).controller.law == expected


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '{ kind = "Proportional", gain = 2000 }',
            '"PID"',
            "controller.law' is 'PID'; it must be a table such as { kind = \"PID\" }",
        ),
        (
            '{ kind = "GammaPrecision" }',
            '{ kind = "ExplicitDetection", learning = "gamma_precision" }',
            "controller.precision.learning' is 'gamma_precision'; it must be a table such as { kind = \"GammaPrecision\" }",
        ),
        (
            '{ kind = "GammaPrecision" }',
            '[{ kind = "GammaPrecision" }]',
            "controller.precision' is [{'kind': 'GammaPrecision'}]; it must be a table such as { kind = ",
        ),
        (
            '{ kind = "GammaPrecision" }',
            '{ kind = "ExplicitDetection", groups = [0, 1] }',
            "controller.precision.groups' is [0, 1]; it must be a list of lists of whole numbers.",
        ),
        (
            '{ kind = "GammaPrecision" }',
            '{ kind = "SwitchingPrecision", process_modes = [{ kind = "Noisier" }] }',
            "controller.precision.process_modes[0].kind' is 'Noisier', which is no valid kind here; did you mean "
            "'NoisierProcess'?",
        ),
        (
            '{ kind = "GammaPrecision" }',
            '{ kind = "SwitchingPrecision", process_modes = { scale = 9 } }',
            "controller.precision.process_modes' is {'scale': 9}; it must be a list of tables with the settings of "
            "NoisierProcess.",
        ),
    ],
    ids=["law", "learner", "list", "groups", "process mode", "one process mode"],
)
def test_what_has_a_kind_is_a_table(write, old, new, words):
    assert old in ACTIVE
    with pytest.raises(ScenarioError, match=re.escape(words)):
        load_scenario(write(text=ACTIVE.replace(old, new)))


SERVO = shipped_scenarios()["position_servo"].read_text()


def test_a_controller_is_designed_for_the_plant_of_the_file():
    """What is measured and actuated, and how well, is said once; the rest are the arguments of the function."""
    scenario = load_scenario("position_servo")
    wanted = controllers.design(
        fmus.path("PositionServo"), measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, noise={"load": 0.02},
        acceptable_error=0.1, acceptable_control=5.0, u_min=-12.0, u_max=12.0,
    )  # fmt: skip
    np.testing.assert_array_equal(scenario.controller.model.A, wanted.model.A)
    np.testing.assert_array_equal(scenario.controller.regulator.gain, wanted.regulator.gain)
    result = scenario.simulate(duration=3.0)
    assert result["plant.angle"][-1] == pytest.approx(0.5, abs=0.05)  # the first sensor says 1 since t = 2 s
    np.testing.assert_allclose(result["controller.fault_probability"][-1], [1.0, 0.0], atol=0.01)


MODEL_OF_TWO = """
A = [[1, 0.05], [0, 0.95]]
B = [[0], [0.05]]
C = [[1, 0]]
process_covariance = 1e-4
sensor_covariance = 1e-4
"""
LINEAR = """
[simulation]
duration = 1
dt = 0.05
[plant]
A = [[0, 1], [0, -1]]
B = [[0], [1]]
C = [[1, 0]]
dt = 0
control = "u"
measured = "y"
[reference]
kind = "Constant"
value = 0.2
[controller]
kind = "Design"
"""


@pytest.mark.parametrize(
    ("more", "covariance"),
    [
        ("", [1e-4]),
        ("sensor_std = 0.3\n[sensors]\ncount = 2\nstd = 1", [0.09, 0.09]),
        ("[sensors]\ncount = 3\nstd = [1, 2, 3]", [1.0, 4.0, 9.0]),
        ("[sensors]\ncount = 2\nresolution = 6", [3.0, 3.0]),
        ("[sensors]\ncount = 2\nstd = 1\nresolution = [0, 6]", [1.0, 4.0]),
        ("sensor_std = 0.3\n[sensors]\ncount = 2\nresolution = 6", [0.09, 0.09]),
        ("sensor_std = 2\n[sensors]\ncount = 2\ncovariance = [[1, 0.5], [0.5, 1]]", [4.0, 4.0]),
        ("[sensors]\ncount = 2\nstd = 2\nmatrix = [[1], [1]]", [4.0, 4.0]),
    ],
)
def test_a_design_knows_the_sensors_of_the_file(write, more, covariance):
    model = load_scenario(write(text=LINEAR + more)).controller.model
    np.testing.assert_allclose(np.diag(model.sensor_covariance), covariance, rtol=1e-12)
    assert float(model.step) == 0.05


@pytest.mark.parametrize(
    ("more", "error", "said"),
    [
        ("measured = 'y'", ScenarioError, "'controller.measured' is already set by [plant] and [sensors]"),
        ("sensor_stdd = 1", ScenarioError, "'controller' has the unknown key 'sensor_stdd'; did you mean 'sensor_std'"),
        ("goal = true", ScenarioError, "'controller.goal' is true; it must be a text in quotes"),
        ("goal = 'z'", UnknownNameError, "'controller': "),
        ("u_min = 3\nu_max = 2", ModelError, "'controller': u_min is 3, above its u_max of 2"),
        ("precision = 'x'", ScenarioError, "'controller.precision' is 'x'; it must be a table such as"),
        (
            "[model]\nA = [[1]]",
            ScenarioError,
            "'model' cannot be used with kind = 'design', which makes its model from",
        ),
        ("[sensors]\nmatrix = [[2]]", ScenarioError, "'controller' cannot be a design, because [sensors] has a matrix"),
        (
            "[sensors]\ncovariance = [[2]]",
            ScenarioError,
            "'controller' lacks 'sensor_std', which it needs if [sensors] has a covariance",
        ),
    ],
)
def test_what_is_wrong_with_a_design_is_said_with_its_place(write, more, error, said):
    with pytest.raises(error, match=re.escape(f"car.toml: {said}")):
        load_scenario(write(text=LINEAR + more))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('kind = "Injection"', 'kind = "Injektion"', "did you mean 'Injection'"),
        ("sensor = 0", "sensor = 2", "Injection refers to sensor 2, but there are 2"),
        ('measured = "angle"', 'measured = "angel"', "did you mean 'angle'"),
        ("[noise.load]", "[noise.laod]", "did you mean 'load'"),
        ("[[faults]]", "[[input_faults.voltge]]", "did you mean 'voltage'"),
        ('kind = "Step"', 'kind = "Stp"', "did you mean 'Step'"),
        ("u_min = -12.0", "u_min = 13.0", "'controller': u_min is 13, above its u_max of 12"),
        ("acceptable_error = 0.1", "acceptable_error = -0.1", "acceptable_error is .-0.1.; it must be positive"),
        ("duration = 6.0", "duration = -6.0", "'simulation': .*duration"),
    ],
)
def test_mistakes_of_the_file_are_said_before_the_plant_is_linearised(write, monkeypatch, old, new, said):
    module = import_module("bayesftc.controllers.design")
    monkeypatch.setattr(module, "linearize", lambda *_, **__: pytest.fail("The plant is linearised."))
    with pytest.raises(BayesFTCError, match=said):
        load_scenario(write((old, new), text=shipped_scenarios()["position_servo"].read_text()))


def test_a_plant_starts_elsewhere_and_the_belief_of_its_design_with_it(write):
    servo = shipped_scenarios()["position_servo"].read_text()
    fmu = 'fmu = "PositionServo"'
    for text, key, values, words in [
        (
            servo.replace(fmu, f"{fmu} #"),
            fmu,
            "parameters = { angle_0 = 0.4 }",
            "'plant.start' is no key .* parameters = ",
        ),
        (LINEAR, "dt = 0\n", "initial = [0.4, 0.0]", r"'plant.start' is no key .* initial = \["),
    ]:
        scenario = load_scenario(write((key, f"{key}\n{values}\n"), text=text))
        start = scenario.simulate(duration=0.1, engine="interpreted")[f"plant.{scenario.wiring.measured}"][0]
        controller = scenario.controller
        belief = controller.measurement_matrix @ controller.initial_mean
        np.testing.assert_allclose([start, *belief], 0.4, atol=1e-9)
        with pytest.raises(ScenarioError, match=words):
            load_scenario(write((key, f"{key}\nstart = 0.4\n"), text=text))


def test_a_design_is_among_the_kinds_of_controllers(write):
    with pytest.raises(ScenarioError, match="did you mean 'design'"):
        load_scenario(write(text=LINEAR.replace('"Design"', '"desing"')))
    with pytest.raises(ScenarioError, match="'UnbiasedActiveInference', 'design'"):
        load_scenario(write(text=LINEAR.replace('kind = "Design"', "")))


CART = """
[simulation]
duration = 0.2
dt = 0.02
[plant]
fmu = "CartPendulum"
control = "force"
measured = ["position", "angle"]
[sensors]
count = 4
std = 0.005
[[reference]]
kind = "Constant"
value = 0.0
[[reference]]
kind = "Constant"
value = 0.0
[controller]
kind = "NonlinearBayesianController"
goal_on = [[1, 0, 0, 0], [0, 1, 0, 0]]
goal_covariance = 1.0
control_covariance = 1.0
iterations = 4
[model]
kind = "from_fmu"
noise = { torque = 0.02 }
"""


def test_a_model_is_that_of_the_plants_fmu(write):
    scenario = load_scenario(write(text=CART))
    wanted = controllers.NonlinearModel.from_fmu(
        fmus.path("CartPendulum"), measured=["position", "angle"], actuated="force", dt=0.02, sensors=4, sensor_std=0.005,
        noise={"torque": 0.02},
    )  # fmt: skip
    model = scenario.controller.model
    assert model.names == wanted.names
    np.testing.assert_array_equal(model.process_covariance, wanted.process_covariance)
    np.testing.assert_array_equal(model.sensor_covariance, wanted.sensor_covariance)
    assert np.isfinite(scenario.simulate()["controller.u"]).all()


LINEAR_CART = """
A = [[1]]
B = [[1, 1]]
C = [[1], [1]]
dt = 0.02
inputs = ["force", "torque"]
outputs = ["position", "angle"]
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('kind = "from_fmu"', 'kind = "from_fmo"', "'model.kind' is 'from_fmo', .* did you mean 'from_fmu'"),
        ('kind = "from_fmu"', 'kind = "from_fmu"\nmeasured = "angle"', "'model.measured' is already set by"),
        ("noise =", "nose =", "'model' has the unknown key 'nose'; did you mean 'noise'"),
        ('fmu = "CartPendulum"', LINEAR_CART, "the .plant. is no FMU"),
    ],
)
def test_a_wrong_model_of_the_plant_names_the_key(write, old, new, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario(write(text=CART.replace(old, new)))


def test_the_kind_of_an_fmu_is_no_kind_of_plant(tmp_path):
    """An FMU has a setting ``kind``, and [plant] and [blocks.<name>] have one for other blocks."""
    fmu = 'kind = "co-simulation"\nfmu = "CruiseControl"'
    file = tmp_path / "car.toml"
    file.write_text(CAR.replace('fmu = "CruiseControl"', fmu, 1) + f"\n[blocks.other]\n{fmu}\n")
    scenario = load_scenario(file)
    assert scenario.plant.kind == scenario.loop()["other"].block.kind == "co-simulation"


def test_a_missing_file_in_a_folder_without_toml_files_names_the_folder(tmp_path):
    with pytest.raises(
        ScenarioError, match=r"There is no scenario file .*; the folder .* has no scenario file\. Check the path"
    ):
        load_scenario(tmp_path / "mine.toml")
    (tmp_path / "mine2.toml").touch()
    with pytest.raises(ScenarioError, match=r"did you mean 'mine2\.toml'"):
        load_scenario(tmp_path / "mine.toml")


def test_variables_of_an_fmu_are_named_or_tables_with_a_unit(write):
    given = 'control = "force"\noutputs = [{ name = "v", unit = "m/s" }]'
    scenario = load_scenario(write(('control = "force"', given)))
    assert [(port.name, port.unit) for port in scenario.plant.outputs] == [("v", "m/s")]
    with pytest.raises(ModelError, match="FMU has the output 'v' in km/h, but"):
        load_scenario(write(('control = "force"', given.replace("m/s", "km/h"))))
    with pytest.raises(
        ScenarioError, match=r"'plant.outputs\[0\]' has the unknown key 'shape'; known names: name, unit"
    ):
        load_scenario(write(('control = "force"', given.replace('unit = "m/s"', "shape = [1]"))))


def test_sensors_have_a_unit_for_each_quantity(write):
    scenario = load_scenario(write(('unit = "m/s"', 'unit = ["m/s"]')))
    assert scenario.sensors.port("y").unit == "m/s"
    with pytest.raises(ModelError, match=r"unit=\('m/s', 'm'\), 2 units for 1 signal; give one for each"):
        load_scenario(write(('unit = "m/s"', 'unit = ["m/s", "m"]\nmatrix = [[1], [1], [1]]')))


def test_offsets_of_sensors_are_estimated(tmp_path):
    (tmp_path / "servo.toml").write_text(SERVO.replace('kind = "design"', 'kind = "design"\nsensor_bias = [0, 0.05]'))
    scenario = load_scenario(tmp_path / "servo.toml")
    assert scenario.controller.model.state_names[-1] == "sensor_error[1]"
    (tmp_path / "servo.toml").write_text(SERVO.replace('kind = "design"', 'kind = "design"\nsensor_bias = [0, 1, 2]'))
    with pytest.raises(BayesFTCError, match="sensor_bias"):
        load_scenario(tmp_path / "servo.toml")
