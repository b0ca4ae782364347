"""A controller from nothing but a plant: linear models of FMUs and of python-control systems, and the call that uses them."""

import re
import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import LinearModel, PoorFitWarning, SignalNames, design
from bayesftc.controllers.bayesian.linear import UnstableLoopWarning
from bayesftc.controllers.bayesian.steady import moduli
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models import pulse_responses
from bayesftc.controllers.models.differences import derivative
from bayesftc.controllers.models.linearization import linearize
from bayesftc.cosim.errors import ConnectionError, ModelError, StepSizeError, UnknownNameError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.running.instance import Instance


def without_cache(monkeypatch):
    """Repeat the experiments with an FMU, which are usually made once, because this one is another in a test."""
    monkeypatch.setattr(pulse_responses, "_realised", pulse_responses._realised.__wrapped__)


def pendulum_at(angle, m=0.2, M=0.5, length=0.3, inertia=0.006, c=0.1, b=1e-3, g=9.81):
    """The pendulum on a cart for small deviations from standing, from the textbook's linear equations."""
    mass = np.array([[M + m, m * length], [m * length, inertia + m * length**2]])
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2:] = np.linalg.solve(mass, np.array([[0, 0, -c, 0], [0, m * g * length, 0, -b]]))
    B = np.concatenate([np.zeros(2), np.linalg.solve(mass, [1.0, 0.0])])[:, None]
    return A, B


# dx/dt = A x + B u by hand, C, and what is asked of the FMU.
SPRING = [[0, 0, 1, 0], [0, 0, 0, 1], [-100, 100, -1, 1], [100, -100, 1, -1]]
GATE = 0.6
PLANTS = {
    "PositionServo": (
        [[0, 1, 0], [0, -2, 10], [0, -2, -20]], [[0], [0], [20]], [[1, 0, 0]], ["angle"], ["voltage"], 0.01
    ),
    "TwoMasses": (SPRING, [[0], [0], [1], [0]], [[1, 0, 0, 0], [0, 1, 0, 0]], ["x1", "x2"], ["force1"], 0.02),
    "CartPendulum": (*pendulum_at(0.0), np.eye(4)[:2], ["position", "angle"], ["force"], 0.02),
    "HydroTurbine": (
        [[-5, 0], [2 / GATE, -2 / GATE]], [[5], [0]], [[-2, 3]], ["power"], ["command"], 0.05
    ),
}  # fmt: skip


def responses(A, B, C, count):
    """C B, C A B, C A A B, ..."""
    rows, state = [], np.asarray(B, float)
    for _ in range(count):
        rows.append(C @ state)
        state = A @ state
    return np.array(rows)


@pytest.mark.parametrize("name", PLANTS)
def test_an_fmu_for_co_simulation_is_known_by_its_answers(name):
    A, B, C, measured, actuated, dt = PLANTS[name]
    model = LinearModel.from_fmu(fmus.path(name), measured=measured, actuated=actuated, sensors=2 * len(measured))
    moving = model.moving
    assert float(model.step) == dt
    assert moving.states == len(A)
    assert model.sensors == 2 * len(measured)
    whole = expm(dt * np.block([[np.asarray(A, float), np.asarray(B, float)], [np.zeros((1, len(A) + 1))]]))
    n = len(A)
    expected = responses(whole[:n, :n], whole[:n, n:], np.asarray(C, float), 40)
    found = responses(*(moving.matrix(name) for name in "ABC"), 40)
    # The derivative of a nonlinear plant costs half of the digits.
    np.testing.assert_allclose(found[:, : len(measured)], expected, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_array_equal(found[:, : len(measured)], found[:, len(measured) :])
    assert model.constant == (name == "HydroTurbine")
    if model.constant:  # in values: power = command in steady state
        steady = np.linalg.solve(np.eye(n) - moving.matrix("A"), moving.matrix("B") * GATE + model.matrix("A")[:n, n:])
        assert model.matrix("C")[0] @ [*steady[:, 0], 1.0] == pytest.approx(GATE, abs=1e-9)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("name", "radius"), [("PositionServo", 3.53), ("TwoMasses", 5.27), ("CartPendulum", 1.10), ("HydroTurbine", 1.09)]
)
def test_on_none_of_the_four_a_goal_for_the_next_step_alone_will_do(name, radius):
    *_, measured, actuated, _ = PLANTS[name]
    goal = "x2" if name == "TwoMasses" else measured[0]
    controller = design(fmus.path(name), measured=measured, actuated=actuated, goal=goal)
    model = controller.model.moving
    with pytest.warns(controllers.UnstableLoopWarning):
        naive = controllers.BayesianController(
            model, goal_on=controller.goal_matrix[:, : model.states], goal_covariance=1e-12
        )
    assert np.abs(naive.closed_loop_poles()).max() == pytest.approx(radius, abs=0.006)
    assert np.abs(controller.closed_loop_poles()).max() < 1


def test_an_fmu_for_model_exchange_is_known_by_its_equations(casadi_fmu):
    """Exactly, in the FMU's own states and values, where its derivatives are zero."""
    path = casadi_fmu("swing", lambda q, u: 2 * q)
    model = LinearModel.from_fmu(path, measured="y", actuated="u", dt=0.05, at={"u": 9.81 / 2})
    rate = np.array([[0, 1, 0], [-9.81 * np.cos(np.pi / 6), -0.1, 1], [0, 0, 0]])
    held = expm(0.05 * rate)
    np.testing.assert_allclose(model.moving.matrix("A"), held[:2, :2], atol=1e-9)
    np.testing.assert_allclose(model.moving.matrix("B"), held[:2, 2:], atol=1e-9)
    np.testing.assert_allclose(model.matrix("C"), [[2, 0, 0]], atol=1e-9)
    point = np.array([np.pi / 6, 0.0, 1.0])
    np.testing.assert_allclose(model.matrix("A") @ point + model.matrix("B") @ [9.81 / 2], point, atol=1e-9)
    controller = design(path, measured="y", actuated="u", dt=0.05, at={"u": 9.81 / 2})
    np.testing.assert_allclose(controller.initial_mean, [0.5, 0.0, 1.0])  # where it starts
    with ModelEquations(cosim.FMU(path)) as equations:
        assert controller.model.names.states[:2] == equations.state_names
    swings = casadi_fmu("through", lambda q, u: q + 0.5 * u)
    with pytest.raises(ModelError, match="depends directly on an input"):
        LinearModel.from_fmu(swings, measured="y", actuated="u", dt=0.05)


