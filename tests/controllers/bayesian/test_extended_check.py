"""`model_suspect` of the nonlinear controller: extended Kalman filters of each set of sensors beside it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import (
    FixedPrecision,
    GammaPrecision,
    LinearModel,
    NonlinearBayesianController,
    NonlinearModel,
    StateEstimator,
    diagnose,
)
from bayesftc.controllers.estimation.consistency import MEAN_LIMIT, PRODUCT_LIMIT, WINDOW
from bayesftc.controllers.estimation.observers import observers
from bayesftc.cosim.ops import cos, sin

STEP, LENGTH, STD = 0.02, 0.5, (0.01, 0.01, 0.005)
NOISE = (1e-10, 1e-5)
FIXED = FixedPrecision()


def swing(x, u, x_next):
    speed = x[1] + STEP * (u[0] - 9.81 / LENGTH * sin(x[0]) - 0.2 * x[1])
    x_next[0] = x[0] + STEP * speed
    x_next[1] = speed


def look(x, y):
    """Two encoders, and a camera that sees the bob from the side."""
    y[0] = x[0]
    y[1] = x[0]
    y[2] = LENGTH * sin(x[0])


MODEL = NonlinearModel(swing, look, 2, 1, 3, NOISE, np.square(STD), STEP)


def move(x, u, noise, gain, weight, std):
    speed = x[1] + STEP * (gain[0] * u[0] - weight[0] / LENGTH * sin(x[0]) - 0.2 * x[1])
    x[0] = x[0] + STEP * speed
    x[1] = speed + std[0] * noise[0]


def show(x, theta):
    theta[0] = x[0]


def look_at(x, y):
    """What the sensors read of the angle alone."""
    y[0] = x[0]
    y[1] = x[0]
    y[2] = LENGTH * sin(x[0])


@dataclass(frozen=True)
class Pendulum(cosim.Block):
    """The plant of the model, but for what its control does and how heavy it is."""

    gain: float = 1.0
    weight: float = 9.81

    inputs = (cosim.Port("u", feedthrough=False), cosim.Port("noise", draw="normal", feedthrough=False))
    outputs = (cosim.Port("theta"),)

    def define(self, step):
        parameters = {"gain": self.gain, "weight": self.weight, "std": NOISE[1] ** 0.5}
        return cosim.Definition(show, move, state={"x": np.zeros(2)}, parameters=parameters)


def run(plant, faults=(), precision=FIXED, seed=3, **options):
    """Return a run over large angles, 1.5 rad to either side, and its controller."""
    controller = NonlinearBayesianController(
        MODEL,
        precision,
        goal_covariance=[3.6e-5, 1e-2],
        initial_covariance=0.01,
        u_min=-60.0,
        u_max=60.0,
        iterations=10,
    )
    loop = cosim.closed_loop(
        plant=plant,
        controller=controller,
        control="u",
        measured=["theta"],
        sensors=cosim.Sensors(count=3, std=STD, function=look_at),
        faults=list(faults),
        reference=[cosim.Sine(amplitude=1.5, period=4.0), 0.0],
    )
    record = ["controller.model_suspect", "controller.u", "controller.y", "controller.x_hat", "controller.P"]
    return loop.simulate(12.0, seed=seed, record=record, **options), controller


def by_numpy(y, u):
    """Return `model_suspect` by extended Kalman filters in plain NumPy."""
    start = MODEL.linearised([0.0, 0.0])
    bank = observers(start, groups=start.alike)
    R, Q, rest, disagreements = np.diag(np.square(STD)), np.diag(NOISE), bank.settling, []
    for chosen in map(list, bank.sensors):
        x, P, last = np.zeros(2), 0.01 * np.eye(2), np.zeros(len(chosen))
        average, square, product, over = np.zeros(len(chosen)), 1.0, 0.0, []
        for k in range(len(y)):
            reading, C = np.empty(3), np.array([[1.0, 0.0], [1.0, 0.0], [LENGTH * cos(x[0]), 0.0]])[chosen]
            look(x, reading)
            e, S = (y[k] - reading)[chosen], C @ P @ C.T + R[np.ix_(chosen, chosen)]
            w = np.linalg.solve(np.linalg.cholesky(S), e)
            if k >= rest:
                average += (w - average) / WINDOW
                square += (w @ w / len(w) - square) / WINDOW
                product += (w @ last / len(w) - product) / WINDOW
            last, count = w, 2 * WINDOW - 1
            mean_part = count * average @ average / square / MEAN_LIMIT
            over.append(max(mean_part, count * len(w) * max(product / square, 0.0) ** 2 / PRODUCT_LIMIT))
            K = P @ C.T @ np.linalg.inv(S)
            x, P = x + K @ e, (np.eye(2) - K @ C) @ P
            fall = -STEP * 9.81 / LENGTH * cos(x[0])
            F = np.array([[1 + STEP * fall, STEP * (1 - 0.2 * STEP)], [fall, 1 - 0.2 * STEP]])
            following = np.empty(2)
            swing(x, u[k], following)
            x, P = following, F @ P @ F.T + Q
        disagreements.append(over)
    least = np.min(disagreements, axis=0)
    return least / (1 + least)


def test_it_is_what_numpy_makes_of_the_samples_over_large_angles():
    result, _ = run(Pendulum(weight=1.1 * 9.81))
    expected = by_numpy(result["controller.y"], result["controller.u"].reshape(-1, 1))
    assert expected.max() > 0.05
    np.testing.assert_allclose(result["controller.model_suspect"].ravel(), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("plant", [Pendulum(gain=-1.0), Pendulum(gain=0.6), Pendulum(weight=1.4 * 9.81)], ids=repr)
def test_wrong_models_are_suspect(plant):
    result, controller = run(plant)
    assert result["controller.model_suspect"].max() > 0.9
    finding = diagnose(result, controller)
    assert finding.kind == "unknown"
    assert "Check the direction of the control" in finding.sentence


FAULTS = [
    (),
    *(
        (fault,)
        for sensor in (0, 2)
        for fault in (
            cosim.Freeze(sensor=sensor, start=3.0, stop=8.0),
            cosim.Injection(sensor=sensor, start=3.0, stop=8.0, magnitude=0.6),
            cosim.Dropout(sensor=sensor, start=3.0, stop=8.0),
        )
    ),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("faults", FAULTS, ids=repr)
def test_a_right_model_is_not_whatever_one_sensor_does(faults):
    for seed in range(5):
        result, controller = run(Pendulum(), faults, GammaPrecision(forgetting=0.9), seed)
        assert result["controller.model_suspect"].max() < 0.5
        assert diagnose(result, controller) is None


@pytest.mark.slow
def test_both_engines_have_the_same_bits():
    fault = [cosim.Injection(sensor=0, start=0.5, stop=2.0, magnitude=0.6)]
    fast, slow = (run(Pendulum(), fault, seed=1, engine=engine)[0] for engine in ("compiled", "interpreted"))
    np.testing.assert_array_equal(fast["controller.model_suspect"], slow["controller.model_suspect"])


def test_for_a_linear_model_it_becomes_that_of_the_steady_observers():
    model = LinearModel([[1.0, 0.1], [0.0, 0.98]], [[0.0], [0.1]], [[1.0, 0.0]] * 2, [1e-5, 1e-4], 0.01, 0.1)
    wrong = NonlinearModel.from_linear(replace(model, B=[[0.0], [0.3]]))
    bent = NonlinearBayesianController(
        wrong, goal_covariance=1.0, control_covariance=1.0, iterations=2, precision=FIXED
    )
    straight = StateEstimator(replace(model, B=[[0.0], [0.3]]), precision=FIXED)
    a, b = bent.online(), straight.online()
    rng, x, found = np.random.default_rng(7), np.zeros(2), []
    for k in range(600):
        y = x[0] + 0.1 * rng.standard_normal(2)
        out = a(y=y, goal=[20.0 * np.sign(np.sin(k / 20)), 0.0])
        found.append([float(out.model_suspect), float(b(y=y, u=out.u).model_suspect)])
        x = model.A @ x + model.B @ out.u + np.sqrt([1e-5, 1e-4]) * rng.standard_normal(2)
    found = np.array(found[400:])
    assert found.max() > 0.3
    np.testing.assert_allclose(found[:, 0], found[:, 1], atol=1e-3)


def test_without_observers_it_is_not_a_number():
    unseen = LinearModel([[1.02, 0], [0, 0.9]], [[0.1], [1.0]], [[0, 1]], [1e-3, 1e-3], 1.0, dt=0.1)
    step = NonlinearBayesianController(unseen, goal_covariance=1.0, control_covariance=1.0).online(compiled=False)
    assert np.isnan(step(y=[0.1], goal=[0.0, 0.0]).model_suspect)
