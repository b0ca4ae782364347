"""Live runs: pieces add up to one run, and a run that goes back goes on as it did, in either engine."""

import gc
import pickle
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc import cosim, fmus
from bayesftc.cosim import Port
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.run.session import Session

ENGINES = ("compiled", "interpreted")
STEPS = 300  # more than a chunk of random numbers


def loop(dt=0.02):
    """Return a diagram that remembers in every way: two FMUs, a delay, noise, a fault, a table, several rates."""
    diagram = cosim.Diagram(dt)
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 1.0}), "car")
    trailer = diagram.add(cosim.FMU(fmus.path("CruiseControl", fmi="3.0")), "trailer", every=2)
    push = diagram.add(cosim.Gaussian(std=100.0), "push")
    seen = diagram.add(cosim.Sensors(count=2, std=0.5), "seen")
    late = diagram.add(cosim.UnitDelay(2), "late")
    frozen = diagram.add(cosim.Freeze(sensor=0, start=1.0, stop=2.0, channels=2), "frozen")
    diagram.connect(push["y"], car["force"])
    diagram.connect(car["v"], trailer["disturbance"])
    diagram.connect(trailer["v"], seen["u"])
    diagram.connect(seen["y"], frozen["u"])
    diagram.connect(frozen["y"], late["u"])
    return diagram.build()


@pytest.fixture(scope="module")
def diagram():
    return loop()


@pytest.fixture(scope="module")
def whole(diagram):
    return diagram.simulate("6", seed=3)


def joined(pieces, name):
    return np.concatenate([piece[name] for piece in pieces])


@pytest.mark.parametrize("engine", ENGINES)
def test_pieces_add_up_to_one_run(diagram, whole, engine, same_bits):
    with diagram.start(seed=3, engine=engine) as session:
        pieces = [session.advance(n / 50) for n in (0, 1, 6, 0, 93, 200)]
        assert (session.k, session.time, session.engine) == (STEPS, 6.0, engine)
    assert [len(p.time) for p in pieces] == [1, 1, 6, 0, 93, 200]
    for name in whole:
        same_bits(joined(pieces, name), whole[name], name)
    same_bits(np.concatenate([p.time for p in pieces]), whole.time)


@pytest.mark.parametrize("decimation", [3, 7])
def test_pieces_keep_the_rows_of_the_whole_run(diagram, decimation, same_bits, tmp_path):
    one = diagram.simulate(2, decimation=decimation, record=["car.*"])
    with diagram.start(decimation=decimation, record=["car.*"]) as session:
        pieces = [session.advance(n / 50) for n in (1, 1, 5, 13, 80)]
    same_bits(joined(pieces, "car.v"), one["car.v"])
    same_bits(np.concatenate([p.time for p in pieces]), one.time)
    kept = cosim.Result.load(pieces[-1].save(tmp_path / "piece"))
    same_bits(kept.time, pieces[-1].time)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, STEPS), min_size=1, max_size=4), st.integers(0, 40), st.sampled_from(ENGINES))
def test_saving_and_going_back_changes_nothing(diagram, whole, same_bits, saves, astray, engine):
    with diagram.start(seed=3, engine=engine) as session:
        pieces = [session.advance(0)]
        for k in sorted(saves):
            pieces.append(session.advance((k - session.k) / 50))
            state = session.save_state()
            session.advance(astray / 50)
            session.restore(state)
            assert session.k == k
        pieces.append(session.advance((STEPS - session.k) / 50))
    for name in whole:
        same_bits(joined(pieces, name), whole[name], name)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_from_before_the_first_step(diagram, whole, engine, same_bits):
    with diagram.start(seed=3, engine=engine) as session:
        state = session.save_state()
        assert state.k == -1
        session.advance(1)
        session.restore(state)
        again = session.advance(6)
    for name in whole:
        same_bits(again[name], whole[name], name)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_goes_to_another_session_and_through_pickle(diagram, whole, engine, same_bits):
    with diagram.start(seed=3) as session:
        session.advance(2)
        state = session.save_state()
        copy = pickle.loads(pickle.dumps(state))
    for saved in (state, copy):  # the session that saved it is closed
        with loop().start(seed=8, engine=engine) as other:
            other.advance(1)
            other.restore(saved)
            rest = other.advance(4)
            for name in whole:
                same_bits(rest[name], whole[name][101:], name)


