"""The nonlinear controller with the model of an FMU: against the same equations by hand, and filterpy's extended filter."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from bayesftc import cosim, fmus
from bayesftc.controllers import FixedPrecision, NonlinearBayesianController, NonlinearModel, design
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import sin

DT = 0.02
NOISE = {"process_covariance": [1e-7, 1e-5], "sensor_covariance": 4e-4}
SETTINGS = {
    "goal_covariance": [1e-3, 1e-1], "control_covariance": 25.0, "initial_covariance": 0.01, "initial_mean": [0.5, 0.0],
    "iterations": 8,
}  # fmt: skip


def by_hand(x, u, x_next):
    """One step of the classical Runge-Kutta method for q'' = -9.81 sin q - 0.1 q' + u."""
    half = 0.5 * DT
    a1, b1 = x[1], -9.81 * sin(x[0]) - 0.1 * x[1] + u[0]
    q, w = x[0] + half * a1, x[1] + half * b1
    a2, b2 = w, -9.81 * sin(q) - 0.1 * w + u[0]
    q, w = x[0] + half * a2, x[1] + half * b2
    a3, b3 = w, -9.81 * sin(q) - 0.1 * w + u[0]
    q, w = x[0] + DT * a3, x[1] + DT * b3
    a4, b4 = w, -9.81 * sin(q) - 0.1 * w + u[0]
    x_next[0] = x[0] + DT / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    x_next[1] = x[1] + DT / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)


def angle_thrice(x, y):
    for i in range(3):
        y[i] = x[0]


@pytest.fixture(scope="module")
def pendulum(casadi_fmu):
    return casadi_fmu("swinging", lambda q, u: q)


@pytest.fixture(scope="module")
def model(pendulum):
    return NonlinearModel.from_fmu(
        pendulum, measured="y", actuated="u", dt=DT, substeps=1, sensors=3, sensor_std=0.02,
        process_covariance=NOISE["process_covariance"],
    )  # fmt: skip


def loop_of(pendulum, model, **options):
    controller = NonlinearBayesianController(model, **SETTINGS | options)
    return cosim.closed_loop(
        cosim.FMU(pendulum, kind="model exchange"), controller, control="u", measured="y",
        sensors=cosim.Sensors(3, 0.02), reference=[1.0, 0.0], faults=[cosim.Freeze(sensor=0, start=0.5, stop=1.0)],
    )  # fmt: skip


def test_the_run_is_that_of_the_equations_written_by_hand(pendulum, model, run_both):
    known = NonlinearModel(by_hand, angle_thrice, 2, 1, 3, **NOISE, dt=DT)
    results = [run_both(loop_of(pendulum, model), 0.3, seed=3), loop_of(pendulum, known).simulate(0.3, seed=3)]
    for name in ("controller.x_hat", "controller.u", "controller.fault_probability", "plant.y"):
        np.testing.assert_allclose(results[0][name], results[1][name], rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_the_belief_is_that_of_filterpys_extended_filter(model):
    step = NonlinearBayesianController(model, precision=FixedPrecision(), **SETTINGS).online()
    ekf = ExtendedKalmanFilter(2, 3, 1)
    ekf.x, ekf.P = np.array([[0.5], [0.0]]), 0.01 * np.eye(2)
    ekf.Q, ekf.R = np.diag(NOISE["process_covariance"]), 4e-4 * np.eye(3)
    C, F, B, following = np.array([[1.0, 0.0]] * 3), np.empty((2, 2)), np.empty((2, 1)), np.empty(2)
    rng = np.random.default_rng(0)
    for _ in range(60):
        y = 0.6 + 0.02 * rng.normal(size=3)
        out = step(y=y, goal=[1.0, 0.0])
        ekf.update(y[:, None], lambda x: C, lambda x: C @ x)
        np.testing.assert_allclose(out.x_hat, ekf.x[:, 0], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(out.P, ekf.P, rtol=1e-7, atol=1e-12)
        here = np.ascontiguousarray(ekf.x[:, 0])
        model.f(here, out.u, following)
        model.f_jacobian(here, out.u, F, B)
        ekf.x, ekf.P = following[:, None].copy(), F @ ekf.P @ F.T + ekf.Q


def test_a_session_continues_and_restores_with_the_same_bits(pendulum, model, same_bits):
    loop = loop_of(pendulum, model)
    whole = loop.simulate(1.0, seed=1)
    with loop.start(seed=1) as session:
        session.advance(0.4)
        state = session.save_state()
        first = session.advance(0.6)
        session.restore(state)
        again = session.advance(0.6)
        same_bits(first["controller.x_hat"], again["controller.x_hat"])
        same_bits(again["controller.x_hat"], whole["controller.x_hat"][-len(again.time) :])


def test_export_is_refused(model):
    controller = NonlinearBayesianController(model, **SETTINGS)
    with pytest.raises(
        ModelError, match=r"calls the FMU .* in its step, and the exported C cannot contain it\. Export"
    ):
        cosim.export_fmu(controller, "never.fmu")


def test_a_campaign_is_the_single_runs(pendulum, model, campaign_as_alone):
    campaign_as_alone(loop_of(pendulum, model), 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("executor", [cosim.Threads(2), cosim.Processes(2)], ids=["threads", "processes"])
def test_workers_of_a_campaign_use_instances_of_their_own(pendulum, model, executor, same_bits):
    campaign = cosim.Campaign(loop_of(pendulum, model), duration=1.0, seeds=range(8), record=["controller.x_hat"])
    results = [campaign.run(executor=each).dataset["controller.x_hat"].values for each in (cosim.Threads(1), executor)]
    same_bits(*results)


@pytest.mark.slow
def test_the_cart_pendulum_is_held_by_its_own_equations(run_both):
    plant = cosim.FMU(fmus.path("CartPendulum"), parameters={"angle_0": 0.3})
    model = NonlinearModel.from_fmu(
        cosim.FMU(fmus.path("CartPendulum"), parameters={"max_substep": 0.01}), measured=["position", "angle"],
        actuated="force", noise={"torque": 0.02}, sensors=4, sensor_std=0.005,
    )  # fmt: skip
    # The precision of the goal is the cost-to-go of the linear regulator at rest.
    regulator = design(model.linearised(model.start), goal=[0], acceptable_control=5.0).regulator
    controller = NonlinearBayesianController(
        model, goal_on=regulator.root, goal_covariance=1e6, control_covariance=25e6, initial_mean=[0, 0.3, 0, 0],
        initial_covariance=1e-4, iterations=6,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="force", measured=["position", "angle"], sensors=cosim.Sensors(4, 0.005),
        reference=[0.0] * 4,
    )  # fmt: skip
    result = run_both(loop, 3.0, seed=0)
    assert np.abs(result["plant.angle"]).max() < 0.6
    assert np.abs(result["plant.angle"][-20:]).max() < 0.1
