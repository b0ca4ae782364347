"""The control law against dense Gaussian conditioning and scipy's optimiser; limits, disturbances, warnings, bad settings."""

import pickle
import warnings

import numpy as np
import pytest
from scipy.optimize import minimize

from bayesftc import controllers
from bayesftc.controllers import BayesianController, FixedPrecision, LinearModel
from bayesftc.controllers.bayesian import steady as _steady
from bayesftc.cosim.errors import ModelError


def random_model(rng, n, p, m):
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    F, G = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    return LinearModel(
        A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), 0.1 * F @ F.T, G @ G.T + 0.1 * np.eye(m), 0.1
    )


def quadratic(model, G, goal_cov, control_cov, control_mean, mean, cov, y, goal):
    """Return the negative log joint of the paper's section 2.3 over z = [x_t, u_t, x_t+1], as a function and its Hessian."""
    A, B, C = (model.matrix(name) for name in "ABC")
    n, p = B.shape
    X, U, N = np.eye(n, 2 * n + p), np.eye(p, 2 * n + p, n), np.eye(n, 2 * n + p, n + p)
    terms = [
        (X, mean, cov),
        (C @ X, y, model.matrix("sensor_covariance")),
        (N - A @ X - B @ U, np.zeros(n), model.matrix("process_covariance")),
        (G @ N, goal, goal_cov),
        (U, control_mean, control_cov),
    ]
    H = sum(J.T @ np.linalg.solve(S, J) for J, _, S in terms)
    b = sum(J.T @ np.linalg.solve(S, r) for J, r, S in terms)
    return H, b


