"""Active inference: its free energy and gradient against CasADi and SciPy, where it settles, and what it survives."""

import pickle
from dataclasses import dataclass, replace
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from control import ss
from scipy import linalg, stats

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import Modality, UnbiasedActiveInference
from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.ops import cos, select, sin, sqrt, square
from bayesftc.cosim.stepping import differentiation

H = 0.01
ARM = cosim.arm_with_camera((1.0, 0.8), (-0.05, 0.01, 0.001))


def bend(x, y):
    y[0] = x[0] * x[1] + 0.3 * square(x[2])
    y[1] = sin(x[3]) - cos(x[0])
    y[2] = x[2] / (1.0 + square(x[1]))


def bend_by_hand(x, y_x):
    for i in range(3):
        for j in range(4):
            y_x[i, j] = 0.0 * x[0]
    y_x[0, 0], y_x[0, 1], y_x[0, 2] = x[1], x[0], 0.6 * x[2]
    y_x[1, 0], y_x[1, 3] = sin(x[0]), cos(x[3])
    d = 1.0 + square(x[1])
    y_x[2, 1], y_x[2, 2] = -2.0 * x[1] * x[2] / square(d), 1.0 / d


def pull(x_hat, goal, u):
    u[0] = 2.0 * (goal[0] - sin(x_hat[0])) - x_hat[2] * x_hat[1]
    u[1] = goal[1] - x_hat[1] + 0.2 * square(x_hat[3])


def steep(x_hat, goal, u):
    u[0] = goal[0] - sqrt(x_hat[0])


# The same functions written again in CasADi, and what each modality is built from.
def casadi_arm(x):
    a, b = 1.0, 0.8
    p = ca.vertcat(a * ca.cos(x[0]) + b * ca.cos(x[0] + x[1]), a * ca.sin(x[0]) + b * ca.sin(x[0] + x[1]))
    r2 = ca.sumsqr(p)
    return ca.vertcat(x, p * (1 - 0.05 * r2 + 0.01 * r2**2 + 0.001 * r2**3))


def casadi_bend(x):
    return ca.vertcat(x[0] * x[1] + 0.3 * x[2] ** 2, ca.sin(x[3]) - ca.cos(x[0]), x[2] / (1 + x[1] ** 2))


def casadi_pull(x, goal):
    return ca.vertcat(2 * (goal[0] - ca.sin(x[0])) - x[2] * x[1], goal[1] - x[1] + 0.2 * x[3] ** 2)


def random_covariance(rng, n, scale):
    M = rng.normal(size=(n, n))
    return scale * (M @ M.T + n * np.eye(n)) / (2 * n)


PD = controllers.ProportionalDerivative([[3.0, 0.5], [-0.2, 2.0]], derivative_gain=[0.7, 0.4])
PID = controllers.PID([2.0, 1.0], derivative_gain=[0.7, 0.4], integral_gain=3.0, integral_limit=0.2)


def random_case(seed, prior, law):
    """A controller with random modalities, priors and precisions, and the same things for the oracle."""
    rng = np.random.default_rng(seed)
    chosen, measured = [], []
    for kind in rng.permutation(4)[: rng.integers(1, 5)]:
        if kind == 0:
            C = rng.normal(size=(3, 4))
            chosen.append(
                Modality(
                    "matrix", matrix=C, covariance=random_covariance(rng, 3, 0.04), precision=rng.uniform(0.3, 2, 3)
                )
            )
            measured.append(lambda x, C=C: ca.DM(C) @ x)
        elif kind == 1:
            chosen.append(Modality("arm", 6, ARM, std=rng.uniform(1e-3, 0.1, 6), precision=rng.uniform(0.3, 1, 6)))
            measured.append(casadi_arm)
        else:
            by_hand = bend_by_hand if kind == 3 else None
            chosen.append(Modality("bend", 3, bend, covariance=random_covariance(rng, 3, 0.5), jacobian=by_hand))
            measured.append(casadi_bend)
    A, B = np.eye(4) + 0.05 * rng.normal(size=(4, 4)), 0.1 * rng.normal(size=(4, 2))
    model = controllers.LinearModel(A, B, np.eye(4), 0.1, 1.0, H) if prior == "kalman" else None
    controller = UnbiasedActiveInference(
        chosen, law, H, 2.0, 0.5, state_prior=prior, model=model, control_precision=random_covariance(rng, 2, 0.5),
        state_precision=random_covariance(rng, 4, 2.0), initial_mean=rng.normal(size=4), inner_steps=2,
        sizes=None if isinstance(law, cosim.Block) else (4, 2, 2),
    )  # fmt: skip
    if prior == "random walk":
        A, B = np.eye(4), 0 * B
    elif prior == "euler":
        A, B = np.block([[np.eye(2), H * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]]), 0 * B
    return controller, measured, A, B, rng