@pytest.mark.slow
def test_a_state_goes_to_another_process(tmp_path, same_bits):
    diagram = arm()
    with diagram.start() as session:
        session.advance(0.1)
        state = session.save_state()
        rest = session.advance(0.1)["arm.q1"]
    (tmp_path / "state").write_bytes(pickle.dumps((diagram, state)))
    text = """
import pickle, sys
diagram, state = pickle.load(open(sys.argv[1], "rb"))
diagram.restore(state)
print(diagram.advance(0.1)["arm.q1"].tobytes().hex())
"""
    done = subprocess.run(
        [sys.executable, "-c", text, str(tmp_path / "state")], capture_output=True, text=True, check=True
    )
    same_bits(np.frombuffer(bytes.fromhex(done.stdout.strip())), rest)


def arm():
    diagram = cosim.Diagram(0.01)
    diagram.add(cosim.FMU(fmus.path("TwoLinkArm"), parameters={"q1_0": 0.3}), "arm")
    return diagram


@pytest.mark.parametrize("engine", ENGINES)
def test_reset_begins_anew(diagram, whole, engine, same_bits):
    with diagram.start(seed=3, engine=engine) as session:
        session.advance(1)
        session.reset()
        again = session.advance(6)
        session.reset(seed=4)
        other = session.advance(6)
    for name in whole:
        same_bits(again[name], whole[name], name)
        same_bits(other[name], diagram.simulate(6, seed=4)[name], name)


def test_the_diagram_keeps_a_live_run(same_bits):
    diagram = arm()
    whole = diagram.simulate(0.3)["arm.q1"]
    first = diagram.advance(0.1)["arm.q1"]
    state = diagram.save_state()
    diagram.advance(0.05)
    diagram.restore(state)
    same_bits(np.concatenate([first, diagram.advance(0.2)["arm.q1"]]), whole)
    diagram.reset()
    same_bits(diagram.advance(0.3)["arm.q1"], whole)
    session = diagram.start()  # another one takes its place
    same_bits(diagram.advance(0.1)["arm.q1"], first)
    assert session.time == 0.1
    session.close()
    same_bits(diagram.advance(0.1)["arm.q1"], first)  # after a closed one, a new one


def test_inputs_that_nothing_feeds_are_set_between_steps():
    diagram = cosim.Diagram(1)
    diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 1.0, "b": 0.0}), "car")
    for engine in ENGINES:
        with diagram.start(engine=engine, record=["car.v", "car.force"]) as session:
            v = [session.advance(0)["car.v"][-1]]
            for force in (1.0, 2.0, -4.0):
                session.set("car.force", force)
                v.append(session.advance(1)["car.v"][-1])
            assert v == [0.0, 1.0, 3.0, -1.0]
            assert session.advance(1)["car.v"][-1] == -5.0  # it keeps its value
            session.reset()
            assert session.advance(2)["car.v"].tolist() == [0.0, 0.0, 0.0]
            with pytest.raises(cosim.UnknownNameError, match=r"no unconnected input 'car.farce'; did you mean"):
                session.set("car.farce", 1.0)
            with pytest.raises(cosim.ModelError, match=r"car.force cannot be set to \[1, 2\]; give one number"):
                session.set("car.force", [1, 2])
            with pytest.raises(
                cosim.ModelError, match=r"car.force cannot be set to nan, because inputs of an FMU must be finite"
            ):
                session.set("car.force", np.nan)