@pytest.mark.parametrize(("n", "p", "m", "outputs"), [(1, 1, 2, 1), (3, 2, 2, 3), (3, 2, 4, 1), (2, 3, 1, 2)])
def test_control_and_joint_belief_are_the_dense_posteriors(n, p, m, outputs):
    rng = np.random.default_rng(n + 10 * p)
    model = random_model(rng, n, p, m)
    G = np.eye(n) if outputs == n else rng.normal(size=(outputs, n))
    mean, goal, y = rng.normal(size=n), rng.normal(size=len(G)), rng.normal(size=m)
    cov = 0.5 * np.eye(n)
    priors = {"control_covariance": 2.0, "control_mean": 0.3, "goal_covariance": 0.2, "goal_on": G}
    priors["precision"] = FixedPrecision()
    for belief in ("filtered", "joint"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
            controller = BayesianController(model, belief=belief, initial_mean=mean, initial_covariance=cov, **priors)
        out = controller.online(compiled=False)(y=y, goal=goal)
        H, b = quadratic(model, G, 0.2 * np.eye(len(G)), 2.0 * np.eye(p), np.full(p, 0.3), mean, cov, y, goal)
        posterior = np.linalg.solve(H, b)
        np.testing.assert_allclose(out.u, posterior[n : n + p], rtol=1e-9, atol=1e-11)
        if belief == "joint":
            np.testing.assert_allclose(out.x_hat, posterior[:n], rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose(out.P, np.linalg.inv(H)[:n, :n], rtol=1e-8, atol=1e-11)
        optimum = minimize(
            lambda z, H=H, b=b: 0.5 * z @ H @ z - b @ z, np.zeros(len(b)), jac=lambda z, H=H, b=b: H @ z - b, tol=1e-12
        )
        np.testing.assert_allclose(out.u, optimum.x[n : n + p], rtol=1e-4, atol=1e-4)


def test_closed_form_of_the_cruise_control():
    a, B, Vg, Vu, Q = 1 - 5 / 100 * 0.02, 0.02 / 100, 0.5, 1e5, 0.001
    model = LinearModel([[a]], [[B]], [[1.0], [1.0]], Q, 1.0, 0.02)
    controller = BayesianController(
        model, FixedPrecision(), goal_covariance=Vg, control_covariance=Vu, initial_mean=18.0
    )
    out = controller.online(compiled=False)(y=[18.4, 17.9], goal=[20.0])
    mu, P = out.x_hat[0], out.P[0, 0]
    assert out.u[0] == pytest.approx(B * Vu * (20.0 - a * mu) / (B * B * Vu + Vg + Q + a * a * P), rel=1e-12)
    deadbeat = BayesianController(model, FixedPrecision(), initial_mean=18.0).online(compiled=False)(
        y=[18.4, 17.9], goal=[20.0]
    )
    assert deadbeat.u[0] == pytest.approx((20.0 - a * deadbeat.x_hat[0]) / B, rel=1e-12)


def test_goals_on_outputs_take_each_distinct_output_once():
    model = LinearModel(np.diag([0.9, 0.8]), np.eye(2), [[1.0, 1.0], [1.0, 1.0], [0.0, 1.0]], 0.1, 1.0, 0.1)
    controller = BayesianController(model, FixedPrecision(), goal_on="outputs")
    assert controller.goals == 2
    out = controller.online(compiled=False)(y=[0.0, 0.0, 0.0], goal=[3.0, 1.0])
    next_state = model.matrix("A") @ out.x_hat + out.u
    np.testing.assert_allclose([next_state.sum(), next_state[1]], [3.0, 1.0], atol=1e-12)


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")  # it is, on purpose
def test_limits_hold_and_the_prediction_uses_the_applied_control():
    model = LinearModel(
        [[1.0]], [[1.0]], [[1.0]], 1e-9, 1e9, 0.5
    )  # the sensor tells nothing: the belief is the prediction
    controller = BayesianController(
        model, FixedPrecision(), u_min=-1.0, u_max=2.0, u_rate=2.0, initial_mean=0.0, initial_covariance=1e-12
    )
    step = controller.online(compiled=False)
    out = [step(y=[0.0], goal=[10.0]) for _ in range(4)]
    np.testing.assert_allclose([o.u[0] for o in out], [1.0, 2.0, 2.0, 2.0])  # at most 2.0 a second times 0.5 s, then 2
    np.testing.assert_allclose([o.x_hat[0] for o in out], [0.0, 1.0, 3.0, 5.0], atol=1e-6)
    down = [step(y=[0.0], goal=[-50.0]).u[0] for _ in range(5)]
    np.testing.assert_allclose(down, [1.0, 0.0, -1.0, -1.0, -1.0])


@pytest.mark.filterwarnings("ignore::bayesftc.controllers.UnstableLoopWarning")
@pytest.mark.parametrize(
    ("given", "first"), [({}, 0.7), ({"initial_control": 0.2}, 0.1), ({"initial_control": [0.9]}, 0.8)]
)
def test_the_rate_counts_from_the_control_of_the_operating_point_or_the_given_one(given, first):
    """It counted from 0, so that a plant at rest was first driven away from its operating point."""
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], 0.1, 1.0, 0.1).about([20.0], [0.8], [20.0])
    controller = BayesianController(
        model, FixedPrecision(), u_rate=1.0, goal_on=[[1.0, 0.0]], initial_mean=20.0, **given
    )
    step = controller.online(compiled=False)
    assert step(y=[20.0], goal=[19.0]).u[0] == pytest.approx(first)


def test_limits_win_over_the_rate():
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], 0.1, 1.0, 0.02)
    step = BayesianController(model, FixedPrecision(), u_min=-100.0, u_max=-10.0, u_rate=1.0).online(compiled=False)
    assert [step(y=[0.0], goal=[5.0]).u[0] for _ in range(3)] == [-10.0, -10.0, -10.0]


@pytest.mark.parametrize("belief", ["filtered", "joint"])
@pytest.mark.parametrize("limit", [np.inf, 1000.0])
def test_a_missing_goal_holds_the_control_under_a_flat_prior(belief, limit):
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-3, 1.0, 0.02)
    step = BayesianController(
        model, FixedPrecision(), belief=belief, u_min=-limit, u_max=limit, initial_mean=20.0
    ).online(compiled=False)
    before = step(y=[20.0, 20.0], goal=[20.0])
    for missing in (np.nan, np.inf):
        out = step(y=[20.0, 20.0], goal=[missing])
        assert out.u[0] == before.u[0]
        assert np.isfinite(out.x_hat).all()
        assert np.isfinite(out.P).all()
    assert np.isfinite(step(y=[20.0, 20.0], goal=[20.0]).u).all()


