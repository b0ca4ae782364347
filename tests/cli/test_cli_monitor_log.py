"""``bayesftc monitor`` with the log of a plant: dates, columns with units, and gaps of the logger."""

import json
import re
from datetime import datetime, timedelta
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.controllers.bayesian import recorded
from bayesftc.monitoring import Signal, align, load_monitor

RUNNER = CliRunner()
SENSORS = ("TT-1 [degC]", "TT-2 [degC]", "TT-3 [degC]")
MODEL = """
dt = 5
time = "when"
[model]
kind = "RandomWalk"
std = 0.05
""" + "".join(f'[sensors."{name}"]\nstd = 0.1\n' for name in SENSORS)


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    """Run compiled, as longer recordings do."""
    monkeypatch.setattr(recorded, "SHORT", 0)


@pytest.fixture
def table():
    """Fifty minutes of three thermometers, of which the second jumps by 2 degrees after 25 minutes."""
    rng = np.random.default_rng(0)
    level = 60.0 + np.cumsum(0.05 * rng.standard_normal(600))
    table = pd.DataFrame({name: level + 0.1 * rng.standard_normal(600) for name in SENSORS})
    table.loc[300:, SENSORS[1]] += 2.0
    return table.round(2)


def write(folder, table, dates="2026-03-29T08:00:00+02:00"):
    """Write the log and a model; the dates begin with the given one, or they are seconds."""
    seconds = 5 * np.arange(600)
    when = (
        [(datetime.fromisoformat(dates) + timedelta(seconds=int(s))).isoformat() for s in seconds] if dates else seconds
    )
    table = table.assign(when=when)[["when", *table.columns]]
    table.to_csv(folder / "log.csv", index=False)
    (folder / "model.toml").write_text(MODEL, encoding="utf-8")
    return ["monitor", str(folder / "log.csv"), "--model", str(folder / "model.toml")]


def invoke(*arguments, code=0):
    done = RUNNER.invoke(app, list(map(str, arguments)))
    assert done.exit_code == code, done.output
    return done


def words(done):
    return " ".join(done.output.replace("\u2502", " ").split())


def test_dates_are_printed_and_written_as_dates(table, tmp_path):
    done = invoke(*write(tmp_path, table), "--out", tmp_path / "out")
    assert "2026-03-29 08:00:00 to 08:49:55 (UTC+02:00), 600 steps of 5 s" in done.stdout
    assert "Faults on 2026-03-29" in done.stdout
    (row,) = (line.split() for line in done.stdout.splitlines() if "Offset" in line)
    assert row[:4] == ["TT-2", "[degC]", "Offset", "08:25:00"]
    assert row[5:7] == ["to", "08:49:55"]
    assert row[-1] == "degC"  # from the name of the column
    report = json.loads((tmp_path / "out" / "faults.json").read_text(encoding="utf-8"))
    assert report["start_date"] == "2026-03-29T08:00:00.000+02:00"
    (fault,) = report["faults"]
    begin = datetime.fromisoformat("2026-03-29T08:00:00+02:00")
    for name in ("start", "end", "onset"):
        assert datetime.fromisoformat(fault[f"{name}_date"]) - begin == pytest.approx(
            timedelta(seconds=fault[name]), abs=timedelta(milliseconds=1)
        )
    written = pd.read_csv(tmp_path / "out" / "probabilities.csv")
    assert list(written.columns[:2]) == ["t", "date"]
    np.testing.assert_array_equal((pd.to_datetime(written.date) - begin) / pd.Timedelta("1 s"), written.t)


def test_dates_of_two_days_have_their_day(table, tmp_path):
    done = invoke(*write(tmp_path, table, "2026-03-29T23:40:00"))
    assert "2026-03-29 23:40:00 to 2026-03-30 00:29:55, 600 steps" in done.stdout
    assert "Faults on" not in done.stdout
    assert "2026-03-30 00:05:00" in done.stdout


@pytest.mark.slow
def test_seconds_stay_seconds(table, tmp_path):
    done = invoke(*write(tmp_path, table, None), "--out", tmp_path / "out")
    assert "0 to 2995 s, 600 steps of 5 s" in done.stdout
    assert "onset (s)" in done.stdout
    assert "_date" not in (tmp_path / "out" / "faults.json").read_text(encoding="utf-8")
    assert "date" not in pd.read_csv(tmp_path / "out" / "probabilities.csv").columns


