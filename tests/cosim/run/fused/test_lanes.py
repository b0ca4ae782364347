"""Runs in lock step: the bits of single runs, for every kind of call; and what happens if one fails."""

import platform
import time
from contextlib import closing

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.bench.measures.full_loop import full_diagram
from bayesftc.cosim.ports import Port
from bayesftc.cosim.random import CHUNK
from bayesftc.cosim.run import engines, many
from bayesftc.cosim.run.fused import compiled, lanes as lanes_text
from bayesftc.cosim.run.fused.side_by_side import SideBySide
from bayesftc.cosim.run.general.program import FUNCTION
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.stepping.machine.services import service_at
from bayesftc.cosim.stepping.machine.shipped import MACHINES


def slow_and_fast():
    """Blocks of three rates with noise, and a part that is the same in all runs."""
    diagram = cosim.Diagram("1/30")
    noise = diagram.add(cosim.Gaussian((1.0, 0.5)), "noise")
    total = diagram.add(cosim.Integrator(1.0, size=2), "total", every=3)
    late = diagram.add(cosim.UnitDelay(2, 0.5), "late", every=2)
    goal = diagram.add(cosim.Sine(1.0, period=0.7), "goal")
    gap = diagram.add(cosim.Sum("+-"), "gap")
    diagram.connect(noise["y"], total["u"])
    diagram.connect(total["y"], late["u"])
    diagram.connect(goal["y"], gap["u[0]"])
    diagram.connect(late["y[1]"], gap["u[1]"])
    return diagram


DIAGRAMS = {"the whole loop": full_diagram, "three rates": slow_and_fast}
SEEDS = tuple(range(5, 5 + 3 * compiled.LANES + 2))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", DIAGRAMS)
@pytest.mark.parametrize("decimation", [1, 7])
def test_runs_in_lock_step_have_the_bits_of_single_runs(name, decimation, lanes, campaign_as_alone):
    diagram = DIAGRAMS[name]()
    campaign_as_alone(diagram, 130 * diagram.step, SEEDS, decimation=decimation)
    assert sum(lanes) >= 2 * compiled.LANES


@pytest.mark.sampled(1)
@pytest.mark.parametrize("every", [1, 3])
def test_a_run_that_fails_is_told_as_elsewhere(every, lanes, make_block, campaign_as_alone):
    def leave(u, y):
        y[0] = u[0] if u[0] < 3.0 else 1.0 / (u[0] - u[0])

    diagram = cosim.Diagram("1/50")
    block = make_block(inputs=[Port("u")], outputs=[Port("y")], output=leave, finite=True)
    plant = diagram.add(block, "plant", every=every)
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], plant["u"])
    table = campaign_as_alone(diagram, 60 * every * diagram.step, tuple(range(150)))
    reasons = table["reason"].astype(bool)
    assert 0 < reasons.sum() < len(table)
    assert 0 in lanes
    assert max(lanes) > 0


@pytest.fixture
def pauses(lanes, monkeypatch):
    """Whether there was more to do after each call of the compiled code, where all runs are too long for one call."""
    more = []

    def noted(self, usual=SideBySide.go_on):
        more.append(usual(self))
        return more[-1]

    monkeypatch.setattr(many, "BREATH", 1e-6)
    monkeypatch.setattr(SideBySide, "go_on", noted)
    return more


