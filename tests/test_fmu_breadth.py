"""FMUs with arrays, ports of every type, tunable parameters, units, events, early returns and discarded steps.

The FMUs are compiled here, from ``breadth/``; fmpy's own simulation of the same files is the oracle.
"""

import dataclasses
import pickle
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim import ops
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError, SSPError, StepSizeError, UnknownNameError
from bayesftc.cosim.fmu import FMU
from bayesftc.cosim.roles import loop_signals
from bayesftc.scenario import load_scenario

SOURCES = Path(__file__).parent / "breadth"
ENGINES = ("compiled", "interpreted")

DESCRIPTION = {
    "3": """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Breadth" instantiationToken="{b}">
  <CoSimulation modelIdentifier="Breadth" canHandleVariableCommunicationStepSize="true" FLAGS/>
  <UnitDefinitions>
    <Unit name="Grad/s"><BaseUnit rad="1" s="-1" factor="0.015707963267948967"/></Unit>
    <Unit name="K"><BaseUnit K="1"/><DisplayUnit name="Rankine" factor="1.8"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <EnumerationType name="Mode"><Item name="off" value="1"/><Item name="on" value="2"/></EnumerationType>
  </TypeDefinitions>
  <ModelVariables>
    <UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="2"/>
    <Float64 name="u" valueReference="2" causality="input" start="0"><Dimension valueReference="1"/></Float64>
    <Float64 name="K" valueReference="3" causality="parameter" variability="fixed" start="1 0 0 1" unit="Grad/s">
      <Dimension valueReference="1"/><Dimension valueReference="1"/></Float64>
    <Float64 name="x0" valueReference="4" causality="parameter" variability="fixed" start="0" unit="K">
      <Dimension valueReference="1"/></Float64>
    <Float64 name="y" valueReference="5" causality="output"><Dimension valueReference="1"/></Float64>
    <Float64 name="k" valueReference="6" causality="parameter" variability="tunable" start="1"/>
    <Float64 name="total" valueReference="7" causality="output"/>
    <Float64 name="stall" valueReference="8" causality="parameter" variability="fixed" start="0"/>
    <Int32 name="count" valueReference="9" causality="output"/>
    <Int32 name="next" valueReference="10" causality="input" start="1"/>
    <Int8 name="byte" valueReference="11" causality="input" start="0"/>
    <Int8 name="byte_out" valueReference="12" causality="output"/>
    <Int64 name="wide" valueReference="13" causality="input" start="0"/>
    <Int64 name="twice" valueReference="14" causality="output"/>
    <Boolean name="flag" valueReference="15" causality="input" start="false"/>
    <Boolean name="flag_out" valueReference="16" causality="output"/>
    <Enumeration declaredType="Mode" name="mode" valueReference="17" causality="input" start="1"/>
    <Enumeration declaredType="Mode" name="mode_out" valueReference="18" causality="output"/>
    <Float32 name="single" valueReference="19" causality="input" start="0"/>
    <Float32 name="single_out" valueReference="20" causality="output"/>
    <UInt16 name="word" valueReference="21" causality="input" start="0"/>
    <UInt16 name="word_out" valueReference="22" causality="output"/>
    <String name="label" valueReference="23" causality="parameter" variability="fixed"><Start value="none"/></String>
    <Int32 name="length" valueReference="24" causality="output"/>
    <Float64 name="numbers" valueReference="25" causality="input" start="1.5 2.5"><Dimension start="2"/></Float64>
    <Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>
  </ModelVariables>
  <ModelStructure>OUTPUTS</ModelStructure>
</fmiModelDescription>""".replace(
        "OUTPUTS",
        "".join(f'<Output valueReference="{r}" dependencies=""/>' for r in (5, 7, 9, 12, 14, 16, 18, 20, 22, 24)),
    ),
    "2": """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Breadth" guid="{b}">
  <CoSimulation modelIdentifier="Breadth" FLAGS/>
  <TypeDefinitions><SimpleType name="Mode"><Enumeration><Item name="off" value="1"/><Item name="on" value="2"/>
  </Enumeration></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="tunable"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="most" valueReference="3" causality="parameter" variability="fixed"><Real start="1e9"/></ScalarVariable>
    <ScalarVariable name="reach" valueReference="4" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="steps" valueReference="5" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="count" valueReference="6" causality="input" variability="discrete"><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="count_out" valueReference="7" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="flag" valueReference="8" causality="input" variability="discrete"><Boolean start="0"/></ScalarVariable>
    <ScalarVariable name="flag_out" valueReference="9" causality="output" variability="discrete"><Boolean/></ScalarVariable>
    <ScalarVariable name="mode" valueReference="10" causality="input" variability="discrete">
      <Enumeration declaredType="Mode" start="1"/></ScalarVariable>
    <ScalarVariable name="mode_out" valueReference="11" causality="output" variability="discrete">
      <Enumeration declaredType="Mode"/></ScalarVariable>
    <ScalarVariable name="lie" valueReference="12" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="end" valueReference="13" causality="parameter" variability="fixed"><Real start="1e9"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs>OUTPUTS</Outputs><InitialUnknowns>OUTPUTS</InitialUnknowns></ModelStructure>
</fmiModelDescription>""".replace(
        "OUTPUTS", "".join(f'<Unknown index="{i}" dependencies=""/>' for i in (3, 6, 8, 10, 12))
    ),
}