def test_an_fmu_that_saves_no_state_is_made_anew_for_each_experiment(monkeypatch):
    settings = {"measured": "power", "actuated": "command", "at": {"command": 0.8}}
    saved = linearize(fmus.path("HydroTurbine"), **settings)  # it must first come to 0.8
    without_cache(monkeypatch)
    monkeypatch.setattr(Instance, "can_save", property(lambda self: False))
    anew = linearize(fmus.path("HydroTurbine"), **settings)
    for name in "ABCuy":
        np.testing.assert_array_equal(getattr(anew, name), getattr(saved, name))
    assert saved.y[0] == pytest.approx(0.8, abs=1e-6)
    # Where it starts: by its own equations at a gate and a flow of 0.6, linearised at 0.8.
    assert saved.y[0] + (saved.C @ saved.start).item() == pytest.approx(0.6, abs=0.05)


def test_noise_does_not_hold_the_plant_at_its_operating_point():
    """A hovering drone: the thrust alone carries it, not half of it a gust, even if noise acts on the gust."""

    def rise(t, x, u, params):
        return np.array([x[1], (u[0] + u[1] - 0.3 * x[1]) / 1.5 - 9.81])

    drone = control.nlsys(rise, lambda t, x, u, p: x[:1], inputs=["thrust", "gust"], outputs=["h"], states=["h", "v"])
    found = linearize(drone, measured="h", actuated="thrust", noise={"gust": 0.5}, dt=0.02)
    np.testing.assert_allclose(found.u, [1.5 * 9.81, 0.0], rtol=1e-6)
    controller = design(drone, measured="h", actuated="thrust", noise={"gust": 0.5}, dt=0.02, sensors=2)
    np.testing.assert_allclose(controller.model.operating_control, [1.5 * 9.81], rtol=1e-6)


def test_the_operating_point_is_the_steady_state_nearest_to_the_start():
    """A plant that starts steady with an inflow had a model of the empty tank, the steady state without inflow."""
    tank = control.nlsys(
        lambda t, x, u, params: (u - 0.3 * np.sqrt(np.abs(x))) / 2.0,
        lambda t, x, u, params: x,
        inputs=["inflow"], outputs=["level"], states=["level"],
    )  # fmt: skip
    settings = {"measured": "level", "actuated": "inflow", "dt": 1.0}
    for level in (0.1, 0.5, 2.0):
        found = linearize(cosim.StateSpace(tank, initial=[level]), **settings)
        np.testing.assert_allclose(found.x, [level], rtol=1e-7)
        np.testing.assert_allclose(found.u, [0.3 * np.sqrt(level)], rtol=1e-7)
    found = linearize(cosim.StateSpace(tank, initial=[0.5]), at={"inflow": 0.3}, **settings)  # a given input stays
    np.testing.assert_allclose((found.x, found.u), ([1.0], [0.3]), rtol=1e-7)


def test_a_drone_hovers_where_it_starts():
    """With drag there is a steady state without thrust: a free fall, for which the altitude has no equation to rest."""
    drone = control.nlsys(
        lambda t, x, u, params: [x[1], u[0] / 1.5 - 9.81 - 0.05 * x[1] * abs(x[1])], lambda t, x, u, params: x[:1],
        inputs=["thrust"], outputs=["h"], states=["h", "v"],
    )  # fmt: skip
    found = linearize(cosim.StateSpace(drone, initial=[10.0, 0.0]), measured="h", actuated="thrust", dt=0.02)
    np.testing.assert_allclose((found.x, [*found.u, 0.0]), ([10.0, 0.0], [1.5 * 9.81, 0.0]), rtol=1e-7)


@pytest.mark.parametrize(("start", "steady", "heat"), [(5.0, 20.0, 0.0), (40.0, 40.0, 12.5), (200.0, 180.0, 100.0)])
def test_the_operating_point_is_within_the_limits(start, steady, heat):
    """A heater cannot cool: a room that starts below the temperature outside has no steady state there."""
    room = control.nlsys(
        lambda t, x, u, params: (0.8 * u - 0.5 * (x - 20.0)) / 30.0, lambda t, x, u, params: x,
        inputs=["heat"], outputs=["T"], states=["T"],
    )  # fmt: skip
    controller = design(cosim.StateSpace(room, initial=[start]), dt=1.0, u_min=0.0, u_max=100.0)
    point = controller.model.operating_state, controller.model.operating_control
    np.testing.assert_allclose(point, ([steady], [heat]), rtol=1e-7, atol=1e-9)
    assert controller.initial_mean[0] == start


def test_a_control_that_leaves_its_limits_in_place_of_another_is_limited_too():
    room = control.nlsys(
        lambda t, x, u, params: u[0] + u[1] - 0.1 * (x - 20.0), lambda t, x, u, params: x,
        inputs=["a", "b"], outputs=["T"], states=["T"],
    )  # fmt: skip
    controller = design(cosim.StateSpace(room, initial=[60.0]), dt=1.0, u_min=0.0, u_max=[1.0, 2.5])
    assert controller.model.operating_control == pytest.approx((1.0, 2.5))
    assert controller.model.operating_state == pytest.approx((55.0,))


def test_the_only_input_is_the_control_also_if_it_has_noise():
    lag = control.ss([[-0.1]], [[0.1]], [[1.0]], 0.0, inputs=["u"], outputs=["y"])
    assert design(lag, dt=1.0, noise={"u": 0.3}).model.names.controls == ("u",)
    gusty = control.ss([[-0.1]], [[0.1, 0.2]], [[1.0]], 0.0, inputs=["u", "gust"], outputs=["y"])
    assert design(gusty, dt=1.0, noise={"gust": 0.3}).model.names.controls == ("u",)


def test_a_control_that_cannot_hold_any_steady_state_is_said():
    drone = control.nlsys(
        lambda t, x, u, params: np.array([x[1], u[0] / 1.5 - 9.81]), lambda t, x, u, params: x[0],
        inputs=["thrust"], outputs=["h"], states=["h", "v"],
    )  # fmt: skip
    words = r"thrust = 14.715, but u_min and u_max limit it to 0 \.\.\. 10. No model within the limits was found: No steady state"
    with pytest.warns(controllers.ModelMismatchWarning, match=words):
        design(cosim.StateSpace(drone, initial=[10.0, 0.0]), dt=0.02, u_min=0.0, u_max=10.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"u_min": 3.0, "u_max": 3.0}, r"u_min \[3.0\] and u_max \[3.0\] leave a control no range"),
        (
            {"at": {"u": 120.0}, "u_min": 0.0, "u_max": 100.0},
            r"has u = 120, but u_min and u_max limit it to 0 \.\.\. 100",
        ),
    ],
)
def test_limits_that_exclude_the_operating_point_are_refused(settings, words):
    system = control.nlsys(
        lambda t, x, u, params: 0.1 * (u - x), lambda t, x, u, params: x, inputs=["u"], outputs=["y"], states=["x"]
    )
    with pytest.raises(ModelError, match=words):
        design(cosim.StateSpace(system, initial=[0.0]), measured="y", actuated="u", dt=0.1, **settings)


