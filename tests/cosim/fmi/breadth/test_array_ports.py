"""Arrays of FMI 3 as vector and matrix ports, and outputs that are not what the description says; fmpy is the oracle."""

import dataclasses
import pickle
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import FMUError, SimulationError, UnknownNameError
from bayesftc.cosim.fmi.fmu import FMU

REALS3 = {"inputs": ["u"], "outputs": ["y", "total"]}


def test_an_element_of_an_array_parameter_may_be_given_alone(breadth):
    whole = FMU(breadth("3"), parameters={"n": 3, "x0": [1.0, 2.0, 3.0]}).parameters
    assert FMU(breadth("3"), parameters={"n": 3, "x0": [1, 0, 3], "x0[1]": 2}).parameters == whole
    assert FMU(breadth("3"), parameters={"K[0,1]": 7.0}).parameters["K"] == ((1.0, 7.0), (0.0, 1.0))
    with pytest.raises(
        FMUError, match=r"'K\[0,1\]', but the other elements of 'K' are not known. Give the whole array 'K'"
    ):
        FMU(breadth("3"), parameters={"n": 3, "K[0,1]": 7.0})
    with pytest.raises(
        UnknownNameError, match=r"has no variable 'K\[2,0\]': 'K' is an array of shape \(2, 2\); did you mean"
    ):
        FMU(breadth("3"), parameters={"K[2,0]": 1.0})


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
        ({"n": 3, "x0": [1, 2]}, "'x0' of the FMU 3.fmu is an array of shape (3,), but is given as"),
        ({"K": [[1, 2], [3]]}, "shape (2, 2), but is given as [[1, 2], [3]]. Give it row by row"),
        ({"K": [[1, 2], [3, "four"]]}, "must be a finite number, not 'four'"),
        ({"n": 10_000}, "would have the shape (10000, 10000): more than 10,000,000 numbers"),
        ({"n": -1}, "must be a whole number from 0 to"),
    ):
        with pytest.raises(FMUError, match=re.escape(words)):
            FMU(breadth("3"), parameters=values)
    with pytest.raises(FMUError, match=r"'y' of the FMU 3.fmu is an array of shape \(0,\), which is empty"):
        FMU(breadth("3"), parameters={"n": 0}, outputs=["y"])


START = 'name="u" valueReference="2" causality="input" start="0"'


def rewritten(path, target, before, after):
    """Copy an FMU with other words in its model description."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(before.encode(), after.encode()))
    return target


@pytest.mark.sampled(1)
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(
    ("own", "rtol", "told"), [("", None, -1.0), ("", 1e-3, 1e-3), ("1e-5", None, 1e-5), ("1e-5", 0.5, 0.5)]
)
def test_a_co_simulation_is_told_the_tolerance(breadth, run_both, tmp_path, own, rtol, told, isolate):
    path = rewritten(breadth("3"), tmp_path / "Some.fmu", START, START.replace('"0"', '"1 2"'))
    experiment = f'<DefaultExperiment tolerance="{own}"/>' if own else ""
    path = rewritten(path, tmp_path / "Told.fmu", "<ModelVariables>", f"{experiment}<ModelVariables>")
    diagram = cosim.Diagram(dt="1/64")
    block = FMU(path, parameters={"n": 3}, isolate=isolate, rtol=rtol, **REALS3)
    assert block.rtol == (None if told < 0 else told)
    diagram.add(block, "told")
    np.testing.assert_allclose(run_both(diagram, 1)["told.y"][-1], told, rtol=1e-13)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("n", [2, 3])
def test_an_input_that_nothing_feeds_keeps_its_start_value(breadth, run_both, tmp_path, n, isolate):
    """Of another size the description has none, and the FMU's own counts; but for what parameters say."""
    path = rewritten(breadth("3"), tmp_path / "Moved.fmu", START, START.replace('"0"', '"1 2"'))
    for given, u in (({}, [1.0, 2.0, 3.0][:n]), ({"u": [4.0, 5.0, 6.0][:n]}, [4.0, 5.0, 6.0][:n])):
        diagram = cosim.Diagram(dt="1/64")
        diagram.add(FMU(path, parameters={"n": n, **given}, isolate=isolate, **REALS3), "moved")
        run = run_both(diagram, 1)
        np.testing.assert_allclose(run["moved.y"], np.outer(run.time, u), rtol=1e-13)


