"""The nonlinear controller: equal to the closed form where that holds, and a minimum of the joint cost by scipy where not."""

import math
import pickle
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares, minimize

from bayesftc import controllers, cosim
from bayesftc.controllers import (
    EFFDI,
    SERFDI,
    BayesianController,
    FixedPrecision,
    GammaPrecision,
    LinearModel,
    NonlinearBayesianController,
    NonlinearModel,
    WishartPrecision,
)
from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.ops import cos, exp, sin, sqrt, square

STEP, LENGTH = 0.02, 0.5


def swing(x, u, x_next):
    """A pendulum: angle (rad) and angular velocity (rad/s), driven by an angular acceleration."""
    speed = x[1] + STEP * (u[0] - 9.81 / LENGTH * sin(x[0]) - 0.2 * x[1])
    x_next[0] = x[0] + STEP * speed
    x_next[1] = speed


def swing_jacobian(x, u, F, B):
    F[1, 0] = -STEP * 9.81 / LENGTH * cos(x[0])
    F[1, 1] = 1.0 - STEP * 0.2
    F[0, 0] = 1.0 + STEP * F[1, 0]
    F[0, 1] = STEP * F[1, 1]
    B[1, 0] = STEP
    B[0, 0] = STEP * STEP


def look(x, y):
    """Two encoders, and a camera that sees the bob from the side."""
    y[0] = x[0]
    y[1] = x[0]
    y[2] = LENGTH * sin(x[0])


def look_jacobian(x, C):
    for i in range(3):
        C[i, 1] = 0.0
    C[0, 0] = 1.0
    C[1, 0] = 1.0
    C[2, 0] = LENGTH * cos(x[0])


STD = (0.01, 0.01, 0.005)
PENDULUM = NonlinearModel(swing, look, 2, 1, 3, [1e-8, 1e-5], np.square(STD), STEP)
# The goal for angle and speed together closes in on the angle with a time constant of (dt^2 + Va / Vw) / dt = 0.2 s.
SETTINGS = {"goal_covariance": [3.6e-5, 1e-2], "initial_covariance": 0.01}


def linear_problem(rng):
    n, p, m = (int(k) for k in rng.integers(1, 5, size=3))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    F, S = rng.normal(size=(n, max(n - 1, 1))), rng.normal(size=(m, m))  # process noise of rank n - 1
    model = LinearModel(
        A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), 0.1 * F @ F.T, S @ S.T + 0.1 * np.eye(m), 0.1
    )
    flat = p <= n and rng.random() < 0.5
    options = {
        "goal_covariance": rng.uniform(0.1, 2.0, n),
        "control_covariance": None if flat else float(rng.choice([0.1, 1.0, 1e6])),
        "control_mean": rng.normal(size=p),
        "initial_covariance": np.diag(rng.choice([0.0, 0.5, 3.0], size=n)),
        "u_max": 5.0,
        "u_rate": 50.0,
    }
    return model, options