def control_law(law, x, goal, integral):
    if law is pull:
        return casadi_pull(x, goal)
    return ca.DM(law.gain) @ (goal - x[:2]) - ca.DM(law.derivative_gain) @ x[2:4] + integral


def descent_by_casadi(controller, measured, A, B, ys, goals):
    """Follow the descent over the rows of y with a free energy written here; return all means and values of F."""
    x, v = ca.SX.sym("x", 4), ca.SX.sym("v", 2)
    y, goal, predicted, integral = ca.SX.sym("y", ys.shape[1]), ca.SX.sym("g", 2), ca.SX.sym("p", 4), ca.SX.sym("i", 2)
    Px, Pu = np.asarray(controller.state_precision), np.asarray(controller.control_precision)
    F, first = -(np.linalg.slogdet(Px)[1] + np.linalg.slogdet(Pu)[1]), 0
    for modality, g in zip(controller.modalities, measured, strict=True):
        error = y[first : first + modality.size] - g(x)
        S = np.diag(np.sqrt(modality.precision * np.diag(modality.covariance)))
        P = S @ np.linalg.inv(modality.covariance) @ S
        F += error.T @ ca.DM(P) @ error - np.linalg.slogdet(P)[1]
        first += modality.size
    eps_x, eps_u = x - predicted, v - control_law(controller.law, x, goal, integral)
    F += eps_x.T @ ca.DM(Px) @ eps_x + eps_u.T @ ca.DM(Pu) @ eps_u + (first + 6) * np.log(2 * np.pi)
    F = F / 2
    slopes = ca.Function("F", [x, v, y, goal, predicted, integral], [F, ca.gradient(F, x), ca.gradient(F, v)])
    mean, control, memory = np.array(controller.initial_mean), np.zeros(2), np.zeros(2)
    prediction, out = mean, []
    for row, target in zip(ys, goals, strict=True):
        for _ in range(controller.inner_steps):
            value, by_x, by_v = (np.array(r).ravel() for r in slopes(mean, control, row, target, prediction, memory))
            mean = mean - H * np.asarray(controller.belief_rate) * by_x
            control = control - H * np.asarray(controller.control_rate) * by_v
        out.append((mean, control, value[0]))
        prediction = A @ mean + B @ control
        if isinstance(controller.law, controllers.PID):
            memory = np.clip(memory + H * np.asarray(controller.law.integral_gain) @ (target - mean[:2]), -0.2, 0.2)
    return (np.array(column) for column in zip(*out, strict=True))


