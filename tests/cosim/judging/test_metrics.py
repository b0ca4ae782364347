"""The figures of a run: their definitions, on signals made by hand, and what is not defined."""

import re
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from sklearn.metrics import roc_auc_score

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import auc, detection, errors_by_phase, figures, limited, periods, rmse
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.judging.signals import ControlSignals, LoopSignals, SensorSignals
from bayesftc.cosim.ops import sin
from bayesftc.examples.cruise_control.block_diagram import by_hand
from bayesftc.examples.cruise_control.cruise_control import LEARNERS, cruise_control

TIME = np.arange(10) * 0.5
FAULTY = np.array([0, 0, 1, 1, 1, 0, 0, 1, 1, 0], dtype=bool)


def sensor(probability=None, beta=None, faulty=FAULTY):
    as_array = [None if v is None else np.array(v, float) for v in (probability, beta)]
    return SensorSignals(0, None, faulty, np.where(FAULTY, 0.25, 1.0), as_array[1], as_array[0])


def test_periods():
    assert periods(FAULTY) == [(2, 5), (7, 9)]
    assert periods(np.ones(3, bool)) == [(0, 3)]
    assert periods(np.zeros(3, bool)) == []


def test_detection_by_hand():
    #                          v alarm before    v one sample late        v lasts on        v missed
    found = detection(sensor([0, 0.9, 0.1, 0.5, 0.9, 0.6, 0.2, 0.4, 0.4, 0]), TIME)
    assert (found.faults, found.missed, found.delay) == (2, 1, 0.5)
    assert found.false_alarm_rate == pytest.approx(2 / 5)
    assert found.fault_share == 0.5
    assert (found.precision_healthy, found.precision_faulty) == (1.0, 0.25)
    assert found.ranked_by == "fault_probability"


def test_what_is_not_defined_is_nan():
    nothing = detection(sensor([np.nan] * 10, [np.nan] * 10), TIME)
    assert np.isnan([nothing.missed, nothing.delay, nothing.false_alarm_rate, nothing.auc]).all()
    assert nothing.ranked_by is None
    healthy = detection(sensor([0.0] * 10, faulty=np.zeros(10, bool)), TIME)
    assert np.isnan([healthy.missed, healthy.delay, healthy.auc, healthy.precision_faulty]).all()
    assert healthy.false_alarm_rate == 0
    always = detection(sensor([1.0] * 10, faulty=np.ones(10, bool)), TIME)
    assert np.isnan([always.false_alarm_rate, always.auc]).all()
    assert (always.delay, always.missed) == (0, 0)
    assert np.isnan(detection(sensor([1.0] * 10, faulty=None), TIME).fault_share)
    assert np.isnan(rmse([]))
    assert np.isnan(rmse([np.nan, 1.0]))
    assert np.isnan(errors_by_phase(None, FAULTY).overall)


def test_where_there_is_no_probability_an_alarm_is_what_the_controller_says_is_detected():
    detected = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 0], dtype=bool)
    for probability in ([np.nan] * 10, None):
        found = detection(replace(sensor(probability), detected=detected), TIME)
        assert (found.faults, found.missed, found.delay, found.false_alarm_rate) == (2, 1, 0.5, pytest.approx(1 / 5))
    assert detection(replace(sensor([0.0] * 10), detected=detected), TIME).missed == 2


def test_beta_ranks_where_there_is_no_probability():
    beta = np.where(FAULTY, 5.0, 2.0)
    found = detection(sensor([np.nan] * 10, beta), TIME)
    assert (found.auc, found.ranked_by) == (1.0, "beta")


def test_phases():
    error = np.where(FAULTY, 2.0, 1.0)
    found = errors_by_phase(error, FAULTY)
    assert (found.before, found.during, found.after) == (1.0, 2.0, 1.0)
    assert found.overall == pytest.approx(np.sqrt((5 + 5 * 4) / 10))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_error_that_is_not_finite_spoils_its_phase(bad):
    """A run that diverges must not look as good as its first half."""
    error = np.where(FAULTY, 2.0, 1.0)
    error[6] = bad
    found = errors_by_phase(error, FAULTY)
    assert (found.before, found.during) == (1.0, 2.0)
    assert np.isnan([found.after, found.overall]).all()


def test_errors_whose_squares_are_infinite():
    assert rmse([3e200, 4e200]) == pytest.approx(12.5**0.5 * 1e200)
    assert rmse([0.0, 0.0]) == 0.0


