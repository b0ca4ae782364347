"""FMUs that this project did not write, made by other exporters when the tests begin."""

import atexit
import gc
import logging
import os
import shutil
import signal
import sys
import zipfile
from importlib.metadata import version
from types import ModuleType

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.errors import FMUCrashed
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.fmus._compiler import CompilerError, compiler_command
from bayesftc.fmus._platforms import host

H, TAU = 0.1, 1.5

BODY = """
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x = self.u = self.y = self.start = 0.0
        self.tau, self.gain, self.inverted, self.mode = 2.0, 1, False, "run"
        {register}

    def exit_initialization_mode(self):
        self.y = self.x = self.start

    def do_step(self, t, h):
        if self.mode == "raise" and t > 0.95:
            raise ValueError("the valve is stuck")
        if self.mode == "refuse" and t > 0.95:
            return False
        if self.mode == "interrupt" and t > 0.95:
            import signal
            signal.raise_signal(signal.SIGINT)
        if self.mode == "crash" and t > 0.95:
            import ctypes
            ctypes.string_at(0)
        if self.mode == "hang" and t > 0.95:
            while True:
                pass
        gain = -self.gain if self.inverted else self.gain
        self.x += h * (gain * self.u - self.x) / self.tau
        self.y = self.x
        return True
"""
SOURCES = {
    "pythonfmu": """from pythonfmu import Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Boolean, Integer, Real, String

class Lag(Fmi2Slave):
"""
    + BODY.format(
        register="""self.register_variable(Real("u", causality=C.input))
        self.register_variable(Real("y", causality=C.output))
        self.register_variable(Real("tau", causality=C.parameter, variability=V.tunable))
        self.register_variable(Real("start", causality=C.parameter, variability=V.fixed))
        self.register_variable(Integer("gain", causality=C.parameter, variability=V.tunable))
        self.register_variable(Boolean("inverted", causality=C.parameter, variability=V.tunable))
        self.register_variable(String("mode", causality=C.parameter, variability=V.tunable))"""
    ),
    "pythonfmu3": """from pythonfmu3 import Fmi3Causality as C, Fmi3Slave, Fmi3Variability as V, Boolean, Float64, Int32, String

class Lag(Fmi3Slave):
"""
    + BODY.format(
        register="""self.time = 0.0
        self.register_variable(Float64("time", causality=C.independent, variability=V.continuous))
        self.register_variable(Float64("u", causality=C.input, start=0.0))
        self.register_variable(Float64("y", causality=C.output))
        self.register_variable(Float64("tau", causality=C.parameter, variability=V.tunable))
        self.register_variable(Float64("start", causality=C.parameter, variability=V.fixed))
        self.register_variable(Int32("gain", causality=C.parameter, variability=V.tunable))
        self.register_variable(Boolean("inverted", causality=C.parameter, variability=V.tunable))
        self.register_variable(String("mode", causality=C.parameter, variability=V.tunable))"""
    ),
}
EXPORTERS = tuple(SOURCES)


@pytest.fixture(scope="session")
def lag(tmp_path_factory):
    """Return the file of a first-order lag, written in Python and exported by a tool, of FMI 2 or 3."""
    files = {}
    for tool, source in SOURCES.items():
        builder = pytest.importorskip(f"{tool}.builder")
        folder = tmp_path_factory.mktemp(tool)
        (folder / f"lag_{tool}.py").write_text(source)
        files[tool] = builder.FmuBuilder.build_FMU(folder / f"lag_{tool}.py", dest=folder)
    return lambda tool: files[tool]


def lagged(inputs, tau=TAU, gain=1.0, start=0.0):
    outputs = [start]
    for u in inputs[:-1]:
        outputs.append(outputs[-1] + H * (gain * u - outputs[-1]) / tau)
    return np.array(outputs)


def driven(path, **options):
    diagram = cosim.Diagram(dt=H)
    plant = diagram.add(FMU(path, parameters={"tau": TAU, "start": 0.5}, **options), "p")
    diagram.connect(diagram.add(cosim.Sine(amplitude=2.0, period=3.0), "u")["y"], plant["u"])
    return diagram


