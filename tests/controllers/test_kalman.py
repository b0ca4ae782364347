"""The promise to users: with precision fixed, the belief is filterpy's Kalman filter's, whatever the goals."""

import warnings

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from bayesftc import controllers, cosim
from bayesftc.controllers.bayesian.validation import compare, ser_reference
from bayesftc.cosim.errors import KernelError, ModelError, UnknownNameError

STEPS = 250


def detectable(A, C):
    """Hautus: every mode on or outside the unit circle is seen by a sensor, with some margin."""
    for eigenvalue in np.linalg.eigvals(A):
        if abs(eigenvalue) >= 0.99:
            stacked = np.vstack([eigenvalue * np.eye(len(A)) - A, C])
            if np.linalg.svd(stacked, compute_uv=False)[-1] < 0.05:
                return False
    return True


@st.composite
def problems(draw):
    """A random detectable model with correlated noises, a share of missing samples, and random goal and control priors."""
    n, p, m = (draw(st.integers(1, 6)) for _ in range(3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = rng.normal(size=(n, n))
    A *= draw(st.floats(0.1, 1.2)) / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.normal(size=(n, p)), rng.normal(size=(m, n))
    for _ in range(20):
        if not detectable(A, C):
            C = rng.normal(size=(m, n))
    assume(detectable(A, C))
    F, G = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    model = controllers.LinearModel(A, B, C, 0.05 * F @ F.T, G @ G.T + 0.1 * np.eye(m), 0.1)
    priors = {
        "goal_covariance": draw(st.sampled_from([1e-3, 1.0, 1e3])),
        "control_covariance": draw(st.sampled_from([1e-2, 1.0, 1e6])),
    }
    return model, priors, draw(st.floats(0.0, 0.3)), rng


def record(controller, rng, missing, steps):
    """Simulate the model in closed loop with the plain Python form; return y, u, x_hat, P."""
    model = controller.model
    A, B, C = (model.matrix(name) for name in "ABC")
    factors = [np.linalg.cholesky(model.matrix(f"{w}_covariance") + 1e-12 * np.eye(k)) for w, k in
               (("process", model.states), ("sensor", model.sensors))]  # fmt: skip
    step = controller.online(compiled=False)
    x = rng.normal(size=model.states)
    goal = rng.normal(size=controller.goals)
    rows = []
    blackout = (steps // 2, steps // 2 + 30)
    for k in range(steps):
        y = C @ x + factors[1] @ rng.normal(size=model.sensors)
        y[rng.random(model.sensors) < missing] = np.nan
        if blackout[0] <= k < blackout[1]:
            y[:] = np.nan
        out = step(y=y, goal=goal)
        rows.append((y, out.u, out.x_hat, out.P))
        x = A @ x + B @ out.u + factors[0] @ rng.normal(size=model.states)
    return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize("count", [4, pytest.param(200, marks=pytest.mark.slow)])
def test_belief_is_filterpys_for_every_goal_and_control_prior(count):
    checked = settings(
        max_examples=count, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    checked(given(problems())(check_problem))()


def check_problem(problem):
    model, priors, missing, rng = problem
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", controllers.UnstableLoopWarning)
        controller = controllers.BayesianController(model, controllers.FixedPrecision(), **priors)
    y, u, x_hat, P = record(controller, rng, missing, STEPS)
    check = compare(x_hat, P, ser_reference(model, y, u))
    assert check.steps == STEPS
    assert check.mean_difference < 1e-9
    assert check.covariance_difference < 1e-9


def two_states(controls):
    B = np.array([[1.0, 0.2], [0.1, 1.0]])[:, :controls]
    return controllers.LinearModel([[0.9, 0.1], [-0.2, 0.8]], B, [[1.0, 0.0], [0.0, 1.0]], 0.1, 0.5, 0.1)


def largest_difference(controller):
    y, u, x_hat, P = record(controller, np.random.default_rng(3), 0.1, 200)
    return compare(x_hat, P, ser_reference(controller.model, y, u)).mean_difference


@pytest.mark.slow
def test_joint_belief_is_kalmans_only_with_a_flat_prior_and_enough_controls():
    flat = {"precision": controllers.FixedPrecision(), "belief": "joint", "goal_covariance": 0.1}
    assert largest_difference(controllers.BayesianController(two_states(2), **flat)) < 1e-9
    # Fewer controls than states: the goal leaks into the belief where no control can explain it away.
    assert largest_difference(controllers.BayesianController(two_states(1), **flat)) > 0.1
    # A proper control prior lets it leak as well.
    assert largest_difference(controllers.BayesianController(two_states(2), control_covariance=1.0, **flat)) > 1e-4
    # The filtered belief is Kalman's in all three.
    for controls, prior in ((2, None), (1, None), (2, 1.0)):
        controller = controllers.BayesianController(
            two_states(controls), controllers.FixedPrecision(), goal_covariance=0.1, control_covariance=prior
        )
        assert largest_difference(controller) < 1e-9


def test_the_check_sees_a_wrong_filter():
    """The comparison can fail: a model with other noise than the controller's differs at once."""
    controller = controllers.BayesianController(two_states(2), controllers.FixedPrecision())
    y, u, x_hat, P = record(controller, np.random.default_rng(4), 0.0, 50)
    other = controllers.LinearModel([[0.9, 0.1], [-0.2, 0.8]], np.eye(2), np.eye(2), 0.11, 0.5, 0.1)
    check = compare(x_hat, P, ser_reference(other, y, u))
    assert check.mean_difference > 1e-3
    assert check.covariance_difference > 1e-3


@pytest.mark.parametrize("threshold", [1.5, 3.0])
def test_ser_in_the_loop_is_filterpys_reference(threshold):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)
    controller = controllers.BayesianController(model, precision=controllers.SERFDI(threshold), initial_mean=20.0)
    rng = np.random.default_rng(5)
    step = controller.online()
    x, rows = 20.0, []
    for k in range(2000):
        y = x + rng.normal(size=2) + [8.0 * (500 < k < 900), 0.0]
        y[rng.random(2) < 0.05] = np.nan
        out = step(y=y, goal=[20.0])
        rows.append((y, out.u, out.x_hat, out.P, out.fault_probability))
        x = 0.999 * x + 2e-4 * out.u[0] + np.sqrt(0.001) * rng.normal()
    y, u, x_hat, P, decided = (np.array(c) for c in zip(*rows, strict=True))
    reference = ser_reference(model, y, u, threshold=threshold, initial_mean=20.0)
    assert 0 < reference.ignored[:, 0].sum() < 2000
    present = np.isfinite(y)
    np.testing.assert_array_equal(decided[present] > 0.5, reference.ignored[present])
    check = compare(x_hat, P, reference)
    assert max(check.mean_difference, check.covariance_difference) < 1e-9


def test_belief_with_learned_precision_is_filterpys_given_the_same_covariances():
    model = controllers.LinearModel([[0.95]], [[0.1]], [[1.0], [1.0]], 0.01, [1.0, 0.5], 0.1)
    controller = controllers.BayesianController(model, precision=controllers.GammaPrecision(forgetting=0.9))
    step, rng = controller.online(), np.random.default_rng(6)
    rows = []
    for k in range(300):
        y = rng.normal(size=2) + np.array([5.0 * (k > 100), 0.0])
        out = step(y=y, goal=[1.0])
        rows.append((y, out.u, out.x_hat, out.P, out.R))
    y, u, x_hat, P, R = (np.array(c) for c in zip(*rows, strict=True))
    check = compare(x_hat, P, ser_reference(model, y, u, R=R))
    assert max(check.mean_difference, check.covariance_difference) < 1e-9
    assert R[-1, 0, 0] > 5 * R[50, 0, 0]  # and precision was indeed learned


def test_the_ser_baseline_on_filterpy_has_the_outputs_of_ours():
    """Of two states and three sensors, with correlated noise, missing samples and a fault; and so has the estimator."""
    noise = [[0.5, 0.1, 0.0], [0.1, 0.4, 0.0], [0.0, 0.0, 0.3]]
    C = [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    model = controllers.LinearModel([[0.9, 0.1], [-0.2, 0.8]], [[1.0], [0.1]], C, 0.1, noise, 0.1)
    rng = np.random.default_rng(8)
    y = rng.normal(size=(200, 3)) + [6.0, 0.0, 0.0] * (np.arange(200) // 50 % 2)[:, np.newaxis]
    y[rng.random(y.shape) < 0.05] = np.nan
    options = {"goal_covariance": 0.1, "control_covariance": 1.0, "initial_mean": [0.5, 0.0]}
    both = [
        controllers.BayesianController(model, precision=controllers.SERFDI(2.5, filter), **options).online()
        for filter in ("own", "filterpy")
    ]
    watching = controllers.StateEstimator(model, controllers.SERFDI(2.5, "filterpy"), initial_mean=[0.5, 0.0]).online()
    for row in y:
        ours, theirs = (step(y=row, goal=[1.0, 0.0]) for step in both)
        watched = watching(y=row, u=theirs.u)
        for name in ours:
            np.testing.assert_allclose(theirs[name], ours[name], rtol=1e-9, atol=1e-12)
            if name in watched:
                np.testing.assert_array_equal(watched[name], theirs[name])


def test_what_computes_by_filterpy_says_where_it_cannot(tmp_path):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)
    learner = controllers.SERFDI(filter="filterpy")
    controller = controllers.BayesianController(model, precision=learner)
    with pytest.raises(ModelError, match="calls Python, which is not available in the exported C"):
        cosim.export_fmu(controller, tmp_path / "ser.fmu")
    diagram = cosim.Diagram(dt=0.02)
    block, goal = diagram.add(controller), diagram.add(cosim.Constant(0.0))
    samples = diagram.add(cosim.Sensors(count=2, std=1.0))
    diagram.connect(goal["y"], samples["u"])
    diagram.connect(samples["y"], block["y"])
    diagram.connect(goal["y"], block["goal"])
    with pytest.raises(KernelError, match="controller"):
        diagram.simulate(1.0, engine="compiled")
    result = diagram.simulate(1.0)
    assert np.isfinite(result["controller.u"]).all()
    assert controllers.check_kalman(result, controller, y="sensors.y").steps == 51
    assert controllers.check_kalman(result, controller, y="sensors.y", most=10).steps == 10
    assert controllers.check_kalman(result, controller) == controllers.check_kalman(result, controller, y="sensors.y")
    with pytest.raises(ModelError, match=r"give the result of the run first.* check_kalman\(result, controller\)"):
        controllers.check_kalman(controller, result)
    del result._columns["sensors.y"]
    with pytest.raises(
        UnknownNameError, match=r"'controller\.y', which is not recorded; add it to record=\['\*', 'contr"
    ):
        controllers.check_kalman(result, controller)
    with pytest.raises(ModelError, match=r"belief='joint' has its own belief.*filter='own'"):
        controllers.BayesianController(model, precision=learner, belief="joint")
    with pytest.raises(ModelError, match="filter='own'"):
        controllers.ExplicitDetection(learner).learner(model)
    with pytest.raises(ModelError, match="filter='scipy'; it must be 'own' or 'filterpy'"):
        controllers.SERFDI(filter="scipy")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"precision": controllers.SwitchingPrecision()}, "SwitchingPrecision, which infers state and faults together"),
        ({"precision": controllers.SwitchingPrecision(joint=False)}, ""),
        ({"belief": "joint", "control_covariance": 1e4, "goal_covariance": 1e-3}, "depends on the goal"),
        ({"precision": controllers.GammaPrecision()}, ""),
    ],
)
def test_a_belief_that_is_no_kalman_filters_is_explained(settings, words):
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    controller = controllers.BayesianController(model, **settings)
    plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    loop = cosim.closed_loop(
        plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), reference=1.0,
        faults=cosim.Injection(sensor=0, start=1.0, magnitude=2.0),
    )  # fmt: skip
    check = controllers.check_kalman(loop.simulate(3.0, seed=1, engine="interpreted"), controller)
    assert (max(check.mean_difference, check.covariance_difference) > 1e-9) is bool(words)
    assert words in check.explanation
    assert bool(check.explanation) is bool(words)
    assert repr(check).endswith(check.explanation or "steps=31)")