def both_controllers(model, iterations=2, **options):
    """Where the model is linear one step is enough, and further ones must change nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
        linear = BayesianController(model, **options)
    nonlinear = NonlinearBayesianController(model, iterations=iterations, **options)
    return linear.online(compiled=False), nonlinear.online(compiled=False)


def assert_alike(a, b, tolerance=1e-9):
    assert list(a) == list(b)
    for name in b:
        if name == "model_suspect":  # of steady filters there, of extended ones here: see test_extended_check.py
            continue
        np.testing.assert_allclose(
            b[name], a[name], rtol=tolerance, atol=tolerance * max(1.0, np.nanmax(np.abs(a.x_hat)))
        )


LEARNERS = [
    FixedPrecision(),
    GammaPrecision(forgetting=0.9),
    WishartPrecision(forgetting=0.9),
    EFFDI(duration=0.4),
    SERFDI(),
]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("belief", ["filtered", "joint"])
@pytest.mark.parametrize("precision", LEARNERS, ids=lambda p: type(p).__name__)
def test_for_a_linear_model_it_is_the_closed_form(belief, precision):
    """Random models, singular process noise and priors, missing samples and goals, limits, correlated sensors."""
    rng = np.random.default_rng(5)
    for iterations in (40, 2, 2):
        model, options = linear_problem(rng)
        a, b = both_controllers(model, iterations, belief=belief, precision=precision, **options)
        for _ in range(12):
            y, goal = rng.normal(size=model.sensors), rng.normal(size=model.states)
            y[rng.random(model.sensors) < 0.2] = np.nan
            goal[rng.random(model.states) < 0.1] = np.nan
            assert_alike(a(y=y, goal=goal), b(y=y, goal=goal))


@dataclass
class Problem:
    """A strongly nonlinear sample, and its joint cost over [x_t, u_t, x_t+1] in plain NumPy."""

    controller: NonlinearBayesianController
    y: np.ndarray
    goal: np.ndarray
    f: Callable
    g: Callable

    def __post_init__(self):
        c = self.controller
        self.sizes = c.model.states, c.model.controls
        Q, R = c.model.matrix("process_covariance"), c.model.matrix("sensor_covariance")
        covariances = c.initial_covariance, R, Q, c.goal_covariance, c.control_covariance
        self.whitening = [np.linalg.inv(np.linalg.cholesky(S)) for S in covariances]
        self.gain = Q @ np.linalg.inv(Q + c.goal_covariance)
        # The spread of each unknown at the prior: the yardstick of distance.
        self.width = np.sqrt(np.concatenate([np.diag(covariances[k]) for k in (0, 4, 3)]))
        self.prior_mean = self.completed(np.asarray(c.initial_mean), np.asarray(c.control_mean))

    def residuals(self, z):
        c, (n, p) = self.controller, self.sizes
        x, u, x_next = z[:n], z[n : n + p], z[n + p :]
        terms = (x - c.initial_mean, self.y - self.g(x), x_next - self.f(x, u), x_next - self.goal, u - c.control_mean)
        return np.concatenate([W @ r for W, r in zip(self.whitening, terms, strict=True)])

    def cost(self, z):
        return 0.5 * float(np.sum(self.residuals(z) ** 2))

    def completed(self, x, u):
        """Return [x, u, x_next] with the best next state for given x and u."""
        following = self.f(x, u)
        return np.concatenate([x, u, following + self.gain @ (self.goal - following)])

    def solution(self):
        out = self.controller.online(compiled=False)(y=self.y, goal=self.goal)
        return self.completed(out.x_hat, out.u)

    def drawn(self, rng):
        """Return a start drawn from the prior, twice as wide."""
        n, p = self.sizes
        start = self.prior_mean + 2.0 * self.width * rng.normal(size=len(self.width))
        return self.completed(start[:n], start[n : n + p])

    def same_basin(self, a, b):
        """Return whether two minima are one: at most 1e-3 spreads of the prior apart."""
        return np.abs((a - b) / self.width).max() < 1e-3


def random_problem(seed):
    """Sines and squares in f and g whose bends are as large as the prior is wide."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    m = int(rng.integers(n, n + 3))
    p = int(rng.integers(1, n + 1))
    A, B = np.eye(n) + 0.3 * rng.normal(size=(n, n)), rng.normal(size=(n, p))
    W, S, Z = (s * rng.normal(size=k) for s, k in ((1.0, (n, n)), (0.5, (n, n)), (0.2, (n, p))))
    C, V, E = (s * rng.normal(size=k) for s, k in ((1.0, (m, n)), (2.0, (m, n)), (0.5, (m, 2))))

    def f(x, u):
        return A @ x + B @ u + Z @ u**2 + np.sin(W @ x) * (S @ x)

    def g(x):
        return C @ x + E[:, 0] * np.sin(V @ x) + 0.2 * E[:, 1] * (V @ x) ** 2

    R, P = rng.uniform(0.05, 1.0, m), rng.uniform(0.2, 1.0, n)
    mean = rng.normal(size=n)
    y = g(mean + np.sqrt(P) * rng.normal(size=n))
    step_functions = as_step_functions(*(tuple(map(tuple, a.tolist())) for a in (A, B, W, S, Z, C, V, E)))
    controller = NonlinearBayesianController(
        NonlinearModel(*step_functions, n, p, m, 0.05 * np.eye(n) + 0.02, R, 0.1),
        FixedPrecision(),
        goal_covariance=float(rng.choice([0.1, 1.0])),
        control_covariance=float(rng.choice([0.3, 3.0, 100.0])),
        control_mean=rng.normal(size=p),
        belief="joint",
        initial_mean=mean,
        initial_covariance=P,
    )
    return Problem(controller, y + np.sqrt(R) * rng.normal(size=m), mean + rng.normal(size=n), f, g)


