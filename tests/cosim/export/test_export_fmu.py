"""Exported FMUs: valid, the same bits as their blocks in Python, states, reset, refusals; and how they are compared."""

import ctypes
import pickle
import re
import subprocess
from fractions import Fraction
from pathlib import Path

import control
import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from sklearn.ensemble import RandomForestClassifier

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.export.deviations import deviation
from bayesftc.examples.cruise_control.cruise_control import cruise_control

PLANTS = ("system", "sine", "delay")
"""Blocks that are plants to FMI; a delay's NaNs are missing samples all the same."""


@pytest.fixture(autouse=True)
def _needs_a_compiler(c_compiler):
    pass


def surrounded(block, name="block"):
    """Return a diagram with noise in all inputs of a block, of which each that may be missing is so now and then."""
    diagram = cosim.Diagram("1/10")
    node = diagram.add(block, name)
    for port in block.inputs:
        if port.draw is None:
            noises = [diagram.add(cosim.Gaussian(std=1.0), f"{port.name}{i}") for i in range(port.size)]
            outputs = [noise["y"] for noise in noises]
            if not block.checks_finite:  # a plant takes no NaN
                gaps = cosim.Dropout(channels=port.size, mean_time_to_fault=3.0, mean_time_to_recovery=0.5)
                missing = diagram.add(gaps, f"gaps_{port.name}")
                diagram.connect(outputs, missing["u"])
                outputs = [missing["y"]]
            diagram.connect(outputs, node[port.name])
    return diagram


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """Return the loop of a car under cruise control with a frozen sensor, and its controller as an FMU."""
    loop = cruise_control(controllers.GammaPrecision(forgetting=0.95))
    folder = tmp_path_factory.mktemp("car")
    return loop, {
        fmi: cosim.export_fmu(loop, folder / f"brain{fmi[0]}.fmu", blocks="controller", fmi=fmi)
        for fmi in ("2.0", "3.0")
    }


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("kind", "fmi"),
    [
        *((k, "3.0") for k in ("lqg", "PID", "RandomFaults", *PLANTS)),
        *((k, "2.0") for k in ("lqg", "RandomFaults", "delay", "random faults on a delayed condition")),
        ("fault on a condition", "3.0"),
    ],
)
def test_the_same_bits_as_the_block_missing_samples_and_noise_included(kind, fmi, blocks, tmp_path):
    diagram = surrounded(blocks[kind])
    path = cosim.export_fmu(diagram, tmp_path / "one.fmu", blocks="block", fmi=fmi)
    assert validate_fmu(str(path)) == []
    found = cosim.verify_fmu(path, diagram, duration=15.0, seed=5, engine="interpreted")
    assert found.agrees(), found
    assert found.in_loop
    assert not found.notes
    assert {d.signal for d in found.beside} == {f"block.{port.name}" for port in blocks[kind].outputs}
    fmu = cosim.FMU(path)
    assert fmu.timing == ("plant" if kind in PLANTS else "sampled")
    assert fmu.checks_finite == blocks[kind].checks_finite
    assert {v.name.partition("[")[0] for v in fmu.description.variables if v.causality == "input"} == {
        port.name for port in blocks[kind].inputs
    }


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_the_same_bits_over_100_000_steps_with_faults(fmi, tmp_path):
    fault = cosim.RandomFaults(channels=2, mean_time_to_fault=20.0, mean_time_to_recovery=5.0)
    loop = cruise_control(controllers.GammaPrecision(forgetting=0.95), fault)
    path = cosim.export_fmu(loop, tmp_path / "brain.fmu", blocks="controller", fmi=fmi)
    found = cosim.verify_fmu(path, loop, duration=2000.0, seed=3, engine="compiled")
    assert found.steps == 100_001
    assert found.agrees(), found


@pytest.mark.slow
def test_blocks_that_are_fused_are_one_fmu(tmp_path, car):
    loop, _ = car
    path = cosim.export_fmu(loop, tmp_path / "front.fmu", fmi="3.0", blocks=["freeze_0", "sensors", "controller"])
    fmu = cosim.FMU(path)
    assert fmu.description.blocks == ("sensors", "freeze_0", "controller")
    assert [port.name for port in fmu.inputs] == ["sensors.u", "sensors.noise", "controller.goal"]
    found = cosim.verify_fmu(path, loop, duration=8.0, engine="interpreted")
    assert found.agrees(), found
    assert found.verdict().startswith("front.fmu does what sensors, freeze_0 and controller do: the same numbers")


