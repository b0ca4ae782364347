"""What controllers say of themselves, against the Riccati equation and runs."""

import re
from dataclasses import replace

import control
import numpy as np
import pytest
from IPython.lib.pretty import pretty
from scipy.linalg import solve_discrete_are

from bayesftc import controllers, cosim
from bayesftc.controllers import FixedPrecision
from bayesftc.controllers.bayesian.describing import expected_accuracy, listed

A, B, H = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
C, Q, R = np.vstack([H, H]), np.diag([1e-4, 2e-4]), np.diag([0.04, 0.09])
MODEL = controllers.LinearModel(A, B, C, Q, R, dt=0.1)


def lqg(model=MODEL, **options):
    return controllers.LQGController(model, **{"goal_covariance": 0.01, "precision": FixedPrecision()} | options)


def test_the_expected_error_of_the_belief_is_kalmans():
    P = solve_discrete_are(A.T, C.T, Q, R)
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    (_, belief) = expected_accuracy(lqg())
    assert belief[0] == pytest.approx(np.sqrt((P - K @ C @ P)[0, 0]), rel=1e-7)


def test_the_expected_error_of_tracking_is_that_of_a_long_run():
    plant = cosim.StateSpace(control.ss(A, B, H, 0, 0.1, inputs=["u"], outputs=["y"]), process_noise=Q)
    loop = cosim.closed_loop(
        plant, lqg(), control="u", measured="y", sensors=cosim.Sensors(2, np.sqrt(np.diag(R))), reference=0.0
    )
    run = loop.simulate(20_000.0, seed=1)
    tracking, belief = expected_accuracy(lqg())
    assert run["plant.y"].std() == pytest.approx(tracking[0], rel=0.05)
    assert (run["controller.x_hat"][:, 0] - run["plant.y"]).std() == pytest.approx(belief[0], rel=0.05)


def precise_axis(**options):
    """An axis in SI units: sensors of 5, 20 and 60 um, a tachometer, and 150 N."""
    axis = control.ss(
        [[0, 1], [0, -2.5]],
        [[0, 0], [1 / 12, 1 / 12]],
        np.eye(2),
        0,
        inputs=["force", "process_force"],
        outputs=["x", "v"],
    )
    return controllers.design(
        axis, measured=["x", "v"], actuated="force", goal="x", dt=0.002, sensor_std=[5e-6, 20e-6, 60e-6, 2e-3],
        noise={"process_force": 5.0}, acceptable_error=2e-4, acceptable_control=50.0, disturbance=1.0, **options,
    )  # fmt: skip


def test_the_accuracy_of_a_precise_axis_in_si_units_needs_no_warning(recwarn):
    """scipy warned of an ill-conditioned matrix; in micrometres it did not, and the numbers were the same."""
    controller = precise_axis(sensors=[3, 1])
    (tracking,), (belief,) = expected_accuracy(controller)
    assert not [w for w in recwarn if "conditioned" in str(w.message)]
    assert (tracking, belief) == pytest.approx((1.06665348e-05, 3.2579e-06), rel=1e-3)


def test_the_noise_of_sensors_of_several_quantities_names_them():
    """A single number of sensors takes the quantities in turn, so that a noise of a position became one of a speed."""
    start = "Expected standard deviations of the sensors: "
    assert f"{start}5e-06 (x), 2e-05 (x), 6e-05 (x), 0.002 (v).\n" in precise_axis(sensors=[3, 1]).describe()
    assert f"{start}5e-06 (x), 2e-05 (v), 6e-05 (x), 0.002 (v).\n" in precise_axis(sensors=4).describe()
    assert not any("(" in line for line in lqg().describe().splitlines() if line.startswith(start))


def test_modes_that_no_control_moves_are_no_poles_of_the_control():
    A = [[-0.1, 0.05, 0.1], [0, -0.001, 0], [0, 0, -1e-5]]  # a room, with the lags of two loads
    room = control.ss(A, np.eye(3)[:, :2], [[1, 0, 0]], 0, inputs=["heat", "outside"], outputs=["room"])
    lines = controllers.design(room, dt=1.0, measured="room", actuated="heat", sensors=2).describe().splitlines()
    assert re.match(r"Closed-loop poles of the control: 0\.\d+; the slowest of magnitude 0\.\d+ \(", lines[0])
    assert lines[1].startswith("Modes that no control moves: 0.99999, 0.999; the slowest of magnitude 0.99999")


