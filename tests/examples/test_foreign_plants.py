"""Plants from other tools, from the file to a loop that tracks while a sensor fails; and what cannot be controlled."""

import importlib
import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers.models.linearization import linearize
from bayesftc.cosim import ModelError
from bayesftc.examples.foreign_fmus import closed_loops
from bayesftc.examples.foreign_fmus.makers import MAKERS, MissingTool
from bayesftc.fmus._compiler import CompilerError, compiler_command
from bayesftc.fmus._platforms import host

CASES = {case.tool: case for case in closed_loops.CASES}
OF_PACKAGES = ("gemseo-fmu", "qfmu")  # whose own demands would change what is installed here


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Return what makes the FMU of a tool, once."""
    files = {}

    def make(tool):
        if tool == "CasADi":
            try:
                compiler_command(host())
            except CompilerError as error:
                pytest.skip(f"what brings sources alone needs a compiler: {error}")
        if tool not in files:
            try:
                files[tool] = MAKERS[tool](tmp_path_factory.mktemp(tool))
            except MissingTool as missing:
                pytest.skip(str(missing))
        return files[tool]

    return make


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tool", CASES)
def test_from_the_file_to_a_loop_that_tracks(made, tool, capsys):
    """Of the two sensors one fails; the loop holds its goal, and says which one it was."""
    file, case = made(tool), CASES[tool]
    inspected = subprocess.run(
        [sys.executable, "-m", "bayesftc", "inspect", str(file), "--json"], capture_output=True, text=True, check=True
    )
    variables = {v["name"]: v["causality"] for v in json.loads(inspected.stdout)["variables"]}
    assert (variables[case.actuated], variables[case.measured]) == ("input", "output")
    errors = closed_loops.main(runs=3, cases=(case,))
    tolerant, without, oracle = (errors[tool, way] for way in closed_loops.WAYS)
    assert tolerant < 0.6 * without
    assert tolerant < 1.15 * oracle
    printed = capsys.readouterr().out
    blamed = json.loads(printed[printed.index("[") : printed.index("]") + 1])
    assert blamed[case.fault.sensor] > 0.95 > 0.05 > blamed[1 - case.fault.sensor]


@pytest.mark.slow
def test_fmus_out_of_packages(tmp_path, monkeypatch):
    """An FMU that OpenModelica has exported, and one that is made on the command line; packages without what they demand."""
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(tmp_path), *OF_PACKAGES]
    if subprocess.run(install, capture_output=True, check=False).returncode:
        pytest.skip(f"no package index can be reached for {' and '.join(OF_PACKAGES)}")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    cases = tuple(CASES[tool] for tool in ("OpenModelica", "qfmu"))
    errors = closed_loops.main(runs=2, cases=cases)
    for case in cases:
        tolerant, without, oracle = (errors[case.tool, way] for way in closed_loops.WAYS)
        assert tolerant < 0.6 * without
        assert tolerant < 1.15 * oracle


def test_a_tool_that_is_missing_is_named(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert closed_loops.main(runs=1, cases=(CASES["qfmu"],)) == {}
    assert "qfmu is not installed. Install it with: python -m pip install --no-deps qfmu" in capsys.readouterr().out
    for maker in MAKERS.values():
        with pytest.raises(MissingTool, match="python -m pip install"):
            maker(tmp_path)


# --- what cannot be controlled ---------------------------------------------------------------------------------------

HEAD = """
from pythonfmu import Fmi2Causality as C, Fmi2Slave, Real

class {name}(Fmi2Slave):
    def __init__(self, **settings):
        super().__init__(**settings)
        self.u = self.y = self.x = self.z = 0.0
        for name, causality in {variables}:
            self.register_variable(Real(name, causality=causality))

    def do_step(self, now, step):
        {body}
        return True
