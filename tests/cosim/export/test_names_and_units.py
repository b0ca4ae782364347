"""What an exported FMU calls its signals, and in which units they are."""

import re
import subprocess
import zipfile
from dataclasses import fields, is_dataclass
from fractions import Fraction
from itertools import pairwise

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.base.units import parse
from bayesftc.cosim.export.dependencies import feeding_elements
from bayesftc.cosim.export.names import legal, program_name, unique
from bayesftc.cosim.export.program import program_of
from bayesftc.cosim.export.units import unit_of_setting


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("plant.v", "plant.v"),
        ("u[0,1]", "u[0,1]"),
        ("größe-1.y[2]", "groesse_1.y[2]"),
        ("Δφ", "deltaphi"),
        ("1st.y", "_1st.y"),
        ("車.y", "_.y"),
        ("a.[0]", "a._[0]"),
        ("é", "e"),
    ],
)
def test_names_that_fmi_does_not_allow_are_spelt_otherwise(name, expected):
    assert legal(name) == expected
    assert legal(expected) == expected


def test_no_two_are_the_same_to_fmi_or_c():
    wanted = [("a.b", ()), ("a_b", ()), ("a", (2,)), ("a_0_", ()), ("time", ()), ("int", ()), ("int_", ())]
    assert unique(wanted) == ["a.b", "a_b_2", "a", "a_0__2", "time_2", "int", "int__2"]


def strange():
    diagram = cosim.Diagram(0.1)
    nodes = [diagram.add(cosim.Gain(2.0), name) for name in ("größe-1", "groesse_1", "車", "車2")]
    for one, other in pairwise(nodes):
        diagram.connect(one["y"], other["u"])
    return diagram


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_diagram_of_strange_names_is_valid(fmi, tmp_path, c_compiler):
    path = str(cosim.export_fmu(strange(), tmp_path / "Strange.fmu", fmi=fmi))
    assert validate_fmu(path) == []
    variables = fmpy.read_model_description(path).modelVariables
    outputs = [v.name for v in variables if v.causality == "output"]
    assert outputs == ["groesse_1.y_2", "groesse_1.y", "_.y", "_2.y"]
    assert cosim.FMU(path).port("groesse_1.y")


def test_a_name_that_is_given_must_be_legal():
    with pytest.raises(cosim.ModelError, match=r"An output of the export cannot be named 'größe'\. FMI allows"):
        program_of(strange(), outputs={"車.y": "größe"})
    given = program_of(strange(), outputs={"車.y": "groesse_1.gain"})
    assert [s.name for s in given.outputs] == ["groesse_1.gain"]
    assert [t.name for t in given.tunables][:4] == [
        "groesse_1.gain_3",
        "groesse_1.offset_2",
        "groesse_1.gain_2",
        "groesse_1.offset",
    ]


@pytest.mark.parametrize("given", [{"y": "u"}, {"y": "time"}, {"y": 7}])
def test_a_name_that_is_given_is_kept_or_refused(given):
    with pytest.raises(cosim.ModelError, match="An output of the export cannot be named"):
        program_of(cosim.Gain(2.0), dt=0.1, outputs=given)


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("controller", "controller"),
        ("mein Regler ü", "mein_Regler_ue"),
        ("2fast", "block_2fast"),
        ("車", "block"),
        ("a.b", "a_b"),
        ("../x", "x_"),
        ("model", "model_"),
        ("Math", "Math_"),
        ("fmi2", "fmi2_"),
        ("int", "int_"),
    ],
)
def test_any_file_name_has_a_name_in_c(stem, expected):
    assert program_name(stem) == expected


CLASHING = "x h i c u program begin tune initial model instance fmi2 math stdint memcpy PROGRAM model_step exit main"


@pytest.mark.sampled(2)
@pytest.mark.parametrize("clashing", CLASHING.split())
def test_no_name_of_a_file_clashes_with_other_c(clashing, c_compiler, tmp_path):
    (source, header) = cosim.export_c(cosim.UnitDelay(), tmp_path, name=clashing, dt=0.1)
    includes = "".join(f"#include <{name}.h>\n" for name in ("math", "stdint", "stdio", "stdlib", "string", "time"))
    (tmp_path / "firmware.c").write_text(f'{includes}#include "{header.name}"\nint main(void) {{ return 0; }}\n')
    command = [
        c_compiler,
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wshadow",
        "-I.",
        source.name,
        "firmware.c",
        "-lm",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["model", "x", "initial", "2 Regler ü"])
