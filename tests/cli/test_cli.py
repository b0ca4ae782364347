"""The command line in this process: tables, JSON, files, and every way in which a command can end."""

import json
import os
import re
import subprocess
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import control
import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import roc_auc_score

import bayesftc
from bayesftc import controllers, cosim
from bayesftc.bench import SECTIONS
from bayesftc.cli import output
from bayesftc.cli.application import COMMANDS
from bayesftc.cli.commands.loops import _compare as compare_module, run as run_module
from bayesftc.cli.guard import guarded
from bayesftc.cosim import Result
from bayesftc.cosim.judging.figures import loop_figure
from bayesftc.cosim.judging.metrics import figures, limited
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.monitoring import load_monitor
from bayesftc.scenario import Scenario, load_scenario, shipped_scenarios
from bayesftc.scenario.campaigns import load_campaign

# The shipped scenario with the paper's learner, whose lines stand there as comments.
CAR = re.sub(
    r'^kind = "SwitchingPrecision".*\n|^# (?=kind = |forgetting = |calibration = )',
    "",
    shipped_scenarios()["cruise_control"].read_text(),
    flags=re.M,
)
LEARNER = CAR.index("[controller.precision]")


def run_car(bayesftc_, *options):
    return bayesftc_("run", "cruise_control", *options)