def test_ports_and_elements_are_set_by_name_or_as_ports(make_block):
    def hold(u, v, y):
        y[0] = 10.0 * u[0, 1] + v[0]

    inputs = (Port("u", (2, 2), default=0.0), Port("v", default=0.0))
    diagram = cosim.Diagram(1)
    block = diagram.add(make_block(inputs=inputs, outputs=[Port("y")], output=hold), "block")
    diagram.connect(diagram.add(cosim.Constant(1.0), "one")["y"], block["v"])
    diagram.set("block.u[0,1]", 2.0)
    assert diagram.advance(0)["block.y"].tolist() == [21.0]
    diagram.set(block["u"], [[0, 3], [0, 0]])
    assert diagram.advance(1)["block.y"].tolist() == [31.0]
    diagram.set(block["u"][1], 4.0)
    assert diagram.advance(1)["block.y"].tolist() == [41.0]
    diagram.set("block.u", np.nan)  # a missing sample, say: only FMUs must have numbers
    with pytest.raises(cosim.UnknownNameError, match=r"block.v is fed by one.y and cannot be set"):
        diagram.set("block.v", 2.0)
    with pytest.raises(cosim.UnknownNameError, match=r"no unconnected input 'block.u\[2,0\]'"):
        diagram.set("block.u[2,0]", 2.0)


def test_wrong_states_and_closed_sessions_are_refused(diagram):
    with arm().start() as session:
        with pytest.raises(cosim.ModelError, match=r"is not a saved state of this diagram"):
            session.restore(diagram.start().save_state())
        with pytest.raises(cosim.ModelError, match=r"is not a saved state"):
            session.restore("state")
        with pytest.raises(cosim.StepSizeError, match=r"no whole number of steps"):
            session.advance(0.011)
        for limit in (-1, "1", float("nan")):
            with pytest.raises(cosim.ModelError, match=r"time_limit is .*; it must be a number of seconds, or None"):
                session.advance(0.01, time_limit=limit)
    for use in (session.save_state, session.reset, lambda: session.advance(1), lambda: session.time):
        with pytest.raises(cosim.ModelError, match=r"The session is closed; start a new one with diagram.start\(\)"):
            use()


def driven(*, m=100.0, gain=1.0, **settings):
    diagram = cosim.Diagram(0.02)
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": m} if m else {}, **settings), "car")
    push, gained = diagram.add(cosim.Constant(300.0), "push"), diagram.add(cosim.Gain(gain), "gain")
    diagram.connect(push["y"], gained["u"])
    diagram.connect(gained["y"], car["force"])
    return diagram


def test_a_state_of_other_parameters_is_refused():
    """They are part of the state, so those of the diagram that takes it would be without effect."""
    with driven(m=None).start(engine="interpreted") as session:
        session.advance(1)
        state = pickle.loads(pickle.dumps(session.save_state()))
        rest = session.advance(1)["car.v"][-1]
    cases = {
        r"block 'car' has another parameter 'm', 100\.0 and not 50\.0, and parameters are part of a state": {"m": 50.0},
        r"block 'gain' has another parameter 'gain', and parameters are part of a state; restore it in": {"gain": 2.0},
    }
    for sentence, changed in cases.items():
        with driven(**changed).start(engine="interpreted") as session:
            with pytest.raises(cosim.ModelError, match=sentence):
                session.restore(state)
            assert len(session.advance(1).time) == 51  # it was left as it was
    with driven(m=100.0).start(engine="interpreted") as session:  # the FMU's own value
        session.restore(state)
        assert session.advance(1)["car.v"][-1] == rest


@pytest.mark.parametrize("engine", ENGINES)
def test_a_failed_run_goes_back(engine, make_block):
    def growing(x, y):
        y[0] = x[0]
        x[0] = x[0] * 1e100

    block = make_block(outputs=(Port("y"),), finite=True, output=growing, state={"x": 1.0})
    diagram = cosim.Diagram(1)
    diagram.add(block, "grows")
    with diagram.start(engine=engine) as session:
        session.advance(2)
        state = session.save_state()
        with pytest.raises(cosim.SimulationError, match=r"at t = 4 s \(step 4\): grows.y came out infinite") as caught:
            session.advance(10)
        assert caught.value.result["grows.y"].tolist() == [1e300]
        assert caught.value.result.time.tolist() == [3.0]
        with pytest.raises(cosim.ModelError, match=r"in the middle of a step after step 3; call restore"):
            session.advance(1)
        session.restore(state)
        assert session.advance(1)["grows.y"].tolist() == [1e300]
        session.reset()
        assert session.advance(1)["grows.y"].tolist() == [1.0, 1e100]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_an_fmu_that_has_returned_fatal_is_not_called_any_more(fmi, lying):
    path, ways = lying(fmi)
    diagram = cosim.Diagram(0.02)
    diagram.add(cosim.FMU(path, parameters={"b": ways["FATAL"]}), "car")
    with diagram.start(engine="interpreted") as session:
        state = session.save_state()
        with pytest.raises(cosim.SimulationError, match="DoStep returned Fatal"):
            session.advance(1)
        with pytest.raises(cosim.FMUError, match=r"\('car'\) has returned Fatal, .* Start a new run with reset\(\)\.$"):
            session.restore(state)
        session.reset()
        assert session.advance(0.02).time.tolist() == [0.0, 0.02]


