"""Point-mass learning of the full precision matrix: against numerical gradients, matrix exponentials and minimisers of SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import optimize
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from bayesftc import controllers
from bayesftc.controllers import PointMassPrecision
from bayesftc.controllers.linalg.eigen import diagonalise
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.cosim.errors import ModelError

LOOSE = {"full": True, "lower_bound": 1e-5, "variance_bound": 1e-5}


def positive(rng, m, least=0.2):
    F = rng.normal(size=(m, m))
    return F @ F.T + least * np.eye(m)


class Learning:
    """The bare step function, fed with innovations as any controller does; NaN is missing."""

    def __init__(self, precision, nominal, covariance=None):
        m = len(nominal)
        model = controllers.LinearModel([[1.0]], [[1.0]], np.ones((m, 1)), 1.0, nominal, 1.0)
        self.learner, self.nominal = precision.learner(model), np.array(nominal)
        self.memory = self.learner.memory.copy()
        if covariance is not None:
            self.memory[1:] = np.concatenate([covariance.ravel(), np.linalg.inv(covariance).ravel()])

    def __call__(self, e):
        m = len(self.nominal)
        e, present = np.asarray(e, float), np.isfinite(e).astype(float)
        R, spread, work = np.zeros((m, m)), np.zeros((m, m)), np.zeros((self.learner.work, m, m))
        used, precision, beta, p = np.zeros((4, m))
        self.learner.step(
            Sample(e, np.nan_to_num(e), present, spread, self.nominal),
            Trust(R, used, precision, beta, p),
            self.memory,
            self.learner.settings,
            work,
        )
        np.testing.assert_array_equal(used, present)
        np.testing.assert_allclose(precision, 1 / np.diag(R), rtol=1e-15)
        assert np.isnan([*beta, *p]).all()
        return R


def free_energy(V, e):
    """-ln of the density of the samples that there are; its additive constant does not matter."""
    here = np.isfinite(e)
    return -multivariate_normal(cov=V[np.ix_(here, here)]).logpdf(e[here])


def gradient(V, e):
    """D with dF = tr(D dZ) at Z = 0, for the precision M exp(Z) M', by central differences; and M."""
    m, h = len(V), 1e-5
    M, D = np.linalg.cholesky(np.linalg.inv(V)), np.zeros((len(V), len(V)))
    for i in range(m):
        for j in range(i + 1):
            Z = np.zeros((m, m))
            Z[i, j] = Z[j, i] = h
            ends = [free_energy(np.linalg.inv(M @ expm(sign * Z) @ M.T), e) for sign in (1, -1)]
            D[i, j] = D[j, i] = (ends[0] - ends[1]) / (2 * h) / (1 if i == j else 2)
    return D, M


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(1, 5), st.floats(1e-3, 0.3), st.floats(0.0, 3.0), st.integers(0, 2**32 - 1))
def test_a_step_goes_down_the_numerical_gradient_of_the_free_energy(m, rate, size, seed):
    rng = np.random.default_rng(seed)
    V, nominal, e = positive(rng, m), positive(rng, m), size * rng.normal(size=m)
    e[rng.random(m) < 0.25] = np.nan
    if np.isnan(e).all():
        e[0] = size
    here = np.isfinite(e)
    s = e[here] @ np.linalg.inv(V[np.ix_(here, here)]) @ e[here]
    R = Learning(PointMassPrecision(rate=rate, **LOOSE), nominal, V)(e)
    if np.exp(0.5 * rate * abs(s - 1)) < max(s, 1 / max(s, 1e-300)):  # else the step ends at the minimum
        D, M = gradient(V, e)
        np.testing.assert_allclose(
            np.linalg.inv(R), M @ expm(-rate * D) @ M.T, rtol=1e-5, atol=1e-6 * np.abs(np.linalg.inv(V)).max()
        )
    absent = ~here
    if absent.any():
        # Given the others the missing ones are as they were.
        for before, after in ((V, R),):
            K = [S[np.ix_(absent, here)] @ np.linalg.inv(S[np.ix_(here, here)]) for S in (before, after)]
            np.testing.assert_allclose(K[1], K[0], rtol=1e-6, atol=1e-8)
            left = [
                S[np.ix_(absent, absent)] - k @ S[np.ix_(here, absent)] for S, k in zip((before, after), K, strict=True)
            ]
            np.testing.assert_allclose(left[1], left[0], rtol=1e-6, atol=1e-8)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(1, 5), st.floats(1e-3, 1e3), st.floats(0.0, 1e8), st.integers(0, 2**32 - 1))