def test_an_fmu_may_be_called_anything(name, c_compiler, tmp_path):
    path = cosim.export_fmu(cosim.UnitDelay(), tmp_path / f"{name}.fmu", dt=0.1)
    assert validate_fmu(str(path)) == []
    diagram = cosim.Diagram(0.1)
    nodes = [diagram.add(cosim.Sine(1.0, 2.0)), diagram.add(cosim.UnitDelay(), "delay")]
    diagram.connect(nodes[0]["y"], nodes[1]["u"])
    assert cosim.verify_fmu(path, diagram, "delay", duration=1.0).agrees()


def test_units_travel_along_connections():
    diagram = cosim.Diagram(0.1)
    v = diagram.add(cosim.Constant(1.0, unit="m/s"), "v")
    sensors = diagram.add(cosim.Sensors(count=2), "sensors")
    fault = diagram.add(cosim.Bias(magnitude=1.0, channels=2), "fault")
    gain = diagram.add(cosim.Gain([[1.0, 2.0]]), "gain")
    force = diagram.add(cosim.Gain(1.0, input_unit="N"), "force")
    diagram.connect(v["y"], sensors["u"])
    diagram.connect(sensors["y"], fault["u"])
    diagram.connect(fault["y"], gain["u"])
    diagram.connect(gain["y"][0], force["u"])
    alone = program_of(diagram, blocks="gain")
    assert [(s.name, s.unit) for s in (*alone.inputs, *alone.outputs)] == [("u", "m/s"), ("y", "N")]
    both = program_of(diagram, blocks=["sensors", "fault"])
    assert {s.name: s.unit for s in both.outputs} == {"sensors.y": "m/s", "fault.y": "m/s", "fault.active": None}


@pytest.mark.parametrize(("reference", "unit"), [(2.0, "m/s"), (cosim.Constant(2.0, unit="m s-1"), "m s-1")])
def test_the_goal_has_the_unit_of_the_quantity(reference, unit):
    plant = cosim.FMU(fmus.path("CruiseControl"))
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]], 0.001, 1.0, dt=0.02)
    controller = controllers.BayesianController(model, controllers.GammaPrecision(forgetting=0.95))
    loop = cosim.closed_loop(plant, controller, control="force", measured="v", reference=reference)
    found = {signal.name: signal.unit for signal in program_of(loop, blocks="controller").inputs}
    assert found == {"y": "m/s", "goal": unit}


@pytest.mark.slow
def test_goals_of_different_units_have_none():
    plant, torques, angles = cosim.FMU(fmus.path("TwoLinkArm")), ["torque1", "torque2"], ["q1", "dq2"]
    model = controllers.LinearModel(0.9 * np.eye(2), np.eye(2), np.eye(2), 0.01 * np.eye(2), np.eye(2), dt=0.01)
    controller = controllers.LQGController(model, goal_covariance=np.eye(2))
    loop = cosim.closed_loop(plant, controller, control=torques, measured=angles, reference=[0.0, 0.0])
    assert {signal.name: signal.unit for signal in program_of(loop, blocks="controller").inputs}["goal"] is None


def test_where_units_meet_nothing_is_said():
    diagram = cosim.Diagram(0.1)
    v, x = diagram.add(cosim.Constant(1.0, unit="m/s"), "v"), diagram.add(cosim.Constant(1.0, unit="m"), "x")
    gain = diagram.add(cosim.Gain([[1.0, 2.0]]), "gain")
    diagram.connect(v["y"], gain["u"][0])
    diagram.connect(x["y"], gain["u"][1])
    assert [s.unit for s in program_of(diagram, blocks="gain").inputs] == [None]


def test_settings_are_measured_in_what_their_fields_say():
    diagram = cosim.Diagram(0.1)
    v = diagram.add(cosim.Constant(1.0, unit="m/s"), "v")
    drift = diagram.add(cosim.Drift(slope=1.0, channels=2, stop=9.0), "drift")
    alone = diagram.add(cosim.Injection(magnitude=1.0, channels=1), "alone")
    for i in range(2):
        diagram.connect(v["y"], drift["u"][i])
    units = {t.name: t.unit for t in program_of(diagram, blocks=["v", "drift", alone.name]).tunables}
    assert units["v.value"] == "m/s"
    assert (units["drift.slope"], units["drift.start"], units["drift.stop"]) == ("m/s/s", "s", "s")
    assert (units["alone.magnitude"], units["alone.period"], units["alone.phase"]) == (None, "s", "rad")
    assert unit_of_setting("{u}/s", "drift", {("other", "u"): "m"}) is None
    assert unit_of_setting("", "drift", {}) is None


