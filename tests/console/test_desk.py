"""The headless desk: what is done by hand is an entry of the scenario, and the file has the bits of the run."""

import csv
import pickle
import tomllib
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from block_kinds import SIZES
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc.console.desk.actions import faults_of
from bayesftc.console.desk.desk import MOST_BRANCHES, Desk
from bayesftc.console.desk.events import as_csv
from bayesftc.console.desk.history import History, SavedStates
from bayesftc.console.shown.layout import MADE, layout
from bayesftc.cosim.errors import BayesFTCError, ModelError, UnknownNameError
from bayesftc.scenario import load_scenario
from bayesftc.scenario._written import toml


def fault(kind, **more):
    return {"kind": kind, **SIZES.get(kind, {}), **more}


def bits(values):
    return np.ascontiguousarray(values).view(np.int64)


def same_as_run(desk, tmp_path: Path):
    """Run the file that the desk writes, and compare every bit of every signal with the rows of the desk."""
    file = tmp_path / "by_hand.toml"
    file.write_text(desk.toml(), encoding="utf-8")
    result = load_scenario(file).simulate()
    lane = desk.branch.lanes[0]
    assert list(result) == list(lane.shapes)
    values = np.concatenate([result[name].reshape(len(result.time), -1) for name in result], axis=1)
    assert lane.rows.first == 0
    assert np.array_equal(bits(values), bits(lane.rows.values))


@pytest.fixture
def desk():
    with Desk("cruise_control", beside=()) as made:
        yield made


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", [each.__name__ for each in MADE])
@pytest.mark.parametrize("target", ["sensors", "force"])
def test_every_fault_has_the_bits_of_the_file(desk, tmp_path, kind, target):
    if (kind, target) == ("Dropout", "force"):
        with pytest.raises(ModelError, match="must be numbers"):
            desk.act("fault", target, fault(kind))
        return
    desk.advance_to(40)
    before = desk.branch.lanes[0].rows
    names = list(desk.branch.lanes[0].place)
    desk.act("fault", target, fault(kind, duration=0.6))
    lane = desk.branch.lanes[0]
    places = [lane.place[name] for name in names]
    assert np.array_equal(bits(before.values), bits(lane.rows.values[:, places]))  # what was is not changed
    desk.advance_to(120)
    name = faults_of(lane.content)[-1][1]
    assert lane.rows.values[:, lane.place[f"{name}.active"]].sum() == 30
    same_as_run(desk, tmp_path)


def test_condition_counts_from_the_action_on(desk, tmp_path):
    desk.advance_to(100)  # the speed has been above 22 m/s before
    lane = desk.branch.lanes[0]
    assert (lane.rows.values[:, lane.place["plant.v"]] > 22.0).any()
    desk.act("fault", "sensors", fault("Freeze", sensor=1, start="plant.v > 22", duration=0.5))
    desk.advance_to(600)
    lane = desk.branch.lanes[0]
    active = lane.rows.values[:, lane.place["freeze_1.active"]]
    assert not active[:101].any()
    assert active.any()
    same_as_run(desk, tmp_path)


def test_reference_and_repair(desk, tmp_path):
    desk.advance_to(50)
    desk.act("goal", "0", value=23.0)
    desk.advance_to(100)
    desk.act("goal", "0", value=18.0)
    desk.act("fault", "sensors", fault("Bias"))
    desk.advance_to(150)
    desk.act("repair", "bias_0")
    desk.act("fault", "sensors", fault("Freeze", start=100.0))
    desk.act("repair", "freeze_0_2")  # has not begun
    desk.advance_to(200)
    lane = desk.branch.lanes[0]
    goal = lane.rows.values[:, lane.place["by_hand_0.y"]]
    assert goal[51] == goal[100] == 23.0
    assert goal[101] == 18.0
    active = lane.rows.values[:, lane.place["bias_0.active"]]
    assert np.flatnonzero(active).tolist() == list(range(101, 151))
    same_as_run(desk, tmp_path)


def test_go_back_has_the_same_bits(desk):
    desk.advance_to(400)
    before = desk.branch.lanes[0].rows.values.copy()
    alarms = desk.branch.lanes[0].alarms
    for k in (399, 123, 0, 250):
        desk.go_back(k)
        assert desk.k == k
        assert len(desk.branch.lanes) == 1
    desk.advance_to(400)
    assert np.array_equal(bits(before), bits(desk.branch.lanes[0].rows.values))
    assert desk.branch.lanes[0].alarms == alarms
    assert len(desk.branches) == 1
    with pytest.raises(ModelError, match="0 to 400"):
        desk.go_back(401)


