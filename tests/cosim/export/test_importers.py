"""Exported FMUs in other tools: tools written in C++ compute the bits of Python.

The masters of Ecos and libcosim are Jacobi masters: all FMUs make a step side by side, then outputs go along connections. So a
controller's output reaches the plant one step late. Before the first step both carry initial outputs along the connections.
"""

import logging
import re
import shutil
import subprocess
import zipfile
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from bayesftc import controllers, cosim, fmus

H, STEPS, V0 = 0.02, 400, 20.0
CAR = fmus.path("CruiseControl")
MODEL = controllers.LinearModel(
    A=[[0.999]], B=[[2e-4]], C=[[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt="1/50"
)
BRAIN = controllers.BayesianController(MODEL, precision=controllers.GammaPrecision(forgetting=0.95), initial_mean=V0)
SHOWN = ("u", "x_hat", "precision", "beta", "fault_probability")
SCALARS = ({"y[0]": "y1", "y[1]": "y2", "goal[0]": "goal"}, {"u[0]": "u", "precision[0]": "p1", "precision[1]": "p2"})


@pytest.fixture(scope="module")
def exported(tmp_path_factory, c_compiler):
    """Return the controller as FMUs: of FMI 2, of FMI 3 with arrays, and of FMI 3 without."""
    folder = tmp_path_factory.mktemp("exported")
    return {
        "2.0": cosim.export_fmu(BRAIN, folder / "Brain2.fmu", fmi="2.0"),
        "3.0": cosim.export_fmu(BRAIN, folder / "Brain3.fmu", fmi="3.0"),
        "scalars": cosim.export_fmu(BRAIN, folder / "Scalars.fmu", fmi="3.0", inputs=SCALARS[0], outputs=SCALARS[1]),
    }


@pytest.fixture(scope="module")
def readings():
    """Return what the sensors say at each step, some of it missing and one of them frozen in the middle, and the goal."""
    rng = np.random.default_rng(11)
    goal = 20.0 + 3.0 * np.sin(np.arange(STEPS) / 40)
    y = goal[:, np.newaxis] + rng.normal(size=(STEPS, 2))
    y[150:300, 0] = y[150, 0]
    y[rng.uniform(size=y.shape) < 0.05] = np.nan
    return y, goal


@pytest.fixture(scope="module")
def expected(readings):
    """Return what plain Python gives for them: the outputs of each step."""
    step = BRAIN.online(compiled=False)
    rows = [step(y=y, goal=[goal]) for y, goal in zip(*readings, strict=True)]
    return {name: np.array([row[name] for row in rows]) for name in SHOWN}


def references(path):
    return {v.name: v.valueReference for v in fmpy.read_model_description(str(path)).modelVariables}


@pytest.fixture(scope="module")
def libcosim():
    """Return the modules of libcosim, a C++ library that runs FMUs of FMI 2."""
    names = ("Execution", "Manipulator", "Observer", "Slave", "Logging")
    found = {name: pytest.importorskip(f"libcosimpy.Cosim{name}") for name in names}
    found["Logging"].log_output_level(found["Logging"].CosimLogLevel.ERROR)
    return found


class Libcosim:
    """A simulation by libcosim: FMUs by name, values by 'fmu.variable'."""

    def __init__(self, modules, paths, connections=(), start=None):
        self._whole = modules["Execution"].CosimExecution.from_step_size(round(H * 1e9))
        self._set = modules["Manipulator"].CosimManipulator.create_override()
        self._seen = modules["Observer"].CosimObserver.create_last_value()
        self._places = {}
        for name, path in paths.items():
            index = self._whole.add_local_slave(modules["Slave"].CosimLocalSlave(str(path), name))
            self._places |= {f"{name}.{variable}": (index, vr) for variable, vr in references(path).items()}
        for begin, end in connections:
            assert self._whole.connect_real_variables(*self._places[begin], *self._places[end]) == 0
        for variable, value in (start or {}).items():
            assert self._whole.real_initial_value(*self._places[variable], value)
        assert self._whole.add_manipulator(self._set)
        assert self._whole.add_observer(self._seen)

    def set(self, variable, value):
        index, reference = self._places[variable]
        assert self._set.slave_real_values(index, [reference], [value])

    def step(self):
        assert self._whole.step()

    def get(self, variable):
        index, reference = self._places[variable]
        return self._seen.last_real_values(index, [reference])[0]


class Ecos:
    """A simulation by Ecos, in the same words."""

    def __init__(self, module, paths, connections=(), start=None):
        structure = module.EcosSimulationStructure()
        for name, path in paths.items():
            structure.add_model(name, str(path))
        for begin, end in connections:
            structure.make_real_connection(begin.replace(".", "::"), end.replace(".", "::"))
        structure.add_parameter_set("start", {name.replace(".", "::"): v for name, v in (start or {}).items()})
        self._whole = module.EcosSimulation(structure=structure, step_size=H)
        self._whole.init(parameter_set="start")

    def set(self, variable, value):
        self._whole.set_real(variable.replace(".", "::"), value)

    def step(self):
        self._whole.step()

    def get(self, variable):
        return self._whole.get_real(variable.replace(".", "::"))


@pytest.fixture(params=["libcosim", "ecos"])
def tool(request):
    """Return what makes simulations of one of the tools."""
    kind = {"libcosim": Libcosim, "ecos": Ecos}[request.param]
    module = request.getfixturevalue(request.param)
    return lambda *given, **settings: kind(module, *given, **settings)


def elements(expected):
    """Return the columns of a signal by the names that they have in FMI 2."""
    for name, rows in expected.items():
        for index in np.ndindex(rows.shape[1:]):
            yield f"{name}[{','.join(map(str, index))}]", rows[(slice(None), *index)]


def fed_with(simulation, readings, names, goal, seen):
    """Return what comes out, step by step, for given readings."""
    rows = {name: [] for name in seen}
    for y, wanted in zip(*readings, strict=True):
        for name, value in zip(names, y, strict=True):
            simulation.set(name, value)
        simulation.set(goal, wanted)
        simulation.step()
        for name, row in rows.items():
            row.append(simulation.get(name))
    return rows


@pytest.mark.slow
def test_the_bits_of_python_for_the_same_readings(exported, tool, readings, expected, same_bits):
    wanted = {f"brain.{name}": rows for name, rows in elements(expected)}
    found = fed_with(tool({"brain": exported["2.0"]}), readings, ["brain.y[0]", "brain.y[1]"], "brain.goal[0]", wanted)
    assert len(found) == 8
    for name, rows in found.items():
        same_bits(np.array(rows), wanted[name], name)


def test_fmi_3_in_a_tool_that_knows_no_arrays(exported, ecos, readings, expected, same_bits):
    """Elements that are named one by one are variables of their own; of arrays Ecos reads a silent zero."""
    wanted = {"brain.u": expected["u"][:, 0], "brain.p1": expected["precision"][:, 0]}
    simulation = Ecos(ecos, {"brain": exported["scalars"]})
    found = fed_with(simulation, readings, ["brain.y1", "brain.y2"], "brain.goal", wanted)
    for name, rows in found.items():
        same_bits(np.array(rows), wanted[name], name)


def test_an_element_is_named_once(tmp_path):
    for names, words in (
        ({"y": "y", "y[0]": "first"}, "'first' of the export is part of another one"),
        ({"y[0]": "a", "y[1]": "a"}, "have one name"),
    ):
        with pytest.raises(cosim.ModelError, match=words):
            cosim.export_fmu(BRAIN, tmp_path / "it.fmu", inputs=names)
    with pytest.raises(cosim.UnknownNameError, match=re.escape("no input 'y[2]'")):
        cosim.export_fmu(BRAIN, tmp_path / "it.fmu", inputs=["y[2]"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_the_bits_of_python_in_fmpy(exported, instance, fmi, readings, expected, same_bits):
    it, found = instance(exported[fmi]).begin(), {name: [] for name in SHOWN}
    for k, (y, goal) in enumerate(zip(*readings, strict=True)):
        it.step(k, H, y=y, goal=goal)
        for name, rows in found.items():
            rows.append(it.get(name))
    for name, rows in found.items():
        same_bits(np.array(rows), expected[name], name)


def test_the_bits_of_python_in_an_fmu_of_fmus(exported, instance, tmp_path, readings, expected, same_bits):
    """A container runs FMUs in C; it is an FMU itself."""
    assembly = pytest.importorskip("fmu_manipulation_toolbox.assembly")
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.ERROR)
    shutil.copy(exported["2.0"], tmp_path / "brain.fmu")
    lines = ["rule;from_fmu;from_port;to_fmu;to_port"]
    lines += [f"INPUT;;{name};brain.fmu;{port}" for name, port in (("a", "y[0]"), ("b", "y[1]"), ("c", "goal[0]"))]
    lines += ["OUTPUT;brain.fmu;u[0];;control", "OUTPUT;brain.fmu;beta[1];;residual"]
    (tmp_path / "whole.csv").write_text("\n".join(lines) + "\n")
    settings = {f"default_auto_{what}": False for what in ("input", "output", "link")}
    assembly.Assembly("whole.csv", fmu_directory=tmp_path, default_step_size=H, **settings).make_fmu(fmi_version=2)
    it, found = instance(tmp_path / "whole.fmu").begin(), []
    for k, (y, goal) in enumerate(zip(*readings, strict=True)):
        it.step(k, H, a=y[0], b=y[1], c=goal)
        found.append([it.get("control")[0], it.get("residual")[0]])
    same_bits(np.array(found), np.column_stack([expected["u"][:, 0], expected["beta"][:, 1]]))


# Closed loops: the first sensor's readings and the goal are given, the second sensor is the speed itself.

LINKS = (("plant.v", "brain.y[1]"), ("brain.u[0]", "plant.force"))


@pytest.fixture(scope="module")
def given(readings):
    y, goal = readings
    first = np.where(np.isnan(y[:, 0]), V0, y[:, 0])
    return first, goal, np.random.default_rng(2).normal(scale=0.03, size=STEPS)


def diagram(brain, given, start_control=None, order=("plant", "brain")):
    """Return the loop; with a control to begin with, the control is delayed by a step."""
    first, goal, push = given
    whole = cosim.Diagram("1/50")
    blocks = {"plant": cosim.FMU(CAR, parameters={"v0": V0}), "brain": brain}
    nodes = {name: whole.add(blocks[name], name) for name in order}
    time = np.arange(STEPS) / 50
    tables = {
        name: whole.add(cosim.Table(time, rows, interpolate=False), name)["y"]
        for name, rows in (("first", first), ("goal", goal), ("push", push))
    }
    plant, brain = nodes["plant"], nodes["brain"]
    if isinstance(brain.block, cosim.FMU):
        control = brain["u[0]"]
        for port, source in (("y[0]", tables["first"]), ("y[1]", plant["v"]), ("goal[0]", tables["goal"])):
            whole.connect(source, brain[port])
    else:
        control = brain["u"]
        whole.connect([tables["first"], plant["v"]], brain["y"])
        whole.connect(tables["goal"], brain["goal"])
    if start_control is not None:
        delay = whole.add(cosim.UnitDelay(initial=start_control), "delay")
        whole.connect(control, delay["u"])
        control = delay["y"]
    whole.connect(control, plant["force"])
    whole.connect(tables["push"], plant["disturbance"])
    return whole


def speeds(whole, coupling="gauss-seidel"):
    return whole.build(coupling).simulate(STEPS * H, engine="interpreted")["plant.v"]


@pytest.fixture(scope="module")
def first_control(given):
    """Return the control for the readings at the start, with which a Jacobi master begins."""
    return float(BRAIN.online(compiled=False)(y=[given[0][0], V0], goal=given[1][:1])["u"][0])


@pytest.fixture(scope="module")
def late(given, first_control):
    """Return the speeds of the loop in Python whose control is one step late."""
    return speeds(diagram(BRAIN, given, first_control))


def start_of(given):
    """Return start values of the controller's inputs that are what initialization carries to them."""
    return {"y[0]": given[0][0], "y[1]": V0, "goal[0]": given[1][0]}


@pytest.fixture
def by_hand(exported, instance, given, first_control):
    """Return a master that calls FMI and does nothing else: the speeds, for an order of steps and their lengths."""

    def master(order, length=lambda k: H):
        plant, brain = instance(CAR), instance(exported["2.0"])
        plant.set(v0=V0)
        brain.set(y=[given[0][0], V0], goal=given[1][0])
        for each in (plant, brain):
            each.enter()
        plant.set(force=brain.get("u"))
        for each in (plant, brain):
            each.fmu.exitInitializationMode()
        assert brain.get("u")[0] == first_control
        found = [V0]
        for k, (first, goal, push) in enumerate(zip(*given, strict=True)):
            u, v = brain.get("u"), plant.get("v")[0]
            if order == "brain, plant":
                brain.set(y=[first, v], goal=goal)
                brain.fmu.doStep(k * H, length(k))
                u = brain.get("u")
            plant.set(force=u, disturbance=push)
            plant.fmu.doStep(k * H, length(k))
            if order != "brain, plant":
                v = plant.get("v")[0] if order == "plant, brain" else v
                brain.set(y=[first, v], goal=goal)
                brain.fmu.doStep(k * H, length(k))
            found.append(plant.get("v")[0])
        return np.array(found)

    return master


@pytest.mark.sampled(2)
@pytest.mark.parametrize("order", [("plant", "brain"), ("brain", "plant")])
def test_a_loop_in_a_tool_whose_control_is_a_step_late(exported, tool, given, late, by_hand, order, same_bits):
    paths = {name: {"plant": CAR, "brain": exported["2.0"]}[name] for name in order}
    start = {"plant.v0": V0, **{f"brain.{name}": value for name, value in start_of(given).items() if name != "y[1]"}}
    simulation, found = tool(paths, LINKS, start=start), [V0]
    for row in zip(*given, strict=True):
        for name, value in zip(("brain.y[0]", "brain.goal[0]", "plant.disturbance"), row, strict=True):
            simulation.set(name, value)
        simulation.step()
        found.append(simulation.get("plant.v"))
    np.testing.assert_allclose(found, late, rtol=1e-12)
    # libcosim counts nanoseconds, and gives the difference of two times as the step, which the car takes as it is.
    exact = (
        late if isinstance(simulation, Ecos) else by_hand("side by side", lambda k: (k + 1) * 2e7 / 1e9 - k * 2e7 / 1e9)
    )
    same_bits(np.array(found), exact)


def test_our_jacobi_mode_is_that_loop(exported, given, late, same_bits):
    """With outputs that are taken for those before the step, and start values that stand for what initialization carries."""
    brain = cosim.FMU(exported["2.0"], timing="plant", parameters=start_of(given))
    for order in (("plant", "brain"), ("brain", "plant")):
        same_bits(speeds(diagram(brain, given, order=order), "jacobi"), late)


def test_the_loop_goes_to_another_tool_as_a_system_structure(exported, ecos, tmp_path, same_bits):
    start = {"y[0]": V0, "y[1]": V0, "goal[0]": 22.0}
    loop = cosim.Diagram("1/50")
    plant = loop.add(cosim.FMU(CAR, parameters={"v0": V0}), "plant")
    brain = loop.add(cosim.FMU(exported["2.0"], timing="plant", parameters=start), "brain")
    for i in range(2):
        loop.connect(plant["v"], brain[f"y[{i}]"])
    loop.connect(brain["u[0]"], plant["force"])
    ours = loop.build("jacobi").simulate(100 * H, engine="interpreted")["plant.v"]
    path, found = cosim.save_ssp(loop, tmp_path / "loop.ssp"), []
    with ecos.EcosSimulation(ssp_path=str(path), step_size=H) as simulation:
        simulation.init(parameter_set="initialValues")
        for _ in range(101):
            found.append(simulation.get_real("plant::v"))
            simulation.step()
    same_bits(np.array(found), ours)


def test_a_controller_that_makes_its_step_first_is_on_time(exported, given, late, same_bits):
    """By the annotation in any order, and without it where it was added before the plant (Gauss-Seidel)."""
    wanted = speeds(diagram(BRAIN, given))
    assert abs(wanted - late).max() > 0.1
    for order in (("plant", "brain"), ("brain", "plant")):
        same_bits(speeds(diagram(cosim.FMU(exported["2.0"]), given, order=order)), wanted)
    as_plant = cosim.FMU(exported["2.0"], timing="plant")
    same_bits(speeds(diagram(as_plant, given, order=("brain", "plant"))), wanted)


@pytest.mark.parametrize("order", ["brain, plant", "plant, brain", "side by side"])
def test_masters_written_by_hand(by_hand, exported, given, late, order, same_bits):
    """This package's own modes, and Python's loop, are each order of steps."""
    as_plant = cosim.FMU(exported["2.0"], timing="plant", parameters=start_of(given))
    wanted = {
        "brain, plant": lambda: speeds(diagram(BRAIN, given)),
        "plant, brain": lambda: speeds(diagram(as_plant, given)),
        "side by side": lambda: late,
    }[order]()
    same_bits(by_hand(order), wanted)


# What the annotation says, and what comes of an importer that does not know it.


def without_annotation(path, target):
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                text, count = re.subn(
                    r"\s*<(Vendor)?Annotations>.*</(Vendor)?Annotations>", "", content.decode(), flags=re.S
                )
                assert count == 1
                content = text.encode()
            new.writestr(name, content)
    return target


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_without_the_annotation_outputs_come_a_step_late(exported, fmi, fed, tmp_path, given, same_bits):
    first, goal, _ = given
    plain = without_annotation(exported[fmi], tmp_path / "plain.fmu")
    assert validate_fmu(str(plain)) == []
    outputs = ["u[0]"] if fmi == "2.0" else ["u"]
    known, unknown = (cosim.FMU(path, outputs=outputs) for path in (exported[fmi], plain))
    told = cosim.FMU(plain, outputs=outputs, timing="sampled")
    assert (known.timing, unknown.timing) == ("sampled", "plant")
    ports = (
        {"y[0]": [first], "y[1]": [goal], "goal[0]": [goal]} if fmi == "2.0" else {"y": [first, goal], "goal": [goal]}
    )
    runs = []
    for block in (known, unknown, told):
        whole = fed(block, {name: np.array(rows) for name, rows in ports.items()})
        result = whole.simulate((STEPS - 1) * H, engine="interpreted")
        runs.append(result[f"block.{outputs[0]}"].reshape(STEPS))
    same_bits(runs[1][1:], runs[0][:-1])
    same_bits(runs[2], runs[0])


# The sources, by compilers other than those that the FMUs are built with.

SDK = """\
#include_next <math.h>
#ifndef _UCRT_NOISY_NAN
static inline float computed(void) { return 0.0f / 0.0f; }
#undef NAN
#define NAN (computed())
#endif
"""
"""What the Windows SDK 10.0.26100 does with NAN, which C99 has as a constant."""


def test_sources_where_nan_is_no_constant(tmp_path, c_compiler):
    source, _ = cosim.export_c(BRAIN, tmp_path, name="brain")
    assert re.search(r"static const .*\(double\)NAN", source.read_text(), re.S)
    (tmp_path / "sdk").mkdir()
    (tmp_path / "sdk" / "math.h").write_text(SDK)
    command = [c_compiler, "-std=c99", "-D_MSC_VER=1942", "-Isdk", "-c", "brain.c"]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr


@pytest.mark.sampled(1)
@pytest.mark.parametrize("options", ["-O0", "-O3 -march=native -ffp-contract=off"])
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_the_sources_in_an_fmu_make_it_anew(
    exported, instance, tmp_path, c_compiler, fmi, options, readings, expected, same_bits
):
    """As an importer does that finds no binary for its platform: all files that the description lists, and libm."""
    folder, anew = tmp_path / "sources of it", tmp_path / "anew.fmu"
    with zipfile.ZipFile(exported[fmi]) as old, zipfile.ZipFile(anew, "w") as new:
        old.extractall(folder)
        place, tag = (
            ("modelDescription.xml", "File") if fmi == "2.0" else ("sources/buildDescription.xml", "SourceFile")
        )
        listed = [each.get("name") for each in ET.fromstring(old.read(place)).iter(tag)]
        command = [c_compiler, *options.split(), "-shared", "-fPIC", *listed, "-o", "made.so", "-lm"]
        made = subprocess.run(command, cwd=folder / "sources", capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        for name in old.namelist():
            binary = name.startswith("binaries/")
            new.writestr(name, (folder / "sources" / "made.so").read_bytes() if binary else old.read(name))
    it, found = instance(anew).begin(), []
    for k, (y, goal) in enumerate(zip(*readings, strict=True)):
        it.step(k, H, y=y, goal=goal)
        found.append(it.get("u"))
    same_bits(np.array(found), expected["u"])