@pytest.mark.parametrize(
    "moment", ["2026-03-29T08:20", "2026-03-29 08:20:00", "29.03.2026 08:20", "2026-03-29T06:20Z", "1200"]
)
def test_a_stretch_is_named_by_dates_or_seconds(table, tmp_path, moment):
    log = write(tmp_path, table)[1]
    model = tmp_path / "fitted.toml"
    done = invoke("monitor", log, "--fit", "--model", model, "--to", moment)
    assert "Offset" in done.stdout
    first = model.read_text(encoding="utf-8").splitlines()[0]
    assert first == (
        "# Fitted by bayesftc monitor --fit to 2026-03-29 08:00:00 to 08:49:55, with healthy sensors from 2026-03-29 08:00:00 to "
        "08:20:00."
    )


@pytest.mark.parametrize(
    ("dates", "moment", "code", "sentence"),
    [
        (
            None,
            "2026-03-29",
            16,
            "The end (--to) is a date, but the times of the recording are 0 to 2995 s. Give seconds.",
        ),
        (
            "2026-03-29T08:00:00",
            "2026-03-29T08:20Z",
            16,
            "The end (--to) has a time zone, but the dates of the recording, 2026-03-29",
        ),
        (
            "2026-03-29T08:00:00",
            "2026-03-28",
            16,
            "The recording, from 2026-03-29 08:00:00 to 08:49:55, has no samples",
        ),
        ("2026-03-29T08:00:00", "08:20", 2, "'08:20' is neither a number of seconds nor a date. Write --to 12.5"),
        (
            "2026-03-29T08:00:00",
            "31.02.2026",
            2,
            "'31.02.2026' is neither a number of seconds nor a date. Write --to 12.5",
        ),
    ],
)
def test_a_moment_that_cannot_be_is_refused(table, tmp_path, dates, moment, code, sentence):
    log = write(tmp_path, table, dates)[1]
    done = invoke("monitor", log, "--fit", "--model", tmp_path / "fitted.toml", "--to", moment, code=code)
    assert sentence in words(done)
    assert not (tmp_path / "fitted.toml").exists()


def test_a_column_is_named_without_its_unit(table, tmp_path):
    log = write(tmp_path, table)[1]
    arguments = ["monitor", log, "--fit", "--model", tmp_path / "fitted.toml", "--json"]
    done = invoke(*arguments, "--sensor", "TT-1", "--sensor", "TT-2 [degC]")
    assert list(json.loads(done.stdout)["sensors"]) == list(SENSORS[:2])
    write(tmp_path, table.rename(columns={SENSORS[2]: "TT-1 [K]"}))
    assert "'TT-1' can be 'TT-1 [K]' or 'TT-1 [degC]'" in words(invoke(*arguments, "--sensor", "TT-1", code=16))
    assert "no column 'TT-4' with numbers" in words(invoke(*arguments, "--sensor", "TT-4", code=16))


def test_the_fitted_motion_is_that_of_the_samples_and_has_a_unit(table, tmp_path):
    log = write(tmp_path, table)[1]
    done = invoke("monitor", log, "--fit", "--model", tmp_path / "walk.toml", "--to", 1400)
    change = re.search(
        r"changes by about (\S+) degC in one second \((\S+) degC in a sample of 5 s\), at random \(Rand", words(done)
    )
    assert change is not None
    assert float(change[2]) == pytest.approx(0.05, rel=0.3)  # of the fixture
    assert float(change[1]) == pytest.approx(float(change[2]) / 5**0.5, rel=0.1)
    assert "Noise, lasting errors, bias and resolution are in degC." in done.stdout
    text = (tmp_path / "walk.toml").read_text(encoding="utf-8")
    assert f"of its change in one second, in degC; in 5 s: {change[2]}\n" in text
    smooth = 60.0 + 20.0 * np.sin(np.arange(600) / 40)
    log = write(tmp_path, table.assign(**{name: table[name] - table[SENSORS[0]] + smooth for name in SENSORS}))[1]
    done = invoke("monitor", log, "--fit", "--model", tmp_path / "rate.toml", "--to", 1400)
    change = re.search(
        r"The rate .* by about (\S+) degC/s in one second, at random \(ConstantRate\)\. It often changes less",
        words(done),
    )
    assert change is not None
    (std,) = re.findall(
        r"^std = (\S+)  # of the rate's change in one second", (tmp_path / "rate.toml").read_text("utf-8"), re.M
    )
    assert float(change[1]) == pytest.approx(float(std), rel=0.06)