def test_branches(desk, tmp_path):
    desk.advance_to(300)
    desk.act("fault", "sensors", fault("Freeze", sensor=1))
    desk.advance_to(350)
    desk.go_back(200)
    branch = desk.act("fault", "sensors", fault("Drift"))
    assert (branch.name, branch.parent, branch.since) == ("branch 2", "first", 200)
    assert [action.settings["kind"] for action in branch.actions] == ["Drift"]  # the freeze came later
    desk.compare("first")
    desk.advance_to(320)
    assert desk.branches["first"].k == 320
    same_as_run(desk, tmp_path)
    desk.rename("branch 2", "drift")
    desk.choose("first")
    assert desk.branch.actions[0].settings["kind"] == "Freeze"
    assert desk.compared is desk.branches["drift"]
    with pytest.raises(ModelError, match="present branch"):
        desk.remove("first")
    desk.remove("drift")
    assert desk.compared is None
    with pytest.raises(UnknownNameError, match="no branch"):
        desk.choose("drift")


def test_what_was_done_later_stays_in_its_branch(desk, tmp_path):
    desk.advance_to(100)
    desk.act("fault", "sensors", fault("Bias", sensor=0))
    desk.advance_to(600)  # the freeze of sensor 0 is in the file
    desk.act("fault", "sensors", fault("Freeze", sensor=1))
    desk.act("goal", "0", value=23.0)
    desk.advance_to(700)
    first = desk.branch
    before = first.lanes[0].rows.values.copy()
    desk.go_back(250)
    assert desk.branch is first  # to look back makes no branch
    assert [name for _, name, _ in desk.faults()] == ["freeze_0", "bias_0"]
    shown = layout(desk)
    assert [each["name"] for each in shown["faults"]] == ["freeze_0", "bias_0"]
    assert [each["later"] for each in shown["actions"]] == [False, True, True]
    assert [each["kind"] for each in tomllib.loads(desk.toml())["faults"]] == ["Freeze", "Bias"]
    desk.go_back(650)  # and forward again
    assert [name for _, name, _ in desk.faults()] == ["freeze_0", "bias_0", "freeze_1"]
    desk.go_back(250)
    desk.advance_to(700)
    assert (desk.branch.name, desk.branch.parent, desk.branch.since) == ("branch 2", "first", 250)
    assert "freeze_1.active" not in desk.branch.lanes[0].place
    assert [name for _, name, _ in desk.faults()] == ["freeze_0", "bias_0"]
    same_as_run(desk, tmp_path)
    desk.choose("first")
    assert desk.k == 700
    assert [name for _, name, _ in desk.faults()] == ["freeze_0", "bias_0", "freeze_1"]
    assert np.array_equal(bits(before), bits(desk.branch.lanes[0].rows.values))
    same_as_run(desk, tmp_path)


def test_events_are_noted_once(desk):
    desk.advance_to(100)
    desk.act("fault", "sensors", fault("Stuck", sensor=1, at=21.0))
    desk.advance_to(200)
    desk.act("goal", "0", value=23.0)  # computes the alarm once more
    desk.go_back(50)
    desk.advance_to(60)
    desk.rename("branch 2", "=1+1")
    events = desk.events.all()
    assert [(e.what, e.branch) for e in events] == [
        ("action", "first"), ("alarm", "first"), ("action", "first"), ("action", "first"), ("branch", "branch 2"),
        ("branch", "=1+1"),
    ]  # fmt: skip
    assert events[0].words == "Stuck of sensor 1 (at 21)"
    assert (events[0].time, events[3].time, events[4].time) == (2.0, 1.0, 1.0)
    assert events[1].words == "sensor 1: alarm"
    assert 2.0 < events[1].time < 3.0
    rows = [*csv.reader(as_csv(events).splitlines())]
    assert [row[1] for row in rows[:2]] == ["time", "2.0"]
    assert rows[-1][2:] == ["'=1+1", "branch", "branch 2 has the new name =1+1"]  # no formula for a spreadsheet
    assert datetime.fromisoformat(rows[1][0]).tzinfo is not None


