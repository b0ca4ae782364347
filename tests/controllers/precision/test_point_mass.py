"""Point-mass precision: its steps against the gradient of the free energy, its bounds, and recovery in the loop."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc import controllers
from bayesftc.controllers import PointMassPrecision
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.cosim.errors import BayesFTCError

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*encountered in:RuntimeWarning"
)  # IEEE 754 arithmetic, as in the engines

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], 0.02)


def free_energy(w, e):
    return (w * e**2 - np.log(w)) / 2


def learn(precision, errors, model=MODEL):
    """Feed innovations to the bare step function, as any controller does; NaN is missing. Returns relative precisions."""
    learner, m = precision.learner(model), model.sensors
    nominal, memory, out = model.matrix("sensor_covariance"), learner.memory.copy(), []
    R, used, weight, beta, p = np.zeros((m, m)), *np.zeros((4, m))
    for row in np.asarray(errors, float):
        present = np.isfinite(row).astype(float)
        e, spread = np.nan_to_num(row), np.zeros((m, m))
        with np.errstate(divide="ignore", over="ignore"):
            learner.step(
                Sample(row, e, present, spread, nominal),
                Trust(R, used, weight, beta, p),
                memory,
                learner.settings,
                np.zeros((learner.work, m, m)),
            )
        np.testing.assert_allclose(np.diag(R), 1 / weight, rtol=1e-12)
        out.append(weight * np.diag(nominal))
    return np.array(out)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.floats(0.01, 4.0), st.floats(-3.0, 3.0), st.floats(1e-4, 1e-2), st.sampled_from(["exponential", "direct"]))
def test_a_small_step_goes_down_the_gradient_of_the_free_energy(w, e, rate, parameterization):
    """The gradient by complex step, with respect to ln w or w."""
    h = 1e-30j
    if parameterization == "exponential":
        gradient = (free_energy(np.exp(np.log(w) + h), e) / 1e-30).imag
        expected = np.exp(np.log(w) - rate * gradient)
    else:
        expected = w - rate * (free_energy(w + h, e) / 1e-30).imag
    best = 1 / e**2 if e**2 else np.inf
    expected = max(expected, best) if w > best else min(expected, best)
    options = {"rate": rate, "lower_bound": 1e-6, "variance_bound": 1e-3, "parameterization": parameterization}
    learner = PointMassPrecision(**options).learner(MODEL)
    nominal, memory = MODEL.matrix("sensor_covariance"), np.array([w, 1.0])
    R, used, weight, beta, p = np.zeros((2, 2)), *np.zeros((4, 2))
    with np.errstate(divide="ignore"):
        learner.step(
            Sample(np.zeros(2), np.array([e, 0.0]), np.ones(2), R, nominal),
            Trust(R, used, weight, beta, p),
            memory,
            learner.settings,
            np.zeros((1, 2, 2)),
        )
    assert memory[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("parameterization", ["exponential", "direct"])
def test_no_step_goes_past_the_samples_own_minimum_and_none_raises_its_free_energy(parameterization):
    rng = np.random.default_rng(4)
    errors = rng.standard_t(1.5, size=(2000, 2)) * [1.0, 2.0]
    errors[rng.random(errors.shape) < 0.1] = np.nan
    precision = PointMassPrecision(rate=3.0, lower_bound=1e-6, variance_bound=1e-6, parameterization=parameterization)
    w = np.vstack([[1.0, 1.0], learn(precision, errors)])
    whitened = errors / [1.0, 2.0]
    missing = np.isnan(errors)
    np.testing.assert_array_equal(w[1:][missing], w[:-1][missing])
    drop = free_energy(w[1:], whitened) - free_energy(w[:-1], whitened)
    assert (drop[~missing] <= 1e-12).all()
    assert ((w[1:] - 1 / whitened**2) * (w[:-1] - 1 / whitened**2) >= -1e-9 * w[:-1] ** 2)[~missing].all()


@pytest.mark.parametrize("parameterization", ["exponential", "direct"])
def test_the_bounds_hold_and_one_absurd_sample_reaches_the_lower_one(parameterization):
    precision = PointMassPrecision(lower_bound=0.01, variance_bound=0.5, parameterization=parameterization)
    w = learn(precision, [[0.0, 0.0]] * 200 + [[1e300, -1e9]] + [[0.0, 0.0]] * 2000)
    assert w[199] == pytest.approx([2.0, 2.0])
    assert w[200] == pytest.approx([0.01, 0.01])
    assert w[-1] == pytest.approx([2.0, 2.0])


def test_a_constant_variance_is_found():
    """At the free energy's minimum w = 1 / E[e^2]."""
    errors = np.random.default_rng(0).normal(size=(8_000, 2)) * [3.0, 1.0]
    w = learn(PointMassPrecision(rate=0.01, variance_bound=0.1), errors)[2_000:]
    np.testing.assert_allclose(w.mean(axis=0), [1 / 9, 4.0], rtol=0.03)


def test_outputs_in_the_loop():
    controller = controllers.BayesianController(MODEL, precision=PointMassPrecision(), initial_mean=20.0)
    step = controller.online(compiled=False)
    for k in range(200):
        out = step(y=[20.0 + 8.0 * (k >= 50), 20.0], goal=[20.0])
    np.testing.assert_array_equal(out.precision_mean, out.precision)
    np.testing.assert_array_equal(out.precision_mode, out.precision)
    np.testing.assert_array_equal(out.precision_variance, [0.0, 0.0])
    assert np.isnan(out.beta).all()
    assert out.precision[0] == pytest.approx(1 / 64, rel=0.2)
    assert abs(out.x_hat[0] - 20.0) < 1.5
    assert "no rate" in str(PointMassPrecision().why_no_probability)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rate": 0.0}, "number above 0"),
        ({"rate": float("nan")}, "number above 0"),
        ({"lower_bound": 0.0}, "number above 0"),
        ({"lower_bound": 2.0}, "at most 1 / variance_bound"),
        ({"variance_bound": -1.0}, "number above 0"),
        ({"parameterization": "linear"}, "'exponential' or 'direct'"),
    ],
)
def test_bad_settings(options, words):
    with pytest.raises(BayesFTCError, match=words):
        PointMassPrecision(**options)