@pytest.mark.parametrize("tool", EXPORTERS)
def test_in_both_engines_against_the_recursion(lag, tool, run_both):
    result = run_both(driven(lag(tool)), 5)
    np.testing.assert_allclose(result["p.y"], lagged(result["u.y"], start=0.5), rtol=1e-13, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("tool", EXPORTERS)
def test_the_same_in_a_process_of_its_own(lag, tool, same_bits):
    inside = driven(lag(tool)).simulate(2, engine="interpreted")
    outside = driven(lag(tool), isolate=True).simulate(2, engine="interpreted")
    same_bits(inside["p.y"], outside["p.y"])


@pytest.mark.parametrize("tool", EXPORTERS)
def test_against_fmpy(lag, tool):
    import fmpy

    steps = 30
    times = np.arange(steps + 1) * H
    u = np.sin(times)
    table = np.array(list(zip(times, u, strict=True)), dtype=[("time", float), ("u", float)])
    # fmpy would interpolate between the rows; two of them at each step hold the value.
    held = np.repeat(table, 2)[:-1]
    held["time"][1::2] = times[1:]
    theirs = fmpy.simulate_fmu(
        str(lag(tool)),
        stop_time=steps * H,
        step_size=H,
        output_interval=H,
        input=held,
        output=["y"],
        start_values={"tau": TAU},
    )
    diagram = cosim.Diagram(dt=H)
    plant = diagram.add(FMU(lag(tool), parameters={"tau": TAU}), "p")
    diagram.connect(diagram.add(cosim.Table(times=times, values=u), "u")["y"], plant["u"])
    ours = diagram.simulate(steps * H, engine="interpreted")
    np.testing.assert_allclose(ours["p.y"], lagged(u), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(theirs["y"], lagged(u), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("tool", EXPORTERS)
def test_parameters_of_every_type(lag, tool):
    diagram = cosim.Diagram(dt=H)
    values = {"tau": TAU, "gain": 3, "inverted": True, "mode": "run", "start": 0.25}
    plant = diagram.add(FMU(lag(tool), parameters=values), "p")
    diagram.connect(diagram.add(cosim.Constant(2.0), "u")["y"], plant["u"])
    result = diagram.simulate(1.0, engine="interpreted")
    np.testing.assert_allclose(result["p.y"], lagged(np.full(11, 2.0), gain=-3.0, start=0.25), rtol=1e-13)


def closed(plant, measured):
    model = controllers.LinearModel(
        [[1 - H / TAU]], [[H / TAU]], [[1.0]] * 2, process_covariance=[[1e-4]], sensor_covariance=[1e-2] * 2, dt=H
    )
    return cosim.closed_loop(
        plant=plant,
        controller=controllers.BayesianController(model, precision=controllers.GammaPrecision(forgetting=0.9)),
        control="u",
        measured=measured,
        sensors=cosim.Sensors(count=2, std=0.1),
        faults=[cosim.Freeze(sensor=0, start=3.0, stop=6.0)],
        reference=cosim.Sine(amplitude=1.0, period=8.0, offset=2.0),
    )


@pytest.mark.parametrize("tool", EXPORTERS)
def test_our_controller_in_the_loop(lag, tool):
    """A loop with a failing sensor; the same loop over the same plant as a linear system of python-control is the measure."""
    import control

    ours = closed(FMU(lag(tool), parameters={"tau": TAU}), "y").simulate(10, seed=3, engine="interpreted")
    system = control.ss([[1 - H / TAU]], [[H / TAU]], [[1.0]], [[0.0]], H, inputs=["u"], outputs=["y"])
    theirs = closed(cosim.StateSpace(system), "y").simulate(10, seed=3, engine="interpreted")
    for name in ("plant.y", "controller.u", "controller.precision"):
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-7, atol=1e-9)
    error = ours["plant.y"] - (2.0 + np.sin(2 * np.pi * ours.time / 8.0))
    assert np.sqrt(np.mean(error[20:] ** 2)) < 0.3  # it follows, though a sensor is frozen


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tool", EXPORTERS)
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("mode", ["raise", "refuse"])
def test_a_step_that_fails_ends_in_a_sentence(lag, tool, mode, isolate):
    """What is raised is an error; a step that PythonFMU refuses says, as FMI 2 has it, that the simulation is to end."""
    diagram = cosim.Diagram(dt=H)
    diagram.add(FMU(lag(tool), parameters={"mode": mode}, isolate=isolate), "p")
    if (tool, mode) == ("pythonfmu", "refuse"):
        with pytest.warns(UserWarning, match=r"The run has ended at t = 1 s \(step 10\), as 'p' requested"):
            assert len(diagram.simulate(3, engine="interpreted")["p.y"]) == 11
        return
    with pytest.raises(cosim.SimulationError, match=r"The run stopped at t = 1 s \(step 10\)") as caught:
        diagram.simulate(3, engine="interpreted")
    assert len(caught.value.result["p.y"]) == 11
    assert ("the valve is stuck" in str(caught.value)) == (mode == "raise")  # what Python said in the FMU


@pytest.mark.parametrize("tool", EXPORTERS)
def test_what_a_binary_holds_of_python_it_lets_go_of_before_the_end(tool, tmp_path, monkeypatch):
    """PythonFMU's own destructors free it twice, and some processes end with an abort and another exit code."""
    builder = pytest.importorskip(f"{tool}.builder")
    (tmp_path / f"ends_{tool}.py").write_text(SOURCES[tool])
    path = builder.FmuBuilder.build_FMU(tmp_path / f"ends_{tool}.py", dest=tmp_path)
    driven(path).simulate(0.1, engine="interpreted")  # loads what has exits of its own
    shutil.copy(path, tmp_path / "other.fmu")
    with zipfile.ZipFile(tmp_path / "other.fmu", "a") as archive:
        archive.writestr("resources/note.txt", "another file, and so another binary")
    path, at_exit = tmp_path / "other.fmu", []
    monkeypatch.setattr(atexit, "register", at_exit.append)
    for _ in range(2):
        last = driven(path).simulate(1.0, engine="interpreted")["p.y"][-1]
    assert [function.__name__ for function in at_exit] == ["finalizePythonInterpreter"]
    with driven(path).start(engine="interpreted") as session:  # of which one may still be open
        at_exit[0]()
        assert session.advance(1.0)["p.y"][-1] == last


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tool", EXPORTERS)
def test_ctrl_c_within_an_fmu_is_no_failure_of_the_fmu(lag, tool):
    """Its binary takes what Python raises there for an error of the model."""
    usual = signal.getsignal(signal.SIGINT)
    with driven(lag(tool)).start(engine="interpreted") as session:
        session.advance(0.5)
        assert signal.getsignal(signal.SIGINT) is usual
    diagram = cosim.Diagram(dt=H)
    diagram.add(FMU(lag(tool), parameters={"mode": "interrupt"}), "p")
    for _ in range(3):  # what has failed is not freed: its binary would free its Python objects twice
        with pytest.raises(KeyboardInterrupt):
            diagram.simulate(3, engine="interpreted")
        gc.collect()
    assert signal.getsignal(signal.SIGINT) is usual


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tool", EXPORTERS)
def test_a_crash_of_an_isolated_fmu_leaves_the_host_alive(lag, tool):
    diagram = cosim.Diagram(dt=H)
    diagram.add(FMU(lag(tool), parameters={"mode": "crash"}, isolate=True), "p")
    with pytest.raises(FMUCrashed) as caught:
        diagram.simulate(3, engine="interpreted")
    assert caught.value.step == 10
    assert len(caught.value.result["p.y"]) == 11


@pytest.mark.slow
def test_a_step_that_never_ends(lag):
    diagram = cosim.Diagram(dt=H)
    diagram.add(FMU(lag("pythonfmu"), parameters={"mode": "hang"}, isolate=True, time_limit=2.0), "p")
    with pytest.raises(FMUCrashed) as caught:
        diagram.simulate(3, engine="interpreted")
    assert caught.value.step == 10


@pytest.mark.parametrize("tool", EXPORTERS)
def test_a_new_version_does_not_run_the_code_of_the_old_one(tool, tmp_path):
    """As in a notebook: run, edit, export anew to the same file, run."""
    builder = pytest.importorskip(f"{tool}.builder")
    source = tmp_path / f"edited_{tool}.py"

    def run(text):
        source.write_text(text)
        builder.FmuBuilder.build_FMU(source, dest=tmp_path)
        mine = sys.modules[source.stem] = ModuleType("mine")  # of that name, as it happens
        before = list(sys.path)
        last = driven(tmp_path / "Lag.fmu").simulate(1.0, engine="interpreted")["p.y"][-1]
        assert sys.modules.pop(source.stem) is mine
        added = sys.path[len(before) :]
        assert sys.path[: len(before)] == before
        assert len(added) <= 1  # behind the user's own folders
        return last

    first = run(SOURCES[tool])
    before = list(sys.path)
    driven(tmp_path / "Lag.fmu").simulate(1.0, engine="interpreted")
    assert sys.path == before  # of a second instance nothing comes
    assert run(SOURCES[tool]) == first
    old = cosim.FMU(shutil.copy(tmp_path / "Lag.fmu", tmp_path / "old.fmu"))
    second = run(SOURCES[tool].replace("gain * self.u", "2 * gain * self.u"))
    assert second - 0.5 * (1 - H / TAU) ** 10 == pytest.approx(2 * (first - 0.5 * (1 - H / TAU) ** 10), rel=1e-12)
    assert driven(old.path).simulate(1.0, engine="interpreted")["p.y"][-1] == first


@pytest.fixture(scope="session")
def pair(tmp_path_factory):
    """Return an FMU that holds two of our cars, the first one's speed pushing the second."""
    assembly = pytest.importorskip("fmu_manipulation_toolbox.assembly")
    folder = tmp_path_factory.mktemp("container")
    for name in ("lead", "follower"):
        shutil.copy(fmus.path("CruiseControl"), folder / f"{name}.fmu")
    (folder / "pair.csv").write_text(
        "rule;from_fmu;from_port;to_fmu;to_port\n"
        "INPUT;;force;lead.fmu;force\n"
        "OUTPUT;lead.fmu;v;;v1\n"
        "OUTPUT;follower.fmu;v;;v2\n"
        "LINK;lead.fmu;v;follower.fmu;disturbance\n"
    )
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.ERROR)
    settings = {f"default_auto_{what}": False for what in ("input", "output", "link")}
    assembly.Assembly("pair.csv", fmu_directory=folder, default_step_size=0.02, **settings).make_fmu(fmi_version=2)
    return folder / "pair.fmu"


def test_an_fmu_of_fmus(pair, run_both):
    block = FMU(pair)
    assert ([p.name for p in block.inputs], [p.name for p in block.outputs]) == (["force"], ["v1", "v2"])
    diagram = cosim.Diagram(dt=0.02)
    both = diagram.add(block, "pair")
    diagram.connect(diagram.add(cosim.Constant(100.0), "push")["y"], both["force"])
    result = run_both(diagram, 2)
    apart = cosim.Diagram(dt=0.02)
    lead, follower = (apart.add(FMU(fmus.path("CruiseControl")), name) for name in ("lead", "follower"))
    apart.connect(apart.add(cosim.Constant(100.0), "push")["y"], lead["force"])
    apart.connect(lead["v"], follower["disturbance"])
    wanted = apart.build("jacobi").simulate(2, engine="interpreted")
    np.testing.assert_allclose(result["pair.v1"], wanted["lead.v"], rtol=1e-12)
    np.testing.assert_allclose(result["pair.v2"], wanted["follower.v"], rtol=1e-12, atol=1e-15)


@pytest.fixture(scope="session")
def pendulum(tmp_path_factory):
    """Return a pendulum for model exchange as CasADi exports it: with its C sources, and no binary."""
    import casadi as ca

    try:
        compiler_command(host())
    except CompilerError as error:
        pytest.skip(f"what brings sources needs a compiler: {error}")
    dae = ca.DaeBuilder("pendulum")
    q, w, u, y = dae.add("q"), dae.add("w"), dae.add("u", "input"), dae.add("y", "output")
    for name, value in (("q", w), ("w", -9.81 * ca.sin(q) - 0.1 * w + u)):
        dae.eq(dae.der(dae.var(name)), value)
    dae.eq(y, q)
    dae.set_start("q", 0.5)
    folder, here = tmp_path_factory.mktemp("casadi"), os.getcwd()
    os.chdir(folder)  # it writes where one is
    try:
        exported = dae.export_fmu({"no_warning": True})
    finally:
        os.chdir(here)
    with zipfile.ZipFile(folder / "pendulum.fmu", "w") as archive:
        for name, place in exported.items():
            archive.write(folder / name, place.removeprefix("./"))
    return folder / "pendulum.fmu"


def test_a_model_with_sources_alone_is_compiled_and_integrated(pendulum):
    from scipy.integrate import solve_ivp

    assert describe(pendulum).platforms == ()
    diagram = cosim.Diagram(dt=0.05)
    diagram.add(FMU(pendulum, solver="scipy:RK45", rtol=1e-9), "p")
    result = diagram.simulate(2.0, engine="interpreted")

    def right(t, x):
        return [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1]]

    wanted = solve_ivp(right, (0, 2), [0.5, 0.0], t_eval=result.time, rtol=1e-11, atol=1e-12).y[0]
    np.testing.assert_allclose(result["p.y"], wanted, atol=1e-6)


