"""``bayesftc export`` and ``bayesftc verify``, as a new user meets them."""

import json
import re
import zipfile

import pytest

from bayesftc import fmus
from bayesftc.scenario import shipped_scenarios


@pytest.fixture(scope="module")
def scenarios(tmp_path_factory):
    """Return the shipped car with gamma learning, which is short in C, run in plain Python, and the same with another setting."""
    folder = tmp_path_factory.mktemp("scenarios")
    text = shipped_scenarios()["cruise_control"].read_text().replace("seed = 1", 'seed = 1\nengine = "interpreted"')
    learners = {"car": '"GammaPrecision"', "other": '"GammaPrecision"\nforgetting = 0.9'}
    files = {name: text.replace('"SwitchingPrecision"', learner) for name, learner in learners.items()}
    assert len(set(files.values())) == 2
    for name, content in files.items():
        (folder / f"{name}.toml").write_text(content)
    return folder / "car.toml", folder / "other.toml"


def test_the_fmu_stops_by_default_when_the_scenario_ends(bayesftc_, scenarios, tmp_path, c_compiler):
    text = scenarios[0].read_text()
    assert "duration = 20.0" in text
    (tmp_path / "short.toml").write_text(text.replace("duration = 20.0", "duration = 61.5"))
    done = bayesftc_("export", "short.toml", "--block", "controller", "--out", "it.fmu")
    assert done.exit_code == 0, done.output
    written = zipfile.ZipFile(tmp_path / "it.fmu").read("modelDescription.xml").decode()
    assert 'stopTime="61.5' in written


def test_a_controller_leaves_and_is_verified(bayesftc_, scenarios, tmp_path, c_compiler):
    car, other = scenarios
    done = bayesftc_("export", car, "--block", "controller")
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert lines[0].startswith("controller.fmu: FMI 2.0, ")
    assert lines[1] == "inputs   y (2) in m/s, goal (1) in m/s"
    assert lines[2].startswith("outputs  u (1) in N, x_hat (1), P (1x1), R (2x2)")
    assert lines[-3] == "step     0.02 s, fixed"
    assert lines[-2].startswith("timing   sampled: ")
    assert lines[-1] == f"Try:  bayesftc verify controller.fmu --against {car}"

    done = bayesftc_("verify", "controller.fmu", "--against", car)
    assert done.exit_code == 0, done.output
    assert "controller.fmu beside controller of" in done.output
    assert "1001 steps, seed 1" in done.output
    assert "In a run with the FMU in place of these blocks: largest difference 0." in done.output
    assert "controller.fmu does what controller does: the same numbers at all 1001 steps." in done.output

    done = bayesftc_("verify", "controller.fmu", "--against", other, "--duration", 4, "--seed", 7, "--json")
    assert done.exit_code == 19
    found = json.loads(done.output)
    assert (found["agrees"], found["seed"], found["steps"], found["blocks"]) == (False, 7, 201, ["controller"])
    assert found["beside"]["controller.u"]["largest"] > 0.0
    assert found["in_loop"]["plant.v"]["largest"] > 0.0
    done = bayesftc_("verify", "controller.fmu", "--against", other, "--duration", 4, "--tolerance", 1e6, "--quiet")
    assert (done.exit_code, done.output) == (0, "")

    done = bayesftc_("inspect", "controller.fmu")
    assert "stands for" in done.output
    assert "controller (bayesftc verify runs it beside the block)" in " ".join(done.output.split())
    assert "bayesftc verify" not in bayesftc_("inspect", "CruiseControl").output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["controller.fmu"]


@pytest.mark.slow
def test_several_blocks_become_one(bayesftc_, scenarios, c_compiler):
    car, _ = scenarios
    options = [
        "--block",
        "controller",
        "-b",
        "sensors",
        "-b",
        "freeze_0",
        "-b",
        "sensors",
        "-o",
        "front.fmu",
        "--fmi",
        "3",
    ]
    done = bayesftc_("export", car, *options)
    assert done.exit_code == 0, done.output
    assert "front.fmu: FMI 3.0, " in done.output
    assert "inputs   sensors.u in m/s, sensors.noise (2), controller.goal (1)" in done.output
    assert "tunable  sensors.std in m/s, " in done.output
    assert "freeze_0.start in s, freeze_0.stop in s, " in done.output
    done = bayesftc_("verify", "front.fmu", "--against", car, "--duration", 8, "--isolate")
    assert done.exit_code == 0, done.output
    assert "what sensors, freeze_0 and controller do: the same numbers" in done.output