@pytest.mark.parametrize("usual", [1, 2, 6])
@pytest.mark.parametrize("late", [0, 1, 3])
def test_the_share_of_missing_samples_is_of_those_that_were_due(usual, late):
    """Of a slow sensor each lost sample counted as a step before its first sample, and as all steps to the next one later."""
    rng, n = np.random.default_rng(usual + late), 600
    due = np.arange(0, n, usual)
    lost = rng.random(len(due)) < 0.03
    lost[:late], lost[late], lost[40:60] = True, False, True
    lost[[39, 60]] = False
    samples = np.full(n, np.nan)
    samples[due[~lost]] = 1.0
    sensor = SensorSignals(0, samples, np.zeros(n, bool), None, None, None)
    assert sensor.missing_share == pytest.approx(lost.mean(), abs=1.01 / len(due))


def test_a_slow_sensor_whose_samples_come_early_or_late_loses_none():
    rng, samples = np.random.default_rng(0), np.full(1000, np.nan)
    samples[(10 * np.arange(100) + rng.integers(-2, 3, 100)).clip(0)] = 1.0
    assert SensorSignals(0, samples, np.zeros(1000, bool), None, None, None).missing_share == 0.0


def test_alarms_between_two_samples_of_a_slow_sensor_count():
    """Three alarms were listed beside a share of 0.00 %: faster sensors had blamed an analyser between two of its samples."""
    samples = np.where(np.arange(60) % 6 == 0, 1.0, np.nan)
    probability = np.where(np.isin(np.arange(60), [8, 9, 10]), 0.9, 0.1)
    slow = detection(SensorSignals(0, samples, np.zeros(60, bool), None, None, probability), np.arange(60.0))
    assert slow.false_alarm_rate == 3 / 60
    assert slow.missing_share == 0.0


def test_missing_samples_are_left_out_of_detection():
    """A dropout, in which beta decays to its prior, is neither missed nor healthier than health."""
    samples = np.array([1, 1, np.nan, np.nan, np.nan, 1, 1, 1, 1, 1])
    probability = np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.1, 0.7, 0.1, 0.9, 0.1])
    precision = np.array([1.0, 1, 9, 9, 9, 1, 1, 0.5, 0.3, 1])
    both = detection(SensorSignals(0, samples, FAULTY, precision, None, probability), TIME)
    assert (both.missing_share, both.faults, both.seen_as_missing, both.missed) == (0.3, 2, 1, 0)
    assert both.delay == 0.5
    assert both.false_alarm_rate == pytest.approx(1 / 5)
    there = ~np.isnan(samples)
    assert both.auc == pytest.approx(roc_auc_score(FAULTY[there], probability[there]))
    assert (both.precision_healthy, both.precision_faulty) == (1.0, 0.4)
    alone = detection(SensorSignals(0, samples, np.isnan(samples), precision, None, probability), TIME)
    assert (alone.faults, alone.seen_as_missing) == (1, 1)
    assert np.isnan([alone.missed, alone.delay, alone.auc, alone.precision_faulty]).all()
    unknown = detection(SensorSignals(0, None, FAULTY, precision, None, probability), TIME)
    assert np.isnan([unknown.missing_share, unknown.seen_as_missing]).all()


def test_a_probability_that_breaks_down_gives_no_figures():
    found = detection(sensor([0, 0, 1, 1, 1, 0, 0, np.nan, np.nan, np.nan]), TIME)
    assert np.isnan([found.missed, found.delay, found.false_alarm_rate, found.auc]).all()


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 4)), min_size=2, max_size=40))
def test_auc_is_that_of_scikit_learn(samples):
    truth, score = (np.array(column) for column in zip(*samples))
    if truth.all() or not truth.any():
        assert np.isnan(auc(truth, score))
    else:
        assert auc(truth, score) == pytest.approx(roc_auc_score(truth, score), abs=1e-12)
        with_missing = np.append(score.astype(float), np.nan)
        assert auc(np.append(truth, True), with_missing) == auc(truth, score)


def test_json_has_no_nan():
    loop = cruise_control(LEARNERS[0])
    plain = figures(loop_signals(loop, loop.simulate(1.0, engine="interpreted"))).to_dict()
    assert plain["sensors"][0]["auc"] is None