def test_a_missing_goal_leaves_the_control_to_its_prior_and_the_other_goals():
    model = LinearModel(np.diag([0.9, 0.8]), np.eye(2), np.eye(2), 0.1, 1.0, 0.1)
    options = {"control_covariance": 2.0, "control_mean": [0.3, -0.7], "goal_covariance": [[1.0, 0.5], [0.5, 2.0]]}
    out = BayesianController(model, **options).online(compiled=False)(y=[1.0, 2.0], goal=[np.nan, 5.0])
    only = BayesianController(model, **{**options, "goal_on": [[0.0, 1.0]], "goal_covariance": 2.0})
    np.testing.assert_allclose(out.u, only.online(compiled=False)(y=[1.0, 2.0], goal=[5.0]).u, rtol=1e-12)
    assert out.u[0] == pytest.approx(0.3)


def test_a_singular_belief_is_conditioned_on_the_goal_where_it_is_not_certain():
    """One state is known exactly: the joint belief moves the other one only, and equals the limit of ever surer beliefs."""
    model = LinearModel(np.diag([0.9, 0.8]), [[1.0], [0.5]], np.eye(2), 0.01, 1.0, 0.1)
    options = {"belief": "joint", "control_covariance": 1.0, "goal_covariance": 0.1, "initial_mean": [1.0, 2.0]}
    options["precision"] = FixedPrecision()

    def belief(covariance):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
            return BayesianController(model, initial_covariance=covariance, **options).online(compiled=False)(
                y=[1.5, 2.5], goal=[0.0, 0.0]
            )

    exact, nearly = belief([0.0, 0.5]), belief([1e-10, 0.5])
    np.testing.assert_allclose(exact.x_hat, nearly.x_hat, rtol=1e-7)
    np.testing.assert_allclose(exact.P, nearly.P, rtol=1e-7, atol=1e-9)
    assert exact.x_hat[0] == 1.0
    certain = belief(0.0)
    np.testing.assert_array_equal(certain.x_hat, [1.0, 2.0])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scales", [(1.0, 1.0), (1.0, 1e-6)])