@pytest.fixture(scope="session")
def breadth(tmp_path_factory, c_compiler):
    """Return a function that returns the FMU of a version of FMI with some flags of its description."""
    compiler = c_compiler
    import fmpy

    folder = tmp_path_factory.mktemp("breadth")
    headers = Path(fmpy.__file__).parent / "c-code"
    binaries = {}
    for major in "23":
        text = (SOURCES / f"fmi{major}.c").read_text()
        wanted = set(re.findall(rf"\b(fmi{major}\w+?)TYPE\b", (headers / f"fmi{major}Functions.h").read_text()))
        macros = {"2": {"fmi2SetReal", "fmi2GetReal"}}.get(major) or {
            f"fmi3{verb}{kind}" for verb in ("Get", "Set") for kind in ("Int8", "UInt16", "Boolean", "Float32")
        }
        stubs = " ".join(f"STUB({n})" for n in sorted(wanted) if n not in macros and not re.search(rf"\b{n}\(", text))
        source, library = folder / f"fmi{major}.c", folder / f"fmi{major}.so"
        source.write_text(text.replace("\nSTUBS\n", f"\n{stubs}\n"))
        subprocess.run([compiler, "-O1", "-w", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
        binaries[major] = library.read_bytes()

    def make(major, flags=""):
        name = f"{major}{''.join(c for c in flags if c.isalnum())}.fmu"
        if not (folder / name).exists():
            place = fmpy.platform if major == "2" else fmpy.platform_tuple
            with zipfile.ZipFile(folder / name, "w") as archive:
                archive.writestr("modelDescription.xml", DESCRIPTION[major].replace("FLAGS", flags))
                archive.writestr(f"binaries/{place}/Breadth{fmpy.sharedLibraryExtension}", binaries[major])
        return folder / name

    return make


EVENTS = 'hasEventMode="true" mightReturnEarlyFromDoStep="true"'
VARIABLE = 'canHandleVariableCommunicationStepSize="true"'
REALS3 = {"inputs": ["u"], "outputs": ["y", "total"]}


def alone(block, dt, *sources):
    diagram = cosim.Diagram(dt=dt)
    node = diagram.add(block, "b")
    for name, source in sources:
        diagram.connect(diagram.add(source, f"s_{name}")["y"], node[name])
    return diagram


# --- arrays ------------------------------------------------------------------------------------------------------------------


def test_arrays_are_vector_and_matrix_ports_as_large_as_structural_parameters_say(breadth):
    block = FMU(breadth("3"))
    assert [(p.name, p.shape, p.default) for p in block.inputs[:2]] == [("u", (2,), (0.0, 0.0)), ("next", (), 1.0)]
    assert block.port("numbers").default == (1.5, 2.5)
    assert block.port("y").shape == (2,)
    assert block.start_value("K") == ((1.0, 0.0), (0.0, 1.0))
    three = FMU(breadth("3"), parameters={"n": 3, "x0": [1, 2, 3]})
    assert (three.port("u").shape, three.port("y").shape, three.port("u").default) == ((3,), (3,), (0.0, 0.0, 0.0))
    assert three.start_value("K") is None  # of another size, the FMU has values of its own
    assert pickle.loads(pickle.dumps(three)) == three
    assert dataclasses.replace(three, name="again").port("u").shape == (3,)
    for values, words in (
        ({"n": 3, "x0": [1, 2]}, "'x0' of the FMU 3.fmu is an array of shape (3,) and must be given as one"),
        ({"K": [[1, 2], [3]]}, "shape (2, 2) and must be given as one, row by row"),
        ({"K": [[1, 2], [3, "four"]]}, "must be a finite number, not 'four'"),
        ({"n": 10_000}, "would have the shape (10000, 10000): more than 10,000,000 numbers"),
        ({"n": -1}, "must be a whole number from 0 to"),
    ):
        with pytest.raises(FMUError, match=re.escape(words)):
            FMU(breadth("3"), parameters=values)
    with pytest.raises(FMUError, match=r"'y' of the FMU 3.fmu is an array of shape \(0,\), which is empty"):
        FMU(breadth("3"), parameters={"n": 0}, outputs=["y"])


@pytest.mark.parametrize("n", [2, 3])
def test_an_array_fmu_gives_the_numbers_of_fmpy_in_both_engines(breadth, run_both, n):
    import fmpy

    K, x0, u = (
        np.array([[1.0, 2.0, 0.5], [3.0, 4.0, -1.0], [0.0, 1.0, 2.0]])[:n, :n],
        [1.0, -1.0, 0.5][:n],
        [0.1, -0.2, 0.3][:n],
    )
    structure = {"n": n} if n != 2 else {}
    block = FMU(breadth("3"), parameters=structure | {"K": K, "x0": x0, "u": u}, **REALS3)
    run = run_both(alone(block, "1/64"), 1)
    expected = np.array(x0) + np.outer(run.time, K @ u)
    np.testing.assert_allclose(run["b.y"], expected, rtol=1e-13)
    np.testing.assert_allclose(run["b.total"], expected.sum(axis=1), rtol=1e-12, atol=1e-13)
    if n == 2:
        start = {name: " ".join(map(repr, np.ravel(v).tolist())) for name, v in (("K", K), ("x0", x0), ("u", u))}
        theirs = fmpy.simulate_fmu(
            str(breadth("3")), stop_time=1.0, output_interval=1 / 64, start_values=start, output=["y"]
        )["y"]
    else:  # simulate_fmu does not configure: the same calls by hand, through fmpy's own functions
        theirs = by_hand(breadth("3"), n, K, x0, u)
    np.testing.assert_array_equal(np.asarray(theirs), run["b.y"])


def by_hand(path, n, K, x0, u):
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    slave = FMU3Slave(
        guid="{b}", unzipDirectory=fmpy.extract(str(path)), modelIdentifier="Breadth", instanceName="oracle"
    )
    slave.instantiate()
    slave.enterConfigurationMode()
    slave.setUInt64([1], [n])
    slave.exitConfigurationMode()
    slave.setFloat64([3], K.ravel().tolist())
    slave.setFloat64([4], x0)
    slave.enterInitializationMode()
    slave.setFloat64([2], u)
    slave.exitInitializationMode()
    rows = [slave.getFloat64([5], nValues=n)]
    for k in range(64):
        slave.doStep(k / 64, 1 / 64)
        rows.append(slave.getFloat64([5], nValues=n))
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(slave.unzipDirectory)
    return rows


def test_arrays_of_another_exporter(tmp_path, run_both):
    builder = pytest.importorskip("pythonfmu3").FmuBuilder
    path = builder.build_FMU(str(SOURCES / "vessel.py"), dest=str(tmp_path))
    mix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 3.0]])
    values = {"mix": mix, "flow": [1, 2, 3], "valves": [True, False, True], "count": [-5, 7]}
    block = FMU(path, parameters=values, tunable=["gain"], timing="plant")
    assert [(p.name, p.shape) for p in block.inputs] == [
        ("flow", (3,)),
        ("valves", (3,)),
        ("count", (2,)),
        ("gain", ()),
    ]
    run = run_both(alone(block, 0.1, ("gain", cosim.Step(time=0.5, before=1.0, after=2.0))), 1)
    np.testing.assert_allclose(run["b.level"][-1], 1.5 * mix @ [1, 0, 3], rtol=1e-12)
    assert run["b.seen"][-1].tolist() == [-5.0, 7.0]
    assert run["b.steps"].tolist() == list(range(11))


