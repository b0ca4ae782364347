"""Where the model is not exact, a slow drift of the most accurate sensor may be believed against two others: a run says so."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim

STD = [0.005, 0.002, 0.02, 0.0035, 0.0035]
"""Three sensors of a cart's position in m, two of its load's angle in rad."""


def crane(rope=1.5):
    """An overhead crane: a cart with a load on a rope of 1.5 m, or of another length."""

    def move(t, x, u, params):
        _, v, angle, rate = x
        s, c = np.sin(angle), np.cos(angle)
        pull = -9.81 * s - 0.05 / rope * rate
        a = (u[0] - 0.5 * v - 2.0 * c * pull + 2.0 * rope * rate**2 * s) / (7.0 - 2.0 * c**2)
        return [v, a, rate, (pull - a * c) / rope]

    def see(t, x, u, params):
        return [x[0], x[2], x[0] + rope * np.sin(x[2])]

    states, outputs = ["x", "v", "theta", "omega"], ["x", "theta", "load"]
    return control.nlsys(move, see, inputs=["force"], outputs=outputs, states=states)


def with_drift(plant, start):
    """Return a loop with a step of 1 m after 2 s, in which the best of the three sensors begins to drift by 2 cm/s."""
    measured = {"measured": ["x", "theta"]}
    controller = controllers.design(
        crane(), **measured, actuated="force", goal="load", sensors=[3, 2], sensor_std=STD, dt=0.02, acceptable_error=0.3,
        acceptable_control=10.0, u_min=-40.0, u_max=40.0,
    )  # fmt: skip
    return cosim.closed_loop(
        plant, controller, control="force", **measured, sensors=cosim.Sensors([3, 2], STD, every=[1, 1, 5, 1, 1]),
        faults=[cosim.Drift(sensor=1, start=start, slope=0.02)], reference=cosim.Step(time=2.0, after=1.0),
    )  # fmt: skip


def test_the_note_names_the_sensors_that_agree_and_the_one_that_is_believed():
    (note,) = with_drift(crane(), 2.5).simulate(10.0, seed=1).notes
    assert note.startswith("sensors 0 and 2 of x agree but are blamed from t = ")
    assert "and sensor 1, which has a fault, is believed" in note


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "start", "lost"), [("linear", 2.5, 0), ("crane", 2.5, 20), ("crane", 6.0, 0), ("longer", 6.0, 20)]
)
def test_the_table_of_the_page_on_wrong_models(name, start, lost):
    """How many of 20 beliefs are more than 5 cm off."""
    linear = control.linearize(crane(), np.zeros(4), [0.0])
    linear.input_labels, linear.output_labels = crane().input_labels, crane().output_labels
    loop = with_drift({"linear": linear, "crane": crane(), "longer": crane(2.0)}[name], start)
    metric = cosim.LoopFigures(only=["belief.x.during"])
    errors = cosim.Campaign(loop, duration=20.0, seeds=20, metrics=[metric]).run().table["belief.x.during"]
    assert abs((errors > 0.05).sum() - lost) <= 2  # other processors round otherwise
