"""``bayesftc monitor``: what it prints and writes, and what it leaves behind when something is wrong."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from bayesftc import monitoring
from bayesftc.cli import app
from bayesftc.cli.commands.recordings import _monitor_fit
from bayesftc.cli.commands.recordings._faults import print_disagreements, print_faults
from bayesftc.cli.commands.recordings.monitor import _remedy
from bayesftc.controllers.bayesian import recorded
from bayesftc.controllers.switching.fault_modes import FAULT_MODES
from bayesftc.monitoring import Alarm, Disagreement, FaultEvent, SensorErrors, Signal, align, load_monitor

RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    """Run compiled, as recordings of more than a thousand steps do: these of 600 steps would take four times as long."""
    monkeypatch.setattr(recorded, "SHORT", 0)


MODEL = """
dt = 0.1
[model]
kind = "RandomWalk"
std = 0.1
[sensors.a]
std = 0.1
unit = "m"
[sensors.b]
std = 0.1
unit = "m"
[sensors.c]
std = 0.1
unit = "m"
"""


@pytest.fixture
def files(tmp_path):
    """A minute of three level sensors, of which the second jumps by 2 m at 30 s."""
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(600)
    level = 5.0 + np.cumsum(0.02 * rng.standard_normal(600))
    table = pd.DataFrame({"t": t, **{name: level + 0.1 * rng.standard_normal(600) for name in "abc"}})
    table.loc[table.t >= 30, "b"] += 2.0
    table.to_csv(tmp_path / "tank.csv", index=False)
    (tmp_path / "model.toml").write_text(MODEL, encoding="utf-8")
    return [str(tmp_path / "tank.csv"), "--model", str(tmp_path / "model.toml")]


def test_it_prints_the_fault_and_writes_all_files(files, tmp_path):
    out = tmp_path / "deep" / "results"
    done = RUNNER.invoke(app, ["monitor", *files, "--out", str(out)])
    assert done.exit_code == 0, done.output
    for words in ("0 to 59.9 s, 600 steps of 0.1 s", "Offset", "30.00", "to 59.90", "1.98 m", f"Written to {out}"):
        assert words in done.output
    assert {f.name for f in out.iterdir()} == {"probabilities.csv", "faults.json", "figure.png"}
    table = pd.read_csv(out / "probabilities.csv")
    assert list(table.columns) == ["t", "a", "a_kind", "b", "b_kind", "c", "c_kind"]
    assert len(table) == 600
    assert table.b[305:].min() > 0.99
    assert table[["a", "c"]].to_numpy().max() < 0.9
    report = json.loads((out / "faults.json").read_text(encoding="utf-8"))
    (fault,) = report["faults"]
    assert (fault["sensor"], fault["kind"]) == ("b", "Offset")
    assert fault["onset"] == pytest.approx(30.0, abs=0.2)
    assert fault["size"] == pytest.approx(2.0, abs=0.2)
    assert report["sensors"]["b"] == {
        "samples": 600, "rate": pytest.approx(10.0), "replaced": 0, "alarms": 1, "bursts": pytest.approx(0.0, abs=0.01),
        "mean_probability": pytest.approx(table.b.mean(), rel=1e-6),
    }  # fmt: skip
    assert (out / "figure.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.usefixtures("undrawn")
def test_the_table_has_the_interval_of_each_sensor_and_a_step_that_loses_no_sample(files, tmp_path):
    """Sensors send every 10 s, with jitter, in a log without some samples, whatever the step of the model is."""
    rng = np.random.default_rng(0)
    table = pd.read_csv(files[0])
    table.t = np.round(10.0 * np.arange(600) + rng.uniform(-1, 1, 600), 1)
    table.loc[rng.random(600) < 0.1, "c"] = np.nan
    table.to_csv(files[0], index=False)

    def printed(dt):
        (tmp_path / "model.toml").write_text(MODEL.replace("dt = 0.1", f"dt = {dt}"), encoding="utf-8")
        done = RUNNER.invoke(app, ["monitor", *files])
        assert done.exit_code == 0, done.output
        return done.output

    words = printed(20)
    assert re.findall(r"([abc]) +\d+ +every (\S+) s", words) == [("a", "10"), ("b", "10"), ("c", "10")]
    advised = r"With\s+dt\s+=\s+10\s+in\s+the\s+model\s+file,\s+none\s+is\s+left\s+out\."
    assert re.search(advised, words)
    words = printed(10)
    assert "eft out:" not in words
    assert re.findall(r"([abc]) +\d+ +every (\S+) s", words) == [("a", "10"), ("b", "10"), ("c", "10")]
    assert re.search(advised, printed(9.9))  # hardly shorter than the interval is not enough


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("fault", [25.0, 45.0])
def test_an_input_without_samples_is_named_if_an_alarm_begins_then(tmp_path, fault):
    """A level that a pump fills, which the log lacks from 20 to 35 s; sensor b has an offset for 5 s."""
    rng, t = np.random.default_rng(0), 0.1 * np.arange(600)
    pump = np.where((t >= 20) & (t < 35), np.nan, 0.2)
    level = 5.0 + 0.02 * t
    table = pd.DataFrame({"t": t, "pump": pump, **{name: level + 0.1 * rng.standard_normal(600) for name in "abc"}})
    table.loc[(table.t >= fault) & (table.t < fault + 5), "b"] += 1.5
    table.to_csv(tmp_path / "tank.csv", index=False)
    text = MODEL.replace('"RandomWalk"\nstd = 0.1', '"Integrator"\nstd = 0.05') + "[inputs.pump]\ngain = 10.0\n"
    (tmp_path / "tank.toml").write_text(text, encoding="utf-8")
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "tank.csv"), "--model", str(tmp_path / "tank.toml")])
    assert done.exit_code == 0, done.output
    words = " ".join(done.output.split())
    assert "Offset" in words
    note = "The input pump has no sample from 19.9 to 35 s; its last value is held. What looks like a fault of a sensor"
    assert (note in words) == (fault == 25.0)


@pytest.mark.usefixtures("undrawn")
def test_faults_of_an_actuator_are_shown_beside_the_sensors(tmp_path):
    """A level that a pump fills: the pump gives .8 more from 20 to 35 s, sensor b 1.5 more from 45 to 52 s."""
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(600)
    pump = np.sin(t / 3)
    gain = 0.1 * (pump + np.where((t >= 20) & (t < 35), 0.8, 0.0)) + 0.006 * rng.standard_normal(600)
    level = 5.0 + np.concatenate([[0.0], np.cumsum(gain)[:-1]])
    table = pd.DataFrame({"t": t, "pump": pump, **{name: level + 0.1 * rng.standard_normal(600) for name in "ab"}})
    table.loc[(table.t >= 45) & (table.t < 52), "b"] += 1.5
    table.to_csv(tmp_path / "tank.csv", index=False)
    text = MODEL[: MODEL.index("[sensors.c]")].replace('"RandomWalk"\nstd = 0.1', '"Integrator"\nstd = 0.05')
    text += '[inputs.pump]\nunit = "l/s"\n[precision]\nkind = "SwitchingPrecision"\n'
    text += 'actuator_modes = [{ kind = "InputOffset", jump = 50.0 }, { kind = "LostEffect" }]\n'
    (tmp_path / "tank.toml").write_text(text, encoding="utf-8")
    arguments = [str(tmp_path / "tank.csv"), "--model", str(tmp_path / "tank.toml"), "--out", str(tmp_path / "out")]
    done = RUNNER.invoke(app, ["monitor", *arguments])
    assert done.exit_code == 0, done.output
    (row,) = (line for line in done.output.splitlines() if "actuator pump   InputOffset" in line)
    report = json.loads((tmp_path / "out" / "faults.json").read_text(encoding="utf-8"))
    assert [(e["sensor"], e["kind"]) for e in report["faults"]] == [("b", "Offset")]
    (blamed,) = report["actuator_faults"]
    assert (blamed["actuator"], blamed["kind"]) == ("pump", "InputOffset")
    assert blamed["start"] == pytest.approx(20.0, abs=2.0)
    assert blamed["end"] == pytest.approx(35.0, abs=2.0)
    assert blamed["size"] == pytest.approx(0.8, abs=0.15)
    assert row.rstrip().endswith(f"{blamed['size']:.3g} l/s")
    written = pd.read_csv(tmp_path / "out" / "probabilities.csv")
    assert list(written.columns) == ["t", "a", "a_kind", "b", "b_kind", "actuator_pump", "actuator_pump_kind"]
    assert report["actuators"]["pump"] == {
        "alarms": 1,
        "mean_probability": pytest.approx(written.actuator_pump.mean(), rel=1e-6),
    }
    assert set(written.actuator_pump_kind[written.actuator_pump > 0.9]) == {"InputOffset"}
    assert written.actuator_pump[(t < 19) | (t > 37)].max() < 0.5


def test_the_size_of_a_fault_has_its_unit_or_counts_noise(capsys):
    """A dead thermometer jumps to a constant: its size is that of the innovations, and no temperature."""
    modes = {mode.__name__: mode for mode in FAULT_MODES}
    events = [FaultEvent("a", 1.0, 2.0, 1.0, kind, 1.0, 2.5) for kind in modes]
    print_faults(events, {"a": "degC"})
    rows = {row.split()[1]: row for row in capsys.readouterr().out.splitlines() if row.strip().startswith("a ")}
    for kind, mode in modes.items():
        assert rows[kind].rstrip().endswith("x 2.5" if mode.size_in_noise else "2.5 degC")
    assert modes["Unmodelled"].size_in_noise
    assert not modes["Offset"].size_in_noise


@pytest.mark.slow
def test_names_are_printed_as_they_are(files, tmp_path):
    """Brackets are no styles of the terminal, and colons make no pictures."""
    names = dict(zip("abc", ("T 1 [degC]", "[red]", ":car:"), strict=True))
    table = pd.read_csv(tmp_path / "tank.csv").rename(columns=names)
    table.to_csv(tmp_path / "named.csv", index=False)
    done = RUNNER.invoke(
        app, ["monitor", str(tmp_path / "named.csv"), "--fit", "--to", "29", "--model", str(tmp_path / "named.toml")]
    )
    assert done.exit_code == 0, done.output
    for name in names.values():
        assert sum(line.lstrip().startswith(name) for line in done.output.splitlines()) >= 2  # fitted model, samples


def test_json_and_quiet(files):
    done = RUNNER.invoke(app, ["monitor", *files, "--json"])
    assert done.exit_code == 0, done.output
    assert [fault["sensor"] for fault in json.loads(done.output)["faults"]] == ["b"]
    done = RUNNER.invoke(app, ["monitor", *files, "--quiet"])
    assert (done.exit_code, done.output) == (0, "")


def test_nothing_found_and_nothing_to_find(files, tmp_path):
    table = pd.read_csv(files[0])
    table[table.t < 30].to_csv(files[0], index=False)
    done = RUNNER.invoke(app, ["monitor", *files])
    assert done.exit_code == 0, done.output
    assert "No fault was found." in done.output
    (tmp_path / "model.toml").write_text(MODEL + '[precision]\nkind = "FixedPrecision"\n', encoding="utf-8")
    done = RUNNER.invoke(app, ["monitor", *files])
    assert "There is no fault probability: FixedPrecision does not infer faults." in done.output


@pytest.mark.usefixtures("undrawn")
def test_a_file_that_cannot_be_written_leaves_none_behind(files, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_csv", full)
    out = tmp_path / "results"
    done = RUNNER.invoke(app, ["monitor", *files, "--out", str(out)])
    assert done.exit_code == 12
    assert "No space left on device" in done.output
    assert not out.exists()


@pytest.mark.parametrize(
    ("break_it", "code", "words"),
    [
        (lambda csv, toml: csv.unlink(), 16, "tank.csv does not exist"),
        (lambda csv, toml: toml.unlink(), 3, "There is no model file"),
        (lambda csv, toml: csv.write_text("t,a,b\n0,1,2\n", encoding="utf-8"), 16, "no column 'c'"),
        (lambda csv, toml: toml.write_text("dt = 1\n", encoding="utf-8"), 3, "lacks 'model'"),
        (lambda csv, toml: (csv.parent / "out").write_text("", encoding="utf-8"), 12, "not a folder"),
    ],
)
def test_mistakes_end_with_a_sentence_and_no_files(break_it, code, words, files, tmp_path):
    break_it(tmp_path / "tank.csv", tmp_path / "model.toml")
    done = RUNNER.invoke(app, ["monitor", *files, "--out", str(tmp_path / "out")])
    assert done.exit_code == code
    assert words in done.output
    assert not (tmp_path / "out").is_dir()


@pytest.fixture
def drive(files, tmp_path):
    """The same recording, with nothing said of it."""
    table = pd.read_csv(files[0])
    table["note"] = "text"
    table.to_csv(tmp_path / "tank.csv", index=False)
    return str(tmp_path / "tank.csv")


@pytest.mark.slow
def test_the_columns_of_a_fit_are_explained_and_gaps_named(drive, tmp_path):
    arguments = ["monitor", drive, "--fit", "--to", "29", "--model", str(tmp_path / "m.toml")]
    whole = RUNNER.invoke(app, arguments)
    for word in ("Noise:", "Lasting errors:", "Bias:", "Resolution:", "fine:", "Repeats:", "Missing:"):
        assert word in whole.output
    assert "gap" not in whole.output
    table = pd.read_csv(drive)
    table[(table.t < 9.95) | (table.t > 14.95)].to_csv(drive, index=False)
    done = RUNNER.invoke(app, [*arguments, "--overwrite"])
    assert done.exit_code == 0, done.output
    assert "The gaps (8% of the steps) are not counted as missing." in done.output
    named = "The recording has a gap, in which no sensor has a sample: from 9.90 to 15.00 s (50 samples). A gap is no fault."
    assert named in done.output


@pytest.mark.usefixtures("undrawn")
def test_a_model_is_fitted_and_written(drive, tmp_path):
    out = tmp_path / "results"
    done = RUNNER.invoke(app, ["monitor", drive, "--fit", "--to", "29", "--out", str(out)])
    assert done.exit_code == 0, done.output
    for words in ("Fitted model", "RandomWalk", "noise", f"Written to {out / 'model.toml'}", "Offset"):
        assert words in done.output
    report = json.loads((out / "faults.json").read_text(encoding="utf-8"))
    (fault,) = report["faults"]
    assert (fault["sensor"], fault["kind"]) == ("b", "Offset")
    assert fault["onset"] == pytest.approx(30.0, abs=0.2)
    fitted = report["fitted"]
    assert fitted["model"] == "RandomWalk"
    assert 1 / 2 < fitted["std"] / (0.02 / 0.1**0.5) < 2
    for sensor in fitted["sensors"].values():
        assert sensor["std"] == pytest.approx(0.1, rel=0.25)
    again = RUNNER.invoke(app, ["monitor", drive, "--model", str(out / "model.toml"), "--json"])
    assert again.exit_code == 0, again.output
    assert json.loads(again.output)["faults"] == report["faults"]


def test_a_missing_recording_is_said_before_a_model_that_is_there(files, tmp_path):
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "missing.csv"), "--fit", "--model", files[2]])
    assert done.exit_code == 16
    assert "missing.csv does not exist" in done.output
    assert "exists already" not in done.output
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "missing.csv")])  # nor before that there is no model
    assert done.exit_code == 16
    assert "missing.csv does not exist" in done.output


def test_a_model_that_is_there_is_not_overwritten(drive, files, tmp_path):
    fit = ["--fit", "--to", "29"]
    before = (tmp_path / "model.toml").read_text(encoding="utf-8")
    done = RUNNER.invoke(app, ["monitor", drive, *fit, "--model", files[2]])
    assert done.exit_code == 12
    assert "exists already" in done.output
    sentence = " ".join(done.output.split())
    assert "Add --overwrite to replace it" in sentence
    assert f"give --model {files[2]} without --fit" in sentence
    assert (tmp_path / "model.toml").read_text(encoding="utf-8") == before
    replaced = RUNNER.invoke(app, ["monitor", drive, *fit, "--overwrite", "--model", files[2], "--json"])
    assert replaced.exit_code == 0, replaced.output
    assert (tmp_path / "model.toml").read_text(encoding="utf-8") != before
    again = RUNNER.invoke(
        app, ["monitor", drive, *fit, "--model", files[2], "--json"]
    )  # the same model: nothing to lose
    assert (again.exit_code, json.loads(again.stdout)) == (0, json.loads(replaced.stdout))
    alone = RUNNER.invoke(app, ["monitor", drive, "--overwrite", "--model", files[2]])
    assert alone.exit_code == 2
    assert "--overwrite replaces the model file" in " ".join(alone.output.replace("│", " ").split())


@pytest.mark.slow
def test_columns_with_any_names_are_fitted(drive, tmp_path):
    table = pd.read_csv(drive).rename(columns={"t": "Time (s)", "a": "oil, left", "b": 'the "big" one', "c": "c"})
    table["index"] = range(len(table))
    table.to_csv(drive, index=False)
    model = tmp_path / "new.toml"
    done = RUNNER.invoke(app, ["monitor", drive, "--fit", "--model", str(model), "--to", "29"])
    assert done.exit_code == 16
    assert "'index' does not follow the others" in done.output
    assert not model.exists()
    names = [f"--sensor={name}" for name in ("oil, left", 'the "big" one', "c")]
    done = RUNNER.invoke(app, ["monitor", drive, "--fit", "--model", str(model), "--to", "29", *names, "--json"])
    assert done.exit_code == 0, done.output
    assert [fault["sensor"] for fault in json.loads(done.stdout)["faults"]] == ['the "big" one']


@pytest.mark.slow
def test_several_files_are_fitted_together(drive, tmp_path):
    table = pd.read_csv(drive)
    folder = tmp_path / "parts"
    folder.mkdir()
    table[["t", "a"]].to_csv(folder / "one.csv", index=False)
    table[["t", "b"]].rename(columns={"t": "time", "b": "a"}).to_csv(folder / "two.csv", index=False)
    done = RUNNER.invoke(
        app, ["monitor", str(folder), "--fit", "--model", str(tmp_path / "m.toml"), "--to", "29", "--json"]
    )
    assert done.exit_code == 0, done.output
    assert set(json.loads(done.stdout)["sensors"]) == {"a", "two_a"}


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ([], 2, "with --fit"),
        (["--from", "3"], 2, "with --fit"),
        (["--fit", "--from", "100"], 16, "no samples between the start (--from) and the end (--to)"),
        (["--fit", "--from", "3", "--to", "2"], 16, "The start (--from) is later than the end (--to)"),
        (["--fit", "--from", "3", "--to", "5"], 16, "samples in the stretch; a fit needs 200"),
        (["--fit", "--sensor", "d"], 16, "no column 'd' with numbers"),
        (["--fit", "--sensor", "a"], 16, "two or more sensors"),
    ],
)
def test_a_fit_that_cannot_be_is_refused(drive, tmp_path, options, code, words):
    model = ["--model", str(tmp_path / "fresh.toml")] if "--fit" in options else []
    done = RUNNER.invoke(app, ["monitor", drive, *options, *model])
    assert done.exit_code == code, done.output
    assert words in " ".join(done.output.replace("│", " ").split())
    assert not (tmp_path / "fresh.toml").exists()


def test_the_stretch_needs_a_fit(files):
    done = RUNNER.invoke(app, ["monitor", *files, "--to", "3"])
    assert done.exit_code == 2
    assert "add --fit" in " ".join(done.output.replace("│", " ").split())


def test_a_rest_of_all_sensors_is_said_and_no_fault(tmp_path):
    """Three wheels that all send the same for ten seconds."""
    rng = np.random.default_rng(1)
    t = 0.1 * np.arange(600)
    level = np.cumsum(0.02 * rng.standard_normal(600))
    table = pd.DataFrame({"t": t, **{name: level + 0.1 * rng.standard_normal(600) for name in "abc"}})
    table.loc[300:399, ["a", "b", "c"]] = 0.0
    table.to_csv(tmp_path / "tank.csv", index=False)
    (tmp_path / "model.toml").write_text(MODEL, encoding="utf-8")
    arguments = ["monitor", str(tmp_path / "tank.csv"), "--model", str(tmp_path / "model.toml")]
    done = RUNNER.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "For 9.9 s in total, all sensors repeat their values" in done.output
    assert "No fault was found" in done.output
    assert json.loads(RUNNER.invoke(app, [*arguments, "--json"]).output)["rest"] == pytest.approx(9.9)


DRIVEN = """
dt = {dt}
[model]
kind = "Matrices"
A = [[{A}]]
B = [[{B}]]
process_covariance = [[1e-4]]
[inputs.pump]
[sensors.a]
std = 0.1
[sensors.b]
std = 0.1
"""


@pytest.fixture
def pumped(tmp_path):
    """A minute of a tank that empties in 5 s (two level sensors) and of the pump's command, which is moved up and down."""
    rng = np.random.default_rng(1000)
    u, level = np.where(np.arange(600) // 70 % 2, 1.0, 0.2), np.zeros(600)
    for k in range(599):
        level[k + 1] = 0.98 * level[k] + 0.2 * u[k] + 0.01 * rng.standard_normal()
    table = pd.DataFrame(
        {"t": 0.1 * np.arange(600), "pump": u, **{name: level + 0.1 * rng.standard_normal(600) for name in "ab"}}
    )
    table.to_csv(tmp_path / "tank.csv", index=False)
    return tmp_path


def watch_pumped(folder, dt=0.1, A=0.98, B=0.2, *options):
    (folder / "model.toml").write_text(DRIVEN.format(dt=dt, A=A, B=B), encoding="utf-8")
    done = RUNNER.invoke(app, ["monitor", str(folder / "tank.csv"), "--model", str(folder / "model.toml"), *options])
    assert done.exit_code == 0, done.output
    return done


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("model", "kind", "words"),
    [
        ({"B": -0.2}, "sign", r"in the opposite direction, about as strongly as in the model\. Check its sign\."),
        ({"B": 0.4}, "gain", r"(0.49|0.5)\d* times as strongly as in the model"),
        ({"A": 0.98**4, "B": 10 - 10 * 0.98**4}, "dt", r"Check dt: .* a sample time of 0\.(39|4)"),
        ({"dt": 0.05}, "dt", r"Check dt: .* 0\.(09|1)\d* s, but dt is 0\.05 s"),
    ],
)  # fmt: skip
def test_a_wrong_model_is_named_in_a_warning(model, kind, words, pumped):
    done = watch_pumped(pumped, **model)
    assert done.stderr.startswith("Warning: All sensors disagree")
    assert re.search(words, done.stderr)
    assert "All sensors disagree" not in done.stdout
    values = (model.get("dt", 0.1), model.get("A", 0.98), model.get("B", 0.2))
    assert json.loads(watch_pumped(pumped, *values, "--json").stdout)["model"]["kind"] == kind


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stop", "words"),
    [
        (41.0, r"moves the plant from 2026-05-01 23:59:(\d+\.\d+) to 2026-05-02 00:00:0\d\.\d+, or"),
        (99.0, r"moves the plant from 2026-05-01 23:59:(\d+\.\d+) on, or"),
    ],
)
def test_what_moves_the_plant_has_the_dates_of_the_recording(stop, words, pumped):
    """It counted seconds from the first sample, which nobody finds in a table of dates."""
    table = pd.read_csv(pumped / "tank.csv")
    acts = (table.t > 30.0) & (table.t < stop)
    level = np.zeros(len(table))
    for k in range(len(table) - 1):
        level[k + 1] = 0.98 * level[k] + 0.02 * acts[k]
    table[["a", "b"]] += level[:, None]
    table["t"] = [
        f"{at:%Y-%m-%dT%H:%M:%S.%f}" for at in pd.Timestamp("2026-05-01 23:59:25") + pd.to_timedelta(table.t, "s")
    ]
    table.to_csv(pumped / "tank.csv", index=False)
    found = json.loads(watch_pumped(pumped, 0.1, 0.98, 0.2, "--json").stdout)["model"]
    assert found["kind"] == "onset"
    (second,) = re.search(words, found["sentence"]).groups()
    assert 25.0 + found["values"][0] == pytest.approx(float(second))
    assert "first sample" not in found["sentence"]


