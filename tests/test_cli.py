"""The command line in this process: tables, JSON, files, and every way in which a command can end."""

import json
import re

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score
from typer.testing import CliRunner

import bayesftc
from bayesftc.cli import app, run as run_module
from bayesftc.cosim import Result
from bayesftc.cosim.metrics import figures
from bayesftc.cosim.roles import loop_signals
from bayesftc.scenario import load_scenario, shipped_scenarios

CAR = shipped_scenarios()["cruise_control"].read_text()
LEARNER = CAR.index("[controller.precision]")


@pytest.fixture
def bayesftc_(tmp_path, monkeypatch):
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")

    def run(*arguments):
        return CliRunner().invoke(app, [str(a) for a in arguments], prog_name="bayesftc")

    return run


def run_car(bayesftc_, *options):
    return bayesftc_("run", "cruise_control", "--engine", "interpreted", *options)


def test_version_and_help(bayesftc_):
    assert bayesftc_("--version").output.strip() == f"bayesftc {bayesftc.__version__}"
    text = bayesftc_("--help").output
    for command in ("run", "inspect", "example", "bench"):
        assert re.search(rf"\b{command}\b", text)
    assert "cruise_control" in text


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


def test_quiet_prints_nothing_and_twice_gives_the_same_files(bayesftc_, tmp_path):
    contents = []
    for _ in range(2):
        done = run_car(bayesftc_, "-q", "--duration", "1", "--out", "out")
        assert (done.exit_code, done.output) == (0, "")
        contents.append({p.name: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.suffix != ".npz"})
        contents[-1]["result"] = Result.load(tmp_path / "out" / "result.npz").to_pandas().to_csv()
    assert contents[0] == contents[1]


def test_check_kalman(bayesftc_):
    done = run_car(bayesftc_, "--check-kalman", "--json", "--duration", "2")
    check = json.loads(done.output)["kalman"]
    assert check["steps"] == 101
    assert check["mean_difference"] < 1e-12
    assert check["covariance_difference"] < 1e-12
    table = run_car(bayesftc_, "--check-kalman", "--duration", "2").output
    assert "Kalman filter over 101 samples" in table
    assert f"{check['mean_absolute']:.2e}" in table


def test_check_kalman_without_its_signals(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", 'record = ["plant.v"]'))
    done = bayesftc_("run", "car.toml", "--check-kalman", "--engine", "interpreted")
    assert done.exit_code == 5
    assert "--check-kalman" in done.output


def test_no_probability_is_explained(bayesftc_, tmp_path):
    """Each learner that gives no probability has dashes and its own sentence, and the AUC of beta where there is one."""
    for kind, auc in (("FixedPrecision", None), ("GammaPrecision", "beta")):
        (tmp_path / "car.toml").write_text(f'{CAR[:LEARNER]}[controller.precision]\nkind = "{kind}"\n')
        done = bayesftc_("run", "car.toml", "--engine", "interpreted")
        why = load_scenario("car.toml").controller.precision.why_no_probability
        assert why in " ".join(done.output.split())
        assert ("AUC of beta" in done.output) == (auc is not None)
        numbers = json.loads(bayesftc_("run", "car.toml", "--engine", "interpreted", "--json").output)
        sensor = numbers["sensors"][0]
        assert sensor["ranked_by"] == auc
        assert sensor["missed"] is sensor["delay"] is sensor["false_alarm_rate"] is None


def test_what_was_not_recorded_is_a_dash_and_not_a_zero(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("seed = 1", 'record = ["plant.v", "reference.y"]'))
    done = bayesftc_("run", "car.toml", "--engine", "interpreted", "--json", "--out", "out")
    numbers = json.loads(done.output)
    assert numbers["tracking"]["v"]["overall"] > 0
    assert numbers["tracking"]["v"]["during"] is None
    assert numbers["sensors"][0]["fault_share"] is None
    assert len(numbers["notes"]) == 2
    assert (tmp_path / "out" / "figure.png").is_file()


def test_a_run_that_stops_keeps_what_it_has(bayesftc_, tmp_path):
    (tmp_path / "car.toml").write_text(CAR.replace("v0 = 20.0", "m = 1e-320, v0 = 20.0"))
    done = bayesftc_("run", "car.toml", "--out", "out", "--engine", "interpreted")
    assert done.exit_code == 11
    assert done.output.startswith("Error: The run stopped at t = 0.02 s")
    assert "result.npz" in done.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figure.png", "figures.json", "result.npz"]
    assert Result.load(tmp_path / "out" / "result.npz").stopped
    assert json.loads((tmp_path / "out" / "figures.json").read_text())["stopped"]


def test_a_folder_that_cannot_be_written_is_known_before_the_run(bayesftc_, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(run_module, "loop_signals", lambda *_: pytest.fail("the run was made"))
    done = run_car(bayesftc_, "--out", "file")
    assert done.exit_code == 12
    assert "it is a file" in done.output


def test_a_figure_that_fails_leaves_no_half_file(bayesftc_, tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    def fail(self, path, **_):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fail)
    done = run_car(bayesftc_, "--out", "out", "--duration", "1")
    assert done.exit_code == 12
    assert "figure.png cannot be written (No space left on device)" in done.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figures.json", "result.npz"]


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
        (RuntimeError("odd"), 70, ["Traceback", "RuntimeError: odd", "a bug of bayesftc"]),
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
    assert "Warning: The goal and control priors make the closed loop unstable" in done.output
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


def test_example(bayesftc_, tmp_path):
    assert bayesftc_("example").output.split() == list(shipped_scenarios())
    (tmp_path / "car.toml").write_text(bayesftc_("example", "cruise_control").output)
    assert bayesftc_("run", "car.toml", "-q", "--duration", "0.1", "--engine", "interpreted").exit_code == 0
    assert bayesftc_("example", "cruise").exit_code == 3


def test_figures_of_the_compiled_engine_are_the_same():
    """The command line's default engine; one compilation, kept in the cache."""
    scenario = load_scenario("cruise_control")
    loop = scenario.loop()
    runs = [
        figures(loop_signals(loop, scenario.simulate(loop, engine=e))).to_dict() for e in ("compiled", "interpreted")
    ]
    assert runs[0] == runs[1]