def test_version_and_help(bayesftc_):
    assert bayesftc_("--version").output.strip() == f"bayesftc {bayesftc.__version__}"
    text = bayesftc_("--help").output
    page = (Path(__file__).parents[2] / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    for command in COMMANDS:
        assert re.search(rf"\b{command}\b", text)
        assert f"`bayesftc {command}" in page, f"docs/reference/command-line.md lacks a row for bayesftc {command}"
    assert "cruise_control" in text
    assert "bool" not in text + bayesftc_("fit", "--help").output  # a flag has no value


def independent(arrays, stop=1000):
    """Compute the figures of the run with one frozen sensor again, from the recorded signals, by plain NumPy."""
    v, reference = arrays["plant.v"], arrays["reference.y"]
    x_hat, probability = arrays["controller.x_hat"][:, 0], arrays["controller.fault_probability"][:, 0]
    precision = arrays["controller.precision"][:, 0]
    t = np.arange(len(v)) * 0.02
    faulty = (t > 5.99) & (t < 13.99)

    def rms(error):
        return np.sqrt(np.sum(error**2) / len(error))

    def phases(error):
        return {
            "overall": rms(error),
            "before": rms(error[t < 5.99]),
            "during": rms(error[faulty]),
            "after": rms(error[t > 13.99]),
        }

    first = np.flatnonzero(faulty & (probability >= 0.5))
    return {
        "tracking": phases(v - reference),
        "belief": phases(x_hat - v),
        "sensor": {
            "fault_share": faulty.mean(),
            "faults": 1,
            "missed": 0,
            "delay": t[first[0]] - t[np.flatnonzero(faulty)[0]],
            "false_alarm_rate": np.mean(probability[~faulty] >= 0.5),
            "auc": roc_auc_score(faulty, probability),
            "precision_healthy": precision[~faulty].mean(),
            "precision_faulty": precision[faulty].mean(),
        },
    }


@pytest.mark.usefixtures("undrawn")
def test_faults_of_an_actuator_are_reported(bayesftc_, tmp_path):
    fault = '[[input_faults.force]]\nkind = "GainFault"\nfactor = 0.5\nstart = 0.5\nstop = 1.0\n'
    (tmp_path / "car.toml").write_text(CAR + fault)
    done = bayesftc_("run", "car.toml", "--duration", 2, "--out", "out")
    assert done.exit_code == 0, done.output
    assert "Faults between the controller and the plant" in done.output
    assert "force (N)" in done.output
    numbers = json.loads((tmp_path / "out" / "figures.json").read_text())
    (force,) = numbers["inputs"]
    sent = Result.load(tmp_path / "out" / "result.npz")["controller.u"][25:50, 0]
    assert force == {
        "name": "force",
        "unit": "N",
        "fault_share": pytest.approx(25 / 101),
        "faults": 1,
        "deviation": pytest.approx(0.5 * np.sqrt(np.mean(sent**2))),
    }
    assert numbers["sensors"][0]["faults"] == 0
    assert numbers["tracking"]["v"]["during"] is not None


@pytest.mark.usefixtures("undrawn")
def test_what_the_controller_says_of_its_actuators_is_reported(bayesftc_, tmp_path):
    text = CAR[: CAR.index("[controller.precision]")]
    text += '[controller.precision]\nkind = "SwitchingPrecision"\nmodes = [{ kind = "Frozen" }]\n'
    text += 'actuator_modes = [{ kind = "LostEffect" }, { kind = "InputOffset", time_to_fault = 60.0 }]\n'
    text += '[[input_faults.force]]\nkind = "Bias"\nmagnitude = 6000.0\nstart = 1.0\n'
    (tmp_path / "car.toml").write_text(text)
    done = bayesftc_("run", "car.toml", "--duration", 2, "--out", "out")
    assert done.exit_code == 0, done.output
    for words in ("Actuator faults that the controller estimates", "kind during alarms, mostly", "InputOffset"):
        assert words in done.output
    (force,) = json.loads((tmp_path / "out" / "figures.json").read_text())["actuators"]
    result = Result.load(tmp_path / "out" / "result.npz")
    probability, kind, size = (result[f"controller.actuator_fault_{n}"][:, 0] for n in ("probability", "kind", "size"))
    faulty = result["force_bias_0.active"] > 0.5
    alarm = probability >= 0.5
    first = np.flatnonzero(alarm & faulty)[0]
    assert force == {
        "name": "force",
        "unit": "N",
        "mean_probability": pytest.approx(probability.mean()),
        "alarm_share": pytest.approx(alarm.mean()),
        "missed": 0,
        "delay": pytest.approx(result.time[first] - 1.0),
        "false_alarm_rate": alarm[~faulty].mean(),
        "auc": pytest.approx(roc_auc_score(faulty, probability)),
        "kind": "InputOffset",
        "size": pytest.approx(size[alarm & (kind == 2)].mean()),
    }
    assert force["size"] == pytest.approx(6000, rel=0.2)


def test_a_run_prints_and_writes_what_numpy_finds_as_well(bayesftc_, tmp_path):
    done = run_car(bayesftc_, "--out", "deep/er", "--seed", 2)
    assert done.exit_code == 0, done.output
    folder = tmp_path / "deep" / "er"
    assert sorted(p.name for p in folder.iterdir()) == ["figure.png", "figures.json", "result.npz"]
    numbers = json.loads((folder / "figures.json").read_text())
    result = Result.load(folder / "result.npz")
    assert (numbers["seed"], numbers["steps"], numbers["duration"], numbers["stopped"]) == (2, 1000, 20.0, None)
    expected = independent(result)
    for key in ("tracking", "belief"):
        assert numbers[key]["v"] == pytest.approx(expected[key], rel=1e-9)
    first, second = numbers["sensors"]
    assert {k: first[k] for k in expected["sensor"]} == pytest.approx(expected["sensor"], rel=1e-9)
    assert first["ranked_by"] == "fault_probability"
    assert second["faults"] == 0
    assert second["auc"] is second["delay"] is second["missed"] is second["precision_faulty"] is None
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    # The table shows the same numbers.
    for value in expected["tracking"].values():
        assert f"{value:.4g}" in done.output
    assert f"{expected['sensor']['auc']:.3f}" in done.output
    assert f"{expected['sensor']['delay']:.2f}" in done.output
    assert "–" in done.output
    assert "m/s" in done.output


def test_json_is_all_that_is_printed(bayesftc_):
    done = run_car(bayesftc_, "--json", "--duration", "1")
    numbers = json.loads(done.output)
    assert numbers["scenario"] == "cruise_control"
    assert numbers["sensors"][0]["missed"] is None
    assert numbers["tracking"]["v"]["during"] is None


@pytest.mark.slow
def test_quiet_prints_nothing_and_twice_gives_the_same_files(bayesftc_, tmp_path):
    contents = []
    for _ in range(2):
        done = run_car(bayesftc_, "-q", "--duration", "1", "--out", "out")
        assert (done.exit_code, done.output) == (0, "")
        contents.append({p.name: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.suffix != ".npz"})
        contents[-1]["result"] = Result.load(tmp_path / "out" / "result.npz").to_pandas().to_csv()
    assert contents[0] == contents[1]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_files_that_are_replaced_are_noted(bayesftc_, tmp_path):
    assert "exist" not in run_car(bayesftc_, "--duration", "1", "--out", "out").stderr
    (tmp_path / "out" / "figure.png").unlink()
    again = run_car(bayesftc_, "--duration", "1", "--out", "out")
    assert "Note: out/result.npz, out/figures.json exist already, and will be replaced." in again.stderr
    assert (tmp_path / "out" / "figure.png").exists()
    assert run_car(bayesftc_, "--duration", "1", "--out", "out", "--quiet").stderr == ""
    (tmp_path / "broken.toml").write_text('[plant]\nfmu = "CruiseControl"\n')
    refused = bayesftc_("run", "broken.toml", "--out", "out")
    assert refused.exit_code > 1
    assert "exist" not in refused.stderr


def test_check_kalman(bayesftc_):
    done = run_car(bayesftc_, "--check-kalman", "--json", "--duration", "2")
    check = json.loads(done.output)["kalman"]
    assert check["steps"] == 101
    assert check["mean_difference"] < 1e-12
    assert check["covariance_difference"] < 1e-12
    assert check["agrees"] is True
    table = run_car(bayesftc_, "--check-kalman", "--duration", "2").output
    said = " ".join(table.split())
    assert "infers state and faults together" in said
    assert (
        "comparison uses its per-sensor form, with the same samples and controls. The belief agrees with filterpy"
        in said
    )
    assert "Kalman filter over 101 samples" in table
    assert f"{check['mean_absolute']:.2e}" in table


def test_check_kalman_compares_the_samples_of_the_controller(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("[simulation]", "[simulation]\ndt = 0.005"))
    check = json.loads(bayesftc_("run", "car.toml", "--check-kalman", "--json", "--duration", "2").output)["kalman"]
    assert (check["steps"], check["agrees"]) == (101, True)


@pytest.mark.usefixtures("undrawn")
def test_a_belief_that_is_not_finite(bayesftc_, tmp_path, monkeypatch):
    """It is told, with numbers that JSON can say, and all files are there."""
    simulate = Scenario.simulate

    def diverging(*arguments, **options):
        result = simulate(*arguments, **options)
        result["controller.x_hat"][300:] = np.nan
        result["controller.P"][300:] = np.inf
        return result

    monkeypatch.setattr(Scenario, "simulate", diverging)
    (tmp_path / "car.toml").write_text(CAR)
    done = bayesftc_("run", "car.toml", "--check-kalman", "--out", "out")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figure.png", "figures.json", "result.npz"]
    numbers = json.loads((tmp_path / "out" / "figures.json").read_text())
    check = numbers["kalman"]
    assert check["agrees"] is check["mean_difference"] is check["covariance_absolute"] is None
    assert "The mean of the belief is not finite from t = 6 s on." in check["verdict"]
    assert "The covariance of the belief is not finite from t = 6 s on." in check["verdict"]
    assert numbers["belief"]["v"]["overall"] is numbers["belief"]["v"]["during"] is None
    assert numbers["belief"]["v"]["before"] > 0
    note = "The belief of v is not finite from t = 6 s on, so it has no error of the belief then."
    assert note in numbers["notes"]
    output = " ".join(done.output.split())
    assert check["verdict"] in output
    assert note in output
    assert " nan " not in output


def test_a_model_whose_belief_grows_without_bound(bayesftc_, tmp_path):
    """No sensor sees the second state; filterpy's estimate of it overflows."""
    text = CAR
    for old, new in {
        "A = [[0.999]]": "A = [[0.999, 0.0], [0.0, 9.0]]",
        "B = [[2e-4]]": "B = [[2e-4], [0.0]]",
        "C = [[1.0], [1.0]]": "C = [[1.0, 0.0], [1.0, 0.0]]",
        "initial_mean = 20.0": "initial_mean = [20.0, 1.0]\ngoal_on = [[1.0, 0.0]]",
    }.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "car.toml").write_text(text)
    done = bayesftc_("run", "car.toml", "--check-kalman", "--json")
    assert done.exit_code == 0, done.output
    check = json.loads(done.stdout)["kalman"]
    assert check["agrees"] is None
    assert "has no result" in check["verdict"]
    assert "filterpy's belief has overflowed" in check["verdict"]