@pytest.mark.sampled(5)
@pytest.mark.parametrize("law", [PD, PID, pull], ids=["PD", "PID", "function"])
@pytest.mark.parametrize("prior", ["random walk", "euler", "kalman"])
@pytest.mark.parametrize("seed", range(4))
def test_free_energy_and_gradient_are_casadis(seed, prior, law):
    controller, measured, A, B, rng = random_case(seed, prior, law)
    sensors = controller.port("y").size
    ys, goals = 0.7 * rng.normal(size=(6, sensors)), 0.5 * rng.normal(size=(6, 2))
    step = controller.online(compiled=False)
    outs = [step(y=a, goal=b) for a, b in zip(ys, goals, strict=True)]
    means, controls, energies = descent_by_casadi(controller, measured, A, B, ys, goals)
    np.testing.assert_allclose([out.x_hat for out in outs], means, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose([out.u for out in outs], controls, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose([out.free_energy for out in outs], energies, rtol=1e-9)
    moved = np.abs(np.diff(means, axis=0)).max()
    assert moved > 1e-3  # the gradient did something


def test_the_constant_makes_it_a_negative_log_density():
    """With the precisions of a generative model, F = -ln p(u, x, y) of SciPy's densities."""
    rng = np.random.default_rng(3)
    R, C = random_covariance(rng, 3, 0.3), rng.normal(size=(3, 4))
    Px, Pu = random_covariance(rng, 4, 2.0), random_covariance(rng, 2, 1.0)
    sensors = Modality("all", matrix=C, covariance=R, precision=1 / np.diag(R))
    controller = UnbiasedActiveInference(
        [sensors], PD, H, 0.1, 0.1, state_precision=Px, control_precision=Pu, initial_mean=rng.normal(size=4)
    )
    y, goal, mean = rng.normal(size=3), rng.normal(size=2), np.asarray(controller.initial_mean)
    u = np.asarray(PD.gain) @ (goal - mean[:2]) - np.asarray(PD.derivative_gain) @ mean[2:]
    log_density = (
        stats.multivariate_normal(C @ mean, R).logpdf(y)
        + stats.multivariate_normal(mean, np.linalg.inv(Px)).logpdf(mean)
        + stats.multivariate_normal(u, np.linalg.inv(Pu)).logpdf(np.zeros(2))
    )
    out = controller.online(compiled=False)(y=y, goal=goal)
    assert out.free_energy == pytest.approx(-log_density, rel=1e-12)


def small(**options):
    """One position seen twice and its rate, under a PD law; precisions as in the arm's published settings."""
    given = {
        "modalities": [
            Modality("position", matrix=[[1.0, 0.0], [1.0, 0.0]], std=0.1),
            Modality("rate", matrix=[[0.0, 1.0]], std=(0.2,), precision=0.5),
        ],
        "law": controllers.ProportionalDerivative(2.0, derivative_gain=1.0),
        "dt": H,
        "belief_rate": 20.0,
        "control_rate": 20.0,
        **options,
    }
    return UnbiasedActiveInference(**given)


def test_with_a_random_walk_and_one_step_the_states_prediction_error_is_zero():
    y = np.random.default_rng(1).normal(size=(50, 3))
    for steps, zero in ((1, True), (3, False)):
        step = small(inner_steps=steps).online(compiled=False)
        errors = np.array([step(y=row, goal=[1.0]).eps_x for row in y])
        assert (errors == 0.0).all() == zero
    weak, strong = (small(state_precision=p).online(compiled=False) for p in (1e-3, 1e3))
    for row in y:  # so P_x has no influence
        np.testing.assert_array_equal(weak(y=row, goal=[1.0]).x_hat, strong(y=row, goal=[1.0]).x_hat)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(5))
def test_inner_steps_lower_the_free_energy(seed):
    controller, *_, rng = random_case(seed, "euler", pull)
    y, goal = rng.normal(size=controller.port("y").size), rng.normal(size=2)
    energies = [
        replace(controller, inner_steps=s).online(compiled=False)(y=y, goal=goal).free_energy for s in range(1, 8)
    ]
    assert (np.diff(energies) < 0).all()


def test_it_settles_at_the_weighted_least_squares_solution():
    rng = np.random.default_rng(8)
    C, R, Px = rng.normal(size=(5, 3)), random_covariance(rng, 5, 0.2), random_covariance(rng, 3, 1.0)
    gain, y, start = rng.uniform(0.5, 2.0, 5), rng.normal(size=5), rng.normal(size=3)
    sensors = Modality("all", matrix=C, covariance=R, precision=gain)
    S = np.diag(np.sqrt(gain * np.diag(R)))
    W = linalg.cholesky(S @ linalg.inv(R) @ S)
    law = controllers.Proportional([1.5], states=3)
    for control, rate in (("law", None), ("gradient", 10.0)):
        controller = UnbiasedActiveInference(
            [sensors], law, H, 5.0, rate, control=control, state_precision=Px, initial_mean=start, inner_steps=1,
        )  # fmt: skip
        step = controller.online(compiled=True)
        for _ in range(1_500):  # the random walk's prior moves with the belief, so the sensors have the last word
            out = step(y=y, goal=[0.4])
        np.testing.assert_allclose(out.x_hat, linalg.lstsq(W @ C, W @ y)[0], rtol=1e-7)
        np.testing.assert_allclose(out.u, 1.5 * (0.4 - out.x_hat[0]), rtol=1e-7)
    many = replace(controller, control="law", control_rate=None, inner_steps=1500)
    settled = many.online(compiled=True)(y=y, goal=[0.4])
    stacked = linalg.lstsq(
        np.vstack([W @ C, linalg.cholesky(Px)]), np.concatenate([W @ y, linalg.cholesky(Px) @ start])
    )
    np.testing.assert_allclose(settled.x_hat, stacked[0], rtol=1e-9)  # within one sample the prior stays where it was


LEARNERS = [cls() for cls in controllers.LEARNERS]


def rough_samples(steps=120):
    rng = np.random.default_rng(4)
    y = rng.normal(size=(steps, 3)) * [0.1, 0.1, 0.2]
    y[40:70, 0] += 3.0
    y[rng.random((steps, 3)) < 0.1] = np.nan
    y[20], y[25], y[30], y[80:90], y[95] = 1e300, [np.inf, -np.inf, 0.0], [np.nan, 1e300, -1e300], np.nan, 0.0
    return y


@pytest.mark.sampled(4)
@pytest.mark.parametrize("control", ["gradient", "law"])
@pytest.mark.parametrize("precision", LEARNERS, ids=repr)
def test_rough_samples_leave_everything_finite_with_every_learner(precision, control):
    controller = small(precision=precision, control=control, control_precision=0.1, inner_steps=2, state_prior="euler")
    step = controller.online(compiled=False)
    for row in rough_samples():
        out = step(y=row, goal=[0.5])
        for name in ("u", "x_hat", "free_energy", "eps_x", "eps_u"):
            assert np.isfinite(out[name]).all(), name
        missing = ~np.isfinite(row) | (np.abs(row) > 1e6)  # an absurd sample counts as none
        assert np.isnan(out.innovation).tolist() == missing.tolist()


def seen_from_the_side(x, y):
    y[0] = sin(x[0]) + 0.1 * x[1]


# Compiling takes seconds each, and test_precision.py compiles every learner: here one of each way to write the step's text.
PD_AND_I = controllers.PID(2.0, derivative_gain=1.0, integral_gain=0.5, integral_limit=1.0)
GROWING = controllers.GammaPrecision(forgetting=None)
FORMS = {
    "gradient": {"precision": GROWING, "state_prior": "euler", "law": PD_AND_I, "inner_steps": 2},
    "law": {"precision": controllers.WishartPrecision(), "control": "law", "belief_rate": 75.0},
}


def of_form(form):
    modalities = [small().modalities[0], Modality("camera", 1, seen_from_the_side, std=0.2, precision=0.5)]
    return small(modalities=modalities, control_precision=0.1, **FORMS[form])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("form", FORMS)
def test_both_forms_agree_to_the_last_bit(form, same_bits):
    steps = [of_form(form).online(compiled=compiled) for compiled in (True, False)]
    for row in rough_samples():
        a, b = (step(y=row, goal=[0.5]) for step in steps)
        for name in a:
            same_bits(a[name], b[name], name)


def test_a_missing_sample_leaves_its_sensor_out():
    both, alone = small(inner_steps=3), small(inner_steps=3)
    alone = replace(alone, modalities=[Modality("first", matrix=[[1.0, 0.0]], std=0.1), alone.modalities[1]])
    first, second = both.online(compiled=False), alone.online(compiled=False)
    for y in np.random.default_rng(0).normal(size=(20, 2)):
        a, b = first(y=[y[0], np.nan, y[1]], goal=[0.2]), second(y=y, goal=[0.2])
        np.testing.assert_allclose(a.x_hat, b.x_hat, rtol=1e-13)
        assert a.free_energy == pytest.approx(b.free_energy, rel=1e-13)


def test_learned_precision_is_in_units_of_the_gain():
    """P = gain at nominal trust, however small the noise; a sensor that is trusted half as much weighs half as much."""

    @dataclass(frozen=True)
    class Half(controllers.PrecisionLearner):
        def learner(self, model):
            return controllers.Learner(learn_half, np.zeros(1), np.zeros(1))

    sensor = Modality("position", matrix=[[1.0]], std=1e-3, precision=0.8)
    for precision, weight in ((controllers.FixedPrecision(), 0.8), (Half(), 0.4)):
        controller = UnbiasedActiveInference(
            [sensor], controllers.Proportional(1.0), H, 10.0, control="law", precision=precision
        )
        out = controller.online(compiled=False)(y=[5e-4], goal=[0.0])
        assert out.x_hat[0] == pytest.approx(H * 10.0 * weight * 5e-4, rel=1e-12)


def learn_half(sample, trust, memory, settings, work):
    for i in range(sample.y.shape[0]):
        trust.R[i, i] = 2.0 * sample.nominal[i, i]
        trust.used[i], trust.precision[i], trust.beta[i], trust.fault_probability[i] = (
            sample.present[i],
            0.5 / sample.nominal[i, i],
            0.0,
            0.0,
        )


def count_up(x_hat, goal, calls, u):
    u[0] = calls[0] + goal[0] - x_hat[0]


def count_one(calls, k, goal):
    calls[0] = calls[0] + 1.0


@dataclass(frozen=True)
class Counting(cosim.Block):
    """A law of the user's own that counts the samples it has seen."""

    @property
    def inputs(self):
        return cosim.Port("x_hat", (2,)), cosim.Port("goal", (1,))

    @property
    def outputs(self):
        return (cosim.Port("u", (1,)),)

    def define(self, step):
        return cosim.Definition(count_up, count_one, state={"calls": 0.0})


@pytest.mark.parametrize("control", ["law", "gradient"])
def test_a_law_of_ones_own_moves_on_once_a_sample(control):
    controller = small(law=Counting(), control=control, inner_steps=50, control_rate=90.0, control_precision=1e-1)
    step = controller.online(compiled=False)
    for k in range(20):
        out = step(y=[0.0, 0.0, 0.0], goal=[0.0])
        assert out.u[0] == pytest.approx(k - out.x_hat[0], abs=1e-9 if control == "law" else 0.05 * k + 1e-9)


def absurd(noise, y):
    """Values of all sizes, infinities, NaN streaks, and long stretches on which all sensors agree exactly."""
    for i in range(y.shape[0]):
        z = noise[i]
        y[i] = select(z < 0.01, 1e300 * (z - 0.005) / (z - 0.005), select(z < 0.02, -1e300 / (z - z), z))
        y[i] = select(noise[3] < 0.5, 0.25, select(noise[4] < 0.1, (z - z) / (z - z), y[i]))


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_a_million_absurd_samples_leave_the_belief_finite(form, make_block):
    source = make_block(
        inputs=[cosim.Port("noise", (5,), draw="uniform")], outputs=[cosim.Port("y", (3,))], output=absurd
    )
    controller = of_form(form)
    diagram = cosim.Diagram(dt=H)
    samples, node = diagram.add(source, "samples"), diagram.add(controller, "node")
    goal = diagram.add(cosim.Constant(1.0), "goal")
    diagram.connect(samples["y"], node["y"])
    diagram.connect(goal["y"], node["goal"])
    result = diagram.build().simulate(10_000.0, record=["node.u", "node.x_hat", "node.free_energy"])
    assert len(result.time) == 1_000_001
    for name in ("node.u", "node.x_hat", "node.free_energy"):
        assert np.isfinite(result[name]).all()


def test_sensors_that_agree_exactly_for_ever_do_not_break_the_descent():
    """Precisions grow a thousand times and more; the step is shortened instead of diverging."""
    step = small(precision=controllers.GammaPrecision(forgetting=None)).online()
    for _ in range(5_000):
        out = step(y=[0.0, 0.0, 0.0], goal=[0.0])
    assert out.precision.max() > 1e5  # a thousand times the nominal one
    for _ in range(200):
        out = step(y=[0.3, 0.3, 0.0], goal=[0.0])
        assert np.abs(out.x_hat).max() < 0.31  # no overshoot either
    assert out.x_hat[0] == pytest.approx(0.3, abs=0.02)


def in_units(unit, **options):
    """A mass in the units of `unit` (two numbers) for position and rate, its sensors, law and rates adapted."""
    T, back = np.diag(unit), np.diag(1 / np.asarray(unit))
    law = controllers.ProportionalDerivative(2.0 / unit[0], derivative_gain=1.0 / unit[1])
    C = np.array([[1.0, 0.0], [1.0, 0.2], [0.1, 1.0]]) @ back
    given = {
        "modalities": [Modality("all", matrix=C, std=(0.1, 0.1, 0.2), precision=(1.0, 0.5, 0.5))],
        "law": law,
        "belief_rate": 30.0 * np.diag(T @ T),
        "control_precision": 0.3,
        "state_precision": back @ [[1.0, 0.3], [0.3, 2.0]] @ back,
        "initial_mean": T @ [0.3, -0.2],
        **options,
    }
    A, B, C = T @ [[1.0, H], [-0.04, 0.99]] @ back, T @ [[0.0], [H]], C
    if given.get("state_prior") == "kalman":
        given["model"] = controllers.LinearModel(A, B, C, 0.1, np.diag([0.01, 0.01, 0.04]), H)
    return small(**given)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"precision": controllers.GammaPrecision(forgetting=None)},  # grows until steps are shortened
        {"precision": controllers.WishartPrecision(), "inner_steps": 3},
        {"precision": controllers.GammaPrecision(forgetting=None), "control": "law", "state_prior": "kalman"},
    ],
    ids=["fixed", "gamma", "wishart", "kalman"],
)
def test_units_of_the_states_change_nothing(options):
    """Rates have a state's unit squared, and the precision of its prior has one over it."""
    rng, unit = np.random.default_rng(2), np.array([1.0, 1000.0])
    ys = 0.02 * rng.normal(size=(400, 3))
    ys[150:250, 0] += 2.0  # a fault
    steps = [in_units(u, **options).online(compiled=False) for u in (np.ones(2), unit)]
    for y in ys:
        a, b = (step(y=y, goal=[goal]) for step, goal in zip(steps, (0.5, 0.5), strict=True))
        np.testing.assert_allclose(b.u, a.u, rtol=1e-9)
        np.testing.assert_allclose(b.x_hat, unit * a.x_hat, rtol=1e-9)


