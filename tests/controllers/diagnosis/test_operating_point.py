"""A goal far from the operating point of the model is named before other reasons why the plant moves differently."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.operating_point import FAR, far_goal, readings_at_rest
from bayesftc.cosim.judging.signals import LoopSignals, QuantitySignals, SensorSignals

TIME = np.arange(5.0)
MOVING = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [2.0]], 1e-4, 0.01, dt=0.1)


def signals(goal, unit="m"):
    sensors = tuple(SensorSignals(i, TIME, None, None, None, None) for i in range(2))
    reference = np.where(TIME > 2.0, goal, 1.0)
    return LoopSignals(TIME, (QuantitySignals("level", unit, (0, 1), None, reference, None, True, True),), sensors, {})


def test_the_readings_at_the_operating_point_are_those_of_the_steady_state():
    model = MOVING.about([4.0], [0.3], [1.5, 5.0])
    assert readings_at_rest(model) == pytest.approx([1.5, 5.0])
    assert readings_at_rest(model.with_delays(2, [0, 3])) == pytest.approx([1.5, 5.0])
    disturbed = MOVING.with_disturbance(1e-3).about([4.0], [0.3], [1.5, 5.0])
    assert readings_at_rest(disturbed) == pytest.approx([1.5, 5.0])


def test_some_models_have_no_readings_at_an_operating_point():
    assert readings_at_rest(MOVING) is None
    assert readings_at_rest(MOVING.about([4.0], [0.3], [1.5, 5.0], following=[5.0])) != pytest.approx([1.5, 5.0])
    vehicle = controllers.LinearModel([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]], np.eye(2), 1e-4, 0.01, dt=0.1)
    place, speed = readings_at_rest(vehicle.about([7.0, 0.0], [0.0], [7.0, 3.0]))
    assert np.isnan(place)  # it rests anywhere
    assert speed == pytest.approx(3.0)
    assert (
        readings_at_rest(vehicle.about([7.0, 2.0], [2.0], [7.0, 2.0], following=[7.2, 2.0])) is None
    )  # it does not rest


def test_only_a_goal_far_from_a_known_operating_point_is_named():
    model = MOVING.about([4.0], [0.3], [1.5, 5.0])
    text = far_goal(model, signals(110.0))
    assert "The goal of level goes to 110 m, but the operating point of the model is 1.5 m" in text
    assert far_goal(model, signals(1.5 + 0.99 * FAR * 1.5)) == ""
    assert far_goal(model, signals(np.nan)) == ""
    assert far_goal(MOVING, signals(110.0)) == ""
    assert (
        far_goal(MOVING.about([0.0], [0.0], [0.1, 0.1]), signals(110.0)) == ""
    )  # the reading is hardly more than noise


@pytest.mark.slow
def test_the_diagnosis_of_a_run_begins_with_a_far_goal():
    """Without the loop, it is not known that the plant is linear."""
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 1e-4, dt=0.5).about(
        [1.0], [1.0], [1.0, 1.0]
    )
    controller = controllers.LQGController(model, goal_on="outputs", initial_mean=(1.0, 1.0))
    plant = cosim.StateSpace(control.ss([[0.9]], [[0.2]], [[1.0]], 0, 0.5), initial=[1.0])

    def findings(goal):
        loop = cosim.closed_loop(
            plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.01),
            reference=cosim.Step(time=5.0, before=1.0, after=goal),
        )  # fmt: skip
        run = loop.simulate(60.0, seed=1)
        return [controllers.diagnose(run, by) for by in (controller, loop)]

    (near, _), (far, known) = findings(1.5), findings(40.0)
    assert near.kind == far.kind == "gain"
    assert near.sentence.startswith("All sensors disagree with the model")
    assert far.sentence.startswith(
        "The goal of y goes to 40, but the operating point of the model is 1, and the model may not"
    )
    assert far.sentence.endswith(known.sentence)
    assert known.sentence.startswith("All sensors disagree with the model")
