"""What ``bayesftc inspect`` says that works, tried out."""

import dataclasses
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from bayesftc import cosim, fmus
from bayesftc.cli import output
from bayesftc.cli.inspection.elements import rows
from bayesftc.cli.inspection.verdicts import verdicts
from bayesftc.cosim.fmi.fmu import FMU, FMUVariable, describe

SHIPPED = {(name, fmi): fmus.path(name, fmi=fmi) for name in ("CruiseControl", "TwoLinkArm") for fmi in ("2.0", "3.0")}


def table(path):
    found = verdicts(Path(path), describe(path), validate=True)
    for verdict in found:
        assert verdict.works in {"yes", "no", "partly"}
        assert verdict.how.endswith(".")
    return {verdict.what: verdict for verdict in found}


def edited(source, target, *changes, drop=""):
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            for before, after in changes if name == "modelDescription.xml" else ():
                assert before.encode() in content
                content = content.replace(before.encode(), after.encode())
            if not drop or not name.startswith(drop):
                new.writestr(name, content)
    return target


def diagram_of(path):
    diagram = cosim.Diagram(dt=describe(path).default_experiment.get("stepSize", 0.1))
    diagram.add(FMU(path), "p")
    return diagram


@pytest.mark.parametrize("path", SHIPPED.values(), ids=lambda path: path.stem)
def test_what_works_with_shipped_plants_works(path, tmp_path):
    rows = table(path)
    wanted = {"model exchange": "no", "event mode": "no", "early return": "no"}
    assert {what: v.works for what, v in rows.items()} == {what: wanted.get(what, "yes") for what in rows}
    diagram = diagram_of(path)
    with diagram.start(engine="interpreted") as session:
        session.advance(diagram.step * 3)
        session.restore(session.save_state())
    cosim.save_ssp(diagram, tmp_path / "x.ssp")
    assert rows["inputs"].how == f"{len(FMU(path).inputs)} ports."


def test_what_cannot_be_saved_is_said(tmp_path):
    flags = [(f'{flag}="true"', "") for flag in ("canGetAndSetFMUstate", "canSerializeFMUstate")]
    path = edited(SHIPPED["CruiseControl", "2.0"], tmp_path / "x.fmu", *flags)
    rows = table(path)
    assert (rows["save and restore"].works, rows["iterated coupling"].works) == ("no", "no")
    assert "states as bytes" not in rows
    assert "from a new instance" in rows["a linear model of it"].how
    with diagram_of(path).start(engine="interpreted") as session, pytest.raises(cosim.BayesFTCError):
        session.save_state()


def test_platforms_instances_and_feedthrough(tmp_path):
    car = SHIPPED["CruiseControl", "2.0"]
    bare = table(edited(car, tmp_path / "bare.fmu", drop="binaries/"))["run on this machine"]
    assert (bare.works, "a C compiler builds one from its sources" in bare.how) == ("partly", True)
    both = edited(tmp_path / "bare.fmu", tmp_path / "empty.fmu", drop="sources/")
    assert table(both)["run on this machine"].works == "no"
    once = edited(car, tmp_path / "once.fmu", ('OnlyOncePerProcess="false"', 'OnlyOncePerProcess="true"'))
    assert table(once)["several instances"].works == "partly"
    told = edited(car, tmp_path / "told.fmu", ('dependencies=""', 'dependencies="1"'))
    assert "Direct feedthrough to v: use timing='sampled'" in table(told)["co-simulation"].how
    silent = edited(car, tmp_path / "silent.fmu", ('dependencies=""', ""))
    assert "does not state the direct feedthrough" in table(silent)["co-simulation"].how


def inspected(*arguments, width=80):
    command = [sys.executable, "-m", "bayesftc", "inspect", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "COLUMNS": str(width)}, check=True
    )
    return done.stdout