ARRAY = '<Float64 name="y" valueReference="5" causality="output"><Dimension valueReference="1"/></Float64>'


@pytest.mark.parametrize(
    ("lie", "words"),
    [
        (-1.0, "has not written 'steps', 'flag_out', 'mode_out' of 'b': its binary and its model description"),
        (-2.0, "writes beyond the memory that it is given for 'count_out' of 'b'"),
    ],
)
def test_whole_numbers_that_are_not_written_are_no_zeros(breadth, lie, words):
    with pytest.raises(FMUError, match=re.escape(words)):
        alone(FMU(breadth("2"), parameters={"lie": lie}), 0.1).simulate(0.1, engine="interpreted")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion valueReference="77"'),
            "a variable 77, which it does not define",
        ),
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion valueReference="6"'),
            "'y' .* as large as 'k', which is 1.0",
        ),
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion start="-5"'),
            "'y' .* is as large as -5: that is no size",
        ),
        (ARRAY, ARRAY.replace('sion valueReference="1"', 'sion start="99999999999"'), "more than 10,000,000 numbers"),
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion start="5"'),
            "fmi3GetFloat64 of 'y' and 'total' returned Error",
        ),
        ('start="1 0 0 1"', 'start="1 0 0"', r"'K' .* start value '1 0 0', which is no Float64 of shape \(2, 2\)"),
        ('start="1 0 0 1"', 'start="1 a 0 1"', "start value '1 a 0 1', which is no Float64"),
        ('<Int8 name="byte"', '<UInt16 name="byte"', "fmi3SetUInt16 of 'byte' returned Error"),
        ('factor="1.8"', 'factor="0"', "what 'Rankine' means is not known"),
    ],
)
def test_descriptions_of_arrays_that_lie_end_in_a_sentence(breadth, tmp_path, old, new, words):
    text = DESCRIPTION["3"].replace("FLAGS", "")
    assert old in text
    with zipfile.ZipFile(breadth("3")) as source, zipfile.ZipFile(tmp_path / "lie.fmu", "w") as target:
        for name in source.namelist():
            content = text.replace(old, new).encode() if name == "modelDescription.xml" else source.read(name)
            target.writestr(name, content)

    values = {"x0": ([1, 2], "Rankine")} if "factor" in new else {}
    with pytest.raises((FMUError, SimulationError), match=words):
        alone(FMU(tmp_path / "lie.fmu", parameters=values, validate=False), 0.1).simulate(0.1, engine="interpreted")


# --- types -------------------------------------------------------------------------------------------------------------------

PAIRS = {
    "3": {"byte": -128.0, "wide": 2.0**51, "flag": 1.0, "mode": 2.0, "single": 0.1, "word": 65535.0},
    "2": {"count": -(2.0**31), "flag": 1.0, "mode": 2.0},
}
OUT = {"wide": "twice"}