def test_the_c_alone(bayesftc_, scenarios, tmp_path):
    done = bayesftc_("export", scenarios[0], "--block", "controller", "--format", "c")
    assert done.exit_code == 0, done.output
    assert "controller.c and controller.h: controller_init, controller_step; controller.h explains" in done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["controller.c", "controller.h"]
    assert "void controller_init(controller *" in (tmp_path / "controller.h").read_text()


WRONG = {
    "a block that is not there": (5, "no block 'contoller'; did you mean 'controller'?", ("--block", "contoller")),
    "an FMU": (9, "The block 'plant' is an FMU", ("--block", "plant")),
    "no folder": (12, "does not exist; create the folder", ("--block", "controller", "-o", "no/control_unit.fmu")),
    "another ending": (12, "name it control_unit.fmu", ("--block", "controller", "-o", "control_unit.zip")),
    "C by the name of a file": (
        12,
        "C is written into a folder",
        ("--block", "controller", "--format", "c", "-o", "x.c"),
    ),
    "another version": (9, "must be one of '2.0', '3.0'", ("--block", "controller", "--fmi", "1.0")),
    "another platform": (5, "did you mean", ("--block", "controller", "--platform", "linux-x86-64")),
    "feedthrough": (9, "acts on the output", ("--block", "controller", "--timing", "plant")),
    "C of FMI": (
        9,
        "--fmi cannot be used with --format c",
        ("--block", "controller", "--format", "c", "--fmi", "2.0"),
    ),
    "no block": (2, "--block", ()),
}


@pytest.mark.parametrize(("code", "says", "options"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_exported_is_a_sentence_and_leaves_nothing(code, says, options, bayesftc_, scenarios, tmp_path):
    done = bayesftc_("export", scenarios[0], *options)
    assert done.exit_code == code, done.output
    assert says in " ".join(done.output.replace("│", " ").split())
    assert "Traceback" not in done.output
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_verified_is_a_sentence(bayesftc_, scenarios, tmp_path):
    car, _ = scenarios
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w"):
        pass
    for code, says, arguments in (
        (4, "nope.fmu cannot be read", ("nope.fmu", "--against", car)),
        (4, "empty.fmu", ("empty.fmu", "--against", car)),
        (3, "There is no file 'carr'", ("empty.fmu", "--against", "carr")),
        (9, "--tolerance is nan", ("empty.fmu", "--against", car, "--tolerance", "nan")),
        (2, "--against", ("empty.fmu",)),
        (9, "Name it by --block; there are ", (fmus.path("TwoMasses"), "--against", car)),
    ):
        done = bayesftc_("verify", *arguments)
        assert done.exit_code == code, done.output
        assert says in " ".join(done.output.replace("│", " ").split())
        assert "Traceback" not in done.output


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (("--platform", "windows"), 5, "Binaries for the platform 'windows' are not supported"),
        (("--out", "missing/car.fmu"), 12, "missing: it does not exist; create the folder, or choose another."),
        (("--format", "c", "--out", "car.c"), 12, "car.c is the name of a file"),
        (("--format", "c", "--fmi", "3.0"), 9, "--fmi cannot be used with --format c"),
    ],
)
def test_options_are_checked_before_the_scenario_is_read(bayesftc_, options, code, sentence):
    done = bayesftc_("export", "missing.toml", "--block", "controller", *options)
    assert done.exit_code == code
    assert sentence in done.output


def test_without_a_name_the_blocks_are_listed(bayesftc_, scenarios):
    done = bayesftc_("export", scenarios[0])
    assert done.exit_code == 2
    said = " ".join(done.output.replace("│", " ").split())
    assert "name what to export, such as --block controller; " in said
    assert re.search(r"has reference, sensors, .*controller and \w+\.", said)
    assert "plant" not in said