@pytest.mark.slow
def test_conditions_of_faults_are_inside_where_their_signals_are(tmp_path):
    fault = cosim.Freeze(start=cosim.when("plant.v", ">", 22.0), stop=cosim.when("sensors.y[1]", "<", 19.0))
    loop = cruise_control(controllers.GammaPrecision(forgetting=0.95), fault)
    path = cosim.export_fmu(loop, tmp_path / "front.fmu", fmi="3.0", blocks=["sensors", "freeze_0"])
    description = cosim.FMU(path).description.variables
    assert {v.name: (v.start, v.unit) for v in description if v.name.endswith("value")} == {
        "freeze_0.start.value": (22.0, "m/s"),
        "freeze_0.stop.value": (19.0, "m/s"),
    }
    assert [port.name for port in cosim.FMU(path).inputs] == ["sensors.u", "sensors.noise", "freeze_0.start_signal"]
    found = cosim.verify_fmu(path, loop, duration=8.0, engine="interpreted")
    assert found.agrees(), found
    assert found.in_loop


@pytest.mark.slow
def test_blocks_of_several_rates_are_one_fmu(tmp_path):
    diagram = cosim.Diagram("1/100")
    noise = diagram.add(cosim.Gaussian(1.0), "noise-1")  # no name for FMI
    limit = diagram.add(cosim.Saturation(-1.0, 1.0), "limit", every=2)
    late = diagram.add(cosim.UnitDelay(), "late", every=3)
    diagram.connect(noise["y"], limit["u"])
    diagram.connect(limit["y"], late["u"])
    for blocks in (["limit", "late"], None):
        path = cosim.export_fmu(diagram, tmp_path / "rates.fmu", blocks=blocks)
        found = cosim.verify_fmu(path, diagram, duration=2.0, engine="interpreted")
        assert found.blocks == (tuple(blocks) if blocks else ("noise-1", "limit", "late"))
        assert found.agrees(), found


def test_a_plant_in_a_loop_with_another_fmu(tmp_path):
    diagram = cosim.Diagram("1/50")
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), "car")
    motor = diagram.add(cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[30.0]], 0, 0.02)), "motor")
    diagram.connect(car["v"], motor["u"])
    diagram.connect(motor["y"], car["force"])
    path = cosim.export_fmu(diagram, tmp_path / "motor.fmu", blocks="motor")
    assert cosim.FMU(path).timing == "plant"
    found = cosim.verify_fmu(path, diagram, duration=5.0, engine="interpreted")
    assert found.agrees(), found
    assert {d.signal for d in found.in_loop} == {"car.v", "motor.y"}


def alone(path):
    diagram = cosim.Diagram("1/50")
    diagram.add(cosim.FMU(path), "brain")
    return diagram


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_states_go_back_and_into_other_instances_and_reset_is_a_new_beginning(car, fmi, same_bits):
    path = car[1][fmi]
    names = {"2.0": ("brain.y[0]", "brain.y[1]", "brain.goal[0]"), "3.0": ("brain.y", "brain.goal")}[fmi]
    values = {"2.0": (20.5, 19.0, 21.0), "3.0": ([20.5, 19.0], [21.0])}[fmi]

    def feed(session):
        for name, value in zip(names, values, strict=True):
            session.set(name, value)

    def same(one, other):
        for name in one:
            same_bits(one[name], other[name], name)

    with alone(path).start(engine="interpreted") as session, alone(path).start(engine="interpreted") as second:
        feed(session)
        beginning = session.advance(1.0)
        early = session.save_state()
        ahead = session.advance(1.0)
        late = pickle.loads(pickle.dumps(session.save_state()))
        further = session.advance(1.0)
        session.restore(early)
        same(session.advance(1.0), ahead)
        second.restore(late)
        same(second.advance(1.0), further)
        session.reset()
        feed(session)
        same(session.advance(1.0), beginning)
        assert any(np.any(ahead[name][-1] != further[name][-1]) for name in ahead)


