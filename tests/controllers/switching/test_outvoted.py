"""Where the model is not exact, a slow drift of the most accurate sensor may be believed against two others: a run says so."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim

STD = [0.005, 0.002, 0.02, 0.0035, 0.0035]
"""Three sensors of a cart's position in m, two of its load's angle in rad."""


def crane():
    """An overhead crane: a cart with a load on a rope of 1.5 m."""

    def move(t, x, u, params):
        _, v, angle, rate = x
        s, c = np.sin(angle), np.cos(angle)
        pull = -9.81 * s - 0.1 / 3.0 * rate
        a = (u[0] - 0.5 * v - 2.0 * c * pull + 3.0 * rate**2 * s) / (7.0 - 2.0 * c**2)
        return [v, a, rate, (pull - a * c) / 1.5]

    def see(t, x, u, params):
        return [x[0], x[2], x[0] + 1.5 * np.sin(x[2])]

    states, outputs = ["x", "v", "theta", "omega"], ["x", "theta", "load"]
    return control.nlsys(move, see, inputs=["force"], outputs=outputs, states=states)


@pytest.fixture(scope="module")
def drift():
    """Return the notes on a run of a step of 1 m, during which the best of the three sensors begins to drift by 2 cm/s."""
    measured = {"measured": ["x", "theta"]}
    controller = controllers.design(
        crane(), **measured, actuated="force", goal="load", sensors=[3, 2], sensor_std=STD, dt=0.02, acceptable_error=0.3,
        acceptable_control=10.0, u_min=-40.0, u_max=40.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        crane(), controller, control="force", **measured, sensors=cosim.Sensors([3, 2], STD, every=[1, 1, 5, 1, 1]),
        faults=[cosim.Drift(sensor=1, start=2.5, slope=0.02)], reference=cosim.Step(time=2.0, after=1.0),
    )  # fmt: skip
    return loop.simulate(10.0, seed=1).notes


def test_the_note_names_the_sensors_that_agree_and_the_one_that_is_believed(drift):
    (note,) = drift
    assert note.startswith("sensors 0 and 2 of x agree but are blamed from t = ")
    assert "and sensor 1 is believed" in note