@pytest.mark.sampled(1)
@pytest.mark.parametrize("width", [80, 120])
def test_the_table_fits_the_terminal(width):
    text = inspected("TwoLinkArm", width=width)
    assert max(map(len, text.splitlines())) <= width
    for words in ("what works", "save and restore", "iterated coupling", "N.m.s/rad", "-1.570796327"):
        assert words in text


def test_long_names_are_not_broken(tmp_path):
    name = "vehicle.body.suspension.damper.coefficient"
    path = edited(SHIPPED["CruiseControl", "2.0"], tmp_path / "x.fmu", ('name="m"', f'name="{name}"'))
    (line,) = (line for line in inspected(str(path), width=80).splitlines() if name in line)
    assert line.split()[1:4] == ["parameter", "kg", "100.0"]


@pytest.mark.slow
def test_local_variables_are_shown_on_demand(tmp_path):
    attributes = 'name="hidden" valueReference="99" causality="local" variability="constant"'
    local = f'<ScalarVariable {attributes}><Real start="1"/></ScalarVariable></ModelVariables>'
    path = edited(SHIPPED["CruiseControl", "2.0"], tmp_path / "x.fmu", ("</ModelVariables>", local))
    assert "1 more (time and local variables): --all shows them." in inspected(str(path))
    assert "hidden" in inspected(str(path), "--all")


def test_json_has_the_verdicts():
    works = json.loads(inspected("CruiseControl", "--json"))["works"]
    assert works["co-simulation"] == {
        "works": "yes",
        "how": "as timing='plant', with its default step of 0.02 s.",
    }


@pytest.mark.parametrize(
    ("name", "words"), [("drive.csv", "bayesftc monitor"), ("mine.toml", "bayesftc run"), ("DRIVE.CSV", "monitor")]
)
def test_a_file_of_another_command_is_named_as_such(tmp_path, name, words, bayesftc_):
    (tmp_path / name).write_text("t,a,b\n0,1,2\n", encoding="utf-8")
    done = bayesftc_("inspect", str(tmp_path / name))
    said = " ".join(done.output.split())
    assert done.exit_code == 4
    assert "not an FMU" in said
    assert words in said
    assert "zip" not in said
    missing = bayesftc_("inspect", str(tmp_path / f"no{name}"))
    assert "not an FMU" not in missing.output


def test_elements_of_an_array_share_a_row():
    def variable(name, start=None, unit=None, description=None):
        return FMUVariable(name, "output", "continuous", "Real", start, unit, description, (), False, 0)

    matrix = [variable(f"R[{i},{j}]", description="A", start=1.0) for i in (1, 2) for j in (0, 1, 2)]
    gap = [variable(f"g[{i}]") for i in (0, 2)]
    units = [variable("y[0]", unit="m"), variable("y[1]", unit="rad")]
    starts = [variable(f"s[{i}]", start=float(i)) for i in (0, 1)]
    others = [variable("v"), variable("v"), variable("w[0].k")]
    shown = rows([*matrix, *gap, *units, *starts, *others], apart=False)
    names = ["R[1..2,0..2]", "g[0]", "g[2]", "y[0]", "y[1]", "s[0..1]", "v", "v", "w[0].k"]
    assert [(row[0], row[4]) for row in shown if row[4]] == [("R[1..2,0..2]", "1.0"), ("s[0..1]", "0.0, 1.0")]
    assert [row[0] for row in shown] == names
    assert len(rows([*matrix, *gap], apart=True)) == len(matrix) + len(gap)


def test_columns_that_no_variable_fills_are_left_out(capsys, monkeypatch):
    from bayesftc.cli.commands.fmus import inspect as module

    description = describe(fmus.path("CruiseControl"))
    without = dataclasses.replace(
        description, variables=tuple(dataclasses.replace(v, unit=None) for v in description.variables)
    )
    for each, has in ((description, True), (without, False)):
        module._print_variables(output.terminal(100), each, everything=False)
        assert (" unit " in capsys.readouterr().out) == has