def test_roles_do_not_hang_on_names(same_bits):
    """A loop that was put together by hand has the same roles as that of closed_loop."""
    from bayesftc import fmus

    car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})
    loops = by_hand(car), cruise_control(LEARNERS[-1])
    ours, theirs = (loop_signals(loop, loop.simulate(7.0, seed=1)) for loop in loops)
    for a, b in zip(ours.quantities, theirs.quantities, strict=True):
        same_bits(a.truth, b.truth)
        same_bits(a.reference, b.reference)
        same_bits(a.belief, b.belief)
        assert (a.name, a.unit) == (b.name, b.unit) == ("v", "m/s")
    for a, b in zip(ours.sensors, theirs.sensors, strict=True):
        same_bits(a.samples, b.samples)
        np.testing.assert_array_equal(a.faulty, b.faulty)
    assert ours.sensors[0].faulty.sum() == 51
    assert not ours.sensors[1].faulty.any()


def faulty_actuator():
    """Return a loop with a fault of sensor 1, a delay behind it, and a fault of the actuator, put together by hand."""
    from bayesftc import fmus

    example = cruise_control(LEARNERS[0])
    diagram = cosim.Diagram(0.02)
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}))
    sensors = diagram.add(cosim.Sensors(count=2, std=1.0))
    bias = diagram.add(cosim.Bias(sensor=1, magnitude=2.0, start=1.0, channels=2))
    delay = diagram.add(cosim.UnitDelay(initial=20.0, size=2))
    brain = diagram.add(example["controller"].block)
    actuator = diagram.add(cosim.GainFault(sensor=0, factor=0.5, start=0.5, channels=1), name="actuator")
    goal = diagram.add(cosim.Constant(20.0))
    diagram.connect(car["v"], sensors["u"])
    diagram.connect(sensors["y"], bias["u"])
    diagram.connect(bias["y"], delay["u"])
    diagram.connect(delay["y"], brain["y"])
    diagram.connect(goal["y"], brain["goal"])
    diagram.connect(brain["u"], actuator["u"])
    diagram.connect(actuator["y"], car["force"])
    return diagram


def test_a_fault_of_the_actuator_is_no_fault_of_a_sensor():
    loop = faulty_actuator()
    signals = loop_signals(loop, loop.simulate(2.0, engine="interpreted"))
    assert not signals.sensors[0].faulty.any()
    assert signals.sensors[1].faulty.sum() == 51
    assert {name: sensor for name, (sensor, _) in signals.faults.items()} == {"bias_1": 1}


class Summing(cosim.Block):
    """A controller that says with one number for both of its sensors that something is wrong."""

    inputs = (cosim.Port("y", (2,)), cosim.Port("goal"))
    outputs = (cosim.Port("u"), cosim.Port("detected"), cosim.Port("beta", (2,)))

    def define(self, step):
        def output(y, goal, u, detected, beta):
            u[0] = goal[0] - 0.5 * (y[0] + y[1])
            detected[0] = 1.0
            beta[0] = y[0]
            beta[1] = y[1]

        return cosim.Definition(output)


