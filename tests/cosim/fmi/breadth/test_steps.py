"""FMUs whose parameters change while they run, with events, early returns and discarded steps."""

import dataclasses
import re

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError, StepSizeError, UnknownNameError
from bayesftc.cosim.fmi.fmu import FMU

ENGINES = ("compiled", "interpreted")
EVENTS = 'hasEventMode="true" mightReturnEarlyFromDoStep="true"'
VARIABLE = 'canHandleVariableCommunicationStepSize="true"'
REALS3 = {"inputs": ["u"], "outputs": ["y", "total"]}


# --- tunable parameters ---------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("major", "flags"), [("2", ""), ("3", ""), ("3", EVENTS)])
def test_tunable_parameters_are_inputs(breadth, alone, run_both, major, flags):
    out, one = {"2": ("x", 1.0), "3": ("y", [1.0, 0.0])}[major]
    block = FMU(breadth(major, flags), tunable=["k"], parameters={"k": 2.0, "u": one}, inputs=["u"], outputs=[out])
    assert [p.name for p in block.inputs] == ["u", "k"]
    assert block.port("k").default == 2.0
    assert dataclasses.replace(block, name="other").inputs == block.inputs
    held = run_both(alone(block, 0.125), 1)["b." + out]
    changed = run_both(alone(block, 0.125, ("k", cosim.Step(time=0.5, before=2.0, after=-4.0))), 1)["b." + out]
    t = np.arange(9) / 8
    np.testing.assert_allclose(held.reshape(9, -1)[:, 0], 2 * t, rtol=1e-12)
    np.testing.assert_allclose(changed.reshape(9, -1)[:, 0], np.where(t <= 0.5, 2 * t, 1 - 4 * (t - 0.5)), atol=1e-12)


def test_what_cannot_be_tuned_is_named(breadth):
    for names, words, error in (
        (["K"], "'K' of the FMU 3.fmu is a fixed parameter; only tunable parameters", FMUError),
        (["u"], "is a continuous input; only tunable", FMUError),
        (["kk"], "has no variable 'kk'; tunable parameters: k.", UnknownNameError),
        ("k", "give a list of names, as ['k']", ModelError),
        (["k", "k"], "a name twice", ModelError),
    ):
        with pytest.raises(error, match=re.escape(words)):
            FMU(breadth("3"), tunable=names)


