"""``bayesftc replay``: runs once more, those that failed too, of loops and of other diagrams; and stores that are damaged."""

import importlib
import json
import pickle
import re
import sys

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.run.result import Result
from bayesftc.scenario import shipped_scenarios

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")

FILE = """
scenario = "cruise_control"
seeds = 2
duration = 2.0
record = ["plant.v"]
decimation = 2

[[metrics]]
kind = "rmse"
signal = "plant.v"
reference = "reference.y"

[factors]
"plant.parameters.m" = [80.0, 100.0]
"""


def wave(folder, amplitudes=(1.0, 2.0), **options):
    """Store a campaign of a diagram that is no closed loop: a sine, and noise that is made larger."""
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Sine(amplitude=1.0, period=4.0), "sine")
    noise, gain = diagram.add(cosim.Gaussian(std=0.1), "noise"), diagram.add(cosim.Gain(3.0), "gain")
    diagram.connect(noise["y"], gain["u"])
    campaign = cosim.Campaign(
        diagram, duration=2.0, grid={"sine.amplitude": list(amplitudes)}, seeds=2, record=["gain.y"], **options
    )
    campaign.run(folder)
    return campaign


@pytest.fixture
def said(bayesftc_):
    """Run a replay, and return its notes."""

    def said(*arguments):
        done = bayesftc_("replay", *arguments, "--json")
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    return said


def test_each_run_has_the_bits_of_the_store(said, bayesftc_, tmp_path):
    (tmp_path / "tracking.toml").write_text(FILE)
    assert bayesftc_("campaign", "tracking.toml", "-q").exit_code == 0
    for run in (0, 3):
        numbers = said("tracking", run)
        assert numbers["notes"] == ["It has the same bits as the run in the store."]
        assert numbers["factors"] == {"plant.parameters.m": [80.0, 100.0][run // 2]}
        assert numbers["steps"] == 100
        assert numbers["tracking"]


def test_a_replay_lists_the_inferred_faults_as_a_run_does(bayesftc_, tmp_path):
    (tmp_path / "tracking.toml").write_text(FILE.replace("duration = 2.0", "duration = 8.0"))
    assert bayesftc_("campaign", "tracking.toml", "-q").exit_code == 0
    replayed, run = bayesftc_("replay", "tracking", 2), bayesftc_("run", "cruise_control", "--duration", 8, "--seed", 0)
    numbers = json.loads(bayesftc_("replay", "tracking", 2, "--json").stdout)
    assert "Frozen" in {found["kind"] for found in numbers["findings"]}
    for done in (replayed, run):
        assert "Faults that the controller infers" in done.stdout, done.output
        assert "The model\nThe 401 samples have not enough evidence" in done.stdout, done.output


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("process_covariance = 0.001", "process_covariance = 1e-5", "Look at the model first"),
        ("initial_mean = 20.0", "initial_mean = 20.0\nu_max = 100.0", "force is at its limit of 100 N for"),
    ],
)
def test_a_replay_has_the_notes_of_a_run(said, bayesftc_, tmp_path, old, new, words):
    text = shipped_scenarios()["cruise_control"].read_text()
    assert old in text
    (tmp_path / "car.toml").write_text(text.replace(old, new, 1))
    (tmp_path / "study.toml").write_text('scenario = "car.toml"\nseeds = 1\n')
    assert bayesftc_("campaign", "study.toml", "-q").exit_code == 0
    replayed = said("study", 0)
    run = json.loads(bayesftc_("run", "car.toml", "--seed", replayed["seed"], "--json").stdout)
    assert any(words in note for note in replayed["notes"])
    assert replayed["notes"][1:] == run["notes"]


def test_a_campaign_keeps_the_numbers_of_a_file(said, bayesftc_, tmp_path):
    """The store has no copy of the file, which may be gone when a run is repeated."""
    (tmp_path / "drive.csv").write_text("t,speed\n0,20\n2,24\n")
    text = shipped_scenarios()["cruise_control"].read_text()
    begin = text.index("[reference]")
    end = text.index("\n[", begin) + 1
    table = '[reference]\nkind = "Table"\nfile = "drive.csv"\ncolumn = "speed"\n\n'
    (tmp_path / "car.toml").write_text(f"{text[:begin]}{table}{text[end:]}")
    (tmp_path / "study.toml").write_text('scenario = "car.toml"\nseeds = 1\nduration = 2.0\nrecord = ["reference.y"]\n')
    assert bayesftc_("campaign", "study.toml", "-q").exit_code == 0
    (tmp_path / "drive.csv").unlink()
    assert said("study", 0)["notes"][0] == "It has the same bits as the run in the store."


