"""The posterior of the control and the free energy, against dense joint Gaussians by NumPy and densities by SciPy."""

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy import optimize
from scipy.stats import multivariate_normal

from bayesftc import controllers
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import sin


def positive(rng, size, least=0.1):
    F = rng.normal(size=(size, size))
    return F @ F.T + least * np.eye(size)


def joint_posterior(terms, size):
    """Mean and covariance of z for independent measurements ``value = H z + noise``: the dense information matrix, inverted."""
    information, shift = np.zeros((size, size)), np.zeros(size)
    for H, value, covariance in terms:
        weight = H.T @ np.linalg.inv(covariance)
        information += weight @ H
        shift += weight @ value
    covariance = np.linalg.inv(information)
    return covariance @ shift, covariance


def free_energy(terms, z):
    return -sum(multivariate_normal(np.zeros(len(v)), S, allow_singular=True).logpdf(v - H @ z) for H, v, S in terms)


def terms_of(controller, mean, covariance, y, R, goal):
    """All factors of eq. 8 as measurements of z = [x_t, u_t, x_t+1]; what is missing is left out."""
    model = controller.model
    A, B, C, Q = (model.matrix(name) for name in ("A", "B", "C", "process_covariance"))
    n, p = B.shape
    x, u, following = np.split(np.eye(2 * n + p), [n, n + p])
    G, Sigma = controller.goal_matrix, np.asarray(controller.goal_covariance)
    here = np.flatnonzero(np.isfinite(y) & np.isfinite(np.diag(R)))
    wanted = np.flatnonzero(np.isfinite(goal))
    terms = [(x, mean, covariance), (following - A @ x - B @ u, np.zeros(n), Q)]
    if len(here):
        terms.append((C[here] @ x, y[here], R[np.ix_(here, here)]))
    if len(wanted):
        terms.append((G[wanted] @ following, goal[wanted], Sigma[np.ix_(wanted, wanted)]))
    if controller.control_covariance is not None:
        terms.append((u, np.asarray(controller.control_mean), np.asarray(controller.control_covariance)))
    return terms


def compare(controller, samples, goals):
    """Run the controller, and compare its outputs with the oracle's at each step."""
    model = controller.model
    n, p = model.states, model.controls
    A, B, Q = (model.matrix(name) for name in ("A", "B", "process_covariance"))
    mean, covariance = np.asarray(controller.initial_mean), np.asarray(controller.initial_covariance)
    step = controller.online(compiled=False)
    for y, goal in zip(samples, goals, strict=True):
        out = step(y=y, goal=goal)
        terms = terms_of(controller, mean, covariance, y, out.R, goal)
        z, S = joint_posterior(terms, 2 * n + p)
        u = slice(n, n + p)
        scale = np.sqrt(np.diag(S))
        np.testing.assert_allclose(out.u / scale[u], z[u] / scale[u], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(
            out.u_covariance / np.outer(scale[u], scale[u]),
            S[u, u] / np.outer(scale[u], scale[u]),
            rtol=1e-6,
            atol=1e-8,
        )
        ends = np.outer(scale[u], scale[:n])
        np.testing.assert_allclose(out.u_state_covariance / ends, S[u, :n] / ends, rtol=1e-6, atol=1e-8)
        assert out.free_energy == pytest.approx(free_energy(terms, z), rel=1e-7, abs=1e-7)
        if controller.belief == "joint":
            np.testing.assert_allclose(
                out.P / np.outer(scale[:n], scale[:n]), S[:n, :n] / np.outer(scale[:n], scale[:n]), atol=1e-7
            )
        mean, covariance = A @ out.x_hat + B @ out.u, A @ out.P @ A.T + Q


@st.composite
def problems(draw):
    n, p, m = draw(st.integers(1, 4)), draw(st.integers(1, 3)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = rng.normal(size=(n, n))
    A *= draw(st.floats(0.1, 1.1)) / np.abs(np.linalg.eigvals(A)).max()
    model = controllers.LinearModel(
        A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), positive(rng, n), positive(rng, m), 0.1
    )
    goals = draw(st.integers(1, n))
    flat = p <= goals and draw(st.booleans())
    learners = [controllers.FixedPrecision(), controllers.GammaPrecision(forgetting=0.8), controllers.SERFDI(1.0)]
    options = {
        "precision": draw(st.sampled_from(learners)),
        "goal_on": rng.normal(size=(goals, n)),
        "goal_covariance": positive(rng, goals),
        "control_covariance": None if flat else positive(rng, p),
        "control_mean": 0.0 if flat else rng.normal(size=p),
        "belief": draw(st.sampled_from(["filtered", "joint"])),
        "initial_covariance": positive(rng, n),
    }
    y, wanted = 2.0 * rng.normal(size=(8, m)), rng.normal(size=(8, goals))
    y[rng.random(y.shape) < 0.2] = np.nan
    if not flat:
        wanted[rng.random(wanted.shape) < 0.2] = np.nan
    return model, options, y, wanted


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(problems())
def test_posterior_and_free_energy_are_those_of_the_dense_joint_gaussian(problem):
    model, options, y, goals = problem
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
        controller = controllers.BayesianController(model, posterior_outputs=True, **options)
    compare(controller, y, goals)


CAR = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)