def running(path, messages):
    """Return an instance of an FMU of FMI 2 that fmpy runs, and its variables by name."""
    description = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    fmu = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )
    callbacks = fmpy.fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(
        lambda _, name, status, category, message: messages.append(message.decode())
    )
    callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
    callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
    fmu.instantiate(callbacks=callbacks, loggingOn=True)
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu, {v.name: v.valueReference for v in description.modelVariables}


def test_another_step_is_refused_with_a_line_in_the_log(car):
    messages = []
    fmu, _ = running(car[1]["2.0"], messages)
    fmu.doStep(0.0, 0.02)
    with pytest.raises(fmpy.fmi1.FMICallException):
        fmu.doStep(0.02, 0.03)
    assert any("step size 0.02999" in message and "must be 0.02" in message for message in messages), messages
    fmu.freeInstance()


def test_a_nan_is_a_missing_sample_to_any_importer(car):
    fmu, number = running(car[1]["2.0"], [])
    step = car[0]["controller"].block.online(compiled=False)
    for k, (a, b) in enumerate([(20.0, 19.5), (np.nan, 20.5), (21.0, np.nan), (np.nan, np.nan), (20.0, 20.0)]):
        fmu.setReal([number[n] for n in ("y[0]", "y[1]", "goal[0]")], [a, b, 22.0])
        fmu.doStep(k * 0.02, 0.02)
        expected = step(y=[a, b], goal=[22.0])
        got = fmu.getReal([number[n] for n in ("u[0]", "x_hat[0]", "beta[0]", "beta[1]")])
        np.testing.assert_array_equal(got, [*expected.u, *expected.x_hat, *expected.beta])
    fmu.terminate()
    fmu.freeInstance()


def test_a_classifier_that_is_linear_is_exported_and_another_is_refused(tmp_path):
    residuals = np.random.default_rng(0).normal(size=(200, 1))
    faulty = (residuals[:, 0] > 0.5).astype(int)
    linear = controllers.FaultClassifier().fit(residuals, faulty).block(2)
    diagram = surrounded(linear)
    path = cosim.export_fmu(diagram, tmp_path / "linear.fmu", blocks="block")
    found = cosim.verify_fmu(path, diagram, duration=10.0, engine="interpreted")
    assert found.agrees(1e-12), found  # exp is in it
    forest = controllers.FaultClassifier(RandomForestClassifier(3, random_state=0)).fit(residuals, faulty).block(2)
    with pytest.raises(cosim.ModelError, match=r"calls Python, .* classifier that is linear in its features"):
        cosim.export_fmu(forest, tmp_path / "forest.fmu", dt=0.1)


# How they are compared


@pytest.mark.slow
def test_signals_under_new_names_are_found_again(car, tmp_path):
    loop, _ = car
    path = cosim.export_fmu(
        loop,
        tmp_path / "renamed.fmu",
        blocks="controller",
        inputs={"y": "speeds", "goal": "wanted"},
        outputs={"u": "force"},
    )
    found = cosim.verify_fmu(path, loop, duration=2.0, engine="interpreted")
    assert found.agrees()
    assert [d.signal for d in found.beside] == ["controller.u"]
    assert "the FMU does not have them: controller.x_hat, controller.P" in " ".join(found.notes)


@pytest.mark.slow
def test_a_block_that_was_exported_by_itself_is_found_by_its_ports(car, tmp_path):
    loop, _ = car
    block = loop["controller"].block
    path = cosim.export_fmu(block, tmp_path / "brain.fmu", outputs={"u": "force", "x_hat": "x_hat"})
    found = cosim.verify_fmu(path, loop, duration=2.0, engine="interpreted")
    assert found.blocks == ("controller",)
    assert found.agrees(), found


def test_an_fmu_that_does_otherwise_is_told(car):
    other = cruise_control(controllers.GammaPrecision(forgetting=0.9))
    found = cosim.verify_fmu(car[1]["2.0"], other, duration=8.0, engine="interpreted")
    assert not found.agrees()
    assert not found.agrees(1e-6)
    assert found.agrees(1e6)
    u, loop = next(d for d in found.beside if d.signal == "controller.u"), found.worst_in_loop
    assert u.largest > 0.0
    assert u.ulps > 1.0
    assert 0.0 < u.time <= 8.0
    assert loop.largest > 0.0
    assert "does NOT do what controller does" in repr(found)
    assert "to the tolerance of 1e+06" in found.verdict(1e6)