@pytest.mark.parametrize(
    ("changes", "said", "unsaid"),
    [
        (
            {"\nstd = 1.0": "\nstd = 3.0"},
            "but the model expects 1 m/s: the square root of its sensor_covariance.",
            "look at",
        ),
        (
            {"\nstd = 1.0": "\nstd = 1.0\nbias = [0.0, 4.0]"},
            "Its healthy samples differ from the true values by 4.01 m/s on average: an offset that the controller's model lacks",
            "Look at",
        ),
        (
            {"process_covariance = 0.001": "process_covariance = 1e-5"},
            "Look at the model first",
            "but the model expects",
        ),
        ({}, "", "is blamed for"),
        (
            {"initial_mean = 20.0": "initial_mean = 20.0\nu_max = 100.0"},
            "force is at its limit of 100 N for",
            "limit of -",
        ),
        ({"initial_mean = 20.0": "initial_mean = 20.0\nu_min = -1e9\nu_max = 1e9"}, "", "at its limit"),
    ],
)
def test_what_explains_a_bad_run_is_a_note(bayesftc_, tmp_path, changes, said, unsaid):
    text = shipped_scenarios()["cruise_control"].read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    (tmp_path / "car.toml").write_text(text)
    notes = " ".join(json.loads(bayesftc_("run", "car.toml", "--json").stdout)["notes"])
    assert said in notes
    assert unsaid not in notes


@pytest.mark.parametrize("fault", ["", '[[input_faults.force]]\nkind = "Bias"\nmagnitude = 1000.0\nstart = 3.0\n'])
def test_an_input_fault_of_the_run_may_be_what_speaks_against_the_model(bayesftc_, tmp_path, fault):
    (tmp_path / "car.toml").write_text(f"{CAR}\n{fault}")
    numbers = json.loads(bayesftc_("run", "car.toml", "--duration", 20, "--json").stdout)
    words = "This run has faults of force (above), and they may be all that speaks against the model"
    assert [bool(numbers["model"]), words in " ".join(numbers["notes"])] == 2 * [bool(fault)]


def test_a_run_whose_diagnosis_fails_is_not_lost(bayesftc_, tmp_path, monkeypatch):
    def failing(*_):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(controllers, "diagnose", failing)
    (tmp_path / "car.toml").write_text(CAR)
    done = bayesftc_("run", "car.toml", "--duration", 2, "--out", "out")
    assert done.exit_code == 70
    assert "Faults and their detection" in done.stdout
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figure.png", "figures.json", "result.npz"]
    assert json.loads(bayesftc_("run", "car.toml", "--duration", 2, "--json").stdout)["sensors"]


def test_a_joint_belief_is_told_apart_from_filterpys(bayesftc_, tmp_path):
    joint = 'initial_mean = 20.0\nbelief = "joint"\ncontrol_covariance = 1e4\ngoal_covariance = 1e-3'
    (tmp_path / "car.toml").write_text(CAR.replace("initial_mean = 20.0", joint))
    done = bayesftc_("run", "car.toml", "--check-kalman", "--json")
    check = json.loads(done.output)["kalman"]
    assert check["agrees"] is False
    assert "does not agree" in check["verdict"]
    assert "depends on the goal" in check["verdict"]


