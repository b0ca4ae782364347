"""Faults on a condition: against a state machine in Python, and against the same faults at times that are known."""

import pickle
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from block_kinds import fault_of
from hypothesis import example, given, settings, strategies as st
from numpy.testing import assert_array_equal

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.blocks.faults.conditions import RELATIONS
from bayesftc.cosim.blocks.faults.kinds import FAULTS
from bayesftc.cosim.errors import AlgebraicLoopError, ModelError, UnknownNameError
from bayesftc.cosim.judging.findings import never_began
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals

DT = 0.02
WHEN = cosim.when("plant.v", ">", 22.0)
OPERATORS = {
    "<": np.less, "<=": np.less_equal, "==": np.equal, "!=": np.not_equal, ">=": np.greater_equal, ">": np.greater,
}  # fmt: skip


def of_each_kind(**common):
    """Return a fault of each kind with the same window."""
    for kind in FAULTS:
        yield fault_of(
            kind,
            **({"mean_time_to_fault": 0.1, "mean_time_to_recovery": 0.1} if kind is FAULTS[-1] else {}),
            **common,
        )


def side_by_side(faults, tables):
    """Return a diagram in which faults modify the same noise, beside tables with a value for each step."""
    diagram = cosim.Diagram(DT)
    noise = diagram.add(cosim.Gaussian(std=1.0), "noise")
    for name, values in tables.items():
        diagram.add(cosim.Table(np.arange(len(values)) / 50, values, interpolate=False), name)
    for fault in faults:
        diagram.connect(noise["y"], diagram.add(replace(fault, channels=1))["u"])
    return diagram


def presence(begins, ends, steps, latching):
    """Return when a fault is present, told as a story: what has to be the case for it to begin, to stay, and to begin again."""
    present, since, rested = [], None, True
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        if since is not None and (end or k - since >= steps or not (latching or begin)):
            since = None
        elif since is None and rested and begin and not end:
            since, rested = k, False
        rested = rested or (since is None and not begin)
        present.append(since is not None)
    return np.array(present)


LEVELS = st.lists(st.sampled_from([0.0, 1.0, 2.0, nan]), min_size=30, max_size=30)


@settings(max_examples=30, deadline=None)
@given(
    levels=st.tuples(LEVELS, LEVELS),
    relations=st.tuples(st.sampled_from(list(RELATIONS)), st.sampled_from([None, *RELATIONS])),
    delayed=st.tuples(st.booleans(), st.booleans()),
    steps=st.sampled_from([1, 3, 7, inf]),
    latching=st.booleans(),
)
@example(([1.0] * 30, [1.0] * 30), ("==", "=="), (False, False), 3, True)
def test_presence(levels, relations, delayed, steps, latching):
    holds = []
    for values, relation, late in zip(levels, relations, delayed, strict=True):
        compared = np.array([nan, *values[:-1]] if late else values)
        holds.append(
            np.zeros(30, bool) if relation is None else ~np.isnan(compared) & OPERATORS[relation](compared, 1.0)
        )
    start = cosim.when("one.y", relations[0], 1.0, delayed=delayed[0])
    stop = inf if relations[1] is None else cosim.when("two.y", relations[1], 1.0, delayed=delayed[1])
    fault = cosim.Bias(magnitude=3.0, start=start, stop=stop, duration=steps * DT, latching=latching, channels=1)
    signals = dict(zip(fault.named_sources, levels, strict=False))
    step = fault.online(DT, compiled=False)
    active = [step(u=[0.0], **{name: values[k] for name, values in signals.items()}).active for k in range(30)]
    assert_array_equal(np.ravel(active), presence(*holds, steps, latching))


def test_every_relation_is_here():
    assert OPERATORS.keys() == RELATIONS.keys()