# --- events and early returns ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", ["1/8", "1/3", "3/4"])
def test_events_are_handled_and_steps_go_on_to_their_end(breadth, alone, run_both, dt):
    import fmpy

    runs, given = {}, {"u": [1.0, 2.0]}
    for flags in ("", 'mightReturnEarlyFromDoStep="true"', EVENTS):
        block = FMU(breadth("3", flags), parameters=given, inputs=["u", "next"], outputs=["y", "count"])
        runs[flags] = run_both(alone(block, dt, ("next", cosim.Step(time=0.75, before=1.0, after=3.0))), 3)
    plain, early, events = runs.values()
    for run in (early, events):
        np.testing.assert_allclose(run["b.y"], plain["b.y"], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(run["b.count"], plain["b.count"])
    assert plain["b.count"].tolist() == np.floor(plain.time / 0.25 + 1e-9).tolist()
    theirs = fmpy.simulate_fmu(
        str(breadth("3", EVENTS)), stop_time=3.0, output_interval=float(events.step), start_values={"u": "1.0 2.0", "next": 1},
        output=["y", "count"], use_event_mode=True, early_return_allowed=True, input=None,
    )  # fmt: skip
    held = run_both(alone(FMU(breadth("3", EVENTS), parameters=given, **REALS3), dt), 3)
    for k, t in enumerate(held.time):  # at an event fmpy has two rows: the later one counts
        rows = np.flatnonzero(np.abs(theirs["time"] - t) < 1e-9)
        np.testing.assert_allclose(theirs["y"][rows[-1]], held["b.y"][k], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_restored_state_gets_its_discrete_inputs_anew(breadth, alone, engine):
    flags = f'{EVENTS} canGetAndSetFMUState="true"'
    block = FMU(breadth("3", flags), parameters={"u": [1.0, 2.0]}, inputs=["u", "next"], outputs=["y", "count"])
    diagram = alone(block, "1/8", ("next", cosim.Step(time=0.5, before=1.0, after=3.0)))
    with diagram.start(engine=engine) as session:
        session.advance(0.25)
        before = session.save_state()
        first = session.advance(1)
        session.restore(before)
        again = session.advance(1)
    np.testing.assert_array_equal(first["b.y"], again["b.y"])
    assert first["b.y"][-1, 0] > 2.0  # the changed input has told


def test_in_a_process_of_its_own_it_gives_the_same_bits(breadth, alone, same_bits):
    runs = []
    for isolate in (False, True):
        block = FMU(
            breadth("3", EVENTS), parameters={"n": 3, "u": [1, 2, 3], "mode": "on"}, tunable=["k"], isolate=isolate
        )
        runs.append(
            alone(block, "1/3", ("k", cosim.Step(time=1, before=1.0, after=2.0))).simulate(3, engine="interpreted")
        )
    for name in runs[0]:
        same_bits(runs[0][name], runs[1][name], name)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("stall", "words"),
    [
        (0.4, "does not continue. Try a smaller step"),
        (0.6, "did not complete the step, or an event, in 10000"),
    ],
)
def test_steps_that_come_nowhere_end_in_a_sentence(breadth, alone, engine, stall, words):
    diagram = alone(FMU(breadth("3", EVENTS), parameters={"stall": stall}, **REALS3), 0.1)
    with pytest.raises(SimulationError, match=words) as caught:
        diagram.simulate(1, engine=engine)
    assert len(caught.value.result.time) == round(stall / 0.1) + 1


# --- discarded steps ------------------------------------------------------------------------------------------------------------


def ramp(alone, path, isolate=False, **parameters):
    block = FMU(path, parameters=parameters, outputs=["x", "steps"], inputs=["u"], isolate=isolate)
    return alone(block, "1/8", ("u", cosim.Constant(1.0)))


@pytest.mark.parametrize("reach", [0.0, 0.5, 0.9])
def test_discarded_steps_go_on_in_parts(breadth, alone, run_both, reach):
    run = run_both(ramp(alone, breadth("2", VARIABLE), most=1 / 100, reach=reach), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)
    assert run["b.steps"][-1] >= 8 * 3
    assert run_both(ramp(alone, breadth("2", VARIABLE), most=1 / 8), 1)["b.steps"][-1] == 8
    held = alone(FMU(breadth("2"), parameters={"u": 3.0}, inputs=[], outputs=["x"]), "1/8")  # an input that is no port
    np.testing.assert_allclose(held.simulate(1, engine="interpreted")["b.x"][-1], 3.0, rtol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_discarded_steps_that_cannot_go_on_end_in_a_sentence(breadth, alone, engine):
    for path, parameters, words in (
        (
            breadth("2"),
            {"most": 0.01},
            "fmi2DoStep returned Discard. It computed the step up to t = 0 s. Try a smaller step",
        ),
        (
            breadth("2", VARIABLE),
            {"most": 1e-9},
            "fmi2DoStep returned Discard. It computed the step up to t = 0 s",
        ),
        (breadth("2", VARIABLE), {"most": 0.01, "lie": -3.0}, "fmi2DoStep returned Discard."),
        (breadth("2", VARIABLE), {"most": 0.01, "lie": float("1e300")}, "fmi2DoStep returned Discard."),
    ):
        with pytest.raises(SimulationError, match=re.escape(words)):
            ramp(alone, path, **parameters).simulate(1, engine=engine)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_may_end_the_run(breadth, alone, isolate, engine):
    """By fmi2Discard with terminated, say: what it has come to is the result, and the session goes on from its beginning only."""
    diagram = ramp(alone, breadth("2", VARIABLE), end=0.3, isolate=isolate)
    with pytest.warns(UserWarning, match=r"The run has ended .* as 'b' requested. The FMU asks to end the simulation"):
        result = diagram.simulate(1, engine=engine)
    assert 0 < len(result.time) < 1 / diagram.step
    assert "requested" in result.stopped
    with diagram.start(engine=engine) as session:
        with pytest.warns(UserWarning, match="has ended"):
            session.advance(1)
        with pytest.raises(ModelError, match="reset"):
            session.advance(1)
        session.reset()
        assert session.advance("1/8").stopped is None


# --- what an FMU cannot do ------------------------------------------------------------------------------------------------------


def test_steps_that_an_fmu_cannot_make_are_refused(breadth, alone):
    fixed = FMU(breadth("3", 'fixedInternalStepSize="0.02"'), **REALS3)
    for dt in (0.02, 0.1, "1/50"):
        alone(fixed, dt).simulate(1)
    for dt in (0.01, 0.03, "1/30"):
        with pytest.raises(StepSizeError, match=r"steps of 0.02 s only .*, but 'b' has steps of .* multiple of 0.02 s"):
            alone(fixed, dt).simulate(1)
    for size in ("x", "NaN", "INF", "-1"):  # what is no size binds nobody
        alone(FMU(breadth("3", f'fixedInternalStepSize="{size}"'), validate=False, **REALS3), 0.1).simulate(1)
