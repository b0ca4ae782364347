"""FMUs of FMI 1.0: against closed forms and fmpy; aliases; what FMI 1 cannot do; and drafts of the standard, refused."""

import re
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import LinearModel
from bayesftc.cosim.errors import FMUError, FMUVersionError, ModelError, SimulationError
from bayesftc.cosim.fmi.fmu import describe

HERE = Path(__file__).parent
CAPABILITIES = 'canHandleVariableCommunicationStepSize="true"'
DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="Slave" modelIdentifier="Slave" guid="{{slave}}" generationTool="an old tool"
  numberOfContinuousStates="0" numberOfEventIndicators="0">
  <UnitDefinitions>
    <BaseUnit unit="K"><DisplayUnitDefinition displayUnit="degC" gain="1" offset="-273.15"/></BaseUnit></UnitDefinitions>
  <TypeDefinitions>
    <Type name="Mode"><EnumerationType><Item name="off"/><Item name="on"/></EnumerationType></Type></TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="1" tolerance="1e-4"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="1" variability="parameter"><Real start="1" fixed="true"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="2" causality="output">
      <Real start="0" fixed="true"/><DirectDependency/></ScalarVariable>
    <ScalarVariable name="same" valueReference="2" causality="output" alias="alias"><Real/><DirectDependency/></ScalarVariable>
    <ScalarVariable name="down" valueReference="2" causality="output" alias="negatedAlias">
      <Real/><DirectDependency/></ScalarVariable>
    <ScalarVariable name="brake" valueReference="1" variability="parameter" alias="negatedAlias">
      <Real start="-1"/></ScalarVariable>
    <ScalarVariable name="lie" valueReference="3" variability="parameter"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="derived" valueReference="1" variability="parameter"><Real/></ScalarVariable>
    <ScalarVariable name="i" valueReference="0" causality="input" variability="discrete"><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="b" valueReference="0" causality="input" variability="discrete"><Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="e" valueReference="1" causality="input" variability="discrete">
      <Enumeration declaredType="Mode" start="1"/></ScalarVariable>
    <ScalarVariable name="i_out" valueReference="0" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="i_down" valueReference="0" causality="output" variability="discrete" alias="negatedAlias">
      <Integer/></ScalarVariable>
    <ScalarVariable name="b_out" valueReference="0" causality="output" variability="discrete"><Boolean/></ScalarVariable>
    <ScalarVariable name="b_not" valueReference="0" causality="output" variability="discrete" alias="negatedAlias">
      <Boolean/></ScalarVariable>
    <ScalarVariable name="e_out" valueReference="1" causality="output" variability="discrete">
      <Enumeration declaredType="Mode"/></ScalarVariable>
    <ScalarVariable name="inner" valueReference="2" causality="internal"><Real/></ScalarVariable>
  </ModelVariables>
  <Implementation><CoSimulation_StandAlone><Capabilities {CAPABILITIES}/></CoSimulation_StandAlone></Implementation>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def slave(tmp_path_factory, c_compiler):
    """Return a function that gives the path of the slave, its description changed by pairs of texts."""
    folder = tmp_path_factory.mktemp("fmi1")
    library = folder / f"Slave{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-shared", "-fPIC", "-O2", "-w", f"-I{headers}", "-o", str(library)]
    subprocess.run([c_compiler, *flags, str(HERE / "fmi1_slave.c")], check=True)

    def path(*pairs):
        text = DESCRIPTION
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        target = folder / f"slave{abs(hash(text))}.fmu"
        with zipfile.ZipFile(target, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
        return target

    return path


def driven(path, dt=0.1, sources=(), **options):
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(cosim.FMU(path, **options), "p")
    for name, block in dict(sources).items():
        diagram.connect(diagram.add(block, f"to_{name}")["y"], plant[name])
    return diagram


def test_an_integrator_with_ports_of_all_types_and_their_aliases(slave, run_both):
    sources = {
        "u": cosim.Sine(amplitude=2.0, period=0.7),
        "i": cosim.Step(time=0.5, before=-3.0, after=2.0**31 - 1),
        "b": cosim.Step(time=0.3, after=1.0),
        "e": cosim.Step(time=0.3, before=1.0, after=2.0),
    }
    result = run_both(driven(slave(), sources=sources, parameters={"k": 3.0}), 1)
    x = np.concatenate([[0.0], np.cumsum(0.1 * 3.0 * result["to_u.y"])[:-1]])
    np.testing.assert_allclose(result["p.x"], x, atol=1e-14)
    for name, other in (("same", result["p.x"]), ("down", -result["p.x"]), ("i_down", -result["p.i_out"])):
        np.testing.assert_array_equal(result[f"p.{name}"], other)
    for name in "ibe":
        np.testing.assert_array_equal(result[f"p.{name}_out"][1:], result[f"to_{name}.y"][:-1])
    assert np.ptp(result["p.i_out"]) > 2**31


def test_the_same_as_fmpy(slave):
    start = {"k": 2.5, "i": 7, "b": True}
    for path in (slave(), slave((CAPABILITIES, ""))):
        ours = driven(path, 0.02, parameters={**start, "u": 0.7}).simulate(2)
        names = ["x", "same", "i_out", "b_out", "e_out"]
        theirs = fmpy.simulate_fmu(
            str(path), stop_time=2, output_interval=0.02, start_values={**start, "u": 0.7}, output=names
        )
        for name in names:
            np.testing.assert_allclose(ours[f"p.{name}"], theirs[name].astype(float), rtol=0, atol=1e-9)
        assert ours["p.x"][-1] > 3


def test_what_a_description_of_fmi_1_says_in_the_words_of_fmi_2(slave):
    description = describe(slave())
    variables = {v.name: v for v in description.variables}
    assert description.fmi_version == "1.0"
    assert description.kinds == ("coSimulation",)
    assert description.capabilities["canHandleVariableCommunicationStepSize"] is True
    assert description.feedthrough["x"] == ()
    assert description.feedthrough["i_out"] is None
    assert variables["k"].causality == "parameter"
    assert variables["derived"].causality == "calculatedParameter"
    assert variables["inner"].causality == "local"
    assert [v.name for v in variables.values() if v.settable] == ["u", "k", "x", "brake", "lie", "i", "b", "e"]
    assert variables["e"].items == (("off", 1), ("on", 2))
    tool = slave(
        ("CoSimulation_StandAlone", "CoSimulation_Tool"),
        ("></CoSimulation_Tool>", '><Model entryPoint="a" type="b"/></CoSimulation_Tool>'),
    )
    assert describe(tool).capabilities["needsExecutionTool"] is True


def test_a_parameter_that_is_the_negative_of_another_is_set_as_such(slave):
    result = driven(slave(), parameters={"brake": -4.0, "u": 1.0}).simulate(1)
    assert result["p.x"][-1] == pytest.approx(4.0)


def test_the_opposite_of_a_boolean_is_no_port(slave):
    block = cosim.FMU(slave())
    assert [p.name for p in block.outputs] == ["x", "same", "down", "i_out", "i_down", "b_out", "e_out"]
    with pytest.raises(
        FMUError, match=r"'b_not' .* is the opposite of another variable \(negatedAlias\) and of type Boolean"
    ):
        cosim.FMU(slave(), outputs=["b_not"])
    assert [p.name for p in cosim.FMU(slave(), outputs=["inner", "down"]).outputs] == ["inner", "down"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("isolate", [False, True])
def test_several_instances_of_one_name_and_each_ones_messages(slave, isolate):
    path = slave()
    diagram = cosim.Diagram(dt=0.1)
    for i in range(3):
        diagram.add(
            cosim.FMU(path, parameters={"u": float(i), "lie": 3.0 if i == 2 else 0.0}, isolate=isolate), f"p{i}"
        )
    with pytest.raises(
        SimulationError, match=r"'p2'.*fmiDoStep returned Error\. Its log: p2: the belt is off at t = 0\.3"
    ) as caught:
        diagram.simulate(1)
    np.testing.assert_allclose(caught.value.result["p1.x"], [0.0, 0.1, 0.2, 0.3], atol=1e-12)


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
@pytest.mark.parametrize(
    ("lie", "sentence"),
    [
        (2, r"fmiDoStep returned Discard\. It computed the step up to t = 0\.3 s\. Try a smaller step\."),
        (3, r"fmiDoStep returned Error\. Its log: p: the belt is off at t = 0\.3"),
        (77, r"fmiDoStep returned 77, which is no status of FMI\."),
    ],
)
def test_steps_that_fail_stop_the_run_and_say_why(slave, lie, sentence, engine):
    with pytest.raises(SimulationError, match=sentence) as caught:
        driven(slave(), parameters={"lie": float(lie)}).simulate(1, engine=engine)
    assert len(caught.value.result.time) == 4


def test_a_refusal_to_begin_says_why_and_kills_nobody(slave):
    # fmpy takes the status for the address of a text, and reads it.
    with pytest.raises(FMUError, match=r"fmiInitializeSlave returned Error.* Its log: p: no way to begin"):
        driven(slave(), parameters={"lie": 1.0}).simulate(1)
    with pytest.raises(FMUError, match=r"could not be instantiated as 'p'.* Its log: the guid is wrong, not mine"):
        driven(slave(('guid="{slave}"', 'guid="wrong"'))).simulate(1)


def test_what_fmi_1_cannot_do_is_said(slave):
    with (
        cosim.Session(driven(slave())) as session,
        pytest.raises(
            FMUError, match=r"FMI 1\.0, which has no saved states. Export it as FMI 2\.0 or 3\.0 with canGet"
        ),
    ):
        session.save_state()
    with pytest.raises(
        ModelError, match=r"rtol=1e-05, but slave.*\.fmu is of FMI 1\.0, whose co-simulation has no tolerance"
    ):
        cosim.FMU(slave(), rtol=1e-5)
    with pytest.raises(FMUError, match="only tunable parameters"):
        cosim.FMU(slave(), tunable=["k"])
    with pytest.raises(FMUVersionError, match="cannot be used for model exchange, only for co-simulation"):
        cosim.FMU(slave(), kind="model exchange")


@pytest.mark.slow
def test_inspect_and_run_from_the_command_line(slave, bayesftc_):
    shown = bayesftc_("inspect", slave())
    assert shown.exit_code == 0
    assert re.search(r"FMI +1\.0", shown.output)
    scenario = f"""
[simulation]
duration = 2.0
[plant]
fmu = "{slave()}"
parameters = {{ k = 2.0 }}
control = "u"
measured = "x"
[sensors]
count = 2
std = 0.1
[reference]
kind = "Step"
time = 0.5
after = 1.0
[model]
A = [[1.0]]
B = [[0.1]]
C = [[1.0], [1.0]]
process_covariance = 1e-4
sensor_covariance = 0.01
dt = 0.05
[controller]
kind = "BayesianController"
[controller.precision]
kind = "FixedPrecision"
"""
    Path("old.toml").write_text(scenario)
    ran = bayesftc_("run", "old.toml", "--out", "results")
    assert ran.exit_code == 0, ran.output
    assert list(Path("results").iterdir())


@pytest.mark.parametrize(
    "version", ["3.0-beta.2", "3.0-alpha.5", "3.0-rc.1", "2.0-rc", "2.0RC1", "2.0_Beta4", "2.0 Beta"]
)
def test_drafts_of_the_standard_are_refused_by_name(slave, version):
    said = rf"is an FMU of FMI {re.escape(version)}, a draft .*only FMI 1\.0, 2\.0 and 3\.0 .*Export .* as FMI 2\.0 or 3\.0"
    with pytest.raises(FMUVersionError, match=said):
        cosim.FMU(slave(('fmiVersion="1.0"', f'fmiVersion="{version}"')))


@pytest.mark.parametrize(
    ("version", "what"), [("4.0", "FMI 4.0,"), ("", "FMI without a version,"), ("9" * 500, f"FMI {'9' * 40},")]
)
def test_other_versions_are_refused_by_name(slave, version, what):
    with pytest.raises(FMUVersionError, match=f"is an FMU of {what} but only FMI"):
        describe(slave(('fmiVersion="1.0"', f'fmiVersion="{version}"')))


def test_campaigns_linear_models_and_systems_of_several(slave, campaign_as_alone, tmp_path):
    noisy = driven(slave(), sources={"u": cosim.Gaussian(std=1.0)})
    assert len(campaign_as_alone(noisy, 1.0)) == 4
    model = LinearModel.from_fmu(cosim.FMU(slave(), parameters={"k": 2.0}), actuated="u", measured="x", dt=0.1)
    np.testing.assert_allclose(model.C @ model.B, [[0.2]], atol=1e-9)
    np.testing.assert_allclose(model.A, [[1.0]], atol=1e-9)
    diagram = driven(slave(), parameters={"u": 0.5, "k": 3.0}, inputs=["u"], outputs=["x", "down"])
    cosim.save_ssp(diagram, tmp_path / "old.ssp")
    loaded = cosim.open_ssp(tmp_path / "old.ssp")
    np.testing.assert_array_equal(loaded.simulate(1)["p.x"], diagram.simulate(1)["p.x"])
