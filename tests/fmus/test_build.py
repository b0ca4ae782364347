"""Building: reproducible, self-contained, and the same contract for a model that is not a plant."""

import random
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from bayesftc import fmus
from bayesftc.fmus import _compiler
from bayesftc.fmus.__main__ import main
from bayesftc.fmus._compiler import why_no_compiler
from bayesftc.fmus._platforms import host
from bayesftc.fmus.build import FMI_VERSIONS, CompilerError, build_fmu
from bayesftc.fmus.plants import CRUISE_CONTROL, TWO_LINK_ARM
from bayesftc.fmus.spec import Model, Variable

needs_compiler = pytest.mark.skipif(bool(why_no_compiler()), reason=why_no_compiler() or "there is a compiler")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build both FMUs twice, once through the command line."""
    folders = [tmp_path_factory.mktemp("one"), tmp_path_factory.mktemp("two") / "new"]
    for fmi in FMI_VERSIONS:
        build_fmu(CRUISE_CONTROL, folders[0], fmi=fmi)
    assert main(["build", "CruiseControl", "--here", "--out", str(folders[1])]) == 0
    return folders


@pytest.mark.slow
@needs_compiler
def test_building_twice_gives_the_same_bytes(built):
    one, two = built
    assert sorted(p.name for p in one.iterdir()) == ["CruiseControl.fmu", "CruiseControl_fmi3.fmu"]
    for path in one.iterdir():
        assert path.read_bytes() == (two / path.name).read_bytes()
        assert str(one.parent).encode() not in path.read_bytes()


@needs_compiler
@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_a_rebuilt_fmu_behaves_as_the_shipped_one(built, fmi):
    shipped = fmus.path("CruiseControl", fmi=fmi)
    rng = random.Random(11)
    rows = [(0.02 * k, rng.uniform(-1e3, 1e3), rng.gauss(0.0, 0.03)) for k in range(1001)]
    signals = np.array(rows, dtype=[("time", float), ("force", float), ("disturbance", float)])

    def run(path):
        return simulate_fmu(
            str(path), stop_time=20.0, output_interval=0.02, input=signals, start_values={"v0": 5.0}, output=["v"]
        )["v"]

    old, new = run(shipped), run(built[0] / shipped.name)
    assert len(new) == 1001
    assert len(set(new)) > 900
    assert np.array_equal(old, new)


@pytest.mark.sampled(1)
@needs_compiler
@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_an_arm_by_another_compiler_has_the_same_bits(tmp_path, fmi):
    start, names = {"torque1": 60.0, "torque2": -20.0, "q2_0": 1.3, "dq1_0": -2.0}, ["q1", "q2", "dq1", "dq2", "x", "y"]
    old, new = (
        simulate_fmu(str(path), stop_time=1.0, output_interval=0.005, start_values=start, output=names)
        for path in (fmus.path("TwoLinkArm", fmi=fmi), build_fmu(TWO_LINK_ARM, tmp_path, fmi=fmi))
    )
    for name in names:
        assert np.ptp(old[name]) > 0.1
        assert np.array_equal(old[name], new[name])


def test_sine_and_cosine_of_plants_are_those_of_step_functions():
    """The header is what the translator writes of `cosim.elementary`."""
    root = Path(__file__).resolve().parents[2]
    tool = runpy.run_path(str(root / "tools" / "elementary.py"))
    assert tool["HEADER"].read_text(encoding="utf-8") == tool["header"](), "python tools/elementary.py"


@needs_compiler
@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_the_sources_inside_compile_on_their_own(tmp_path, fmi):
    unzipped = Path(extract(fmus.path("CruiseControl", fmi=fmi), str(tmp_path / "fmu")))
    (configuration,) = read_model_description(unzipped).buildConfigurations
    (files,) = configuration.sourceFileSets
    library = tmp_path / "car.so"
    command = [
        *_compiler.compiler_command(host()),
        "-std=c99",
        "-fPIC",
        "-shared",
        "-I.",
        *files.sourceFiles,
        "-o",
        str(library),
    ]
    done = subprocess.run(command, cwd=unzipped / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert library.stat().st_size > 0


def test_a_missing_compiler_is_one_clear_sentence(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(_compiler.shutil, "which", lambda name: None)
    monkeypatch.setattr(_compiler.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CompilerError, match=r"No C compiler for .* was found .*'pip install ziglang'\.$"):
        _compiler.compiler_command(host())


def test_the_compiler_is_looked_for_in_order(monkeypatch):
    monkeypatch.setenv("CC", "my-cc -pipe")
    monkeypatch.setattr(_compiler.shutil, "which", lambda name: name if name in {"my-cc", "clang"} else None)
    assert _compiler.compiler_command(host()) == ["my-cc", "-pipe"]
    monkeypatch.setenv("CC", "other-cc")
    with pytest.raises(CompilerError, match="CC names the compiler 'other-cc'"):
        _compiler.compiler_command(host())
    monkeypatch.delenv("CC")
    assert _compiler.compiler_command(host()) == ["clang"]
    monkeypatch.setattr(_compiler.shutil, "which", lambda name: None)
    monkeypatch.setattr(_compiler.importlib.util, "find_spec", lambda name: object())
    assert _compiler.compiler_command(host())[:4] == [sys.executable, "-m", "ziglang", "cc"]


# A model that uses what the car does not: hidden state, direct feedthrough, a tunable parameter, a local variable, a
# name with brackets, a library, a fixed step, a step that can fail. It is what an exported controller looks like.
LEAKY = r"""
#include <math.h>
#include "model.h"

