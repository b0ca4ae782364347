"""The example of redundant speed sensors: its made-up drive, and that faults are found in it and in the recorded one."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.examples.redundant_speed_sensors import fit, study, synthetic, watch
from bayesftc.monitoring import align, load_monitor
from bayesftc.monitoring.figure import plot_monitored

FOLDER = Path(study.__file__).parent
RECORDED = study.recorded()
NEEDS_RECORDING = "the recorded drive is not here: BAYESFTC_DATA names no folder with comma2k19 in it"


@pytest.fixture
def recorded():
    """The folder of the recorded drive."""
    if RECORDED is None:
        pytest.skip(NEEDS_RECORDING)
    return RECORDED


def test_no_part_is_forgotten_and_the_drive_is_small():
    assert {p.stem for p in FOLDER.glob("*.py")} - {"__init__"} == {"command", "fit", "study", "synthetic", "watch"}
    assert sum(p.stat().st_size for p in (FOLDER / "data").iterdir()) < 300_000


def test_the_drives_files_are_what_its_script_writes(tmp_path):
    synthetic.main([str(tmp_path)])
    for file in tmp_path.iterdir():
        # Sines and exponentials may differ in the last bit between machines, and so a wheel's sample by one step.
        ours, theirs = (np.loadtxt(f, delimiter=",", skiprows=1) for f in (file, FOLDER / "data" / file.name))
        np.testing.assert_allclose(ours, theirs, atol=0.003)


def test_the_drive_with_faults_is_shipped(tmp_path):
    watch.write(tmp_path)
    for file in (FOLDER / "faulty").iterdir():
        ours, theirs = (np.genfromtxt(f, delimiter=",", skip_header=1) for f in (tmp_path / file.name, file))
        np.testing.assert_allclose(ours, theirs, atol=0.003)
    gnss = np.genfromtxt(FOLDER / "faulty" / "gnss_speed.csv", delimiter=",", skip_header=1)
    assert np.isnan(gnss[:, 1]).sum() == 40
    monitor = load_monitor(FOLDER / "data" / "model.toml")
    found = monitor.run(align(*monitor.signals([FOLDER / "faulty"]), monitor.dt))
    assert [event.sensor for event in found.events] == [name for name, *_ in watch.FAULTS]
    figure = plot_monitored(found)
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == ["belief (m/s)", *(f"{s}\n(m/s)" for s in found.recording.sensors), "fault probability"]


def test_the_made_up_drive_is_like_the_recorded_one():
    wheel = synthetic.drive()["wheel_speed.csv"]
    readings = np.column_stack([wheel[name] for name in synthetic.WHEELS])
    errors = readings - synthetic.speed(wheel["t"])[:, None]
    repeats = (np.diff(readings, axis=0) == 0).mean(axis=0)
    assert ((repeats > 0.037) & (repeats < 0.05)).all()
    assert np.median(np.diff(wheel["t"])) == pytest.approx(1 / 83, abs=2e-4)
    np.testing.assert_allclose(errors.mean(axis=0), -0.15, atol=0.02)
    lasting = [np.corrcoef(errors[1:, i], errors[:-1, i])[0, 1] for i in range(4)]
    assert 0.68 < min(lasting) < max(lasting) < 0.85
    shared = np.corrcoef(errors.T)
    assert shared[0, 1] == pytest.approx(0.83, abs=0.08)
    assert shared[2, 3] == pytest.approx(0.70, abs=0.08)


def test_four_faults_are_found_with_their_kinds(capsys):
    found = watch.main([])
    kinds = {"noise": "Noisier", "freeze": "Frozen", "dropout": "DroppedOut", "drift": "Drifting"}
    assert [(e.sensor, e.kind) for e in found.events] == [(name, kinds[kind]) for name, kind, *_ in watch.FAULTS]
    for event, (*_, span) in zip(found.events, watch.FAULTS, strict=True):
        assert event.onset == pytest.approx(span[0], abs=0.2)
        assert event.end == pytest.approx(span[1], abs=0.1)
    assert len(capsys.readouterr().out.splitlines()) == 8


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("main", "arguments", "code", "words"),
    [
        (study.main, ["nowhere"], 16, "nowhere does not exist"),
        (study.main, ["--model", "nowhere.toml"], 3, "no model file nowhere.toml"),
        (study.main, ["--model", "fixed.toml"], 9, "fixed.toml gives no fault probability to study: FixedPrecision"),
        (study.main, ["short"], 16, "The drive in short ends at 35.0 s. A study needs"),
        (study.main, ["--onsets", "1"], 2, "'1' must be a whole number of at least 2"),
        (study.main, ["--seed", "-1"], 2, "'-1' must be a whole number of at least 0"),
        (fit.main, ["--start", "30"], 16, "no samples between 30 and 20 s"),
        (fit.main, ["--iterations", "x"], 2, "'x' must be a whole number"),
        (watch.main, ["--figure", "nowhere/x.png"], 12, "x.png cannot be written"),
        (watch.main, ["--figure", "x.abc"], 2, "'abc' is not supported"),
        (synthetic.main, ["fixed.toml"], 12, "fixed.toml cannot be written"),
        (synthetic.main, [], 2, "required: folder"),
    ],
)
def test_wrong_arguments_end_in_a_sentence(main, arguments, code, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BAYESFTC_DATA", raising=False)
    if "short" in arguments:
        (tmp_path / "short").mkdir()
        for file in (FOLDER / "data").glob("*.csv"):
            head, *rows = file.read_text(encoding="utf-8").splitlines(keepends=True)
            text = head + "".join(row for row in rows if float(row.split(",")[0]) < 35.0)
            (tmp_path / "short" / file.name).write_text(text, encoding="utf-8")
    model = (FOLDER / "data" / "model.toml").read_text(encoding="utf-8")
    (tmp_path / "fixed.toml").write_text(model + '[precision]\nkind = "FixedPrecision"\n', encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == code
    assert words in capsys.readouterr().err


def test_a_folder_of_recordings_that_is_not_there_is_none(monkeypatch, tmp_path):
    monkeypatch.setenv("BAYESFTC_DATA", str(tmp_path))
    assert study.recorded() is None
    (tmp_path / "comma2k19").mkdir()
    assert study.recorded() == tmp_path / "comma2k19"


def check(folder, onsets):
    healthy, rows = study.study(folder, onsets=onsets)
    assert len(healthy.events) <= 1
    assert [(row.kind, row.size) for row in rows] == list(study.CASES)
    for row in rows:
        assert row.low <= row.auc <= row.high <= 1.0
        if row.kind == "freeze" or row.size >= 1.0:
            assert row.auc > 0.95
            assert row.missed == 0.0
    assert "95 % interval" in study.table(healthy, rows)
    assert rows[1].delay >= rows[3].delay - 0.02  # half a metre a second is not found before two are
    return rows


@pytest.mark.slow
def test_faults_of_the_made_up_drive_are_found():
    check(FOLDER / "data", onsets=5)


def test_faults_of_the_recorded_drive_are_found(recorded):
    check(recorded, onsets=10)


def test_the_numbers_of_the_model_are_the_likeliest_of_the_recorded_drive(recorded):
    monitor = load_monitor(FOLDER / "data" / "model.toml")
    recording = fit.part(monitor, recorded, 0.0, study.FITTED)
    best, values = fit.likelihood(monitor, recording), fit.numbers(monitor)
    for name, value in values.items():
        for factor in (0.8, 1.25):
            assert fit.likelihood(fit.changed(monitor, {**values, name: factor * value}), recording) < best + 0.5


@pytest.mark.slow
def test_an_alarm_lasts_beyond_its_fault_where_sensors_with_slow_errors_are_judged_one_by_one(tmp_path):
    """The numbers of docs/tutorials/monitor.md, by its commands."""
    runner, file = CliRunner(), tmp_path / "model.toml"
    drive = tmp_path / "drive.csv"
    drive.write_text(runner.invoke(app, ["example", "faulty_wheel_speed"]).stdout, encoding="utf-8")

    def alarm(*options):
        done = runner.invoke(app, ["monitor", str(drive), *options, "--model", str(file), "--json"])
        (found,) = [each for each in json.loads(done.stdout)["faults"] if each["sensor"] == "front_right"]
        return tuple(round(found[name], 2) for name in ("start", "end", "size"))

    assert alarm("--fit") == (29.81, 35.99, 1.38)
    file.write_text(file.read_text(encoding="utf-8").replace("joint = true", "joint = false"))
    assert alarm() == (29.91, 40.0, -0.41)
    head, *errors = file.read_text(encoding="utf-8").split("[[errors]]")
    kept = [each for each in errors if float(re.search(r"time_constant = ([\d.]+)", each)[1]) < 5.0]
    assert len(errors) == len(kept) + 4
    file.write_text("[[errors]]".join([head, *kept]))
    assert alarm()[1] == pytest.approx(36.0, abs=0.1)


@pytest.mark.slow
def test_fitting_makes_the_recording_likelier():
    monitor = load_monitor(FOLDER / "data" / "model.toml")
    recording = fit.part(monitor, FOLDER / "data", 0.0, study.FITTED)
    fitted, best = fit.fit(monitor, recording, iterations=2)
    assert best > fit.likelihood(monitor, recording) + 100.0  # the file's numbers are another drive's
    assert fitted.keys() == fit.numbers(monitor).keys()