def nominal_fraction(controller):
    """What of a step is taken at nominal trust: from how far the first step goes, and how far it would go in full."""
    mean = np.asarray(controller.initial_mean)
    C, y = controller.measurement_matrix, np.array([1.0, 0.5, -0.3])
    weights = np.concatenate([s.precision for s in controller.modalities])
    slope = -C.T @ (weights * (y - C @ mean))
    goal = 0.5
    if controller.control == "gradient":
        law = controller.law
        D = np.hstack([-np.asarray(law.gain), -np.asarray(law.derivative_gain)])
        wanted = np.asarray(law.gain) @ [goal] + D @ mean
        slope = slope - D.T @ np.asarray(controller.control_precision) @ (0.0 - wanted)
    moved = controller.online(compiled=False)(y=y, goal=[goal]).x_hat - mean
    return moved / (-H * np.asarray(controller.belief_rate) * slope)


@pytest.mark.parametrize("control", ["gradient", "law"])
@pytest.mark.parametrize("eigenvalue", [1.8, 1.99])
def test_a_stable_setting_is_never_shortened_at_nominal_trust(control, eigenvalue):
    """The rate is taken up to the given largest eigenvalue, where the sums of rows are above 2."""
    options = {"control": control, "control_precision": 0.3, "control_rate": 60.0}
    controller = in_units((1.0, 1000.0), **options)
    H_full, rates = controller._nominal_curvature()
    factor = eigenvalue / np.linalg.eigvals(rates[:, np.newaxis] * H_full).real.max()
    controller = replace(
        controller,
        belief_rate=factor * np.asarray(controller.belief_rate),
        control_rate=factor * np.asarray(controller.control_rate),
    )
    scaled = factor * np.sqrt(np.outer(rates, rates)) * H_full
    assert np.abs(scaled).sum(axis=1).max() > eigenvalue + 0.1
    np.testing.assert_allclose(nominal_fraction(controller), 1.0, rtol=1e-9)


