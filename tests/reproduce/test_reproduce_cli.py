"""``bayesftc reproduce``: tables, files, and every way in which it can end."""

import json
import sys

import pytest

from bayesftc import reproduce
from bayesftc.cosim.errors import ModelError
from bayesftc.reproduce import settings
from bayesftc.reproduce.registry import EXPERIMENTS

FEW = ("--runs", "2", "--paper-only", "--jobs", "2")


@pytest.mark.slow
def test_tracking_prints_its_table_and_writes_its_files(bayesftc_, tmp_path):
    earlier = tmp_path / "here" / "there"
    earlier.mkdir(parents=True)
    for name in ("tracking_grid.png", "tracking_errors.png", "detection_roc.png", "tracking_notes.txt"):
        (earlier / name).write_text("of an earlier run")
    done = bayesftc_("reproduce", "tracking", *FEW, "--seed", 5, "--out", "here/there")
    assert done.exit_code == 0, done.output
    for text in ("total merit", "(21)", "EF-FDI", "freeze/constant", "steps per second", "tracking.json"):
        assert text in done.stdout
    # A run with --paper-only draws no grid, and one of another experiment nothing of this one.
    kept, written = {"detection_roc.png", "tracking_notes.txt"}, {p.name for p in earlier.iterdir()}
    assert written == kept | {"tracking.json", "tracking_error_over_time.png", "tracking_errors.png"}
    assert {name for name in written if (earlier / name).read_bytes() == b"of an earlier run"} == kept
    report = json.loads((tmp_path / "here" / "there" / "tracking.json").read_text())
    assert report["settings"]["seed"] == 5
    assert report["settings"]["runs"] == 2
    assert report["merit"].keys() == report["paper"]["merit"].keys()


@pytest.mark.slow
def test_json_is_one_object_with_the_experiments(bayesftc_):
    done = bayesftc_("reproduce", "tracking", *FEW, "--json")
    assert json.loads(done.stdout)["tracking"]["scenarios"]["drift/sine"]["PL"]["n"] == 2


@pytest.mark.slow
def test_quiet_prints_nothing(bayesftc_):
    assert bayesftc_("reproduce", "tracking", *FEW, "--quiet").output == ""


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("trakcing",), 5, "did you mean 'tracking'"),
        (("tracking", "--jobs", "0"), 9, "jobs is 0"),
        (("tracking", "--runs", "1"), 9, "runs is 1"),
        (("tracking", "--seed", "-1"), 9, "seed"),
    ],
)
def test_wrong_input_is_a_sentence(bayesftc_, arguments, code, words):
    done = bayesftc_("reproduce", *arguments)
    assert done.exit_code == code
    assert words in done.stderr
    assert "Traceback" not in done.output


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: settings.Arm(threshold_runs=0), "threshold_runs is 0"),
        (lambda: settings.Arm(start=(0.0,)), "must be a tuple of 2 numbers"),
        (lambda: settings.Arm(detection_groups=((0, 9),)), "samples from 0 to 5"),
        (lambda: settings.Tracking(significance=5), "significance=5"),
        (lambda: settings.Tracking(injections=(1.0, "large")), "which contains='large'"),
        (lambda: settings.Detection(training_share=1.0), "training_share=1.0"),
        (lambda: settings.Car(drag=None), "drag=None"),
        (lambda: reproduce.tracking(settings=settings.Arm()), "This experiment takes Tracking"),
        (lambda: reproduce.arm(settings={}), "This experiment takes Arm"),
    ],
)
def test_wrong_settings_are_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()


def test_help_says_what_each_experiment_is(bayesftc_):
    lines = bayesftc_("reproduce", "--help").stdout.splitlines()
    for experiment in EXPERIMENTS.values():
        (line,) = (line for line in lines if line.split()[:1] == [experiment.name])
        assert ("Beyond the paper" in line) == experiment.beyond


def test_a_folder_that_cannot_be_written_is_told_before_the_run(bayesftc_, tmp_path):
    (tmp_path / "file").write_text("")
    done = bayesftc_("reproduce", "all", "--out", "file/below")
    assert done.exit_code == 12
    assert "not a folder" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_every_experiment_says_what_its_list_demands():
    from bayesftc import reproduce

    assert set(reproduce.__all__) == set(EXPERIMENTS)
    for name, experiment in EXPERIMENTS.items():
        assert getattr(reproduce, name) is experiment.run
    with pytest.raises(AttributeError):
        _ = reproduce.nothing


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_stops_at_once_and_leaves_nothing(stopped_by_ctrl_c, tmp_path):
    arguments = ["reproduce", "tracking", "--paper-only", "--runs", "20000", "--jobs", "2", "--out", "out"]
    # The first task is done; all of them would take minutes.
    code, errors = stopped_by_ctrl_c(*arguments, after="The paper's table 1 ")
    assert code == 130
    assert "Stopped by Ctrl-C" in errors
    assert not (tmp_path / "out").exists()
