"""A loop that is lost: from when, and what is not said of the samples from there."""

from dataclasses import replace

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.judging.lost import loss_of
from bayesftc.cosim.judging.signals import ControlSignals, LoopSignals, QuantitySignals, SensorSignals

FALLING = control.ss([[4.0]], [[1.0]], [[1.0]], 0, inputs=["force"], outputs=["x"])  # falls without control
TIME = np.arange(0.0, 10.0, 0.1)
GROWN = np.where(TIME < 5.0, 1.0, np.exp(8.0 * (TIME - 5.0)))


def loop(**limits):
    model = controllers.LinearModel.from_control(
        FALLING, dt=0.1, sensors=2, process_covariance=1e-4, sensor_covariance=0.01
    )
    return cosim.closed_loop(
        cosim.StateSpace(FALLING, initial=[0.2]),
        controllers.BayesianController(model, **limits),
        control="force",
        measured="x",
        sensors=cosim.Sensors(2, 0.1),
        reference=0.0,
    )


@pytest.fixture(scope="module")
def overflowed():
    """Return the error of a run to infinity with the right model, of a control that is at its limit."""
    with pytest.raises(cosim.SimulationError) as raised:
        loop(u_min=-0.1, u_max=0.1).simulate(200.0, seed=1)
    return raised.value


def by_hand(values, *, goal=1.0, precision=1e4, sent=None):
    """Return the signals of a loop of one quantity, one sensor and one control between -2 and 2 V."""
    n = len(TIME)
    reference = None if goal is None else np.full(n, goal)
    quantity = QuantitySignals("z", "m", (0,), values, reference, values, goal is not None, True)
    sensor = SensorSignals(0, values, np.zeros(n, bool), np.full(n, precision), None, np.zeros(n))
    controls = () if sent is None else (ControlSignals("u", "V", sent, -2.0, 2.0),)
    return LoopSignals(TIME, (quantity,), (sensor,), {}, controls=controls)


@pytest.mark.parametrize("goal", [0.0, None])
def test_without_the_noise_of_its_sensors_no_loop_is_lost(goal):
    """A constant load moved a loop with a law of its own from 1e-4 to .48: "lost", a thousand times its start away."""
    values = np.where(TIME[3] < TIME, 0.48, 1e-4)
    assert loss_of(by_hand(values, goal=goal, precision=0.0)) is None
    assert loss_of(by_hand(values, goal=goal)) is None


def test_the_rows_before_a_loss_are_not_lost_and_a_piece_after_it_is():
    """With a goal that grows in a run, the smaller one of the rows before gave them another loss, at another time."""
    goal = np.where(GROWN < 3e3, 1.0, 1e3)

    def part(begin, end=None):
        signals = by_hand(GROWN, precision=1e8)
        (quantity,), rows = signals.quantities, slice(begin, end)
        its = replace(quantity, truth=GROWN[rows], reference=goal[rows], belief=GROWN[rows])
        return replace(signals, time=TIME[rows], quantities=(its,))

    found = loss_of(part(0))
    assert found.row == int(np.argmax(GROWN > 1e6 + 1e3))
    assert loss_of(part(0, found.row)) is None
    assert loss_of(part(found.row + 5)).row == 0


@pytest.mark.parametrize(
    ("changes", "bound", "words"),
    [
        ({}, 1e4, "more than 10000 m from its goal"),  # a million standard deviations of 0.01 m
        ({"precision": 1e8}, 1e3, "more than 1000 m from its goal"),  # a thousand times the goal
        ({"goal": None, "precision": 1e16}, 4.5e6, "beyond 4.5e+06 m, where numbers are too coarse for its sensors"),
    ],
)
def test_a_loop_is_lost_from_where_it_stays_beyond_a_plausible_range(changes, bound, words):
    found = loss_of(by_hand(GROWN, **changes))
    assert found.row == int(np.argmax(bound < GROWN))
    assert found.note == f"the loop is lost from t = {TIME[found.row]:g} s: z stays {words}"
    assert found.shown < found.row


@pytest.mark.parametrize(
    "values",
    [
        np.ones(100),
        np.where((TIME > 3.0) & (TIME < 4.0), 1e7, 1.0),  # it comes back
        np.where(TIME < 5.0, 1.0, 900.0),  # far, but a plant may be there
        np.full(100, np.nan),
        1e9 + TIME,  # it starts there
    ],
)
def test_other_loops_are_not(values):
    assert loss_of(by_hand(values)) is None


def test_it_says_since_when_the_control_is_at_its_limit():
    sent = np.where(TIME < 5.45, 0.0, 2.0)
    found = loss_of(by_hand(GROWN, sent=sent))
    assert found.note.endswith("from its goal, control u is at its limit of 2 V from t = 5.5 s")
    assert "too weak" in found.todo
    assert "too weak" not in loss_of(by_hand(GROWN, sent=np.zeros(100))).todo


def test_nothing_else_is_said_of_what_follows(overflowed):
    run = overflowed.result
    stopped, lost, limited = run.notes
    assert (stopped, limited.split(" for ")[0]) == ("stopped early", "control force is at its limit of -0.1")
    assert lost.startswith("the loop is lost from t = 3.4 s: x stays more than ")
    assert lost.endswith(" from its goal, control force is at its limit of -0.1 from t = 0 s")
    sentences = str(run.summary())
    assert sentences.index("The loop is lost from t = 3.4 s") < sentences.index("Root-mean-square errors")
    assert "agree but are blamed" not in sentences
    assert not run.suspicions


def test_the_diagnosis_begins_with_it(overflowed):
    found = controllers.diagnose(overflowed.result, loop(u_min=-0.1, u_max=0.1))
    assert found.kind == "lost"
    assert found.sentence.startswith("The loop is lost from t = 3.4 s")
    assert "do not have enough evidence against the model" in found.sentence
    wrong = loop()  # the control has the other sign in this plant
    run = cosim.closed_loop(
        cosim.StateSpace(control.ss([[4.0]], [[-1.0]], [[1.0]], 0, inputs=["force"], outputs=["x"]), initial=[0.2]),
        wrong["controller"].block,
        control="force",
        measured="x",
        sensors=cosim.Sensors(2, 0.1),
        reference=0.0,
    ).simulate(8.0, seed=1, engine="interpreted")
    found = controllers.diagnose(run, wrong)
    assert found.kind == "sign"
    assert found.sentence.startswith("The loop is lost from t = ")


def test_the_figure_shows_when_and_what_was_before(overflowed, tmp_path):
    figure = overflowed.result.plot()
    for axis in figure.axes:
        assert [line.get_xdata()[0] for line in axis.lines if line.get_color() == "#CC0000"] == pytest.approx([3.4])
    x = figure.axes[0]
    assert "the loop is lost" in x.get_legend_handles_labels()[1]
    assert x.get_ylim()[1] < 2000.0
    assert any(text.get_text() == "cut off: up to 1.3e+308" for text in x.texts)


def test_an_error_says_what_the_loop_did_before(overflowed):
    said = str(overflowed)
    assert said.startswith(f"{overflowed.result.stopped} The loop is lost from t = 3.4 s: ")
    assert said.endswith("Last values, at t = 177.8 s: x 1.298e+308 (goal 0), control force -0.1.")
    assert "kept" not in said
    assert overflowed.__notes__ == ["The signals up to the step before are in the exception's result."]
