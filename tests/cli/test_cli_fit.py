"""``bayesftc fit``: what it prints and writes, and what a wrong command line says."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim, fmus

OPTIONS = ("--parameter", "m=50:200", "--parameter", "b=1:20", "--input", "force=u", "--output", "v=v1,v2")


@pytest.fixture
def drive(tmp_path):
    diagram = cosim.Diagram(dt=0.1)
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 110.0, "b": 6.0}), "car")
    force = diagram.add(cosim.PRBS(300.0, 4.0, offset=200.0), "force")
    diagram.connect(force["y"], car["force"])
    run = diagram.simulate(30.0)
    v1, v2 = run["car.v"] + 0.2 * np.random.default_rng(0).standard_normal((2, len(run.time)))
    v2[100:160] = np.nan
    file = tmp_path / "drive.csv"
    pd.DataFrame({"time": run.time, "u": run["force.y"], "v1": v1, "v2": v2}).to_csv(file, index=False)
    return file


def test_it_prints_and_writes_the_fit(bayesftc_, drive, tmp_path):
    done = bayesftc_("fit", "CruiseControl", drive, *OPTIONS, "--out", "results")
    assert done.exit_code == 0, done.output
    assert "standard error" in done.stdout
    assert "Written to results: fit.json, figure.png" in done.stdout
    numbers = json.loads((tmp_path / "results" / "fit.json").read_text())
    for name, true in (("m", 110.0), ("b", 6.0)):
        row = numbers["parameters"][name]
        assert abs(row["value"] - true) < 3 * row["std"]
    assert numbers["parameters"]["m"]["unit"] == "kg"
    assert numbers["sensors"]["v2"]["samples"] == 241
    assert (tmp_path / "results" / "figure.png").stat().st_size > 10_000
    assert bayesftc_("fit", "CruiseControl", drive, *OPTIONS, "--out", "results", "--quiet").stdout == ""


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_column_of_times_is_found_with_its_unit(bayesftc_, drive):
    in_seconds = json.loads(bayesftc_("fit", "CruiseControl", drive, *OPTIONS, "--json").stdout)
    table = pd.read_csv(drive)
    table.assign(time=1000 * table["time"]).rename(columns={"time": "t_ms"}).to_csv(drive, index=False)
    done = bayesftc_("fit", "CruiseControl", drive, *OPTIONS, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout) == in_seconds


def test_json_has_null_where_there_is_no_number(bayesftc_, drive):
    done = bayesftc_(
        "fit", "CruiseControl", drive, *OPTIONS, "--parameter", "v0=5:9", "--json", "--held-out", 0, "--all-samples"
    )
    numbers = json.loads(done.stdout)
    assert numbers["parameters"]["v0"]["std"] is None  # it is 0, below the range
    assert numbers["sensors"]["v1"]["held_out"] is None
    assert any("lower bound" in sentence for sentence in numbers["sentences"])


def test_an_undetermined_parameter_has_no_standard_error(bayesftc_, drive):
    still = pd.read_csv(drive).rename(columns={"u": "force"})
    still[["v1", "v2"]] = 0.1 * np.sin(np.outer(np.arange(len(still)), [1.0, 2.0]))
    still.to_csv(drive, index=False)
    done = bayesftc_("fit", "CruiseControl", drive, "--parameter", "m=50:200", "--output", "v=v1,v2", "--all-samples")
    assert "not determined" in done.stdout
    assert "--input force" in done.stderr


@pytest.mark.slow
def test_values_that_stand_for_no_sample_do_not_count(bayesftc_, drive):
    """The fit is that of empty cells, whether a value holds for one column or a text for all."""
    table = pd.read_csv(drive)
    arguments = ("fit", "CruiseControl", drive, *OPTIONS, "--json")
    table.loc[40:60, "v1"] = np.nan
    table.to_csv(drive, index=False)
    expected = json.loads(bayesftc_(*arguments).stdout)
    table.loc[40:60, "v1"] = 1372.0
    table["v2"] = table["v2"].astype(object).where(table["v2"].notna(), " Bad Input")
    table.to_csv(drive, index=False)
    done = bayesftc_(*arguments, "--invalid", "v1=1372", "--invalid", "Bad Input")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["parameters"]["m"]["value"] == pytest.approx(expected["parameters"]["m"]["value"], rel=1e-9)
    assert found["sensors"]["v1"] == expected["sensors"]["v1"]
    done = bayesftc_(*arguments, "--invalid", "w1=1372")
    assert done.exit_code != 0
    assert "no column 'w1' for --invalid; known names: time, u, v1, v2" in " ".join(done.output.split())


def test_the_option_for_uneven_times_is_named(bayesftc_, drive):
    table = pd.read_csv(drive)
    table.drop(table.index[3]).assign(time=lambda rows: rows["time"] + 0.03 * (rows.index % 2)).to_csv(drive)
    done = bayesftc_("fit", "CruiseControl", drive, *OPTIONS)
    assert done.exit_code == 8
    assert re.search(r"not evenly spaced: .* Give --dt 0\.\d+, the usual step", " ".join(done.output.split()))


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("CruiseControl", "no.csv", *OPTIONS), 16, "cannot be read"),
        (("CruiseContrl", "drive.csv", *OPTIONS), 4, "did you mean 'CruiseControl'"),
        (("no.fmu", "drive.csv", *OPTIONS), 4, "no.fmu"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "v0"), 2, "Write NAME=LOW:HIGH."),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "v0=3"), 2, "LOW:HIGH"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "m=1:2"), 2, "twice"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "v0=3:1"), 9, "low < high"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "v_0=1:3"), 5, "did you mean 'v0'"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "mass=1:3"), 5, "known names: b, m, v0."),
        (("CruiseControl", "drive.csv", *OPTIONS, "--output", "slope=p9"), 5, "has no column 'p9' for an output"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--input", "push=u"), 5, "no input 'push'"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--output", "w=v1"), 9, "twice"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--time", "t"), 8, "no column 't'"),
        (
            ("CruiseControl", "drive.csv", *OPTIONS, "--time", "t"),
            8,
            "(--time ...), or --dt in seconds. Its columns: time, u,",
        ),
        (("CruiseControl", "drive.csv", *OPTIONS, "--held-out", 2), 9, "has --held-out 2.0"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--parameter", "force=1:2"), 4, "it among --input with"),
        (("CruiseControl", "drive.csv", *OPTIONS, "--out", "drive.csv"), 12, "is a file"),
    ],
)
def test_a_wrong_command_line_says_what_to_do(bayesftc_, drive, arguments, code, words):
    done = bayesftc_("fit", *arguments)
    assert done.exit_code == code
    assert words in " ".join(done.output.replace("│", " ").split())