@pytest.mark.parametrize("delays", [0, 3])
@pytest.mark.parametrize("expected", [{"noise": {"w": 100.0}}, {"noise": {"w": 100.0, "u": 10.0}}])
def test_a_loop_that_a_small_error_would_lose_is_warned_of(expected, delays):
    """The distance is that of the margins of the loop, computed from the diagram."""
    A = [[0, 1, 0, 0], [-100, -0.1, 100, 0.1], [0, 0, 0, 1], [100, 0.1, -100, -0.1]]
    carts = control.ss(A, [[0, 0], [1, 0], [0, 0], [0, 1]], [[0, 0, 1, 0]], 0, inputs=["u", "w"], outputs=["y"])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        controller = controllers.design(
            carts,
            measured="y",
            actuated="u",
            dt=0.02,
            sensor_std=0.01,
            acceptable_error=0.3,
            input_delays=delays,
            **expected,
        )
    (found,) = moduli(controller)
    if not delays:
        loop = cosim.closed_loop(carts, controller, control="u", measured="y", reference=0.0)
        assert found == pytest.approx(loop.margins().modulus, rel=1e-4)
    said = [str(each.message) for each in caught if each.category is UnstableLoopWarning]
    assert len(said) == (found < 0.1)
    assert all(re.search(rf'as near as {found:.2g} to -1 .* \(noise={{"u": ...}}\), estimate', text) for text in said)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_how_near_loops_are_to_instability_does_not_depend_on_units(unit):
    """Each loop is opened alone, as by loop.margins(at=): watts beside a valve from 0 to 1 are no reason for a warning."""
    rooms = control.ss(
        [[-0.2, 0.1], [0.1, -0.3]],
        [[1, 0.3 / unit], [0.2, 1 / unit]],
        np.eye(2),
        0,
        inputs=["a", "b"],
        outputs=["x", "y"],
    )
    controller = controllers.design(
        rooms, measured=["x", "y"], actuated=["a", "b"], dt=0.5, sensor_std=0.01, acceptable_error=0.1,
        acceptable_control=[1.0, unit], noise={"a": 0.05, "b": 0.05 * unit},
    )  # fmt: skip
    loop = cosim.closed_loop(rooms, controller, control=["a", "b"], measured=["x", "y"], reference=[0.0, 0.0])
    assert moduli(controller) == pytest.approx([loop.margins(at=name).modulus for name in "ab"], rel=1e-3)


def test_a_start_elsewhere_is_no_fault_of_the_sensors_if_it_is_expected():
    settings = {"measured": "y", "actuated": "u", "dt": 0.1, "sensors": 2, "noise": {"u": 0.01}}
    settings["precision"] = controllers.SwitchingPrecision(start_doubt=0.0)
    system = control.ss([[-0.5]], [[0.5]], [[1.0]], 0, inputs=["u"], outputs=["y"])
    blamed = []
    for spread in (10.0, 1e5):
        controller = design(system, **settings, initial_spread=spread)
        np.testing.assert_allclose(
            np.array(controller.initial_covariance),
            spread / 10.0 * np.array(design(system, **settings).initial_covariance),
        )
        loop = cosim.closed_loop(
            cosim.StateSpace(system, initial=[2.0]), controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.01),
            reference=0.0,
        )  # fmt: skip
        blamed.append(
            (loop.simulate(5.0, engine="interpreted")["controller.fault_probability"] > 0.5).any(axis=1).mean()
        )
    assert blamed[0] > 0.2 > 0.02 >= blamed[1]
    with pytest.raises(ModelError, match="initial_spread"):
        design(system, **settings, initial_spread=-1.0)
    given = design(
        system, **settings, initial_mean=2.0, sensor_delays=1, disturbance=0.1
    )  # also a delayed y, and no load
    np.testing.assert_array_equal(given.initial_mean, [2.0, 2.0, 0.0])
    elsewhere = design(cosim.StateSpace(system, initial=[3.0]), **settings, initial_mean=[2.0])
    np.testing.assert_array_equal(elsewhere.initial_mean, [2.0])  # and not the 3.0 of the plant
    with pytest.raises(ModelError, match="initial_mean has the shape"):
        design(system, **settings, initial_mean=[2.0, 0.0])


def test_outputs_may_have_different_numbers_of_sensors():
    """As the model with a row of C for each; a loop and a scenario have the same numbers."""
    tank = control.ss(
        [[-0.1, 0.0], [0.02, -0.05]], 0.1 * np.eye(2), np.eye(2), 0, inputs=["valve", "heater"], outputs=["h", "T"]
    )
    settings = {
        "measured": ["h", "T"],
        "actuated": ["valve", "heater"],
        "dt": 1.0,
        "noise": {"valve": 0.1, "heater": 0.2},
    }
    model = design(tank, **settings, sensors=(1, 3), sensor_std=(0.01, 0.2)).model
    np.testing.assert_array_equal(model.matrix("C"), np.eye(2)[[0, 1, 1, 1]])
    np.testing.assert_array_equal(np.sqrt(np.diag(model.matrix("sensor_covariance"))), [0.01, 0.2, 0.2, 0.2])
    assert model.names.sensors == ("h", "T", "T", "T")
    controller = design(tank, **settings)
    ports = {port.name: port.description for port in controller.inputs + controller.outputs}
    assert (ports["y"], ports["u"]) == (
        "Samples of the sensors (h, T); NaN is a missing one",
        "Control (valve, heater)",
    )
    assert ports["x_hat"] == "Mean of the belief about the state"
    covariances = {"process_covariance": model.process_covariance, "sensor_covariance": model.sensor_covariance}
    same = LinearModel.from_control(tank, dt=1.0, sensors=(1, 3), **covariances)
    for name in "ABC":
        np.testing.assert_allclose(same.matrix(name), model.matrix(name), atol=1e-12)
    four = design(tank, **settings, sensors=(1, 3), sensor_std=(0.01, 0.2))
    with pytest.raises(ConnectionError, match=r"sensors=cosim\.Sensors\(count=\(1, 3\), std="):
        cosim.closed_loop(tank, four, control=["valve", "heater"], measured=["h", "T"], reference=[1.0, 5.0])
    with pytest.raises(ModelError, match=r"3 sensors are no multiple of 2 .* sensors=\(1, 3\)"):
        design(tank, **settings, sensors=3)
    with pytest.raises(ModelError, match=r"without names, in the order of the measured outputs: sensors=\(1, 3\)"):
        design(tank, **settings, sensors={"h": 1, "T": 3})
    with pytest.raises(ModelError, match="sensors has 3 numbers for 2 measured outputs"):
        design(tank, **settings, sensors=(1, 1, 1))


