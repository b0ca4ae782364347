"""A campaign file from the command line: run, resumed, reported, replayed; and what can be wrong with it."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bayesftc.cosim import ScenarioError, varied
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.scenario import find_scenario
from bayesftc.scenario._files import read_toml
from bayesftc.scenario._scenario import scenario_of
from bayesftc.scenario._unused import unused_of_campaign
from bayesftc.scenario.campaigns import ScenarioLoop, load_campaign

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")

FILE = """
scenario = "cruise_control"
seeds = 3
duration = 2.0
record = ["plant.v", "reference.y", "controller.beta", "freeze_0.active"]
piece = 5

[[metrics]]
kind = "rmse"
signal = "plant.v"
reference = "reference.y"
shift = 1
name = "rmse"

[factors]
"faults[0].start" = [0.5, 1.0]

[factors."controller.precision"]
gamma = { kind = "gamma_precision", forgetting = 0.9 }
fixed = { kind = "fixed_precision" }
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "tracking.toml"
    path.write_text(FILE)
    return path


@pytest.mark.usefixtures("undrawn")
def test_from_file_to_report_and_replay(bayesftc_, file, tmp_path, same_bits):
    done = bayesftc_("campaign", file, "--jobs", 2)
    assert done.exit_code == 0, done.output
    assert "12 runs, in tracking" in done.stdout
    assert re.search(r"faults\[0\].start +┃ controller.precision +┃ runs ┃ +rmse \(m/s\) ┃", done.stdout)
    assert "12 runs, all of them from earlier, in tracking" in bayesftc_("campaign", file).stdout
    numbers = json.loads(bayesftc_("campaign", file, "--json").stdout)
    assert (numbers["runs"], numbers["failed"], len(numbers["points"])) == (12, 0, 4)
    assert numbers["units"] == {"rmse": "m/s"}
    # What is printed is what the same loops give in Python, one by one.
    campaign = load_campaign(file)
    errors = []
    for run in range(3):
        result = campaign.replay(run)
        errors.append(np.sqrt(np.mean((result["plant.v"][1:] - result["reference.y"][:-1]) ** 2)))
    first = numbers["points"][0]
    assert first["factors"] == {"faults[0].start": 0.5, "controller.precision": "gamma"}
    assert first["metrics"]["rmse"]["mean"] == pytest.approx(np.mean(errors), rel=1e-12)

    again = bayesftc_("replay", "tracking", 7, "--out", "run7")
    assert again.exit_code == 0, again.output
    assert "It has the same bits as the run in the store." in again.stdout.replace("\n", " ")
    assert {p.name for p in (tmp_path / "run7").iterdir()} == {"result.npz", "figure.png", "figures.json"}

    page = bayesftc_("report", "tracking", "-o", "report.html", "--title", "Does <it> track?")
    assert page.exit_code == 0, page.output
    text = (tmp_path / "report.html").read_text()
    assert "Does &lt;it&gt; track?" in text
    assert not re.search(r'(src|href)="(?!#)', text)  # it needs no other file
    mean = first["metrics"]["rmse"]["mean"]
    assert re.search(rf"{mean:.4g} (±|\(0 to)", text)  # of three runs the interval may reach zero
    for run in worst_runs(tmp_path / "tracking"):
        assert f"bayesftc replay {tmp_path / 'tracking'} {run}" in text


def worst_runs(folder):
    """Return the worst run of all, and that of each learner."""
    import pandas as pd

    table = pd.read_parquet(folder / "runs.parquet")
    return table["run"][[table["rmse"].idxmax(), *table.groupby("controller.precision")["rmse"].idxmax()]]


def test_factors_reach_the_scenario_that_the_file_would_say(file, same_bits, tmp_path):
    campaign = load_campaign(file)
    text = (tmp_path / "other.toml").write_text  # the same lines, changed by hand
    from bayesftc.scenario import find_scenario, load_scenario

    said = find_scenario("cruise_control").read_text()
    changed = re.sub(r"(?m)^start = 6\.0.*$", "start = 1.0", said)
    changed = re.sub(r"(?s)\[controller\.precision\].*", '[controller.precision]\nkind = "FixedPrecision"\n', changed)
    assert changed != said
    text(changed)
    loop = load_scenario(tmp_path / "other.toml").loop()
    seed = campaign.job.plan.seeds[3][1]
    same_bits(loop.simulate(2.0, seed=seed)["plant.v"], campaign.replay(10)["plant.v"])