@pytest.mark.parametrize("name", DIAGRAMS)
def test_long_runs_go_on_after_pauses(name, lanes, pauses, campaign_as_alone):
    diagram = DIAGRAMS[name]()
    campaign_as_alone(diagram, 5 * CHUNK * diagram.step, SEEDS)
    assert sum(lanes) >= 2 * compiled.LANES
    assert sum(pauses) == 5 * -(-sum(lanes) // compiled.LANES)


def long_runs(steps, **settings):
    """Return runs of this many chunks of steps, which record one signal."""
    schedule = slow_and_fast().schedule
    return many.ManyRuns(schedule, select_signals(schedule, ["gap.y"]), steps * CHUNK, **settings)


def test_long_runs_stop_between_pauses(lanes, pauses):
    runs = long_runs(10)
    with closing(runs), pytest.raises(many.StoppedFromOutside):
        for _ in runs.run(range(SEEDS[-1]), lambda: len(pauses) < 5):
            pass
    assert pauses == [True] * 5


@pytest.mark.slow
def test_a_group_that_takes_longer_than_the_limit_is_made_one_by_one(lanes, pauses, monkeypatch):
    slept = []

    def sleep_once():
        if pauses and not slept:
            time.sleep(1.1)
            slept.append(len(pauses))
        return True

    with closing(long_runs(10, time_limit=1.0)) as runs:
        reasons = [reason for block in runs.run(range(40), sleep_once) for reason in block.reasons]
    assert reasons == [""] * 40
    assert slept == [1]
    assert lanes[0] == 0
    assert sum(lanes) > 0


@pytest.fixture
def nothing_kept(monkeypatch, tmp_path):
    """No loop is compiled yet, and the number of steps never makes compiling pay."""
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path))
    monkeypatch.setattr(compiled, "_addresses", {})
    monkeypatch.setattr(compiled, "LOADED", 0)
    monkeypatch.setattr(compiled, "COMPILED", np.inf)


@pytest.mark.parametrize(("seconds", "compiles"), [(0.99 * compiled.SECONDS, False), (compiled.SECONDS, True)])
def test_slow_runs_are_worth_compiling(seconds, compiles, nothing_kept, monkeypatch):
    monkeypatch.setattr(compiled, "load_or_compile", lambda name, compile: 1)
    with slow_and_fast().start() as session:
        assert bool(session._engine.in_lock_step(1e6, seconds)) is compiles


def test_no_runs_wait_for_the_compiler_of_another_thread(nothing_kept):
    """They are made one by one meanwhile."""
    with slow_and_fast().start() as session:
        with compiled._compiling:
            assert session._engine.in_lock_step(1e6, compiled.SECONDS) is None
        assert session._engine.in_lock_step(1e6, compiled.SECONDS)


def test_runs_go_in_lock_step_once_the_compiler_of_another_thread_is_done(nothing_kept, monkeypatch):
    monkeypatch.setattr(compiled, "COMPILED", 0)
    monkeypatch.setattr(engines, "fused", lambda *_: 0)  # the loop of one run would wait for the compiler
    monkeypatch.setattr(many, "BREATH", 1e-6)
    with closing(long_runs(3)) as runs:
        blocks = runs.run(range(60))
        with compiled._compiling:
            alone = [next(blocks) for _ in range(5)]
        later = list(blocks)
    assert [len(block.steps) for block in alone] == [1] * 5
    assert compiled.LANES in {len(block.steps) for block in later}


def test_runs_with_much_to_record_are_made_one_by_one(lanes, monkeypatch, campaign_as_alone):
    monkeypatch.setattr(many, "MOST_BESIDE", 8 * 130)
    campaign_as_alone(slow_and_fast(), "130/30", SEEDS, record=["gap.y"])
    assert not lanes
    monkeypatch.setattr(many, "MOST_BESIDE", 8 * 131)
    campaign_as_alone(slow_and_fast(), "130/30", SEEDS, record=["gap.y"])
    assert lanes


def test_runs_whose_pauses_would_be_far_apart_are_made_one_by_one(lanes, pauses, monkeypatch):
    monkeypatch.setattr(many, "LONGEST", 0.0)
    with closing(long_runs(3)) as runs:
        assert [len(block.steps) for block in runs.run(range(12))] == [1] * 12
    assert not lanes


def test_the_first_run_tells_whether_compiling_pays(nothing_kept, monkeypatch):
    groups = []
    monkeypatch.setattr(
        SideBySide, "begin", lambda self, *a, usual=SideBySide.begin: groups.append(1) or usual(self, *a)
    )
    for at in (compiled, many):
        monkeypatch.setattr(at, "SECONDS", 1e-9)
    with closing(long_runs(3)) as runs:
        assert sum(len(block.steps) for block in runs.run(range(40))) == 40
    assert groups