def as_step_functions(A, B, W, S, Z, C, V, E):
    n, p, m = len(A), len(B[0]), len(C)

    def f(x, u, x_next):
        for i in range(n):
            inner, total = 0.0, 0.0
            for j in range(n):
                total = total + A[i][j] * x[j]
                inner = inner + W[i][j] * x[j]
            for j in range(p):
                total = total + B[i][j] * u[j] + Z[i][j] * square(u[j])
            for j in range(n):
                total = total + S[i][j] * sin(inner) * x[j]
            x_next[i] = total

    def g(x, y):
        for i in range(m):
            inner, total = 0.0, 0.0
            for j in range(n):
                total = total + C[i][j] * x[j]
                inner = inner + V[i][j] * x[j]
            y[i] = total + E[i][0] * sin(inner) + 0.2 * E[i][1] * square(inner)

    return f, g


def by_least_squares(problem, start, method="lm"):
    return least_squares(problem.residuals, start, method=method, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(12))
def test_no_optimiser_of_scipys_finds_less_in_the_same_basin(seed):
    """Several optimisers, started from our solution and from the prior mean."""
    problem = random_problem(1000 + seed)
    ours = problem.solution()
    cost = problem.cost(ours)
    gradient = approx_fprime(ours, problem.cost, 1e-7) * problem.width
    assert np.abs(gradient).max() < 1e-4 * max(cost, 1.0)  # as exact as differences are
    for start in (ours, problem.prior_mean):
        found = [minimize(problem.cost, start, method=method, tol=1e-12).x for method in ("BFGS", "Nelder-Mead")]
        for theirs in found + [by_least_squares(problem, start, method) for method in ("lm", "trf")]:
            if start is ours or problem.same_basin(theirs, ours):
                assert problem.cost(theirs) >= cost * (1.0 - 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("problems", [20, 2000])
def test_every_search_converges_and_how_often_a_better_minimum_lies_elsewhere(problems):
    """Two things that are not the same.

    Each search must have converged: within its basin SciPy (Levenberg and Marquardt's method from our solution, and from the
    prior mean) finds no cost lower by more than 1e-8. That a lower minimum lies in another basin, where a search from the prior
    mean or from twenty draws of the prior finds it, is no failure of the search: its share is reported, of every tenth problem.
    The seeds are not those that the default of `iterations` was chosen on.
    """
    unconverged, elsewhere = [], []
    for seed in range(100_000, 100_000 + problems):
        problem, rng = random_problem(seed), np.random.default_rng(seed)
        ours = problem.solution()
        bound = problem.cost(ours) * (1.0 - 1e-8)
        nearby = by_least_squares(problem, ours)
        starts = [problem.prior_mean, *(problem.drawn(rng) for _ in range(20 * (seed % 10 == 0)))]
        lower = [z for z in (by_least_squares(problem, start) for start in starts) if problem.cost(z) < bound]
        if problem.cost(nearby) < bound or any(problem.same_basin(z, nearby) for z in lower):
            unconverged.append(seed)
        elif seed % 10 == 0:
            elsewhere.append(len(lower) > 0)
    share = np.mean(elsewhere)
    print(f"Of {problems} searches {len(unconverged)} have not converged.")  # noqa: T201
    print(f"Of {len(elsewhere)} problems {share:.3f} have a better minimum in another basin.")  # noqa: T201
    assert not unconverged
    assert share < 0.2
    assert share > 0.0 or problems < 2000  # a few problems may have none


def test_disturbances_of_a_linear_model_are_no_goals():
    model = LinearModel([[0.9]], [[0.5]], [[1.0]], 0.01, 0.1, 0.1).with_disturbance(1e-3)
    options = {"precision": FixedPrecision(), "initial_mean": 0.5, "initial_covariance": 1.0}
    closed, searched = (kind(model, **options) for kind in (BayesianController, NonlinearBayesianController))
    assert searched.goals == closed.goals == 1
    outs = [c.online(compiled=False)(y=[0.7], goal=[1.0]) for c in (closed, searched)]
    np.testing.assert_allclose(outs[1].u, outs[0].u, rtol=1e-9)
    np.testing.assert_allclose(outs[1].x_hat, outs[0].x_hat, rtol=1e-9)
    with pytest.raises(ModelError, match="disturbances=2"):
        replace(searched.model, disturbances=2)


def test_one_step_is_an_extended_kalman_filters():
    """filterpy's extended Kalman filter makes one undamped step from the prediction; more steps are a better minimum."""
    from filterpy.kalman import ExtendedKalmanFilter

    rng, y = np.random.default_rng(0), np.empty(3)
    for _ in range(20):
        mean = rng.normal(size=2)
        look(mean + 0.1 * rng.normal(size=2), y)
        y += np.array(STD) * rng.normal(size=3)
        ekf = ExtendedKalmanFilter(2, 3)
        ekf.x, ekf.P, ekf.R = mean.copy(), 0.01 * np.eye(2), np.diag(np.square(STD))
        C, reading = np.empty((3, 2)), np.empty(3)
        look_jacobian(mean, C)
        look(mean, reading)
        ekf.update(y.copy(), lambda x, C=C: C, lambda x, reading=reading: reading)
        controller = NonlinearBayesianController(
            PENDULUM, FixedPrecision(), iterations=1, initial_mean=mean, **SETTINGS
        )
        out = controller.online(compiled=False)(y=y, goal=[0.0, 0.0])
        np.testing.assert_allclose(out.x_hat, ekf.x, rtol=1e-9, atol=1e-12)


def encoders(x, y):
    y[0] = x[0]
    y[1] = x[0]


def test_with_linear_sensors_a_run_is_an_extended_kalman_filters():
    from filterpy.kalman import ExtendedKalmanFilter

    model = NonlinearModel(swing, encoders, 2, 1, 2, [1e-8, 1e-5], [1e-4, 4e-4], STEP)
    step = NonlinearBayesianController(model, FixedPrecision(), **SETTINGS).online()
    ekf, rng = ExtendedKalmanFilter(2, 2), np.random.default_rng(1)
    ekf.x, ekf.P, ekf.R, ekf.Q = np.zeros(2), 0.01 * np.eye(2), np.diag([1e-4, 4e-4]), np.diag([1e-8, 1e-5])
    C, F, B = np.array([[1.0, 0.0], [1.0, 0.0]]), np.empty((2, 2)), np.empty((2, 1))
    for k in range(80):
        y = 0.5 * np.sin(0.1 * k) + 0.01 * rng.normal(size=2)
        out = step(y=y, goal=[0.3, 0.0])
        ekf.update(y, lambda x: C, lambda x: C @ x)
        np.testing.assert_allclose(out.x_hat, ekf.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(out.P, ekf.P, rtol=1e-9, atol=1e-15)
        swing_jacobian(ekf.x, out.u, F, B)
        following = np.empty(2)
        swing(ekf.x, out.u, following)
        ekf.x, ekf.P = following, F @ ekf.P @ F.T + ekf.Q


def test_the_covariance_is_that_of_the_model_linearised_at_the_estimate():
    controller = NonlinearBayesianController(PENDULUM, FixedPrecision(), initial_mean=[1.2, 0.0], **SETTINGS)
    out = controller.online(compiled=False)(y=[1.0, 1.01, 0.42], goal=[1.0, 0.0])
    C = np.empty((3, 2))
    look_jacobian(out.x_hat, C)
    information = np.eye(2) / 0.01 + C.T @ np.diag(1 / np.square(STD)) @ C
    np.testing.assert_allclose(out.P, np.linalg.inv(information), rtol=1e-9, atol=1e-15)


def test_a_random_walk_predicts_the_belief_itself():
    options = {"precision": FixedPrecision(), "initial_mean": [0.3, 1.0], **SETTINGS, "prediction": "random walk"}
    step = NonlinearBayesianController(PENDULUM, **options).online(compiled=False)
    first = step(y=[0.3, 0.31, 0.15], goal=[0.5, 0.0])
    second = step(y=[0.32, 0.33, 0.16], goal=[0.5, 0.0])
    reading = np.empty(3)
    look(first.x_hat, reading)
    np.testing.assert_allclose(second.innovation, [0.32, 0.33, 0.16] - reading, rtol=1e-12)
    model = LinearModel(np.eye(2), np.zeros((2, 1)), [[1.0, 0.0]] * 2, [1e-8, 1e-5], 1e-4, STEP)
    linear = NonlinearModel(swing, encoders, 2, 1, 2, [1e-8, 1e-5], 1e-4, STEP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
        kalman = BayesianController(model, FixedPrecision(), control_covariance=1.0, **SETTINGS).online(compiled=False)
    walk = NonlinearBayesianController(linear, FixedPrecision(), prediction="random walk", **SETTINGS).online(
        compiled=False
    )
    for y in ([0.1, 0.2], [None, 0.3], [0.2, 0.1]):
        a, b = kalman(y=y, goal=[0.0, 0.0]), walk(y=y, goal=[0.0, 0.0])
        np.testing.assert_allclose(b.x_hat, a.x_hat, rtol=1e-9)
        np.testing.assert_allclose(b.P, a.P, rtol=1e-9)


def test_derivatives_that_are_given_do_what_derived_ones_do():
    given = replace(PENDULUM, f_jacobian=swing_jacobian, g_jacobian=look_jacobian)
    a, b = (NonlinearBayesianController(m, **SETTINGS).online(compiled=False) for m in (PENDULUM, given))
    for y in ([0.3, 0.31, 0.15], [0.32, None, 0.16]):
        assert_alike(a(y=y, goal=[0.5, 0.0]), b(y=y, goal=[0.5, 0.0]), 1e-12)


@pytest.mark.parametrize("belief", ["filtered", "joint"])
def test_a_missing_goal_holds_the_control_under_a_flat_prior(belief):
    step = NonlinearBayesianController(PENDULUM, belief=belief, **SETTINGS).online(compiled=False)
    before = step(y=[0.1, 0.1, 0.05], goal=[0.2, 0.0])
    out = step(y=[0.1, 0.1, 0.05], goal=[np.nan, np.inf])
    assert out.u[0] == before.u[0] != 0.0
    assert np.isfinite(out.x_hat).all()
    assert (np.linalg.eigvalsh(out.P) > 0).all()


def moving(x, u, noise, theta, omega, following, standard):
    for _ in range(10):
        following[1] = x[1] + 0.1 * STEP * (u[0] - 9.81 / LENGTH * sin(x[0]) - 0.2 * x[1])
        x[0] = x[0] + 0.1 * STEP * following[1]
        x[1] = following[1]
    x[1] = x[1] + standard[0] * noise[0]


def shown(x, theta, omega):
    theta[0] = x[0]
    omega[0] = x[1]


def brain(precision, **settings):
    """One form of the controller for all that is compiled here: what differs in numbers alone is compiled once."""
    return NonlinearBayesianController(PENDULUM, precision=precision, iterations=10, **SETTINGS, **settings)


def track(make_block, precision, faults):
    plant = make_block(
        inputs=[cosim.Port("u", feedthrough=False), cosim.Port("noise", draw="normal", feedthrough=False)],
        outputs=[cosim.Port("theta"), cosim.Port("omega")],
        finite=True,
        output=shown,
        update=moving,
        state={"x": np.zeros(2), "following": np.zeros(2)},
        parameters={"standard": 0.003},
    )
    return cosim.closed_loop(
        plant=plant,
        controller=brain(precision, u_min=-60.0, u_max=60.0),
        control="u",
        measured=["theta", "omega"],
        sensors=cosim.Sensors(count=3, std=STD, signals=2, function=look),
        faults=faults,
        reference=[cosim.Sine(amplitude=1.0, period=4.0), 0.0],
    )


@pytest.mark.slow
def test_tracking_goes_on_while_a_sensor_fails(make_block, same_bits):
    fault = [cosim.Injection(sensor=0, start=1.5, stop=4.0, magnitude=0.6)]
    learned = GammaPrecision(forgetting=0.9)
    errors, results = {}, {}
    for name, precision, faults in (
        ("healthy", learned, []),
        ("learned", learned, fault),
        ("fixed", FixedPrecision(), fault),
    ):
        results[name] = result = track(make_block, precision, faults).simulate(4.0, seed=3, engine="interpreted")
        during = result.time > 2.0
        errors[name] = float(np.sqrt(np.mean((result["plant.theta"] - result["controller.x_hat"][:, 0])[during] ** 2)))
    assert errors["learned"] < 1.5 * errors["healthy"]
    assert errors["fixed"] > 10.0 * errors["healthy"]
    # Both engines compute the same bits, fault and all.
    compiled = track(make_block, learned, fault).simulate(4.0, seed=3)
    for name in compiled:
        same_bits(compiled[name], results["learned"][name], name)


def wild(x, u, x_next):
    """A motion that overflows far away, and a measurement that is no number below zero."""
    x_next[0] = x[0] + 0.1 * u[0] - 0.1 * (exp(x[0]) - 1.0)


def roots(x, y):
    y[0] = sqrt(x[0] + 2.0)
    y[1] = x[0]


def absurd(rng, steps, sensors, around):
    y = around + 0.1 * rng.normal(size=(steps, sensors))
    odd = rng.random((steps, sensors))
    y = np.select([odd < 0.01, odd < 0.02, odd < 0.03, odd < 0.04], [1e300, -np.inf, np.nan, -1e12], y)
    for start in rng.integers(0, steps, 20):
        y[start : start + 60] = np.nan
    return y


@pytest.mark.sampled(1)
@pytest.mark.parametrize("belief", ["filtered", "joint"])
@pytest.mark.parametrize("precision", [FixedPrecision(), GammaPrecision(), WishartPrecision()], ids=repr)
def test_absurd_samples_are_survived(belief, precision):
    model = NonlinearModel(wild, roots, 1, 1, 2, 1e-3, 0.01, 0.1)
    controller = NonlinearBayesianController(model, precision=precision, belief=belief, iterations=10)
    step = controller.online(compiled=False)
    y = absurd(np.random.default_rng(4), 200, 2, np.array([np.sqrt(2.0), 0.0]))
    y[-20:] = [np.sqrt(2.0), 0.0]
    for row in y:
        out = step(y=row, goal=[0.0])
        assert np.isfinite(out.x_hat).all()
        assert np.isfinite(out.u).all()
        assert (np.linalg.eigvalsh(out.P) > 0).all()
    assert abs(out.x_hat[0]) < 0.5


def hold(x, u, x_next):
    x_next[0] = x[0] + u[0]


def escape(x, u, x_next):
    x_next[0] = exp(x[0] + u[0])


@pytest.mark.parametrize(("f", "far"), [(hold, 1e120), (hold, 1e160), (escape, 1e3)])
def test_a_belief_that_is_lost_begins_anew(f, far):
    """Sent to where squares, or the model itself, are no numbers, it is back after one step."""
    model = NonlinearModel(f, encoders, 1, 1, 2, 1e-3, 0.01, 0.1)
    step = NonlinearBayesianController(
        model, FixedPrecision(), control_covariance=1e6, initial_mean=0.1, u_min=-1.0, u_max=1.0
    ).online(compiled=False)
    step(y=[0.1, 0.1], goal=[0.1])
    step._view("mean")[0] = far
    for _ in range(2):
        out = step(y=[0.2, 0.2], goal=[0.2])
    assert abs(out.x_hat[0] - 0.2) < 0.1
    assert np.isfinite(out.u).all()


def repeated(samples, y, k):
    for i in range(3):
        y[i] = samples[k % samples.shape[0], i]


@pytest.mark.slow
def test_a_long_run_of_absurd_samples_leaves_covariances_positive_definite(make_block):
    """A hundred thousand steps; every hundredth belief is looked at."""
    samples = absurd(np.random.default_rng(7), 5000, 3, np.zeros(3))
    source = make_block(
        outputs=[cosim.Port("y", (3,))], output=repeated, parameters={"samples": samples}, name="samples"
    )
    diagram = cosim.Diagram(STEP)
    node = diagram.add(source)
    goal = diagram.add(cosim.Constant(0.0), "goal")
    controller = diagram.add(brain(GammaPrecision()), "controller")
    diagram.connect(node["y"], controller["y"])
    diagram.connect([goal["y"], goal["y"]], controller["goal"])
    names = ["controller.x_hat", "controller.P", "controller.u"]
    result = diagram.simulate(100_000 * STEP, record=names, decimation=100)
    assert all(np.isfinite(result[name]).all() for name in names)
    assert (np.linalg.eigvalsh(result["controller.P"]) > 0).all()


def test_it_says_what_each_sensor_reads_of_the_state():
    """By it `bayesftc run` finds the tracking error and the belief's; the camera is no linear function."""
    np.testing.assert_array_equal(
        NonlinearBayesianController(PENDULUM, FixedPrecision()).measurement_matrix,
        [[1.0, 0.0], [1.0, 0.0], [np.nan, np.nan]],
    )
    model, options = linear_problem(np.random.default_rng(2))
    read = NonlinearBayesianController(model, **options).measurement_matrix
    np.testing.assert_allclose(read, model.matrix("C"), rtol=1e-15)


def test_models_and_controllers_pickle():
    controller = NonlinearBayesianController(PENDULUM, **SETTINGS)
    copy = pickle.loads(pickle.dumps(controller))
    a, b = (c.online(compiled=False)(y=[0.1, 0.1, 0.05], goal=[0.2, 0.0]) for c in (controller, copy))
    assert_alike(a, b, 0.0)


def short(x, y):
    y[0] = x[0]


def beyond(x, y):
    for i in range(3):
        y[i] = x[2]


def greedy(x, y):
    x[0] = 1.0
    look(x, y)


def branching(x, y):
    for i in range(3):
        y[i] = x[0] if x[0] > 0 else 0.0


def uneven(x, y):
    y[:] = x


def imported(x, y):
    for i in range(3):
        y[i] = math.sin(x[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"states": 0}, "states=0; it must be a whole number"),
        ({"process_covariance": [1.0, 2.0, 3.0]}, "process_covariance is 3 x 1; it must be 2 x 2"),
        ({"process_covariance": [1.0, -1.0]}, "positive semi-definite"),
        ({"sensor_covariance": 0.0}, "sensor_covariance is not positive definite"),
        ({"g": short}, r"g does not write y\[1\]"),
        ({"sensors": 2, "sensor_covariance": 1.0}, "reaches beyond its arguments"),
        ({"g": beyond}, "reaches beyond its arguments .* x has 2"),
        ({"g": greedy}, "writes into its inputs"),
        ({"g": swing}, r"arguments x, u, x_next; it must be a step function g\(x, y\)"),
        ({"f": np.sin}, r"it must be a step function f\(x, u, x_next\)"),
        ({"g": uneven}, "g 'uneven' .* cannot be computed: could not broadcast"),
        ({"states": "2"}, "states='2'; it must be a whole number"),
        ({"controls": None}, "controls=None; it must be a whole number"),
        ({"sensors": -3}, "sensors=-3; it must be a whole number"),
        ({"process_covariance": "small"}, "process_covariance is 'small'"),
        ({"f_jacobian": look_jacobian}, "f_jacobian has the arguments x, C"),
        ({"dt": -1}, "must be positive"),
    ],
)
def test_models_that_cannot_be_right(change, words):
    with pytest.raises(ValueError, match=words):
        replace(PENDULUM, **change)


def test_a_function_that_branches_needs_its_derivatives():
    with pytest.raises(KernelError, match=r"The model's g: .* branches on data.* as g_jacobian"):
        replace(PENDULUM, g=branching)


def test_a_function_that_breaks_the_rules_of_step_functions_is_refused():
    with pytest.raises(KernelError, match=r"The model's g: .*'imported' .*uses 'math'.* bayesftc.cosim.ops \(absolute"):
        replace(PENDULUM, g=imported)


def test_without_any_sensor_or_goal_the_belief_is_the_prediction():
    step = brain(FixedPrecision(), initial_mean=[0.3, 1.0]).online(compiled=False)
    out, following = step(y=[None] * 3, goal=[None, np.nan]), np.empty(2)
    np.testing.assert_allclose(out.x_hat, [0.3, 1.0], rtol=1e-12)
    np.testing.assert_allclose(out.P, 0.01 * np.eye(2), rtol=1e-12, atol=1e-15)
    assert out.u[0] == 0.0
    second = step(y=[None] * 3, goal=[None, None])
    swing(out.x_hat, out.u, following)
    np.testing.assert_allclose(second.x_hat, following, rtol=1e-12)


def infinite(x, y):
    for i in range(3):
        y[i] = 1.0 / x[0]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"model": 3.0}, "needs a NonlinearModel"),
        ({"precision": 3.0}, "precision learner"),
        ({"goal_covariance": -1.0}, "goal_covariance is not positive definite"),
        ({"goal_covariance": [[1.0, 2.0], [2.0, 1.0]]}, "goal_covariance is not positive definite"),
        ({"initial_covariance": [1.0, -1.0]}, "initial_covariance is not positive semi-definite"),
        ({"initial_mean": [1.0, 2.0, 3.0]}, "initial_mean has the shape"),
        ({"control_covariance": 0.0}, "control_covariance is not positive definite"),
        ({"goal_on": [[0.0, 0.0]]}, "flat control prior"),
        ({"goal_on": [[1.0]]}, "goal_on is 1 x 1"),
        ({"goal_on": "outputs"}, "for linear models"),
        ({"belief": "kalman"}, "must be 'filtered' or 'joint'"),
        ({"prediction": "euler"}, "'model' or 'random walk'"),
        ({"prediction": ["model"]}, "'model' or 'random walk'"),
        ({"belief": {}}, "must be 'filtered' or 'joint'"),
        ({"goal_on": [["a"]]}, "goal_on is .*give a row for each element"),
        ({"initial_mean": "upright"}, "initial_mean is 'upright'"),
        *(
            ({"iterations": n}, "iterations=.* whole number")
            for n in (0, -3, 20.5, "20", None, True, np.nan, np.inf, [3])
        ),
        ({"u_min": 1.0, "u_max": 0.0}, "u_min is 1, above its u_max of 0"),
        ({"model": replace(PENDULUM, g=infinite)}, "g is not finite at x = "),
    ],
)
def test_controllers_that_cannot_be_right(settings, words):
    with pytest.raises(ModelError, match=words):
        NonlinearBayesianController(**{"model": PENDULUM, **settings})