def test_compiled_has_the_same_bits():
    controller = controllers.BayesianController(
        CAR, precision=controllers.GammaPrecision(), initial_mean=20.0, posterior_outputs=True
    )
    rng, steps = np.random.default_rng(3), [controller.online(compiled=c) for c in (True, False)]
    for k in range(200):
        y = 20.0 + rng.normal(size=2) + [5.0 * (k > 100), 0.0]
        y[rng.random(2) < 0.1] = np.nan
        a, b = (step(y=y, goal=[20.0]) for step in steps)
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
        assert np.isfinite(a.free_energy)


def test_they_are_outputs_only_where_they_are_asked_for_and_change_nothing_else():
    plain, more = (
        controllers.BayesianController(CAR, controllers.FixedPrecision(), posterior_outputs=asked)
        for asked in (False, True)
    )
    names = [[port.name for port in c.outputs] for c in (plain, more)]
    assert [n for n in names[1] if n not in names[0]] == ["u_covariance", "u_state_covariance", "free_energy"]
    steps = [c.online(compiled=False) for c in (plain, more)]
    for y in np.random.default_rng(1).normal(size=(50, 2)):
        a, b = (step(y=y, goal=[1.0]) for step in steps)
        for name in names[0]:
            np.testing.assert_array_equal(a[name], b[name])
    with pytest.raises(ModelError, match="posterior_outputs='yes'; it must be True or False"):
        controllers.BayesianController(CAR, posterior_outputs="yes")
    with pytest.raises(ModelError, match="priors is arbitrary"):
        controllers.LQGController(CAR, posterior_outputs=True)


def test_states_without_uncertainty_have_no_density():
    """A process that drives one of two states, a constant that is known: SciPy's densities on the support, by a proper prior."""
    model = controllers.LinearModel(
        [[0.9, 0.1], [0.0, 1.0]], [[1.0], [0.0]], [[1.0, 0.0], [1.0, 1.0]], [0.2, 0.0], 0.5, 0.1
    )
    controller = controllers.BayesianController(
        model, controllers.FixedPrecision(), goal_on=[[1.0, 0.0]], control_covariance=2.0, control_mean=0.3,
        initial_mean=[0.0, 1.0], initial_covariance=[1.0, 0.0], posterior_outputs=True,
    )  # fmt: skip
    y, goal = np.array([0.7, 1.9]), np.array([2.0])
    out = controller.online(compiled=False)(y=y, goal=goal)
    terms = terms_of(controller, np.array([0.0, 1.0]), np.diag([1.0, 0.0]), y, out.R, goal)
    # The joint of z = [x, u, x+, y, goal] by covariances, conditioned on the last three.
    A, B, C = (model.matrix(name) for name in "ABC")
    root = np.zeros((8, 6))  # of x[0], u, q[0], and the noises of two sensors and the goal
    root[0, 0], root[2, 1] = 1.0, np.sqrt(2.0)
    root[3:5] = A @ root[:2] + B @ root[2:3]
    root[3, 2] += np.sqrt(0.2)
    root[5:7] = C @ root[:2]
    root[[5, 6], [3, 4]] += np.sqrt(0.5)
    root[7] = root[3]
    root[7, 5] += 1.0
    mean = np.array([0.0, 1.0, 0.3, *(A @ [0.0, 1.0] + B @ [0.3]), *(C @ [0.0, 1.0]), 0.0])
    mean[7] = mean[3]
    S = root @ root.T
    gain = S[:5, 5:] @ np.linalg.inv(S[5:, 5:])
    z = mean[:5] + gain @ (np.array([*y, *goal]) - mean[5:])
    posterior = S[:5, :5] - gain @ S[5:, :5]
    assert out.u[0] == pytest.approx(z[2], rel=1e-12)
    assert out.u_covariance[0, 0] == pytest.approx(posterior[2, 2], rel=1e-12)
    np.testing.assert_allclose(out.u_state_covariance[0], posterior[2, :2], rtol=1e-12, atol=1e-15)
    assert out.free_energy == pytest.approx(free_energy(terms, z), rel=1e-12)


