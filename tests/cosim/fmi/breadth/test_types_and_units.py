"""FMUs with ports and parameters of every type, and with units."""

import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim import ops
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError
from bayesftc.cosim.fmi.fmu import FMU

ENGINES = ("compiled", "interpreted")


# --- types ----------------------------------------------------------------------------------------------------------------------

PAIRS = {
    "3": {"byte": -128.0, "wide": 2.0**51, "flag": 1.0, "mode": 2.0, "single": 0.1, "word": 65535.0},
    "2": {"count": -(2.0**31), "flag": 1.0, "mode": 2.0},
}
OUT = {"wide": "twice"}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("major", "23")
def test_values_of_every_type_go_in_and_out_exactly(breadth, alone, run_both, major):
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
        ("3", "wide", 2.0**52, "The output 'twice' is connected, but its value is a whole number of 2**53 or more"),
        ("3", "wide", float("inf"), "'wide' is Int64"),
        ("2", "count", float("nan"), "'count' is Integer and must be a whole number from -2147483648 to 2147483647"),
        ("2", "flag", 0.1, "'flag' is Boolean"),
    ],
)
def test_values_that_do_not_fit_stop_the_run(breadth, alone, make_block, engine, major, name, value, words):
    def write(y, t, value):
        y[0] = ops.select(t < 0.25, 1.0, value[0])

    source = make_block(outputs=[cosim.Port("y")], parameters={"value": value}, output=write)
    diagram = alone(FMU(breadth(major)), 0.1, (name, source))
    if name == "wide":  # else it is rounded
        diagram.connect(diagram["b"]["twice"], diagram.add(cosim.Gain(1.0), "needs")["u"])
    with pytest.raises(SimulationError, match=re.escape(words)) as caught:
        diagram.simulate(1, engine=engine)
    assert "at t = 0.3 s (step 3)" in str(caught.value) or name == "wide"
    assert len(caught.value.result.time) == 4


@pytest.mark.sampled(2)
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("isolate", [False, True])
def test_a_whole_number_that_no_double_holds_ends_no_run_that_does_not_need_it(breadth, alone, engine, isolate):
    diagram = alone(
        FMU(breadth("3"), isolate=isolate), 0.1, ("wide", cosim.Step(time=0.2, before=5.0, after=2.0**60 + 2.0**9))
    )
    with pytest.warns(UserWarning, match=r"^'twice' of 'b' reached whole numbers of 2.*the nearest doubles"):
        run = diagram.simulate(0.5, engine=engine)
    np.testing.assert_array_equal(run["b.twice"], [0.0, 10.0, 10.0, *[2.0**61 + 2.0**10] * 3])
    np.testing.assert_array_equal(run["b.byte_out"], 0.0)


def test_parameters_of_every_type(breadth, alone):
    block = FMU(breadth("3"), parameters={"label": "four", "mode": "on", "flag": True, "byte": -5})
    assert block.parameters == {"label": "four", "mode": 2, "flag": True, "byte": -5}
    run = alone(block, 0.1).simulate(0.1)
    assert [run[f"b.{name}"][-1] for name in ("length", "mode_out", "flag_out", "byte_out")] == [4.0, 2.0, 1.0, -5.0]
    assert FMU(breadth("3"), parameters={"mode": 2}).parameters == {"mode": 2}
    for mode in ("onn", 3, 1.5, True):
        with pytest.raises(FMUError, match=r"'mode' of the FMU .* must be one of 'off' \(1\), 'on' \(2\), not"):
            FMU(breadth("3"), parameters={"mode": mode})


# --- units ----------------------------------------------------------------------------------------------------------------------


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
            "'m' of the FMU CruiseControl.fmu is in kg, and '100.0 s' cannot be converted to that: their dimensions",
        ),
        ({"m": (1, "blorps")}, "the unit 'blorps' is not known"),
        ({"m": "kg 100"}, "must be a finite number, not 'kg 100'"),
    ):
        with pytest.raises(FMUError, match=re.escape(words)):
            FMU(cosim_path(), parameters=values)
    with pytest.raises(FMUError, match=r"'k' of the FMU 3.fmu has no unit, but '2.0 m' has one; give a plain number"):
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


@pytest.fixture
def without_units(tmp_path):
    """A copy of the shipped car whose description has no units, as PythonFMU writes it."""
    path = tmp_path / "Bare.fmu"
    with zipfile.ZipFile(cosim_path()) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = re.sub(rb'(<Real[^>]*?) unit="[^"]*"', rb"\1", content)
            new.writestr(name, content)
    return path


def test_ports_give_an_fmu_without_units_its_units(without_units):
    given = {"inputs": [cosim.Port("force", unit="N"), "disturbance"], "outputs": [cosim.Port("v", unit="m/s")]}
    car = FMU(without_units, **given)
    assert {port.name: port.unit for port in (*car.inputs, *car.outputs)} == {
        "force": "N",
        "disturbance": None,
        "v": "m/s",
    }
    again = replace(car, parameters={"m": 90.0}).watching(["m"])
    assert {port.name: port.unit for port in (*again.inputs, *again.outputs)} == {
        "force": "N", "disturbance": None, "v": "m/s", "m": None,
    }  # fmt: skip
    pushed = replace(car, parameters={"force": "0.2 kN"})
    assert dict(pushed.parameters) == {"force": 200.0} == dict(replace(pushed).parameters)
    with pytest.raises(FMUError, match=r"'force' of the FMU Bare\.fmu is in N, and '2.0 m' cannot be converted"):
        replace(car, parameters={"force": "2 m"})
    loop = cosim.closed_loop(
        car,
        controllers.LQGController(
            controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]], 1e-3, 0.01, dt=0.02), goal_covariance=0.01
        ),
        control="force",
        measured="v",
        reference=cosim.Constant(2.0, unit="m/s"),
    )
    assert loop.simulate(0.04, engine="interpreted").units["sensors.y"] == "m/s"
    sentence = (
        "FMU has the output 'v' in km/h, but CruiseControl.fmu has it in m/s. Leave out the unit here, and convert"
    )
    with pytest.raises(ModelError, match=re.escape(sentence)):
        FMU(cosim_path(), outputs=[cosim.Port("v", unit="km/h")])
    assert FMU(cosim_path(), outputs=[cosim.Port("v", unit="m.s-1")]).outputs[0].unit == "m/s"
