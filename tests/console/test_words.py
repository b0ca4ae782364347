"""The sentences about sensors and actuators agree with what the controller does."""

import re

import pytest

from bayesftc import controllers
from bayesftc.console.desk.desk import Desk
from bayesftc.console.desk.inference import Inference
from bayesftc.console.shown.words import cards
from bayesftc.controllers.registry import LEARNERS
from bayesftc.scenario import find_scenario

SWITCHING = 'kind = "SwitchingPrecision"'


def desk_with(tmp_path, learner):
    """Return a desk of the car whose precision learner has other lines."""
    text = find_scenario("cruise_control").read_text(encoding="utf-8")
    assert text.count(SWITCHING) == 1
    file = tmp_path / "car.toml"
    file.write_text(text.replace(SWITCHING, learner), encoding="utf-8")
    return Desk(file, beside=())


def value(lane, name):
    return lane.rows.newest[lane.place[f"controller.{name}"]]


@pytest.mark.parametrize("kind", [learner.__name__ for learner in LEARNERS])
def test_words_of_a_frozen_sensor_have_its_weight(tmp_path, kind):
    """Sensor 0 is frozen from 6 s to 14 s. Only learners with a probability say that a sensor is faulty or healthy."""
    with desk_with(tmp_path, f'kind = "{kind}"') as desk:
        desk.advance_to(500)
        lane = desk.branch.lanes[0]
        first, second = cards(lane)[:2]
        precisions = [value(lane, f"precision[{i}]") for i in range(2)]
        weight = precisions[0] / sum(precisions)
        if kind == "ExplicitDetection":  # its precision of a detected sensor is low, but not zero
            assert weight > 0.01
            assert first["words"].startswith(f"trusting sensor 0 less (weight {100 * weight:.0f} %) since 7.")
            assert first["words"].endswith(" s: a fault is detected, without a probability")
            assert second["words"].endswith(" %: nothing is detected")
            assert (first["p"], first["state"], second["state"]) == (None, "faulty", "healthy")
        elif lane.scenario.controller.precision.why_no_probability:
            assert (first["state"], second["state"]) == ("unknown", "unknown")
            assert first["words"] == f"using sensor 0, weight {100 * weight:.0f} %: {kind} gives no fault probability"
        elif first["state"] == "healthy":
            assert first["words"] == f"using sensor 0, weight {100 * weight:.0f} %"
        else:
            assert first["state"] == "faulty"
            said = "ignoring sensor 0 " if weight < 0.01 else f"trusting sensor 0 less (weight {100 * weight:.0f} %) "
            assert first["words"].startswith(said)


def test_a_share_of_two_faulty_sensors_says_nothing(tmp_path):
    """Both are frozen. The larger share of two precisions near zero is no trust."""
    with desk_with(tmp_path, SWITCHING) as desk:
        desk.advance_to(450)
        desk.act("fault", "sensors", {"kind": "Freeze", "sensor": 1})
        desk.advance_to(500)
        for i, card in enumerate(cards(desk.branch.lanes[0])[:2]):
            assert card["weight"] is None
            assert card["words"].startswith(f"ignoring sensor {i} since ")


def test_a_sensor_with_an_offset_is_corrected_only_in_the_joint_form(tmp_path):
    """In the joint form the variance of the speed is below that with the other sensor alone; in the other form it is not."""
    bias = {"kind": "Bias", "sensor": 1, "magnitude": 5.0}
    found = {}
    for joint in ("true", "false"):
        with desk_with(tmp_path, f"{SWITCHING}\njoint = {joint}") as desk:
            desk.advance_to(900)
            desk.act("fault", "sensors", bias)
            desk.advance_to(1300)
            lane = desk.branch.lanes[0]
            found[joint] = *(card["words"] for card in cards(lane)[:2]), value(lane, "P[0,0]"), cards(lane)[1]["size"]
    with desk_with(tmp_path, SWITCHING) as desk:
        desk.advance_to(900)
        desk.act("fault", "sensors", {"kind": "Dropout", "sensor": 1})
        desk.advance_to(1300)
        alone = value(desk.branch.lanes[0], "P[0,0]")
    other, words, variance, size = found["true"]
    assert re.match(r"correcting sensor 1 by -(4\.[89]|5)\S* m/s since 18\S* s: offset", words)
    assert other == "using sensor 0"  # its share in the precisions is 1, but the corrected sensor informs, too
    assert variance < 0.97 * alone
    assert 4.7 < float(size.split()[0]) < 5.3
    other, words, variance, size = found["false"]
    assert re.match(r"ignoring sensor 1 since 17\.\d+ s: offset", words)
    assert other == "using sensor 0, weight 100 %"
    assert variance > 0.97 * alone
    assert size.startswith("+")


def test_the_learner_says_which_kinds_are_offsets():
    class Creeping(controllers.Drifting):
        pass

    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=0.1)
    learner = controllers.SwitchingPrecision([controllers.Frozen(), controllers.Offset(), Creeping()])
    assert Inference.of(controllers.StateEstimator(model, learner)).offset_kinds == ("Offset", "Creeping")
    assert Inference.of(controllers.StateEstimator(model, controllers.GammaPrecision())).offset_kinds == ()


@pytest.mark.parametrize(
    ("fault", "mode", "words"),
    [
        ({"kind": "GainFault", "factor": 0.5}, "LostEffect", "compensating the fault of actuator force since"),
        ({"kind": "Stuck", "at": 900.0}, "StuckActuator", "allowing for the fault of actuator force since"),
    ],
)
def test_no_control_compensates_a_stuck_actuator(tmp_path, fault, mode, words):
    modes = f'{SWITCHING}\nactuator_modes = [{{ kind = "{mode}", time_to_fault = 60.0 }}]'
    with desk_with(tmp_path, modes) as desk:
        desk.advance_to(800)
        assert cards(desk.branch.lanes[0])[2]["words"] == "using actuator force"
        desk.act("fault", "force", fault)
        desk.advance_to(1400)
        assert cards(desk.branch.lanes[0])[2]["words"].startswith(words)
