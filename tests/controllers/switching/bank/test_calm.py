"""A process that is quieter than its model: no healthy sensor is blamed, and faults are still found."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus

STEP = 0.05


def probabilities(sensors, stated, true, *, fault=None, seeds=(0, 1), count=1200, joint=True):
    """Return the fault probabilities (samples of all seeds x sensors) of sensors with noise 1 and a process in its units."""
    model = controllers.LinearModel([[0.98]], [[1.0]], [[1.0]] * sensors, stated**2, 1.0, dt=STEP)
    precision = controllers.SwitchingPrecision(joint=joint)
    estimator = controllers.StateEstimator(model, precision, initial_covariance=stated**2 + 1.0)
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
@pytest.mark.parametrize(
    ("sensors", "stated", "joint"),
    [
        (1, 1.0, True),
        (2, 3.0, True),
        (2, 30.0, True),
        (3, 1.0, True),
        (1, 1.0, False),
        (2, 3.0, False),
        (3, 1.0, False),
    ],
)
def test_no_healthy_sensor_is_blamed_where_the_process_noise_is_stated_too_large(sensors, stated, true, joint):
    """One seemed unmodelled for up to all of the time: it followed less than the belief, which followed the others' noise."""
    assert (probabilities(sensors, stated, true * stated, joint=joint) > 0.5).mean() < 0.02


@pytest.mark.parametrize("true", [0.0, 0.1, 0.3])
def test_only_sensors_of_their_quantities_are_not_blamed_in_a_quiet_process_by_the_per_sensor_form(true):
    """Place and acceleration of a mass under a load. The accelerometer was blamed for most of the time."""
    A, gain = np.array([[1.0, STEP, STEP**2 / 2], [0.0, 0.98, STEP], [0.0, 0.0, 0.9]]), np.array([0.0, 0.0, 1.0])
    C, Q = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.diag([1e-9, 1e-9, 1.0])
    model = controllers.LinearModel(A, gain[:, None], C, Q, np.diag([1e-4, 0.1]), dt=STEP)
    precision, said = controllers.SwitchingPrecision(joint=False), []
    for seed in range(3):
        rng, x = np.random.default_rng(seed), np.zeros(3)
        step = controllers.StateEstimator(model, precision, initial_covariance=Q).online()
        for _ in range(1500):
            said.append(step(y=C @ x + np.array([0.01, 0.316]) * rng.normal(size=2), u=[0.0]).fault_probability)
            x = A @ x + true * gain * rng.normal()
    assert (np.array(said) > 0.5).mean(axis=0).max() < 0.1


def test_beside_a_sensor_that_says_nothing_the_per_sensor_form_judges_as_before():
    """Its part of the evidence for a quiet process is lost in rounding, and no division by zero follows."""
    model = controllers.LinearModel([[0.98]], [[1.0]], [[1.0]] * 2, 1.0, [1.0, 1e20], dt=STEP)
    step = controllers.StateEstimator(model, controllers.SwitchingPrecision(joint=False)).online(compiled=False)
    rng = np.random.default_rng(0)
    for _ in range(50):
        assert np.isfinite(step(y=rng.normal(size=2), u=[0.0]).fault_probability).all()


def test_a_stated_process_is_judged_as_before():
    assert (probabilities(2, 3.0, 3.0) > 0.5).mean() < 0.001


@pytest.mark.parametrize("wrong", [lambda k, y, rng: y + 8.0 * np.sin(0.4 * k), lambda k, y, rng: 12.0 * rng.normal()])
def test_a_fault_of_large_errors_is_found_in_a_quiet_process(wrong):
    said = probabilities(3, 3.0, 0.1, fault=lambda k, y, rng: wrong(k, y, rng) if k >= 600 else y, seeds=(0,))
    assert (said[:600] > 0.5).mean() < 0.02
    assert (said[640:, 0] > 0.9).mean() > 0.95
    assert (said[640:, 1] > 0.5).mean() < 0.05


@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize(("sensors", "size", "fault"), [(2, 1.0, "gain"), (2, 0.1, "lag"), (3, 0.1, "lag")])
def test_a_fault_of_small_errors_is_found_where_the_noise_is_as_stated(sensors, size, fault, joint):
    """Small errors of a filtered sensor made the process seem quiet, and its alarm was withdrawn."""
    late = 0.0

    def wrong(k, y, rng):
        nonlocal late
        late = late + (y - late) / 10 if k else y
        return y if k < 500 else 0.7 * y if fault == "gain" else late + (1 - 1 / 19) ** 0.5 * 0.3 * rng.normal()

    said = probabilities(sensors, size, size, fault=wrong, seeds=(0,), count=1900, joint=joint)
    assert (said[700:, 0] > 0.5).mean() > 0.7
    assert (said[700:, 1:] > 0.5).mean() < 0.15


def test_a_lagging_sensor_does_not_outvote_two_that_agree_in_a_quiet_process():
    """An underwater vehicle: its error grows slowly, and the belief followed it for 1.5 m, while two healthy ones agreed."""
    A = [[0, 1, 0], [0, -40 / 120, 1 / 120], [0, 0, -1 / 0.4]]
    plant = control.ss(
        A, [[0, 0], [0, 1 / 120], [1 / 0.4, 0]], np.eye(2, 3), 0, inputs=["thrust", "load"], outputs=["depth", "speed"]
    )
    plant, std = cosim.StateSpace(plant, initial=[10.0, 0.0, 0.0]), [0.02, 0.02, 0.05, 0.01]
    controller = controllers.design(
        plant, measured=["depth", "speed"], actuated="thrust", sensors=[3, 1], sensor_std=std, goal="depth", dt=0.1,
        noise={"load": 1.0}, disturbance=0.01, acceptable_error=0.1, acceptable_control=20.0, initial_spread=1e4,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="thrust", measured=["depth", "speed"], sensors=cosim.Sensors([3, 1], std=std),
        noise={"load": cosim.Constant(-8.0)},
        reference=cosim.Table([0, 60, 120, 240, 300, 420, 460, 600], [10, 10, 22, 22, 10, 10, 4, 4]),
        faults=[cosim.Lag(sensor=0, start=210.0, time_constant=8.0), cosim.Dropout(sensor=3, start=200.0, stop=500.0)],
    )  # fmt: skip
    result = loop.simulate(500.0, seed=1)
    blamed = (result["controller.fault_probability"] > 0.5)[result.time > 310].mean(axis=0)
    assert blamed[0] > 0.9
    assert blamed[1:3].max() < 0.02
    assert np.abs(result["controller.x_hat"][:, 0] - result["plant.depth"])[100:].max() < 0.2


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