@pytest.mark.parametrize("major", "23")
def test_values_of_every_type_go_in_and_out_exactly(breadth, run_both, major):
    sources = [(name, cosim.Constant(value)) for name, value in PAIRS[major].items()]
    for timing in ("plant", "sampled"):
        run = run_both(alone(FMU(breadth(major), timing=timing), 0.1, *sources), 0.5)
        for name, value in PAIRS[major].items():
            out = run["b." + OUT.get(name, f"{name}_out")]
            wanted = {"single": np.float32(0.1), "wide": 2.0**52}.get(name, value)
            assert out[-1] == wanted
        if major == "2":
            assert run["b.steps"].tolist() == [k + (timing == "sampled") for k in range(6)]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("major", "name", "value", "words"),
    [
        ("3", "byte", 128.0, "'byte' is Int8 and must be a whole number from -128 to 127"),
        ("3", "byte", 0.5, "whole number from -128"),
        ("3", "word", -1.0, "'word' is UInt16 and must be a whole number from 0 to 65535"),
        ("3", "flag", 2.0, "'flag' is Boolean and must be a whole number from 0 to 1"),
        ("3", "mode", 3.0, "'mode' is Enumeration and must be a whole number from 1 to 2"),
        ("3", "single", 1e39, "'single' is Float32 and must be a number up to 3.40282e+38"),
        ("3", "wide", 2.0**52, "The output 'twice' is a whole number that a double cannot hold exactly"),
        ("3", "wide", float("inf"), "'wide' is Int64"),
        ("2", "count", float("nan"), "'count' is Integer and must be a whole number from -2147483648 to 2147483647"),
        ("2", "flag", 0.1, "'flag' is Boolean"),
    ],
)
def test_values_that_do_not_fit_stop_the_run(breadth, make_block, engine, major, name, value, words):
    def write(y, t, value):
        y[0] = ops.select(t < 0.25, 1.0, value[0])

    source = make_block(outputs=[cosim.Port("y")], parameters={"value": value}, output=write)
    diagram = alone(FMU(breadth(major)), 0.1, (name, source))
    with pytest.raises(SimulationError, match=re.escape(words)) as caught:
        diagram.simulate(1, engine=engine)
    assert "at t = 0.3 s (step 3)" in str(caught.value) or name == "wide"
    assert len(caught.value.result.time) == 4


def test_parameters_of_every_type(breadth):
    block = FMU(breadth("3"), parameters={"label": "four", "mode": "on", "flag": True, "byte": -5})
    assert block.parameters == {"label": "four", "mode": 2, "flag": True, "byte": -5}
    run = alone(block, 0.1).simulate(0.1)
    assert [run[f"b.{name}"][-1] for name in ("length", "mode_out", "flag_out", "byte_out")] == [4.0, 2.0, 1.0, -5.0]
    assert FMU(breadth("3"), parameters={"mode": 2}).parameters == {"mode": 2}
    for mode in ("onn", 3, 1.5, True):
        with pytest.raises(FMUError, match=r"'mode' of the FMU .* must be one of 'off' \(1\), 'on' \(2\), not"):
            FMU(breadth("3"), parameters={"mode": mode})


# --- units -------------------------------------------------------------------------------------------------------------------


def test_values_with_units_become_the_variables_own(breadth):
    block = FMU(breadth("3"), parameters={"K": ([[90, 0], [0, 180]], "deg/s"), "x0": ([0, 100], "degC")})
    np.testing.assert_allclose(block.parameters["K"], [[100, 0], [0, 200]], rtol=1e-14)  # gradians: the FMU's own unit
    np.testing.assert_allclose(block.parameters["x0"], [273.15, 373.15], rtol=1e-15)
    np.testing.assert_allclose(FMU(breadth("3"), parameters={"x0": ([9, 18], "Rankine")}).parameters["x0"], [5, 10])
    car = FMU(cosim_path(), parameters={"m": "0.1 t", "v0": "3.6 km/h", "b": (5, "kg/s")})
    assert car.parameters == {"m": pytest.approx(100.0), "v0": pytest.approx(1.0), "b": 5.0}
    for values, words in (
        (
            {"m": "100 s"},
            "'m' of the FMU CruiseControl.fmu is in kg, and '100.0 s' cannot be brought to that: their dimensions",
        ),
        ({"m": (1, "blorps")}, "what 'blorps' means is not known"),
        ({"m": "kg 100"}, "must be a finite number, not 'kg 100'"),
    ):
        with pytest.raises(FMUError, match=re.escape(words)):
            FMU(cosim_path(), parameters=values)
    with pytest.raises(FMUError, match=r"'k' of the FMU 3.fmu has no unit, and '2.0 m' has one; give a plain number"):
        FMU(breadth("3"), parameters={"k": "2 m"})


def test_an_fmus_own_units_count_in_connections(breadth):
    grads = FMU(breadth("3"), inputs=[], outputs=[], tunable=[]).description.units["Grad/s"]
    assert grads.unit.powers == {"radian": 1, "second": -1}  # to pint, this would be a giga-radian

    class Wheel(cosim.Block):
        outputs = (cosim.Port("y", unit="Grad/s", meaning=grads.unit),)

        def define(self, step):
            return cosim.Definition(output=lambda y: None)

    diagram = cosim.Diagram(0.1)
    gain = diagram.add(cosim.Gain(1.0, input_unit="deg/s"))
    with pytest.raises(cosim.ConnectionError, match=r"in Grad/s, but .* in deg/s; put Gain\(0\.9\) between them"):
        diagram.connect(diagram.add(Wheel())["y"], gain["u"])