@pytest.mark.slow
def test_faults_of_sensors_of_two_quantities_are_no_error_of_a_right_model(tmp_path):
    """It warned that all sensors disagree with the model, and advised more process noise."""
    rng, n, A = np.random.default_rng(0), 1500, np.array([[0.97, 0.02], [0.0, 0.95]])
    u, x = np.where(np.arange(n) // 70 % 2, 1.0, 0.2), np.zeros((n, 2))
    for k in range(n - 1):
        x[k + 1] = A @ x[k] + [0.1 * u[k], 0.5 * u[k]] + np.array([0.01, 0.02]) * rng.standard_normal(2)
    y = x[:, [0, 0, 1, 1]] + [0.1, 0.1, 0.2, 0.2] * rng.standard_normal((n, 4))
    y[500:, 0] += 0.01 * np.arange(n - 500)
    y[900:, 3] = y[900, 3]
    columns = {"t": 0.1 * np.arange(n), "pump": u, **dict(zip("abcd", y.T, strict=True))}
    pd.DataFrame(columns).to_csv(tmp_path / "two.csv", index=False)
    text = 'dt = 0.1\n[model]\nkind = "Matrices"\nA = [[0.97, 0.02], [0.0, 0.95]]\nB = [[0.1], [0.5]]\n'
    text += "process_covariance = [[1e-4, 0.0], [0.0, 4e-4]]\n[inputs.pump]\n[sensors.a]\nstd = 0.1\n[sensors.b]\nstd = 0.1\n"
    text += "".join(f"[sensors.{name}]\nstd = 0.2\nreads = [0.0, 1.0]\n" for name in "cd")
    (tmp_path / "two.toml").write_text(text)
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "two.csv"), "--model", str(tmp_path / "two.toml"), "--json"])
    numbers = json.loads(done.stdout)
    assert [(event["sensor"], event["kind"]) for event in numbers["faults"]] == [("a", "Drifting"), ("d", "Frozen")]
    assert (numbers["model"]["kind"], numbers["model"]["others"]) == ("sensors", ["noise"])
    assert numbers["notes"][0].startswith(
        "The monitor blames a and d at the same time. Without the samples for which it"
    )
    assert "disagree" not in done.stderr
    monitor = load_monitor(tmp_path / "two.toml")
    assert monitor.compare(monitor.read(tmp_path / "two.csv")).kind == "noise"