def test_no_step_passes_the_samples_minimum_or_the_bounds(m, rate, size, seed):
    """s = e' Pi e moves towards 1, whatever the rate; eigenvalues relative to the nominal precision stay between the bounds."""
    rng = np.random.default_rng(seed)
    V, nominal, e = positive(rng, m), positive(rng, m), size * rng.normal(size=m)
    R = Learning(PointMassPrecision(rate=rate, **LOOSE), nominal, V)(e)
    before, after = (e @ np.linalg.solve(S, e) for S in (V, R))
    if 1e-3 < before < 1e3:  # else the loose bounds act, too
        assert min(before, 1.0) * (1 - 1e-6) <= after <= max(before, 1.0) * (1 + 1e-6)
    learn = Learning(PointMassPrecision(rate=rate, full=True, lower_bound=0.01, variance_bound=0.5), nominal)
    for row in (e, np.where(np.arange(m) % 2, np.nan, -e), 1e-3 * e, np.full(m, np.nan), np.full(m, 1e300)):
        R = learn(row)
        np.testing.assert_array_equal(R, R.T)
        root = np.linalg.cholesky(nominal)
        relative = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, R).T))
        assert relative.min() > 0.5 * (1 - 1e-9)
        assert relative.max() < 100 * (1 + 1e-9)


def test_one_sensor_is_the_diagonal_learner():
    rng = np.random.default_rng(2)
    options = {"rate": 0.7, "lower_bound": 0.01, "variance_bound": 0.5}
    full, diagonal = (Learning(PointMassPrecision(**options, full=full), [[4.0]]) for full in (True, False))
    for e in 2.0 * rng.standard_cauchy(500):
        e = np.array([e if rng.random() < 0.9 else np.nan])
        m, learner = 1, diagonal.learner
        R, spread, work, rest = np.zeros((m, m)), np.zeros((m, m)), np.zeros((1, m, m)), np.zeros((4, m))
        with np.errstate(divide="ignore"):
            learner.step(
                Sample(e, np.nan_to_num(e), np.isfinite(e).astype(float), spread, diagonal.nominal),
                Trust(R, *rest),
                diagonal.memory,
                learner.settings,
                work,
            )
        np.testing.assert_allclose(full(e), R, rtol=1e-12)


def test_units_and_order_of_the_sensors_do_not_matter():
    rng = np.random.default_rng(5)
    nominal, scale, order = positive(rng, 3), np.array([1.0, 1e-3, 50.0]), [2, 0, 1]
    here, there = (Learning(PointMassPrecision(rate=0.3, full=True), S)
                   for S in (nominal, (nominal * np.outer(scale, scale))[np.ix_(order, order)]))  # fmt: skip
    for e in 3.0 * rng.normal(size=(100, 3)):
        expected = (here(e) * np.outer(scale, scale))[np.ix_(order, order)]
        np.testing.assert_allclose(there((e * scale)[order]), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_it_settles_where_scipys_minimiser_has_the_least_mean_free_energy():
    """Correlated errors of three sensors, one of which is silent half of the time."""
    rng = np.random.default_rng(7)
    truth = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, -0.3], [0.0, -0.3, 2.0]])
    errors = rng.multivariate_normal(np.zeros(3), truth, size=4_000)
    errors[rng.random(4_000) < 0.5, 2] = np.nan
    whole, part = errors[np.isfinite(errors[:, 2])], errors[np.isnan(errors[:, 2])][:, :2]
    below = np.tril_indices(3)

    def mean(parameters):
        root = np.zeros((3, 3))
        root[below] = parameters
        V = root @ root.T + 1e-9 * np.eye(3)
        return (
            -(multivariate_normal(cov=V).logpdf(whole).sum() + multivariate_normal(cov=V[:2, :2]).logpdf(part).sum())
            / 4_000
        )

    best = optimize.minimize(mean, np.eye(3)[below], method="BFGS").x
    root = np.zeros((3, 3))
    root[below] = best
    learn = Learning(PointMassPrecision(rate=0.01, full=True, variance_bound=0.01), 3.0 * np.eye(3))
    covariances = [learn(row) for _ in range(3) for row in errors]
    found = np.mean(covariances[4_000:], axis=0)
    np.testing.assert_allclose(found, root @ root.T, atol=0.06)
    assert found[0, 1] > 0.7