def test_most_branches(desk):
    desk.advance_to(20)
    for _ in range(MOST_BRANCHES - 1):
        desk.go_back(10)
        desk.act("goal", "0", value=20.0)
        desk.advance_to(20)
    desk.go_back(10)
    with pytest.raises(ModelError, match="Remove one"):
        desk.act("goal", "0", value=20.0)
    desk.go_back(0)
    with pytest.raises(ModelError, match="Remove one"):
        desk.advance_to(1)
    assert desk.k == 0


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (("fault", "sensors", {"kind": "Freeze", "sensor": 7}), "sensor"),
        (("fault", "sensors", {"kind": "Freezing"}), "kind"),
        (("fault", "sensors", {"kind": "Freeze", "start": 0.1}), "already at"),
        (("fault", "sensors", {"kind": "Freeze", "start": "fast"}), "condition"),
        (("fault", "sensors", {"kind": "Freeze", "start": "plant.x > 1"}), "plant"),
        (("fault", "brake", {"kind": "Freeze"}), "brake"),
        (("repair", "freeze_9"), "freeze_9"),
        (("goal", "3", None, 1.0), "references"),
        (("input", "mass", None, 1.0), "mass"),
        (("explode", "plant"), "explode"),
    ],
)
def test_wrong_actions_change_nothing(desk, action, words):
    desk.advance_to(20)
    with pytest.raises(BayesFTCError, match=words):
        desk.act(*action)
    desk.advance_to(30)
    assert desk.branch.actions == ()
    assert desk.k == 30


def test_controllers_see_the_same_noise_and_faults():
    with Desk("cruise_control") as desk:
        desk.advance_to(100)
        desk.act("fault", "sensors", fault("Freeze", sensor=1))
        desk.advance_to(300)
        first, second = desk.branch.lanes
        assert [first.name, second.name] == ["SwitchingPrecision", "FixedPrecision"]
        noise = [lane.rows.values[:, lane.place["disturbance_noise.y"]] for lane in desk.branch.lanes]
        assert np.array_equal(*noise)
        assert first.place["freeze_1.active"] == second.place["freeze_1.active"]
    with pytest.raises(UnknownNameError, match="FixedPrecision"):
        Desk("cruise_control", beside=["FixPrecision"])


ACTIONS = st.lists(
    st.one_of(
        st.tuples(
            st.just("fault"),
            st.sampled_from(["sensors", "force"]),
            st.sampled_from([each.__name__ for each in MADE if each.__name__ != "Dropout"]),
            st.sampled_from([0, 1]),
            st.sampled_from([None, 0.1, 0.5]),
        ),
        st.tuples(st.just("goal"), st.floats(15.0, 25.0)),
        st.tuples(st.just("repair"), st.integers(0, 3)),
        st.tuples(st.just("back"), st.integers(0, 60)),
        st.tuples(st.just("on"), st.integers(1, 60)),
    ),
    min_size=1,
    max_size=8,
)


def perform(desk, actions):
    for what, *rest in actions:
        if what == "fault":
            target, kind, sensor, duration = rest
            more = {"duration": duration} if duration else {}
            desk.act("fault", target, fault(kind, sensor=sensor if target == "sensors" else 0, **more))
        elif what == "goal":
            desk.act("goal", "0", value=rest[0])
        elif what == "repair":
            known = faults_of(desk.branch.lanes[0].content)
            if known:
                with suppress(UnknownNameError):  # after going back, a fault that was made later is not known yet
                    desk.act("repair", known[rest[0] % len(known)][1])
        elif what == "back":
            desk.go_back(max(desk.k - rest[0], 0))
        desk.advance_to(desk.k + (rest[0] if what == "on" else 7))


@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ACTIONS)
def test_random_actions_have_the_bits_of_the_file(tmp_path, actions):
    with Desk("cruise_control", beside=()) as desk:
        desk.advance_to(10)
        perform(desk, actions)
        same_as_run(desk, tmp_path)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ACTIONS)
def test_many_random_actions_have_the_bits_of_the_file(tmp_path, actions):
    with Desk("cruise_control", beside=()) as desk:
        desk.advance_to(10)
        perform(desk, actions)
        same_as_run(desk, tmp_path)


def test_history_stays_within_its_memory():
    history = History(4, 4 * 8 * 3000)
    kept = []
    for first in range(0, 20_000, 100):
        rows = np.arange(first, first + 100, dtype=np.float64)[:, None] * np.ones(4)
        history.append(rows, first)
        kept.append(history.rows)
        assert history.bytes <= 4 * 8 * 3000
    last = history.rows
    assert last.last == 19_999
    assert np.array_equal(last.values[:, 0], np.arange(last.first, 20_000))
    for rows in kept:  # readers keep what they have
        assert np.array_equal(rows.values[:, 0], np.arange(rows.first, rows.last + 1))
    assert len(history.rows.of(19_990, 30_000).values) == 10
    assert len(history.rows.of(25_000, 30_000).values) == 0