@pytest.mark.slow
def test_a_right_model_is_not_warned_of_even_if_a_sensor_fails(pumped):
    assert watch_pumped(pumped).stderr == ""
    table = pd.read_csv(pumped / "tank.csv")
    table.loc[table.t >= 30, "b"] += 2.0
    table.to_csv(pumped / "tank.csv", index=False)
    done = watch_pumped(pumped)
    assert done.stderr == ""
    assert "Offset" in done.stdout


def tank(tmp_path, begin, end=60.0):
    """A minute of three sensors of a level, of which the second has an offset for a part; the command that fits a model to it."""
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(600)
    level = 20.0 + np.cumsum(0.02 * rng.standard_normal(600))
    failed = (t >= begin) & (t < end)
    y = {name: level + 0.1 * rng.standard_normal(600) + 2.0 * (name == "b") * failed for name in "abc"}
    pd.DataFrame({"t": t, **y}).to_csv(tmp_path / "tank.csv", index=False)
    return ["monitor", str(tmp_path / "tank.csv"), "--fit", "--model"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("begin", [35.2, 36.0, 45.0])
def test_an_offset_that_lasts_to_the_end_is_not_learnt(tmp_path, begin):
    """A fit to a recording takes it for a fault, says so, and the monitor finds it, also without a stretch."""
    command = [*tank(tmp_path, begin), str(tmp_path / "model.toml")]
    report = json.loads(RUNNER.invoke(app, [*command, "--json"]).stdout)
    (note,) = report["notes"]
    about, size = re.match(r"From about ([\d.]+) s on, b is ([\d.]+) above its place among the other", note).groups()
    assert begin - 1.6 < float(about) <= begin  # in parts of 1.6 s
    assert float(size) == pytest.approx(2.0, abs=0.1)
    assert f"If it was healthy until then, fit with --to {float(about):.10g}. If it has been healthy since" in note
    (fault,) = report["faults"]
    assert (fault["sensor"], fault["kind"], fault["end"]) == ("b", "Offset", pytest.approx(59.9))
    assert fault["start"] - begin < 1.0
    healthy = json.loads(RUNNER.invoke(app, [*command, "--json", "--overwrite", "--to", about]).stdout)
    assert healthy["notes"] == []
    assert [fault["sensor"] for fault in healthy["faults"]] == ["b"]


@pytest.mark.parametrize("sudden", [False, True])
def test_two_sensors_that_part_have_a_note(tmp_path, sudden):
    rng, t = np.random.default_rng(0), np.arange(3000)
    y = 20.0 + np.cumsum(0.05 * rng.standard_normal(3000))[:, None] + 0.05 * rng.standard_normal((3000, 2))
    y[1500:, 0] += 1.0 if sudden else np.linspace(0.0, 1.0, 1500)
    np.savetxt(tmp_path / "two.csv", np.column_stack([t, y]), delimiter=",", header="t,a,b", comments="", fmt="%.3f")
    command = ["monitor", str(tmp_path / "two.csv"), "--fit", "--model", str(tmp_path / "model.toml"), "--json"]
    (note,) = json.loads(RUNNER.invoke(app, command).stdout)["notes"]
    how = r"a is [\d.]+ above its place beside b" if sudden else r"a and b move apart. At the end \(2999 s\) a is"
    assert re.match(rf"From about 1[456]\d\d s on, {how}", note)
    assert "Two sensors do not show which one has moved" in note


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("begin", "end", "said", "remedy"),
    [
        (30.0, 60.0, "b is 1.98 above", "fit with --to 30.4. If it has been healthy since then, fit with --from 30.4"),
        (24.0, 42.0, "errors of b last", "--from and --to"),
    ],
)
def test_a_fit_over_a_lasting_fault_names_the_remedy(tmp_path, begin, end, said, remedy):
    """The model of a stretch with a fault expects the fault, and its alarm ends too early."""
    command = tank(tmp_path, begin, end)
    whole = RUNNER.invoke(app, [*command, str(tmp_path / "whole.toml")])
    assert said in " ".join(whole.output.split())
    assert remedy in " ".join(whole.output.split())
    assert "If it measures another quantity, leave it out: name the others with --sensor." in " ".join(
        whole.output.split()
    )
    healthy = RUNNER.invoke(app, [*command, str(tmp_path / "healthy.toml"), "--to", f"{min(begin, 30) - 1:g}"])
    assert healthy.exit_code == 0
    words = " ".join(healthy.output.split())
    assert "because the stretch is too short or too calm for them" in words
    assert "To fit the stretch alone, put its rows into a file of their own." in words
    assert "errors of b" not in healthy.output
    assert f"to {end - 0.1:.2f}" in healthy.output
    assert "Biases, repeats and missing come from the stretch" in healthy.output
    first = (tmp_path / "healthy.toml").read_text().splitlines()[0]
    assert (
        first
        == f"# Fitted by bayesftc monitor --fit to 0 to 59.9 s, with healthy sensors from 0 to {min(begin, 30) - 1:g} s."
    )