def test_a_system_without_a_sample_time_says_where_one_is_given():
    with pytest.raises(StepSizeError, match=r"without a sample time.* dt=0\.01, or dt = 0\.01 in \[simulation\]"):
        design(control.ss(-1.0, 1.0, 1.0, 0.0), measured="y", actuated="u")


def test_a_plant_that_never_rests_is_said():
    with pytest.raises(ModelError, match=r"does not come to rest.*, angle still changes after.*LinearModel\.identify"):
        LinearModel.from_fmu(fmus.path("PositionServo"), measured="angle", actuated="voltage", at={"voltage": 1.0})


@pytest.mark.slow
def test_a_very_slow_plant_is_waited_for(tmp_path):
    """A tank with a time constant of three days and a sample each 30 s: its first 20,000 samples are two of them."""
    tank = cosim.StateSpace(
        control.ss([[-1 / 3e5]], [[1 / 3e5]], [[1.0]], 0, inputs=["u"], outputs=["y"]), initial=[1.0]
    )
    fmu = cosim.FMU(cosim.export_fmu(tank, tmp_path / "tank.fmu", dt=30.0))
    with pytest.warns(UserWarning, match="the steady state that it reached"):
        model = design(fmu, measured="y", actuated="u", dt=30.0, sensor_std=0.1).model
    assert model.A[0, 0] == pytest.approx(np.exp(-30.0 / 3e5), rel=1e-6)


def test_a_plant_that_comes_to_rest_elsewhere_is_linearised_there():
    falls = cosim.FMU(fmus.path("CartPendulum"), parameters={"angle_0": 0.1, "b": 0.02})
    reached = r"It ran .* the steady state that it reached, with position = \S{1,10}, angle = 3\.142\. For"
    with pytest.warns(UserWarning, match=reached):
        found = linearize(falls, measured=["position", "angle"], actuated="force")
    assert found.y[1] == pytest.approx(np.pi, abs=1e-6)
    assert np.abs(np.linalg.eigvals(found.A)).max() <= 1 + 1e-7  # hanging, and the cart wherever it is


def test_too_low_an_order_is_said():
    with pytest.warns(PoorFitWarning, match="order 2 misses"):
        model = LinearModel.from_fmu(fmus.path("TwoMasses"), measured=["x1", "x2"], actuated="force1", order=2)
    assert model.states == 2
    with pytest.raises(ModelError, match="give from 1 to"):
        LinearModel.from_fmu(fmus.path("TwoMasses"), measured=["x1", "x2"], actuated="force1", order=0)


def test_pulses_that_the_plant_cannot_take_are_left_out():
    """A gate that is nearly shut fails under large pulses down; small ones tell the same as by the equations."""
    opening = 0.1
    narrow = cosim.FMU(fmus.path("HydroTurbine"), parameters={"gate_0": opening, "command": opening})
    found = linearize(narrow, measured="power", actuated="command")
    known = np.exp(-0.05 * np.array([5.0, 2 / opening]))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(found.A)), np.sort(known), rtol=1e-5)


def test_a_plant_that_rests_at_a_limit_is_said(monkeypatch):
    one_sided = Instance.update

    def pump(self, inputs, outputs, t):  # the voltage cannot be negative
        return one_sided(self, np.maximum(inputs, 0.0), outputs, t)

    without_cache(monkeypatch)
    monkeypatch.setattr(Instance, "update", pump)
    with pytest.warns(PoorFitWarning, match=r"'voltage' up and down differ by 100 %"):
        linearize(fmus.path("PositionServo"), measured="angle", actuated="voltage")


def test_a_dead_band_is_no_derivative_of_zero(monkeypatch):
    usual, band = Instance.update, 0.2

    def stiff(self, inputs, outputs, t):
        return usual(self, np.sign(inputs) * np.maximum(np.abs(inputs) - band, 0.0), outputs, t)

    without_cache(monkeypatch)
    monkeypatch.setattr(Instance, "update", stiff)
    settings = {"measured": "angle", "actuated": "voltage"}
    with pytest.raises(ModelError, match=r"larger pulses of 'voltage', but not to one of 0\.1: it has a dead band"):
        linearize(fmus.path("PositionServo"), **settings)
    band = 0.002
    with pytest.warns(PoorFitWarning, match=r"larger pulses of 'voltage', but not to one of 0\.001"):
        found = linearize(fmus.path("PositionServo"), **settings)
    monkeypatch.setattr(Instance, "update", usual)
    known = linearize(fmus.path("PositionServo"), **settings)
    late = [(m.C @ np.linalg.matrix_power(m.A, 50) @ m.B).item() for m in (found, known)]
    assert late[0] == pytest.approx(late[1], rel=0.05)


@pytest.mark.parametrize(
    ("name", "words"),
    [("HydroTurbine", "differ too much for a linear model"), ("TwoMasses", "No input moves")],
)
def test_outputs_that_are_rounded_too_coarsely_are_said(monkeypatch, name, words):
    usual = Instance.output

    def rounded(self, inputs, outputs, t):
        status = usual(self, inputs, outputs, t)
        outputs[:] = np.round(outputs / 1e-3) * 1e-3
        return status

    without_cache(monkeypatch)
    monkeypatch.setattr(Instance, "output", rounded)
    *_, measured, actuated, _ = PLANTS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # there is no model of which a warning could speak
        with pytest.raises(
            ModelError, match=rf"{words}.*outputs are rounded.*dead band.*\[known\.plant\].*from a record"
        ):
            linearize(fmus.path(name), measured=measured, actuated=actuated)


