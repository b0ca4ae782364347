"""What a scenario says to no effect is a note on stderr, and no error: short runs of long scenarios are usual."""

import json
from fractions import Fraction
from pathlib import Path

import control
import pytest
from hypothesis import given, strategies as st

from bayesftc import controllers, cosim
from bayesftc.cosim.blocks.faults.without_effect import short_faults
from bayesftc.cosim.campaign.designs.design import Points
from bayesftc.cosim.campaign.runs import late
from bayesftc.scenario import load_scenario, shipped_scenarios
from bayesftc.scenario._unused import unused, unused_of_campaign
from bayesftc.scenario.campaigns import load_campaign

CAR = shipped_scenarios()["cruise_control"].read_text()
FACTORS = 'scenario = "car.toml"\nduration = 2.0\nseeds = 1\n[factors]\n'


@pytest.fixture
def car(tmp_path):
    """Return a function that writes a scenario, in which some texts are others."""

    def write(*pairs):
        text = CAR
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "car.toml").write_text(text)
        return tmp_path / "car.toml"

    return write


def test_a_fault_after_the_end_is_a_note_where_it_disturbs_nobody(bayesftc_, car):
    car()
    short = ("run", "car.toml", "--duration", "2")
    note = "car.toml: 'faults[0]' starts at 6 s, but the run ends at 2 s. The fault has no effect."
    assert f"Note: {note}\n" == bayesftc_(*short).stderr
    assert bayesftc_(*short, "--quiet").output == ""
    done = bayesftc_(*short, "--json")
    assert done.stderr == ""
    assert note in json.loads(done.stdout)["notes"]
    assert unused(load_scenario("car.toml")) == []


def test_a_fault_between_two_steps_is_a_note(bayesftc_, car):
    car()
    with open("car.toml", "a", encoding="utf-8") as file:
        file.write('[[faults]]\nkind = "Bias"\nmagnitude = 1.0\nstart = 1.105\nstop = 1.115\n')
    step = load_scenario("car.toml").loop().step
    when = f"from 1.105 s to 1.115 s, between two steps of {float(step):g} s"
    note = f"car.toml: 'faults[1]' lasts {when}. The fault has no effect."
    assert f"Note: {note}\n" == bayesftc_("run", "car.toml").stderr
    with pytest.warns(UserWarning, match=r"^The fault 'bias_0' lasts from 1\.105 s to 1\.115 s, between two steps"):
        load_scenario("car.toml").loop().simulate(8.0, engine="interpreted")


@given(st.integers(1, 400), st.integers(1, 50), st.integers(1, 100), st.integers(0, 30))
def test_a_fault_is_between_two_steps_if_no_step_is_in_its_window(num, den, start, length):
    step = Fraction(num, den)
    begin, end = start / 10, (start + length + 0.5) / 10
    steps = [float(k * step) for k in range(int(end / float(step)) + 2)]
    seen = any(begin <= t < end for t in steps)
    assert bool(list(short_faults({"f": (begin, end)}, step))) == (not seen)


def test_a_block_that_is_connected_to_nothing_is_a_note(bayesftc_, car):
    blocks = """
[blocks.path]
kind = "Sine"
amplitude = 1.0
period = 2.0
[blocks.wind]
kind = "Constant"
value = 3.0
[blocks.double]
kind = "Gain"
gain = 2.0
[[connections]]
from = "plant.v"
to = "double.u"
[[faults]]
kind = "Bias"
magnitude = 1.0
start = "wind.y > 2"
"""
    car()
    with open("car.toml", "a", encoding="utf-8") as file:
        file.write(blocks)
    note = "car.toml: 'blocks.path' is connected to nothing. It has no effect. Connect it in [[connections]], or leave it out."
    assert unused(load_scenario("car.toml")) == [note]
    done = bayesftc_("run", "car.toml", "--duration", "1", "--engine", "interpreted")
    assert note in " ".join(done.stderr.split())


