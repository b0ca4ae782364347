"""The consistency check where sensors have no sample in some steps."""

import control
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings, strategies as st

from bayesftc import controllers, cosim
from bayesftc.controllers.estimation import consistency as check
from bayesftc.controllers.estimation.observers import observers


def by_filterpy(model, y, u):
    """Return the check's output at each step, with filterpy's filters of the sensors that have a sample."""
    bank, R, weight = observers(model), model.matrix("sensor_covariance"), 1.0 / check.WINDOW
    filters = []
    for noise, covariance in zip(bank.noise, bank.covariance, strict=True):
        kalman = KalmanFilter(model.states, model.sensors, model.controls)
        kalman.F, kalman.B, kalman.Q, kalman.P = bank.transition, model.matrix("B"), noise, check.UNCERTAIN * covariance
        filters.append(kalman)
    moments = np.stack([np.array([[0.0], [1.0], [0.0]]) * np.ones(model.sensors)] * len(bank))
    last, out = np.zeros((len(bank), model.sensors)), []
    for k, (samples, push) in enumerate(zip(y, u, strict=True)):
        found = []
        for s, (chosen, kalman) in enumerate(zip(bank.sensors, filters, strict=True)):
            there = [i for i in chosen if np.isfinite(samples[i])]
            if there:
                C = model.matrix("C")[there]
                e = samples[there] - C @ kalman.x[:, 0]
                white = np.linalg.solve(np.linalg.cholesky(C @ kalman.P @ C.T + R[np.ix_(there, there)]), e)
                new = np.stack([white, white**2, white * last[s, there]])
                if k + 1 >= bank.settling + 0.5:
                    moments[s][:, there] += weight * (new - moments[s][:, there])
                last[s, there] = white
                kalman.update(samples[there][:, None], R=R[np.ix_(there, there)], H=C)
            kalman.predict(u=push[:, None])
            mean, square, product = (moments[s, i, list(chosen)] for i in range(3))
            scale = len(chosen) * (2 - weight) / weight / square.sum()
            alike = max(product.sum(), 0.0) ** 2 / square.sum()
            found.append(scale * max((mean**2).sum() / check.MEAN_LIMIT, alike / check.PRODUCT_LIMIT))
        out.append(min(found) / (1.0 + min(found)))
    return np.array(out)


@settings(max_examples=15)
@given(
    seed=st.integers(0, 10**6),
    share=st.floats(0.0, 0.7),
    correlation=st.sampled_from([0.0, 0.6]),
    wrong=st.sampled_from([1.0, 3.0]),
)
def test_it_is_that_of_kalman_filters_with_the_samples_that_are_there(seed, share, correlation, wrong):
    """Also where the noise of sensors is correlated, whichever of them has a sample."""
    rng = np.random.default_rng(seed)
    R = 0.01 * np.eye(6)
    R[0, 4] = R[4, 0] = R[1, 5] = R[5, 1] = 0.01 * correlation
    model = controllers.LinearModel(
        [[1.0, 0.1], [0.0, 0.95]], [[0.0], [0.1]], [[1, 0], [1, 0], [2, 0], [2, 0], [0, 1], [0, 1]], 1e-4, R, dt=0.1
    )
    x, y, u = np.zeros(2), [], np.sign(np.sin(np.arange(500) / 30))[:, None]
    for push in u:
        y.append(model.C @ x + rng.multivariate_normal(np.zeros(6), R))
        x = model.A @ x + wrong * model.B @ push + 0.01 * rng.standard_normal(2)
    y, gone = np.array(y), rng.random((500, 6)) < share
    y[gone] = np.nan
    step = controllers.StateEstimator(model, precision=controllers.FixedPrecision()).online()
    found = [float(step(y=row, u=push).model_suspect) for row, push in zip(y, u, strict=True)]
    np.testing.assert_allclose(found, by_filterpy(model, y, u), rtol=1e-6, atol=1e-9)
    assert (max(found) > 0.5) == (wrong > 1.0)


