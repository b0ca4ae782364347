"""``bayesftc calibrate``, and that the shipped example's map is what the command in its comment prints."""

import json
import re

import pytest
from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.scenario import load_scenario

RUNNER = CliRunner()
SHIPPED = load_scenario("cruise_control").path.read_text(encoding="utf-8")


@pytest.fixture
def with_learner(tmp_path):
    """Write the shipped scenario with another learner, a line of TOML or more, and return its file."""

    def write(lines):
        file = tmp_path / "car.toml"
        file.write_text(re.sub(r"^kind = \"SwitchingPrecision\".*$", lines, SHIPPED, flags=re.M), encoding="utf-8")
        return str(file)

    return write


def test_the_shipped_map_is_what_the_command_in_its_comment_prints(with_learner):
    command = re.search(r"^#\s+bayesftc calibrate car.toml (.*)$", SHIPPED, re.M)
    lines = re.findall(r"^# ((?:kind|forgetting) = .*)$", SHIPPED, re.M)
    assert command
    assert lines == ['kind = "GammaPrecision"', "forgetting = 0.95"]
    done = RUNNER.invoke(app, ["calibrate", with_learner("\n".join(lines)), *command.group(1).split()])
    assert done.exit_code == 0, done.output
    assert f"# {done.output.strip().splitlines()[-1]}" in SHIPPED.splitlines()


def test_json_and_options(with_learner):
    file = with_learner('kind = "GammaPrecision"')
    done = RUNNER.invoke(app, ["calibrate", file, "--steps", "6000", "--injection", "8", "--seed", "3", "--json"])
    assert done.exit_code == 0, done.output
    report = json.loads(done.output)
    assert report["calibration"]["feature"] == "log"
    assert 0.5 < report["auc"] <= 1.0


def test_a_learner_without_rate_and_probability_is_refused(with_learner):
    file = with_learner('kind = "FixedPrecision"')
    done = RUNNER.invoke(app, ["calibrate", file])
    assert done.exit_code == 9
    for words in (file, "cannot calibrate FixedPrecision", "has no rate", "GammaPrecision"):
        assert words in done.output


def test_errors_name_the_options(tmp_path):
    slow = re.sub(r"^dt = 0.02", "dt = 1.0", SHIPPED, flags=re.M)
    file = tmp_path / "slow.toml"
    file.write_text(slow.replace("seed = 1", "seed = 1\ndt = 1.0"), encoding="utf-8")
    done = RUNNER.invoke(app, ["calibrate", str(file), "--time-to-recovery", "0.4"])
    assert done.exit_code == 9
    assert "--time-to-recovery 0.4, but a step of the model takes 1 s" in done.output
    assert "at least 1." in done.output
    assert RUNNER.invoke(app, ["calibrate", str(file), "--steps", "6000"]).exit_code == 0
    assert "has --steps 5; give at least" in RUNNER.invoke(app, ["calibrate", "cruise_control", "--steps", "5"]).output


def test_of_a_learner_that_gives_a_probability_it_is_said_how_good_it_is():
    options = ["calibrate", "cruise_control", "--steps", "25000", "--seed", "3"]
    done = RUNNER.invoke(app, [*options, "--json"])
    assert done.exit_code == 0, done.output
    report = json.loads(done.output)
    assert report["calibration"] is None
    assert report["brier"] < 0.7 * report["brier_of_constant"]
    assert report["auc"] > 0.8
    said = " ".join(RUNNER.invoke(app, options).output.split())
    assert f"AUC {report['auc']:.3f}, Brier score {report['brier']:.4f}" in said
    assert "SwitchingPrecision gives a fault probability itself, so there is no map to fit" in said
    assert (
        "it freezes, jumps by 3 sd of its noise or drifts by 5 sd of its noise a second. A fault lasts 0.4 s on" in said
    )
    assert f"On {report['samples']} samples of the 2 sensors, the last fifth of the run, " in said
    assert "average, and the next one begins 2.8 s after it on average." in said
    assert f"of them in fault ({report['faults']} faults begin): AUC" in said
    assert "Do not rely" not in said
    assert "too few faults" not in said
    low, high = report["calibration_error_interval"]
    assert f"calibration error {report['calibration_error']:.3f} (95 % interval {low:.3f} to {high:.3f})." in said


def test_of_few_faults_there_is_no_verdict_but_the_steps_that_it_needs(tmp_path):
    """The probabilities are wrong, see above, but six faults do not show it. With the named or the default steps they do."""
    lines = "kind = 'SwitchingPrecision'\nmodes = [{ kind = 'Offset', time_to_fault = 1e12, time_to_recovery = 1e6 }]"
    file = tmp_path / "car.toml"
    file.write_text(re.sub(r"^kind = \"SwitchingPrecision\".*$", lines, SHIPPED, flags=re.M), encoding="utf-8")
    options = ["calibrate", str(file), "--injection", "0.5", "--drift", "0.1"]
    options += ["--time-to-fault", "10", "--time-to-recovery", "10"]
    said = " ".join(RUNNER.invoke(app, [*options, "--steps", "10000"]).output.split())
    assert "Do not rely" not in said
    few = re.search(r"There are too few faults in the test to say .*: (\d) begin in it, of at least 40\.", said)
    assert few
    assert f"({few.group(1)} faults begin)" in said
    steps = re.search(r"Give --steps (\d+)\.", said)
    assert steps
    for enough in ([], ["--steps", steps.group(1)]):
        said = " ".join(RUNNER.invoke(app, [*options, *enough]).output.split())
        assert "Do not rely on these probabilities for such faults: their Brier" in said
        assert "too few faults" not in said