def test_the_compared_numbers_are_the_true_ones():
    time = np.array([0.0, 0.1, 0.2])
    one = np.array([[1.0, np.nan], [2.0, np.inf], [-4.0, 0.0]])
    assert deviation("s", time, one, one.copy()) == cosim.Deviation("s", 0.0, None, 0.0, 0.0)
    near = one.copy()
    near[1, 0] = np.nextafter(np.nextafter(2.0, 3.0), 3.0)
    found = deviation("s", time, one, near)
    assert (found.largest, found.time, found.ulps) == (2.0**-50, 0.1, 2.0)
    assert found.relative == 2.0**-52
    across = deviation("s", time[:1], np.array([[-5e-324]]), np.array([[5e-324]]))
    assert across.ulps == 2.0
    for was, now in ((1.0, np.nan), (np.nan, 1.0), (np.inf, -np.inf)):
        assert deviation("s", time[:1], np.array([[was]]), np.array([[now]])).largest == np.inf


@pytest.mark.parametrize(
    ("was", "now", "sentence"),
    [
        (0.0, 0.5, "s is always 0 in the diagram, but differs from it by 0.5 with the FMU."),
        (1.0, np.nan, "at t = 0.1 s, s is NaN or infinite in one run, and has another value in the other."),
        (1.0, 3.0, "s differs by 2 times its largest value."),
    ],
)
def test_the_verdict_has_no_infinite_ratio(was, now, sentence):
    each = deviation("s", np.array([0.0, 0.1]), np.full((2, 1), was), np.array([[was], [now]]))
    found = cosim.Verification(Path("law.fmu"), ("law",), 2, Fraction(1, 10), 0, (each,), (each,))
    assert found.verdict() == f"law.fmu does NOT do what law does: {sentence}"
    assert not re.search(r"\binf\b", repr(found))


def test_the_verdict_names_the_control_first():
    """The first output that differs by a number, although another differs by a larger factor or is no number."""
    time, one = np.array([0.0, 0.1]), np.ones((2, 1))
    u, P, size, kept = (
        deviation(name, time, one, one * factor)
        for name, factor in (("u", 1.5), ("P", 9.0), ("size", np.nan), ("kept", 1.0))
    )
    found = cosim.Verification(Path("law.fmu"), ("law",), 2, Fraction(1, 10), 0, (kept, u, P, size), (u, P, size))
    assert found.verdict() == (
        "law.fmu does NOT do what law does: u differs by 0.5 of its largest value, and 2 more signals differ."
    )
    assert (
        "In a run with the FMU in place of these blocks: largest difference 8, of P at t = 0 s (8 times its largest value); "
        "at t = 0 s, size is NaN or infinite" in repr(found)
    )


@pytest.mark.slow
def test_what_cannot_be_compared_is_a_sentence(car, tmp_path):
    loop, paths = car
    limit = cosim.export_fmu(cosim.Saturation(-1.0, 1.0), tmp_path / "limit.fmu", dt="1/10")
    with pytest.raises(
        cosim.ModelError, match=r"The block from which limit\.fmu was exported is not clear: no block has its"
    ):
        cosim.verify_fmu(limit, loop, duration=1.0)
    with pytest.raises(cosim.UnknownNameError, match="the input 'y\\[0\\]', but sensors has none"):
        cosim.verify_fmu(paths["2.0"], loop, "sensors", duration=1.0)
    with pytest.raises(cosim.UnknownNameError, match="no block 'contoller'; did you mean 'controller'"):
        cosim.verify_fmu(paths["2.0"], loop, "contoller", duration=1.0)
    with pytest.raises(cosim.ModelError, match="'plant' is an FMU itself"):
        cosim.verify_fmu(paths["2.0"], loop, ["plant"], duration=1.0)
    two = cosim.Diagram("1/10")
    noise = two.add(cosim.Gaussian(1.0))
    for name, low in (("first", -1.0), ("second", -2.0)):
        two.connect(noise["y"], two.add(cosim.Saturation(low, 1.0), name)["u"])
    with pytest.raises(cosim.ModelError, match="first and second have its inputs and outputs"):
        cosim.verify_fmu(limit, two, duration=1.0)
    assert cosim.verify_fmu(limit, two, "first", duration=5.0, engine="interpreted").agrees()
    assert not cosim.verify_fmu(limit, two, "second", duration=5.0, engine="interpreted").agrees()
    slow = cosim.Diagram("1/5")
    slow.connect(slow.add(cosim.Gaussian(1.0))["y"], slow.add(cosim.Saturation(-1.0, 1.0))["u"])
    with pytest.raises(cosim.StepSizeError, match=r"limit.fmu makes steps of 0.1 s, but saturation one every 0.2 s"):
        cosim.verify_fmu(limit, slow, duration=1.0)