def test_a_model_in_an_ssp(pendulum, tmp_path):
    diagram = cosim.Diagram(dt=0.05)
    diagram.add(FMU(pendulum, solver="scipy:RK45", parameters={"u": 0.5}), "p")
    opened = cosim.open_ssp(cosim.save_ssp(diagram, tmp_path / "pendulum.ssp"))
    assert opened["p"].block.kind == "model exchange"
    assert dict(opened["p"].block.parameters) == {"u": 0.5}  # the solver is the tool's, so SSP does not say it


@pytest.mark.slow
def test_a_controller_designed_from_nothing_but_the_model(pendulum):
    """The pendulum is held where it would not stay, with one of three sensors frozen; where it hangs is its rest."""
    controller = controllers.design(FMU(pendulum), measured="y", actuated="u", dt=0.05, sensors=3, sensor_std=0.02)
    loop = cosim.closed_loop(
        plant=FMU(pendulum, solver="scipy:RK45"),
        controller=controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=3, std=0.02),
        faults=[cosim.Freeze(sensor=1, start=2.0)],
        reference=cosim.Step(time=4.0, before=0.3, after=-0.2),
    )
    result = loop.simulate(10.0, seed=1, engine="interpreted")
    np.testing.assert_allclose(result["plant.y"][[79, 199]], [0.3, -0.2], atol=0.05)
    assert (result["controller.fault_probability"][-1] > 0.5).tolist() == [False, True, False]