def test_a_part_of_what_is_another_factor_is_changed_after_it(file):
    inner = FILE.replace('"faults[0].start" = [0.5, 1.0]', '"controller.precision.prior_shape" = [2.0, 3.0]')
    file.write_text(inner.replace('fixed = { kind = "fixed_precision" }', ""))
    job = load_campaign(file).job
    learners = [job.diagram(point)["controller"].block.precision for point in range(2)]
    assert [(type(one).__name__, one.forgetting, one.prior_shape) for one in learners] == [
        ("GammaPrecision", 0.9, 2.0),
        ("GammaPrecision", 0.9, 3.0),
    ]


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        ("seeds = 3", "sedes = 3", "did you mean 'seeds'"),
        ("[factors]", "[grid]", "has the unknown key 'grid'; did you mean 'factors'?"),
        ('scenario = "cruise_control"', "", "lacks 'scenario'"),
        ('scenario = "cruise_control"', 'scenario = "cruise"', "did you mean 'cruise_control'"),
        ('kind = "rmse"', 'kind = "rms"', "did you mean 'RMSE'"),
        ('signal = "plant.v"', "", "lacks 'signal'"),
        ('"faults[0].start"', '"faults[0,2]"', "write an element of a matrix as [0][2]."),
        ('"faults[0].start"', '"faults[3].start"', "the scenario has no 3 in faults; it has the elements 0 to 0."),
        ('"faults[0].start"', '"fault[0].start"', "the scenario has no 'fault'; did you mean 'faults'?"),
        (
            '"faults[0].start"',
            '"faults[0].begin"',
            "tracking.toml: The factor 'faults[0].begin' refers to the unknown key",
        ),
        ('"faults[0].start"', '"freeze_0.strat"', "the unknown key 'strat'; did you mean 'freeze_0.start'?"),
        ('"faults[0].start"', '"freeze_1.start"', "the scenario has no 'freeze_1'; did you mean 'freeze_0'?"),
        (
            "[0.5, 1.0]",
            '[0.5, "soon"]',
            "tracking.toml: The factor 'faults[0].start' has a value that the scenario rejects.",
        ),
        ("[0.5, 1.0]", "0.5", "must be a list of values"),
        ('kind = "fixed_precision"', 'kind = "fixed"', "no valid kind here"),
        ("duration = 2.0", "duration = 2.001", "duration"),
        ("piece = 5", "piece = 0", "piece"),
        ('"plant.v", "reference.y"', '"plant.w"', "no signal 'plant.w'"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_and_leaves_nothing(bayesftc_, file, tmp_path, line, instead, message):
    assert line in FILE
    file.write_text(FILE.replace(line, instead))
    done = bayesftc_("campaign", file)
    assert 1 < done.exit_code < 70, done.output
    said = re.sub(r"\s+", " ", done.stderr)
    assert message in said
    if "the scenario has no" in message:
        assert said.count("The factor") == 1  # no value is rejected
    assert [p.name for p in tmp_path.iterdir()] == ["tracking.toml"]


@pytest.mark.slow
def test_wrong_stores_and_runs_are_said(bayesftc_, file, tmp_path):
    for command in (["report", "nowhere"], ["replay", "nowhere", 0]):
        done = bayesftc_(*command)
        assert done.exit_code == 20
        assert "check the path, or run the campaign first" in re.sub(r"\s+", " ", done.stderr)
    bayesftc_("campaign", file, "-q")
    assert "the runs 0 to 11" in bayesftc_("replay", "tracking", 12).stderr
    assert "did you mean 'rmse'" in bayesftc_("report", "tracking", "--metric", "rmsse").stderr
    assert "no factor" in bayesftc_("report", "tracking", "--compare", "mass").stderr
    file.write_text(FILE.replace("seeds = 3", "seeds = 3\nseed = 7"))
    other = bayesftc_("campaign", file)
    assert other.exit_code == 20
    assert "is another one: seeds[0][0] is " in other.stderr
    assert bayesftc_("campaign", file, "--scheduler", "tcp://127.0.0.1:1", "--jobs", 2).exit_code == 9


def test_more_seeds_need_another_store(bayesftc_, file, tmp_path):
    assert bayesftc_("campaign", file).exit_code == 0
    file.write_text(FILE.replace("seeds = 3", "seeds = 5"))
    more = bayesftc_("campaign", file)
    assert more.exit_code == 20
    sentence = (
        "has seeds=3, not seeds=5. A store keeps its number of runs. Choose another folder, or give seeds=3 to go on."
    )
    assert sentence in more.stderr


@pytest.mark.slow
def test_comments_and_limits_may_change_and_what_is_run_may_not(bayesftc_, file, tmp_path):
    car = tmp_path / "car.toml"
    car.write_text(bayesftc_("example", "cruise_control").stdout)
    own = FILE.replace('"cruise_control"', '"car.toml"')
    file.write_text(own)
    assert bayesftc_("campaign", file, "-q").exit_code == 0
    file.write_text("# begun on a Monday\n" + own.replace("piece = 5", "piece = 6\ntime_limit = 100.0"))
    car.write_text("# my car\n" + car.read_text())
    assert bayesftc_("campaign", file, "-q").exit_code == 0
    assert "\nstop = 14.0" in car.read_text()
    car.write_text(car.read_text().replace("\nstop = 14.0", "\nstop = 13.0"))
    other = bayesftc_("campaign", file)
    assert other.exit_code == 20
    assert "description.scenario.faults[0].stop is 14.0 in the store and 13.0 now" in re.sub(r"\s+", " ", other.stderr)


IN_PYTHON = {
    "freeze_0.start": ("faults[0].start", [0.5, 1.0]),
    "freeze_0": ("faults[0]", [{"kind": "Drift", "sensor": 1, "start": 0.5, "slope": 1.0}]),
    "force_freeze_0.stop": ("input_faults.force[0].stop", [1.0, 1.5]),
    "plant.m": ("plant.parameters.m", [80.0, 120.0]),
    "disturbance_noise.std": ("noise.disturbance.std", [0.01, 0.02]),
    "controller.precision.forgetting": ("controller.precision.forgetting", [0.8, 0.9]),
}
"""Paths of factors as they are in Python, lines of the scenario, and values."""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("path", IN_PYTHON)
def test_a_factor_may_be_named_as_in_python(path, tmp_path, same_bits):
    content = read_toml(find_scenario("cruise_control"))
    content["input_faults"] = {"force": [{"kind": "Freeze", "sensor": 0, "start": 0.2}]}
    content["controller"]["precision"] = {"kind": "GammaPrecision", "forgetting": 0.7}
    loop = ScenarioLoop(str(tmp_path / "car.toml"), content)
    line, values = IN_PYTHON[path]
    for value in values:
        one, other = (
            given.simulate(1.2, seed=1, engine="interpreted")
            for given in (loop(**{path: value}), loop(**{line: value}))
        )
        same_bits(one["controller.u"], other["controller.u"])
        if not isinstance(value, dict):  # a table is a thing of files
            in_python = varied(loop(), {path: value}).simulate(1.2, seed=1, engine="interpreted")
            same_bits(one["controller.u"], in_python["controller.u"])


def test_a_controller_is_designed_for_the_plant_of_the_file_whatever_the_plant_is(tmp_path, same_bits):
    """As in Python: what a wrong inertia or noisier sensors do to a controller, not what one for them would do."""
    content = read_toml(find_scenario("position_servo"))
    loop = ScenarioLoop(str(tmp_path / "servo.toml"), content)

    def run(given):
        return given.simulate(2.5, seed=1)["controller.u"]

    for path, value in (("plant.J", 0.03), ("plant.parameters.J", 0.03), ("sensors.std", 0.05), ("sensors.bias", 0.1)):
        same_bits(run(loop(**{path: value})), run(varied(loop(), {path.replace("parameters.", ""): value})))
    changed = loop.changed({"plant.J": 0.03})  # as the page of a replay has it, and its download
    same_bits(run(scenario_of(changed, tmp_path / "servo.toml").loop()), run(loop(**{"plant.J": 0.03})))
    # Its own settings, and what it is connected to, are known to it.
    content["controller"]["acceptable_error"] = 0.02
    same_bits(run(ScenarioLoop(loop.path, content)()), run(loop(**{"controller.acceptable_error": 0.02})))
    assert loop(**{"sensors.count": 3, "plant.J": 0.03})["controller"].block.model.sensors == 3
    both = loop(**{"sensors.count": 3, "sensors.std": [0.01, 0.02, 0.03]})["controller"].block.model
    np.testing.assert_allclose(np.diag(both.matrix("sensor_covariance")), np.square([0.01, 0.02, 0.03]))
    # What the file says of one of both is kept, and the other is that of the file, too.
    said = ScenarioLoop(loop.path, {**content, "known": {"plant": {**content["plant"], "parameters": {"J": 0.02}}}})
    for factor in ({}, {"sensors.std": 0.05}, {"plant.J": 0.03}):
        known = said(**factor)["controller"].block.model
        np.testing.assert_allclose(np.diag(known.matrix("sensor_covariance")), [1e-4, 1e-4])
        np.testing.assert_array_equal(known.matrix("A"), said()["controller"].block.model.matrix("A"))


def test_two_names_of_one_line_are_refused(tmp_path):
    loop = ScenarioLoop(str(tmp_path / "car.toml"), read_toml(find_scenario("cruise_control")))
    with pytest.raises(ScenarioError, match=r"'faults\[0\]\.start', 'freeze_0\.start' refer to the same line"):
        loop(**{"faults[0].start": 1.0, "freeze_0.start": 2.0})


def test_a_fault_that_starts_too_late_is_found_by_either_name(tmp_path):
    file = tmp_path / "late.toml"
    for name in ("faults[0].start", "freeze_0.start"):
        for start, count in ((1.0, 0), (3.0, 1)):
            factors = f'[factors]\n"{name}" = [{start}]\n'
            file.write_text(FILE[: FILE.index("[factors]")] + factors, encoding="utf-8")
            assert len(unused_of_campaign(load_campaign(file), str(file))) == count


def test_a_scenario_is_looked_for_beside_the_campaign(tmp_path, monkeypatch):
    """Not in the working directory, which the message had named."""
    (tmp_path / "room.toml").write_text(find_scenario("cruise_control").read_text())
    (tmp_path / "many.toml").write_text(FILE.replace("cruise_control", "roo.toml"))
    with pytest.raises(ScenarioError, match=rf"There is no scenario file {re.escape(str(tmp_path))}.*'room.toml'"):
        load_campaign(tmp_path / "many.toml")
    (tmp_path / "many.toml").write_text(FILE.replace("cruise_control", "rooms/room"))
    with pytest.raises(ScenarioError, match=re.escape(f"the folder {tmp_path / 'rooms'} does not exist")):
        load_campaign(tmp_path / "many.toml")
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "many.toml").write_text(FILE.replace("cruise_control", "~/room.toml"))
    assert load_campaign(tmp_path / "below" / "many.toml")


