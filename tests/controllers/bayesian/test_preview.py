"""Goals known ahead: the law is the optimum of the known goals by two other ways, in every form in which a controller runs."""

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.sparse import block_array, block_diag, eye_array, kron
from scipy.sparse.linalg import spsolve

from bayesftc import controllers, cosim
from bayesftc.controllers import FixedPrecision, LinearModel, LQGController
from bayesftc.cosim.errors import ModelError


def servo(dt=0.02):
    """A position servo whose shaft has friction, with two sensors."""
    plant = control.sample_system(control.ss([[0, 1], [0, -2]], [[0], [2]], [[1, 0]], 0), dt, method="zoh")
    return LinearModel(
        plant.A, plant.B, np.tile(plant.C, (2, 1)), 1e-3 * plant.B @ plant.B.T + 1e-8 * np.eye(2), 1e-4, dt=dt
    )


def heated_rooms():
    """Two rooms with a heater each, which lose heat to each other and to the outside: two goals, two controls."""
    A, B = np.array([[0.9, 0.05], [0.04, 0.88]]), np.array([[0.1, 0.0], [0.01, 0.15]])
    return LinearModel(A, B, np.eye(2), 1e-4, 1e-3, dt=1.0)


def random_plant(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    r = int(rng.integers(1, min(n, p) + 1))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.5, 1.15) / np.abs(np.linalg.eigvals(A)).max()
    C = rng.normal(size=(n, n)) + np.eye(n)
    return LinearModel(A, rng.normal(size=(n, p)), C, 1e-4, 1e-3, dt=0.1), C[:r]


PLANTS = {
    "servo": (servo(), [[1.0, 0.0]]),
    "speed of the servo": (servo(), [[0.0, 1.0]]),  # the position drifts
    "heated rooms": (heated_rooms(), np.eye(2)),
    **{f"random {seed}": random_plant(seed) for seed in range(6)},
}


def controller_of(model, H, preview, **settings):
    settings = {"goal_covariance": 0.04, "control_covariance": 0.5} | settings
    return LQGController(model, FixedPrecision(), goal_on=H, preview=preview, **settings)


def steady(model, H):
    """The steady state of each goal, the one with the cheapest control; a position that no goal sees may move on."""
    A, B, H = model.matrix("A"), model.matrix("B"), np.asarray(H)
    n, p = B.shape
    drifts = (A[:, 0] == np.eye(n)[0]).all() and not H[:, 0].any()
    M = np.block([[np.eye(n) - A, -B], [H, np.zeros((len(H), p))]])[int(drifts) :]
    solution, free = np.linalg.pinv(M)[:, -len(H) :], np.linalg.svd(M)[2][np.linalg.matrix_rank(M) :].T
    if free.shape[1] and np.abs(free[n:]).max() > 1e-9:
        solution = solution - free @ np.linalg.pinv(free[n:]) @ solution[n:]
    return solution[:n], solution[n:]


def long_optimum(model, H, goals, x, horizon=400):
    """The first control of the quadratic programme over a long horizon, by its conditions of optimality; the last goal holds."""
    A, B, H = model.matrix("A"), model.matrix("B"), np.asarray(H, float)
    n, p = B.shape
    u_goal, wanted = steady(model, H)[1], np.array([goals[min(t, len(goals) - 1)] for t in range(horizon + 1)])
    # The unknowns are u_0, x_1, u_1, .., x_N; constraints are the model's steps.
    stage = block_diag([np.eye(p) / 0.5, H.T @ H / 0.04])
    each = [np.concatenate([u_goal @ wanted[t] / 0.5, H.T @ wanted[t + 1] / 0.04]) for t in range(horizon)]
    first, then = np.hstack([B, -np.eye(n)]), np.hstack([np.zeros((n, p)), A])
    steps = kron(eye_array(horizon), first) + kron(eye_array(horizon, k=-1), then)
    whole = block_array([[kron(eye_array(horizon), stage), steps.T], [steps, None]], format="csc")
    moves = np.concatenate([-A @ x, np.zeros((horizon - 1) * n)])
    return spsolve(whole, np.concatenate([*each, moves]))[:p]


