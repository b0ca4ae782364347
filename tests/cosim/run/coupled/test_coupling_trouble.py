"""Iterated coupling off the happy path: missing samples, iterations that diverge, Ctrl-C while a state is saved."""

import os

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.fmi.binaries.codes import EVENTS, GET, SET, STEP
from bayesftc.cosim.fmi.exchange.words import INTERRUPTED
from bayesftc.cosim.isolation import protocol
from bayesftc.cosim.isolation.instance import Isolated
from bayesftc.cosim.ops import isnan, select
from bayesftc.cosim.run.coupled import steps
from bayesftc.examples.coupled_masses.masses import Masses, sprung_mass
from bayesftc.fmus._compiler import why_no_compiler

pytestmark = pytest.mark.skipif(bool(why_no_compiler()), reason=why_no_compiler() or "there is a compiler")

ENGINES = ("compiled", "interpreted")


def held(u, y):
    """Take what was measured, and a guess where nothing was."""
    for i in range(2):
        y[i] = -3.0 * select(isnan(u[i]), 0.2, u[i]) + 1.0


@pytest.mark.parametrize("acceleration", ["anderson", "aitken"])
@pytest.mark.parametrize("order", [("lost", "held"), ("held", "lost")])
def test_a_missing_sample_may_be_among_what_is_guessed(order, acceleration, make_block, run_both):
    """A value that is NaN in the guess and in the result agrees, and the others are solved for beside it."""
    blocks = {
        "lost": cosim.Dropout(sensor=0, start=0.5, stop=1.0, channels=2),
        "held": make_block(inputs=(Port("u", (2,)),), outputs=(Port("y", (2,)),), output=held),
    }
    diagram = cosim.Diagram(0.1)
    nodes = {name: diagram.add(blocks[name], name) for name in order}
    diagram.connect(nodes["held"]["y"], nodes["lost"]["u"])
    diagram.connect(nodes["lost"]["y"], nodes["held"]["u"])
    run = run_both(diagram.build("iterated", tolerance=1e-13, acceleration=acceleration), 2)
    gone = np.isnan(run["lost.y"][:, 0])
    assert gone.tolist() == [0.5 - 1e-9 <= t < 1.0 - 1e-9 for t in run.time]
    np.testing.assert_allclose(run["held.y"][:, 0], np.where(gone, 0.4, 0.25), rtol=1e-10)
    np.testing.assert_allclose(run["held.y"][:, 1], 0.25, rtol=1e-10)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_iteration_that_diverges_says_so(engine):
    """Overflow to infinities and NaNs, which would agree with each other, is never taken for a solution."""
    diagram = cosim.Diagram(0.1)
    one, two = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Sum("+-"), "two")
    gain = diagram.add(cosim.Gain(50.0), "gain")
    diagram.connect([one["y"], gain["y"]], two["u"])
    diagram.connect(two["y"], gain["u"])
    diagram.build("iterated", acceleration=None, iterations=10_000)
    with pytest.raises(
        cosim.SimulationError,
        match=r"of 'two' and 'gain' diverges: gain.y has grown beyond 1e\+100\. Use acceleration='anderson', or a U",
    ):
        diagram.simulate(1, engine=engine)


def isolated_pair(step_error):
    diagram, masses = cosim.Diagram("1/20"), Masses(c=4.0)
    one, two = (
        diagram.add(cosim.FMU(sprung_mass(), parameters={"c": 4.0, "x0": masses.x0[i]}, isolate=isolate), name)
        for i, (name, isolate) in enumerate((("one", False), ("two", True)))
    )
    for here, there in ((one, two), (two, one)):
        for port in "xv":
            diagram.connect(here[port], there[f"{port}_other"])
    return diagram.build("iterated", step_error=step_error)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="isolation needs a POSIX system")
@pytest.mark.parametrize(
    ("engine", "step_error", "what"),
    [
        ("compiled", 1e-4, "restore"),
        *(
            pytest.param(engine, step_error, what, marks=pytest.mark.slow)
            for engine in ENGINES
            for step_error in (None, 1e-4)
            for what in ("save", "restore", "forget")
            if (engine, step_error, what) != ("compiled", 1e-4, "restore")
        ),
    ],
)
def test_ctrl_c_while_a_state_is_saved_or_restored(engine, step_error, what, monkeypatch, same_bits):
    """The answer that nobody has waited for is not taken for that to the next request."""
    usual_reply, usual_ask, asked = Isolated._reply, Isolated._ask, []

    def reply(self, limit):
        if asked == [what] * 7:
            asked.clear()
            raise KeyboardInterrupt
        return usual_reply(self, limit)

    def ask(self, request, *given, **options):
        asked.extend([request] * (request == what))
        return usual_ask(self, request, *given, **options)

    diagram = isolated_pair(step_error)
    with diagram.start(engine=engine) as session:
        state = session.save_state()
        first = session.advance(0.3)["one.x"]
        with monkeypatch.context() as patch:
            patch.setattr(Isolated, "_reply", reply)
            patch.setattr(Isolated, "_ask", ask)
            with pytest.raises(KeyboardInterrupt):
                session.advance(5)
        with pytest.raises(cosim.FMUCrashed, match=r"'two' .* was ended because Ctrl-C interrupted a request"):
            session.restore(state)
        session.reset()
        same_bits(session.advance(0.3)["one.x"], first)


def test_no_status_of_fmi_looks_like_a_crash_or_ctrl_c():
    """An event that an FMU discards was 502, as Ctrl-C in an isolated one."""
    of_fmi = {where + status for where in (GET, SET, STEP, EVENTS) for status in range(6)}
    assert not of_fmi & {protocol.CRASHED, protocol.INTERRUPTED, INTERRUPTED}
    assert (steps.CRASHED, steps.INTERRUPTED, INTERRUPTED) == (
        protocol.CRASHED,
        protocol.INTERRUPTED,
        protocol.INTERRUPTED,
    )