@pytest.mark.parametrize("m", [1, 2, 3, 6, 20])
def test_eigenvalues_are_numpys(m):
    rng = np.random.default_rng(m)
    for a in (
        positive(rng, m),
        np.diag(np.arange(1.0, m + 1.0)),
        np.ones((m, m)),
        np.diag(10.0 ** -np.arange(m)) + 1e-3,
    ):
        turned, vectors = a.copy(), np.zeros((m, m))
        diagonalise(turned, vectors)
        np.testing.assert_allclose(np.sort(np.diag(turned)), np.linalg.eigvalsh(a), rtol=1e-12, atol=1e-14 * m)
        np.testing.assert_allclose(vectors @ np.diag(np.diag(turned)) @ vectors.T, a, atol=1e-12)
        np.testing.assert_allclose(vectors.T @ vectors, np.eye(m), atol=1e-13)


@pytest.mark.slow
def test_in_the_loop_it_weighs_correlated_sensors_and_reports_the_matrix():
    """Two sensors share an error that the model does not know: learned, they count for little more than one of them."""
    model = controllers.LinearModel([[1.0]], [[1.0]], [[1.0]] * 3, 1e-4, 1.0, 0.1)
    precision = PointMassPrecision(rate=0.02, full=True)
    step = controllers.StateEstimator(model, precision).online(compiled=True)
    rng, R = np.random.default_rng(1), []
    for _ in range(4_000):
        shared = 3.0 * rng.normal()
        out = step(y=rng.normal(size=3) + np.array([shared, shared, 0.0]), u=[0.0])
        R.append(out.R)
        np.testing.assert_allclose(out.precision_mean @ out.R, np.eye(3), atol=1e-9)
        np.testing.assert_array_equal(out.precision_mode, out.precision_mean)
        assert not out.precision_variance.any()
    found = np.mean(R[1_000:], axis=0)
    np.testing.assert_allclose(found[:2, :2], [[10.0, 9.0], [9.0, 10.0]], rtol=0.15)
    assert abs(found[0, 2]) < 0.5


def test_active_inference_weighs_by_it():
    """Its free energy at the first gradient, by SciPy's densities with the sensor covariance that is reported."""
    precision = PointMassPrecision(rate=1.0, full=True)
    sensors = controllers.Modality("speed", matrix=[[1.0], [1.0]], std=(0.5, 0.8), precision=(4.0, 1.5625))
    law = controllers.Proportional(1.0)
    controller = controllers.UnbiasedActiveInference(sensors, law, 0.1, 0.1, control="law", precision=precision)
    step = controller.online(compiled=False)
    for y in ([0.4, -0.5], [3.0, 2.5], [-4.0, -5.0]):
        out = step(y=y, goal=[0.0])
    assert abs(out.R[0, 1]) > 0.1
    density = multivariate_normal(cov=out.R).logpdf(out.innovation) + multivariate_normal(cov=1.0).logpdf(out.eps_x)
    density += multivariate_normal(cov=1.0).logpdf(out.eps_u)
    assert out.free_energy == pytest.approx(-density, rel=1e-9)


def test_a_matrix_has_no_direct_step():
    with pytest.raises(ModelError, match="parameterization='direct'"):
        PointMassPrecision(full=True, parameterization="direct")
    with pytest.raises(ModelError, match="their product must be at least 1e-10"):
        PointMassPrecision(full=True, lower_bound=1e-6, variance_bound=1e-5)
    with pytest.raises(ModelError, match="full=1; it must be True or False"):
        PointMassPrecision(full=1)