@pytest.mark.parametrize("tool", EXPORTERS)
def test_what_they_say_of_themselves(lag, tool):
    description = describe(lag(tool))
    assert description.generation_tool.lower().startswith(tool.removesuffix("3"))
    assert description.kinds == ("coSimulation",)
    assert description.feedthrough == {"y": None}  # it does not say
    assert version(tool) in description.generation_tool


VALVE = """
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Integer


class Valve(Fmi2Slave):
    def __init__(self, **settings):
        super().__init__(**settings)
        self.is_open, self.count = False, 0
        self.register_variable(Boolean("is_open", causality=Fmi2Causality.output))
        self.register_variable(Integer("count", causality=Fmi2Causality.output))

    def do_step(self, now, step):
        self.count += 1
        self.is_open = self.count > 2
        return True
"""


def test_boolean_and_integer_variables_as_pythonfmu_writes_them(tmp_path):
    """It gives them no variability, which in FMI means continuous, as they cannot be."""
    builder = pytest.importorskip("pythonfmu.builder")
    (tmp_path / "valve.py").write_text(VALVE)
    path = builder.FmuBuilder.build_FMU(tmp_path / "valve.py", dest=tmp_path)
    with pytest.warns(UserWarning, match="must have variability != .*is_open|is_open.* must have variability != "):
        block = FMU(path)
    diagram = cosim.Diagram(dt=H)
    diagram.add(block, "p")
    result = diagram.simulate(0.4, engine="interpreted")
    np.testing.assert_array_equal(result["p.count"], [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(result["p.is_open"], [0, 0, 0, 1, 1])