def test_the_arm_with_three_modalities():
    modalities = [
        Modality("encoders", matrix=np.eye(4)[:2], std=1e-3),
        Modality("tachometers", matrix=np.eye(4)[2:], std=1e-3),
        Modality("all", 6, ARM, std=(1e-3,) * 4 + (1e-2,) * 2, precision=0.2),
    ]
    law = controllers.PID((250.0, 250.0), derivative_gain=(20.0, 20.0), integral_gain=50.0, integral_limit=100.0)
    controller = UnbiasedActiveInference(
        modalities, law, 1e-3, 200.0, control="law", initial_mean=(-1.5, 0.0, 0.0, 0.0)
    )

    linear = np.vstack([np.eye(4), np.eye(4), np.full((2, 4), np.nan)])  # the encoders also where a function reads them
    np.testing.assert_array_equal(controller.measurement_matrix, linear)
    np.testing.assert_array_equal(controller.goal_matrix, np.eye(4)[:2])
    assert controller.port("y").size == 10
    with pytest.raises(ModelError, match=r"an eigenvalue of \d"):
        replace(controller, belief_rate=2000.0)


def test_a_look_at_its_ports_derives_nothing_anew(monkeypatch):
    controller = UnbiasedActiveInference(
        Modality("bend", 3, bend, std=0.1), pull, H, 1.0, control_rate=0.1, sizes=(4, 2, 2), initial_mean=0.2
    )
    monkeypatch.setattr(differentiation, "_derived", lambda *a: pytest.fail("derived again"))
    for one in (controller, pickle.loads(pickle.dumps(controller)), replace(controller, inner_steps=2)):
        assert [port.name for port in one.outputs][:2] == ["u", "x_hat"]
        one.define(Fraction(1, 100))