def test_of_two_equal_modes_the_control_may_move_one():
    twins = control.ss(np.diag([0.9, 0.9]), [[1.0], [0.0]], np.eye(2), 0, 0.1, inputs=["force"], outputs=["a", "b"])
    lines = controllers.design(twins, measured=["a", "b"], actuated="force", goal="a").describe().splitlines()
    moved = re.match(r"Closed-loop poles of the control: (\S+); the slowest", lines[0])
    assert 0.0 < float(moved[1]) < 0.85
    assert lines[1].startswith("Modes that no control moves: 0.9; the slowest of magnitude 0.900")


def test_rows_of_gains_have_the_names_of_states_and_controls():
    text = precise_axis(sensors=4).describe()
    gain = next(line for line in text.splitlines() if line.startswith("Gain of the filter"))
    assert re.fullmatch(
        r"Gain of the filter, a row for each state: [^;(]+ \(x\[0]\); [^;(]+ \(x\[1]\); [^;(]+ \(disturbance\[0]\)\.",
        gain,
    )
    drives = control.ss(np.eye(2) * 0.9, np.eye(2), np.eye(2), 0, 0.1, inputs=["left", "right"])
    two = controllers.design(drives, actuated=["left", "right"], noise={"left": 0.1, "right": 0.2}).describe()
    assert "as standard deviations: 0.1 (left), 0.2 (right) on each control." in two
    assert re.search(r"K, a row for each control: [^;(]+ \(left\); [^;(]+ \(right\)\.", two)


def test_loads_of_the_design_are_named():
    """It said that no load on the control is estimated, and nothing of the others."""
    room = control.ss(
        np.diag([-0.1, -0.2]), [[1.0, 0.1, 0.0], [0.5, 0.0, 0.3]], np.eye(2), 0,
        inputs=["heat", "outdoor", "people"], outputs=["air", "wall"],
    )  # fmt: skip
    for disturbance in (False, True):
        said = controllers.design(
            room, measured=["air", "wall"], actuated="heat", goal="air", sensors=[2, 2], sensor_std=[0.1, 0.1], dt=1.0,
            loads={"outdoor": (1.0, 1000.0), "people": (1.0, 1000.0)}, disturbance=disturbance,
            acceptable_error=1.0, acceptable_control=1.0,
        ).describe()  # fmt: skip
        assert "Loads that are estimated, as deviations from the operating point: outdoor, people.\n" in said
        assert ("No load on the control is estimated" in said) != disturbance
    room = control.ss(
        -0.1,
        [[1.0, 0.1]],
        [[1.0], [0.0]],
        [[0.0, 0.0], [0.0, 1.0]],
        inputs=["heat", "outdoor"],
        outputs=["air", "weather"],
    )
    said = controllers.design(
        room, measured=["air", "weather"], actuated="heat", goal="air", dt=1.0, loads={"outdoor": (1.0, 1000.0)}
    ).describe()
    assert "Loads that are estimated, as deviations from the operating point: outdoor.\n" in said
    assert "Loads that are estimated" not in lqg().describe()


@pytest.mark.parametrize("learner", controllers.LEARNERS, ids=lambda learner: learner.__name__)
def test_every_learner_is_described(learner):
    text = lqg(precision=learner()).describe()
    assert text.startswith("Closed-loop poles of the control: ")
    assert f"Precision learner: {learner.__name__}." in text
    assert "Model: 2 states, 1 control, 2 sensors of 1 quantity, every 0.1 s." in text
    assert "Expected errors without faults" in text
    assert (
        "Expected process noise in each step, as standard deviations: 0.01 (x[0]), 0.01414 (x[1]) of each state.\n"
        in text
    )
    assert len(text) < 3000
    assert pretty(text) == str(text)  # as the last line of a notebook's cell