def cosim_path():
    from bayesftc import fmus

    return fmus.path("CruiseControl")


# --- tunable parameters ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("major", "flags"), [("2", ""), ("3", ""), ("3", EVENTS)])
def test_tunable_parameters_are_inputs(breadth, run_both, major, flags):
    out, one = {"2": ("x", 1.0), "3": ("y", [1.0, 0.0])}[major]
    block = FMU(breadth(major, flags), tunable=["k"], parameters={"k": 2.0, "u": one}, inputs=["u"], outputs=[out])
    assert [p.name for p in block.inputs] == ["u", "k"]
    assert block.port("k").default == 2.0
    assert dataclasses.replace(block, name="other").inputs == block.inputs
    held = run_both(alone(block, 0.125), 1)["b." + out]
    changed = run_both(alone(block, 0.125, ("k", cosim.Step(time=0.5, before=2.0, after=-4.0))), 1)["b." + out]
    t = np.arange(9) / 8
    np.testing.assert_allclose(held.reshape(9, -1)[:, 0], 2 * t, rtol=1e-12)
    np.testing.assert_allclose(changed.reshape(9, -1)[:, 0], np.where(t <= 0.5, 2 * t, 1 - 4 * (t - 0.5)), atol=1e-12)


def test_what_cannot_be_tuned_is_named(breadth):
    for names, words, error in (
        (["K"], "'K' of the FMU 3.fmu is a fixed parameter; only tunable parameters", FMUError),
        (["u"], "is a continuous input; only tunable", FMUError),
        (["kk"], "has no variable 'kk'; tunable parameters: k.", UnknownNameError),
        ("k", "give a list of names, as ['k']", ModelError),
        (["k", "k"], "a name twice", ModelError),
    ):
        with pytest.raises(error, match=re.escape(words)):
            FMU(breadth("3"), tunable=names)