def test_a_model_alone_says_what_is_measured():
    """The cruise control's model, predicted as by a Kalman filter; the control is in the prediction."""
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)
    controller = UnbiasedActiveInference(
        law=controllers.Proportional(2000.0), model=model, belief_rate=2.0, control="law", state_prior="kalman",
        state_precision=10.0, initial_mean=20.0, precision=controllers.GammaPrecision(),
    )  # fmt: skip
    np.testing.assert_array_equal(controller.measurement_matrix, model.matrix("C"))
    loop = cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controller,
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.Freeze(sensor=0, start=2.0, stop=4.0)],
        reference=25.0,
    )
    result = loop.simulate(6.0, seed=1)
    assert result["plant.v"][-1] == pytest.approx(25.0, abs=1.0)


def oscillator(precision, **prior):
    """A lightly damped plant whose damping is the control's, with an encoder of two that is wrong from 4 s on."""
    frequency, C = 2 * np.pi, np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    M = linalg.expm(H * np.array([[0, 1, 0], [-(frequency**2), -0.02 * frequency, 1], [0, 0, 0]]))
    A, B = M[:2, :2], M[:2, 2:]
    if prior["state_prior"] == "kalman":
        prior["model"] = controllers.LinearModel(A, B, C, 1e-4, 0.02**2, H)
    controller = UnbiasedActiveInference(
        Modality("all", matrix=C, std=0.02), controllers.ProportionalDerivative(40.0, derivative_gain=4.0), H, 50.0,
        control="law", precision=precision, **prior,
    )  # fmt: skip
    plant = cosim.StateSpace(ss(A, B, np.eye(2), 0, H, inputs=["force"], outputs=["position", "speed"]))
    return cosim.closed_loop(
        plant=plant, controller=controller, control="force", measured=["position", "speed"],
        sensors=cosim.Sensors(count=4, std=0.02, signals=2, matrix=C.tolist()),
        faults=[cosim.Injection(sensor=0, magnitude=1.0, start=4.0)], reference=1.0,
    )  # fmt: skip