def test_a_time_limit_stops_where_it_can_go_on(same_bits):
    diagram = arm()
    whole = diagram.simulate(20)["arm.q1"]
    with diagram.start(engine="compiled") as session:
        with pytest.raises(cosim.SimulationError, match="time limit of 0 s") as caught:
            session.advance(20, time_limit=0)
        rest = session.advance(20 - session.time)
        same_bits(np.concatenate([caught.value.result["arm.q1"], rest["arm.q1"]]), whole)


def test_an_interrupted_session_goes_back(make_block):
    hits = []

    def interrupting(t, y):
        hits.append(1)
        if len(hits) == 5:
            raise KeyboardInterrupt
        y[0] = t

    diagram = cosim.Diagram(1)
    diagram.add(make_block(outputs=(Port("y"),), output=interrupting, compiled=False), "block")
    with diagram.start() as session:
        state = session.save_state()
        with pytest.raises(KeyboardInterrupt):
            session.advance(20)
        with pytest.raises(cosim.ModelError, match="in the middle of a step"):
            session.advance(1)
        session.restore(state)
        assert session.advance(2)["block.y"].tolist() == [0.0, 1.0, 2.0]


def test_nobody_else_uses_a_session_that_runs():
    diagram, said = arm(), []

    def use(*_):
        for way in (lambda: session.advance(1.0), lambda: session.reset(seed=2), session.save_state, session.close):
            with pytest.raises(cosim.ModelError, match=r"The session is running.* wait until advance\(\) returns"):
                way()
        said.append(True)

    with diagram.start(engine="interpreted") as session:
        session.advance(1.0, progress=use)
        assert said
        session.reset()
    with pytest.raises(cosim.ModelError, match="is closed"):
        session.reset(seed=2)


def test_a_live_session_does_not_pickle():
    with (
        arm().start(engine="interpreted") as session,
        pytest.raises(cosim.ModelError, match=r"pickle the diagram and the state from save"),
    ):
        pickle.dumps(session)


def test_a_dropped_session_frees_its_fmus():
    from bayesftc.cosim.fmi.binaries.loading import _loaded

    diagram = arm()
    session = diagram.start()
    library = next(x for x in _loaded.values() if x.description.name == "TwoLinkArm" and x.alive)
    alive = library.alive
    del session, diagram
    gc.collect()
    assert library.alive == alive - 1


# --- real time ----------------------------------------------------------------------------------------------------------------


def test_a_paced_run_takes_its_time():
    diagram = arm()
    diagram.simulate(0.01)
    began = time.perf_counter()
    paced = diagram.simulate(0.4, pace=2.0)
    taken = time.perf_counter() - began
    assert 0.2 <= taken < 2.0
    report = paced.metadata["pace"]
    assert report["pace"] == 2.0
    assert 0 <= report["overruns"] <= 40
    assert "pace" not in diagram.simulate(0.4).metadata


def test_overruns_are_counted_and_measured(make_block):
    def slow(t, y):
        if 2.5 < t * 100 < 3.5:
            time.sleep(0.2)
        y[0] = time.perf_counter()

    diagram = cosim.Diagram(0.01)
    diagram.add(make_block(outputs=(Port("y"),), output=slow, compiled=False), "block")
    result = diagram.simulate(1.0, pace=1.0)
    report, y = result.metadata["pace"], result["block.y"]
    assert 0.18 <= report["worst_overrun"] < 5.0
    assert report["overruns"] >= 15  # the slow step, and those that came too late because of it
    due = y[0] + result.time
    assert (y - due)[1:].min() > -0.005  # never ahead of the clock
    assert np.median(np.abs((y - due)[-20:])) < 0.1  # it has caught up