@pytest.mark.slow
def test_headings_that_pass_north_count_on(tmp_path):
    """The fit says so and writes it into the model file; without it the monitor names the line that is missing."""
    rng, t = np.random.default_rng(0), 1.0 * np.arange(600)
    heading = 30.0 * np.sin(2 * np.pi * t / 300)
    y = {name: heading + std * rng.standard_normal(600) for name, std in (("a", 0.3), ("b", 0.5), ("c", 0.5))}
    y["c"][500:] += 8.0
    pd.DataFrame({"t": t, **{name: column % 360 for name, column in y.items()}}).to_csv(
        tmp_path / "ship.csv", index=False
    )
    model = tmp_path / "model.toml"
    command = ["monitor", str(tmp_path / "ship.csv"), "--json", "--model", str(model)]
    report = json.loads(RUNNER.invoke(app, [*command, "--fit", "--to", "490"]).stdout)
    assert "jump by about 360 up and down, as an angle does" in " ".join(report["notes"])
    assert [(fault["sensor"], fault["kind"], round(fault["size"])) for fault in report["faults"]] == [
        ("c", "Offset", 8)
    ]
    line = "period = 360  # an angle, which begins anew after a full turn\n"
    assert model.read_text().count(line) == 3
    again = json.loads(RUNNER.invoke(app, command).stdout)
    assert (again["faults"], again["notes"]) == (report["faults"], [])
    model.write_text(model.read_text().replace(line, ""))
    (note,) = json.loads(RUNNER.invoke(app, command).stdout)["notes"][-1:]
    assert f"If they are angles, add period = 360 below each of their sensors in {model}" in note