INSIDE = """
[blocks.part]
kind = "Subsystem"
[blocks.part.blocks.late]
kind = "Freeze"
start = 50.0
[blocks.part.blocks.inner]
kind = "Subsystem"
[blocks.part.blocks.inner.blocks.later]
kind = "Freeze"
start = 60.0
[blocks.part.blocks.inner.blocks.soon]
kind = "Freeze"
start = 1.0
[[blocks.part.blocks.inner.connections]]
from = "later.y"
to = "soon.u"
[[blocks.part.connections]]
from = "inner.y"
to = "late.u"
[[connections]]
from = "plant.v"
to = "part.u"
"""


@pytest.mark.slow
def test_a_fault_inside_subsystems_has_its_note_and_is_none_of_the_plant(bayesftc_, car):
    path = car()
    path.write_text(path.read_text() + INSIDE)
    scenario = load_scenario(path)
    assert [text.partition(": ")[2].split(", but")[0] for text in unused(scenario)] == [
        "'blocks.part.blocks.late' starts at 50 s",
        "'blocks.part.blocks.inner.blocks.later' starts at 60 s",
    ]
    assert scenario.loop().simulate(0.1, engine="interpreted").roles.inputs == ()
    done = bayesftc_("run", path, "--engine", "interpreted", "--duration", "2")
    assert done.exit_code == 0, done.output
    assert "inside[" not in done.stdout
    assert "between the controller and the plant" not in done.stdout


def test_sensors_and_variables_that_nobody_reads_are_said(car):
    path = car(("C = [[1.0], [1.0]]", "C = [[1.0], [0.0]]"), ("count = 2", "count = 2\nmatrix = [[0.0], [0.0]]"))
    said = unused(load_scenario(path))
    assert [text.partition(" has ")[2] for text in said] == [
        "a row of zeros, so sensor 0 measures nothing of the plant.",
        "a row of zeros, so sensor 1 measures nothing of the plant.",
        "a column of zeros, so no sensor measures 'v'.",
        "a row of zeros, so the controller does not use sensor 1.",
    ]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ('"faults[0].start" = [2.5, 3.0]', ["'faults[0]' starts at 2.5 s, but the run ends at 2 s"]),
        ('"faults[0].start" = [0.5, 3.0]', []),
        ('"faults[0].start" = [2.5, { signal = "plant.v", relation = ">", value = 22.0 }]', []),
        ('"sensors.std" = [0.5, 1.0]', ["'faults[0]' starts at 6 s"]),
        ('faults = { none = [], one = [{ kind = "Freeze", start = 0.5 }] }', []),
        ('"simulation.seed" = [1, 2]', ["the factor 'simulation.seed' has no effect", "'faults[0]' starts at 6 s"]),
    ],
)
def test_factors_that_change_nothing_are_said(car, tmp_path, factors, words):
    car()
    path = tmp_path / "campaign.toml"
    path.write_text(FACTORS + factors)
    said = unused_of_campaign(load_campaign(path), "campaign.toml")
    assert len(said) == len(words)
    for text, word in zip(said, words, strict=True):
        assert word in text


def late_car():
    """Return the loop of the shipped car, and the sentence about its fault in a run of 2 s."""
    return load_scenario("cruise_control").loop(), "The fault 'freeze_0' starts at 6 s, but the run ends at 2 s."


def test_python_warns_of_a_fault_after_the_end_at_the_line_of_the_call(recwarn):
    loop, sentence = late_car()
    loop.simulate(2.0)
    (warning,) = recwarn.list
    assert str(warning.message) == f"{sentence} The fault has no effect."
    assert warning.filename == __file__
    recwarn.clear()
    loop.simulate(6.1)
    with loop.start() as session:
        session.advance(1.0)  # it may be continued beyond the start
    assert not recwarn.list