FIRST, LAST = 20, 45
SIGNAL = np.where(np.arange(81) < FIRST, 1.0, np.where(np.arange(81) < LAST, 3.0, 2.0))
BEGUN, ENDED = cosim.when("signal.y", ">", 2.0), cosim.when("signal.y", "<=", 2.0)
AT_A_TIME = {"start": FIRST * DT, "stop": LAST * DT}
ON_CONDITION = {
    "until another": {"start": BEGUN, "stop": ENDED},
    "for a duration": {"start": BEGUN, "duration": (LAST - FIRST) * DT},
    "while it lasts": {"start": BEGUN, "latching": False},
    "until a time": {"start": BEGUN, "stop": LAST * DT},
    "from a time": {"start": FIRST * DT, "stop": cosim.when("signal.y", "==", 2.0)},
    "from a time for a duration": {"start": FIRST * DT, "duration": (LAST - FIRST) * DT},
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", FAULTS)
def test_each_kind_equals_the_same_at_a_time(kind, run_both, same_bits):
    """To the last bit, in both engines; the names of the faults are the same, so that their random numbers are."""
    (expected,) = (fault for fault in of_each_kind(**AT_A_TIME) if type(fault) is kind)
    reference = run_both(side_by_side([expected], {"signal": SIGNAL}), 80 * DT, seed=4)
    name = expected.default_name
    assert reference[f"{name}.active"].any()
    for window in ON_CONDITION.values():
        fault = replace(expected, **{"stop": inf, **window})
        result = run_both(side_by_side([fault], {"signal": SIGNAL}), 80 * DT, seed=4)
        for port in ("y", "active"):
            same_bits(result[f"{name}.{port}"], reference[f"{name}.{port}"])


@pytest.mark.slow
def test_each_kind_in_campaigns(campaign_as_alone):
    faults = [
        f for w in ({"start": BEGUN, "stop": ENDED}, {"start": BEGUN, "duration": 0.1}) for f in of_each_kind(**w)
    ]
    named = [replace(fault, name=f"fault_{i}") for i, fault in enumerate(faults)]
    diagram = side_by_side(named, {"signal": SIGNAL})
    points = {"fault_0.start.value": [1.5, 2.5], "fault_1.stop": [1.0, cosim.when("noise.y", ">", 1.0)]}
    assert (campaign_as_alone(diagram, 80 * DT, points=points)["status"] == "ok").all()


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(list(of_each_kind())), st.integers(0, 40), st.integers(1, 40))
def test_any_kind_at_any_time(fault, first, length):
    signal = np.zeros(81)
    signal[first : first + length] = 1.0
    conditions = {"start": cosim.when("signal.y", "==", 1.0), "stop": cosim.when("signal.y", "<", 1.0)}
    on_condition, at_a_time = (
        side_by_side([replace(fault, **window)], {"signal": signal}).simulate(80 * DT, seed=2, engine="interpreted")
        for window in (conditions, {"start": first / 50, "stop": (first + length) / 50})
    )
    name = f"{fault.default_name}.y"
    assert on_condition[name].tobytes() == at_a_time[name].tobytes()


# --- In a closed loop ------------------------------------------------------------------------------------------------

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=DT)


def car(**options):
    """The car of the paper; its speed exceeds 22 m/s within the first second."""
    settings = {
        "controller": controllers.BayesianController(MODEL, precision=controllers.GammaPrecision(), initial_mean=20.0),
        "control": "force",
        "measured": "v",
        "sensors": cosim.Sensors(count=2, std=1.0),
        "reference": cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
        **options,
    }
    return cosim.closed_loop(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), **settings)


def test_figures_of_a_run_are_those_of_the_real_times(run_both):
    loop = car(faults=[cosim.Drift(sensor=1, slope=9.0, start=WHEN, duration=0.6)])
    result = run_both(loop, 3.0, seed=1)
    first = int(np.argmax(result["plant.v"] > 22.0))
    assert 0 < first < 100
    assert_array_equal(np.flatnonzero(result["drift_1.active"]), np.arange(first, first + 30))
    known = car(faults=[cosim.Drift(sensor=1, slope=9.0, start=first / 50, stop=(first + 30) / 50)])
    expected = known.simulate(3.0, seed=1)
    assert_array_equal(result["controller.u"], expected["controller.u"])
    assert figures(loop_signals(loop, result)).to_dict() == figures(loop_signals(known, expected)).to_dict()
    assert figures(loop_signals(loop, result)).sensors[1].faults == 1


def test_actuator_faults_and_signals_of_other_faults(run_both):
    loop = car(
        faults=[
            cosim.Freeze(start=WHEN),
            cosim.Bias(sensor=1, magnitude=2.0, start=cosim.when("freeze_0.active", "==", 1.0)),
        ],
        input_faults={"force": cosim.GainFault(factor=0.5, start=cosim.when("controller.u", "<", 0.0), latching=False)},
    )
    result = run_both(loop, 4.0, seed=1, record=["*", "plant.force"])
    assert_array_equal(result["freeze_0.active"], np.logical_or.accumulate(result["plant.v"] > 22.0))
    assert_array_equal(result["bias_1.active"], result["freeze_0.active"])
    sent = result["controller.u"][:, 0]
    assert_array_equal(result["force_gain_fault_0.active"], sent < 0.0)
    assert_array_equal(result["plant.force"], np.where(sent < 0.0, 0.5, 1.0) * sent + 0.0)
    (force,) = loop_signals(loop, result).inputs
    assert_array_equal(force.faulty, sent < 0.0)