@pytest.mark.slow
def test_a_model_that_blames_sensors_that_agree_is_suspected(table, tmp_path):
    arguments = write(tmp_path, table)
    model = tmp_path / "model.toml"
    model.write_text(model.read_text(encoding="utf-8").replace("std = 0.05", "std = 0.002"), encoding="utf-8")
    done = invoke(*arguments)
    assert "Suspect the model, not the sensors: " in done.stdout
    assert "This ends with std = 0.0" in done.stdout
    assert "bayesftc monitor --fit finds such numbers in a recording." in done.stdout
    report = json.loads(invoke(*arguments, "--json").stdout)
    (note,) = report["notes"]
    assert note in done.stdout
    doubtful = sum(fault["doubtful"] for fault in report["faults"])
    assert doubtful > 1
    assert (
        f"In brackets: {doubtful} of {len(report['faults'])}, which are probably no faults of sensors." in done.stdout
    )
    assert "(Offset)" in done.stdout
    right = json.loads(invoke(*write(tmp_path, table), "--json").stdout)
    assert [fault["doubtful"] for fault in right["faults"]] == [False]
    assert right["notes"] == []


def silent(table, first, last, sensors=SENSORS):
    table = table.copy()
    table.loc[first : last - 1, list(sensors)] = np.nan
    return table


@pytest.mark.sampled(1)
@pytest.mark.parametrize("rows", ["empty", "missing"])
def test_a_gap_of_the_logger_is_no_fault(table, tmp_path, rows):
    arguments = write(tmp_path, silent(table, 100, 160))
    if rows == "missing":
        log = pd.read_csv(tmp_path / "log.csv")
        log.dropna().to_csv(tmp_path / "log.csv", index=False)
    done = invoke(*arguments, "--out", tmp_path / "out")
    assert "from 2026-03-29 08:08:15 to 08:13:20 (60 samples). A gap is no fault." in done.stdout
    assert "DroppedOut" not in done.stdout
    report = json.loads((tmp_path / "out" / "faults.json").read_text(encoding="utf-8"))
    assert [(fault["sensor"], fault["kind"]) for fault in report["faults"]] == [(SENSORS[1], "Offset")]
    (gap,) = report["gaps"]
    assert (gap["start"], gap["end"], gap["samples"]) == (495.0, 800.0, 60)
    assert gap["end_date"] == "2026-03-29T08:13:20.000+02:00"


def test_a_sensor_that_drops_out_is_a_fault_also_beside_a_gap(table, tmp_path):
    """The first thermometer is silent before the gap already, and the third later, alone."""
    logged = silent(silent(silent(table, 60, 160, SENSORS[:1]), 100, 160), 200, 230, SENSORS[2:])
    report = json.loads(invoke(*write(tmp_path, logged), "--json").stdout)
    dropped = [
        (fault["sensor"], fault["start"], fault["end"]) for fault in report["faults"] if fault["kind"] == "DroppedOut"
    ]
    (first, begin, end), (third, *_) = dropped
    assert (first, third) == (SENSORS[0], SENSORS[2])
    assert 300 <= begin < 340
    assert end == 795  # up to its next sample
    assert [gap["samples"] for gap in report["gaps"]] == [60]


@pytest.mark.parametrize(("late", "dropped"), [(1, False), (2, False), (12, True)])
def test_a_sensor_may_come_back_a_little_later(table, tmp_path, late, dropped):
    logged = silent(silent(table, 100, 160), 160, 160 + late, SENSORS[2:])
    report = json.loads(invoke(*write(tmp_path, logged), "--json").stdout)
    kinds = [fault["kind"] for fault in report["faults"] if fault["sensor"] == SENSORS[2]]
    assert kinds == ["DroppedOut"] * dropped


def test_a_sample_missing_soon_after_a_gap_is_no_dropout(table, tmp_path):
    report = json.loads(
        invoke(*write(tmp_path, silent(silent(table, 100, 160), 161, 162, SENSORS[:1])), "--json").stdout
    )
    assert [fault["kind"] for fault in report["faults"]] == ["Offset"]


def test_a_fault_before_a_gap_goes_on_in_it(table, tmp_path):
    report = json.loads(invoke(*write(tmp_path, silent(table, 350, 400)), "--json").stdout)
    (fault,) = report["faults"]  # although the learner has forgotten it in so long a gap
    assert (fault["sensor"], fault["kind"], fault["end"]) == (SENSORS[1], "Offset", 2995.0)
    assert fault["onset"] <= fault["start"] < 1600


def test_a_fault_that_ends_before_a_gap_is_not_that_after_it(table, tmp_path):
    """The sensor is healthy for 100 s before the gap, or for 250 s after it."""
    for healthy in (slice(330, 349), slice(400, 449)):
        repaired = table.copy()
        repaired.loc[healthy, SENSORS[1]] -= 2.0
        report = json.loads(invoke(*write(tmp_path, silent(repaired, 350, 400)), "--json").stdout)
        assert [fault["sensor"] for fault in report["faults"]] == [SENSORS[1]] * 2


