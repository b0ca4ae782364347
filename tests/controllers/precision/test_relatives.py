"""The published relatives against plain NumPy filters in state space, as printed, over random models."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc import controllers
from bayesftc.controllers import StudentTUpdate, VariationalBayesKF, WeightedLikelihood
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.cosim.errors import BayesFTCError

pytestmark = pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")


def random_model(seed):
    rng = np.random.default_rng(seed)
    n, p, m = rng.integers(1, 5), rng.integers(1, 3), rng.integers(1, 5)
    A = rng.normal(size=(n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    L, S = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    R = S @ S.T + 0.3 * np.eye(m)
    return controllers.LinearModel(A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), 0.1 * L @ L.T, R, 1.0)


def samples(model, steps=60, missing=0.1):
    rng = np.random.default_rng(7)
    y = rng.normal(size=(steps, model.sensors)) * 3.0
    y[steps // 2 : steps // 2 + 10, 0] += 15.0
    y[rng.random(y.shape) < missing] = np.nan
    return y


def run(model, precision, y):
    """Return the controller's outputs for the samples, step by step."""
    controller = controllers.BayesianController(model, precision=precision, control_covariance=1.0)
    step = controller.online(compiled=False)
    return [step(y=row, goal=np.ones(model.states)) for row in y]


def kalman(m, P, y, H, R):
    """Printed form: K = P- H' (H P- H' + R)^-1, m = m- + K (y - H m-), P = P- - K H P-."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return m + K @ (y - H @ m), P - K @ H @ P


def follow(model, outs, y, update):
    """Run a filter in state space beside the controller, with the controls it gave, and compare the beliefs."""
    A, B, C, Q = (model.matrix(name) for name in ("A", "B", "C", "process_covariance"))
    m, P = np.zeros(model.states), np.eye(model.states)
    for row, out in zip(y, outs, strict=True):
        there = np.flatnonzero(np.isfinite(row))
        m, P, expected = update(m, P, row, there, C)
        scale = max(np.linalg.norm(m), np.sqrt(np.trace(P)))
        assert np.linalg.norm(out.x_hat - m) < 1e-9 * scale
        assert np.linalg.norm(out.P - P) < 1e-9 * np.linalg.norm(P)
        for name, value in expected.items():
            np.testing.assert_allclose(out[name], value, rtol=1e-8, atol=1e-12, err_msg=name)
        m, P = A @ m + B @ out.u, A @ P @ A.T + Q


SEEDS = range(6)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_variational_bayes_with_variances(seed, iterations):
    model, rho, a0 = random_model(seed), 0.9, 1.5
    a, b = np.full(model.sensors, a0), a0 * np.diag(model.matrix("sensor_covariance"))

    def update(m0, P0, y, there, C):
        nonlocal a, b
        H, a, b = C[there], a.copy(), b.copy()
        a[there] = rho * a[there] + 0.5
        b[there] = rho * b[there]
        before, m, P = b[there].copy(), m0, P0
        for _ in range(iterations):
            R = np.diag(b[there] / a[there])
            m, P = kalman(m0, P0, y[there], H, R)
            b[there] = before + 0.5 * (y[there] - H @ m) ** 2 + 0.5 * np.diag(H @ P @ H.T)
        return m, P, {"beta": b, "precision_shape": a, "precision_rate": b, "precision_mean": a / b}

    y = samples(model)
    follow(model, run(model, VariationalBayesKF(rho, iterations, a0), y), y, update)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_variational_bayes_with_a_full_covariance(seed, iterations):
    model, rho, a0 = random_model(seed), 0.9, 2.5
    d = model.sensors
    nu, V = 2 * a0 + d - 1, (2 * a0 - 2) * model.matrix("sensor_covariance")
    np.testing.assert_allclose(V / (nu - d - 1), model.matrix("sensor_covariance"))  # what the prior expects

    def update(m0, P0, y, there, H):
        nonlocal nu, V
        nu, before = rho * (nu - d - 1) + d + 1 + 1, rho * V
        V = before
        for _ in range(iterations):
            m, P = kalman(m0, P0, y, H, V / (nu - d - 1))
            r = y - H @ m
            V = before + np.outer(r, r) + H @ P @ H.T
        return m, P, {"beta": np.diag(V) / 2, "precision_degrees_of_freedom": nu}

    y = samples(model, missing=0.0)
    follow(model, run(model, VariationalBayesKF(rho, iterations, a0, "full"), y), y, update)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_student_t_update(seed, joint):
    model, v, iterations = random_model(seed), 3.0, 4
    nominal = model.matrix("sensor_covariance")

    def update(m0, P0, y, there, C):
        H, d = C[there], len(there)
        R = nominal[np.ix_(there, there)] if joint else np.diag(np.diag(nominal)[there])
        weight = np.ones(d)
        for _ in range(iterations):
            m, P = kalman(m0, P0, y[there], H, R / np.sqrt(np.outer(weight, weight)))
            r = y[there] - H @ m
            E = np.outer(r, r) + H @ P @ H.T
            if joint:
                weight = np.full(d, 0.5 * (d + v) / (0.5 * (v + np.trace(E @ np.linalg.inv(R)))))
            else:
                weight = 0.5 * (1 + v) / (0.5 * (v + np.diag(E) / np.diag(R)))
        m, P = kalman(m0, P0, y[there], H, R / np.sqrt(np.outer(weight, weight)))
        weights = np.ones(len(y))
        weights[there] = weight
        if joint and d:
            weights[:] = weight[0]
        return m, P, {"precision_weight": weights, "precision": weights / np.diag(nominal)}

    y = samples(model)
    follow(model, run(model, StudentTUpdate(v, iterations, joint), y), y, update)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_weighted_likelihood(seed, joint):
    """The state update is filterpy's, with the covariance R / w."""
    model, c = random_model(seed), 2.0
    nominal = model.matrix("sensor_covariance")

    def update(m0, P0, y, there, C):
        H, e = C[there], y[there] - C[there] @ m0
        R = nominal[np.ix_(there, there)] if joint else np.diag(np.diag(nominal)[there])
        squared = np.full(len(there), e @ np.linalg.solve(R, e)) if joint else e**2 / np.diag(R)
        w = c**2 / (c**2 + squared)
        kf = KalmanFilter(dim_x=model.states, dim_z=model.sensors)
        kf.x, kf.P = m0.reshape(-1, 1), P0
        if len(there):
            kf.update(y[there].reshape(-1, 1), R=R / np.sqrt(np.outer(w, w)), H=H)
        weights = np.ones(len(y))
        weights[there] = w
        if joint and len(there):
            weights[:] = w[0]
        return kf.x[:, 0], kf.P, {"precision_weight": weights, "precision": weights / np.diag(nominal)}

    y = samples(model)
    follow(model, run(model, WeightedLikelihood(c, joint), y), y, update)