def test_an_algebraic_loop_needs_the_step_before(run_both):
    condition = cosim.when("controller.u", ">", 500.0)
    with pytest.raises(AlgebraicLoopError, match=r"A condition of 'freeze_0' can .* when\(\.\.\., delayed=True\)"):
        car(faults=cosim.Freeze(start=condition, latching=False))
    result = run_both(car(faults=cosim.Freeze(start=replace(condition, delayed=True), latching=False)), 2.0, seed=1)
    high = result["controller.u"][:, 0] > 500.0
    assert high.any()
    assert_array_equal(result["freeze_0.active"], [False, *high[:-1]])


def test_inputs_and_local_variables_of_an_fmu(run_both):
    loop = car(
        faults=cosim.Freeze(start=cosim.when("plant.force", ">", 500.0, delayed=True)),
        input_faults={"disturbance": cosim.Bias(magnitude=0.1, start=cosim.when("plant.m", ">", 50.0))},
    )
    result = run_both(loop, 1.0, seed=1, record=["*", "plant.force"])
    high = np.logical_or.accumulate(result["plant.force"] > 500.0)
    assert_array_equal(result["freeze_0.active"], [False, *high[:-1]])
    assert result["disturbance_bias_0.active"].all()


def test_it_may_begin_again_and_be_random(run_both):
    again = car(faults=cosim.Freeze(start=WHEN, stop=cosim.when("plant.v", "<", 20.0)))
    active = run_both(again, 20.0, seed=1)["freeze_0.active"]
    assert (np.diff(active) == 1).sum() > 1
    hazards = {"mean_time_to_fault": 0.2, "mean_time_to_recovery": 0.1}
    result = run_both(car(faults=cosim.RandomFaults(start=WHEN, latching=False, **hazards)), 8.0, seed=1)
    inside = result["plant.v"] > 22.0
    assert not result["random_faults_0.active"][~inside].any()
    assert 0.3 < result["random_faults_0.active"][inside].mean() < 0.9


def test_a_live_run_is_saved_within_a_fault(same_bits):
    loop = car(faults=cosim.Lag(time_constant=0.3, start=WHEN, duration=1.0))
    whole = loop.simulate(3.0, seed=1)
    with loop.start(seed=1) as session:
        session.advance(1.0)
        assert whole["lag_0.active"][50] == 1.0
        state = pickle.loads(pickle.dumps(session.save_state()))
        session.advance(2.0)
        session.restore(state)
        end = session.advance(2.0)
    same_bits(end["controller.u"], whole["controller.u"][-len(end.time) :])


@pytest.mark.parametrize(
    "kind", [cosim.Bias(magnitude=5.0, start="by hand"), cosim.Freeze(start="by hand", duration=0.5)]
)
def test_by_hand_it_is_present_while_its_input_is_set(kind):
    loop, name = car(faults=kind), kind.default_name
    with loop.start(seed=1) as session:
        pieces = [session.advance(0)]
        for present in (0.0, 1.0, 0.0, 1.0):
            session.set(f"{name}.start_signal", present)
            pieces.append(session.advance(1.0))
    active = np.concatenate([piece[f"{name}.active"] for piece in pieces])
    steps = round(min(1.0, kind.duration) / DT)
    expected = [first + k for first in (51, 151) for k in range(steps)]  # a value counts from the next step on
    assert np.flatnonzero(active).tolist() == expected


def test_by_hand_nothing_begins_by_itself(same_bits):
    loop = car(faults=cosim.Freeze(start="by hand"))
    result = loop.simulate(2.0, seed=1)
    assert not result["freeze_0.active"].any()
    assert list(never_began(loop, result)) == [
        "The fault 'freeze_0' did not occur: it begins when its input start_signal is set to 1."
    ]
    early = {"freeze_0.start": 1.0}
    same_bits(
        cosim.varied(loop, early).simulate(2.0)["controller.u"],
        car(faults=cosim.Freeze(start=1.0)).simulate(2.0)["controller.u"],
    )
    with pytest.raises(ModelError, match="is no condition"):
        cosim.when("", ">", 0.5)
    with pytest.raises(ModelError, match="Freeze has stop='by hand'; give start='by hand'"):
        cosim.Freeze(stop="by hand")