def slower_than_its_log(path, seed, seconds=80, frozen=()):
    """Write a log of 25 rows a second of three speeds, of which the third one has 5 values a second."""
    rng, t = np.random.default_rng(seed), 0.04 * np.arange(25 * seconds)
    y = np.sin(t / 3)[:, None] + [0.02, 0.03, 0.1] * rng.standard_normal((len(t), 3))
    y[:, 2] = np.repeat(y[::5, 2], 5)
    for begin, end in frozen:
        y[(t >= begin) & (t < end), 2] = y[np.searchsorted(t, begin) - 1, 2]
    pd.DataFrame({"t": t, "left": y[:, 0], "right": y[:, 1], "gnss": y[:, 2]}).to_csv(path, index=False)


@pytest.mark.slow
def test_a_sensor_whose_values_the_log_repeats_is_fitted_without_the_repetitions(tmp_path):
    """They hid half of its noise, and it had 6 alarms in 80 healthy seconds."""
    model, fitted, watched = tmp_path / "model.toml", tmp_path / "fit.csv", tmp_path / "watched.csv"
    slower_than_its_log(fitted, 0)
    slower_than_its_log(watched, 1, frozen=[(40, 46)])
    command = ["monitor", "--json", "--model", str(model)]
    report = json.loads(RUNNER.invoke(app, [*command, str(fitted), "--fit"]).stdout)
    assert report["fitted"]["sensors"]["gnss"]["std"] == pytest.approx(0.1, rel=0.15)
    assert report["faults"] == []
    assert "gnss has a new value about every 0.2 s, and repeats it in the rows between." in " ".join(report["notes"])
    assert model.read_text().count("held = true") == 1
    (fault,) = json.loads(RUNNER.invoke(app, [*command, str(watched)]).stdout)["faults"]
    assert (fault["sensor"], fault["kind"]) == ("gnss", "DroppedOut")
    assert (fault["onset"], fault["end"]) == (pytest.approx(40, abs=0.5), pytest.approx(46, abs=0.5))