def chain_gain(model, H, preview):
    """The gain of the regulator whose state also has the known goals, relative to the last one, by scipy."""
    A, B, H = model.matrix("A"), model.matrix("B"), np.asarray(H, float)
    (n, p), r = B.shape, len(H)
    d = preview * r  # r_0 - r_n, .., r_n-1 - r_n: they move up, and nothing follows
    whole = np.block([[A, np.zeros((n, d))], [np.zeros((d, n)), np.eye(d, d, r)]])
    effect = np.vstack([B, np.zeros((d, p))])
    error = np.hstack([H, -np.eye(r, d)])
    expected = np.hstack([np.zeros((p, n)), steady(model, H)[1] @ np.eye(r, d)])
    Q, R = np.eye(r) / 0.04, np.eye(p) / 0.5
    stage, cross = error.T @ Q @ error + expected.T @ R @ expected, -expected.T @ R
    P = solve_discrete_are(whole, effect, stage, R, s=cross)
    return np.linalg.solve(R + effect.T @ P @ effect, effect.T @ P @ whole + cross.T)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("preview", [1, 2, 7])
@pytest.mark.parametrize("name", [name for name in PLANTS if name != "speed of the servo"])
def test_the_law_is_that_of_the_regulator_whose_state_has_the_goals(name, preview):
    model, H = PLANTS[name]
    n, r = model.states, len(H)
    controller = controller_of(model, H, preview)
    gain, (x_goal, u_goal) = chain_gain(model, H, preview), steady(model, H)
    step, rng = controller.online(compiled=False), np.random.default_rng(1)
    goals = [rng.normal(size=r)] * (preview + 1)
    for k in range(3 * preview + 5):
        new = np.full(r, np.nan) if k == 4 else rng.normal(size=r) if k else goals[-1]
        goals = [*goals[1:], goals[-1] if k == 4 else new]
        out = step(y=model.matrix("C") @ rng.normal(size=n), goal=new)
        last = goals[-1]
        state = np.concatenate([np.ravel(out.x_hat) - x_goal @ last, *(goal - last for goal in goals[:-1])])
        law = u_goal @ last - gain @ state
        np.testing.assert_allclose(np.atleast_1d(out.u), law, rtol=1e-8, atol=1e-8 * np.abs(gain).max())


@pytest.mark.sampled(4)
@pytest.mark.parametrize("preview", [1, 5, 30])
@pytest.mark.parametrize("name", PLANTS)
def test_the_law_is_the_optimum_of_a_long_horizon(name, preview):
    model, H = PLANTS[name]
    controller = controller_of(model, H, preview)
    step, rng = controller.online(compiled=False), np.random.default_rng(2)
    goals = [rng.normal(size=len(H)) for _ in range(preview + 1)]
    step(y=np.zeros(model.sensors), goal=goals[0])
    for goal in goals[1:]:
        out = step(y=np.zeros(model.sensors), goal=goal)
    optimum = long_optimum(model, H, goals, np.ravel(out.x_hat))
    np.testing.assert_allclose(np.atleast_1d(out.u), optimum, rtol=1e-8, atol=1e-8 * np.abs(optimum).max())


def test_a_goal_that_stays_gives_the_law_without_preview():
    for name, (model, H) in PLANTS.items():
        without, with_it = (controller_of(model, H, n).online(compiled=False) for n in (0, 9))
        rng = np.random.default_rng(3)
        for _ in range(12):
            y = rng.normal(size=model.sensors)
            a, b = (np.atleast_1d(step(y=y, goal=np.full(len(H), 0.7)).u) for step in (without, with_it))
            np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9 * np.abs(a).max(), err_msg=name)


@pytest.mark.parametrize("belief", ["filtered", "joint"])
def test_the_linear_law_is_the_law_as_it_runs(belief):
    model, H = PLANTS["heated rooms"]
    controller = controller_of(model, H, 4, belief=belief)
    A, B, C, D = controller.linear_law()
    step, rng = controller.online(compiled=False), np.random.default_rng(4)
    for _ in range(300):  # until the gains are constant
        out = step(y=np.zeros(2), goal=np.zeros(2))
    state = np.zeros(len(A))
    for _ in range(20):
        y, goal = rng.normal(size=2), rng.normal(size=2)
        out, given = step(y=y, goal=goal), np.concatenate([y, goal])
        np.testing.assert_allclose(np.ravel(out.u), C @ state + D @ given, rtol=1e-8, atol=1e-9)
        state = A @ state + B @ given