void model_initialize(double *x)
{
    x[X_HIDDEN] = x[X_y_1_];
    x[X_HIDDEN + 1] = 0.0;
    x[X_u] = 0.0;
    x[X_size] = 0.0;
}

int model_step(double *x, double h)
{
    if (x[X_y_1_] > 1e6) {
        return 42;
    }
    x[X_HIDDEN] += h * x[X_y_1_];
    x[X_HIDDEN + 1] += x[X_TIME];
    x[X_u] = x[X_gain] * x[X_y_1_] + x[X_HIDDEN];
    x[X_size] = sqrt(fabs(x[X_HIDDEN + 1]));
    return 0;
}
"""


def leaky(folder):
    source = folder / "leaky.c"
    source.write_text(LEAKY)
    return Model(
        name="Leaky",
        description="An integrator with feedthrough",
        source=source,
        variables=(
            Variable("y[1]", "input", "Measurement", start=2.0, variability="discrete"),
            Variable("gain", "parameter", "Gain", start=3.0, variability="tunable"),
            Variable("u", "output", "Control", variability="discrete", dependencies=("y[1]", "gain")),
            Variable("size", "local", "A number to look at", variability="discrete"),
        ),
        step=0.5,
        fixed_step=True,
        hidden=2,
        timing="sampled",
        libraries=("m",),
    )


@pytest.mark.sampled(1)
@needs_compiler
@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_the_wrappers_take_any_model_that_keeps_the_contract(tmp_path, fmi):
    path = build_fmu(leaky(tmp_path), tmp_path, fmi=fmi)
    assert validate_fmu(str(path)) == []
    description = read_model_description(path)
    (output,) = description.outputs
    assert [v.name for v in output.dependencies] == ["y[1]", "gain"]
    assert not description.coSimulation.canHandleVariableCommunicationStepSize

    unzipped = extract(path, str(tmp_path / "fmu"))
    slave_class = FMU2Slave if fmi == "2.0" else FMU3Slave
    slave = slave_class(guid=description.guid, unzipDirectory=unzipped, modelIdentifier="Leaky", instanceName="one")
    slave.instantiate()
    get, put = (slave.getReal, slave.setReal) if fmi == "2.0" else (slave.getFloat64, slave.setFloat64)
    if fmi == "2.0":
        slave.setupExperiment(startTime=1.0)
        slave.enterInitializationMode()
    else:
        slave.enterInitializationMode(startTime=1.0)
    slave.exitInitializationMode()

    def run():
        for k in range(4):
            put([0, 1], [float(k), 10.0 * k])  # an input, and a tunable parameter between steps
            slave.doStep(1.0 + 0.5 * k, 0.5)
        return get([0, 1, 2, 3])

    state = slave.getFMUState()
    last = run()
    # The hidden state started as y(0) = 2 and has gained .5 (0 + 1 + 2 + 3); the times 1, 1.5, 2, 2.5 sum to 7.
    assert last == [3.0, 30.0, 30.0 * 3.0 + 5.0, 7.0**0.5]
    slave.setFMUState(state)
    assert run() == last
    slave.setFMUState(state)
    with pytest.raises(FMICallException):
        slave.doStep(1.0, 0.25)
    slave.setFMUState(state)
    put([0], [2e6])
    with pytest.raises(FMICallException):
        slave.doStep(1.0, 0.5)
    slave.freeFMUState(state)
    slave.freeInstance()


@needs_compiler
def test_a_source_that_does_not_compile_shows_the_compilers_words(tmp_path):
    model = leaky(tmp_path)
    model.source.write_text("int model_step(double *x, double h) { return no_such_name; }\n")
    with pytest.raises(CompilerError, match=r"(?s)failed with fmi2\.c, Leaky\.c:.*no_such_name"):
        build_fmu(model, tmp_path / "out")
    assert not (tmp_path / "out").exists()