def test_probabilities_that_are_not_to_be_trusted_are_named_with_the_worst_sensor(tmp_path):
    """Small faults are frequent, and the only mode of the learner expects one in thousands of years."""
    rare = "{ kind = 'Offset', time_to_fault = 1e12, time_to_recovery = 1e6 }"
    lines = f'kind = "SwitchingPrecision"\nmodes = [{rare}]'
    file = tmp_path / "car.toml"
    file.write_text(re.sub(r"^kind = \"SwitchingPrecision\".*$", lines, SHIPPED, flags=re.M), encoding="utf-8")
    options = [
        "calibrate",
        str(file),
        "--steps",
        "40000",
        "--injection",
        "0.5",
        "--drift",
        "0.1",
        "--time-to-recovery",
        "2",
    ]
    done = RUNNER.invoke(app, options)
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "jumps by 0.5 or drifts by 0.1 a second. A fault lasts 2 s" in said
    assert re.search(
        r"Do not rely on these probabilities for such faults: .* The worst are those of sensor \d: their mean is 0",
        said,
    )
    assert "compare with joint = false in [controller.precision]" in said
    report = json.loads(RUNNER.invoke(app, [*options, "--json"]).output)
    assert report["simulated"] == {
        "mean_time_to_fault": 2.8, "mean_time_to_recovery": 2.0, "injection": [0.5, 0.5], "drift": [0.1, 0.1]
    }  # fmt: skip
    assert len(report["sensors"]) == 2


def test_each_sensor_has_sizes_in_its_own_noise_or_its_own_number(tmp_path):
    file = tmp_path / "car.toml"
    two = SHIPPED.replace("sensor_covariance = 1.0", "sensor_covariance = [[1.0, 0.0], [0.0, 4.0]]")
    file.write_text(two, encoding="utf-8")
    options = ["calibrate", str(file), "--steps", "6000"]
    assert json.loads(RUNNER.invoke(app, [*options, "--json"]).output)["simulated"]["injection"] == [3.0, 6.0]
    said = " ".join(RUNNER.invoke(app, [*options, "--injection", "2.5", "--injection", "5"]).output.split())
    assert "jumps by 2.5, 5 (sensors 0 to 1) or drifts by 5 sd of its noise a second." in said
    refused = RUNNER.invoke(app, [*options, "--drift", "1", "--drift", "2", "--drift", "3"])
    assert refused.exit_code == 9
    assert "has --drift [1.0, 2.0, 3.0] for 2 sensors; give one number, or one for each." in refused.output


def test_help_says_that_nothing_is_fitted_with_the_default_learner():
    said = " ".join(RUNNER.invoke(app, ["calibrate", "--help"]).output.split())
    assert "Measure the accuracy of the fault probability on simulated faults." in said
    assert "The default learner gives a probability itself, and nothing is fitted." in said


def test_the_controller_of_the_scenario_is_that_of_the_simulation():
    """A controller by `design` has settings and a law of its own."""
    done = RUNNER.invoke(app, ["calibrate", "position_servo", "--steps", "6000", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["auc"] > 0.8


def test_the_diagram_and_the_numbers_are_written(tmp_path):
    folder = tmp_path / "out"
    done = RUNNER.invoke(app, ["calibrate", "cruise_control", "--steps", "6000", "--seed", "3", "--out", str(folder)])
    assert done.exit_code == 0, done.output
    assert f"Written to {folder}: reliability.png, calibration.json." in done.output
    assert (folder / "reliability.png").read_bytes().startswith(b"\x89PNG")
    numbers = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
    assert sum(numbers["reliability"]["samples"]) == numbers["samples"]
    (tmp_path / "file").write_text("")
    assert RUNNER.invoke(app, ["calibrate", "cruise_control", "--out", str(tmp_path / "file")]).exit_code == 12


def test_slow_sensors_are_said_to_have_all_samples(with_learner, tmp_path):
    file = with_learner('kind = "GammaPrecision"')
    told = "all sensors have a sample in each step"
    plain = RUNNER.invoke(app, ["calibrate", file, "--steps", "5000"])
    assert told not in plain.output
    slow = SHIPPED.replace("\n[sensors]\n", "\n[sensors]\nevery = [1, 5]\n")
    assert slow != SHIPPED
    (tmp_path / "slow.toml").write_text(
        re.sub(r"^kind = \"SwitchingPrecision\".*$", 'kind = "GammaPrecision"', slow, flags=re.M), encoding="utf-8"
    )
    assert told in RUNNER.invoke(app, ["calibrate", str(tmp_path / "slow.toml"), "--steps", "5000"]).output