def test_settings_faults_names_and_limits_are_named():
    named = controllers.LinearModel.from_control(
        control.ss(A, B, H, 0, 0.1, inputs=["force"], outputs=["place"]),
        process_covariance=Q, sensor_covariance=R,
    )  # fmt: skip
    precision = controllers.SwitchingPrecision(
        [controllers.Offset()], actuator_modes=[controllers.LostEffect()], loss=0.02
    )
    text = lqg(named.with_disturbance(), precision=precision, u_min=-2.0, u_max=3.0).describe()
    assert "Model: 2 states and 1 disturbance, 1 control (force), 2 sensors of 1 quantity (place)" in text
    assert "loss=0.02" in text
    assert "Sensor faults that are distinguished: Offset." in text
    assert (
        "assumes these mean times in seconds, until a fault begins / until it ends: Offset 750 / 50. Times that you"
        in text
    )  # at 0.1 s, five times the default
    assert "Actuator faults that are distinguished: LostEffect." in text
    assert "limits of the control: -2 to 3" in text
    assert "No load on the control is estimated" not in text
    assert "No load on the control is estimated (disturbance=True in design)." in lqg(named).describe()
    assert "0.01 (x[0]), 0.01414 (x[1]) of each state; 0.01 of the disturbance.\n" in text
    assert (
        "at constant goals and disturbances, with a sample of every sensor in each step (standard deviations)" in text
    )
    errors = lqg(named.with_disturbance().with_sensor_errors(0.1, 10.0)).describe()
    assert "2 states and 1 disturbance and 2 errors of sensors, 1 control" in errors
    assert re.search(r"; 0\.01 of the disturbance; [0-9.e-]+, [0-9.e-]+ of each error of a sensor\.\n", errors)


def test_a_bayesian_controller_says_its_poles_and_why_it_has_no_probability():
    controller = controllers.BayesianController(
        MODEL, precision=controllers.GammaPrecision(forgetting=0.8), goal_on="outputs",
        goal_covariance=1e-3, control_covariance=50.0,
    )  # fmt: skip
    text = controller.describe()
    largest = np.abs(controller.closed_loop_poles()).max()
    constant = -MODEL.dt / np.log(largest)
    assert f"the slowest of magnitude {largest:.3f} (time constant {constant:.3g} s)" in text.splitlines()[0]
    assert "GammaPrecision, with forgetting=0.8." in text
    assert "There is no fault probability: GammaPrecision has no calibration" in text


def test_only_the_pole_of_a_constant_that_no_control_moves_is_left_out():
    """Both states are integrators, of which the control moves one: a second pole had been left out with the constant's."""
    model = controllers.LinearModel(np.eye(2), [[0.1], [0.0]], [[1, 0], [1, 1], [0, 1]], [1e-3, 1e-6], 1e-2, dt=0.1)
    controller = controllers.BayesianController(
        model, controllers.FixedPrecision(), goal_on=[[1.0, 0.0]], goal_covariance=0.01
    )
    poles = controller.closed_loop_poles()
    left = np.sort_complex(poles[np.abs(poles - 1.0) > 1e-9])
    assert len(left) == len(poles) - 1
    np.testing.assert_array_equal(np.sort_complex(controller._relevant_poles()), left)


def test_an_unstable_loop_has_no_accuracy():
    """A costly control that leaves an unstable mode as it is."""
    model = controllers.LinearModel([[1.1]], [[1.0]], [[1.0]], 1e-3, 1e-2, dt=0.1)
    controller = controllers.BayesianController(model, FixedPrecision(), goal_covariance=1e9, control_covariance=1e-9)
    assert np.abs(controller.closed_loop_poles()).max() > 1.0
    assert "Expected accuracy: none" in controller.describe()


def test_the_control_at_the_operating_point_is_named():
    def drain(t, x, u, params):
        return np.array([0.1 * u[0] - 0.2 * np.sqrt(x[0])])

    tank = control.nlsys(drain, lambda t, x, u, params: x, inputs=["pump"], outputs=["level"], states=["h"])
    plant = cosim.StateSpace(tank, initial=[1.0])
    settings = {"noise": {"pump": 0.3}, "input_delays": 1}
    text = controllers.design(
        plant, measured="level", actuated="pump", sensors=2, dt=0.1, at={"pump": 2.0}, **settings
    ).describe()
    assert "Expected process noise in each step, as standard deviations: 0.3 on the control.\n" in text
    assert "every 0.1 s, about an operating point at which the control is 2 and h = 1.\n" in text


def test_a_mode_that_is_not_damped_and_has_no_goal_leaves_the_accuracy_of_the_others():
    """A position without a goal beside a controlled speed: the speed is as accurate as in a model without the position."""
    alone = lqg(controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 1e-3, 0.04, dt=0.1))
    beside = controllers.LinearModel(
        [[0.9, 0.0], [0.1, 1.0]], [[0.1], [0.0]], np.eye(2), np.diag([1e-3, 1e-12]), np.diag([0.04, 1e6]), dt=0.1
    )
    speed = lqg(beside, goal_on=[[1.0, 0.0]])
    np.testing.assert_allclose(expected_accuracy(speed), expected_accuracy(alone), rtol=1e-3)
    assert speed.describe().splitlines()[-1].startswith("Expected errors without faults")


