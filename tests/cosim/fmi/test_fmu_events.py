"""Time events and clocks of FMI 3 in co-simulation, with an FMU that refuses every call which the standard forbids.

The FMU is compiled here, from ``events/``; what it gives is compared with closed forms.
"""

import pickle
import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cli.inspection.verdicts import verdicts
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError, StepSizeError
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.running.clocked import ClockedInstance

SOURCE = Path(__file__).parent / "events" / "clocked.c"
ENGINES = ("compiled", "interpreted")

CLOCKS = """
    <Clock name="tick" valueReference="20" causality="input" intervalVariability="constant" intervalDecimal="0.25"/>
    <Float64 name="v" valueReference="21" causality="input" variability="discrete" start="0" clocks="20"/>
    <Float64 name="w" valueReference="22" causality="output" variability="discrete" clocks="20"/>
    <Int32 name="ticks" valueReference="23" causality="output" clocks="20"/>
    <Float64 name="ticked" valueReference="24" causality="output" variability="discrete" clocks="20"/>
    <Clock name="even" valueReference="25" causality="output" intervalVariability="triggered" clocks="20"/>
    <Int32 name="evens" valueReference="26" causality="output" clocks="25"/>
    <Clock name="fixed" valueReference="30" causality="input" intervalVariability="fixed"/>
    <Int32 name="fixed_ticks" valueReference="31" causality="output" clocks="30"/>
    <Float64 name="fixed_time" valueReference="32" causality="output" variability="discrete" clocks="30"/>
    <Clock name="countdown" valueReference="40" causality="input" intervalVariability="countdown"/>
    <Int32 name="countdown_ticks" valueReference="41" causality="output" clocks="40"/>
    <Float64 name="countdown_time" valueReference="42" causality="output" variability="discrete" clocks="40"/>
    <Clock name="changing" valueReference="50" causality="input" intervalVariability="changing"/>
    <Int32 name="changing_ticks" valueReference="51" causality="output" clocks="50"/>
    <Float64 name="changing_time" valueReference="52" causality="output" variability="discrete" clocks="50"/>
    <Clock name="triggered" valueReference="60" causality="input" intervalVariability="triggered"/>
    <Int32 name="on_trigger" valueReference="61" causality="output" clocks="60"/>"""

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Clocked" instantiationToken="{c}">
  <CoSimulation modelIdentifier="Clocked" FLAGS/>
  <LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/></LogCategories>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="u" valueReference="1" causality="input" start="0"/>
    <Float64 name="x" valueReference="2" causality="output"/>
    <Int32 name="level" valueReference="3" causality="output"/>PARAMETERS
    <Int32 name="mode" valueReference="13" causality="input" start="0"/>CLOCKS
  </ModelVariables>
  <ModelStructure>OUTPUTS</ModelStructure>