def test_process_noise_comes_in_where_it_is_said():
    model = LinearModel.from_fmu(
        fmus.path("PositionServo"), measured="angle", actuated="voltage", noise={"load": 0.1}, sensor_std=[0.02]
    )
    both = linearize(fmus.path("PositionServo"), measured="angle", actuated=["voltage", "load"])
    Q = model.matrix("process_covariance")
    np.testing.assert_allclose(np.linalg.eigvalsh(Q)[:-1], 0.0, atol=1e-15)
    # The output's variance after some steps, which no choice of states changes.
    C, A, load = model.matrix("C"), model.matrix("A"), both.B[:, 1]
    ours = sum((C @ np.linalg.matrix_power(A, k) @ Q @ np.linalg.matrix_power(A, k).T @ C.T).item() for k in range(20))
    theirs = sum((0.1 * both.C @ np.linalg.matrix_power(both.A, k) @ load).item() ** 2 for k in range(20))
    assert ours == pytest.approx(theirs, rel=1e-5)
    assert model.matrix("sensor_covariance").item() == pytest.approx(4e-4)


def test_the_usual_noise_is_a_share_of_what_a_control_may_do():
    """In any unit of the control: a motor in microvolts needs no other model than one in volts."""
    motor = control.tf([1.0], [1.0, 1.0, 0.0], inputs=["u"], outputs=["y"])
    settings = {"measured": "y", "actuated": "u", "dt": 0.1}
    for scale in (1e-6, 1.0, 1e6):
        scaled = control.ss(control.ss(motor) * (1 / scale), inputs=["u"], outputs=["y"])
        for limits in ({"acceptable_control": 2.0 * scale}, {"u_min": -scale, "u_max": 3.0 * scale}):
            Q = design(scaled, **settings, **limits).model.matrix("process_covariance")
            known = design(motor, **settings, noise={"u": 0.1}).model
            ours = design(scaled, **settings, **limits).model.matrix("C")
            assert (ours @ Q @ ours.T).item() == pytest.approx(
                (known.matrix("C") @ known.matrix("process_covariance") @ known.matrix("C").T).item(), rel=1e-9
            )


def test_systems_of_python_control():
    A, B, C, *_ = PLANTS["CartPendulum"]
    linear = control.ss(A, B, C, 0, inputs=["force"], outputs=["position", "angle"])
    controller = design(
        linear, measured=["position", "angle"], actuated="force", goal="position", dt=0.02, acceptable_error=0.2
    )
    sampled = control.sample_system(linear, 0.02)
    gain, _, _ = control.dlqr(sampled.A, sampled.B, np.diag([25.0, 0, 0, 0]), np.eye(1))
    np.testing.assert_allclose(controller.regulator.gain, gain, rtol=1e-7)

    def swing(t, x, u, params):
        return [x[1], u[0] - 9.81 * np.sin(x[0]) - 0.5 * x[1]]

    hanging = control.NonlinearIOSystem(swing, lambda t, x, u, p: x[:1], inputs=["u"], outputs=["angle"], states=2)
    found = linearize(hanging, measured="angle", actuated="u", dt=0.05, at={"u": 9.81 / 2})
    np.testing.assert_allclose(found.x, [np.pi / 6, 0.0], atol=1e-8)
    local = [[0, 1], [-9.81 * np.cos(np.pi / 6), -0.5]]
    np.testing.assert_allclose(found.A, expm(0.05 * np.array(local)), atol=1e-10)
    controller = design(hanging, measured="angle", actuated="u", dt=0.05, at={"u": 9.81 / 2})
    np.testing.assert_array_equal(controller.initial_mean, [0.0, 0.0, 1.0])  # where it starts, and the constant


def car(unit=1.0):
    """A car with drag, 0.4 v |v| + 100 N against 1200 kg; its speed in units of so many m/s."""

    def drives(t, x, u, params):
        speed = unit * x[1]
        return [speed, (u[0] - 0.4 * speed * abs(speed) - 100.0) / 1200.0 / unit]

    return control.NonlinearIOSystem(drives, None, inputs=["force"], outputs=["x", "v"], states=2)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_a_car_is_linearised_in_motion(unit):
    """Its position goes on all the while; at 260 N it goes 20 m/s."""
    plant = cosim.StateSpace(car(unit), initial=[0.0, 18.0 / unit], feedthrough=False)
    found = linearize(plant, measured=["x", "v"], actuated="force", dt=0.1, at={"force": 260.0})
    np.testing.assert_allclose(found.x, [0.0, 20.0 / unit], rtol=1e-7)
    np.testing.assert_allclose(found.following, [2.0, 20.0 / unit], rtol=1e-7)
    assert found.u[0] == 260.0
    rate = np.array([[0, unit, 0], [0, -0.8 * 20 / 1200, 1 / 1200 / unit], [0, 0, 0]])
    np.testing.assert_allclose(found.A, expm(0.1 * rate)[:2, :2], rtol=1e-6)
    np.testing.assert_allclose(found.B, expm(0.1 * rate)[:2, 2:], rtol=1e-6)
    # Without the position among the outputs there is none in the model.
    alone = linearize(plant, measured="v", actuated="force", dt=0.1, at={"force": 260.0})
    assert alone.following is None
    np.testing.assert_allclose(alone.A, found.A[1:, 1:])
    np.testing.assert_allclose(alone.start, [18.0 / unit])


def test_cruise_control():
    """A goal on the speed alone, with the position measured too: it goes on, and the law is that of the speed."""
    plant = cosim.StateSpace(car(), initial=[0.0, 18.0], feedthrough=False)
    settings = {"actuated": "force", "goal": "v", "dt": 0.1, "at": {"force": 260.0}, "acceptable_control": 300.0}
    fixed = controllers.FixedPrecision()
    controller = design(
        plant, measured=["x", "v"], sensor_std=[1.0, 0.1], disturbance=100.0, precision=fixed, **settings
    )
    alone = design(plant, measured="v", **settings)
    assert "do not depend on 1 of the plant's integrators" in controller.describe()
    np.testing.assert_allclose(controller.regulator.gain, [[0.0, *alone.regulator.gain[0]]], rtol=1e-9)
    loop = cosim.closed_loop(
        plant,
        controller,
        control="force",
        measured=["x", "v"],
        sensors=cosim.Sensors(2, [1.0, 0.1]),
        dt=0.1,
        reference=cosim.Step(time=20.0, before=20.0, after=25.0),
    )
    result = loop.simulate(60.0, seed=1)
    assert result["plant.v"][150:200] == pytest.approx(20.0, abs=0.3)
    assert result["plant.v"][-50:] == pytest.approx(25.0, abs=0.3)
    assert result["plant.x"][-1] > 1200.0