def test_outputs_last_as_long_as_somebody_reads_them(lanes, make_block, campaign_as_alone):
    """Beyond a chunk of random numbers: one that is rarely written, one that only its own update reads, one that nobody reads."""

    def hold(u, y, unread, k):
        if k % (CHUNK + 7) == 3:
            y[0] = u[0]
        unread[0] = 2.0 * u[0]

    def show(total, shown, doubled):
        shown[0] = total[0]
        doubled[0] = 2.0 * total[0]

    def count(u, doubled, total):
        total[0] = 0.1 * doubled[0] + u[0]

    diagram = cosim.Diagram("1/50")
    noise = diagram.add(cosim.Gaussian(1.0), "noise")
    held = diagram.add(make_block(inputs=[Port("u")], outputs=[Port("y"), Port("unread")], output=hold), "held")
    counted = diagram.add(
        make_block(
            inputs=[Port("u", feedthrough=False)],
            outputs=[Port("shown"), Port("doubled")],
            output=show,
            update=count,
            state={"total": 1.0},
        ),
        "counted",
    )
    both, kept = diagram.add(cosim.Sum("++"), "both"), diagram.add(cosim.Integrator(), "kept")
    diagram.connect(noise["y"], held["u"])
    diagram.connect(noise["y"], counted["u"])
    diagram.connect([held["y"], held["y"]], both["u"])
    diagram.connect(both["y"], kept["u"])
    steps = 2 * CHUNK + 60
    campaign_as_alone(diagram, steps * diagram.step, SEEDS, record=["kept.y", "counted.shown"])
    campaign_as_alone(diagram, steps * diagram.step, SEEDS, record=["kept.y", "noise.y"], decimation=9)
    assert sum(lanes) >= 2 * compiled.LANES


def test_what_cannot_be_put_into_lanes_is_called_run_by_run(lanes, make_block, campaign_as_alone):
    def takes_a_slice(u, y):
        for value in u[:1]:  # C is not written for this
            y[0] = value

    diagram = cosim.Diagram("1/50")
    block = make_block(inputs=[Port("u")], outputs=[Port("y")], output=takes_a_slice)
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], diagram.add(block, "block")["u"])
    campaign_as_alone(diagram, 1, SEEDS)
    assert sum(lanes)


@pytest.mark.parametrize("way", ["SHARES", "nothing"])
def test_instances_that_share_something_are_found_out(way, lanes, lying, campaign_as_alone):
    path, ways = lying("2.0")
    diagram = cosim.Diagram("1/10")
    car = diagram.add(cosim.FMU(path, parameters={"v0": 0.0, "b": ways.get(way, 0.0)}), "car")
    diagram.connect(diagram.add(cosim.Gaussian(100.0), "force")["y"], car["force"])
    campaign_as_alone(diagram, 5, SEEDS)
    assert (len(lanes) == 1) is (way == "SHARES")


def test_what_is_compiled_does_not_depend_on_addresses():
    """Else each process would compile the loop anew."""
    with full_diagram().start() as session:
        schedule, (calls, *others) = session._schedule, session._engine._described()
    moved = calls.copy()
    moved[:, FUNCTION] += (calls[:, FUNCTION] != 0) & ~services_among(calls)  # nothing begins at an odd address
    found = [compiled._described(schedule, (each, *others), compiled.INCLUDED)[0] for each in (calls, moved)]
    assert found[0] == found[1]
    known = ["service_fmi2_get_plain", "service_fmi2_advance_plain"] if platform.machine() in MACHINES else []
    assert [name for name in found[0].services if name] == known


def services_among(calls):
    return np.array([bool(service_at(address)) for address in calls[:, FUNCTION]])


def test_the_name_of_a_loop_on_the_disk_depends_on_how_its_text_is_made(monkeypatch, tmp_path):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path))
    names = []
    monkeypatch.setattr(compiled, "load_or_compile", lambda name, compile: names.append(name))
    with full_diagram().start(record=["plant.v"]) as session:
        for _ in range(3):
            session._engine.in_lock_step(np.inf)
            monkeypatch.setattr(lanes_text._LanesText, "_record_row", lambda self, row: None)
    assert len(set(names)) == 2