def test_one_number_for_all_sensors_says_nothing_of_each():
    import control

    loop = cosim.closed_loop(
        plant=cosim.StateSpace(control.ss([[0.5]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["v"])),
        controller=Summing(),
        control="u",
        measured="v",
        sensors=cosim.Sensors(count=2, std=0.1),
        reference=1.0,
        dt=0.1,
    )
    result = loop.simulate(1.0, engine="interpreted")
    for i, sensor_ in enumerate(loop_signals(loop, result).sensors):
        assert sensor_.detected is None
        np.testing.assert_array_equal(sensor_.beta, result["controller.beta"][:, i])


def two_outputs(**sensors):
    """Return a plant of two states that are both measured, under a controller with a goal for the first."""
    import control

    from bayesftc import controllers

    system = control.ss(
        [[1, 0.1], [0, 0.9]], [[0.0], [0.1]], np.eye(2), 0, 0.1, inputs=["u"], outputs=["position", "speed"]
    )
    rows = np.asarray(sensors["matrix"]) if "matrix" in sensors else np.eye(2)[[0, 1, 0, 1]]
    model = controllers.LinearModel(system.A, system.B, rows, 1e-4, 0.01, 0.1)
    controller = controllers.BayesianController(
        model, controllers.FixedPrecision(), goal_on=[[1.0, 0.0]], control_covariance=10.0, goal_covariance=0.1
    )
    return cosim.closed_loop(
        plant=cosim.StateSpace(system, initial=[0.0, 1.0]),
        controller=controller,
        control="u",
        measured=["position", "speed"],
        sensors=cosim.Sensors(count=len(rows), std=0.1, signals=2, **sensors),
        faults=[cosim.Bias(sensor=1, magnitude=1.0, start=1.0)],
        reference=1.0,
    )


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
def test_several_quantities():
    loop = two_outputs()
    result = loop.simulate(3.0, engine="interpreted")
    position, speed = loop_signals(loop, result).quantities
    assert (position.name, position.sensors, speed.name, speed.sensors) == ("position", (0, 2), "speed", (1, 3))
    np.testing.assert_array_equal(position.truth, result["plant.position"])
    np.testing.assert_array_equal(position.reference, np.ones(31))
    assert speed.reference is None  # the goal says nothing of it
    np.testing.assert_allclose(speed.belief, result["controller.x_hat"][:, 1])
    found = figures(loop_signals(loop, result))
    assert np.isnan(found.tracking["speed"].overall)
    assert found.belief["speed"].overall > 0


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
def test_a_sensor_of_a_mixture():
    loop = two_outputs(matrix=[[1.0, 0.0], [0.5, 2.0]])
    result = loop.simulate(1.0, engine="interpreted")
    position, mixture = loop_signals(loop, result).quantities
    assert mixture.name == "0.5 position + 2 speed"
    np.testing.assert_allclose(mixture.truth, 0.5 * result["plant.position"] + 2 * result["plant.speed"])
    assert position.name == "position"


def slipping(x, y):
    y[0] = x[1] + 0.1 * sin(x[1])


def seen_in_part_by_functions():
    """Active inference of the same plant; of its speed it knows a function that is not linear."""
    from bayesftc import controllers

    modalities = [
        controllers.Modality("position", matrix=[[1.0, 0.0]], std=0.1),
        controllers.Modality("speed", 1, slipping, std=0.1),
    ]
    law = controllers.ProportionalDerivative(1.0, derivative_gain=0.5)
    controller = controllers.UnbiasedActiveInference(modalities, law, 0.1, 5.0, control="law")
    plant = two_outputs()["plant"].block
    return cosim.closed_loop(
        plant=plant, controller=controller, control="u", measured=["position", "speed"], reference=1.0
    )


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
def test_what_is_measured_by_a_function_has_no_belief_and_what_the_goal_is_for_has_tracking():
    from types import SimpleNamespace

    from bayesftc.cli.commands.loops.run import _notes

    loop = seen_in_part_by_functions()
    result = loop.simulate(2.0, engine="interpreted")
    signals = loop_signals(loop, result)
    position, speed = signals.quantities
    np.testing.assert_array_equal(position.belief, result["controller.x_hat"][:, 0])
    assert (position.has_goal, position.has_belief, speed.has_goal, speed.has_belief) == (True, True, False, False)
    found = figures(signals)
    assert found.tracking["position"].overall == pytest.approx(rmse(result["plant.position"] - 1.0))
    assert np.isnan([found.belief["speed"].overall, found.tracking["speed"].overall]).all()
    notes = " ".join(_notes(SimpleNamespace(controller=loop["controller"].block), signals))
    assert "No tracking error of 'speed': the goal is for 'position'." in notes
    assert "speed has no error of the belief" in notes
    assert "record" not in notes
    assert "position has" not in notes
    assert "error of position" not in notes


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
def test_a_controller_that_says_nothing_of_its_sensors_has_goals_in_order(make_block):
    def act(y, goal, u):
        u[0] = goal[0] - y[0]

    ports = {"inputs": [cosim.Port("y", (1,)), cosim.Port("goal")], "outputs": [cosim.Port("u")]}
    loop = cosim.closed_loop(
        plant=two_outputs()["plant"].block, controller=make_block(output=act, **ports), control="u",
        measured="position", reference=1.0, dt=0.1,
    )  # fmt: skip
    (position,) = loop_signals(loop, loop.simulate(1.0, engine="interpreted")).quantities
    assert (position.has_goal, position.has_belief) == (True, False)
    np.testing.assert_array_equal(position.reference, np.ones(11))


def test_what_is_no_closed_loop():
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Constant(1.0))
    with pytest.raises(ModelError, match="one Sensors block"):
        loop_signals(diagram, diagram.simulate(1.0, engine="interpreted"))