@pytest.mark.slow
def test_state_and_faults_inferred_together_are_told_apart_from_filterpys(bayesftc_, tmp_path):
    """The form that infers them apart is compared in its place, where there is one."""
    text = CAR[:LEARNER] + '[controller.precision]\nkind = "SwitchingPrecision"\n'
    for settings, agrees, words in (
        ("", True, ["infers state and faults together", "its per-sensor form", "agrees"]),
        ("joint = false", True, ["The belief agrees"]),
        ('actuator_modes = [{ kind = "LostEffect" }]', False, ["does not agree", "infers state and faults together"]),
    ):
        (tmp_path / "car.toml").write_text(f"{text}{settings}\n")
        done = bayesftc_("run", "car.toml", "--duration", "8", "--check-kalman", "--json")
        check = json.loads(done.output)["kalman"]
        assert check["agrees"] is agrees
        for word in words:
            assert word in check["verdict"]
        assert ("its per-sensor form" in check["verdict"]) is (settings == "")


def test_check_kalman_says_before_the_run_what_it_cannot_do(bayesftc_, tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "loop_signals", lambda *_: pytest.fail("the run was made"))
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", "seed = 1\ndecimation = 5"))
    done = bayesftc_("run", "car.toml", "--check-kalman")
    assert done.exit_code == 9
    assert "compares every step, but car.toml has decimation = 5" in " ".join(done.output.split())


def test_a_dropout_is_neither_missed_nor_detected(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace('"Freeze"', '"Dropout"'))
    done = bayesftc_("run", "car.toml")
    rows = {line[:42].strip(): line[42:].split() for line in done.output.splitlines()}
    assert rows["samples missing (share of those due)"] == ["40.0%", "0.0%"]
    assert rows["faults seen as missing samples"] == ["1", "0"]
    assert rows["faults missed"] == rows["AUC"] == ["–", "–"]
    assert "A missing sample needs no detector" in done.output
    assert "samples missing" not in run_car(bayesftc_, "--duration", "1").output


def test_the_pauses_of_a_slow_sensor_are_no_missing_samples(bayesftc_, tmp_path):
    car = tmp_path / "slow.toml"
    car.write_text(shipped_scenarios()["cruise_control"].read_text().replace("count = 2", "count = 2\nevery = [1, 5]"))
    done = bayesftc_("run", car, "--duration", "2", "--out", tmp_path / "out")
    assert "sensor 1" in done.output
    assert "missing" not in done.output


def test_what_tracking_compares_is_said(bayesftc_):
    assert "steers the state to it one step later" in " ".join(run_car(bayesftc_, "--duration", "1").output.split())


LATE = """
[simulation]
duration = 2.0
[plant]
fmu = "PositionServo"
control = "voltage"
measured = "angle"
[sensors]
count = 2
std = 0.01
[[input_faults.voltage]]
kind = "Delay"
delay = 0.1
initial = 0.0
[reference]
kind = "Sine"
amplitude = 0.5
period = 4.0
[controller]
kind = "design"
input_delays = DELAYS
preview = PREVIEW
"""


@pytest.mark.parametrize(
    ("delays", "preview", "sentence", "warning"),
    [
        (10, 30, "at the same instant. Faults", None),
        (14, 0, "The regulator lags behind a moving reference", "0.04 s earlier in the plant than in the model"),
    ],
)
def test_dead_times_of_the_loop_count_in_the_check_before_a_run(
    bayesftc_, tmp_path, recwarn, delays, preview, sentence, warning
):
    file = tmp_path / "late.toml"
    file.write_text(LATE.replace("DELAYS", str(delays)).replace("PREVIEW", str(preview)))
    output = " ".join(bayesftc_("run", str(file)).output.split())
    assert sentence in output
    warned = [str(w.message) for w in recwarn if "in the plant" in str(w.message)] + [
        line for line in [output] if "in the plant than in the model" in line
    ]
    assert bool(warned) == (warning is not None)
    assert warning is None or any(warning in text for text in warned)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("record", ['["plant.v"]', '"reference.*"'])
def test_check_kalman_records_what_it_needs(bayesftc_, tmp_path, record):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", f"record = {record}"))
    done = bayesftc_("run", "car.toml", "--check-kalman", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["kalman"]["agrees"] is True


@pytest.mark.slow
def test_the_ser_baseline_is_compared_with_filterpys_of_itself(bayesftc_, tmp_path):
    """filterpy decides for itself which samples to ignore; without all signals the run says what is missing."""
    text = CAR[:LEARNER] + '[controller.precision]\nkind = "SERFDI"\n'
    for more in ("", 'filter = "filterpy"\n'):
        (tmp_path / "car.toml").write_text(text + more)
        done = bayesftc_("run", "car.toml", "--duration", "8", "--json")
        check = json.loads(done.output)["kalman"]
        assert check["agrees"] is True
        assert (check["mean_difference"] == 0.0) is bool(more)
        assert check["steps"] == 401
    (tmp_path / "car.toml").write_text(text.replace("seed = 1", 'record = ["plant.v"]'))
    done = bayesftc_("run", "car.toml", "--duration", "1")
    assert "filterpy's, which needs every signal" in " ".join(done.output.split())


@pytest.mark.slow
def test_no_probability_is_explained(bayesftc_, tmp_path):
    """Each learner that gives no probability has dashes and its own sentence, and the AUC of beta where there is one."""
    for kind, auc in (("FixedPrecision", None), ("GammaPrecision", "beta")):
        (tmp_path / "car.toml").write_text(f'{CAR[:LEARNER]}[controller.precision]\nkind = "{kind}"\n')
        done = bayesftc_("run", "car.toml")
        why = load_scenario("car.toml").controller.precision.why_no_probability
        assert why in " ".join(done.output.split())
        assert ("AUC of beta" in done.output) == (auc is not None)
        numbers = json.loads(bayesftc_("run", "car.toml", "--json").output)
        sensor = numbers["sensors"][0]
        assert sensor["ranked_by"] == auc
        assert sensor["missed"] is sensor["delay"] is sensor["false_alarm_rate"] is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("", "", "The model The 101 samples have not enough evidence against the controller's model to name an error."),
        ("B = [[", "B = [[-", "The model All sensors disagree with the model in the same way"),
        ("seed = 1", 'seed = 1\nrecord = ["plant.v"]', None),
    ],
)
def test_a_run_says_whether_its_samples_show_an_error_of_the_model(bayesftc_, tmp_path, old, new, sentence):
    (tmp_path / "car.toml").write_text(CAR.replace(old, new) if old else CAR)
    shown = " ".join(bayesftc_("run", "car.toml", "--duration", 2).stdout.split())
    assert ("The model" in shown) == (sentence is not None)
    assert (sentence or "") in shown


