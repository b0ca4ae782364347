"""The goal that looks ahead: the one-step posterior is the regulator's law, goals are on outputs, refusals are sentences."""

import pickle
import warnings

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from bayesftc import controllers, cosim
from bayesftc.controllers import BayesianController, FixedPrecision, LinearModel, LQGController
from bayesftc.cosim.errors import ModelError


def sampled(A, B, C, dt, sensors=1):
    """The model of a continuous plant, with noise on its inputs."""
    plant = control.sample_system(control.ss(A, B, C, 0), dt, method="zoh")
    noise = 1e-3 * plant.B @ plant.B.T + 1e-8 * np.eye(len(A))
    return LinearModel(plant.A, plant.B, np.tile(plant.C, (sensors, 1)), noise, 1e-4, dt=dt)


def servo(dt=0.01):
    """A position servo: a voltage, a current that follows within 0.05 s, a shaft with friction."""
    return sampled([[0, 1, 0], [0, -2, 2], [0, 0, -20]], [[0], [0], [20]], [[1, 0, 0]], dt, sensors=2)


def two_masses(dt=0.02):
    """Two masses with a spring between them; a force on the first, the place of the second."""
    A = [[0, 1, 0, 0], [-100, -1, 100, 1], [0, 0, 0, 1], [100, 1, -100, -1]]
    return sampled(A, [[0], [1], [0], [0]], [[0, 0, 1, 0]], dt)


def pendulum(dt=0.02):
    """A pendulum that stands on a cart, linearised upright; place of the cart and angle are measured."""
    A = [[0, 1, 0, 0], [0, -0.1, 1.0, 0], [0, 0, 0, 1], [0, -0.2, 20.0, 0]]
    return sampled(A, [[0], [1], [0], [2]], [[1, 0, 0, 0], [0, 0, 1, 0]], dt)


def wrong_way(dt=0.05):
    """A plant that first goes the wrong way: (1 - s) / ((1 + s) (1 + 0.5 s))."""
    plant = control.ss(control.tf([-1, 1], [0.5, 1.5, 1]))
    return sampled(plant.A, plant.B, plant.C, dt)


PLANTS = {
    "servo": (servo(), [0]),
    "two masses": (two_masses(), [0]),
    "pendulum": (pendulum(), [0]),
    "wrong way": (wrong_way(), [0]),
}


@pytest.mark.parametrize("name", PLANTS)
def test_the_one_step_posterior_is_the_regulators_law(name):
    model, goals = PLANTS[name]
    A, B, H = model.matrix("A"), model.matrix("B"), model.matrix("C")[goals]
    controller = LQGController(model, FixedPrecision(), goal_on=H, goal_covariance=0.04, control_covariance=0.5)
    gain, cost, poles = control.dlqr(A, B, H.T @ H / 0.04, np.eye(1) / 0.5)
    step, rng = controller.online(compiled=False), np.random.default_rng(1)
    steady = np.linalg.solve(np.block([[np.eye(len(A)) - A, -B], [H, np.zeros((1, 1))]]), np.eye(len(A) + 1)[:, -1])
    x_ss, u_ss = steady[: len(A)], steady[len(A) :]
    goal = np.zeros(1)
    for k in range(40):
        given = np.array([np.nan]) if k == 7 else rng.normal(size=1)
        goal = goal if k == 7 else given  # no goal: the last one holds
        out = step(y=rng.normal(size=model.sensors), goal=given)
        law = u_ss * goal - gain @ (np.ravel(out.x_hat) - x_ss * goal)
        np.testing.assert_allclose(np.atleast_1d(out.u), law, rtol=1e-9, atol=1e-9 * np.abs(gain).max())
    np.testing.assert_allclose(controller.regulator.cost_to_go, cost, rtol=1e-7, atol=1e-9 * cost.max())
    found = controller.closed_loop_poles()
    for pole in poles:
        assert np.abs(found - pole).min() < 1e-6
    assert np.abs(found).max() < 1