def satellite(fault, every, seed, precision=None):
    """Return a run of an attitude by two gyros and a star tracker with a sample in each `every` steps."""
    plant = control.ss([[0, 1], [0, -0.05]], [[0], [1]], np.eye(2), 0, inputs=["torque"], outputs=["angle", "rate"])
    std, measured = [0.002, 0.001, 0.001], ["angle", "rate"]
    controller = controllers.design(
        plant, dt=0.05, measured=measured, actuated="torque", sensors=[1, 2], sensor_std=std, goal="angle",
        acceptable_error=0.05, acceptable_control=0.1, **({"precision": precision} if precision else {}),
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="torque", measured=measured, sensors=cosim.Sensors([1, 2], std, every=[every, 1, 1]),
        faults=[fault], reference=cosim.Sine(0.5, 40.0),
    )  # fmt: skip
    return loop.simulate(60.0, seed=seed)


@pytest.mark.parametrize("fault", [cosim.Freeze(sensor=1, start=20.0), cosim.Drift(sensor=2, start=20.0, slope=0.002)])
@pytest.mark.parametrize("precision", [None, controllers.FixedPrecision()], ids=["default", "fixed"])
def test_a_fault_beside_a_slow_sensor_is_no_wrong_model(fault, precision):
    """Between the samples the observers took the controller's estimate, which fixed precision lets the fault spoil."""
    for seed in range(3):
        run = satellite(fault, 20, seed, precision)
        assert run["controller.model_suspect"].max() < 0.3


@pytest.mark.parametrize("pole", [1.05, 1.5])
def test_it_comes_back_when_an_unstable_plant_was_not_seen_for_long(pole):
    """The belief has grown to the largest number, its variance to the largest one; then the samples are back."""
    model = controllers.LinearModel([[pole]], [[1.0]], [[1.0], [1.0]], 1e-3, 0.01, dt=0.1)
    step = controllers.StateEstimator(model, precision=controllers.FixedPrecision()).online()
    rng, x, found = np.random.default_rng(0), 0.0, []
    for k in range(4000):
        y = x + 0.1 * rng.standard_normal(2) if k < 200 or k > 2500 else np.full(2, np.nan)
        u = -(pole - 0.1) * x  # what the plant's own control does
        found.append(float(step(y=y, u=[u if k < 200 or k > 2500 else 1.0]).model_suspect))
        x = pole * x + u + (0.5 if k > 3000 else 0.0) + 1e-3**0.5 * rng.standard_normal()
    assert np.isfinite(found).all()
    assert max(found[200:3000]) < 0.5 < max(found[3000:])


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize(
    "precision", [controllers.FixedPrecision(), controllers.SwitchingPrecision(loss=0.9)], ids=repr
)
def test_a_start_elsewhere_is_no_wrong_model_however_few_samples_there_are(every, precision):
    model = controllers.LinearModel([[0.999]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    step, rng, x, found = (
        controllers.StateEstimator(model, precision=precision).online(),
        np.random.default_rng(0),
        5.0,
        [],
    )
    for k in range(1500):
        y = x + 0.1 * rng.standard_normal(2) if k % every == 0 else np.full(2, np.nan)
        found.append(float(step(y=y, u=[0.0]).model_suspect))
        x = 0.999 * x + 0.01 * rng.standard_normal()
    assert max(found) < 0.5


def test_the_units_of_states_do_not_decide_what_is_kept_without_samples():
    """An unstable position in m that no sample tells for long, beside a pressure in Pa."""
    A, C = np.diag([1.02, 0.9]), np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    found = []
    for unit in (1.0, 1e6):
        there = np.diag([1.0, unit])
        model = controllers.LinearModel(
            A,
            there @ np.ones((2, 1)),
            C @ there,
            np.diag([1e-4, 1e-2 * unit**2]),
            [0.01, 0.01, unit**4, unit**4],
            dt=0.1,
        )
        step, rng = (
            controllers.StateEstimator(model, precision=controllers.FixedPrecision()).online(),
            np.random.default_rng(1),
        )
        x, out = np.zeros(2), []
        for k in range(3000):
            y = C @ np.diag([1.0, unit**2]) @ x + np.array([0.1, 0.1, unit**2, unit**2]) * rng.standard_normal(4)
            y[:2] = y[:2] if k < 300 or k > 2000 else np.nan
            u = -0.5 * x[0]
            out.append(float(step(y=y, u=[u]).model_suspect))
            x = A @ x + u + rng.standard_normal(2) * [0.01, 0.1]
        found.append(out)
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