@pytest.mark.parametrize("n", [2, 3])
def test_an_array_fmu_gives_the_numbers_of_fmpy_in_both_engines(breadth, alone, run_both, n):
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


def test_arrays_of_another_exporter(alone, tmp_path, run_both):
    builder = pytest.importorskip("pythonfmu3").FmuBuilder
    path = builder.build_FMU(str(Path(__file__).with_name("vessel.py")), dest=str(tmp_path))
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
        (-2.0, "writes beyond the memory for 'count_out' of 'b'"),
    ],
)
def test_whole_numbers_that_are_not_written_are_no_zeros(breadth, alone, lie, words):
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
            "'y' .* invalid size: 'k', which is 1.0",
        ),
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion start="-5"'),
            "'y' .* has the negative size -5",
        ),
        (ARRAY, ARRAY.replace('sion valueReference="1"', 'sion start="99999999999"'), "more than 10,000,000 numbers"),
        (
            ARRAY,
            ARRAY.replace('sion valueReference="1"', 'sion start="5"'),
            "fmi3GetFloat64 of 'y' and 'total' returned Error",
        ),
        (
            'start="1 0 0 1"',
            'start="1 0 0"',
            r"'K' .* start value '1 0 0', which is no valid Float64 of shape \(2, 2\)",
        ),
        ('start="1 0 0 1"', 'start="1 a 0 1"', "start value '1 a 0 1', which is no valid Float64"),
        ('<Int8 name="byte"', '<UInt16 name="byte"', "fmi3SetUInt16 of 'byte' returned Error"),
        ('factor="1.8"', 'factor="0"', "the unit 'Rankine' is not known"),
    ],
)
def test_descriptions_of_arrays_that_lie_end_in_a_sentence(breadth, alone, tmp_path, old, new, words):
    with zipfile.ZipFile(breadth("3")) as source, zipfile.ZipFile(tmp_path / "lie.fmu", "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                assert old.encode() in content
                content = content.replace(old.encode(), new.encode())
            target.writestr(name, content)

    values = {"x0": ([1, 2], "Rankine")} if "factor" in new else {}
    with pytest.raises((FMUError, SimulationError), match=words):
        alone(FMU(tmp_path / "lie.fmu", parameters=values, validate=False), 0.1).simulate(0.1, engine="interpreted")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("isolate", [False, True])
def test_campaigns_of_arrays(mixer, breadth, isolate, campaign_as_alone):
    diagram = cosim.Diagram(0.1)
    plant = diagram.add(dataclasses.replace(mixer(), isolate=isolate), "plant")
    noise = [diagram.add(cosim.Gaussian(std=1.0), f"n{i}") for i in range(3)]
    diagram.connect([n["y"] for n in noise], plant["u"])
    points = {
        "plant.k": [1.0, 2.0],
        "plant.K": {"unit": np.eye(3), "mixed": np.ones((3, 3))},
        "plant.x0[1]": [0.0, 1.0],
    }
    seeds = (3,) if isolate else (3, 1, 4, 159)  # a process for each run
    assert (campaign_as_alone(diagram, 1.0, seeds, points=points)["status"] == "ok").all()
    points = {"plant.n": [3], "plant.K": {"three": np.eye(3)}, "plant.x0": {"three": [1.0, 2.0, 3.0]}}
    two = cosim.Diagram(0.1)
    two.add(FMU(breadth("3"), inputs=[], outputs=["total"]), "plant")
    assert (campaign_as_alone(two, 1.0, points=points)["status"] == "ok").all()