@pytest.mark.sampled(1)
@pytest.mark.parametrize("belief", ["filtered", "joint"])
@pytest.mark.parametrize("name", PLANTS)
def test_poles_that_are_shown_are_those_of_control_and_filter(name, belief):
    """Apart, each by a Riccati equation of its own; and of the loop as it runs, whose steps tell its matrix."""
    model, goals = PLANTS[name]
    A, B, C = (model.matrix(name) for name in "ABC")
    controller = LQGController(
        model, FixedPrecision(), goal_on=C[goals], goal_covariance=0.04, control_covariance=0.5, belief=belief
    )
    P = solve_discrete_are(A.T, C.T, model.matrix("process_covariance"), model.matrix("sensor_covariance"))
    gain = np.linalg.solve(C @ P @ C.T + model.matrix("sensor_covariance"), C @ P).T
    known = np.append(np.linalg.eigvals(A - B @ controller.regulator.gain), np.linalg.eigvals(A - A @ gain @ C))
    shown = controller.closed_loop_poles()
    assert len(shown) == len(known)
    assert max(np.abs(shown - pole).min() for pole in known) < 1e-8
    # The loop's state is the plant's and the prediction; from the steady belief on each step is the same matrix.
    n, step = len(A), controller.online(compiled=False)
    rng, x, states = np.random.default_rng(0), np.zeros(n), []
    for k in range(600 + 60 * n):
        if k >= 600 and (k - 600) % 30 == 0:
            x = x + rng.normal(size=n)
        out = step(y=C @ x, goal=np.zeros(len(goals)))
        following = A @ x + B @ np.atleast_1d(out.u)
        predicted = A @ np.ravel(out.x_hat) + B @ np.atleast_1d(out.u)
        states.append([*x, *predicted])
        x = following
    now = np.array(states)
    pairs = [k for k in range(600, len(now) - 1) if (k + 1 - 600) % 30]
    # A prediction belongs to the next sample: (x_k, prediction of x_k) -> (x_k+1, prediction of x_k+1).
    here = np.array([[*now[k, :n], *now[k - 1, n:]] for k in pairs])
    there = np.array([[*now[k + 1, :n], *now[k, n:]] for k in pairs])
    scale = np.abs(here).max(axis=0)
    loop = np.linalg.lstsq(here / scale, there / scale, rcond=1e-12)[0].T
    found = np.linalg.eigvals(loop)
    assert max(np.abs(found - pole).min() for pole in shown) < 1e-5