@pytest.mark.slow
def test_without_an_output_that_others_hear_the_loop_stays_as_it_is(car, tmp_path):
    loop, _ = car
    path = cosim.export_fmu(loop, tmp_path / "deaf.fmu", blocks="controller", outputs=["x_hat"])
    found = cosim.verify_fmu(path, loop, duration=2.0, engine="interpreted")
    assert found.in_loop is None
    assert found.agrees()
    assert "the diagram uses controller.u[0], which the FMU does not have" in repr(found)


def test_elements_that_an_fmu_lacks_are_named(tmp_path):
    def noisy(count):
        diagram = cosim.Diagram("1/10")
        gain = diagram.add(cosim.Gain(np.eye(count)), "gain")
        diagram.connect([diagram.add(cosim.Gaussian(std=1.0), f"noise{i}")["y"] for i in range(count)], gain["u"])
        return diagram

    path = cosim.export_fmu(noisy(2), tmp_path / "two.fmu", blocks="gain")
    found = cosim.verify_fmu(path, noisy(3), duration=2.0, engine="interpreted")
    assert "Not compared, as the FMU does not have them: gain.y[2]." in found.notes


@pytest.mark.slow
def test_an_isolated_fmu_gives_the_same(car):
    assert cosim.verify_fmu(car[1]["2.0"], car[0], duration=2.0, engine="interpreted", isolate=True).agrees()


# What cannot be written


def test_nothing_is_left_where_an_export_fails(tmp_path):
    limit = cosim.Saturation(-1.0, 1.0)
    for path, error, says in (
        (tmp_path / "no" / "x.fmu", cosim.ResultFileError, "does not exist; create the folder"),
        (tmp_path / "x", cosim.ResultFileError, "does not end in .fmu"),
        (tmp_path / ".fmu", cosim.ResultFileError, "name it controller.fmu, say"),
        (tmp_path / ("x" * 300 + ".fmu"), cosim.ResultFileError, "too long for a file"),
        (tmp_path / "file" / "x.fmu", cosim.ResultFileError, "is a file and no folder"),
    ):
        (tmp_path / "file").write_text("")
        with pytest.raises(error, match=says):
            cosim.export_fmu(limit, path, dt=0.1)
    (tmp_path / "folder.fmu").mkdir()
    with pytest.raises(cosim.ResultFileError, match="is a folder; give the FMU another name"):
        cosim.export_fmu(limit, tmp_path / "folder.fmu", dt=0.1)
    with pytest.raises(cosim.ModelError, match=r"fmi='1\.0'; it must be one of '2\.0', '3\.0'"):
        cosim.export_fmu(limit, tmp_path / "x.fmu", dt=0.1, fmi="1.0")
    with pytest.raises(cosim.ModelError, match="acts on the output 'y' directly"):
        cosim.export_fmu(limit, tmp_path / "x.fmu", dt=0.1, timing="plant")
    with pytest.raises(cosim.ModelError, match="has no sample time"):
        cosim.export_c(limit, tmp_path)
    with pytest.raises(cosim.ResultFileError, match="does not exist"):
        cosim.export_c(limit, tmp_path / "no" / "c", dt=0.1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.fmu"]


def test_c_is_replaced_as_a_whole_and_compiles(tmp_path, c_compiler):
    folder = tmp_path / "made"
    source, _ = cosim.export_c(cosim.Saturation(-2.0, 2.0), folder, name="limit", dt=0.1)
    cosim.export_c(cosim.Saturation(-1.0, 1.0), folder, name="limit", dt=0.1)
    assert sorted(p.name for p in folder.iterdir()) == ["limit.c", "limit.h"]
    subprocess.run(
        [c_compiler, "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC", source.name, "-o", "limit.so", "-lm"],
        cwd=folder,
        check=True,
    )
    library = ctypes.CDLL(str(folder / "limit.so"))
    state, u, y = np.zeros(64), np.array([3.0]), np.zeros(1)
    library.limit_init(ctypes.c_void_p(state.ctypes.data))
    library.limit_evaluate(*(ctypes.c_void_p(array.ctypes.data) for array in (state, u, y)))
    assert y[0] == 1.0


def count_up(x):
    x[0] = x[0] + 1.0


def tick(x, y):
    count_up(x)
    y[0] = x[0]


class Ticker(cosim.Block):
    """Counts its steps, in a function that its output function calls."""

    outputs = (cosim.Port("y"),)

    def define(self, step):
        return cosim.Definition(tick, state={"x": 0.0})


def test_outputs_that_change_a_state_are_computed_once_a_step(tmp_path, c_compiler):
    with pytest.raises(cosim.ModelError, match=r"computing its outputs changes a state\. Give timing='sampled'"):
        cosim.export_fmu(Ticker(), tmp_path / "ticker.fmu", dt=0.1, timing="plant")
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.FMU(cosim.export_fmu(Ticker(), tmp_path / "ticker.fmu", dt=0.1)), "fmu")
    run = diagram.simulate(0.4, engine="interpreted")
    np.testing.assert_array_equal(run["fmu.y"], [1.0, 2.0, 3.0, 4.0, 5.0])