def test_derivatives_in_any_units_and_at_kinks():
    point, scale = np.array([0.5, 1e-9, 3e7]), np.array([1.0, 1e-9, 1e7])

    def f(z):
        a, b, c = z / scale
        return np.array([np.sin(a) * b, np.exp(c) + a, np.sqrt(c - 2.9)])

    a, b, c = point / scale
    known = [[np.cos(a) * b, np.sin(a), 0], [1, 0, np.exp(c)], [0, 0, 0.5 / np.sqrt(c - 2.9)]]
    np.testing.assert_allclose(derivative(f, point), known / scale, rtol=1e-8, atol=1e-16)
    with pytest.warns(PoorFitWarning, match="kink"):
        derivative(lambda z: np.abs(z - 0.5), np.array([0.5]))
    for speed in (0.0, 1e-12, 1e-10, 1e-9, 1e-6, 0.1):  # a drag is smooth, also beside its zero
        assert derivative(lambda v: -0.3 * v * np.abs(v), np.array([speed])) == pytest.approx(-0.6 * speed, abs=1e-9)
    with pytest.raises(ModelError, match="cannot be evaluated near"):
        derivative(lambda z: np.where(z == 0.5, z, np.nan), np.array([0.5]))


def test_a_linear_car_of_which_only_the_speed_is_measured():
    car = control.ss([[0, 1], [0, -0.1]], [[0], [1]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"])
    controller = design(car, measured="v", actuated="force", dt=0.1)
    assert controller.model.states == 1
    gain, _, _ = control.dlqr(*(controller.model.matrix(name) for name in "AB"), 100 * np.eye(1), np.eye(1))
    np.testing.assert_allclose(controller.regulator.gain, gain, rtol=1e-9)
    with pytest.raises(ModelError, match="zero at 1"):  # standing, at any angle but upright it must go ever faster
        design(fmus.path("CartPendulum"), measured=["position", "angle"], actuated="force", goal="angle")


def test_inputs_that_are_given_are_kept():
    falls = control.NonlinearIOSystem(
        lambda t, x, u, p: [x[1], u[0] - 9.81], None, inputs="u", outputs=["z", "v"], states=2
    )
    found = linearize(falls, measured="z", actuated="u", dt=0.1)
    assert found.u[0] == pytest.approx(9.81)
    with pytest.raises(ModelError, match="No steady state was found"):
        linearize(falls, measured="z", actuated="u", dt=0.1, at={"u": 5.0})


@pytest.mark.slow
def test_faults_of_a_slow_plant_last_as_many_samples():
    tank = control.tf([1], [3600.0, 1.0], inputs=["inflow"], outputs=["level"])  # an hour
    slow = controllers.design(tank, measured="level", actuated="inflow", dt=60.0, noise={"inflow": 0.1}, sensors=2)
    assert slow.precision.paced(60.0) == controllers.SwitchingPrecision().slowed(3000.0)
    fast = controllers.design(tank, measured="level", actuated="inflow", dt=0.01, noise={"inflow": 0.1}, sensors=2)
    assert fast.precision == controllers.SwitchingPrecision()
    loop = cosim.closed_loop(
        cosim.StateSpace(tank), slow, control="inflow", measured="level", sensors=cosim.Sensors(2, 0.01),
        faults=[cosim.Injection(sensor=1, start=3600.0, magnitude=0.3)], reference=1.0, dt=60.0,
    )  # fmt: skip
    probability = loop.simulate(7200.0, seed=1, engine="interpreted")["controller.fault_probability"]
    assert probability[-1, 1] > 0.99 > 0.01 > probability[-1, 0]


def test_of_a_linear_model_the_sensors_have_numbers():
    model = LinearModel([[1, 0.1], [0, 1]], [[0.005], [0.1]], [[1, 0], [1, 0], [0, 1]], [1e-6, 1e-6], 1e-4, dt=0.1)
    controller = design(model, goal=[1])
    np.testing.assert_array_equal(controller.goal_matrix, [[1, 0]])
    np.testing.assert_array_equal(design(model, goal=[[1, 0]]).goal_matrix, [[1, 0]])
    assert isinstance(controller.precision, controllers.SwitchingPrecision)
    with pytest.raises(ModelError, match=r"2 goals but only 1 control.* such as goal=\[0\]"):
        design(model)
    with pytest.raises(ModelError, match="numbers of sensors, from 0 to 2"):
        design(model, goal=[3])
    with pytest.raises(ModelError, match="no names"):
        design(model, goal="angle")
    with pytest.raises(ModelError, match="leave measured= out"):
        design(model, measured="angle")
    named = replace(model, names=SignalNames(["torque"], ["angle", "angle", "rate"], ["a", "r"]))
    np.testing.assert_array_equal(design(named, goal="angle").goal_matrix, [[1, 0]])
    np.testing.assert_array_equal(design(named, goal=["rate"]).goal_matrix, [[0, 1]])
    with pytest.raises(UnknownNameError, match="no sensor 'angel'; did you mean 'angle'"):
        design(named, goal="angel")


def test_a_redundant_sensor_fails_and_the_servo_stays():
    """One call makes it; a frozen sensor then costs a controller with fixed precisions its goal, and not this one."""
    servo = cosim.FMU(fmus.path("PositionServo"))
    far = {}
    for precision in (None, controllers.FixedPrecision()):
        controller = design(servo, measured="angle", actuated="voltage", sensors=2, precision=precision)
        loop = cosim.closed_loop(
            servo,
            controller,
            control="voltage",
            measured="angle",
            sensors=cosim.Sensors(count=2, std=0.01),
            faults=[cosim.Injection(sensor=0, start=1.0, stop=3.0, magnitude=0.5)],
            reference=1.0,
        )
        result = loop.simulate(3.0, seed=1)
        far[precision] = np.sqrt(np.mean((result["plant.angle"][200:300] - 1.0) ** 2))
        if precision is None:
            assert result["controller.fault_probability"][150:300, 0].min() > 0.9
            assert result["controller.fault_probability"][150:300, 1].max() < 0.1
    assert far[None] < 0.02
    assert min(far.values()) < 0.1 * max(far.values())


TWO = control.ss(0.9 * np.eye(2), np.eye(2), np.eye(2), 0, 0.1)
BLIND = control.ss([[-1.0]], [[1.0]], [[0.0]], 0)


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"measured": None, "plant": cosim.FMU(fmus.path("PositionServo"))}, ModelError, r"s measured=.*: angle, speed, current"),
        ({"measured": "angel"}, UnknownNameError, "did you mean 'angle'"),
        ({"measured": "angel", "dt": "soon"}, UnknownNameError, "did you mean 'angle'"),
        ({"actuated": []}, ModelError, "actuated=.*at least one variable"),
        ({"measured": ["angle", "angle"]}, ModelError, "each once"),
        ({"actuated": None}, ModelError, r"needs actuated=, names of inputs of the plant \(known: voltage, load\)"),
        ({"measured": "speed"}, None, None),
        ({"sensors": 0}, ModelError, "at least 1"),
        ({"at": {"volts": 1.0}}, UnknownNameError, "volts"),
        ({"acceptable_error": 0.0}, ModelError, "must be positive"),
        ({"goal": ["angle", "speed"]}, ModelError, "2 goals but only 1 control"),
        ({"measured": ["speed", "angle"]}, ModelError, r'2 goals but only 1 control.* such as goal=\["speed"\]'),
        ({"dt": "soon"}, StepSizeError, "soon"),
        ({"sensor_std": -0.01}, ModelError, "must not be negative"),
        ({"sensors": 2, "sensor_std": [0.1] * 3}, ModelError, "std has 3 numbers for 2 sensors of 1 output; give one number"),
        ({"sensor_std": 0.0}, ModelError, r"sensor_std is \[0.0\]; a sensor without noise"),
        ({"precision": "fixed"}, ModelError, r"precision is 'fixed'; .* for a Kalman filter, FixedPrecision\(\)"),
        ({"plant": (np.eye(2), np.eye(2))}, ModelError, r"^The plant must be an FMU .*control.ss\(A, B, C, D, dt\), or a Line"),
        ({"plant": (np.eye(2), np.eye(2)), "measured": None}, ModelError, "^The plant must be an FMU"),
        ({"actuated": None, "noise": {"u0": 1.0, "u1": 1.0}, "plant": TWO}, ModelError, r"needs actuated=.*: u0, u1\)"),
        ({"measured": "z", "actuated": "u[0]", "plant": TWO}, UnknownNameError, "known names: y0, y1"),
        ({"plant": BLIND, "measured": "y", "actuated": "u", "dt": 0.1}, ModelError, "y: no state of the model moves"),
        ({"noise": 0.1}, ModelError, r"a number for each input by name, as noise=\{'load'"),
        ({"at": 0.1}, ModelError, r"a number for each input by name, as at="),
        ({"u_min": 5.0, "u_max": -5.0}, ModelError, "u_min is 5, above its u_max of -5"),
        ({"u_min": None}, ModelError, "u_min is None; it must be a number or a list of numbers, infinite for no limit"),
    ],
)  # fmt: skip
def test_wrong_settings_are_said_in_a_sentence(settings, error, words):
    make = {"plant": fmus.path("PositionServo"), "measured": "angle", "actuated": "voltage"} | settings
    plant = make.pop("plant")
    if error is None:  # the speed alone is a plant of its own, in which the angle has no place
        assert design(plant, **make).model.states == 2
        return
    with pytest.raises(error, match=words):
        design(plant, **make)


