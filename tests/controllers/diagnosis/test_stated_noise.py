"""Noise of sensors that the model states far too large, as in degrees for samples in radians."""

import warnings

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.scatter import stated_too_large


@pytest.mark.parametrize("wrong", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_noise_in_another_unit_is_named_before_more_noise_of_the_plant(wrong):
    """Stated 57 times too large, it makes the plant look as if it moved at random."""
    plant = control.ss(
        [[0, 1], [0, -1]], [[0, 0], [1, 1]], np.eye(2), 0, inputs=["u", "gust"], outputs=["angle", "rate"]
    )
    std = np.array([0.02, 0.02, 0.02, 0.02])
    controller = controllers.design(
        plant, dt=0.05, measured=["angle", "rate"], actuated="u", sensors=[2, 2], sensor_std=std * (57.3 if wrong else 1.0),
        goal="angle", noise={"gust": 0.3}, acceptable_error=0.1, acceptable_control=2.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="u", measured=["angle", "rate"], sensors=cosim.Sensors([2, 2], std),
        noise={"gust": cosim.Gaussian(std=0.3)}, reference=cosim.Step(2.0, after=1.0),
    )  # fmt: skip
    finding = controllers.diagnose(loop.simulate(40.0, seed=1), loop)
    if wrong:
        assert finding.sentence.startswith(
            "Unless the errors of sensors 0, 1, 2 and 3 last for many samples, the model"
        )
    else:
        assert finding is None


@pytest.mark.slow
def test_a_plant_in_arcseconds_is_diagnosed_without_a_warning():
    """Candidates that are far off overflow; each warned in a notebook."""
    arcsec, k, c = 206265.0, 15791.0, 40.2
    A = np.array(
        [
            [0, 1, 0, 0, 0],
            [-k / 80, -(c + 20) / 80, k / 80, c / 80, 0],
            [0, 0, 0, 1, 0],
            [k / 320, c / 320, -k / 320, -c / 320, arcsec / 320],
            [0, 0, 0, 0, -0.2],
        ]
    )
    B = np.array([[0, 0], [arcsec / 80, 0], [0, 0], [0, 0], [0, 0.2]])
    C = np.array([[0, 0, 1, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 1, 0.0]])
    outputs = ["angle", "motor_rate", "axis_rate"]
    plant = control.ss(A, B, C, 0, inputs=["torque", "gust"], outputs=outputs)
    std = [2.0, 5.0, 0.3, 1.0, 3.0]
    controller = controllers.design(
        plant, dt=0.02, measured=outputs, actuated="torque", sensors=[3, 1, 1], sensor_std=std, sensor_bias=[0, 0, 0, 0, 5.0],
        goal="angle", noise={"gust": 112.0, "torque": 0.5}, acceptable_error=1.0, acceptable_control=10.0, u_min=-60, u_max=60,
    )  # fmt: skip
    sensors = cosim.Sensors([3, 1, 1], std, bias=[0, 0, 0, 0, 4.0], every=[1, 1, 50, 1, 1])
    loop = cosim.closed_loop(
        plant, controller, control="torque", measured=outputs, sensors=sensors, reference=0.0,
        noise={"gust": cosim.Gaussian(std=112.0)},
    )  # fmt: skip
    run = loop.simulate(60.0, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert controllers.diagnose(run, loop) is None


def test_what_is_no_small_noise():
    """Errors that last, a coarse sensor, one that is frozen, and jumps."""
    rng, steps = np.random.default_rng(0), 2000
    level = np.cumsum(0.01 * rng.standard_normal(steps))
    noise = 0.1 * rng.standard_normal((steps, 2))
    healthy = level[:, None] + noise
    both = [(0, 1)]
    assert (
        "sensors 0 and 1 last for many samples, the model states them at least 10 times too large"
        in stated_too_large(healthy, np.ones(2), both)
    )
    assert "Unless the errors of sensor 1 last" in stated_too_large(healthy, np.array([0.1, 1.0]), [(0,), (1,)])
    assert stated_too_large(healthy, np.full(2, 0.25), both) == ""
    lasting = healthy + np.array([1.0, -1.0]) * np.sin(np.arange(steps) / 300.0)[:, None]
    assert stated_too_large(lasting, np.ones(2), both) == ""
    frozen = np.where(np.arange(steps)[:, None] > 50, healthy[50], healthy)
    assert stated_too_large(frozen, np.full(2, 0.25), both) == ""
    coarse = np.round(healthy, 0)
    assert stated_too_large(coarse, np.full(2, 0.3), both) == ""
    jumping = healthy + 20.0 * (rng.random((steps, 2)) < 0.05)
    assert stated_too_large(jumping, np.ones(2), both) == ""
    assert stated_too_large(np.full((steps, 2), np.nan), np.ones(2), both) == ""