def test_what_a_field_says_of_its_unit_is_known(block):
    ports = {port.name: "m" for port in (*block.inputs, *block.outputs)}
    for field in fields(block) if is_dataclass(block) else ():  # a subsystem has no settings of its own
        text = field.metadata.get("unit", "s")
        unit = unit_of_setting(text, "it", {("it", port): unit for port, unit in ports.items()})
        assert unit, f"{field.name}: {text} names a port that {type(block).__name__} has not"
        assert parse(unit), f"{field.name}: {unit} is no unit"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_an_fmu_tells_the_units_of_its_parameters(fmi, tmp_path, c_compiler):
    path = cosim.export_fmu(cosim.Sine(1.0, 2.0, unit="N"), tmp_path / "Sine.fmu", fmi=fmi, dt=0.1)
    assert validate_fmu(str(path)) == []
    variables = fmpy.read_model_description(str(path)).modelVariables
    said = {v.name: v.unit for v in variables if v.causality == "parameter"}
    assert said == {"amplitude": "N", "period": "s", "offset": "N", "phase": "rad"}


def test_every_port_says_what_it_is(block):
    for port in (*block.inputs, *block.outputs):
        assert port.description or port.draw, port.name


@pytest.mark.sampled(3)
def test_every_tunable_says_what_it_is(block, sample_time):
    for tunable in program_of(block, dt=sample_time(block)).tunables:
        assert not re.fullmatch(r"\w+ of \w+", tunable.description), (
            f"{tunable.name} is not among its class's Parameters"
        )


def test_what_only_tells_that_something_is_missing_counts():
    monitor = controllers.FaultMonitor(2, ("beta",), 0.5, controllers.LogisticMap((1.0,), (0.0,), (1.0,), -1.0))
    fed = feeding_elements(program_of(monitor, dt=0.1))["fault_probability"]
    assert [{"innovation[0]", "beta[0]"} <= of and "beta[1]" not in of for of in fed] == [True, False]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_of_a_unit_that_nobody_knows_only_the_name_is_told(fmi, tmp_path, c_compiler):
    """Exponents that are all zero would make a number of it, which an importer may convert."""
    path = cosim.export_fmu(cosim.Gain(1.0, input_unit="blip", output_unit="%"), tmp_path / "it.fmu", fmi=fmi, dt=0.1)
    assert validate_fmu(str(path)) == []
    text = zipfile.ZipFile(path).read("modelDescription.xml").decode()
    assert '<Unit name="blip" />' in text
    assert '<BaseUnit factor="0.01" />' in text


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seconds", ["1/50", "7/100", "60"])
def test_the_default_experiment_is_a_whole_number_of_steps(seconds, tmp_path, c_compiler):
    """The last step of another one would be cut, which is refused; where a step is a minute long there would be none."""
    path = cosim.export_fmu(cosim.UnitDelay(), tmp_path / "it.fmu", dt=seconds)
    told = fmpy.read_model_description(str(path)).defaultExperiment
    steps = Fraction(told.stopTime).limit_denominator(1000) / Fraction(seconds)
    assert steps.denominator == 1
    assert steps >= 100
    assert len(fmpy.simulate_fmu(str(path))) == steps + 1


@pytest.mark.parametrize(("given", "written"), [(60.0, 60.0), (0.05, 0.06), (1e-9, 0.03)])
def test_the_stop_time_is_as_given_up_to_the_next_step(given, written, tmp_path, c_compiler):
    path = cosim.export_fmu(cosim.UnitDelay(), tmp_path / "it.fmu", dt=0.03, stop_time=given)
    told = fmpy.read_model_description(str(path)).defaultExperiment
    assert float(told.stopTime) == pytest.approx(written, rel=1e-12)


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_a_stop_time_that_is_none_is_refused(wrong, tmp_path):
    with pytest.raises(cosim.ModelError, match=r"stop_time=.*positive number of seconds"):
        cosim.export_fmu(cosim.UnitDelay(), tmp_path / "it.fmu", dt=0.03, stop_time=wrong)