# --- events and early returns --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", ["1/8", "1/3", "3/4"])
def test_events_are_handled_and_steps_go_on_to_their_end(breadth, run_both, dt):
    import fmpy

    runs, given = {}, {"u": [1.0, 2.0]}
    for flags in ("", 'mightReturnEarlyFromDoStep="true"', EVENTS):
        block = FMU(breadth("3", flags), parameters=given, inputs=["u", "next"], outputs=["y", "count"])
        runs[flags] = run_both(alone(block, dt, ("next", cosim.Step(time=0.75, before=1.0, after=3.0))), 3)
    plain, early, events = runs.values()
    for run in (early, events):
        np.testing.assert_allclose(run["b.y"], plain["b.y"], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(run["b.count"], plain["b.count"])
    assert plain["b.count"].tolist() == np.floor(plain.time / 0.25 + 1e-9).tolist()
    theirs = fmpy.simulate_fmu(
        str(breadth("3", EVENTS)), stop_time=3.0, output_interval=float(events.step), start_values={"u": "1.0 2.0", "next": 1},
        output=["y", "count"], use_event_mode=True, early_return_allowed=True, input=None,
    )  # fmt: skip
    held = run_both(alone(FMU(breadth("3", EVENTS), parameters=given, **REALS3), dt), 3)
    for k, t in enumerate(held.time):  # at an event fmpy has two rows: the later one counts
        rows = np.flatnonzero(np.abs(theirs["time"] - t) < 1e-9)
        np.testing.assert_allclose(theirs["y"][rows[-1]], held["b.y"][k], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_restored_state_gets_its_discrete_inputs_anew(breadth, engine):
    flags = f'{EVENTS} canGetAndSetFMUState="true"'
    block = FMU(breadth("3", flags), parameters={"u": [1.0, 2.0]}, inputs=["u", "next"], outputs=["y", "count"])
    diagram = alone(block, "1/8", ("next", cosim.Step(time=0.5, before=1.0, after=3.0)))
    with diagram.start(engine=engine) as session:
        session.advance(0.25)
        before = session.save_state()
        first = session.advance(1)
        session.restore(before)
        again = session.advance(1)
    np.testing.assert_array_equal(first["b.y"], again["b.y"])
    assert first["b.y"][-1, 0] > 2.0  # the changed input has told


def test_in_a_process_of_its_own_it_gives_the_same_bits(breadth, same_bits):
    runs = []
    for isolate in (False, True):
        block = FMU(
            breadth("3", EVENTS), parameters={"n": 3, "u": [1, 2, 3], "mode": "on"}, tunable=["k"], isolate=isolate
        )
        runs.append(
            alone(block, "1/3", ("k", cosim.Step(time=1, before=1.0, after=2.0))).simulate(3, engine="interpreted")
        )
    for name in runs[0]:
        same_bits(runs[0][name], runs[1][name], name)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("stall", "words"),
    [
        (0.4, "comes no further; a smaller step may do"),
        (0.6, "did not come to the end of the step, or of an event, in 10000"),
    ],
)
def test_steps_that_come_nowhere_end_in_a_sentence(breadth, engine, stall, words):
    diagram = alone(FMU(breadth("3", EVENTS), parameters={"stall": stall}, **REALS3), 0.1)
    with pytest.raises(SimulationError, match=words) as caught:
        diagram.simulate(1, engine=engine)
    assert len(caught.value.result.time) == round(stall / 0.1) + 1


# --- discarded steps -----------------------------------------------------------------------------------------------------------


def ramp(path, **parameters):
    block = FMU(path, parameters=parameters, outputs=["x", "steps"], inputs=["u"])
    return alone(block, "1/8", ("u", cosim.Constant(1.0)))


@pytest.mark.parametrize("reach", [0.0, 0.5, 0.9])
def test_discarded_steps_go_on_in_parts(breadth, run_both, reach):
    run = run_both(ramp(breadth("2", VARIABLE), most=1 / 100, reach=reach), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)
    assert run["b.steps"][-1] >= 8 * 3
    assert run_both(ramp(breadth("2", VARIABLE), most=1 / 8), 1)["b.steps"][-1] == 8
    held = alone(FMU(breadth("2"), parameters={"u": 3.0}, inputs=[], outputs=["x"]), "1/8")  # an input that is no port
    np.testing.assert_allclose(held.simulate(1, engine="interpreted")["b.x"][-1], 3.0, rtol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_discarded_steps_that_cannot_go_on_end_in_a_sentence(breadth, engine):
    for path, parameters, words in (
        (
            breadth("2"),
            {"most": 0.01},
            "fmi2DoStep returned Discard. It could compute the step up to t = 0 s; a smaller step",
        ),
        (
            breadth("2", VARIABLE),
            {"most": 1e-9},
            "fmi2DoStep returned Discard. It could compute the step up to t = 0 s",
        ),
        (breadth("2", VARIABLE), {"most": 0.01, "lie": -3.0}, "fmi2DoStep returned Discard."),
        (breadth("2", VARIABLE), {"most": 0.01, "lie": float("1e300")}, "fmi2DoStep returned Discard."),
        (breadth("2", VARIABLE), {"end": 0.3}, "It asks to end the simulation."),
    ):
        with pytest.raises(SimulationError, match=re.escape(words)):
            ramp(path, **parameters).simulate(1, engine=engine)


# --- what an FMU cannot do -----------------------------------------------------------------------------------------------------


def test_steps_that_an_fmu_cannot_make_are_refused(breadth):
    fixed = FMU(breadth("3", 'fixedInternalStepSize="0.02"'), **REALS3)
    for dt in (0.02, 0.1, "1/50"):
        alone(fixed, dt).simulate(1)
    for dt in (0.01, 0.03, "1/30"):
        with pytest.raises(
            StepSizeError, match=r"steps of 0.02 s only .*, but 'b' is to make steps of .* multiple of 0.02 s"
        ):
            alone(fixed, dt).simulate(1)
    for size in ("x", "NaN", "INF", "-1"):  # what is no size binds nobody
        alone(FMU(breadth("3", f'fixedInternalStepSize="{size}"'), validate=False, **REALS3), 0.1).simulate(1)


# --- controllers of arrays ---------------------------------------------------------------------------------------------------

MIX = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, -0.5], [0.5, 0.0, 2.0]])


def mixer(breadth, **start):
    return FMU(breadth("3"), parameters={"n": 3, "K": MIX, "x0": [0.0, 0.0, 0.0], **start})


def test_a_model_of_elements_of_arrays(breadth):
    plant = mixer(breadth)
    whole = controllers.LinearModel.from_fmu(plant, measured="y", actuated="u", dt=0.1)
    np.testing.assert_allclose(whole.matrix("C") @ whole.matrix("B"), 0.1 * MIX, atol=1e-9)
    some = controllers.LinearModel.from_fmu(plant, measured=["y[2]", "total"], actuated=["u[2]", "u[0]"], dt=0.1)
    expected = 0.1 * np.array([MIX[2], MIX.sum(axis=0)])[:, [2, 0]]
    np.testing.assert_allclose(some.matrix("C") @ some.matrix("B"), expected, atol=1e-9)
    assert some.states == 2  # what moves the other elements alone is not in it
    # Inputs that are not actuated are held where they are said to be; of a vector by one number, or by one for each element.
    for at in ({"u": [0.0, 0.0, 0.0]}, {"u": 0.0}, {"u[1]": 0.0}):
        found = controllers.LinearModel.from_fmu(plant, measured="y", actuated="u[0]", dt=0.1, at=at, noise={"u": 0.1})
        C, Q = found.matrix("C"), found.matrix("process_covariance")
        np.testing.assert_allclose(C @ Q @ C.T, 1e-4 * MIX @ MIX.T, atol=1e-9)
    for settings, words, error in (
        ({"measured": "y[3]"}, r"no output 'y\[3\]'; did you mean 'y\[\d\]'", UnknownNameError),
        ({"measured": "total[0]"}, r"no output 'total\[0\]'; did you mean 'total'", UnknownNameError),
        ({"measured": "z[0]"}, "has no output 'z'", UnknownNameError),
        ({"measured": ["y", "y[1]"]}, r"'y\[1\]' names an element a second time", ModelError),
        ({"actuated": ["u[1]", "u"]}, "'u' names an element a second time", ModelError),
        ({"at": {"u": [0.0, 0.0]}}, "The operating point of u has the shape", ModelError),
        ({"noise": {"u[1]": -1.0}}, r"The noise has u\[1\]=-1", ModelError),
    ):
        with pytest.raises(error, match=words):
            controllers.LinearModel.from_fmu(plant, **{"measured": "y", "actuated": "u", "dt": 0.1} | settings)


