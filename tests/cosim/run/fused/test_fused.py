"""The loop of a diagram as one function: the bits of the interpreted engine, for every kind of call; and when it is used."""

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.bench.measures.full_loop import RECORD, full_diagram
from bayesftc.cosim.ports import Port
from bayesftc.cosim.run import engines
from bayesftc.cosim.run.fused import compiled
from bayesftc.cosim.stepping.kept import STATISTICS


def slow_and_fast():
    """Blocks of three rates with noise, one of them with its own count of steps."""
    diagram = cosim.Diagram("1/30")
    noise = diagram.add(cosim.Gaussian((1.0, 0.5)), "noise")
    total = diagram.add(cosim.Integrator(1.0, size=2), "total", every=3)
    late = diagram.add(cosim.UnitDelay(2, 0.5), "late", every=2)
    diagram.connect(noise["y"], total["u"])
    diagram.connect(total["y"], late["u"])
    return diagram


def algebraic():
    """A loop without a delay, which a solver computes as a group."""
    diagram = cosim.Diagram(0.1)
    goal, gain = diagram.add(cosim.Sine(1.0, period=0.7), "goal"), diagram.add(cosim.Gain(-0.5), "gain")
    total = diagram.add(cosim.Sum("++"), "sum")
    diagram.connect(goal["y"], total["u[0]"])
    diagram.connect(gain["y"], total["u[1]"])
    diagram.connect(total["y"], gain["u"])
    diagram.build(coupling="iterated")
    return diagram


DIAGRAMS = {"the whole loop": full_diagram, "three rates": slow_and_fast, "an algebraic loop": algebraic}


@pytest.mark.parametrize("name", DIAGRAMS)
@pytest.mark.parametrize("decimation", [1, 7])
def test_the_bits_are_those_of_the_interpreted_engine(name, decimation, as_one, run_both):
    diagram = DIAGRAMS[name]()
    result = run_both(diagram, 200 * diagram.step, seed=2**64 - 1, decimation=decimation)
    assert np.isfinite(result.table).any()


@pytest.mark.parametrize("name", DIAGRAMS)
def test_pieces_and_saved_states_go_on_where_they_were(name, as_one):
    diagram = DIAGRAMS[name]()
    whole = diagram.simulate(150 * diagram.step, seed=5, engine="interpreted").table
    with diagram.start(seed=5) as session:
        pieces = [session.advance(n * diagram.step).table for n in (0, 1, 62, 1, 1)]
        state = session.save_state()
        session.advance(3 * diagram.step)
        session.restore(state)
        pieces.append(session.advance(85 * diagram.step).table)
    assert np.concatenate(pieces).tobytes() == whole.tobytes()


@pytest.mark.parametrize("every", [1, 3])
def test_a_failure_is_told_as_elsewhere(every, as_one, make_block):
    def blow_up(k, y):
        y[0] = 1.0 / (k - 70.0)

    diagram = cosim.Diagram("1/50")
    diagram.add(make_block(outputs=[Port("y")], output=blow_up, finite=True), "plant", every=every)
    told = []
    for engine in ("compiled", "interpreted"):
        with pytest.raises(cosim.SimulationError, match=f"step {70 * every}\\): plant.y came out infinite") as caught:
            diagram.simulate(10, engine=engine)
        told.append((str(caught.value), caught.value.result.table.tobytes()))
    assert told[0] == told[1]


def test_what_numba_has_compiled_is_called_by_its_address(as_one, make_block, run_both):
    def takes_a_slice(u, y):
        for value in u[:1]:  # C is not written for this
            y[0] = value

    diagram = cosim.Diagram("1/50")
    block = make_block(inputs=[Port("u")], outputs=[Port("y")], output=takes_a_slice)
    diagram.connect(diagram.add(cosim.Ramp(2.0), "ramp")["y"], diagram.add(block, "block")["u"])
    result = run_both(diagram, 1.0)
    assert (result["block.y"] == result["ramp.y"]).all()


def test_paced_runs_compile_no_loop(monkeypatch):
    monkeypatch.setattr(compiled, "LOADED", 0)
    monkeypatch.setattr(engines, "fused", lambda *_: pytest.fail("It would make the first steps late."))
    slow_and_fast().simulate(0.1, pace=1000.0)


def test_campaigns_have_the_bits_of_single_runs(as_one, campaign_as_alone):
    campaign_as_alone(full_diagram(), 4.0)


def test_short_runs_compile_nothing():
    diagram = full_diagram()
    diagram.simulate(1.0, record=RECORD)
    before = dict(STATISTICS)
    diagram.simulate(1.0, record=RECORD)
    diagram.simulate((compiled.LOADED - 1) * diagram.step, record=["plant.v"])
    assert before == STATISTICS


def test_other_parameters_compile_nothing(as_one):
    from dataclasses import replace

    from bayesftc.bench._user_loop import Setting

    full_diagram().simulate(1.0, record=RECORD)
    before = STATISTICS["compiled"]
    full_diagram(replace(Setting(), b=3e-4, forgetting=0.9, sensor_std=2.0)).simulate(1.0, seed=7, record=RECORD)
    assert STATISTICS["compiled"] == before
    assert as_one[0] == as_one[1]
