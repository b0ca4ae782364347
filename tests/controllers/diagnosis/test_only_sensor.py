"""A fault of the only sensor of a quantity disturbs every set of sensors, as a wrong model does."""

import re

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.best import best_explanations

MEASURED, STD, NOISE = ["position", "speed"], [0.01, 0.05], 0.05


def wheel(rate=1.0):
    return control.ss([[0, 1], [0, -2 * rate]], [[0], [2 * rate]], np.eye(2), 0, inputs=["u"], outputs=MEASURED)


def designed():
    settings = {"measured": MEASURED, "sensors": [1, 1], "sensor_std": STD, "noise": {"u": NOISE}, "dt": 0.02}
    return controllers.design(wheel(), actuated="u", goal="position", **settings)


def run(plant, faults=(), seed=1):
    """Return a run whose motor has the noise of the model, and its loop."""
    loop = cosim.closed_loop(
        plant,
        designed(),
        control="u",
        measured=MEASURED,
        sensors=cosim.Sensors([1, 1], STD),
        reference=cosim.Sine(amplitude=0.5, period=4.0),
        faults=faults,
        blocks={"noise": cosim.Gaussian(std=NOISE), "moved": cosim.Sum()},
        connections=[(["plant.u", "noise.y"], "moved.u"), ("moved.y", "plant.u")],
    )
    return loop.simulate(12.0, seed=seed), loop


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("fault", "end"),
    [
        (cosim.Bias(sensor=0, start=4.0, stop=7.0, magnitude=0.3), 7.0),
        (cosim.Freeze(sensor=1, start=4.0, stop=8.0), 8.0),
    ],
)
def test_the_fault_of_an_only_sensor_is_named_first_with_its_times(fault, end):
    finding = controllers.diagnose(*run(wheel(), [fault]))
    assert finding.kind == "sensors"
    assert finding.others
    i = fault.sensor
    said = (
        rf"Sensor {i} \({MEASURED[i]}\), the only one of its quantity, is probably faulty from (\S+) s to (\S+) s after"
    )
    times = re.match(said, finding.sentence)
    assert [float(time) for time in times.groups()] == pytest.approx([4.0, end], abs=0.2)
    assert "With all samples, as if no sensor had failed: " in finding.sentence


@pytest.mark.sampled(1)
@pytest.mark.parametrize("rate", [0.8, 1.3])
def test_a_wrong_model_under_which_an_only_sensor_alone_is_blamed_is_found(rate):
    result, loop = run(wheel(rate))
    blamed = (result["controller.fault_probability"] >= 0.5).mean(axis=0)
    assert blamed[0] < 0.01  # below one in a hundred samples it counts as never blamed
    assert blamed[1] > 0.1
    finding = controllers.diagnose(result, loop)
    assert finding.kind == "dynamics"
    assert "faulty" not in finding.sentence


def test_a_load_while_a_sensor_is_left_out_shows_in_the_other_one():
    model, rng = designed().model, np.random.default_rng(3)
    A, B, C = (model.matrix(name) for name in "ABC")
    u, x = np.repeat(rng.choice([-0.5, 0.5], (30, 1)), 20, axis=0), np.zeros((600, model.states))
    for k in range(599):
        load = 0.5 * (200 <= k < 350)
        x[k + 1] = A @ x[k] + B[:, 0] * (u[k, 0] + load + NOISE * rng.standard_normal())
    y = x @ C.T + STD * rng.standard_normal((600, 2))
    y[200:350, 0] = np.nan
    begins = [x.values[0] for x in best_explanations(model, y, u, each=True) if x.kind == "onset"]
    assert begins == [pytest.approx(200 * 0.02, abs=0.1)]