@pytest.mark.parametrize("names", [("y", "u"), (["y[0]", "y[1]", "y[2]"], ["u[0]", "u[1]", "u[2]"])])
def test_a_designed_controller_keeps_a_goal_while_a_sensor_of_an_element_fails(breadth, names):
    """Three coupled tanks in one array, each with two sensors; one sensor of the second is offset."""
    plant, (measured, actuated) = mixer(breadth), names
    goals = [1.0, -0.5, 2.0]
    errors = {}
    for precision in (None, controllers.FixedPrecision()):
        controller = controllers.design(
            plant, measured=measured, actuated=actuated, dt=0.05, sensors=6, precision=precision, u_min=-5.0, u_max=5.0
        )
        loop = cosim.closed_loop(
            plant, controller, control=actuated, measured=measured, sensors=cosim.Sensors(count=6, std=0.01),
            faults=[cosim.Injection(sensor=1, start=2.0, magnitude=0.5)], reference=goals,
        )  # fmt: skip
        result = loop.simulate(5.0, seed=1, engine="interpreted")
        errors[precision] = np.sqrt(np.mean((result["plant.y"][60:] - goals) ** 2, axis=0))
        if precision is None:
            assert result["controller.fault_probability"][60:, 1].min() > 0.9
            assert result["controller.fault_probability"][60:, [0, 2, 3, 4, 5]].max() < 0.1
    assert errors[None].max() < 0.02
    assert errors[controllers.FixedPrecision()][1] > 0.1


def test_a_goal_on_one_element_with_one_element_driven(breadth):
    plant = mixer(breadth)
    controller = controllers.design(
        plant, measured=["y[0]", "y[2]"], actuated="u[2]", goal="y[2]", dt=0.05, sensors=4, noise={"u[2]": 0.1}
    )
    assert controller.goal_matrix.shape == (1, controller.model.states)
    loop = cosim.closed_loop(
        plant, controller, control="u[2]", measured=["y[0]", "y[2]"], sensors=cosim.Sensors(count=4, std=0.01),
        input_faults={"u[2]": cosim.GainFault(factor=0.5, start=2.0), "u[1]": cosim.Freeze(start=1.0)},
        noise={"u[0]": cosim.Constant(0.0)}, reference=1.0,
    )  # fmt: skip
    assert [node.name for node in loop.nodes if "u_" in node.name] == [
        "u_2_gain_fault_0", "u_0_noise", "u_1_start", "u_1_freeze_0"
    ]  # fmt: skip
    result = loop.simulate(4.0, seed=1, engine="interpreted")
    assert np.abs(result["plant.y"][60:, 2] - 1.0).max() < 0.1
    assert [q.name for q in loop_signals(loop, result).quantities] == ["y[0]", "y[2]"]


def test_ports_of_arrays_are_named_by_element(breadth):
    diagram = cosim.Diagram(dt=0.1)
    node = diagram.add(mixer(breadth), "plant")
    assert node["y[2]"] == node["y"][2]
    assert node["y[2]"].name == "plant.y[2]"
    with pytest.raises(UnknownNameError, match=r"has no port 'y\[3\]'"):
        node["y[3]"]


def test_goals_of_an_identified_model_by_array_or_element(breadth):
    diagram = cosim.Diagram(dt=0.1)
    plant = diagram.add(mixer(breadth), "plant")
    moves = [diagram.add(cosim.Gaussian(std=1.0), f"move_{i}") for i in range(3)]
    sensors = diagram.add(cosim.Sensors(count=3, signals=3, std=0.01), "sensors")
    diagram.connect([move["y"] for move in moves], plant["u"])
    diagram.connect(plant["y"], sensors["u"])
    found = controllers.LinearModel.identify(
        diagram.simulate(100.0, seed=1, record=["plant.u", "sensors.y"], engine="interpreted"),
        inputs=["plant.u"], outputs=["sensors.y[0]", "sensors.y[2]"], order=2,
    )  # fmt: skip
    assert found.inputs == ("plant.u[0]", "plant.u[1]", "plant.u[2]")
    controller = controllers.design(found, goal="sensors.y")
    np.testing.assert_array_equal(controller.goal_matrix, controllers.design(found, goal=[0, 1]).goal_matrix)
    with pytest.raises(UnknownNameError, match=r"no output 'sensors\.y\[1\]'"):
        controllers.design(found, goal="sensors.y[1]")