def test_what_was_not_recorded_is_a_dash_and_not_a_zero(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", 'record = ["plant.v", "reference.y"]'))
    done = bayesftc_("run", "car.toml", "--json", "--out", "out")
    numbers = json.loads(done.output)
    assert numbers["tracking"]["v"]["overall"] > 0
    assert numbers["tracking"]["v"]["during"] is None
    assert numbers["sensors"][0]["fault_share"] is None
    assert len(numbers["notes"]) == 1
    assert (tmp_path / "out" / "figure.png").is_file()


def test_a_run_that_recorded_no_figures_prints_what_to_record_and_no_empty_table(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", 'record = ["plant.v"]'))
    shown = " ".join(bayesftc_("run", "car.toml", "--duration", "8").stdout.split())
    sentence = (
        "Figures are missing, because these signals were not recorded: controller.beta, controller.fault_probability, "
        "controller.precision, controller.u, controller.x_hat, freeze_0.active, freeze_0.y, reference.y. "
        "Add them to 'record' of the scenario, or remove 'record'."
    )
    assert shown.count("not recorded") == shown.count(sentence) == 1
    assert "–" not in shown


def test_a_goal_that_was_not_recorded_is_not_taken_for_none(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", 'record = ["plant.v", "controller.x_hat"]'))
    numbers = json.loads(bayesftc_("run", "car.toml", "--json").output)
    assert "reference.y" in numbers["notes"][0].partition("these signals were not recorded: ")[2]
    assert not any("the goal has no element" in note for note in numbers["notes"])


def test_decimation_does_not_shorten_the_run(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", "decimation = 7"))
    numbers = json.loads(bayesftc_("run", "car.toml", "--json").output)
    assert (numbers["duration"], numbers["steps"]) == (20.0, 1000)


def test_a_run_that_stops_at_its_first_step_says_nothing_of_limits():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 1e-4, 0.01, dt=0.1)
    plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[10.0]], 0, 0.1), initial=[1e308])  # its output is infinite
    loop = cosim.closed_loop(
        plant, controllers.BayesianController(model, u_max=9.0), control="u", measured="y", reference=0.0
    )
    with pytest.raises(cosim.SimulationError) as stopped:
        loop.simulate(1.0, engine="interpreted")
    assert not len(stopped.value.result.time)
    assert not list(limited(loop_signals(loop, stopped.value.result)))
    assert stopped.value.result.notes == ["stopped early"]


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_stops_keeps_what_it_has(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("v0 = 20.0", "m = 1e-320, v0 = 20.0"))
    done = bayesftc_("run", "car.toml", "--out", "out")
    assert done.exit_code == 11
    assert done.output.startswith("Error: The run stopped at t = 0.02 s")
    assert "Last values, at t = 0 s: v 20 m/s " in done.output
    assert done.output.endswith(f"The signals up to then are in {Path('out/result.npz')}.\n")
    assert "are kept" not in done.output
    nowhere = bayesftc_("run", "car.toml").output
    assert nowhere.endswith("To keep the signals up to then, add --out FOLDER.\n")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figure.png", "figures.json", "result.npz"]
    assert Result.load(tmp_path / "out" / "result.npz").stopped
    assert json.loads((tmp_path / "out" / "figures.json").read_text())["stopped"]


def test_a_figure_that_cannot_be_drawn_does_not_take_the_signals_with_it(bayesftc_, tmp_path, monkeypatch):
    def fail(*_):
        raise ValueError("no limits")

    monkeypatch.setattr(loop_figure, "plot_run", fail)
    done = run_car(bayesftc_, "--out", "out", "--duration", "1")
    assert done.exit_code == 70
    assert (
        "figure.png could not be drawn (ValueError: no limits); result.npz and figures.json are written." in done.output
    )
    assert "Written to out: result.npz, figures.json" in done.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figures.json", "result.npz"]
    (tmp_path / "car.toml").write_text(CAR.replace("v0 = 20.0", "m = 1e-320, v0 = 20.0"))
    assert bayesftc_("run", "car.toml", "--out", "stopped").exit_code == 11  # the figure is not what to say last
    assert (tmp_path / "stopped" / "result.npz").is_file()