def test_a_replay_with_an_estimator_alone_compares_its_model(said, tmp_path):
    """Its control is a signal of another block. The plant moves twice as far as the model says."""
    from bayesftc import controllers

    model = controllers.LinearModel([[0.95]], [[0.05]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    system = control.ss([[0.95]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"])
    diagram = cosim.Diagram(0.1)
    blocks = cosim.StateSpace(system), cosim.Sensors(2, 0.1), controllers.StateEstimator(model), cosim.Sine(1.0, 4.0)
    plant, sensors, estimator, source = map(diagram.add, blocks, ("plant", "sensors", "estimator", "source"))
    diagram.connect(source["y"], plant["u"])
    diagram.connect(plant["y"], sensors["u"])
    diagram.connect(sensors["y"], estimator["y"])
    diagram.connect(source["y"], estimator["u"])
    cosim.Campaign(diagram, duration=60.0, grid={"source.amplitude": [1.0, 2.0]}).run(tmp_path / "estimated")
    assert said("estimated", 1)["model"]["kind"] == "gain"


def test_a_run_that_differs_is_told(said, tmp_path):
    from bayesftc.cosim.campaign.designs.plan import Piece
    from bayesftc.cosim.campaign.store.folder import CampaignStore

    campaign = wave(tmp_path / "wave")
    outcome = campaign.job.run(Piece(0, 2, 3))
    outcome.signals["gain.y"][0, 7] = np.nextafter(outcome.signals["gain.y"][0, 7], 9.0)
    metadata = CampaignStore.open("wave").metadata
    with CampaignStore.resume(
        "wave", metadata.description, metadata.plan, metadata.signals, campaign.job.time, metadata.metrics
    ) as store:
        store.replace(outcome)
    assert said("wave", 1)["notes"][0] == "It has the same bits as the run in the store."
    assert said("wave", 2)["notes"][0].startswith("It differs from the run in the store in gain.y. ")


def test_a_diagram_that_is_no_closed_loop_is_recorded_and_drawn(said, bayesftc_, tmp_path, same_bits):
    campaign = wave(tmp_path / "wave")
    done = bayesftc_("replay", "wave", 3, "--out", "once more")
    assert done.exit_code == 0, done.output
    assert "It has the same bits as the run in the store." in done.stdout
    assert "There are no figures of this run: " in done.stdout
    assert "Written to once more: figure.png, figures.json, result.npz" in done.stdout
    result = Result.load(tmp_path / "once more" / "result.npz")
    assert set(result) == {"sine.y", "noise.y", "gain.y"}
    same_bits(result["gain.y"], campaign.replay(3)["gain.y"])
    assert (tmp_path / "once more" / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "once more" / "figures.json").read_text()) == said("wave", 3)
    assert bayesftc_("replay", "wave", 3, "-q").output == ""


@pytest.mark.usefixtures("undrawn")
def test_runs_that_had_no_time_go_to_their_end(said, bayesftc_, tmp_path):
    (tmp_path / "tracking.toml").write_text("time_limit = 1e-9\n" + FILE)
    bayesftc_("campaign", "tracking.toml", "-q")
    numbers = said("tracking", 1, "--out", "again")
    (note,) = numbers["notes"]
    assert note.startswith("In the store this run failed: The run reached its time limit")
    assert "Now it is complete. It has the same bits as the run in the store, as far as both have run." in note
    assert numbers["stopped"] is None
    assert numbers["steps"] == 100
    assert (tmp_path / "again" / "result.npz").exists()


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_stops_stops_again_and_its_steps_are_there(said, bayesftc_, tmp_path):
    (tmp_path / "growth.toml").write_text(FILE.replace("[80.0, 100.0]", "[1e-300]").replace("2.0", "4.0"))
    bayesftc_("campaign", "growth.toml", "-q")
    import pandas as pd

    failed = pd.read_parquet(tmp_path / "growth" / "runs.parquet").iloc[1]
    assert failed["status"] == "failed"
    numbers = said("growth", 1, "--out", "again")
    assert numbers["stopped"] == failed["reason"]
    assert numbers["steps"] == failed["steps"] < 200
    assert numbers["notes"][0] == (
        f"In the store this run failed: {failed['reason']} Now it stopped as well: {failed['reason']} "
        "It has the same bits as the run in the store, as far as both have run."
    )
    assert len(Result.load(tmp_path / "again" / "result.npz").time) == numbers["steps"] + 1
    quiet = bayesftc_("replay", "growth", 1, "-q")
    assert quiet.exit_code == 0


def test_a_run_that_is_not_done_yet(said, tmp_path):
    from bayesftc.cosim.campaign.store.parts import WHOLE

    wave(tmp_path / "wave", piece=2)
    (tmp_path / "wave" / WHOLE).unlink()  # as before anything was done
    assert said("wave", 0)["notes"][0] == "The store does not have this run yet."


@pytest.mark.sampled(3)
@pytest.mark.parametrize("damage", ["cut", "bits", "empty", "other", "another", "gone", "module"])
def test_a_store_whose_loop_is_damaged_is_refused_in_a_sentence(bayesftc_, tmp_path, damage):
    wave(tmp_path / "wave")
    file = tmp_path / "wave" / "job.pickle"
    data = file.read_bytes()
    if damage == "another":
        wave(tmp_path / "longer", amplitudes=(1.0, 2.0, 3.0))
        data = (tmp_path / "longer" / "job.pickle").read_bytes()
    file.write_bytes(
        {
            "cut": data[: len(data) // 2],
            "bits": bytes(b ^ 0x55 for b in data[:40]) + data[40:],
            "empty": b"",
            "other": pickle.dumps(({}, pickle.dumps("a text"))),
            "another": data,
            "gone": data,
            "module": data.replace(b"bayesftc.cosim", b"bayesftx.cosim"),
        }[damage]
    )
    if damage == "gone":
        file.unlink()
    done = bayesftc_("replay", "wave", 0, "--out", "again")
    assert done.exit_code == 20, done.output
    message = re.sub(r"\s+", " ", done.stderr)
    reasons = {
        "gone": "cannot be repeated from its store",
        **dict.fromkeys(("other", "another"), "does not contain the loop"),
    }
    reasons["module"] = "needs the module 'bayesftx', which is not found"
    assert reasons.get(damage, "is damaged, or needs the modules") in message
    assert "Traceback" not in done.output
    assert not (tmp_path / "again").exists()


def test_an_fmu_that_is_not_the_one_is_refused(bayesftc_, tmp_path):
    (tmp_path / "tracking.toml").write_text(FILE)
    bayesftc_("campaign", "tracking.toml", "-q")
    (fmu,) = (tmp_path / "tracking" / "fmus").iterdir()
    fmu.chmod(0o644)
    fmu.write_bytes(fmu.read_bytes() + b" ")
    done = bayesftc_("replay", "tracking", 0)
    assert done.exit_code == 20
    assert "is missing or damaged" in re.sub(r"\s+", " ", done.stderr)


def test_a_module_that_is_not_on_the_path_is_named_with_what_to_do(bayesftc_, tmp_path, monkeypatch):
    """The command has no present folder on its path, where a script has found the modules beside it."""
    (tmp_path / "own_loops.py").write_text(
        "from bayesftc import cosim\n"
        "def wave(period):\n"
        "    diagram = cosim.Diagram(dt=0.1)\n"
        "    diagram.add(cosim.Sine(amplitude=1.0, period=period), 'sine')\n"
        "    return diagram\n"
    )
    with monkeypatch.context() as there:
        there.syspath_prepend(str(tmp_path))
        own = importlib.import_module("own_loops")
        cosim.Campaign(own.wave, duration=1.0, grid={"period": [1.0, 2.0]}).run(tmp_path / "waves")
    monkeypatch.delitem(sys.modules, "own_loops")
    done = bayesftc_("replay", "waves", 0, "--out", "again")
    assert done.exit_code == 20
    message = re.sub(r"\s+", " ", done.stderr)
    assert "it needs the module 'own_loops', which is not found" in message
    assert "PYTHONPATH=" in message
    monkeypatch.syspath_prepend(str(tmp_path))
    assert bayesftc_("replay", "waves", 0, "--out", "again").exit_code == 0