def test_a_scenario_is_told_from_a_campaign(bayesftc_, tmp_path):
    car = tmp_path / "car.toml"
    car.write_text(bayesftc_("example", "cruise_control").stdout)
    done = bayesftc_("campaign", car)
    assert done.exit_code == 3
    assert "is a scenario, not a campaign file" in re.sub(r"\s+", " ", done.stderr)


def test_a_stop_says_what_is_kept(bayesftc_, file, monkeypatch):
    usual = CampaignStore.write

    def write(store, outcome):
        if len(store.done()) == 2:
            raise KeyboardInterrupt
        usual(store, outcome)

    monkeypatch.setattr(CampaignStore, "write", write)
    done = bayesftc_("campaign", file, "--jobs", 1, "--quiet", "-o", "my runs")
    assert done.exit_code == 130
    said, _, again = done.stderr.rstrip("\n").partition(" To go on: ")
    assert said.endswith("10 of 12 runs are kept in my runs.")
    assert shlex.split(again) == ["bayesftc", "campaign", str(file), "-o", "my runs"]
    monkeypatch.setattr(CampaignStore, "write", usual)
    done = bayesftc_(*shlex.split(again)[1:])
    assert done.exit_code == 0
    assert "bayesftc report 'my runs' draws them" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as POSIX has them")
def test_ctrl_c_keeps_what_is_done_and_goes_on(file, tmp_path, bayesftc_):
    file.write_text(FILE.replace("seeds = 3", "seeds = 400").replace("duration = 2.0", "duration = 200.0"))
    command = [sys.executable, "-m", "bayesftc", "campaign", str(file), "--jobs", "1"]
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    parts = tmp_path / "tracking" / "runs"
    deadline = time.monotonic() + 60
    while not (parts.is_dir() and any(parts.glob("part-*.parquet"))) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in errors
    kept = len(list(parts.glob("part-*.parquet")))
    assert 0 < kept < 320
    assert errors.endswith(f"{5 * kept} of 1600 runs are kept in tracking. To go on: bayesftc campaign {file}\n")
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
    while len(list(parts.glob("part-*.parquet"))) <= kept and time.monotonic() < deadline + 60:
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert len(list(parts.glob("part-*.parquet"))) > kept