def test_a_plant_with_one_direct_output_says_that_all_are_sampled(tmp_path, caplog):
    """A disk with an accelerometer was a step late in another tool, and refused as a plant with advice that did not help."""
    arm = control.ss(
        [[0, 1], [-9, -0.1]], [[0, 0], [1, 0.5]], [[1, 0], [0, 1], [-9, -0.1]], [[0, 0], [0, 0], [0, 0.5]],
        inputs=["drive", "load"], outputs=["angle", "speed", "acceleration"],
    )  # fmt: skip
    with caplog.at_level("INFO", logger="bayesftc"):
        sampled = cosim.FMU(cosim.export_fmu(cosim.StateSpace(arm), tmp_path / "arm.fmu", dt=0.01))
    (said,) = [record.getMessage() for record in caplog.records if "step late" in record.getMessage()]
    assert "The input load acts on the output acceleration directly" in said
    assert said.endswith("outputs=['angle', 'speed'].")
    caplog.clear()
    with caplog.at_level("INFO", logger="bayesftc"):
        path = cosim.export_fmu(cosim.StateSpace(arm), tmp_path / "two.fmu", dt=0.01, outputs=["angle", "speed"])
    assert not [record for record in caplog.records if "step late" in record.getMessage()]
    assert (sampled.timing, cosim.FMU(path).timing) == ("sampled", "plant")

    def loop(plant):
        controller = controllers.design(
            arm, measured=["angle", "speed"], actuated="drive", goal="angle", dt=0.01, acceptable_error=0.1,
            acceptable_control=1.0,
        )  # fmt: skip
        return cosim.closed_loop(
            plant,
            controller,
            control="drive",
            measured=["angle", "speed"],
            sensors=cosim.Sensors([1, 1], 0.01),
            reference=0.1,
        )

    with pytest.raises(cosim.AlgebraicLoopError, match=r"'plant' is an FMU with timing='sampled'.*\(outputs=\.\.\.\)"):
        loop(sampled).simulate(0.1)
    loop(cosim.FMU(path)).simulate(0.1, engine="interpreted")


def test_a_block_in_place_of_the_diagram_is_refused(tmp_path):
    with pytest.raises(cosim.ModelError, match=r"verify_fmu\(\) needs the diagram .* It is Saturation"):
        cosim.verify_fmu(tmp_path / "x.fmu", cosim.Saturation(-1.0, 1.0), duration=4.0)