def test_without_a_goal_a_flat_prior_leaves_the_control_undetermined():
    step = controllers.BayesianController(CAR, controllers.FixedPrecision(), posterior_outputs=True).online(
        compiled=False
    )
    out = step(y=[0.0, 0.1], goal=[np.nan])
    assert np.isnan(out.u_covariance).all()
    assert np.isnan(out.u_state_covariance).all()
    assert np.isnan(out.free_energy)
    assert np.isfinite(step(y=[0.0, 0.1], goal=[0.0]).free_energy)


def swing(x, u, following):
    following[0] = x[0] + 0.1 * x[1]
    following[1] = x[1] + 0.1 * (u[0] - sin(x[0]))


def look(x, y):
    y[0] = sin(x[0])
    y[1] = x[1] + 0.1 * x[0] * x[0]


def test_of_a_linear_model_the_nonlinear_controller_has_the_same():
    options = {
        "goal_covariance": [[0.3, 0.1], [0.1, 0.5]], "control_covariance": 2.0, "control_mean": 0.4, "posterior_outputs": True,
        "precision": controllers.GammaPrecision(),
    }  # fmt: skip
    model = controllers.LinearModel([[1.0, 0.1], [-0.1, 0.9]], [[0.0], [0.1]], np.eye(2), [0.02, 0.0], [0.3, 0.2], 0.1)
    linear, nonlinear = (
        cls(model, **options).online(compiled=False)
        for cls in (controllers.BayesianController, controllers.NonlinearBayesianController)
    )
    for y in ([0.2, 0.3], [np.nan, -0.4], [2.0, 0.1]):
        a, b = (step(y=y, goal=[0.5, np.nan]) for step in (linear, nonlinear))
        for name in ("u", "u_covariance", "u_state_covariance", "free_energy"):
            np.testing.assert_allclose(b[name], a[name], rtol=1e-7, atol=1e-12)


def test_of_a_nonlinear_model_they_are_scipys_least_value_and_curvature():
    """The free energy by scipy's minimiser over x_t, u_t, x_t+1, the covariances by its differences of the equations there."""
    model = controllers.NonlinearModel(
        swing, look, 2, 1, 2, process_covariance=[0.01, 0.02], sensor_covariance=[0.05, 0.1], dt=0.1
    )
    controller = controllers.NonlinearBayesianController(
        model, controllers.FixedPrecision(), goal_covariance=[0.1, 0.2], control_covariance=3.0, control_mean=0.2,
        initial_mean=[0.3, -0.1], initial_covariance=[0.4, 0.2], posterior_outputs=True,
    )  # fmt: skip
    y, goal = np.array([0.8, 0.5]), np.array([0.4, 0.9])
    plain, compiled = (controller.online(compiled=c)(y=y, goal=goal) for c in (False, True))
    variances = np.array([0.4, 0.2, 0.01, 0.02, 0.05, 0.1, 0.1, 0.2, 3.0])

    def whitened(z):
        x, u, following, reading, ahead = z[:2], z[2:3], z[3:], np.zeros(2), np.zeros(2)
        look(x, reading)
        swing(x, u, ahead)
        parts = (x - [0.3, -0.1], following - ahead, y - reading, goal - following, u - 0.2)
        return np.concatenate(parts) / np.sqrt(variances)

    found = optimize.least_squares(
        whitened, [0.3, -0.1, 0.2, 0.4, 0.9], xtol=1e-15, ftol=1e-15, gtol=1e-15, jac="3-point"
    )
    least = found.cost + 0.5 * np.log(2 * np.pi * variances).sum()
    S = np.linalg.inv(found.jac.T @ found.jac)
    for out in (plain, compiled):
        assert out.free_energy == pytest.approx(least, rel=1e-10)
        assert out.u[0] == pytest.approx(found.x[2], abs=1e-6)
        assert out.u_covariance[0, 0] == pytest.approx(S[2, 2], rel=1e-4)
        np.testing.assert_allclose(out.u_state_covariance[0], S[2, :2], rtol=1e-4)
