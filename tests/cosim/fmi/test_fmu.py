"""FMUs as blocks: numbers against fmpy and the recursion, both engines against each other, instances, logs."""

import ctypes
import logging
import os
import pickle
import sys
import threading
import zipfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import AlgebraicLoopError, ConnectionError, SimulationError
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.reading import messages as _fmi_messages
from bayesftc.cosim.fmi.running import instance as _fmi_instance
from bayesftc.cosim.ports import Port, listed

FMI = ("2.0", "3.0")
ENGINES = ("compiled", "interpreted")
STEP = Fraction(1, 50)


def car(fmi="2.0", **options):
    return FMU(fmus.path("CruiseControl", fmi=fmi), **options)


def edited(source, target, **changes):
    """Copy an FMU with entries passed through functions of their bytes; ``description`` is the model description."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            change = changes.get("description" if name == "modelDescription.xml" else Path(name).suffix[1:])
            content = old.read(name)
            new.writestr(name, content if change is None else change(content))
    return target


def described(fmi, target, *pairs):
    def change(content):
        for old, new in pairs:
            assert old.encode() in content
            content = content.replace(old.encode(), new.encode())
        return content

    return edited(fmus.path("CruiseControl", fmi=fmi), target, description=change)


def cruise(block, gain=-500.0, dt=0.02):
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(block, name="car")
    controller = diagram.add(cosim.Gain(gain, offset=10_000.0))
    noise = diagram.add(cosim.Gaussian(std=0.03), name="noise")
    diagram.connect(plant["v"], controller["u"])
    diagram.connect(controller["y"], plant["force"])
    diagram.connect(noise["y"], plant["disturbance"])
    return diagram


def recursion(forces, disturbances, b=5.0, m=100.0, v0=0.0, h=0.02):
    v = [v0]
    for force, disturbance in zip(forces, disturbances, strict=True):
        v.append((1 - b / m * h) * v[-1] + h / m * force + disturbance)
    return np.array(v)


def memory_in_use():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("fmi", FMI)
def test_ports_come_from_the_description(fmi):
    block = car(fmi)
    assert [(p.name, p.unit, p.default, p.feedthrough) for p in block.inputs] == [
        ("force", "N", 0.0, False),
        ("disturbance", "m/s", 0.0, False),
    ]
    assert [(p.name, p.unit, p.shape) for p in block.outputs] == [("v", "m/s", ())]
    assert (block.timing, block.default_name, block.checks_finite) == ("plant", "cruisecontrol", True)
    assert FMU(block.path, name="car").default_name == "car"
    diagram = cosim.Diagram(dt=0.02)
    v, force = diagram.add(block, name="car")["v"], diagram.add(block, name="c")["force"]
    with pytest.raises(ConnectionError, match=r"car\.v is in m/s, but c\.force is in N"):
        diagram.connect(v, force)


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("engine", ENGINES)
def test_closed_loop_follows_the_recursion(fmi, engine):
    block = car(fmi, parameters={"m": 120.0, "b": 7, "v0": 3.5})
    run = cruise(block).simulate(10.0, seed=4, engine=engine, record=["car.*", "car.force", "car.disturbance"])
    v = run["car.v"]
    assert np.array_equal(run["car.force"], -500.0 * v + 10_000.0)
    expected = recursion(run["car.force"][:-1], run["car.disturbance"][:-1], b=7.0, m=120.0, v0=3.5)
    assert np.allclose(v, expected, rtol=1e-12)
    assert v[0] == 3.5
    assert np.std(run["car.disturbance"]) == pytest.approx(0.03, rel=0.2)


@pytest.mark.parametrize("timing", ["plant", "sampled"])
def test_engines_and_versions_agree_to_the_last_bit(timing):
    runs = []
    for fmi in FMI:
        for engine in ENGINES:
            diagram = cosim.Diagram(dt="1/30")
            node = diagram.add(car(fmi, timing=timing), name="car")
            sine, noise = diagram.add(cosim.Sine(300.0, 1.7)), diagram.add(cosim.Gaussian(std=0.1))
            diagram.connect(sine["y"], node["force"])
            diagram.connect(noise["y"], node["disturbance"])
            runs.append(diagram.simulate(20, seed=1, engine=engine)["car.v"].tobytes())
    assert len(set(runs)) == 1


@pytest.mark.parametrize("fmi", FMI)
def test_numbers_are_those_of_fmpy(fmi):
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    run = cruise(car(fmi, parameters={"v0": 1.0})).simulate(
        4.0, seed=2, record=["car.*", "car.force", "car.disturbance"]
    )
    path = str(fmus.path("CruiseControl", fmi=fmi))
    model = fmpy.read_model_description(path)
    folder = fmpy.extract(path)
    kind = FMU2Slave if fmi == "2.0" else FMU3Slave
    slave = kind(guid=model.guid, unzipDirectory=str(folder), modelIdentifier="CruiseControl", instanceName="oracle")
    slave.instantiate()
    set_, get = (slave.setReal, slave.getReal) if fmi == "2.0" else (slave.setFloat64, slave.getFloat64)
    if fmi == "2.0":
        slave.setupExperiment(startTime=0.0)
    set_([5], [1.0])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    v = []
    for k in range(200):
        v += get([2])
        set_([0, 1], [run["car.force"][k], run["car.disturbance"][k]])
        slave.doStep(k / 50, 0.02)
    slave.terminate()
    slave.freeInstance()
    assert np.array_equal(run["car.v"][:200], v)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", FMI)
def test_sampled_timing_gives_the_result_of_the_step_at_once(fmi, engine):
    runs = {}
    for timing in ("plant", "sampled"):
        diagram = cosim.Diagram(dt=0.02)
        block = car(fmi, timing=timing)
        assert all(p.feedthrough == (timing == "sampled") for p in block.inputs)
        node, sine = diagram.add(block, name="car"), diagram.add(cosim.Sine(100.0, 3.0, offset=50.0))
        diagram.connect(sine["y"], node["force"])
        runs[timing] = diagram.simulate(2.0, engine=engine)["car.v"]
    assert np.array_equal(runs["sampled"][:-1], runs["plant"][1:])
    with pytest.raises(AlgebraicLoopError, match="feeds it through"):
        cruise(car(fmi, timing="sampled")).build()


def test_timing_is_the_annotation_unless_said_otherwise(tmp_path):
    for fmi in FMI:
        path = described(fmi, tmp_path / f"{fmi}.fmu", ('timing="plant"', 'timing="sampled"'))
        assert FMU(path).timing == "sampled"
        assert FMU(path, timing="plant").timing == "plant"
        silent = described(fmi, tmp_path / f"silent{fmi}.fmu", ('<bayesftc timing="plant" />', ""))
        assert FMU(silent, validate=False).timing == "plant"


@pytest.mark.parametrize("fmi", FMI)
def test_start_values_of_inputs_hold_while_nothing_is_connected(fmi):
    block = car(fmi, parameters={"force": 25.0})
    assert block.port("force").default == 25.0
    for chosen in (
        block,
        car(fmi, parameters={"force": 25.0}, inputs=["disturbance"]),
        car(fmi, parameters={"force": 25.0}, inputs=[]),
    ):
        diagram = cosim.Diagram(dt=0.02)
        diagram.add(chosen, name="car")
        for engine in ENGINES:
            v = diagram.simulate(0.1, engine=engine)["car.v"]
            assert np.allclose(v, recursion([25.0] * 5, [0.0] * 5), rtol=1e-14)


def test_blocks_and_ports_are_shown_in_a_line():
    car = cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 120.0}, isolate=True)
    assert repr(car) == (
        "<FMU CruiseControl.fmu, co-simulation, timing='plant', isolated, parameters={'m': 120.0}: "
        "force [N], disturbance [m/s] -> v [m/s]>"
    )
    assert "timing='sampled': nothing -> v [m/s]" in repr(cosim.FMU(car.path, inputs=[], timing="sampled"))
    node = cosim.Diagram(0.02).add(car, "car")
    assert repr(node["v"]) == "<output car.v in m/s>"
    many = [Port(f"u{i}", (2, 3) if i == 1 else ()) for i in range(12)]
    assert listed(many, 2) == "u0, u1(2x3), 10 more"


def test_no_ports_at_all():
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(car(inputs=(), outputs=()), name="mute")
    diagram.add(cosim.Constant(1.0), name="one")
    for engine in ENGINES:
        assert len(diagram.simulate(1.0, engine=engine).time) == 51


def test_two_instances_at_a_time_and_one_freed():
    first, second = (car().instantiate(STEP, name) for name in ("first", "second"))
    u, y = np.array([100.0, 0.0]), np.zeros(1)
    for k in range(10):
        assert first.update(u, y, k / 50) == 0
    first.close()
    for k in range(10):
        assert second.update(2 * u, y, k / 50) == 0
    assert second.output(u, y, 0.2) == 0
    second.close()
    second.close()
    assert np.allclose(y, recursion([200.0] * 10, [0.0] * 10)[-1], rtol=1e-14)


def test_several_fmus_in_one_diagram_and_slower_rates():
    for engine in ENGINES:
        diagram = cosim.Diagram(dt=0.02)
        force = diagram.add(cosim.Constant(100.0), name="force")
        for name, fmi, every in (("a", "2.0", 1), ("b", "3.0", 1), ("slow", "2.0", 5)):
            diagram.connect(force["y"], diagram.add(car(fmi), name=name, every=every)["force"])
        run = diagram.simulate(2.0, engine=engine)
        assert np.array_equal(run["a.v"], run["b.v"])
        assert np.allclose(run["slow.v"][::5], recursion([100.0] * 20, [0.0] * 20, h=0.1), rtol=1e-13)
        assert np.array_equal(run["slow.v"][::5].repeat(5)[:101], run["slow.v"])


@pytest.mark.sampled(1)
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("lives", [2000, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("fmi", FMI)
def test_thousands_of_lives_leave_no_memory_behind(fmi, lives):
    block = car(fmi)
    u, y = np.zeros(2), np.zeros(1)

    def live():
        instance = block.instantiate(STEP, "again")
        assert instance.output(u, y, 0.0) == instance.update(u, y, 0.0) == instance.output(u, y, 0.02) == 0
        instance.close()

    for _ in range(100):
        live()
    others = set(_fmi_messages._open)  # of runs that other tests have not let go of
    before = memory_in_use()
    for _ in range(lives):
        live()
    assert memory_in_use() - before < 1e6
    assert set(_fmi_messages._open) <= others


def test_runs_in_threads_do_not_mix():
    alone = [cruise(car(fmi)).simulate(5.0, seed=s)["car.v"] for s, fmi in enumerate(FMI * 4)]
    together = [None] * 8

    def work(s):
        together[s] = cruise(car(FMI[s % 2])).simulate(5.0, seed=s)["car.v"]

    threads = [threading.Thread(target=work, args=(s,)) for s in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_blocks_are_plain_values(tmp_path, monkeypatch):
    block = car(parameters={"m": np.float64(120.0)}, inputs=["force"])
    copy = pickle.loads(pickle.dumps(block))
    assert copy == block
    assert hash(copy) == hash(block)
    assert block != car(parameters={"m": 121.0}, inputs=["force"])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car.fmu").write_bytes(Path(block.path).read_bytes())
    relative = FMU("car.fmu")
    monkeypatch.chdir("/")
    assert relative.description.name == "CruiseControl"  # the path was made absolute where it was given
    import dataclasses

    assert dataclasses.replace(block, timing="sampled").inputs[0].feedthrough


@pytest.mark.parametrize("engine", ENGINES)
def test_nan_out_of_a_plant_stops_the_run_and_keeps_the_result(engine):
    diagram = cosim.Diagram(dt=0.02)
    plant = diagram.add(car(), name="car")
    source = diagram.add(cosim.Table([0.0, 0.1], [100.0, 1e308], interpolate=False))
    push = diagram.add(cosim.Gain(1e3), name="push")
    diagram.connect(source["y"], push["u"])
    diagram.connect(push["y"], plant["force"])
    with pytest.raises(SimulationError, match=r"step 6\): car\.v came out infinite") as caught:
        diagram.simulate(1.0, engine=engine)
    assert np.allclose(caught.value.result["car.v"], recursion([1e5] * 5, [0.0] * 5), rtol=1e-13)


@pytest.mark.parametrize("fmi", FMI)
def test_a_failed_call_is_explained_in_the_words_of_fmi(fmi, capfd, caplog):
    instance = car(fmi).instantiate(STEP, "car")
    u, y = np.zeros(2), np.zeros(1)
    with caplog.at_level(logging.ERROR, "bayesftc.fmu"):
        status = instance.update(u, y, 5.0)  # not the time at which it stands
    assert status == _fmi_instance.STEP + 3
    sentence = instance.explain(status)
    assert sentence.startswith(f"fmi{fmi[0]}DoStep returned Error. Its log: ")
    assert "the communication point 5 is not the time 0" in sentence
    assert "car: fmi" in caplog.text
    assert instance.update(u, y, 0.0) == _fmi_instance.SET + 3
    assert "Real" in instance.explain(203) or "Float64" in instance.explain(203)
    instance.close()
    assert capfd.readouterr() == ("", "")


def test_messages_are_bounded_and_formatted(caplog):
    import fmpy.logging  # noqa: F401 - without fmpy's proxy there is nothing to test

    messages = _fmi_messages.Messages("car")
    structure = _fmi_messages.callbacks2(messages)
    # As an FMU calls it: with variable arguments, which fmpy's proxy formats.
    kind = ctypes.CFUNCTYPE(
        None,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char_p,
    )
    log = kind(ctypes.cast(structure.logger, ctypes.c_void_p).value)
    with caplog.at_level(logging.INFO, "bayesftc.fmu"):
        for i in range(50):
            log(messages.key, b"car", i % 5, b"logAll", b"value %d of %s" + b"." * 1000, i, b"x\xff")
    kept = list(messages)
    assert len(kept) == _fmi_messages.KEPT == 20
    assert kept[-1].startswith("value 49 of x\N{REPLACEMENT CHARACTER}...")
    assert max(map(len, kept)) == _fmi_messages.LENGTH == 500
    assert {r.levelname for r in caplog.records} == {"INFO", "WARNING", "ERROR", "CRITICAL"}
    messages.close()
    log(messages.key, b"car", 0, b"logAll", b"%d %s", 1, b"after the end")  # must not crash; fmpy prints it
    assert list(messages) == kept


@pytest.mark.parametrize("fmi", FMI)
def test_description_without_loading(fmi, monkeypatch):
    def refuse(*arguments):
        raise AssertionError("loaded a binary")

    monkeypatch.setattr(ctypes.cdll, "LoadLibrary", refuse)
    description = describe(str(fmus.path("CruiseControl", fmi=fmi)))
    assert (description.name, description.fmi_version, description.fmi_major) == ("CruiseControl", fmi, int(fmi[0]))
    assert description.kinds == ("coSimulation",)
    assert ("linux64" if fmi == "2.0" else "x86_64-linux") in description.platforms
    assert description.default_experiment == {"startTime": 0.0, "stopTime": 20.0, "stepSize": 0.02}
    assert description.capabilities["canGetAndSetFMUstate"] is True
    assert description.capabilities["needsExecutionTool"] is False
    v = {variable.name: variable for variable in description.variables}
    assert (v["b"].causality, v["b"].variability, v["b"].start, v["b"].unit) == ("parameter", "fixed", 5.0, "N.s/m")
    assert v["b"].type == ("Real" if fmi == "2.0" else "Float64")
    assert v["b"].description == "Drag coefficient"
    assert (v["b"].settable, v["force"].settable, v["v"].settable) == (True, True, False)
    assert "inf" not in repr(description)


CODES = r"""
typedef %(status)s;
%(original)s
%(get)s
__attribute__((visibility("default"))) %(declaration)s
{
    double mode = 0.0;
    const unsigned int reference = 3; /* the parameter b says what is to happen from t = 0.1 s on */
    %(read)s
    if (t > 0.09 && mode >= 1000.0) {
        %(special)s
        return (int)mode - 1000;
    }
    return original(%(arguments)s);
}
"""


@pytest.fixture(scope="module", params=FMI)
def failing(request, tmp_path_factory, c_compiler):
    """Build an FMU whose step fails in the way that its parameter b names."""
    import subprocess

    if sys.platform != "linux":
        pytest.skip("needs Linux; the status codes themselves are tested everywhere")
    fmi, folder = request.param, tmp_path_factory.mktemp("failing")
    source = fmus.path("CruiseControl", fmi=fmi)
    with zipfile.ZipFile(source) as archive:
        for name in archive.namelist():
            if name.startswith("sources/"):
                (folder / Path(name).name).write_bytes(archive.read(name))
    wrapper = folder / f"fmi{fmi[0]}.c"
    text = wrapper.read_text()
    assert f"fmi{fmi[0]}Status fmi{fmi[0]}DoStep(" in text
    wrapper.write_text(text.replace(f"fmi{fmi[0]}Status fmi{fmi[0]}DoStep(", f"fmi{fmi[0]}Status original("))
    if fmi == "2.0":
        arguments, types, special = "c, t, h, n", "void *c, double t, double h, int n", ""
        get, read = (
            "int fmi2GetReal(void *, const unsigned *, unsigned long, double *);",
            "fmi2GetReal(c, &reference, 1, &mode);",
        )
    else:
        arguments = "c, t, h, n, e, q, r, l"
        types = "void *c, double t, double h, _Bool n, _Bool *e, _Bool *q, _Bool *r, double *l"
        get = "int fmi3GetFloat64(void *, const unsigned *, unsigned long, double *, unsigned long);"
        read = "fmi3GetFloat64(c, &reference, 1, &mode, 1);"
        special = "if (mode == 1010.0) { *q = 1; return 0; } if (mode == 1011.0) { *r = 1; *l = t; return 0; }"
    fields = {
        "status": "int status",
        "original": f"int original({types});",
        "get": get,
        "declaration": f"int fmi{fmi[0]}DoStep({types})",
        "read": read,
        "special": special,
        "arguments": arguments,
    }
    (folder / "codes.c").write_text(CODES % fields)
    library = folder / "library.so"
    command = [
        c_compiler,
        "-O1",
        "-shared",
        "-fPIC",
        "-I.",
        wrapper.name,
        "CruiseControl.c",
        "codes.c",
        "-o",
        str(library),
    ]
    subprocess.run([*command, "-lm"], cwd=folder, check=True)
    return edited(source, folder / "Failing.fmu", so=lambda _: library.read_bytes())


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("mode", "sentence"),
    [
        (1002.0, r"DoStep returned Discard\."),
        (1003.0, r"DoStep returned Error\. It logged nothing\."),
        (1004.0, r"DoStep returned Fatal\."),
        (1005.0, r"DoStep returned Pending\. Asynchronous steps are not supported"),
        (1011.0, r"returned early from fmi3DoStep, at t = 0\.1 s, before the end of the step, and does not continue"),
    ],
)
def test_steps_that_fail_stop_the_run_and_keep_the_result(failing, engine, mode, sentence):
    if mode == 1011 and describe(failing).fmi_major == 2:
        pytest.skip("FMI 2 has no such answer")
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(failing, parameters={"b": mode, "force": 100.0}), name="car")
    with pytest.raises(SimulationError, match=sentence) as caught:
        diagram.simulate(1.0, engine=engine)
    assert "at t = 0.1 s (step 5): block 'car' failed. " in str(caught.value)
    if mode == 1002 and describe(failing).fmi_major == 2:
        assert "up to t = 0.1 s. Try a smaller step." in str(caught.value)
    expected = recursion([100.0] * 5, [0.0] * 5, b=mode)
    assert np.allclose(caught.value.result["car.v"], expected, rtol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_warnings_do_not_stop_the_run(failing, engine):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(failing, parameters={"b": 1001.0}), name="car")
    assert len(diagram.simulate(1.0, engine=engine).time) == 51