def test_too_few_values_of_such_a_sensor_are_refused_with_the_reason(tmp_path):
    slower_than_its_log(tmp_path / "log.csv", 0, seconds=30)
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "log.csv"), "--fit", "--model", str(tmp_path / "model.toml")])
    words = " ".join(done.output.split())
    assert "The sensor 'gnss' has 150 samples in the stretch; a fit needs 200." in words
    assert "gnss has a new value about every 0.2 s" in words


def test_a_code_of_a_heading_is_named_and_not_fitted(tmp_path):
    """It was put on a turn, each time with another value: nothing named it, and its sensor had thirty times its noise."""
    rng, t = np.random.default_rng(1), 1.0 * np.arange(900)
    heading = 30.0 * np.sin(2 * np.pi * t / 300) + 0.8 * t
    table = pd.DataFrame({"t": t, **{name: (heading + rng.standard_normal(900)) % 360 for name in "abc"}}).round(1)
    table.loc[rng.random(900) < 0.1, "b"] = -999.0
    table.to_csv(tmp_path / "ship.csv", index=False)
    command = ["monitor", str(tmp_path / "ship.csv"), "--json", "--model", str(tmp_path / "model.toml"), "--fit"]
    report = json.loads(RUNNER.invoke(app, command).stdout)
    (note,) = (note for note in report["notes"] if "add --invalid" in note)
    assert note.startswith("b is exactly -999 in 11% of its samples")
    assert report["fitted"]["sensors"]["b"]["std"] == pytest.approx(1.0, rel=0.15)
    named = json.loads(RUNNER.invoke(app, [*command, "--overwrite", "--invalid", "b=-999"]).stdout)
    assert named["faults"] == []
    assert named["fitted"]["sensors"]["b"] == pytest.approx(report["fitted"]["sensors"]["b"])


@pytest.mark.slow
def test_the_recording_of_the_readme_fits_its_model(tmp_path):
    drive = tmp_path / "drive.csv"
    drive.write_text(RUNNER.invoke(app, ["example", "faulty_wheel_speed"]).stdout, encoding="utf-8")
    made = RUNNER.invoke(app, ["monitor", str(drive), "--fit", "--model", str(tmp_path / "model.toml"), "--json"])
    found = json.loads(made.stdout)
    assert found["model"] is None
    assert {event["sensor"] for event in found["faults"]} == {"front_left", "rear_left", "front_right"}


def flown(tmp_path, **columns):
    """Five minutes of three altimeters, of which the lidar has the least noise, and further columns."""
    rng, t = np.random.default_rng(0), 0.1 * np.arange(3000)
    level = 6 + 2.5 * np.sin(2 * np.pi * t / 50) + np.sin(2 * np.pi * t / 17)
    noise = {"baro": 0.3, "gnss": 0.8, "lidar": 0.03}
    table = pd.DataFrame({"t": t, **{name: level + std * rng.standard_normal(3000) for name, std in noise.items()}})
    table.assign(**columns).round(3).to_csv(tmp_path / "flight.csv", index=False)
    return ["monitor", str(tmp_path / "flight.csv"), "--fit", "--model", str(tmp_path / "model.toml")]


def test_a_column_without_numbers_is_named(tmp_path):
    command = flown(tmp_path, sonar=np.nan, remark="none")
    done = RUNNER.invoke(app, [*command, "--json"])
    note = "The columns 'sonar' and 'remark' have no numbers; they are not monitored."
    assert json.loads(done.stdout)["notes"] == [note]
    assert f"Note: {note}" in done.stderr
    chosen = [f"--sensor={name}" for name in ("baro", "lidar", "gnss")]
    named = RUNNER.invoke(app, [*command, "--overwrite", "--json", *chosen])
    assert json.loads(named.stdout)["notes"] == []


@pytest.mark.slow
def test_a_value_in_place_of_samples_is_named_and_can_be_left_out(tmp_path):
    command = flown(tmp_path)
    table = pd.read_csv(tmp_path / "flight.csv").rename(columns={"lidar": "lidar [cm]", "baro": "baro [m]"})
    table["lidar [cm]"] = np.where(table["lidar [cm]"] > 8, -1, 100 * table["lidar [cm]"]).round(1)
    table.to_csv(tmp_path / "flight.csv", index=False)
    note, one_by_one = json.loads(RUNNER.invoke(app, [*command, "--json"]).stdout)["notes"]
    assert one_by_one.startswith(
        "The model file has no joint = true, because of lidar [cm]: sensors are judged one by one"
    )
    assert "fit with --invalid as said above" in one_by_one
    share = f"{np.mean(table['lidar [cm]'] == -1):.0%}"
    assert f"is exactly -1 in {share} of its samples, while the other sensors of its quantity are not near -1." in note
    assert "add --invalid 'lidar [cm]=-1'" in note
    for option in ("lidar [cm]=-1", "lidar=-1", "-1"):
        report = json.loads(RUNNER.invoke(app, [*command, "--overwrite", "--json", f"--invalid={option}"]).stdout)
        assert report["notes"] == []
        assert report["sensors"]["lidar [cm]"]["samples"] == int((table["lidar [cm]"] != -1).sum())
        again = RUNNER.invoke(app, ["monitor", command[1], "--model", command[-1], "--json"])
        assert json.loads(again.stdout)["sensors"] == report["sensors"]