def test_a_folder_that_cannot_be_written_is_known_before_the_run(bayesftc_, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(run_module, "loop_signals", lambda *_: pytest.fail("the run was made"))
    (tmp_path / "taken" / "figure.png").mkdir(parents=True)
    for out, words in {
        "file": "file is a file, not a folder",
        "file/deeper": "file is a file, not a folder",
        "taken": "figure.png cannot be written: it is a folder",
        "x" * 300: "File name too long",
    }.items():
        done = run_car(bayesftc_, "--out", out)
        assert done.exit_code == 12, done.output
        assert words in done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "taken"]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.sampled(1)
@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("raised", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("file", ["result.npz", "figures.json", "figure.png"])
def test_files_appear_all_or_none(bayesftc_, tmp_path, monkeypatch, file, raised, there):
    """A disk that is full at one file, or Ctrl-C, leaves what was there before: no file, and no folder made for it."""
    out = tmp_path / "deep" / "out"
    if there:
        assert run_car(bayesftc_, "-q", "--out", out, "--duration", "1").exit_code == 0
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    def fail(path, *_, **__):
        with open(path, "wb") as half:
            half.write(b"half")
        raise raised

    if file == "result.npz":
        monkeypatch.setattr(np, "savez_compressed", lambda handle, **_: fail(handle.name))
    else:
        name = "write_text" if file == "figures.json" else "write_bytes"
        monkeypatch.setattr(f"pathlib.Path.{name}", fail)
    done = run_car(bayesftc_, "--out", out, "--duration", "2")
    monkeypatch.undo()
    assert done.exit_code == (130 if isinstance(raised, KeyboardInterrupt) else 12)
    assert ".bayesftc-" not in done.output
    if done.exit_code == 12:
        assert "No space left on device" in done.output
        assert str(out) in done.output.replace("\n", "")
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert (tmp_path / "deep").exists() == there
    assert not list(tmp_path.rglob(".bayesftc-*"))


def test_wrong_options(bayesftc_):
    assert bayesftc_("run").exit_code == 2
    assert bayesftc_("run", "cruise_control", "--engine", "fast").exit_code == 2
    assert bayesftc_("run", "cruise_control", "--seed", "-1").exit_code == 9
    assert bayesftc_("run", "cruise_control", "--duration", "nan").exit_code == 8


def test_debug_shows_the_traceback(bayesftc_):
    assert "Traceback" not in bayesftc_("run", "nope").output
    assert "Traceback" in bayesftc_("run", "nope", "--debug").output


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (RuntimeError("odd"), 70, ["Traceback", "RuntimeError: odd", "a bug in bayesftc"]),
        (KeyboardInterrupt(), 130, ["Stopped by Ctrl-C"]),
        (MemoryError(), 71, ["not enough memory", "decimation"]),
    ],
)
def test_other_ends(bayesftc_, monkeypatch, raised, code, words):
    def fail(*_, **__):
        raise raised

    monkeypatch.setattr(run_module, "load_scenario", fail)
    done = bayesftc_("run", "cruise_control")
    assert done.exit_code == code
    for word in words:
        assert word in done.output


def test_warnings_are_sentences(bayesftc_, tmp_path):
    text = CAR
    for old, new in {
        "initial_mean = 20.0": 'initial_mean = 20.0\ncontrol_covariance = 1e9\ngoal_covariance = 1e-6\ngoal_on = "outputs"',
        "A = [[0.999]]": "A = [[0.999, 1.0], [0.0, 3.0]]",
        "B = [[2e-4]]": "B = [[2e-4], [0.0]]",
        "C = [[1.0], [1.0]]": "C = [[1.0, 0.0], [1.0, 0.0]]",
    }.items():
        text = text.replace(old, new)
    (tmp_path / "car.toml").write_text(text)
    done = bayesftc_("run", "car.toml", "--engine", "interpreted", "--duration", "0.1")
    assert re.search("Warning: The .*closed loop.* unstable", done.output)
    assert "UnstableLoopWarning" not in done.output


def test_inspect(bayesftc_, tmp_path):
    text = bayesftc_("inspect", "CruiseControl").output
    for word in ("co-simulation", "force", "disturbance", "N.s/m", "100.0", "linux64", "Drag coefficient", "FMI"):
        assert word in text
    plain = json.loads(bayesftc_("inspect", "CruiseControl", "--json").output)
    assert plain["fmi_version"] == "2.0"
    assert {v["name"]: v["start"] for v in plain["variables"]}["m"] == 100.0
    assert bayesftc_("inspect", plain["path"]).exit_code == 0
    (tmp_path / "broken.fmu").write_bytes(b"no zip")
    for name, words in {
        "broken.fmu": "is no FMU",
        "none.fmu": "check the path",
        "CruseControl": "did you mean 'CruiseControl'",
    }.items():
        done = bayesftc_("inspect", name)
        assert done.exit_code == 4
        assert words in done.output


def test_bench_passes_its_options_on(bayesftc_, monkeypatch):
    seen = []
    monkeypatch.setattr("bayesftc.bench.main", lambda **options: seen.append(options))
    for options in ([], ["--quick"], ["--quick", "--json"], ["export", "memory"]):
        assert bayesftc_("bench", *options).exit_code == 0
    wanted = [(False, False), (False, True), (True, True)]
    every = [{"json": j, "quick": q, "sections": SECTIONS} for j, q in wanted]
    assert seen == [*every, {"json": False, "quick": False, "sections": ["export", "memory"]}]


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("line", "found"), [("bayesftc ru", {"run"}), ("bayesftc run --ou", {"--out"})])
def test_a_shell_completes_commands_and_options(line, found):
    words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1), "_BAYESFTC_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-m", "bayesftc"], env={**os.environ, **words}, capture_output=True, text=True, timeout=60
    )
    assert set(done.stdout.split()) == found