def _with_control(u, rate=None, unit="N", dt=0.1):
    force = ControlSignals("force", unit, np.asarray(u, dtype=float), -1.0, 1.0, rate, dt)
    return LoopSignals(dt * np.arange(len(u)), (), (), {}, controls=(force,))


SWING = [*np.linspace(-1.0, 1.0, 21), *np.ones(10), *np.linspace(1.0, -1.0, 21), *-np.ones(10)] * 3


@pytest.mark.parametrize(
    ("signals", "note", "advice"),
    [
        (_with_control([1.0] * 4 + [0.0] * 6), "force is at its limit of 1 N for 40% of the run, where it cannot", "reach"),
        (_with_control([1.0, 0.0, 0.0, 0.0, 0.0]), None, None),
        (_with_control(SWING), r"swings between its limits, -1 N \(19% of the run\) and 1 N \(19%\)$", "goal_covariance"),
        (_with_control(SWING, 1.0), r"\(19%\), and changes at its limit of 1 N/s for 6\d%$", "goal_covariance"),
        (_with_control(SWING, 1.0, None), r"-1 \(.* and 1 \(.*at its limit of 1 per second for 6\d%$", "goal_covariance"),
        (_with_control([0.5, 0.6] * 20, 1.0), None, None),  # noise, up and down
    ],
)  # fmt: skip
def test_controls_at_their_limits(signals, note, advice):
    found = list(limited(signals))
    assert len(found) == (note is not None)
    assert all(re.search(note, said) and advice in what for said, what in found)


def test_a_loop_that_swings_between_the_limits_of_its_control_says_so():
    plant = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0, inputs=["force"], outputs=["x"])
    controller = controllers.design(
        plant, measured="x", actuated="force", sensors=2, sensor_std=0.01, goal="x", dt=0.1, acceptable_error=0.05,
        acceptable_control=10.0, u_min=-4.0, u_max=4.0, u_rate=1.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        cosim.StateSpace(plant),
        controller,
        control="force",
        measured="x",
        sensors=cosim.Sensors(2, 0.01),
        reference=3.0,
    )
    result = loop.simulate(60.0, seed=1)
    (note,) = [note for note in result.notes if "control" in note]
    assert re.search(r"swings between its limits, -4 \(.*and changes at its limit of 1 per second", note)
    assert any("Give a larger goal_covariance" in sentence for sentence in result.summary().notes)


@pytest.mark.parametrize(("amplitude", "advice"), [(10.0, "Is the goal within its reach?"), (0.0, "too aggressive")])
def test_a_control_that_follows_a_goal_out_of_reach_is_not_called_aggressive(amplitude, advice):
    plant = control.ss([[0.0, 1.0], [0.0, -0.5]], [[0.0], [1.0]], [[1.0, 0.0]], 0, inputs=["u"], outputs=["y"])
    costs = {"acceptable_error": 1e-4, "acceptable_control": 1e4} if not amplitude else {}
    controller = controllers.design(
        plant, measured="y", actuated="u", sensors=2, sensor_std=0.05, dt=0.02, u_min=-1.0, u_max=1.0, **costs
    )
    loop = cosim.closed_loop(
        plant,
        controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(2, 0.05),
        reference=cosim.Sine(amplitude=amplitude, period=8.0),
    )
    (sentence,) = [note for note in loop.simulate(40.0, seed=1).summary().notes if "swings" in note]
    assert advice in sentence


def test_a_control_that_a_frozen_sensor_misleads_is_not_called_aggressive():
    """A Kalman filter believes it; a larger acceptable error made the tracking worse."""
    plant = control.ss([[0.0, 1.0], [0.0, -0.5]], [[0.0], [1.0]], [[1.0, 0.0]], 0, inputs=["u"], outputs=["y"])
    controller = controllers.design(
        plant, measured="y", actuated="u", sensors=2, sensor_std=[0.01, 1.0], dt=0.02, u_min=-1.0, u_max=1.0,
        precision=controllers.FixedPrecision(), acceptable_error=0.01, acceptable_control=10.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, [0.01, 1.0]),
        faults=cosim.Freeze(sensor=0, start=1.0), reference=cosim.Sine(amplitude=2.0, period=8.0),
    )  # fmt: skip
    (sentence,) = [note for note in loop.simulate(60.0, seed=1).summary().notes if "swings" in note]
    assert "the belief is wrong by far more than the controller expects" in sentence
    assert "aggressive" not in sentence