@pytest.mark.sampled(8)
@pytest.mark.parametrize("seed", range(25))
def test_the_law_of_random_plants_in_any_units(seed):
    """Up to 6 states, 3 controls and as many goals or fewer, spectral radius up to 1.2, units from 1e-3 to 1e3."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    r = int(rng.integers(1, min(n, p) + 1))
    units = 10 ** rng.uniform(-3, 3, n)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.3, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    A, B = A * np.outer(units, 1 / units), rng.normal(size=(n, p)) * units[:, None]
    H, C = rng.normal(size=(r, n)) / units, np.diag(1 / units)
    model = LinearModel(A, B, C, 1e-4 * units**2, 1e-2, dt=0.1)
    covariances = rng.uniform(0.01, 1.0, r), rng.uniform(0.1, 10.0, p)
    belief = "joint" if seed % 2 else "filtered"
    controller = LQGController(
        model,
        FixedPrecision(),
        goal_on=H,
        goal_covariance=covariances[0],
        control_covariance=covariances[1],
        belief=belief,
    )
    cost = H.T @ np.diag(1 / covariances[0]) @ H
    gain, _, _ = control.dlqr(A, B, (cost + cost.T) / 2, np.diag(1 / covariances[1]))
    goal = rng.normal(size=r)
    out = controller.online(compiled=False)(y=rng.normal(size=n), goal=goal)
    # The cheapest steady state: minimise u' R u subject to it, by the equations of Lagrange.
    hold = np.block([[np.eye(n) - A, -B], [H, np.zeros((r, p))]])
    price = np.diag(np.concatenate([np.zeros(n), 1 / covariances[1]]))
    whole = np.block([[price, hold.T], [hold, np.zeros((n + r, n + r))]])
    scale = np.concatenate([units, np.ones(p), 1 / units, np.ones(r)])
    whole, rhs = whole * np.outer(scale, scale), np.concatenate([np.zeros(2 * n + p), goal])
    steady = np.linalg.lstsq(whole, rhs * scale, rcond=1e-14)[0] * scale
    law = steady[n : n + p] - gain @ (np.ravel(out.x_hat) - steady[:n])
    np.testing.assert_allclose(np.atleast_1d(out.u), law, rtol=1e-9, atol=1e-9 * np.abs(law).max())


def test_a_goal_on_the_speed_alone_leaves_the_position_to_itself():
    """Cruise control: the law is that of the car without its position, which goes on and on."""
    A, B, C = [[0, 1, 0], [0, -0.05, 0.5], [0, 0, -2.0]], [[0], [0], [2.0]], [[1, 0, 0], [0, 1, 0]]
    model = sampled(A, B, C, 0.1)
    speed = control.sample_system(control.ss(np.array(A)[1:, 1:], B[1:], [[1, 0]], 0), 0.1)
    controller = LQGController(
        model, FixedPrecision(), goal_on=[[0, 1, 0]], goal_covariance=0.04, control_covariance=0.5
    )
    gain, cost, poles = control.dlqr(speed.A, speed.B, speed.C.T @ speed.C / 0.04, np.eye(1) / 0.5)
    np.testing.assert_allclose(controller.regulator.gain, np.hstack([[[0.0]], gain]), rtol=1e-9)
    np.testing.assert_allclose(controller.regulator.cost_to_go[1:, 1:], cost, rtol=1e-9)
    text = controller.describe()
    assert "do not depend on 1 of the plant's integrators" in text
    assert "0.999" not in text.splitlines()[0] + text.splitlines()[1]
    assert np.abs(poles).max() == pytest.approx(np.abs(controller.regulator.poles(model.A, model.B)).max())
    hold = np.linalg.solve(np.block([[np.eye(2) - speed.A, -speed.B], [speed.C, np.zeros((1, 1))]]), [0, 0, 1.0])
    step, x = controller.online(compiled=False), np.array([1e6, 0.0, 0.0])
    for _ in range(300):
        out = step(y=model.C @ x, goal=[25.0])
        law = 25.0 * hold[2:] - gain @ (out.x_hat[1:] - 25.0 * hold[:2])
        np.testing.assert_allclose(np.atleast_1d(out.u), law, rtol=1e-9, atol=1e-9 * np.abs(gain).max())
        x = model.A @ x + model.B @ np.atleast_1d(out.u)
    assert x[1] == pytest.approx(25.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_integrators_that_no_goal_sees_in_any_units(seed):
    """Chains of one to three of them, driven by up to 4 other states of up to 2 controls, in mixed coordinates."""
    rng = np.random.default_rng(seed)
    k, n, p = int(rng.integers(1, 4)), int(rng.integers(1, 5)), int(rng.integers(1, 3))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.3, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    B, H = rng.normal(size=(n, p)), rng.normal(size=(1, n))
    chain = np.eye(k) + 0.1 * np.eye(k, k=1)
    driven = np.vstack([np.zeros((k - 1, n)), 0.1 * rng.normal(size=(1, n))])
    mix = np.linalg.qr(rng.normal(size=(n + k, n + k)))[0]
    T = 10 ** rng.uniform(-2, 2, n + k)[:, None] * mix
    back = np.linalg.inv(T)
    whole = T @ np.block([[chain, driven], [np.zeros((n, k)), A]]) @ back
    model = LinearModel(
        whole, T @ np.vstack([np.zeros((k, p)), B]), back, 1e-4 * T @ T.T, 1e-4, dt=0.1
    )  # fmt: skip
    controller = LQGController(
        model, FixedPrecision(), goal_on=np.hstack([np.zeros((1, k)), H]) @ back, goal_covariance=0.04
    )
    assert controller.regulator.drifting == k
    gain, _, poles = control.dlqr(A, B, H.T @ H / 0.04, np.eye(p))
    np.testing.assert_allclose(
        controller.regulator.gain @ T, np.hstack([np.zeros((p, k)), gain]), atol=1e-9 * np.abs(gain).max()
    )
    found = controller.regulator.poles(model.A, model.B)
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(poles)), atol=1e-8)
    assert np.abs(controller._relevant_poles()).max() < 1
    x = rng.normal(size=n + k)
    out = controller.online(compiled=False)(y=back @ x, goal=[2.0])
    price = np.block([[np.zeros((n, n + p))], [np.zeros((p, n)), np.eye(p)]])
    hold = np.block([[np.eye(n) - A, -B], [H, np.zeros((1, p))]])
    lagrange = np.block([[price, hold.T], [hold, np.zeros((n + 1, n + 1))]])
    steady = np.linalg.solve(lagrange, np.append(np.zeros(2 * n + p), 2.0))
    law = steady[n : n + p] - gain @ ((back @ np.ravel(out.x_hat))[k:] - steady[:n])
    np.testing.assert_allclose(np.atleast_1d(out.u), law, rtol=1e-9, atol=1e-9 * np.abs(law).max())


@pytest.mark.parametrize(("make", "radius"), [(servo, 3.5), (two_masses, 5.3)])
def test_a_goal_for_the_next_step_alone_is_short_sighted(make, radius):
    model = make()
    goal = {"goal_on": model.matrix("C")[:1], "goal_covariance": 1e-9}
    with pytest.warns(controllers.UnstableLoopWarning):
        naive = BayesianController(model, **goal)
    assert np.abs(naive.closed_loop_poles()).max() == pytest.approx(radius, abs=0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.abs(LQGController(model, **goal).closed_loop_poles()).max() < 1


def test_the_goal_changes_during_a_run_in_both_engines(run_both):
    """On the model itself: the output is led to each goal, also beside a second control that is not needed for it."""
    A, B = [[0.9, 0.1], [0.0, 0.8]], [[0.0, 0.2], [0.1, 0.0]]
    model = LinearModel(A, B, np.eye(2), 1e-6, 1e-4, dt=0.1)
    controller = LQGController(
        model, FixedPrecision(), goal_on=[[1, 0]], goal_covariance=0.01, control_covariance=[1.0, 4.0]
    )
    loop = cosim.closed_loop(
        cosim.StateSpace(control.ss(A, B, np.eye(2), 0, 0.1)),
        controller,
        control=["u0", "u1"],
        measured=["y0", "y1"],
        reference=cosim.Step(time=10.0, before=1.0, after=-2.0),
    )
    result = run_both(loop, 20.0)
    assert result["plant.y0"][99] == pytest.approx(1.0, abs=1e-3)
    assert result["plant.y0"][-1] == pytest.approx(-2.0, abs=2e-3)
    # Of all controls that hold the output at 1 the cheapest.
    reach = np.linalg.solve(np.eye(2) - A, B)[0]
    cost = np.diag([1.0, 0.25])
    cheapest = np.linalg.solve(cost, reach) / (reach @ np.linalg.solve(cost, reach))
    np.testing.assert_allclose(result["controller.u"][99], cheapest, atol=2e-3)


def test_an_operating_point_is_a_constant_of_the_model():
    """Deviations plus their origin, by hand, against the controller of values."""
    model = servo()
    x, u, y = np.array([0.3, 0.0, 0.0]), [2.0], [10.3, 10.3]
    deviations = LQGController(
        model, FixedPrecision(), goal_on=[[1, 0, 0]], goal_covariance=0.01, initial_covariance=1e-3
    )
    about = model.about(x, u, y)
    values = LQGController(
        about,
        FixedPrecision(),
        goal_on=about.quantities[:1],
        goal_covariance=0.01,
        initial_covariance=1e-3,
        initial_mean=x,
    )
    assert "1.000" not in values.describe().splitlines()[1]  # the constant is none of the poles
    one, two = deviations.online(compiled=False), values.online(compiled=False)
    rng = np.random.default_rng(2)
    for _ in range(20):
        sample = rng.normal(size=2)
        low, high = one(y=sample, goal=[0.5]), two(y=sample + y, goal=[10.8])
        np.testing.assert_allclose(high.u, np.atleast_1d(low.u) + u, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(high.x_hat[:3], low.x_hat + x, atol=1e-9)
        assert high.x_hat[3] == 1.0
    assert pickle.loads(pickle.dumps(about)).constant


def test_a_constant_load_leaves_no_steady_error():
    model = servo().with_disturbance(1e-4)
    controller = LQGController(
        model, FixedPrecision(), goal_on="outputs", goal_covariance=1e-3, initial_covariance=1e-4
    )
    A, B, C = (servo().matrix(name) for name in "ABC")
    step, x, u = controller.online(compiled=False), np.zeros(3), np.zeros(1)
    for _ in range(800):
        u = np.atleast_1d(step(y=C @ x, goal=[1.0]).u)
        x = A @ x + B @ (u + 0.7)
    assert x[0] == pytest.approx(1.0, abs=1e-6)
    assert u[0] == pytest.approx(-0.7, abs=1e-6)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("arrives", "load"), [(1.0, 0.5), (0.5, 0.0)])
def test_an_actuator_fault_that_is_found_leaves_no_steady_error(arrives, load):
    model = LinearModel([[0.9]], [[0.1]], [[1], [1]], 1e-6, 1e-4, dt=0.1)
    modes = [controllers.InputOffset(), controllers.LostEffect()]
    left = {}
    for actuator_modes in (modes, []):
        precision = controllers.SwitchingPrecision(actuator_modes=actuator_modes)
        controller = LQGController(model, precision, goal_covariance=0.01, initial_covariance=1e-4)
        step, x, rng, reached = controller.online(compiled=True), 0.0, np.random.default_rng(1), []
        for k in range(300):
            u = step(y=x + 1e-2 * rng.normal(size=2), goal=[1.0]).u[0]
            x = 0.9 * x + 0.1 * (u if k < 100 else arrives * u + load) + 1e-3 * rng.normal()
            reached.append(x)
        left[len(actuator_modes)] = abs(np.mean(reached[200:]) - 1.0)
    assert left[2] < 0.02
    assert left[2] < 0.2 * left[0]


def test_a_lost_effect_that_is_known_leaves_the_loop_as_it_was_designed():
    """With a fifth of the effect the control is five times as large, although its cost is high."""
    A, B, C = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]] * 2)
    model = LinearModel(A, B, C, np.diag([1e-8, 1e-6]), 1e-6, dt=0.1)
    mode = controllers.LostEffect(time_to_fault=10.0, time_to_recovery=1e6, share=0.8, spread=0.05, walk=0.0)
    learner = controllers.SwitchingPrecision(actuator_modes=[mode])
    controller = LQGController(
        model, learner, goal_covariance=1.0, control_covariance=1.0, initial_covariance=1e-6
    )  # fmt: skip
    goal = [np.sign(np.sin(k / 40)) for k in range(600)]
    runs = []
    for effect in (1.0, 0.2):
        step, x, seen, rng = controller.online(), np.zeros(2), [], np.random.default_rng(2)
        for k in range(600):
            u = step(y=C @ x + 1e-3 * rng.standard_normal(2), goal=[goal[k]]).u
            x = A @ x + (effect if k >= 100 else 1.0) * B @ u
            seen.append(x[0])
        runs.append(np.array(seen))
    assert np.abs(runs[0] - runs[1])[300:].max() < 0.1 * np.ptp(runs[0][300:])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: (np.diag([1.05, 0.5]), [[0], [1]], np.eye(2), {}), r"no control moves .* eigenvalue 1\.05, which grows"),
        (lambda: (np.diag([1.05, 0.5]), np.eye(2), [[0, 1]], {}), r"no sensor sees the mode with the eigenvalue 1\.05"),
        (lambda: (np.diag([0.9, 0.5]), [[1], [1]], np.eye(2), {}), "There are 2 goals but only 1 control"),
        (lambda: ([[0, 0], [1, 0]], [[1], [0]], [[1, -1]], {}), "zero at 1"),
        (lambda: (np.diag([-1.0, 0.5]), np.eye(2), np.eye(2), {"goal_on": [[0, 1]]}), "goals do not see .* -1, which stays"),
        (lambda: (np.diag([1.0, 1.0 + 1e-9]), np.eye(2), np.eye(2), {"goal_on": [[0, 1]]}), None),
        (lambda: (np.diag([0.9, 0.5]), np.eye(2), np.eye(2), {"goal_on": "states"}), "not every state"),
        (lambda: (np.diag([0.9, 0.5]), np.eye(2), np.eye(2), {"control_covariance": None}), "needs a control_covariance"),
        (lambda: (np.diag([0.9, 0.5]), np.eye(2), np.eye(2), {"control_mean": 1.0}), "leave control_mean out"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_in_a_sentence(make, words):
    A, B, C, settings = make()
    model = LinearModel(A, B, C, 1e-4, 1e-4, dt=0.1)
    if words is None:  # an integrator may be left alone
        assert LQGController(model, **settings).regulator.drifting == 1
        return
    with pytest.raises(ModelError, match=words):
        LQGController(model, **settings)


@pytest.mark.parametrize("dt", [1e-4, 1.0, 60.0])
def test_a_mode_that_is_gone_within_a_sample_does_not_hide_another(dt):
    """Of 1 / (s (s + 1)) a sample of a minute leaves exp(-60) of one mode; the other is moved and seen as ever."""
    whole = np.array([[1, -np.expm1(-dt), dt + np.expm1(-dt)], [0, np.exp(-dt), -np.expm1(-dt)]])
    model = LinearModel(whole[:, :2], whole[:, 2:], [[1, 0]], 1e-6, 1e-4, dt=dt)
    assert np.abs(LQGController(model, FixedPrecision(), goal_covariance=0.01).closed_loop_poles()).max() < 1
    with pytest.raises(ModelError, match="no control moves"):
        LQGController(LinearModel(whole[:, :2], [[0], [0]], [[1, 0]], 1e-6, 1e-4, dt=dt))


def test_constants_come_last():
    model = servo().about([0, 0, 0], [1.0], [0, 0])
    with pytest.raises(ModelError, match="model is already one of values"):
        model.about([0, 0, 0], [1], [0, 0])
    for more in (model.with_sensor_errors(1.0, 1.0), model.with_disturbance()):
        assert more.state_names[-1] == "constant"
    with pytest.raises(ModelError, match="last state is not constant"):
        LinearModel(np.eye(2), [[0], [1]], np.eye(2), 1e-4, 1e-4, dt=0.1, disturbances=1, constant=True)
    with pytest.raises(ModelError, match="into f and g"):
        controllers.NonlinearModel.from_linear(model)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_a_state_that_the_goal_does_not_need_has_no_effect(unit):
    """In Pa such a state made the goal seem impossible to hold."""
    found = []
    for scale in (1.0, unit):
        A, B, C = np.diag([0.9, 0.8]), np.array([[0.1], [0.1 * scale]]), np.eye(2)
        model = LinearModel(A, B, C, [1e-4, 1e-4 * scale**2], [0.01, 0.01 * scale**2], dt=0.1)
        controller = LQGController(model, FixedPrecision(), goal_on=[[1.0, 0.0]], goal_covariance=0.01)
        regulator = controller.regulator
        np.testing.assert_allclose(regulator.x_of_goal[:, 0], [1.0, 0.5 * scale], rtol=1e-5)
        found.append((regulator.u_of_goal, regulator.gain[:, :1]))
    np.testing.assert_allclose(*found, rtol=1e-7)


@pytest.mark.parametrize("unit", [1.0, 1.0 / 206265.0, 1e3])
@pytest.mark.parametrize("acceptable", [0.3, 3.0, 5.0, 30.0])
def test_the_law_that_runs_is_that_of_the_riccati_equation_in_any_unit(unit, acceptable):
    """A telescope in arcseconds with gusts: scipy's cost-to-go has wrong variances, and its root another law."""
    arcsec, inertia, gust = 206265.0 * unit, 400.0, 5.0
    A = np.array([[0, 1, 0], [0, -20 / inertia, arcsec / inertia], [0, 0, -1 / gust]])
    plant = control.ss(
        A,
        [[0, 0], [arcsec / inertia, 0], [0, 1 / gust]],
        [[1.0, 0, 0]],
        0,
        inputs=["torque", "gust"],
        outputs=["angle"],
    )
    controller = controllers.design(
        plant, measured="angle", actuated="torque", dt=0.02, sensors=2, sensor_std=unit, noise={"gust": 110.0, "torque": 0.5},
        acceptable_error=acceptable * unit, acceptable_control=10.0, precision=controllers.FixedPrecision(),
    )  # fmt: skip
    states = np.array([unit, unit, 1.0])
    A, B = controller.model.A / states[:, None] * states, controller.model.B / states[:, None]
    cost, price = np.diag([1.0 / acceptable**2, 0.0, 0.0]), [[0.01]]
    alone = control.dlqr(A[:2, :2], B[:2], cost[:2, :2], price)
    X, U = np.zeros(2), np.zeros(1)
    if A[2, 2] > np.abs(alone[2]).max():
        # A gust that is slower than the loop belongs to the steady state: with x = X gust + d and u = U gust + v, only its
        # change moves d.
        whole = np.block([[np.eye(2) - A[:2, :2], -B[:2]], [np.array([[1.0, 0.0]]), 0.0]])
        X, U = np.split(np.linalg.solve(whole, np.append(A[:2, 2], 0.0)), [2])
        A = A.copy()
        A[:2, 2] = X * (1.0 - A[2, 2])
    gain = control.dlqr(A, B, cost, price)[0]
    K = (gain - np.append(np.zeros(2), U + gain[0, :2] @ X)) / states
    np.testing.assert_allclose(controller.regulator.gain, K, rtol=1e-6)
    loop = cosim.closed_loop(
        plant, controller, control="torque", measured="angle", sensors=cosim.Sensors(2, unit), reference=0.0,
        noise={"gust": cosim.Gaussian(std=110.0)},
    )  # fmt: skip
    run = loop.simulate(2.0, seed=1, engine="interpreted")
    law = -run["controller.x_hat"] @ K.T
    np.testing.assert_allclose(run["controller.u"], law, rtol=1e-6, atol=1e-6 * np.abs(law).max())