def test_texts_in_place_of_samples_count_as_missing(tmp_path):
    command = flown(tmp_path)
    table = pd.read_csv(tmp_path / "flight.csv").astype({"lidar": object})
    table.loc[100:149, "lidar"], table.loc[300, "lidar"] = "Bad Input", "No Data"
    table.to_csv(tmp_path / "flight.csv", index=False)
    refused = RUNNER.invoke(app, command)
    options = ["--invalid", "Bad Input", "--invalid", "lidar=No Data"]
    assert (
        "add --invalid 'Bad Input' --invalid 'No Data' to --fit, or invalid = [\"Bad Input\", \"No Data\"] to a model"
        in (" ".join(refused.output.split()))
    )
    report = json.loads(RUNNER.invoke(app, [*command, *options, "--json"]).stdout)
    assert report["sensors"]["lidar"]["samples"] == 3000 - 51
    again = RUNNER.invoke(app, ["monitor", command[1], "--model", command[-1], "--json"])
    assert json.loads(again.stdout)["sensors"] == report["sensors"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--fit", "--invalid", "lidar"], "'lidar' has no number. Write --invalid 0 for all columns"),
        (["--fit", "--invalid", "lidar="], "'lidar=' has no value. Write --invalid 0 for all columns"),
        (["--model", "model.toml", "--invalid", "0"], "--invalid is for a fit: add --fit"),
    ],
)
def test_an_invalid_value_that_cannot_be_is_refused(tmp_path, options, words):
    done = RUNNER.invoke(app, ["monitor", flown(tmp_path)[1], *options])
    assert done.exit_code == 2
    assert words in " ".join(done.output.replace("│", " ").split())


def test_a_column_that_does_not_follow_is_named(tmp_path):
    rng = np.random.default_rng(1)
    command = flown(tmp_path, sonar=3 + 0.5 * rng.standard_normal(3000))
    note, one_by_one = json.loads(RUNNER.invoke(app, [*command, "--json"]).stdout)["notes"]
    assert one_by_one.startswith("The model file has no joint = true, because of sonar: sensors are judged one by one")
    assert re.match(
        r"sonar does not follow the other sensors: while they move by 1, it moves by -?0\.?\d*\. Motion ", note
    )
    two = RUNNER.invoke(app, [*command, "--overwrite", "--json", "--sensor=baro", "--sensor=sonar"])
    assert any(note.startswith("baro and sonar do not agree") for note in json.loads(two.stdout)["notes"])


def test_a_column_of_another_quantity_is_named_by_its_place_or_its_missing_unit():
    rng = np.random.default_rng(0)
    t, y = 0.1 * np.arange(3000), 50 + 0.01 * rng.standard_normal((3000, 3))
    columns = dict(zip(("f1 [Hz]", "f2 [Hz]", "u"), y.T, strict=True))

    def said(u):
        signals = {name: monitoring.Signal(t, values) for name, values in (columns | {"u": u}).items()}
        samples = monitoring.recorded(signals)
        fitted, places = monitoring.fit_model(samples), {name: monitoring.Place("", name, "t") for name in signals}
        return [*_monitor_fit._strangers(fitted, samples), *_monitor_fit._without_unit(fitted, places)]

    (note,) = said(y[:, 2] - 50)
    assert note.startswith(
        "u does not seem to measure the same quantity as the other sensors: it lies at 0, they lie at about 50, and it does not "
        "visibly move with them. "
    )
    assert "If u measures another quantity, leave it out: name the others with --sensor." in note
    (note,) = said(y[:, 2])
    assert note.startswith(
        "u has no unit in brackets, but f1 [Hz] has. The fit takes all for samples in Hz. If a column measures"
    )


def test_a_column_that_moves_the_other_way_is_named_with_what_to_write(tmp_path):
    """In an error where its distance is larger than the motion of the others, else in a note."""
    rng, t = np.random.default_rng(0), np.arange(3000)
    command = ["monitor", str(tmp_path / "dive.csv"), "--fit", "--model", str(tmp_path / "model.toml"), "--json"]

    def said(depth):
        table = pd.DataFrame({"t": t, **{name: depth + 0.1 * rng.standard_normal(3000) for name in "abc"}})
        table["c"] = 40.0 - table["c"]
        table.to_csv(tmp_path / "dive.csv", index=False)
        return RUNNER.invoke(app, command)

    refused = " ".join(said(15 + 3 * np.sin(2 * np.pi * t / 300)).output.split())
    assert "'c' moves the other way than the others" in refused
    assert float(re.search(r"gain = -1\.0, bias = ([\d.]+), and its std", refused)[1]) == pytest.approx(40.0, abs=0.1)
    swings = 15 + 0.9 ** (t[:, None] - t[None]).clip(0) * (t[:, None] >= t[None]) @ rng.standard_normal(3000)
    note, _ = json.loads(said(swings).stdout)["notes"]
    assert note.startswith("c does not follow the other sensors: while they move by 1, it moves by -")
    bias = float(re.search(r"write gain = -1\.0 and bias = ([\d.]+) below \[sensors\.c\]", note)[1])
    assert bias == pytest.approx(40.0, abs=0.5)


def test_a_column_in_degrees_fahrenheit_is_named(tmp_path):
    rng, t = np.random.default_rng(0), np.arange(3000)
    level = 120 + 30 * np.sin(2 * np.pi * t / 300)
    table = pd.DataFrame({"t": t, **{name: level + 0.3 * rng.standard_normal(3000) for name in "abc"}})
    table["b"] = 1.8 * table["b"] + 32
    table.round(2).to_csv(tmp_path / "plant.csv", index=False)
    command = ["monitor", str(tmp_path / "plant.csv"), "--fit", "--model", str(tmp_path / "model.toml"), "--json"]
    note, _ = json.loads(RUNNER.invoke(app, command).stdout)["notes"]
    assert note.startswith("b does not follow the other sensors: while they move by 1, it moves by 1.8. ")
    assert (
        "A factor of 1.8 is that from degC to degF. If these are the units, name the columns 'b [degF]' and 'a [degC]'"
        in note
    )
    named = table.rename(columns={"a": "a [degC]", "b": "b [degF]"})
    named.to_csv(tmp_path / "plant.csv", index=False)
    assert json.loads(RUNNER.invoke(app, [*command, "--overwrite"]).stdout)["notes"] == []