def test_without_a_choice_no_names_are_needed():
    of_car = {"plant": fmus.path("CruiseControl"), "noise": {"disturbance": 0.1}}
    for given, names in [
        ({"plant": TWO}, (("u0", "u1"), ("y0", "y1"))),
        ({"plant": TWO, "noise": {"u1": 0.1}, "goal": "y0"}, (("u0",), ("y0", "y1"))),
        (of_car, (("force",), ("v",))),
    ]:
        model = design(**given).model
        assert (model.names.controls, model.names.sensors) == names


def test_a_wrong_argument_gets_similar_names_and_warnings_the_line_of_the_user():
    with pytest.raises(TypeError, match="design has no argument 'goals'; did you mean 'goal'"):
        controllers.design(fmus.path("PositionServo"), measured="angle", actuated="voltage", goals="angle")
    falls = cosim.FMU(fmus.path("CartPendulum"), parameters={"angle_0": 0.1, "b": 0.02})
    with pytest.warns(UserWarning, match="is not steady at its start") as warned:
        controllers.design(falls, measured=["position", "angle"], goal="position", actuated="force")
    assert {each.filename for each in warned} == {__file__}
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Constant(1.0))
    with pytest.raises(TypeError, match="simulate has no argument 'seeds'; did you mean 'seed'"):
        diagram.simulate(1.0, seeds=3)
    with pytest.raises(TypeError, match=r"simulate lacks the argument 'duration'; write simulate\(duration=...\)"):
        diagram.simulate()