def loaded(load, keep):
    """Return a model whose load moves the first state and rests at `load`, about its operating point, with its offset."""
    A, B = np.array([[0.9, 0.2, 0.1], [0.0, 0.8, 0.0], [0.0, 0.0, keep]]), np.array([[0.0], [0.1], [0.0]])
    x = np.array([1.0, (0.1 - 0.1 * load) / 0.2, load])
    u = np.array([0.2 * x[1] / 0.1])
    model = LinearModel(A, B, np.eye(3), 1e-4, 1e-4, dt=1.0).about(x, u, x)
    return model, A, B, x, x - A @ x - B @ u


@pytest.mark.parametrize("keep", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("acceptable", [1e-4, 9.0])
def test_a_load_that_rests_elsewhere_than_at_zero_is_in_the_operating_point(keep, acceptable):
    model, A, B, x, offset = loaded(4.0, keep)
    controller = LQGController(
        model, FixedPrecision(), goal_on=np.array([[1.0, 0.0, 0.0, 0.0]]), goal_covariance=acceptable
    )
    step = controller.online(compiled=False)
    for _ in range(300):
        x = A @ x + B @ np.ravel(step(y=x, goal=[1.0]).u) + offset
    assert x[0] == pytest.approx(1.0, abs=1e-6)


def test_a_load_that_is_faster_than_the_loop_is_left_to_the_regulator():
    """Its steady state is out of reach: to counteract it at any price costs far more than it saves."""
    model, A, B, *_ = loaded(0.0, 0.5)
    controller = LQGController(model, FixedPrecision(), goal_on=np.eye(1, 4), goal_covariance=9.0)
    gain = control.dlqr(A, B, np.diag([1.0 / 9.0, 0.0, 0.0]), [[1.0]])[0]
    np.testing.assert_allclose(controller.regulator.gain, gain, rtol=1e-7, atol=1e-12)


def test_goals_that_two_controls_cannot_hold_apart_are_named_first():
    """The advice was to bring sizes nearer to each other, as of a Riccati equation without a solution."""
    model = LinearModel(np.diag([0.9, 0.9]), np.ones((2, 2)), np.eye(2), 1e-3, 1e-2, dt=0.1)
    with pytest.raises(ModelError, match=r"^The goals cannot each be held") as caught:
        LQGController(model, FixedPrecision(), goal_on=np.eye(2))
    assert "Bring the sizes" not in str(caught.value)