def test_a_scenario_measures_and_drives_arrays(breadth, tmp_path):
    matrices = f"A = [[1, 0], [0, 1]]\nB = [[0.1, 0], [0, 0.1]]\nC = {np.tile(np.eye(2), (2, 1)).tolist()}"
    (tmp_path / "arrays.toml").write_text(
        f"""
[simulation]
duration = 3.0
[plant]
fmu = "{breadth("3")}"
control = "u"
measured = ["y", "total"]
[sensors]
count = 4
matrix = [[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]]
std = 0.01
[[reference]]
kind = "Constant"
value = 1.0
[[reference]]
kind = "Constant"
value = -1.0
[model]
{matrices}
process_covariance = 1e-4
sensor_covariance = 1e-4
dt = 0.1
[controller]
kind = "BayesianController"
goal_on = [[1, 0], [0, 1]]
control_covariance = 100.0
"""
    )
    y = load_scenario(tmp_path / "arrays.toml").simulate(engine="interpreted")["plant.y"]
    np.testing.assert_allclose(y[-1], [1.0, -1.0], atol=0.05)


# --- arrays in SSPs ------------------------------------------------------------------------------------------------------------


def of_arrays(breadth, **start):
    ports = {"inputs": ["u", "single", "flag"], "outputs": ["y", "total", "flag_out"]}
    return dataclasses.replace(mixer(breadth, **start), **ports)


def two_mixers(breadth, **second):
    diagram = cosim.Diagram(dt="1/16")
    first = diagram.add(of_arrays(breadth, u=[1.0, 2.0, 3.0], k=0.5), "first")
    last = diagram.add(of_arrays(breadth, flag=True, **second), "last")
    diagram.connect(first["y"], last["u"])
    return diagram


def rewritten(path, target, *changes):
    """Copy an SSP, with changes of its text."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as new:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith(".ssd"):
                for old, text in changes:
                    assert old.encode() in content
                    content = content.replace(old.encode(), text.encode(), 1)
            new.writestr(name, content)
    return target


def test_arrays_go_into_an_ssp_and_come_back(breadth, tmp_path, monkeypatch, same_bits):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = cosim.save_ssp(two_mixers(breadth), tmp_path / "arrays.ssp")
    text = zipfile.ZipFile(path).read("SystemStructure.ssd").decode()
    assert 'version="2.0"' in text
    assert 'version="1.0"' not in text.partition("?>")[2]
    ours = two_mixers(breadth).build("jacobi").simulate(1, engine="interpreted")
    for again in (path, rewritten(path, tmp_path / "types.ssp", ("<ssv:Real value=", "<ssv:Float64 value="))):
        run = cosim.open_ssp(again).build("jacobi").simulate(1, engine="interpreted")
        for name in ("first.y", "last.y", "last.flag_out"):
            same_bits(run[name], ours[name], name)
    assert np.abs(ours["last.y"][-1]).min() > 0.1
    open_size = rewritten(
        path, tmp_path / "open.ssp", ('<ssc:Dimension size="3" />', '<ssc:Dimension sizeConnector="n" />')
    )
    cosim.open_ssp(open_size)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('Dimension size="3"', 'Dimension size="2"', "declares first.u as an array of 2, but in .* its shape is (3,)"),
        ('Dimension size="3" />', 'Dimension size="3"/><ssc:Dimension/>', "declares first.u as an array of 3 x ?, but in"),
        ('Dimension size="3"', 'Dimension size="-3"', "has a Dimension of size '-3', which is no size"),
        ('Dimension size="3"', 'Dimension size="three"', "has a Dimension of size 'three', which is no size"),
        ('value="1.0 2.0 3.0"', 'value="1.0 2.0"', "gives 'u' the value '1.0 2.0', which is no Real array of shape (3,)"),
        ('value="1.0 2.0 3.0"', 'value="1.0 x 3.0"', "gives 'u' the value '1.0 x 3.0', which is no Real array"),
        ('endConnector="u"', 'endConnector="u" endIndices="1"', "has indices in the connection from first.y to last.u: SSP"),
        ('startConnector="y"', 'startConnector="total"', "connects first.total, of shape (), to last.u, of shape (3,)"),
        ('version="2.0" name="initialValues"', 'name="initialValues"', None),
    ],
)  # fmt: skip
def test_what_an_ssp_says_wrongly_of_arrays(breadth, tmp_path, monkeypatch, old, new, words):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = cosim.save_ssp(two_mixers(breadth), tmp_path / "arrays.ssp")
    wrong = rewritten(path, tmp_path / "wrong.ssp", (old, new))
    if words is None:
        cosim.open_ssp(wrong)
        return
    with pytest.raises(SSPError, match=re.escape(words).replace(r"\.\*", ".*")):
        cosim.open_ssp(wrong)


def test_elements_of_arrays_are_not_saved(breadth, tmp_path):
    element, crossed, constant = cosim.Diagram(dt=0.1), cosim.Diagram(dt=0.1), cosim.Diagram(dt=0.1)
    for diagram in (element, crossed, constant):
        diagram.add(of_arrays(breadth), "a")
        diagram.add(of_arrays(breadth), "b")
    element.connect(element["a"]["y[1]"], element["b"]["single"])
    crossed.connect([crossed["a"]["y"][2], crossed["a"]["y"][:2]], crossed["b"]["u"])
    constant.connect(constant.add(cosim.Constant(1.0), "one")["y"], constant["b"]["u[0]"])
    for diagram, words in (
        (element, "b.single is fed by an element of a.y"),
        (crossed, "b.u is an array, and only an array of an FMU with the same shape"),
        (constant, "b.u is an array, and only an array of an FMU with the same shape"),
    ):
        with pytest.raises(SSPError, match=words):
            cosim.save_ssp(diagram, tmp_path / "x.ssp")