def test_an_unstable_plant_is_found_again_after_a_blackout(scales):
    """Thousands of steps without a sample: the belief knows nothing then, and is right again after one sample."""
    model = LinearModel([[1.2, 0.3], [0.0, 0.9]], np.eye(2), np.eye(2), 0.01, scales, 0.1)
    step = BayesianController(model, FixedPrecision()).online()
    for blackout in (150, 1000, 5000):
        for _ in range(blackout):
            out = step(y=[None, None], goal=[0.0, 0.0])
            assert np.isfinite(out.P).all()
            assert np.isfinite(out.u).all()
        for _ in range(3):
            out = step(y=[3.0, -2.0], goal=[3.0, -2.0])
        np.testing.assert_allclose(out.x_hat, [3.0, -2.0], atol=0.1)
        assert (np.diag(out.P) < 1.1 * np.array(scales)).all()
        assert (np.linalg.eigvalsh(out.P) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("belief", ["filtered", "joint"])
def test_the_poles_are_those_of_plant_and_belief_together(belief):
    """The loop in steady state is linear: its matrix, column by column from the step function itself, has these eigenvalues."""
    rng = np.random.default_rng(8)
    for _ in range(2):
        n, p, m = rng.integers(1, 4), rng.integers(1, 3), rng.integers(1, 4)
        model = random_model(rng, n, p, m)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
            controller = BayesianController(
                model, FixedPrecision(), belief=belief, control_covariance=0.5, goal_covariance=0.1
            )
        A, B, C = (model.matrix(name) for name in "ABC")

        def settled(controller=controller, model=model):
            step = controller.online(compiled=False)
            for _ in range(150):
                step(y=np.zeros(model.sensors), goal=np.zeros(controller.goals))
            return step

        columns = []
        for k in range(2 * n):
            step, x = settled(), np.zeros(n)
            mean = step._view("mean")
            (x if k < n else mean)[k % n] = 1.0
            out = step(y=C @ x, goal=np.zeros(controller.goals))
            columns.append(np.concatenate([A @ x + B @ out.u, mean]))
        expected = np.sort(np.abs(np.linalg.eigvals(np.array(columns).T)))
        np.testing.assert_allclose(np.sort(np.abs(controller.closed_loop_poles())), expected, atol=1e-6)


def test_a_pole_on_the_circle_is_warned_about():
    """Position alone, met exactly at each sample: the velocity flips its sign for ever (the sampled zero at -1)."""
    servo = LinearModel([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], [[1.0, 0.0]], 1e-4, 1e-2, 0.1)
    with pytest.warns(controllers.UnstableLoopWarning, match=r"poles are -1, "):
        BayesianController(servo, FixedPrecision(), goal_on="outputs")


def test_a_constant_that_no_control_moves_is_no_reason_to_warn():
    biased = LinearModel(np.diag([0.9, 1.0]), [[0.1], [0.0]], [[1.0, 0.0], [1.0, 1.0]], 0.01, 1.0, 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BayesianController(biased, FixedPrecision(), goal_on=[[1.0, 0.0]])


def test_a_blackout_makes_no_false_certainty():
    """Two unstable states, unseen for long: seeing one of them afterwards says nothing of the other."""
    model = LinearModel([[1.2, 0.3], [0.0, 1.1]], np.eye(2), np.eye(2), 0.01, 1.0, 0.1)
    step = BayesianController(model, FixedPrecision()).online(compiled=False)
    for _ in range(1000):
        step(y=[None, None], goal=[0.0, 0.0])
    out = step(y=[0.0, None], goal=[0.0, 0.0])
    assert out.P[0, 0] < 1.1
    assert out.P[1, 1] > 1e15
    out = step(y=[0.0, 1000.0], goal=[0.0, 0.0])
    assert abs(out.x_hat[1] - 1000.0) < 1.0


def test_an_undetermined_control_is_held_whatever_the_rounding():
    rng = np.random.default_rng(0)
    for _ in range(30):
        B = rng.normal(size=(2, 2))
        model = LinearModel(0.5 * np.eye(2), B, np.eye(2), 0.1, 1.0, 0.1)
        for belief in ("filtered", "joint"):
            step = BayesianController(model, FixedPrecision(), belief=belief).online(compiled=False)
            before = step(y=[1.0, 2.0], goal=[2.0, 1.0])
            out = step(y=[1.0, 2.0], goal=[2.0, np.nan])
            np.testing.assert_array_equal(out.u, before.u)
            assert np.isfinite(out.P).all()


def test_an_unstable_mode_that_no_sensor_sees_is_warned_about():
    model = LinearModel([[1.1, 0.0], [0.0, 0.5]], np.eye(2), [[0.0, 1.0]], 0.1, 1.0, 0.1)
    with pytest.warns(controllers.UnstableLoopWarning, match="no sensor sees"):
        BayesianController(model, FixedPrecision())


def simulate_with_load(controller, load, steps=4000):
    """The car on a slope: a constant force that the model does not know. Returns the mean error over the last quarter."""
    rng, step = np.random.default_rng(0), controller.online()
    x, errors = 20.0, []
    for _ in range(steps):
        out = step(y=x + 0.1 * rng.normal(size=2), goal=[20.0])
        x = 0.999 * x + 2e-4 * (out.u[0] + load)
        errors.append(x - 20.0)
    return np.mean(errors[-steps // 4 :])


def test_an_estimated_disturbance_leaves_no_steady_error():
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-5, 0.01, 0.02)
    without = simulate_with_load(BayesianController(model, FixedPrecision(), initial_mean=20.0), load=-200.0)
    extended = model.with_disturbance(100.0)
    assert (extended.states, extended.disturbances) == (2, 1)
    controller = BayesianController(extended, FixedPrecision(), initial_mean=20.0)
    assert controller.goals == 1
    with_estimate = simulate_with_load(controller, load=-200.0)
    assert abs(without) > 0.1
    assert abs(with_estimate) < 0.01


def test_a_short_sighted_goal_is_warned_about_with_its_poles():
    servo = LinearModel([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], [[1.0, 0.0]], 1e-4, 1e-2, 0.1)
    with pytest.warns(controllers.UnstableLoopWarning, match=r"poles are .*magnitude 1\.05"):
        controller = BayesianController(servo, FixedPrecision(), goal_covariance=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BayesianController(servo, FixedPrecision(), goal_covariance=1.0)
    # The poles are those of the loop: with goals met exactly, the error obeys A - B L.
    poles = controller.closed_loop_poles()
    step = controller.online(compiled=False)
    x, sizes = np.array([1.0, 0.0]), []
    for _ in range(400):
        out = step(y=[x[0]], goal=[0.0, 0.0])
        x = servo.matrix("A") @ x + servo.matrix("B") @ out.u
        sizes.append(np.linalg.norm(x))
    assert np.log(sizes[-1] / sizes[200]) / 199 == pytest.approx(np.log(np.abs(poles).max()), rel=0.02)


def test_controllers_and_models_pickle():
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-5, 0.01, 0.02)
    controller = BayesianController(model, precision=controllers.GammaPrecision(forgetting=0.9))
    copy = pickle.loads(pickle.dumps(controller))
    a, b = controller.online(compiled=False)(y=[1.0, 2.0], goal=[3.0]), copy.online()(y=[1.0, 2.0], goal=[3.0])
    assert all(np.array_equal(a[name], b[name], equal_nan=True) for name in a)


MODEL = {"A": [[0.9]], "B": [[1.0]], "C": [[1.0]], "process_covariance": 0.1, "sensor_covariance": 1.0, "dt": 0.1}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"A": [[1.0, 0.0]]}, "must be square"),
        ({"B": [[1.0], [2.0]]}, r"B is 2 x 1; it must have 1 row \(is it transposed\?\)\."),
        ({"B": [[1.0, 2.0], [3.0, 4.0]]}, r"B is 2 x 2; it must have 1 row\."),
        ({"C": [[1.0, 2.0]]}, "C is 1 x 2; it must have 1 column"),
        ({"A": [[float("nan")]]}, "NaN or infinite"),
        ({"sensor_covariance": 0.0}, r"not positive definite: its smallest eigenvalue is 0\."),
        ({"sensor_covariance": -1.0}, "smallest eigenvalue is -1"),
        ({"process_covariance": -0.1}, "positive semi-definite"),
        ({"C": [[1.0], [1.0]], "sensor_covariance": [1e6, -1e-7]}, "smallest eigenvalue is -1e-07"),
        ({"C": [[1.0], [1.0]], "sensor_covariance": [[1.0, 0.5], [0.0, 1.0]]}, "not symmetric"),
        ({"C": [[1.0], [1.0]], "sensor_covariance": [[1.0, 2.0], [2.0, 1.0]]}, "smallest eigenvalue is -1"),
        ({"dt": 0}, "must be positive"),
        ({"disturbances": 1}, "at least one must be the plant's"),
    ],
)
def test_models_that_cannot_be_right(change, words):
    with pytest.raises(ValueError, match=words):
        LinearModel(**{**MODEL, **change})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"goal_covariance": 0.0}, "goal_covariance is not positive definite"),
        ({"control_covariance": -1.0}, "control_covariance is not positive definite"),
        ({"initial_mean": [1.0, 2.0]}, "initial_mean has the shape"),
        ({"u_min": 1.0, "u_max": 0.0}, "u_min is 1, above its u_max of 0"),
        ({"u_rate": 0.0}, "u_rate"),
        ({"initial_control": 2.0, "u_max": 1.0}, r"The initial_control \[2.0\] is outside the limits .* u_max=\[1.0\]"),
        ({"initial_control": [0.0, 1.0]}, "The initial_control has the shape"),
        ({"belief": "kalman"}, "must be 'filtered' or 'joint'"),
        ({"goal_on": "inputs"}, "must be 'states', 'outputs' or a matrix"),
        ({"goal_on": [[1.0, 0.0]]}, "goal_on is 1 x 2"),
        ({"goal_on": [[0.0]]}, "flat control prior"),
        ({"precision": 3.0}, "precision learner"),
    ],
)
def test_controllers_that_cannot_be_right(settings, words):
    with pytest.raises(ModelError, match=words):
        BayesianController(LinearModel(**MODEL), **settings)