def test_the_law_about_an_operating_point_is_one_of_deviations():
    tank = control.nlsys(
        lambda t, x, u, params: 0.5 * u - 0.1 * np.sqrt(np.abs(x)), lambda t, x, u, params: x,
        inputs=["u"], outputs=["h"], states=["h"],
    )  # fmt: skip
    plant = cosim.StateSpace(tank, initial=[4.0])
    controller = controllers.design(plant, dt=0.1, u_min=0.0, u_max=2.0, sensors=2)
    gains, out = controller.steady_gains(), controller.online(compiled=False)(y=[None, None], goal=[4.2])
    (u0,), (x0,) = controller.model.operating_control, controller.model.operating_state
    assert (u0, x0) == (pytest.approx(0.4), pytest.approx(4.0))
    assert out.u[0] - u0 == pytest.approx(gains.M[0, 0] * (4.2 - x0) - gains.L[0, 0] * (out.x_hat[0] - x0))
    words = (
        "The control is F goal - K belief, each as its deviation from the operating point. K, a row for each control: "
    )
    assert words in controller.describe()
    assert "The control is F goal - K belief. K, a row" in lqg().describe()


def test_noise_is_described_at_the_inputs_at_which_it_was_stated():
    """The states of a model by responses say nothing to an engineer, and the noise was stated for inputs."""
    plant = control.ss(
        [[-1.0, 0.0], [1.0, -0.2]], [[1.0, 0.5], [0.0, 1.0]], [[0.0, 1.0]], 0, inputs=["u", "kick"], outputs=["y"]
    )
    given = {"measured": "y", "actuated": "u", "dt": 0.1, "sensors": 2, "noise": {"kick": 0.2, "u": 3.0}}
    start = "Expected process noise in each step, as standard deviations: "
    text = controllers.design(plant, **given).describe()
    assert f"{start}0.2 (kick), 3 (u) at these inputs.\n" in text
    assert (
        f"{start}0.2 (kick), 3 (u) at these inputs.\n" in controllers.design(plant, **given, input_delays=2).describe()
    )
    alike = control.ss([[-1.0]], [[1.0, 2.0]], [[1.0]], 0, inputs=["u", "kick"], outputs=["y"])
    assert "(kick)" not in controllers.design(alike, **given).describe()  # their sum does not tell each
    loaded = controllers.design(plant, **given | {"noise": {"u": 3.0}, "loads": {"kick": (0.2, 5.0)}})
    assert (
        f"{start}3 (u) at this input; for the loads {0.2 * np.sqrt(1 - np.exp(-0.04)):.4g} (kick).\n"
        in loaded.describe()
    )
    other = replace(loaded.model, process_covariance=np.diag([1.0, 2.0, 1e-4]))
    assert "(kick) of each state" in replace(loaded, model=other).describe()


def test_poles_that_rounding_moves_from_zero_and_past_signals_are_counted():
    delays = np.eye(8, k=-1)  # a plant that holds its own delays
    delays[0, 0] = 0.9
    plant = control.ss(delays, [[0.1], *[[0.0]] * 7], [[*[0.0] * 7, 1.0]], 0, 0.1, inputs=["u"], outputs=["y"])
    lines = controllers.design(plant, measured="y", actuated="u", sensors=2, input_delays=2).describe().splitlines()
    poles = r"(-?[\d.]+(\+[\d.]+j)?, )+(and )?\d+ below 0\.05 in magnitude, and 2 at 0 for the delays; the slowest"
    assert re.search(poles, lines[0])
    gains = [line for line in lines if line.startswith(("Gain of the filter", "The control is"))]
    assert not any("u[-1]" in line for line in gains)
    assert all(line.endswith(" Those of 2 past signals are left out; steady_gains() has all.") for line in gains)
    assert re.match(r"Closed-loop poles of the control: 0\.9, 0; the slowest", pole_text([0.9, 1e-17]))


def pole_text(poles):
    return f"Closed-loop poles of the control: {listed(np.array(poles), 0.1)}"
