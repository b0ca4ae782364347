"""Finding the shipped FMUs, their descriptions, and the errors of a wrong request."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

import bayesftc
from bayesftc import fmus
from bayesftc.fmus.__main__ import main
from bayesftc.fmus.build import FMI_VERSIONS, own_files
from bayesftc.fmus.plants import PLANTS
from bayesftc.fmus.spec import Model, Variable

SHIPPED = [(plant, fmi) for plant in PLANTS for fmi in FMI_VERSIONS]


def test_path_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for fmi in FMI_VERSIONS:
        path = fmus.path("CruiseControl", fmi=fmi)
        assert path.is_absolute()
        assert zipfile.is_zipfile(path)
        assert read_model_description(path).fmiVersion == fmi
    assert fmus.path("CruiseControl") == fmus.path("CruiseControl", fmi="2.0")


def test_names_are_the_files():
    folder = fmus.path("CruiseControl").parent
    assert sorted(p.name for p in folder.glob("*.fmu")) == sorted(
        fmus.path(n, fmi=v).name for n in fmus.names() for v in FMI_VERSIONS
    )


def test_an_unknown_name_names_the_near_ones():
    shipped = ", ".join(fmus.names())
    with pytest.raises(
        ValueError, match=rf"'cruisecontroll'.*did you mean 'CruiseControl'\?.*Shipped FMUs: {shipped}\."
    ):
        fmus.path("cruisecontroll")
    with pytest.raises(ValueError, match=r"is shipped\. Shipped FMUs") as caught:
        fmus.path("Submarine")
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize("fmi", ["1.0", "2", "", None, 3.0])
def test_an_unknown_version_is_an_error(fmi):
    with pytest.raises(ValueError, match=r"fmi='2\.0' or fmi='3\.0'"):
        fmus.path("CruiseControl", fmi=fmi)


def test_the_version_is_keyword_only():
    with pytest.raises(TypeError):
        fmus.path("CruiseControl", "3.0")


def test_import_is_light():
    code = (
        "import sys; from bayesftc import fmus; fmus.path(fmus.names()[0]); "
        "print(sorted({'numpy', 'fmpy', 'lxml', 'numba'} & set(sys.modules)))"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(bayesftc.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == "[]"


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("plant", "fmi"), SHIPPED)
def test_shipped_fmus_are_valid(plant, fmi):
    path = fmus.path(plant.name, fmi=fmi)
    assert validate_fmu(str(path)) == []
    assert path.stat().st_size < 120_000


@pytest.mark.parametrize(("plant", "fmi"), SHIPPED)
def test_shipped_fmus_are_built_from_the_present_sources(plant, fmi):
    with zipfile.ZipFile(fmus.path(plant.name, fmi=fmi)) as archive:
        for name, content in own_files(plant, fmi=fmi).items():
            assert archive.read(name) == content, (
                f"{name} changed: run 'python -m bayesftc.fmus build' and commit the FMUs"
            )


@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_headers_keep_their_licence(fmi):
    with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as archive:
        headers = [
            name for name in archive.namelist() if name.startswith(f"sources/fmi{fmi[0]}") and name.endswith(".h")
        ]
        assert len(headers) == 3
        for name in headers:
            assert b"Redistributions in binary form must reproduce the above copyright notice" in archive.read(name)


@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_description_of_the_car(fmi):
    description = read_model_description(fmus.path("CruiseControl", fmi=fmi))
    variables = {v.name: v for v in description.modelVariables}
    assert {n: (v.causality, v.unit, v.start) for n, v in variables.items() if n != "time"} == {
        "force": ("input", "N", "0.0"),
        "disturbance": ("input", "m/s", "0.0"),
        "v": ("output", "m/s", None),
        "b": ("parameter", "N.s/m", "5.0"),
        "m": ("parameter", "kg", "100.0"),
        "v0": ("parameter", "m/s", "0.0"),
    }
    assert ("time" in variables) == (fmi == "3.0")
    (output,), (unknown,) = description.outputs, description.initialUnknowns
    assert (output.variable.name, output.dependencies) == ("v", [])
    assert (unknown.variable.name, [v.name for v in unknown.dependencies]) == ("v", ["v0"])
    base = {u.name: (u.baseUnit.kg, u.baseUnit.m, u.baseUnit.s) for u in description.unitDefinitions}
    assert base == {"s": (0, 0, 1), "N": (1, 1, -2), "m/s": (0, 1, -1), "N.s/m": (1, 0, -1), "kg": (1, 0, 0)}
    can = description.coSimulation
    assert (can.canGetAndSetFMUstate, can.canSerializeFMUstate, can.canHandleVariableCommunicationStepSize) == (
        True,
    ) * 3
    assert not can.canBeInstantiatedOnlyOncePerProcess
    assert description.generationDateAndTime.endswith("Z")


@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_description_of_the_arm(fmi):
    description = read_model_description(fmus.path("TwoLinkArm", fmi=fmi))
    variables = {v.name: v for v in description.modelVariables}
    units = {"q1": "rad", "dq2": "rad/s", "torque1": "N.m", "x": "m", "I1": "kg.m2", "D2": "N.m.s/rad", "g": "m/s2"}
    assert {name: variables[name].unit for name in units} == units
    base = {u.name: tuple(getattr(u.baseUnit, n) for n in ("kg", "m", "s", "rad")) for u in description.unitDefinitions}
    assert base["N.m"] == (1, 2, -2, 0)
    assert base["N.m.s/rad"] == (1, 2, -1, -1)
    assert base["rad/s"] == (0, 0, -1, 1)
    assert {o.variable.name: o.dependencies for o in description.outputs} == {
        name: [] for name in ("q1", "q2", "dq1", "dq2", "x", "y")
    }
    assert {u.variable.name: {v.name for v in u.dependencies} for u in description.initialUnknowns} == {
        **{name: {f"{name}_0"} for name in ("q1", "q2", "dq1", "dq2")},
        **{name: {"L1", "L2", "q1_0", "q2_0"} for name in ("x", "y")},
    }


def test_command_line_lists_and_refuses(capsys, tmp_path):
    assert main(["list"]) == 0
    assert capsys.readouterr().out.split() == list(fmus.names())
    assert main(["build", "CruseControl", "--out", str(tmp_path)]) == 1
    assert "did you mean 'CruiseControl'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


V = Variable("v", "output", "Velocity")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Variable("a b", "input", ""), "not valid"),
        (lambda: Variable("a", "input", "", start=float("nan")), "not finite"),
        (lambda: Variable("a", "input", "", variability="fixed"), "cannot be fixed"),
        (lambda: Variable("a", "input", "", dependencies=("b",)), "only an output"),
        (lambda: Model("a-b", "", Path("a.c"), (V,), step=1.0), "no C identifier"),
        (lambda: Model("a", "", Path("a.c"), (V,), step=0.0), "step size"),
        (lambda: Model("a", "", Path("a.c"), (V, V), step=1.0), "has the C name X_v"),
        (lambda: Model("a", "", Path("a.c"), (Variable("time", "input", ""),), step=1.0), "Rename"),
        (
            lambda: Model("a", "", Path("a.c"), (Variable("y", "output", "", dependencies=("v",)), V), step=1.0),
            "neither",
        ),
    ],
)
def test_a_description_that_cannot_be_is_an_error(make, message):
    with pytest.raises(ValueError, match=message):
        make()