def test_variances_of_very_different_sizes_are_fine():
    model = LinearModel(**{**MODEL, "C": [[1.0], [1.0]], "sensor_covariance": [1e10, 1e-8]})
    assert BayesianController(model, FixedPrecision()).online(compiled=False)(y=[1e5, 1.0], goal=[0.0]).x_hat[
        0
    ] == pytest.approx(1.0, abs=1e-3)


def test_from_control():
    import control

    system = control.ss([[0.0, 1.0], [-2.0, -3.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    model = LinearModel.from_control(system, process_covariance=1e-3, sensor_covariance=[1.0, 1.0], dt="1/50")
    exact = control.sample_system(system, 0.02, "zoh")
    np.testing.assert_allclose(model.matrix("A"), exact.A)
    np.testing.assert_allclose(model.matrix("B"), exact.B)
    assert model.sensors == 2
    assert model.step.denominator == 50
    with pytest.raises(ValueError, match=r"continuous; give .* dt="):
        LinearModel.from_control(system, process_covariance=1e-3, sensor_covariance=1.0)
    with pytest.raises(ModelError, match="direct feedthrough"):
        LinearModel.from_control(
            control.ss([[-1.0]], [[1.0]], [[1.0]], [[1.0]]), process_covariance=1.0, sensor_covariance=1.0, dt=0.1
        )
    with pytest.raises(ValueError, match=r"sample time is 0\.02 s"):
        LinearModel.from_control(exact, process_covariance=1e-3, sensor_covariance=1.0, dt=0.1)


@pytest.mark.parametrize("size", [1e6, 1e12, 1e18])
def test_a_belief_that_knows_nothing_may_stand_before_redundant_sensors(size):
    """The check of the loop's poles must not divide by the sensors' noise where it is lost beside the belief's."""
    model = controllers.LinearModel([[0.999, 0.1], [0.0, 0.98]], [[0.0], [0.1]], [[1.0, 0.0]] * 3, 1e-3, 1.0, 0.02)
    settings = {"control_covariance": 100.0, "goal_covariance": [1e3, 1.0]}
    poles = [
        np.sort_complex(controllers.BayesianController(model, initial_covariance=start, **settings).closed_loop_poles())
        for start in (1.0, size)
    ]
    np.testing.assert_allclose(poles[1], poles[0], atol=1e-5)


def test_what_says_whether_a_loop_is_stable_is_found_once_for_a_model_and_its_priors():
    """It takes longer than all else of making a controller; thousands of points of a campaign have the same model."""
    model = controllers.LinearModel([[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], 1e-3, 1.0, 0.02)
    settings = {"control_covariance": 100.0, "goal_covariance": 3.0}
    first = controllers.BayesianController(model, **settings)
    found = _steady._gains.cache_info().misses
    for forgetting in (0.5, 0.7, 0.9):
        precision = controllers.GammaPrecision(forgetting=forgetting)
        other = controllers.BayesianController(model, precision=precision, u_max=forgetting, **settings)
        assert other.closed_loop_poles().tobytes() == first.closed_loop_poles().tobytes()
    assert _steady._gains.cache_info().misses == found
    for changed in ({"goal_covariance": 4.0}, {"control_covariance": 99.0}, {"belief": "joint"}):
        other = controllers.BayesianController(model, **{**settings, **changed})
        assert not np.allclose(other.closed_loop_poles(), first.closed_loop_poles(), rtol=1e-9)


def test_the_default_learner_and_its_form():
    """It is joint wherever that is possible; where it is not, nobody has to choose."""
    default = controllers.SwitchingPrecision()
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-3, 1.0, 0.02)
    correlated = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-3, [[1.0, 0.5], [0.5, 1.0]], 0.02)
    nonlinear = controllers.NonlinearModel.from_linear(model)
    forms = {
        BayesianController(model): True,
        controllers.LQGController(model): True,
        BayesianController(correlated): False,
        BayesianController(model, belief="joint"): False,
        controllers.NonlinearBayesianController(nonlinear): False,
    }
    for controller, joint in forms.items():
        assert controller.precision == default
        assert (controller._learner().infer is not None) is joint
    assert controllers.StateEstimator(model).precision == default
    uaic = controllers.UnbiasedActiveInference((), controllers.Proportional([[1.0]]), control="law", model=model)
    assert uaic.precision == FixedPrecision()
    with pytest.raises(ModelError, match="actuator faults cannot be inferred; use a BayesianController"):
        controllers.NonlinearBayesianController(
            nonlinear, controllers.SwitchingPrecision(actuator_modes=[controllers.LostEffect()])
        )