def loop_of(preview, reference, **settings):
    model = servo()
    plant = control.ss([[0, 1], [0, -2]], [[0], [2]], [[1, 0]], 0)
    controller = controller_of(model, [[1.0, 0.0]], preview, **settings)
    return cosim.closed_loop(
        cosim.StateSpace(plant),
        controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=0.01),
        reference=reference,
    )


def test_both_engines_give_the_same_bits_and_hold_limits():
    loop = loop_of(6, cosim.Sine(1.0, 2.0), u_max=0.8, u_min=-0.8, u_rate=5.0)
    one, other = (loop.simulate(2.0, seed=1, engine=engine) for engine in ("compiled", "interpreted"))
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])
    assert np.abs(one["controller.u"]).max() == 0.8
    assert np.abs(np.diff(one["controller.u"][:, 0])).max() <= 5.0 * 0.02 + 1e-12


def test_figures_compare_with_the_present_reference():
    loop = loop_of(6, cosim.Sine(1.0, 2.0))
    result = loop.simulate(2.0, seed=1)
    assert result.roles.quantities[0].reference == ("reference.y", 0)
    np.testing.assert_array_equal(result["reference.ahead"][:-6], result["reference.y"][6:])
    plain = loop_of(0, cosim.Sine(1.0, 2.0)).simulate(2.0, seed=1)
    np.testing.assert_array_equal(result["reference.y"], plain["reference.y"])


@pytest.mark.parametrize("reference", [cosim.Ramp(0.5), cosim.Sine(1.0, 4.0)], ids=["ramp", "sine"])
def test_the_lag_becomes_smaller_with_each_known_sample(reference):
    base, errors = loop_of(1, reference, goal_covariance=1e-3), []
    for preview in (0, 1, 5, 20, 60):
        loop = cosim.varied(base, {"controller.preview": preview})
        result = loop.simulate(8.0, seed=1)
        errors.append(np.sqrt(np.mean((result["plant.y"] - result["reference.y"])[200:] ** 2)))
        again = loop_of(preview, reference, goal_covariance=1e-3).simulate(8.0, seed=1)
        np.testing.assert_array_equal(result["plant.y"], again["plant.y"])
    assert (np.diff(errors) < 0.0).all()
    assert errors[-1] < 0.2 * errors[0]


def test_a_factor_cannot_add_a_preview_to_a_loop_without_one():
    with pytest.raises(ModelError, match=r"comes from reference.y, whose future .* with a preview of at least 1"):
        cosim.varied(loop_of(0, cosim.Ramp(1.0)), {"controller.preview": 3})


def test_the_loop_is_as_stable_as_without_preview():
    without, with_it = (loop_of(n, 1.0).linear() for n in (0, 5))
    found = np.sort_complex(with_it.poles())
    np.testing.assert_allclose(found[np.abs(found) > 1e-6], np.sort_complex(without.poles()), rtol=1e-6)
    assert with_it.margins().phase == pytest.approx(without.margins().phase, rel=1e-6)
    assert with_it.step_info()["SteadyStateValue"] == pytest.approx(1.0)


def test_the_description_names_the_time_ahead():
    assert (
        "The input goal is the goal of 5 samples later (0.1 s)." in controller_of(servo(), [[1.0, 0.0]], 5).describe()
    )


@pytest.mark.parametrize("preview", [-1, 1.5, "1", True, 10_000, None])
def test_a_wrong_preview_is_refused(preview):
    with pytest.raises(ModelError, match="LQGController has preview="):
        controller_of(servo(), [[1.0, 0.0]], preview)


def test_design_passes_the_preview_on():
    controller = controllers.design(servo(), preview=4)
    assert controller.preview == 4
    assert controller.preview_gains.shape == (5, 1, 1)
    np.testing.assert_allclose(controller.preview_gains.sum(axis=0), controller.steady_gains().M)