REDUNDANT = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]] * 3, 0.001, [1.0, 4.0, 1.0], 0.02)


@pytest.mark.parametrize("precision", [VariationalBayesKF(), StudentTUpdate(), WeightedLikelihood()], ids=repr)
def test_one_failed_sensor_of_three_is_isolated(precision):
    controller = controllers.BayesianController(REDUNDANT, precision=precision, initial_mean=20.0)
    step = controller.online(compiled=False)
    for _ in range(20):
        out = step(y=[40.0, 20.0, 20.0], goal=[20.0])
    assert out.precision[0] < 0.1
    assert out.precision[1] > 0.2
    assert abs(out.x_hat[0] - 20.0) < 2.0


def test_one_weight_for_all_cannot_tell_sensors_apart():
    for precision in (StudentTUpdate(joint=True), WeightedLikelihood(joint=True)):
        step = controllers.BayesianController(REDUNDANT, precision=precision, initial_mean=20.0).online(compiled=False)
        out = step(y=[40.0, 20.0, 20.0], goal=[20.0])
        np.testing.assert_allclose(out.precision_weight, out.precision_weight[0])


@pytest.mark.parametrize("precision", [VariationalBayesKF(), VariationalBayesKF(covariance="full"), StudentTUpdate()])
def test_a_belief_that_knows_nothing_is_no_obstacle(precision):
    """Redundant sensors under a prior variance 1e12 times theirs: the residual after the update, not the innovation, counts."""
    controller = controllers.BayesianController(REDUNDANT, precision=precision, initial_covariance=1e12)
    out = controller.online(compiled=False)(y=[1e6, 1e6 + 1.0, 1e6 - 1.0], goal=[20.0])
    assert out.x_hat[0] == pytest.approx(1e6, abs=1.0)
    np.testing.assert_allclose(np.diag(out.R), [1.0, 4.0, 1.0], rtol=0.6)


def test_without_a_belief_covariance_the_variances_are_the_gamma_learners():
    """A controller without one hands over a spread of zeros: then the residual is the innovation."""
    learner, nominal = VariationalBayesKF(0.9, 3, 2.0).learner(REDUNDANT), REDUNDANT.matrix("sensor_covariance")
    memory, e = learner.memory.copy(), np.array([3.0, -1.0, 0.5])
    R, used, weight, beta, p = np.zeros((3, 3)), *np.zeros((4, 3))
    with np.errstate(all="ignore"):
        learner.step(
            Sample(e, e, np.ones(3), np.zeros((3, 3)), nominal),
            Trust(R, used, weight, beta, p),
            memory,
            learner.settings,
            np.zeros((learner.work, 3, 3)),
        )
    np.testing.assert_allclose(beta, 0.9 * 2.0 * np.diag(nominal) + 0.5 * e**2, rtol=1e-12)
    np.testing.assert_allclose(memory[3:6], 0.9 * 2.0 + 0.5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: VariationalBayesKF(forgetting=0.0), "above 0 and at most 1"),
        (lambda: VariationalBayesKF(iterations=0), "whole number at least 1 and at most 20"),
        (lambda: VariationalBayesKF(iterations=2.5), "whole number at least 1 and at most 20"),
        (lambda: VariationalBayesKF(prior_shape=0.0), "number above 0"),
        (lambda: VariationalBayesKF(prior_shape=1.0, covariance="full"), "number above 1"),
        (lambda: VariationalBayesKF(covariance="banded"), "'diagonal' or 'full'"),
        (lambda: StudentTUpdate(degrees_of_freedom=0.0), "number above 0"),
        (lambda: StudentTUpdate(iterations=21), "whole number at least 1 and at most 20"),
        (lambda: WeightedLikelihood(c=-1.0), "number above 0"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(BayesFTCError, match=words):
        make()


def test_why_there_is_no_probability():
    assert "calibration" in str(VariationalBayesKF().why_no_probability)
    assert "StudentTUpdate weights" in str(StudentTUpdate().why_no_probability)
    assert "WeightedLikelihood weights" in str(WeightedLikelihood().why_no_probability)