def test_example(bayesftc_, tmp_path):
    listed = {line.split()[0]: line for line in bayesftc_("example").output.splitlines() if line}
    assert {"tracking", "model", "wheel_speed", *shipped_scenarios()} <= set(listed)
    assert "bayesftc campaign tracking.toml" in listed["tracking"]
    assert "bayesftc monitor faulty_wheel_speed.csv --fit" in listed["faulty_wheel_speed"]
    assert bayesftc_("example", "faulty_wheel_speed").stdout != bayesftc_("example", "wheel_speed").stdout
    for name in ("tracking", "model", "gnss_speed", "imu", "wheel_speed"):
        file = tmp_path / listed[name].split()[-1] if name in {"tracking", "model"} else tmp_path / f"{name}.csv"
        file.write_text(bayesftc_("example", name).stdout, encoding="utf-8")
    assert load_campaign(tmp_path / "tracking.toml").runs == 24 * 25
    assert len(load_monitor(tmp_path / "model.toml").read([tmp_path]).y) > 1000
    (tmp_path / "car.toml").write_text(bayesftc_("example", "cruise_control").output)
    assert bayesftc_("run", "car.toml", "-q", "--duration", "0.1", "--engine", "interpreted").exit_code == 0
    assert bayesftc_("example", "cruise").exit_code == 3


@pytest.fixture
def used_together(bayesftc_, tmp_path, monkeypatch):
    """A folder made by the commands that the list of examples prints for files that are used together."""
    monkeypatch.chdir(tmp_path)
    *_, last = bayesftc_("example").output.split("\n\n")
    assert last.startswith("gnss_speed.csv, imu.csv, model.toml, wheel_speed.csv are used together, all in one folder:")
    for line in last.strip().splitlines()[1:]:
        _, command, name, _, file = line.split()
        printed = bayesftc_(command, name)
        (tmp_path / file).write_text(printed.stdout, encoding="utf-8")
        others = {
            other for other in ("gnss_speed", "imu", "model", "wheel_speed") if f"example {other} >" in printed.stderr
        }
        assert others == {"gnss_speed", "imu", "model", "wheel_speed"} - {name}
    return tmp_path


def test_files_that_are_used_together_are_named(bayesftc_, used_together):
    assert len(list(used_together.iterdir())) == 4
    assert bayesftc_("example", "cruise_control").stderr == ""


@pytest.mark.slow
def test_the_monitors_model_works_beside_the_files_that_it_is_used_with(bayesftc_, used_together):
    assert bayesftc_("monitor", ".", "--model", "model.toml").exit_code == 0


@pytest.mark.slow
def test_figures_of_the_compiled_engine_are_the_same():
    """The command line's default engine; one compilation, kept in the cache."""
    scenario = load_scenario("cruise_control")
    loop = scenario.loop()
    runs = [
        figures(loop_signals(loop, scenario.simulate(loop, duration=8.0, engine=e))).to_dict()
        for e in ("compiled", "interpreted")
    ]
    assert runs[0] == runs[1]


@pytest.mark.slow
def test_a_run_keeps_pace_with_the_clock_and_says_where_it_was_late(bayesftc_):
    begin = time.monotonic()
    done = run_car(bayesftc_, "--duration", "12", "--pace", "10", "--json")  # more steps than powers of two in a float
    numbers = json.loads(done.output)
    assert time.monotonic() - begin > 1.2
    assert numbers["pace"]["pace"] == 10.0
    assert "pace of 10 simulated seconds per second" in numbers["notes"][-1]
    same = json.loads(run_car(bayesftc_, "--duration", "12", "--json").output)
    assert "pace" not in same
    assert numbers["tracking"] == same["tracking"]
    short = run_car(bayesftc_, "--duration", "1", "--pace", "1e6")
    assert re.search(r"no\s+step\s+was\s+late\s+by\s+more\s+than\s+1\s+ms|run\s+was\s+late", short.output)
    late = run_car(bayesftc_, "--duration", "2000", "--pace", "1e6")  # nobody is as fast
    assert re.search(r"the run was\s+late (once|\d+\s+times),\s+by\s+at\s+most\s+[\d.e+]+\s+ms", late.output)


def _no_loading(*_, **__):
    pytest.fail("the scenario was read before the options were checked")


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (("--pace", 0), 9, "pace is 0.0; it must be a positive number of simulated seconds for each second, 1.0 for real time."),
        (("--duration", -3), 8, "The duration is -3.0 s; it must not be negative."),
        (("--duration", "nan"), 8, "The duration nan is no finite number; give seconds, as 0.02 or '1/50'."),
        (("--seed", -1), 9, "The seed is -1; it must be a whole number from 0 to 2**64 - 1."),
        (("--out", "file/run"), 12, "Nothing can be written into file/run: file is a file, not a folder. Choose another name."),
    ],
)  # fmt: skip
@pytest.mark.parametrize("compare", [False, True])
def test_options_are_checked_before_the_scenario_is_read(
    bayesftc_, tmp_path, monkeypatch, options, code, sentence, compare
):
    (tmp_path / "file").touch()
    monkeypatch.setattr(run_module, "load_scenario", _no_loading)
    monkeypatch.setattr(compare_module, "load_scenario", _no_loading)
    if compare and options[0] == "--pace":
        pytest.skip("--compare has no --pace")
    files = ("a.toml", "b.toml", "--compare") if compare else ("a.toml",)
    done = bayesftc_("run", *files, *options)
    assert (done.exit_code, done.output.replace(f"{tmp_path}{os.sep}", "")) == (code, f"Error: {sentence}\n")