def test_the_belief_about_a_model_of_values_begins_at_its_operating_point():
    about = LinearModel([[0.95]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1).about([350.0], [175.0], [350.0, 350.0])
    for model, settings in ((about, {}), (about, {"disturbance": 1.0}), (about.with_disturbance(1.0), {})):
        assert controllers.design(model, **settings).initial_mean[0] == 350.0
    assert controllers.design(about, input_delays=1).initial_mean[:2].tolist() == [350.0, 175.0]
    assert controllers.design(about, initial_mean=340.0).initial_mean[0] == 340.0


def test_offsets_of_sensors_are_states_that_nobody_knows_at_the_start():
    """A compass of three is 2 degrees off: the steady filter of its model knows that after days, a new controller does not."""
    ship = control.ss(
        [[0, 1], [0, -0.05]],
        [[0, 0], [0.01, 0.05]],
        [[1, 0], [0, 1]],
        0,
        inputs=["rudder", "waves"],
        outputs=["psi", "r"],
    )
    given = {
        "measured": ["psi", "r"], "actuated": "rudder", "goal": "psi", "sensors": [3, 1], "sensor_std": [0.1, 1.0, 0.3, 0.05],
        "dt": 0.5, "noise": {"waves": 0.5}, "acceptable_error": 1.0, "acceptable_control": 10.0,
    }  # fmt: skip
    bias = [0.0, 2.0, 0.0, 0.0]
    results = []
    for controller in (design(ship, **given), design(ship, sensor_bias=bias, **given)):
        loop = cosim.closed_loop(
            ship, controller, control="rudder", measured=["psi", "r"], noise={"waves": cosim.Gaussian(std=0.5)},
            sensors=cosim.Sensors([3, 1], given["sensor_std"], bias=bias), reference=cosim.Step(time=20.0, after=20.0),
        )  # fmt: skip
        results.append(loop.simulate(100.0, seed=1)["controller.fault_probability"][:, 1])
    assert (results[0][100:] > 0.5).mean() > 0.9
    assert (results[1] < 0.5).all()
    model = controller.model
    assert model.state_names[-1] == "sensor_error[1]"
    assert np.asarray(controller.initial_covariance)[-1, -1] == pytest.approx(4.0)
    own = design(design(ship, **given).model, goal=[0], sensor_bias=bias, acceptable_error=1.0, acceptable_control=10.0)
    np.testing.assert_array_equal(own.model.matrix("A"), model.matrix("A"))
    np.testing.assert_array_equal(own.goal_matrix, controller.goal_matrix)


def test_the_offset_of_a_plant_about_an_operating_point_stands_before_the_constant():
    controller = design(
        fmus.path("CruiseControl"), actuated="force", at={"force": 1000.0}, sensors=2, sensor_bias=[0.0, 0.5]
    )
    assert controller.model.state_names[-2:] == ("sensor_error[1]", "constant")
    assert controller.goal_matrix[0, -2:].tolist() == pytest.approx([0.0, float(controller.goal_matrix[0, -1])])
    with pytest.raises(ModelError, match="must be 0 \\(no offset\\) or positive"):
        design(fmus.path("CruiseControl"), actuated="force", sensors=2, sensor_bias=-1.0)


@pytest.mark.parametrize("dt", [0.001, 0.01])
def test_a_drift_of_a_sensor_with_an_offset_is_found_and_no_error_of_the_model(dt):
    cart = control.ss([[0, 1], [0, -1]], [[0], [1]], [[1, 0]], 0, inputs=["force"], outputs=["x"])
    controller = design(
        cart, measured="x", actuated="force", sensors=3, sensor_std=0.01, sensor_bias=[0, 0.1, 0], dt=dt
    )
    loop = cosim.closed_loop(
        cart, controller, control="force", measured="x", sensors=cosim.Sensors(3, 0.01, bias=[0, 0.1, 0]),
        faults=[cosim.Drift(sensor=1, start=10.0, slope=0.02)], reference=0.0,
    )  # fmt: skip
    result = loop.simulate(20.0, seed=1)
    assert (result["controller.fault_probability"][result.time > 17.0][:, 1] > 0.9).all()
    assert (result["controller.fault_probability"][:, [0, 2]] > 0.5).mean() < 0.01
    assert result["controller.model_suspect"].max() < 0.5


def test_an_offset_of_all_sensors_is_refused():
    with pytest.raises(ModelError, match="all sensors have an offset"):
        design(fmus.path("CruiseControl"), actuated="force", sensors=2, sensor_bias=0.5)


@pytest.mark.parametrize("time_constant", [1e3, 1e9])
def test_a_sensor_whose_error_hardly_changes_has_an_observer_of_its_own(time_constant):
    """All sensors were compared at once, and a fault of one made the model suspect."""
    model = LinearModel([[0.99]], [[0.1]], [[1.0]] * 3, 1e-3, 0.01, dt=0.5)
    bank = observers(model.with_sensor_errors(2.0, time_constant=time_constant, sensors=[1]))
    assert bank.sensors == ((0,), (1,), (2,))


@pytest.mark.parametrize("coupling", [0.0, 1e-20, 1e-15, 1e-10])
def test_a_state_that_noise_hardly_reaches_has_an_initial_covariance(coupling):
    """One that only rounding couples to the noise had none, and no steady filter."""
    A = [[0, coupling, 0], [0, -1, 0], [0, 0, -0.5]]
    plant = control.ss(A, [[1, 0], [0, 1], [0, 0]], [[1, 0, 0], [0, 1, 0]], 0, inputs=["u", "gust"], outputs=["x", "v"])
    controller = design(
        plant, measured=["x", "v"], actuated="u", goal="x", dt=0.1, sensors=[1, 1], sensor_std=1.0, noise={"gust": 1.0},
        acceptable_error=1.0, acceptable_control=1.0,
    )  # fmt: skip
    assert 1e-4 < controller.initial_covariance[0, 0] ** 0.5 < 0.1


@pytest.mark.parametrize("unit", [1.0, 1.0 / 206265.0, 1e6])
def test_the_initial_covariance_does_not_depend_on_units(unit):
    """The gusts of a telescope are in N m; noise in the same number for all states was 13 arcsec of an angle in rad."""
    arcsec, inertia = 206265.0 * unit, 400.0
    A = np.array([[0, 1, 0], [0, -20 / inertia, arcsec / inertia], [0, 0, -0.2]])
    plant = control.ss(
        A, [[0, 0], [arcsec / inertia, 0], [0, 0.2]], [[1.0, 0, 0]], 0, inputs=["torque", "gust"], outputs=["angle"]
    )
    controller = design(
        plant, measured="angle", actuated="torque", dt=0.02, sensors=2, sensor_std=unit, noise={"gust": 110.0, "torque": 0.5},
        acceptable_error=unit, acceptable_control=10.0,
    )  # fmt: skip
    model, states = controller.model, np.array([unit, unit, 1.0])
    A, Q = model.A / states[:, None] * states, model.process_covariance / np.outer(states, states)
    P = solve_discrete_are(A.T, (model.C * states / unit).T, Q, np.eye(2))
    start = controller.initial_covariance / np.outer(states, states)
    np.testing.assert_allclose(np.sqrt(np.diag(start)), np.sqrt(10.0 * np.diag(P)), rtol=1e-3)


@pytest.mark.parametrize("dt", [0.002, 0.001])
def test_an_integration_that_diverges_is_named(dt):
    """A winding of .1 ms in substeps of 1 ms: it was called a step that is too long, or a control without effect."""
    quick = {"J": 4e-4, "b": 1e-4, "K": 0.05, "R": 1.0, "L": 1e-4}
    servo = cosim.FMU(fmus.path("PositionServo"), parameters=quick)
    settings = {"measured": "angle", "actuated": "voltage", "sensors": 2, "dt": dt}
    with pytest.raises(cosim.ModelError, match="shorter ones \\(max_substep of a shipped FMU\\)"):
        controllers.design(servo, **settings)
    right = cosim.FMU(fmus.path("PositionServo"), parameters=quick | {"max_substep": 1e-5})
    assert controllers.design(right, **settings).model.states > 1