@pytest.mark.parametrize(
    ("there", "gaps"),
    [
        (lambda k: (np.r_[0:40, 50:90], np.r_[0:40, 50:90]), [(39, 50, 10)]),
        (lambda k: (np.r_[0:40, 42:90], np.r_[0:40, 42:90]), []),  # a single sample is missing
        (lambda k: (np.r_[0:40, 50:90], np.r_[0:90:10]), []),  # only the fast sensor is silent
        (lambda k: (np.r_[0:40, 90:140], np.r_[0:40:10, 90:140:10]), [(39, 90, 4)]),
        (lambda k: (np.r_[0:40, 50:90], np.r_[0:20, 60:90]), []),  # the second has failed before
        (lambda k: (np.r_[0:40, 50:90],), []),  # a single sensor drops out
        (lambda k: (k[k % 7 > 4], k[k % 7 > 4]), []),  # the logger misses five of seven all the time
    ],
)
def test_a_gap_is_the_silence_of_several_sensors_at_once(there, gaps):
    steps = there(np.arange(140))
    signals = {str(i): Signal(own.astype(float), np.sin(own)) for i, own in enumerate(steps)}
    found = align(signals, {}, dt=1.0).gaps
    assert [(gap.start, gap.end, gap.samples) for gap in found] == gaps


def test_many_gaps_are_counted_and_the_longest_named(table, tmp_path):
    for k in range(7):
        table = silent(table, 20 + 30 * k, 30 + 31 * k)
    done = invoke(*write(tmp_path, table, None))
    sentence = (
        "The recording has 7 gaps, in which no sensor has a sample. The longest: from 395.00 to 460.00 s (12 samples)"
    )
    assert sentence in done.stdout
    assert len(re.findall(r"\(\d+ samples\)", done.stdout)) == 5


def test_the_figure_has_dates_gaps_bare_names_and_the_kinds_of_faults(table, tmp_path):
    arguments = write(tmp_path, silent(table, 100, 160))
    monitor = load_monitor(arguments[-1])
    figure = monitor.run(monitor.read([arguments[1]])).plot()
    figure.draw_without_rendering()
    *_, last = figure.axes
    assert last.get_xlabel() == "time (UTC+02:00)"
    ticks = [tick.get_text() for tick in last.get_xticklabels()]
    assert "08:30" in ticks
    assert [axis.get_ylabel() for axis in figure.axes[:3]] == ["belief (degC)", "TT-1\n(degC)", "TT-2\n(degC)"]
    assert [[text.get_text() for text in axis.texts] for axis in figure.axes[:4]] == [["TT-2: Offset"], [], [], []]
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["belief", "shaded: an alarm", "dotted: a gap of\nthe recording"]
    assert [text.get_text() for text in last.get_legend().get_texts()] == ["TT-1", "TT-2", "TT-3", "alarm from 0.9"]


@pytest.mark.slow
def test_many_faults_have_their_kinds_above_their_sensor(table, tmp_path):
    for k in range(6):
        table.loc[60 + 40 * k : 80 + 40 * k, SENSORS[0]] += 2.0
    for k in range(3):
        table = silent(table, 250 + 25 * k, 260 + 25 * k, SENSORS[2:])
    arguments = write(tmp_path, table)
    monitor = load_monitor(arguments[-1])
    monitored = monitor.run(monitor.read([arguments[1]]))
    figure = monitored.plot()
    figure.draw_without_rendering()
    assert [text.get_text() for text in figure.axes[0].texts] == [
        f"shaded: {len(monitored.events)} alarms, in the colour of their sensor"
    ]
    for i, sensor in enumerate(SENSORS):
        texts = figure.axes[1 + i].texts
        assert {text.get_text() for text in texts} == {
            event.kind for event in monitored.events if event.sensor == sensor
        }
        boxes = [text.get_window_extent() for text in texts]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def test_seconds_since_1970_are_shown_as_dates_and_kept_in_full(table, tmp_path):
    command = write(tmp_path, table, None)
    log = pd.read_csv(command[1])
    log["when"] += 1_777_885_920.5
    log.to_csv(command[1], index=False)
    done = invoke(*command, "--out", tmp_path / "out")
    assert "2026-05-04 09:12:00 to 10:01:55 (UTC)" in done.output
    assert "Faults on 2026-05-04" in done.output
    report = json.loads((tmp_path / "out" / "faults.json").read_text(encoding="utf-8"))
    assert (report["start"], report["start_date"]) == (1_777_885_920.5, "2026-05-04T09:12:00.500+00:00")
    assert pd.read_csv(tmp_path / "out" / "probabilities.csv").t[:2].tolist() == [1_777_885_920.5, 1_777_885_925.5]