@pytest.mark.parametrize(
    ("grid", "warned"),
    [
        (None, True),
        ({"freeze_0.start": [2.5, 0.5]}, False),
        ({"freeze_0.start": [2.5, cosim.when("plant.v > 22")]}, False),
        ({"freeze_0.stop": [12.0, 15.0]}, True),
        ({"freeze_0": [cosim.Freeze(start=0.5)]}, False),
    ],
)
def test_campaigns_in_python_warn_too(grid, warned, recwarn):
    loop, sentence = late_car()
    cosim.Campaign(loop, duration=2.0, grid=grid, record=["plant.v"])
    assert [sentence in str(warning.message) for warning in recwarn.list] == [True] * warned


def starting_at(start=6.0):
    """Return the loop of the shipped car with another start of its fault."""
    if start is None:
        raise ValueError("no start")
    return cosim.varied(load_scenario("cruise_control").loop(), {"freeze_0.start": start})


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("grid", "warned"),
    [
        (None, "6"),
        ({"start": [2.5, 0.5]}, None),
        ({"start": [4.0, 2.5]}, "2.5"),
        ({"start": [2.5, None]}, "2.5"),  # the second fails
        ({"start": [2.5, cosim.when("plant.v > 22")]}, None),
        ({"start": [2.5] * 5 + [3.0]}, None),  # so many that it is not known
    ],
)
def test_campaigns_of_functions_warn_too(grid, warned, recwarn, monkeypatch):
    monkeypatch.setattr(late, "TRIED", 5)
    cosim.Campaign(
        starting_at, duration=2.0, grid=grid and Points([{"start": s} for s in grid["start"]]), record=["plant.v"]
    )
    said = [f"The fault 'freeze_0' starts at {warned} s, but the run ends at 2 s. The fault has no effect."]
    assert [str(warning.message) for warning in recwarn.list] == said * (warned is not None)
    assert {warning.filename for warning in recwarn.list} <= {__file__}


def test_campaigns_of_scenarios_warn_and_note_it_once(car, tmp_path, bayesftc_, recwarn):
    car()
    (tmp_path / "campaign.toml").write_text(FACTORS + '"sensors.std" = [0.5, 1.0]')
    load_campaign(tmp_path / "campaign.toml")
    assert ["starts at 6 s" in str(warning.message) for warning in recwarn.list] == [True]
    done = bayesftc_("campaign", tmp_path / "campaign.toml", "--out", tmp_path / "store", "--executor", "threads")
    assert done.stderr.count("starts at 6 s") == 1


def test_comparisons_warn_too(recwarn, bayesftc_, car):
    loop, sentence = late_car()
    cosim.compare({"one": loop, "other": late_car()[0]}, duration=2.0, seeds=2, executor=cosim.Threads(1))
    assert [sentence in str(warning.message) for warning in recwarn.list] == [True]
    path = car()
    other = path.with_name("other.toml")
    other.write_text(path.read_text())
    arguments = ("run", path, other, "--compare", "--seeds", 2, "--duration", "2")
    done = bayesftc_(*arguments)
    notes = [line for line in done.stderr.splitlines() if line.startswith("Note: ")]
    assert [Path(note.partition(": 'faults[0]' starts at 6 s")[0]).name for note in notes] == ["car.toml", "other.toml"]
    assert len(json.loads(bayesftc_(*arguments, "--json").stdout)["notes"]) == 2


def test_closed_loop_warns_of_sensors_and_blocks_that_nothing_uses(recwarn):
    system = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [0.0]], 1e-3, 0.04, dt=0.1)
    cosim.closed_loop(
        system, controllers.BayesianController(model), control="u", measured="y", reference=1.0,
        sensors=cosim.Sensors(2, 0.2, matrix=[[1.0], [0.0]]), blocks={"wind": cosim.Constant(1.0)},
    )  # fmt: skip
    assert [str(warning.message) for warning in recwarn.list] == [
        "The matrix of sensors= has a row of zeros, so sensor 1 measures nothing of the plant.",
        "C of the controller's model has a row of zeros, so the controller does not use sensor 1.",
        "The block 'wind' is connected to nothing. It has no effect. Connect it with connections=[...], or leave it out.",
    ]