@pytest.mark.parametrize("precision", [controllers.GammaPrecision(), controllers.PointMassPrecision()], ids=repr)
def test_a_prediction_that_is_followed_in_full_keeps_a_lightly_damped_plant(precision):
    """As the class says: a belief that lags looks like a fault to the learner, which makes it lag more."""
    errors = {}
    for prior, weight in (("random walk", 1.0), ("euler", 2.0), ("kalman", 2.0)):  # H * 50 * 2 = 1: in full
        loop = oscillator(precision, state_prior=prior, state_precision=weight)
        result = loop.simulate(8.0, seed=1)
        errors[prior] = np.sqrt(np.mean((result["controller.x_hat"][:, 0] - result["plant.position"]) ** 2))
    assert errors["kalman"] < 0.02  # the noise of one encoder
    assert min(errors["random walk"], errors["euler"]) > 10 * errors["kalman"]


def reaches(x_hat, goal, u):
    u[0] = goal[0] - x_hat[4]


def reads_first(x, y):
    y[0] = x[0]


def reaches_derivative(x, y_x):
    y_x[3, 0] = 1.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("absurd_goal", [1e20, 1e140, 1e300, np.inf, np.nan])
def test_a_belief_comes_back_from_an_absurd_goal(absurd_goal):
    step = small(control_precision=0.1).online()
    for goal in (0.1, absurd_goal, absurd_goal):
        step(y=[0.1, 0.1, 0.0], goal=[goal])
    for _ in range(3000):
        out = step(y=[0.1, 0.1, 0.0], goal=[0.1])
    assert np.isfinite(out.free_energy)
    np.testing.assert_allclose(out.x_hat, 0.1, atol=0.2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"belief_rate": 200.0, "control": "law"}, "unstable.*eigenvalue of 4 at"),
        ({"belief_rate": -1.0}, "must be positive"),
        ({"control_rate": None}, "needs a control_rate"),
        ({"inner_steps": 0}, "at least 1"),
        ({"control": "both"}, "'gradient' or 'law'"),
        ({"state_prior": np.array(["euler", "kalman"])}, "state_prior"),
        ({"dt": True}, "no finite number"),
        ({"inner_steps": 10**9}, "at most 10000"),
        ({"state_prior": "kalman"}, "needs a model"),
        ({"state_precision": -1.0}, "not positive definite"),
        ({"modalities": []}, "at least one"),
        ({"modalities": [Modality("x", matrix=[[1.0]], std=1.0)]}, "1 columns, but there are 2 states"),
        ({"modalities": [Modality("x", 1, bend, std=1.0)]}, "reaches beyond its arguments"),
        ({"law": pull}, "sizes="),
        ({"law": steep, "sizes": (2, 1, 1)}, r"derivative is \[\[-inf, 0.0\]\] at the initial mean"),
        ({"law": None}, "lacks its law"),
        ({"law": reaches, "sizes": (2, 1, 1), "control": "law"}, "control law 'reaches' reaches beyond its arguments"),
        (
            {"modalities": [Modality("x", 1, reads_first, std=1.0, jacobian=reaches_derivative)]},
            "jacobian of the modality 'x'",
        ),
        ({"modalities": [Modality("x", 2, reads_first, std=1.0, jacobian=reads_first)]}, r"does not write y\[1\]"),
        ({"law": cosim.Sensors()}, "x_hat and goal"),
        ({"sizes": (3, 1, 1)}, "leave sizes out"),
        ({"initial_mean": [0.0, np.nan]}, "finite"),
        ({"dt": None}, "sample time"),
        ({"precision": "gamma"}, "precision learner"),
        ({"belief_rate": "fast"}, "belief_rate is 'fast'; it must be a number or a list"),
        ({"control_rate": [20.0, None]}, "control_rate"),
        ({"state_precision": "high"}, "state_precision is 'high'"),
        ({"inner_steps": "2"}, "whole number"),
        ({"sizes": "abc"}, "three whole numbers"),
        ({"sizes": 3}, "three whole numbers"),
        ({"sizes": (2.5, 1, 1)}, "three whole numbers"),
        ({"modalities": "position"}, "must be Modality objects"),
        ({"modalities": 3}, "must be Modality objects"),
        ({"model": "car"}, "must be a LinearModel"),
        ({"precision": controllers.EFFDI(duration=0.017)}, "EFFDI"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else value,
)
def test_bad_settings_are_said_in_a_sentence(options, words):
    with pytest.raises(BayesFTCError, match=words):
        small(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "one of function= and matrix="),
        ({"matrix": [[1.0]], "function": bend}, "one of function= and matrix="),
        ({"matrix": [[1.0]]}, "one of std= and covariance="),
        ({"matrix": [[1.0]], "std": 0.0}, "positive"),
        ({"matrix": [[1.0]], "std": 1.0, "precision": -1.0}, "positive"),
        ({"matrix": [[1.0]], "std": 1.0, "size": 2}, "has 1 rows"),
        ({"function": bend, "std": 1.0}, "number of samples"),
        ({"function": print, "size": 1, "std": 1.0}, "plain Python function"),
        ({"matrix": "identity", "std": 1.0}, "a row for each sensor"),
        ({"matrix": [[1.0]], "std": "small"}, "std of the modality 'camera' is 'small'"),
    ],
)
def test_a_modality_says_what_it_lacks(options, words):
    with pytest.raises(ModelError, match=words):
        Modality("camera", **options)