def test_a_drift_that_stays_is_named_with_its_beginning_and_its_end(tmp_path):
    rng, t = np.random.default_rng(0), np.arange(6000)
    level = 20 + 5 * np.sin(2 * np.pi * t / 900)
    table = pd.DataFrame({"t": t, **{name: level + 0.3 * rng.standard_normal(6000) for name in "abc"}})
    table["b"] += 3 * np.clip((t - 2000) / 1500, 0, 1)
    table.round(2).to_csv(tmp_path / "plant.csv", index=False)
    command = ["monitor", str(tmp_path / "plant.csv"), "--fit", "--model", str(tmp_path / "model.toml"), "--json"]
    notes = json.loads(RUNNER.invoke(app, command).stdout)["notes"]
    (note,) = (note for note in notes if note.startswith("From about"))
    found = re.match(
        r"From about (\d+) s on, b moves away from the other sensors\. From about (\d+) s until the end \(5999 s\) it is "
        r"[23]\.\d+ above its place among the other sensors\. .* fit with --to (\d+)\. If it has been healthy since it has "
        r"stayed there, fit with --from (\d+)\. ",
        note,
    )
    begin, reached, to, since = map(int, found.groups())
    assert (to, since) == (begin, reached)
    assert 1800 <= begin <= 2100
    assert 3200 <= reached <= 3700


def test_a_gain_error_is_named(tmp_path):
    rng, t = np.random.default_rng(0), np.arange(10000)
    level = 12 + 2.5 * np.sin(2 * np.pi * t / 1440)
    table = pd.DataFrame({"t": t, **{name: level + 0.1 * rng.standard_normal(len(t)) for name in "ab"}})
    table["b"] *= 1.02
    table.round(3).to_csv(tmp_path / "flow.csv", index=False)
    command = ["monitor", str(tmp_path / "flow.csv"), "--fit", "--model", str(tmp_path / "model.toml"), "--json"]
    notes = json.loads(RUNNER.invoke(app, command).stdout)["notes"]
    assert any(note.startswith("While a moves by 1, b moves by 1.0") for note in notes)
    assert any("The model file has this gain" in note for note in notes)
    monitor = load_monitor(tmp_path / "model.toml")
    assert monitor.sensors["b"].gain == pytest.approx(1.02, abs=0.003)
    (bias,) = re.findall(r"write gain = 1 and bias = (\S+) below \[sensors.b\]", " ".join(notes))
    assert float(bias) == pytest.approx(0.24, abs=0.02)
    table.loc[: len(t) // 3, "b"] *= 1.05
    table.round(3).to_csv(tmp_path / "flow.csv", index=False)
    notes = json.loads(RUNNER.invoke(app, [*command, "--overwrite"]).stdout)["notes"]
    assert any("but not in both halves of the recording" in note for note in notes)
    assert load_monitor(tmp_path / "model.toml").sensors["b"].gain == 1.0


def test_a_log_of_changes_is_named(tmp_path, caplog):
    """The columns are named once, though the fit and the monitor read them."""
    rng = np.random.default_rng(0)
    level = 20.0 + np.cumsum(0.05 * rng.standard_normal(2000))
    values = np.round((level[:, None] + 0.2 * rng.standard_normal((2000, 3))) / 0.1) * 0.1
    table = pd.DataFrame({"t": np.arange(2000.0), **{name: values[:, i] for i, name in enumerate("abc")}})
    for name in "ab":
        table[name] = table[name].where(table[name].diff() != 0.0)
    table.to_csv(tmp_path / "log.csv", index=False)
    words = "The columns 'a', 'b' seem to have a value only where it has changed"
    done = RUNNER.invoke(app, ["monitor", str(tmp_path / "log.csv"), "--fit", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert caplog.text.count(words) == 1


def test_sensors_that_are_open_at_the_same_time_have_one_sentence(capsys):
    """Three pairs of three sensors had a line each, also beside alarms that the model causes."""
    t = np.arange(100.0)
    recording = align({name: Signal(t, np.zeros(100)) for name in "abc"}, {}, dt=1)
    pairs = [Disagreement(pair, 10.0, 20.0, 0.9) for pair in (("a", "b"), ("a", "c"), ("b", "c"))]
    pairs += [Disagreement(("a", "b"), 51.0, 60.0, 0.95), Disagreement(("b", "c"), 80.0, 90.0, 0.97)]
    monitored = SimpleNamespace(recording=recording, alarm=Alarm(hold=5.0))
    doubtful = FaultEvent("a", 40.0, 48.0, 1.0, "Offset")
    print_disagreements(monitored, pairs, [doubtful])
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.count("it is open which") == 2
    assert (
        "From 10.00 to 20.00 s it is open which of a, b and c is faulty, or whether the model is wrong (the" in printed
    )
    assert (
        "From 80.00 to 90.00 s it is open which of b and c is faulty (the sum of two fault probabilities reaches 0.97)"
        in printed
    )


@pytest.mark.parametrize("with_errors", [[], ["a"], ["a", "b"]])
def test_more_motion_is_advised_with_the_fault_that_the_fit_may_have_taken_for_lasting_errors(with_errors):
    """Errors of all sensors that are blamed are no fault of one of them."""
    errors = [SensorErrors(0.3, 40.0, [name]) for name in with_errors]
    fitted = SimpleNamespace(model=SimpleNamespace(errors=errors, sensors={"a": None, "b": None}))
    suspicion = SimpleNamespace(sensors=("a", "b"), setting="motion")
    words = _remedy(None, fitted, suspicion, Path("model.toml"))
    assert words.startswith("Change it in model.toml and give --model model.toml without --fit.")
    assert ("If a failed in this recording, which the model now expects" in words) == (with_errors == ["a"])


def test_sensors_that_agree_while_the_quantity_moves_have_a_note_instead_of_an_open_fault(tmp_path):
    t, rng = np.arange(1000.0), np.random.default_rng(0)
    level = 20.0 + 4.4 * ((t > 0) + 0.16 * (t > 1) - 0.57 * (1.0 - np.exp(-t / 60.0)))
    noise = 0.1 * rng.standard_normal((1000, 2))
    pd.DataFrame({"t": t, "a": level + noise[:, 0], "b": level + noise[:, 1]}).to_csv(tmp_path / "y.csv", index=False)
    model = "dt = 1\njoint = true\n[model]\nkind = 'RandomWalk'\nstd = 0.1\n[sensors]\na.std = 0.1\nb.std = 0.1\n"
    (tmp_path / "model.toml").write_text(model)
    command = ["monitor", str(tmp_path / "y.csv"), "--model", str(tmp_path / "model.toml")]
    numbers = json.loads(RUNNER.invoke(app, [*command, "--json"]).stdout)
    assert numbers["disagreements"] == []
    assert any("a and b agree, but by the model both are probably faulty" in note for note in numbers["notes"])
    printed = " ".join(RUNNER.invoke(app, command).output.split())
    assert "No fault was found." in printed
    assert "it is open" not in printed
    assert "a and b agree, but by the model both are probably faulty" in printed