def test_history_takes_rows_that_are_written_in_place():
    history, kept = History(2, 10**6), []
    for first, count in ((0, 1), (1, 400), (401, 5000), (300, 7), (307, 20_000)):  # the fourth replaces rows
        room = history.room(count, 2)
        room[:] = np.arange(first, first + count, dtype=np.float64)[:, None]
        history.append(room, first)
        kept.append((history.rows, history.rows.values))
        assert history.rows.last == first + count - 1
        assert np.array_equal(history.rows.values[:, 1], np.arange(history.rows.first, history.rows.last + 1))
        assert history.rows.newest[0] == history.rows.last
    for rows, values in kept:  # readers keep what they have
        assert np.array_equal(rows.values, values)
    part = history.rows.of(20_000, 20_010, [1])
    assert part.values.tolist() == [[float(k)] for k in range(20_000, 20_011)]


@pytest.mark.slow
def test_all_branches_together_stay_within_the_memory():
    with Desk("cruise_control", beside=(), memory=4_000_000) as desk:
        desk.advance_to(10_000)
        for number in range(5):
            desk.go_back(9_000)
            desk.act("goal", "0", value=20.0 + number)
            desk.advance_to(10_000)
            lanes = [branch.lanes[0] for branch in desk.branches.values()]
            assert len(lanes) == number + 2
            assert sum(lane.bytes for lane in lanes) < 4_100_000
            assert all(lane.bytes > 4_000_000 / len(lanes) / 4 for lane in lanes)  # each has its part
        before = desk.branch.lanes[0].rows.newest
        desk.go_back(100)
        desk.choose("branch 2")
        desk.choose("branch 6")
        assert np.array_equal(bits(before), bits(desk.branch.lanes[0].rows.newest))


def test_a_step_whose_row_was_dropped_has_one_again_after_going_back_to_its_state():
    with Desk("cruise_control", beside=(), memory=400_000) as desk:
        lane = desk.branch.lanes[0]
        desk.advance_to(4000)
        expected = lane.rows.newest.copy()
        lane._states.add(lane._session.save_state())
        desk.advance_to(8000)
        assert lane.rows.first > 4000
        desk.go_back(4000)
        assert lane.rows.last == 4000
        assert np.array_equal(bits(lane.rows.newest), bits(expected))


def test_states_of_fmus_count():
    with Desk("cruise_control", beside=()) as desk:
        lane = desk.branch.lanes[0]
        desk.advance_to(1000)
        state = lane._session.save_state()
        assert lane._states.bytes / len(lane._states) == state.memory.nbytes + len(
            pickle.dumps(state.instances["plant"])
        )


def test_long_runs_stay_within_their_memory():
    with Desk("cruise_control", beside=(), memory=2_000_000) as desk:
        desk.advance_to(20_000)
        lane = desk.branch.lanes[0]
        assert lane.rows.first > 0
        assert lane._history.bytes + lane._states.bytes < 2_100_000
        values = lane.rows.values[-1].copy()
        desk.go_back(5_000)  # its rows were dropped
        assert desk.k == 5_000
        desk.advance_to(20_000)
        assert np.array_equal(bits(values), bits(lane.rows.values[-1]))


def test_saved_states_thin_out():
    class State:
        def __init__(self, k):
            self.k, self.memory, self.instances = k, np.zeros(100), {}

    states = SavedStates(10, 800 * 20)
    for k in range(0, 10_000, 10):
        if states.is_due(k):
            states.add(State(k))
        assert len(states) <= 20
    assert states.before(5).k == 0
    assert 0 < states.before(9_999).k <= 9_999
    assert states.interval > 10


def test_written_toml_is_read_the_same():
    content = {
        "a": 1, "b": 0.1 + 0.2, "c": "text \"with\" \\ and \n", "d": [[1.0, 2.0], [3.0]], "e": True, "f": -0.0,
        "g": float("inf"), "simulation": {"x": 1}, "of": {"kind": "K", "n": {"kind": "L", "deep": {"a b": [1]}}},
        "list": [{"kind": "F", "start": {"signal": "a.b", "value": 1e-300}}, {"kind": "G"}], "empty": [], "none": {},
        "mixed": {"list": [{"a": [{"b": 1}]}], "x": 5},
    }  # fmt: skip
    assert tomllib.loads(toml(content)) == content
    with pytest.raises(BayesFTCError, match="cannot be written"):
        toml({"a": None})