"""


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    """Return what exports a plant from its equations by PythonFMU."""
    builder = pytest.importorskip("pythonfmu.builder")

    def write(name, body, inputs=("u",), outputs=("y",)):
        folder = tmp_path_factory.mktemp(name)
        variables = ", ".join([*(f'("{n}", C.input)' for n in inputs), *(f'("{n}", C.output)' for n in outputs)])
        text = HEAD.format(name=name, variables=f"[{variables}]", body=body)
        (folder / f"{name.lower()}.py").write_text(text)
        return Path(builder.FmuBuilder.build_FMU(folder / f"{name.lower()}.py", dest=folder))

    return write


def refused(file, *parts, measured="y", actuated="u", **options):
    with pytest.raises(ModelError) as caught:
        controllers.design(cosim.FMU(file), measured=measured, actuated=actuated, dt=0.1, sensors=2, **options)
    for part in parts:
        assert part in str(caught.value), str(caught.value)
    assert str(caught.value).endswith((".", "?"))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_without_an_input(written):
    file = written("Alone", "self.y += step * (1.0 - self.y)", inputs=())
    refused(file, "The FMU 'alone' has no input that could control it", "`bayesftc monitor`")


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_without_an_output(written):
    file = written("Blind", "self.x += step * (self.u - self.x)", outputs=())
    refused(file, "The FMU 'blind' has no output that a sensor could measure", "it has none either")


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_input_that_moves_nothing(written):
    file = written("Unmoved", "self.y += step * (1.0 - self.y)")
    refused(file, "No input moves any of the outputs; actuate other inputs")


@pytest.fixture
def equations(tmp_path, monkeypatch):
    """Return what exports a model exchange FMU by CasADi from the rates of its states, and its output y."""
    ca = pytest.importorskip("casadi")
    try:
        compiler_command(host())
    except CompilerError as error:
        pytest.skip(f"what brings sources alone needs a compiler: {error}")

    def export(rates, output):
        dae = ca.DaeBuilder("plant")
        known = {name: dae.add(name) for name in rates}
        known["u"] = dae.add("u", "input")
        for name, rate in rates.items():
            dae.eq(dae.der(dae.var(name)), rate(**known))
        dae.eq(dae.add("y", "output"), output(**known))
        monkeypatch.chdir(tmp_path)  # CasADi writes where one is
        with zipfile.ZipFile(tmp_path / "plant.fmu", "w") as archive:
            for name, place in dae.export_fmu({"no_warning": True}).items():
                archive.write(tmp_path / name, place.removeprefix("./"))
        return tmp_path / "plant.fmu"

    return export


def test_without_a_state(equations):
    file = equations({}, lambda u: 3 * u)
    refused(file, "The FMU 'plant' has no state. Its outputs depend directly on its inputs (a relative degree of 0)")


def test_an_output_that_depends_at_once_on_the_input(equations):
    file = equations({"x": lambda x, u: u - x}, lambda x, u: x + u)
    refused(file, "D is not 0, a relative degree of 0")


def test_a_mode_that_grows_and_no_control_moves(equations):
    file = equations({"x": lambda x, z, u: u - x + z, "z": lambda x, z, u: 0.5 * z}, lambda x, z, u: x)
    refused(
        file,
        "cannot be stabilised: no control moves the mode with the eigenvalue 1.05127, which grows by 5.13 % a sample",
    )


def test_a_mode_that_grows_and_no_sensor_sees(equations):
    file = equations({"x": lambda x, z, u: u - x, "z": lambda x, z, u: 0.5 * z + u}, lambda x, z, u: x)
    refused(file, "cannot be estimated: no sensor sees the mode with the eigenvalue 1.05127")


def test_an_unstable_zero_is_controlled(equations):
    """The output first moves the other way; a law that pays for its control never inverts the plant."""
    file = equations({"x": lambda x, z, u: z, "z": lambda x, z, u: u - x - 2 * z}, lambda x, z, u: x - z)
    plant = cosim.FMU(file)
    controller = controllers.design(plant, measured="y", actuated="u", dt=0.1, sensors=2, sensor_std=0.01)
    loop = cosim.closed_loop(
        plant=plant,
        controller=controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=0.01),
        faults=[cosim.Injection(sensor=0, start=10.0, magnitude=0.5)],
        reference=1.0,
    )
    y = loop.simulate(30.0, seed=1)["plant.y"]
    assert y.min() < -0.05
    np.testing.assert_allclose(y[-50:], 1.0, atol=0.05)


def test_a_control_without_effect_where_the_plant_rests():
    """As a spring's stiffness where the spring is not stretched."""
    linear = linearize(fmus.path("PositionServo"), measured="angle", actuated="voltage")
    still = replace(linear, B=np.full_like(linear.B, 1e-18))
    from bayesftc.controllers.models.linearization import refuse_unmoved

    refuse_unmoved(linear, ["voltage"])
    with pytest.raises(
        ModelError, match="voltage has no effect about the operating point, so it cannot control the plant"
    ):
        refuse_unmoved(still, ["voltage"])


@pytest.mark.filterwarnings("ignore:The plant:UserWarning")
def test_a_plant_whose_own_solver_runs_away(made):
    """OpenModelica's co-simulation takes one Euler step for each communication step: too long for this spring."""
    file = made("OpenModelica")
    with pytest.warns(
        controllers.ModelMismatchWarning, match="y grows without bound in the plant, but not in the model.*shorter dt"
    ):
        controllers.design(cosim.FMU(file), measured="y", actuated="f", dt=0.02, sensors=2)
