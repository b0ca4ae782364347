"""A linearization holds what precision learners have learned: it is finite, with the gain of the precision at the point."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import LEARNERS, FixedPrecision, GammaPrecision

MODEL = controllers.LinearModel([[1, 0.1], [0, 1]], [[0.005], [0.1]], [[1, 0], [1, 0]], [1e-4, 1e-4], 0.04, dt=0.1)


def bayesian(precision):
    return controllers.BayesianController(MODEL, precision=precision, control_covariance=1.0, goal_on="outputs")


def lqg(precision):
    return controllers.LQGController(MODEL, precision=precision, goal_covariance=0.01, control_covariance=1.0)


def nonlinear(precision):
    return controllers.NonlinearBayesianController(MODEL, precision=precision, control_covariance=1.0, iterations=1)


def active_inference(precision):
    law = controllers.ProportionalDerivative(gain=[[1.0]], derivative_gain=[[1.0]])
    return controllers.UnbiasedActiveInference(
        model=MODEL, law=law, state_prior="kalman", control="law", state_precision=10.0, belief_rate=0.5, precision=precision
    )  # fmt: skip


MAKERS = {
    controllers.BayesianController: bayesian,
    controllers.LQGController: lqg,
    controllers.NonlinearBayesianController: nonlinear,
    controllers.UnbiasedActiveInference: active_inference,
}
QUICK = [maker for maker in MAKERS.values() if maker is not nonlinear]


def test_every_controller_is_here():
    assert set(MAKERS) == set(controllers.CONTROLLERS)


def check_finite(controller):
    plant = cosim.StateSpace(control.ss(MODEL.A, MODEL.B, np.eye(2)[:1], 0, 0.1, inputs=["u"], outputs=["y"]))
    loop = cosim.closed_loop(
        plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.2), reference=[0.0] * len(controller.goal_matrix)
    )  # fmt: skip
    system = loop.to_control(inputs=["controller.u"], seed=None, engine="interpreted")
    found = control.linearize(system, system.initial_state, 0.0)
    assert not any(
        label.startswith("controller_memory")
        for label in system.linearize(system.initial_state, copy_names=True).state_labels
    )
    for matrix in (found.A, found.B, found.C, found.D):
        assert np.isfinite(matrix).all()
    return found


@pytest.mark.sampled(3)
@pytest.mark.parametrize("make", QUICK, ids=lambda make: make.__name__)
@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.__name__)
def test_every_learner_is_linearized_to_finite_numbers(learner, make):
    check_finite(make(learner()))


@pytest.mark.slow
def test_a_nonlinear_controller_is_linearized_to_finite_numbers():
    check_finite(nonlinear(controllers.EFFDI()))


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.__name__)
def test_every_learner_is_linearized_to_finite_numbers_in_a_nonlinear_controller(learner):
    check_finite(nonlinear(learner()))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("make", [bayesian, lqg])
@pytest.mark.parametrize(
    "learner",
    [learner for learner in LEARNERS if learner is not controllers.SwitchingPrecision],
    ids=lambda c: c.__name__,
)
def test_the_gain_is_that_of_the_precision_where_the_learner_is_held(learner, make):
    """After a fault: Kalman's gain by NumPy, of the covariance that the controller reports for this sample."""
    system = make(learner()).to_control(inputs=["y", "goal"], outputs=["x_hat", "R"], seed=None, engine="interpreted")
    rng, x = np.random.default_rng(3), system.initial_state
    labels = system.state_labels
    for k in range(12):
        y = 0.2 * rng.normal(size=2) + [0.0, 3.0 * (k > 8)]
        u = np.concatenate([y, [0.0]])
        out = system.output(0.1 * k, x, u)
        if k == 11:
            break
        x = system.dynamics(0.1 * k, x, u)
    R, P = (
        out[2:].reshape(2, 2),
        np.array([x[labels.index(f"covariance[{i},{j}]")] for i in (0, 1) for j in (0, 1)]).reshape(2, 2),
    )
    used = np.isfinite(np.diag(R))
    C = MODEL.matrix("C")[used]
    gain = np.zeros((2, 2))
    gain[:, used] = P @ C.T @ np.linalg.inv(C @ P @ C.T + R[np.ix_(used, used)])
    found = system.linearize(x, u, 1.1)
    np.testing.assert_allclose(found.D[:2, :2], gain, atol=1e-8)
    assert learner is FixedPrecision or not np.allclose(R, MODEL.matrix("sensor_covariance"))


def test_outputs_that_learning_moves_are_constants():
    held = bayesian(GammaPrecision()).to_control(
        outputs=["u", "beta", "fault_probability"], seed=None, engine="interpreted"
    )
    found = held.linearize(held.initial_state, [0.3, 0.1, 0.0])
    assert not found.C[1:].any()
    assert not found.D[1:].any()
    assert found.D[0].any()


def test_a_vector_of_another_size_is_refused():
    system = bayesian(FixedPrecision()).to_control(engine="interpreted")
    with pytest.raises(cosim.ModelError, match="vector of 2 numbers, but the system has 3"):
        system.linearize(system.initial_state, [0.0, 0.0])
