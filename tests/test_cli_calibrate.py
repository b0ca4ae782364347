"""``bayesftc calibrate``, and that the shipped example's map is what the command in its comment prints."""

import json
import re

from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.scenario import load_scenario

RUNNER = CliRunner()


def test_the_shipped_map_is_what_the_command_in_its_comment_prints():
    scenario = load_scenario("cruise_control")
    text = scenario.path.read_text(encoding="utf-8")
    command = re.search(r"^#\s+bayesftc (calibrate .*)$", text, re.M)
    assert command
    done = RUNNER.invoke(app, command.group(1).split())
    assert done.exit_code == 0, done.output
    assert done.output.strip().splitlines()[-1] in text.splitlines()


def test_json_and_options():
    done = RUNNER.invoke(
        app, ["calibrate", "cruise_control", "--steps", "6000", "--injection", "8", "--seed", "3", "--json"]
    )
    assert done.exit_code == 0, done.output
    report = json.loads(done.output)
    assert report["calibration"]["feature"] == "log"
    assert 0.5 < report["auc"] <= 1.0


def test_only_learners_with_a_rate_are_calibrated(tmp_path):
    text = load_scenario("cruise_control").path.read_text(encoding="utf-8")
    other = tmp_path / "ser.toml"
    other.write_text(re.sub(r'kind = "GammaPrecision"[\s\S]*', 'kind = "SERFDI"\n', text), encoding="utf-8")
    done = RUNNER.invoke(app, ["calibrate", str(other)])
    assert done.exit_code == 9
    for words in (str(other), "cannot calibrate SERFDI", "has no rate", "GammaPrecision"):
        assert words in done.output
    other.write_text(re.sub(r'kind = "GammaPrecision"[\s\S]*', 'kind = "SwitchingPrecision"\n', text), encoding="utf-8")
    said = " ".join(RUNNER.invoke(app, ["calibrate", str(other)]).output.split())
    assert (
        "cannot calibrate SwitchingPrecision, which has no rate and gives a fault probability itself; give it" in said
    )
    assert "modes" not in said