def two_scenarios(folder, change=lambda text: text):
    """Write the car with the paper's learner and with fixed precisions; return both files."""
    ours, fixed = folder / "gamma.toml", folder / "fixed.toml"
    ours.write_text(CAR.replace("duration = 20.0", "duration = 2.0"))
    fixed.write_text(
        change(
            CAR[:LEARNER].replace("duration = 20.0", "duration = 2.0")
            + '[controller.precision]\nkind = "FixedPrecision"\n'
        )
    )
    return fixed, ours


def test_scenarios_are_compared_with_the_same_seeds(bayesftc_, tmp_path):
    fixed, ours = two_scenarios(tmp_path)
    done = bayesftc_(
        "run", fixed, ours, "--compare", "--seeds", 3, "--duration", 8.0, "--out", tmp_path / "out", "--json"
    )
    assert done.exit_code == 0, done.output
    first, second = json.loads(done.stdout)["loops"]
    assert (first["loop"], second["loop"], second["runs"], second["pairs"]) == ("fixed", "gamma", 3, 3)
    assert first["difference"] is None
    assert second["difference"] == pytest.approx(second["error"] - first["error"])
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"comparison.csv", "runs.csv", "figure.png"}
    runs = pd.read_csv(tmp_path / "out" / "runs.csv")
    assert not runs.duplicated(["loop", "seed"]).any()
    errors = runs.groupby("loop")["tracking.v.overall"].mean()
    assert [errors["fixed"], errors["gamma"]] == pytest.approx([first["error"], second["error"]])
    shown = bayesftc_("run", fixed, ours, "--compare", "--seeds", 2).output
    assert "Tracking error of v (m/s), whole run" in shown
    assert "relative to fixed" in shown
    assert "blamed*" in shown
    assert "* Blamed while healthy: the share of the fault-free steps with an alarm, mean of all" in " ".join(
        shown.split()
    )


def test_a_row_of_the_runs_is_what_the_command_with_its_seed_makes(bayesftc_, tmp_path):
    fixed, ours = two_scenarios(tmp_path)
    bayesftc_("run", fixed, ours, "--compare", "--seeds", 2, "--duration", 8.0, "--out", tmp_path / "out")
    row = pd.read_csv(tmp_path / "out" / "runs.csv").query("loop == 'gamma'").iloc[-1]
    done = bayesftc_("run", ours, "--seed", row["seed"], "--duration", 8.0, "--json")
    assert json.loads(done.stdout)["tracking"]["v"]["overall"] == pytest.approx(row["tracking.v.overall"])


def test_the_worst_run_of_a_loop_is_named_if_it_is_far_worse_than_the_median():
    """The mean over the runs hides one that has lost its plant."""
    runs = pd.DataFrame({"loop": ["a"] * 3 + ["b"] * 3, "seed": [7, 8, 9] * 2})
    runs["tracking.v.overall"] = [1.0, 1.1, 2.9, 1.0, 8.0, 1.2]
    runs["tracking.w.overall"] = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    table = pd.DataFrame({"signal": ["v", "w"] * 2, "unit": ["m/s", ""] * 2})
    (sentence,) = compare_module._far_worse(
        SimpleNamespace(runs=runs, table=table), {"a": "a.toml", "b": "in/b.toml"}, 5.0
    )
    assert "worst run of b, with the seed 8, has an error of v of 8 m/s; the median of its runs is 1.2 m/s" in sentence
    assert sentence.endswith("bayesftc run in/b.toml --seed 8 --duration 5.0.")


def test_wrong_comparisons_are_refused(bayesftc_, tmp_path):
    fixed, ours = two_scenarios(tmp_path, lambda text: text.replace("duration = 2.0", "duration = 3.0"))
    for arguments, sentence in (
        ((fixed, "--compare"), "--compare has only one scenario"),
        ((fixed, ours), "bayesftc run has 2 scenarios"),
        ((fixed, "--seeds", 3), "bayesftc run has --seeds"),
        ((fixed, ours, "--compare", "--engine", "compiled"), "Leave them out"),
        ((fixed, ours, "--compare", "--seeds", 2), "'fixed' lasts 3.0 s and 'gamma' lasts 2.0 s"),
        ((fixed, fixed, "--compare"), "have the same name"),
    ):
        done = bayesftc_("run", *arguments)
        assert done.exit_code != 0
        assert sentence in " ".join(done.output.split())


def test_a_warning_is_printed_once(capsys):
    with guarded():
        for angle in (1, 2, 2, 1):
            warnings.warn(f"The plant reached {angle} rad.", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == "Warning: The plant reached 1 rad.\nWarning: The plant reached 2 rad.\n"


@pytest.mark.parametrize("width", [60, 80, 200])
def test_tables_of_a_run_break_no_word(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    columns = tuple(f"sensor {i} (temperature)" for i in range(5))
    rows = [("share of time in fault", *["13.0%"] * 5), ("mean detection delay (s)", *["130.00"] * 5)]
    console = output.terminal()
    for table in output._fitting(console, columns, rows, turned=True):
        console.print(table)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= width
    assert printed.count("(temperature)") in {5, 10}
    assert {"detection", "130.00", "13.0%"} <= set(printed.split())