</fmiModelDescription>"""

STARTS = {
    "first": 0.0, "every": 0.0, "most": 0.0, "early": 1e9, "last": 1e9, "stale": 0.0, "refuse": 0.0, "period": 0.4, "shift": 0.2
}  # fmt: skip
VARIES = 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true" canSerializeFMUState="true"'
EVENTS = f'hasEventMode="true" {VARIES}'


@pytest.fixture(scope="session")
def clocked(tmp_path_factory, c_compiler):
    """Return a function that returns the FMU with some flags and clocks in its description."""
    import fmpy

    folder = tmp_path_factory.mktemp("clocked")
    text = SOURCE.read_text()
    header = (Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h").read_text()
    wanted = set(re.findall(r"\b(fmi3\w+?)TYPE\b", header))
    stubs = " ".join(f"STUB({name})" for name in sorted(wanted) if not re.search(rf"\b{name}\(", text))
    source, library = folder / "clocked.c", folder / "clocked.so"
    source.write_text(text.replace("\nSTUBS\n", f"\n{stubs}\n"))
    subprocess.run([c_compiler, "-O1", "-w", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)

    def make(flags=EVENTS, clocks=""):
        outputs = [2, 3, *map(int, re.findall(r'valueReference="(\d+)" causality="output"', clocks))]
        parameters = "".join(
            f'\n    <Float64 name="{name}" valueReference="{i}" causality="parameter" variability="fixed" start="{start}"/>'
            for i, (name, start) in enumerate(STARTS.items(), 4)
        )
        for word, content in {
            "FLAGS": flags, "CLOCKS": clocks, "PARAMETERS": parameters,
            "OUTPUTS": "".join(f'<Output valueReference="{r}" dependencies=""/>' for r in outputs),
        }.items():  # fmt: skip
            make.text = (DESCRIPTION if word == "FLAGS" else make.text).replace(word, content)
        path = folder / f"{abs(hash(make.text))}.fmu"
        if not path.exists():
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("modelDescription.xml", make.text)
                archive.write(library, f"binaries/{fmpy.platform_tuple}/Clocked{fmpy.sharedLibraryExtension}")
        return path

    return make


def alone(block, dt, **sources):
    diagram = cosim.Diagram(dt=dt)
    node = diagram.add(block, "b")
    for name, source in sources.items():
        diagram.connect(diagram.add(source, f"s_{name}")["y"], node[name])
    return diagram


def integral(t, first, every):
    """Return the integral of the level, which is one more from each event on, for u = 1."""
    events = first + every * np.arange(100)
    return t + np.maximum(t[:, None] - events, 0.0).sum(axis=1)


# --- time events -------------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("dt", "first", "every"),
    [("1/8", 0.3, 0.55), ("1/3", 0.25, 0.25), (0.1, 0.2, 0.1), ("1/3", 2.0, 5.0), (1, 0.01, 0.07)],
)
def test_no_step_goes_across_the_next_time_event(clocked, run_both, dt, first, every):
    run = run_both(alone(FMU(clocked(), parameters={"u": 1.0, "first": first, "every": every}), dt), 3)
    np.testing.assert_allclose(run["b.x"], integral(run.time, first, every), rtol=1e-9, atol=1e-12)
    # An event at t_k has happened before the outputs of t_k are read.
    events = np.floor((run.time - first) / every + 1e-9) + 1
    assert run["b.level"].tolist() == (1 + np.maximum(events, 0)).tolist()


def test_without_event_mode_the_fmu_handles_its_events_itself(clocked, run_both):
    values = {"u": 1.0, "first": 0.3, "every": 0.55}
    runs = [run_both(alone(FMU(clocked(flags), parameters=values), "1/8"), 3) for flags in (EVENTS, VARIES)]
    for name in ("b.x", "b.level"):
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-12)


def test_where_steps_cannot_be_cut_an_event_waits_for_their_end(clocked, run_both):
    path = clocked('hasEventMode="true"')
    run = run_both(alone(FMU(path, parameters={"first": 0.2, "every": 0.1}), 0.1), 1)  # at the ends of steps
    assert run["b.level"][-1] == 10
    with pytest.raises(SimulationError, match="a step across the next time event"):  # this one is strict: FMI lets it
        alone(FMU(path, parameters={"first": 0.25, "every": 0.1}), 0.1).simulate(1, engine="interpreted")
    grid = clocked(f'{EVENTS} fixedInternalStepSize="0.05"')
    run = run_both(alone(FMU(grid, parameters={"u": 1.0, "first": 0.25, "every": 0.15}), 0.2), 1)
    np.testing.assert_allclose(run["b.x"], integral(run.time, 0.25, 0.15), rtol=1e-9)
    with pytest.raises(SimulationError, match="a step across"):
        alone(FMU(grid, parameters={"first": 0.26, "every": 0.15}), 0.2).simulate(1, engine="interpreted")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_restored_state_has_its_next_event_again(clocked, engine):
    diagram = alone(FMU(clocked(), parameters={"u": 1.0, "first": 0.3, "every": 0.55}), "1/8")
    with diagram.start(engine=engine) as session:
        session.advance(0.25)
        before = session.save_state()
        first = session.advance(1)
        session.restore(before)
        again = session.advance(1)
    np.testing.assert_array_equal(first["b.x"], again["b.x"])
    with diagram.start(engine=engine) as session:  # as bytes, in another run
        session.restore(pickle.loads(pickle.dumps(before)))
        np.testing.assert_array_equal(session.advance(1)["b.x"], first["b.x"])


def test_an_event_at_the_communication_point_itself_is_progress(clocked, run_both):
    run = run_both(alone(FMU(clocked(), parameters={"u": 1.0, "early": 0.35}), 0.1), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)


def test_a_next_event_that_is_past_does_not_stop_the_run(clocked, run_both):
    run = run_both(alone(FMU(clocked(), parameters={"u": 1.0, "stale": 1.0}), 0.1), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)


def test_inputs_that_are_no_ports_keep_what_they_were_given(clocked, run_both):
    run = run_both(alone(FMU(clocked(), parameters={"u": 2.0}, inputs=["mode"]), 0.1), 1)
    np.testing.assert_allclose(run["b.x"], 2.0 * run.time, rtol=1e-12)


def test_discrete_inputs_are_compared_before_any_input_is_set(clocked, run_both):
    block = FMU(clocked(), parameters={"first": 0.3, "every": 0.55})
    run = run_both(alone(block, "1/8", u=cosim.Constant(1.0), mode=cosim.Step(time=0.5, before=0.0, after=3.0)), 1)
    np.testing.assert_allclose(run["b.x"], integral(run.time, 0.3, 0.55), rtol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_fmu_that_asks_to_end_is_told_that_it_has_ended(clocked, caplog, engine):
    diagram = alone(FMU(clocked(), parameters={"last": 0.5, "first": 0.1, "every": 0.1}), 0.1)
    with pytest.warns(UserWarning, match=r"The run has ended at t = 0.4 s .*, as 'b' requested") as caught:
        result = diagram.simulate(1, engine=engine)
    assert result.stopped == str(caught[0].message)
    assert len(result.time) == 5
    assert "b: terminated" in caplog.messages


# --- discarded steps and values ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flags", [EVENTS, VARIES])
def test_a_discarded_step_is_tried_in_smaller_parts(clocked, run_both, flags):
    run = run_both(alone(FMU(clocked(flags), parameters={"u": 1.0, "most": 0.03}), 0.1), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("flags", ["", VARIES, EVENTS])
def test_steps_that_are_always_discarded_end_in_a_sentence(clocked, engine, flags):
    diagram = alone(FMU(clocked(flags), parameters={"most": 1e-9}), 0.1)
    words = r"fmi3DoStep returned Discard. It has made no progress. Try a smaller step. It logged nothing."
    with pytest.raises(SimulationError, match=words):
        diagram.simulate(1, engine=engine)
    diagram = alone(FMU(clocked(flags), parameters={"refuse": 0.5}), 0.1, u=cosim.Step(time=0.3, before=0.0, after=1.0))
    with pytest.raises(SimulationError, match=r"fmi3SetFloat64.* returned Discard. It does not accept this value."):
        diagram.simulate(1, engine=engine)


# --- clocks --------------------------------------------------------------------------------------------------------------------


def changing(count):
    return np.cumsum(0.1 * np.arange(1, count + 1))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dt", ["1/8", "1/3", 0.1, 1])
@pytest.mark.parametrize("timing", ["plant", "sampled"])
def test_clocks_tick_when_the_fmu_asks_for_it(clocked, run_both, dt, timing):
    """At t_k with the inputs of t_k: the outputs of a plant show it after its step, as all that its inputs do."""
    block = FMU(clocked(clocks=CLOCKS), timing=timing, parameters={"u": 1.0, "first": 0.3, "every": 0.55})
    assert [p.name for p in block.inputs] == ["u", "mode", "v"]
    assert "on_trigger" not in [p.name for p in block.outputs]
    assert "evens" in [p.name for p in block.outputs]
    run = run_both(alone(block, dt, v=cosim.Ramp(slope=1.0)), 3)
    h = float(run.step)
    until = run.time + h if timing == "sampled" else run.time  # ticks before this have happened
    for name, ticks in {
        "": 0.25 * np.arange(40), "fixed_": 0.2 + 0.4 * np.arange(20), "countdown_": 0.9 + np.arange(9.0),
        "changing_": changing(20),
    }.items():  # fmt: skip
        count = (ticks < until[:, None] - 1e-9).sum(axis=1)
        assert run[f"b.{name}ticks"].tolist() == count.tolist(), name
        last = np.where(count > 0, ticks[np.maximum(count, 1) - 1], 0.0)
        np.testing.assert_allclose(run[f"b.{name}time" if name else "b.ticked"], last, atol=1e-9)
    count = (0.25 * np.arange(40) < until[:, None] - 1e-9).sum(axis=1)
    assert run["b.evens"].tolist() == (count // 2).tolist()
    held = h * np.floor(0.25 * np.arange(40) / h + 1e-9)  # the input at each tick is that of the step it lies in
    np.testing.assert_allclose(run["b.w"], [held[:c].sum() for c in count], atol=1e-9)
    np.testing.assert_allclose(run["b.x"], integral(until if timing == "sampled" else run.time, 0.3, 0.55), rtol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_clocks_go_back_with_a_restored_state(clocked, engine):
    diagram = alone(FMU(clocked(clocks=CLOCKS)), "1/8", v=cosim.Ramp(slope=1.0))
    with diagram.start(engine=engine) as session:
        session.advance(0.875)
        before = session.save_state()
        first = session.advance(1.5)
        session.restore(before)
        again = session.advance(1.5)
    for name in first:
        np.testing.assert_array_equal(first[name], again[name], err_msg=name)


def test_clocks_tick_in_a_process_of_its_own(clocked, same_bits):
    blocks = [FMU(clocked(clocks=CLOCKS), isolate=isolate) for isolate in (False, True)]
    runs = [alone(block, "1/8", v=cosim.Ramp(slope=1.0)).simulate(2) for block in blocks]
    for name in runs[0]:
        same_bits(runs[0][name], runs[1][name], name)


def test_clocks_that_count_in_fractions(clocked, run_both):
    text = CLOCKS.replace(
        'intervalDecimal="0.25"', 'supportsFraction="true" resolution="12" intervalCounter="3" intervalDecimal="0.25"'
    )
    run = run_both(alone(FMU(clocked(clocks=text), outputs=["ticks"]), "1/3"), 3)
    assert run["b.ticks"].tolist() == [(0.25 * np.arange(40) < t - 1e-9).sum() for t in run.time]
    told = CLOCKS.replace('intervalVariability="fixed"', 'intervalVariability="fixed" intervalDecimal="0.5"')
    run = run_both(alone(FMU(clocked(clocks=told), outputs=["fixed_ticks"]), 0.1), 3)
    assert run["b.fixed_ticks"][-1] == 6


def test_clocks_that_nobody_ticks_are_left_alone(clocked, run_both):
    basic = FMU(clocked(VARIES, CLOCKS), parameters={"u": 1.0})  # without event mode its clocks are its own affair
    assert [p.name for p in basic.inputs] == ["u", "mode"]
    np.testing.assert_allclose(run_both(alone(basic, 0.1), 1)["b.x"][-1], 1.0)
    for path in (clocked(VARIES, CLOCKS), clocked(clocks=CLOCKS)):
        with pytest.raises(FMUError, match=r"'on_trigger' .* is clocked, by clocks that do not tick here"):
            FMU(path, outputs=["on_trigger"])
    names = ("even", "evens", "triggered", "on_trigger")
    text = "\n".join(line for line in CLOCKS.splitlines() if any(f'name="{name}"' in line for name in names))
    only = FMU(clocked(clocks=text.replace(' clocks="20"', "")), parameters={"u": 1.0})
    assert [p.name for p in only.outputs] == ["x", "level", "evens"]
    run = run_both(alone(only, 0.1), 1)
    np.testing.assert_allclose(run["b.x"], run.time, rtol=1e-12)
    assert run["b.evens"].tolist() == [0.0] * 11


def test_what_python_raises_in_a_step_passes_compiled_code(clocked, monkeypatch):
    """As Ctrl-C does, which Python notices in the callback."""

    def interrupted(self, ticking):
        if self._inputs[-1] > 0.5:
            raise KeyboardInterrupt
        return tick(self, ticking)

    tick = ClockedInstance._tick
    monkeypatch.setattr(ClockedInstance, "_tick", interrupted)
    diagram = alone(FMU(clocked(clocks=CLOCKS), outputs=["ticks"]), "1/8", v=cosim.Ramp(slope=1.0))
    with diagram.start() as session:
        with pytest.raises(KeyboardInterrupt):
            session.advance(2)
        monkeypatch.undo()
        session.reset()
        assert session.advance(2)["b.ticks"][-1] == 8


@pytest.mark.parametrize("engine", ENGINES)
def test_what_clocks_cannot_do_is_said(clocked, engine):
    fixed = FMU(clocked('hasEventMode="true"', CLOCKS))
    with pytest.raises(
        StepSizeError, match=r"clock 'tick' .* every 0.25 s from 0 s on, within the steps of 'b' \(0.1 s\)"
    ):
        alone(fixed, 0.1).simulate(1, engine=engine)
    periodic = CLOCKS[: CLOCKS.index('    <Clock name="countdown')]
    alone(FMU(clocked('hasEventMode="true"', periodic)), 0.05).simulate(1, engine=engine)
    with pytest.raises(FMUError, match=r"could not be initialized as 'b': its clock 'fixed' has the interval -1.0 s"):
        alone(FMU(clocked(clocks=CLOCKS), parameters={"period": -1.0}), 0.1).simulate(1, engine=engine)
    with pytest.raises(FMUError, match=r"could not be initialized as 'b': fmi3GetClock returned Error"):
        alone(FMU(clocked(clocks=CLOCKS), parameters={"period": 99.0}), 0.1).simulate(1, engine=engine)
    for wrong in ("0", "-1", "x", "NaN"):
        text = CLOCKS.replace('intervalDecimal="0.25"', f'intervalDecimal="{wrong}"')
        with pytest.raises(FMUError, match="the clock 'tick' has an interval or shift that is not valid"):
            FMU(clocked(clocks=text), validate=False)


def test_model_exchange_does_not_let_clocks_stand_still(clocked, tmp_path):
    text = DESCRIPTION.replace("CoSimulation", "ModelExchange").replace("FLAGS", "")
    for word, content in {"PARAMETERS": "", "CLOCKS": CLOCKS, "OUTPUTS": ""}.items():
        text = text.replace(word, content)
    with zipfile.ZipFile(tmp_path / "exchange.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
    with pytest.raises(
        FMUError, match="has the clock 'tick', but clocks tick in co-simulation only, not in model exchange"
    ):
        FMU(tmp_path / "exchange.fmu", validate=False)


def test_names_that_are_none_are_refused_in_a_sentence(clocked):
    for settings, words in (
        ({"name": 3}, "FMU has name=3; it must be a string"),
        ({"tunable": 3}, "FMU has tunable=3; give a list of names"),
        ({"inputs": 3}, "FMU has inputs=3; give a list of names"),
        ({"outputs": [3]}, r"FMU has outputs=\[3\]; give a list of names"),
        ({"timing": []}, r"FMU has timing=\[\]; it must be 'plant', 'direct' or 'sampled'"),
        ({"kind": []}, r"FMU has kind=\[\]; it must be 'co-simulation' or 'model exchange'"),
    ):
        with pytest.raises(ModelError, match=words):
            FMU(clocked(), **settings)
    with pytest.raises(FMUError, match=r"describe has path=3; it must be the path of an .fmu file"):
        describe(3)


def test_inspect_says_which_clocks_tick(clocked):
    def row(*arguments):
        path = clocked(*arguments)
        return {v.what: v for v in verdicts(path, describe(path), validate=True)}

    rows = row(EVENTS, CLOCKS)
    assert rows["clocks"].works == "partly"
    assert rows["clocks"].how == (
        "time ticks tick, fixed, countdown and 1 more, when the FMU requests it; nothing triggers triggered."
    )
    assert rows["outputs"].how == "12 ports; cannot be ports: even, on_trigger."
    rows = row(VARIES, CLOCKS)
    assert rows["clocks"].works == "no"
    assert rows["inputs"].how == "2 ports; cannot be ports: tick, v, fixed and 3 more."
    assert "clocks" not in row()


@pytest.mark.parametrize("clocks", ["", CLOCKS])
def test_iterated_steps_repeat_their_events_and_ticks(clocked, clocks):
    """Two integrators in a loop: the steps are taken back and repeated, and each event is counted once."""
    diagram = cosim.Diagram(dt="1/8")
    values = ({"first": 0.3, "every": 0.55}, {"first": 0.25, "every": 0.5})
    first, second = (
        diagram.add(FMU(clocked(clocks=clocks), parameters=v), name) for v, name in zip(values, "ab", strict=True)
    )
    total = diagram.add(cosim.Sum("+-"), "total")
    diagram.connect(first["x"], second["u"])
    diagram.connect([diagram.add(cosim.Constant(0.5), "half")["y"], second["x"]], total["u"])
    diagram.connect(total["y"], first["u"])
    runs = [diagram.build("iterated").simulate(2, engine=engine) for engine in ENGINES]
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name], err_msg=name)
    assert (runs[0]["a.level"][-1], runs[0]["b.level"][-1]) == (5, 5)
    if clocks:
        assert runs[0]["a.ticks"][-1] == 8


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flags", [EVENTS, 'hasEventMode="true" canHandleVariableCommunicationStepSize="true"'])
@pytest.mark.parametrize("options", [{}, {"timing": "sampled"}, {"isolate": True}], ids=str)
def test_campaigns_begin_with_the_first_event_again(clocked, campaign_as_alone, flags, options):
    block = FMU(clocked(flags, CLOCKS), parameters={"u": 1.0, "first": 0.3, "every": 0.55}, **options)
    table = campaign_as_alone(alone(block, "1/8", v=cosim.Gaussian(std=1.0)), 2.0)
    assert (table["status"] == "ok").all()