def test_a_single_modality_needs_no_list():
    sensor = Modality("all", matrix=[[1.0, 0.0], [0.0, 1.0]], std=0.1)
    one, listed = small(modalities=sensor), small(modalities=[sensor])
    assert one.modalities == listed.modalities == (sensor,)


def test_a_turning_prediction_whose_pull_would_throw_the_belief_outwards_is_refused():
    """An undamped oscillation predicted by the model: each eigenvalue has a small real part, but is far from it."""
    turn = [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]
    model = controllers.LinearModel(turn, [[0.0], [0.1]], [[0.1, 0.0]], 1e-3, 1.0, 1.0)
    settings = {"model": model, "law": controllers.Proportional([1.0], states=2), "control": "law"}
    UnbiasedActiveInference(state_prior="kalman", state_precision=1.0, **settings)
    with pytest.raises(ModelError, match="unstable"):
        UnbiasedActiveInference(state_prior="kalman", state_precision=10.0, **settings)


def test_no_noise_is_learned_from_a_belief_without_covariance():
    """Its lag behind the state is no noise of the sensors: also where a wrapper has the learner."""
    model = controllers.LinearModel([[0.99]], [[0.1]], [[1.0], [1.0]], 0.01, [0.04, 0.04], 0.1)
    options = {"model": model, "law": controllers.Proportional(1.0), "state_prior": "kalman", "control": "law"}
    believed, learned = (
        [
            wrap(controllers.SwitchingPrecision([controllers.Frozen()], joint=False, noise_factor=factor))
            for wrap in (lambda learner: learner, controllers.ExplicitDetection)
        ]
        for factor in (1.0, 3.0)
    )
    rows = np.random.default_rng(0).normal(size=(60, 2)) + np.linspace(0.0, 30.0, 60)[:, None]
    for without, with_noise in zip(believed, learned, strict=True):
        assert with_noise.without_covariance() == without
        runs = []
        for precision in (without, with_noise):
            step = UnbiasedActiveInference(**options, precision=precision).online(compiled=False)
            runs.append([step(y=row, goal=[0.0]).R for row in rows])
        np.testing.assert_array_equal(*runs)
    gamma = controllers.GammaPrecision()
    assert gamma.without_covariance() is gamma