def test_a_condition_is_varied(same_bits):
    loop = car(faults=cosim.Freeze(start=1.0))
    for changes in (
        {"freeze_0.start": WHEN},
        {"freeze_0.start": cosim.when("reference.y", ">", 22.0), "freeze_0.duration": 0.5},
        {"freeze_0": cosim.Freeze(start=WHEN, stop=cosim.when("plant.v", "<", 20.0))},
    ):
        fault = changes.get("freeze_0") or cosim.Freeze(**{path[9:]: value for path, value in changes.items()})
        varied = cosim.varied(loop, changes)
        same_bits(varied.simulate(3.0)["controller.u"], car(faults=fault).simulate(3.0)["controller.u"])
        again = cosim.varied(varied, {"freeze_0.start": 1.0, "freeze_0.stop": inf, "freeze_0.duration": inf})
        same_bits(again.simulate(3.0)["controller.u"], loop.simulate(3.0)["controller.u"])
    other = cosim.varied(varied, {"freeze_0.start.signal": "sensors.y[1]", "freeze_0.start.value": 23.0})
    result = other.simulate(3.0)
    assert np.argmax(result["freeze_0.active"]) == np.argmax(result["sensors.y"][:, 1] > 23.0)


def test_a_text_is_a_condition():
    fault = cosim.Freeze(start="plant.v > 22", stop="plant.v <= 20")
    assert fault == cosim.Freeze(start=WHEN, stop=cosim.when("plant.v", "<=", 20.0))
    with pytest.raises(cosim.ModelError, match="Freeze has start='soon'; it must be seconds, a condition"):
        cosim.Freeze(start="soon")


def test_connected_by_hand(run_both):
    diagram = cosim.Diagram(DT)
    ramp, fault = diagram.add(cosim.Ramp(1.0)), diagram.add(cosim.Bias(magnitude=1.0, channels=1, start=WHEN))
    diagram.connect(ramp["y"], fault["u"])
    step = diagram.add(cosim.Step(time=0.1, after=30.0))
    diagram.connect(step["y"], fault["start_signal"])  # takes precedence over the name
    assert np.argmax(run_both(diagram, 0.2)["bias_0.active"]) == 5


def test_in_a_subsystem_blocks_inside_come_first(run_both):
    """The ramp inside has the name of another one outside; the step is outside only."""
    inside = cosim.Diagram(DT)
    ramp = inside.add(cosim.Ramp(10.0), "ramp")
    fault = cosim.Bias(
        magnitude=1.0, channels=1, start=cosim.when("ramp.y", ">=", 1.0), stop=cosim.when("step.y", ">", 0.5)
    )
    inside.connect(ramp["y"], inside.add(fault)["u"])
    outside = cosim.Diagram(DT)
    outside.add(cosim.Ramp(-1.0), "ramp")
    outside.add(cosim.Step(time=0.16, after=1.0), "step")
    outside.add(cosim.Subsystem(inside, inputs={}, outputs={"y": "bias_0.y"}), "part")
    active = run_both(outside, 0.2)["part.bias_0.active"]
    assert_array_equal(np.flatnonzero(active), [5, 6, 7])
    varied = cosim.varied(outside, {"part.bias_0.start.value": 1.4})
    assert_array_equal(np.flatnonzero(run_both(varied, 0.2)["part.bias_0.active"]), [7])
    free = cosim.Subsystem(inside, outputs={"y": "bias_0.y"})  # by default, what is not found inside is an input
    assert [port.name for port in free.inputs] == ["stop_signal"]
    step = free.online()
    values = [step(stop_signal=float(k == 7)).y[0] for k in range(9)]
    assert_array_equal(np.round(values, 9), [0.0, 0.2, 0.4, 0.6, 0.8, 2.0, 2.2, 1.4, 1.6])


def test_python_control_gets_the_same_loop():
    import control

    diagram = cosim.Diagram(DT)  # not built: the signal of the condition is found all the same
    ramp = diagram.add(cosim.Ramp(10.0), "ramp")
    fault = diagram.add(cosim.Bias(magnitude=1.0, channels=1, start=cosim.when("ramp.y", ">=", 1.0), duration=0.04))
    diagram.connect(ramp["y"], fault["u"])
    system = diagram.to_control(outputs=["bias_0.active", "bias_0.y"])
    assert system.ninputs == 0
    times = np.arange(11) * DT
    response = control.input_output_response(system, times, X0=cosim.initial_state(system))
    assert_array_equal(
        response.outputs, [np.r_[np.zeros(5), 1, 1, np.zeros(4)], 10 * times + np.r_[np.zeros(5), 1, 1, np.zeros(4)]]
    )