def test_the_clock_runs_on_between_calls():
    with arm().start() as session:
        began = time.perf_counter()
        for _ in range(10):
            session.advance(0.01, pace=1.0)
            time.sleep(0.008)  # work outside of the loop is part of the period
        assert 0.09 <= time.perf_counter() - began < 0.17


@pytest.mark.parametrize("pace", [0, -1, float("nan"), float("inf"), True, "1"])
def test_a_pace_must_be_positive(pace):
    with pytest.raises(cosim.ModelError, match=r"pace is .*; it must be a positive number"):
        arm().simulate(0.1, pace=pace)


@pytest.mark.parametrize("wrong", [np.zeros((5, 1)), np.zeros((11, 1), dtype=np.float32), np.zeros(11)])
def test_a_wrong_array_for_the_recording_is_refused(wrong):
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Ramp(1.0), "ramp")
    with diagram.start() as session:
        session.record_into(lambda rows, columns: wrong)
        with pytest.raises(ModelError, match="The array for the recording has the shape"):
            session.advance(1.0)


def ramp():
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Ramp(1.0, unit="m"), "ramp")
    return diagram


@pytest.mark.parametrize("engine", ENGINES)
def test_pieces_have_metadata_and_units_of_their_own(engine):
    """They share what does not change; what a user writes into one is not in the next."""
    with ramp().start(seed=3, engine=engine) as session:
        first = session.advance(0.1)
        first.metadata["driver"], first.units["ramp.y"] = "me", "km"
        second = session.advance(0.1)
        assert first.metadata == second.metadata | {"driver": "me"}
        assert "driver" not in second.metadata
        assert (first.units, second.units) == ({"ramp.y": "km"}, {"ramp.y": "m"})
        assert list(second.metadata)[:4] == ["seed", "duration", "step", "engine"]
        again = pickle.loads(pickle.dumps(second))
        assert (again.metadata, again.units, again["ramp.y"].tolist()) == (second.metadata, {"ramp.y": "m"}, [0.2])


@pytest.mark.parametrize("engine", ENGINES)
def test_the_metadata_of_a_piece_follow_its_duration_and_seed(engine):
    with ramp().start(seed=3, engine=engine) as session:
        state = session.save_state()
        durations = [session.advance(duration).metadata["duration"] for duration in (0.1, 0.1, 0.3, "1/10", 0.3, 0)]
        assert durations == [0.1, 0.1, 0.3, 0.1, 0.3, 0.0]
        session.reset(seed=4)
        assert session.advance(0.3).metadata["seed"] == 4
        session.restore(state)
        assert session.advance(0.3).metadata["seed"] == 3
        assert "pace" in session.advance(0.1, pace=1e6).metadata
        assert "pace" not in session.advance(0.1).metadata


def test_an_interrupt_at_any_line_leaves_the_number_of_steps_alone():
    """The steps of the last duration are kept; those of another duration must never stand under it."""
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Ramp(1.0), "ramp")
    with diagram.start(engine="interpreted") as session:
        for line in range(60):
            session.reset()
            session.advance(0.1)
            count = 0

            def interrupt(frame, event, argument, line=line):
                nonlocal count
                if frame.f_code is not Session.advance.__code__:
                    return None
                count += event == "line"
                if event == "line" and count == line:
                    raise KeyboardInterrupt
                return interrupt

            before = sys.gettrace()
            sys.settrace(interrupt)
            try:
                session.advance(0.5)
            except KeyboardInterrupt:
                pass
            finally:
                sys.settrace(before)
            session._is_running = False  # an interrupt in the line that says so leaves it
            session.reset()
            piece = session.advance(0.1)
            assert (len(piece.time), piece.metadata["duration"]) == (2, 0.1)
        assert line > count > 15  # each line was interrupted
