"""A process that is quieter than its model: no healthy sensor is blamed, and faults are still found."""

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus

STEP = 0.05


def probabilities(sensors, stated, true, *, fault=None, seeds=(0, 1), count=1200):
    """Return the fault probabilities (samples of all seeds x sensors) of sensors with noise 1 and a process in its units."""
    model = controllers.LinearModel([[0.98]], [[1.0]], [[1.0]] * sensors, stated**2, 1.0, dt=STEP)
    estimator = controllers.StateEstimator(model, initial_covariance=stated**2 + 1.0)
    said = []
    for seed in seeds:
        rng, x, step = np.random.default_rng(seed), 0.0, estimator.online()
        for k in range(count):
            y = x + rng.normal(size=sensors)
            if fault is not None:
                y[0] = fault(k, y[0], rng)
            said.append(step(y=y, u=[0.0]).fault_probability)
            x = 0.98 * x + true * rng.normal()
    return np.array(said)


@pytest.mark.parametrize("true", [0.0, 0.1, 0.3])
@pytest.mark.parametrize(("sensors", "stated"), [(1, 1.0), (2, 3.0), (2, 30.0), (3, 1.0)])
def test_no_healthy_sensor_is_blamed_where_the_process_noise_is_stated_too_large(sensors, stated, true):
    """One seemed unmodelled for up to all of the time: it followed less than the belief, which followed the others' noise."""
    assert (probabilities(sensors, stated, true * stated) > 0.5).mean() < 0.02


def test_a_stated_process_is_judged_as_before():
    assert (probabilities(2, 3.0, 3.0) > 0.5).mean() < 0.001


@pytest.mark.parametrize("wrong", [lambda k, y, rng: y + 8.0 * np.sin(0.4 * k), lambda k, y, rng: 12.0 * rng.normal()])
def test_a_fault_of_large_errors_is_found_in_a_quiet_process(wrong):
    said = probabilities(3, 3.0, 0.1, fault=lambda k, y, rng: wrong(k, y, rng) if k >= 600 else y, seeds=(0,))
    assert (said[:600] > 0.5).mean() < 0.02
    assert (said[640:, 0] > 0.9).mean() > 0.95
    assert (said[640:, 1] > 0.5).mean() < 0.05


@pytest.mark.parametrize("frozen", [False, True])
def test_a_turbine_at_rest_has_no_alarm_and_one_of_its_sensors_may_freeze(frozen):
    """By default `design` states a process noise for the command, which a simulated plant does not have."""
    plant = cosim.FMU(fmus.path("HydroTurbine"))
    controller = controllers.design(
        plant, measured="power", actuated="command", sensors=2, sensor_std=0.002, u_min=0.0, u_max=1.0
    )
    loop = cosim.closed_loop(
        plant, controller, control="command", measured="power", sensors=cosim.Sensors(2, std=0.002), reference=0.6,
        faults=[cosim.Freeze(sensor=0, start=10.0)] if frozen else [],
    )  # fmt: skip
    for seed in range(3):
        alarms = loop.simulate(30.0, seed=seed)["controller.fault_probability"] > 0.5
        assert alarms[:200].mean() < 0.01
        assert alarms[:, 1].mean() < 0.01
        assert alarms[220:, 0].mean() == pytest.approx(float(frozen), abs=0.01)