# --- What is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("v", ">", 1.0), "signal='v'; it must be the name of a signal with its block"),
        ((".v", ">", 1.0), "such as 'plant.v'"),
        ((7, ">", 1.0), "signal=7"),
        (("plant.v", "=>", 1.0), r"relation='=>'; it must be one of < <= == != >= >"),
        (("plant.v", [], 1.0), r"relation=\[\]"),
        (("plant.v", ">", nan), "on plant.v has value=nan; it must be a finite number"),
        (("plant.v", ">", inf), "value=inf"),
        (("plant.v", ">", "22"), "value='22'"),
        (("plant.v => 22",), r"'plant\.v => 22' is no condition; write signal, relation and number"),
        (("plant.v > fast",), "is no condition"),
        (("plant.v > 22 m/s",), "is no condition"),
        (("plant.v", ">"), "'plant.v' is no condition"),
        ((7,), "7 is no condition"),
        (("plant.v > inf",), "value=inf"),
        (("v > 1",), "signal='v'"),
        (("plant.v > 2", ">", 3), "'plant.v > 2' is a whole condition, but there is also relation='>' or value=3"),
        (("plant.v > 2", ">"), "'plant.v > 2' is a whole condition"),
    ],
)
def test_bad_conditions(arguments, sentence):
    with pytest.raises(ModelError, match=sentence):
        cosim.when(*arguments)


@pytest.mark.parametrize("relation", ["<", "<=", "==", "!=", ">=", ">"])
@pytest.mark.parametrize("text", ["plant.y[0,1]{}-2e3", "  plant.y[0,1]  {} -2000 "])
def test_conditions_as_text(relation, text):
    assert cosim.when(text.format(relation)) == cosim.when("plant.y[0,1]", relation, -2000.0)
    assert cosim.when(text.format(relation), delayed=True).delayed


def test_a_fault_that_never_began_is_noted():
    loop = car(faults=[cosim.Freeze(start=cosim.when("plant.v > 500")), cosim.Drift(slope=1.0, start=WHEN)])
    result = loop.simulate(2.0, seed=1, engine="interpreted")
    assert result["drift_0.active"].any()
    assert list(never_began(loop, result)) == [
        "The fault 'freeze_0' did not occur: it begins on the condition plant.v > 500."
    ]


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"start": "plant.v => 22"}, r"start='plant.v => 22'; it must be seconds, a condition"),
        ({"start": WHEN, "stop": 0.0}, "stop=0.0"),
        ({"start": WHEN, "stop": nan}, "stop=nan"),
        ({"start": nan, "stop": WHEN}, "start=nan"),
        ({"duration": 0.0}, "duration=0.0; it must be a positive number"),
        ({"duration": nan}, "duration=nan"),
        ({"duration": "2 s"}, "duration='2 s'"),
        ({"latching": False}, "latching=False and start=0.0; .* only where the start is a condition"),
        ({"latching": 1, "start": WHEN}, "latching=1"),
    ],
)
def test_bad_windows(settings, sentence):
    with pytest.raises(ModelError, match=sentence):
        cosim.Freeze(**settings)
    with pytest.raises(TypeError):
        cosim.when("plant.v", ">", 1.0, late=True)


def test_bad_conditions_of_part_of_a_mixture():
    with pytest.raises(ModelError, match=r"Freeze with its own start=When\("):
        cosim.RandomFaults(kinds=(cosim.Freeze(start=WHEN),))
    with pytest.raises(ModelError, match=r"its own duration=1\.0; give duration to RandomFaults"):
        cosim.RandomFaults(kinds=(cosim.Freeze(duration=1.0),))


@pytest.mark.parametrize(
    ("signal", "sentence"),
    [
        ("plant.w", r"Freeze 'freeze_0' reads the signal 'plant\.w', but .*; known names: .*plant\.v"),
        ("plnt.v", r"'plnt\.v', but .* did you mean 'plant\.v'"),
        ("sensors.y", r"no number of that name; did you mean .*'sensors\.y\[1\]'"),
        ("sensors.y[2]", r"did you mean .*'sensors\.y\[1\]'"),
        ("plant.disturbance", r"but the diagram has no number of that name"),
        ("freeze_0.start_signal", r"no number of that name"),
    ],
)
def test_signals_that_are_not_there(signal, sentence):
    with pytest.raises(UnknownNameError, match=sentence):
        car(faults=cosim.Freeze(start=cosim.when(signal, ">", 1.0)))
