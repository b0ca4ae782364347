"""Covariances of fits against their formulas, and the tests for correlated residuals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesftc.cosim.fitting.coloured import arma, white_scores
from bayesftc.cosim.fitting.uncertainty import combinations, covariance, is_correlated, long_run

PAIR = np.zeros(2, dtype=np.int64)


def test_independent_residuals_give_the_inverse_of_the_gauss_newton_matrix():
    jacobian = np.random.default_rng(0).standard_normal((50, 2, 3))
    flat = jacobian.reshape(-1, 3)
    np.testing.assert_allclose(
        covariance(jacobian, np.zeros((50, 2)), PAIR, correlated=False), np.linalg.inv(flat.T @ flat)
    )


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.5, 0.9])
def test_the_long_run_covariance_is_that_of_an_autoregression(rho):
    """Of unit innovations it is 1/(1 - rho)^2 a sample."""
    series = lfilter([1.0], [1.0, -rho], np.random.default_rng(1).standard_normal((20_000, 2)), axis=0)
    estimated = long_run(series) / len(series)
    np.testing.assert_allclose(np.diag(estimated), 1 / (1 - rho) ** 2, rtol=0.1)
    assert abs(estimated[0, 1]) < 0.05 * estimated[0, 0]


def test_errors_that_two_sensors_share_count_once():
    rng = np.random.default_rng(2)
    shared = rng.standard_normal(5000)
    residuals, jacobian = np.column_stack([shared, shared]), np.ones((5000, 2, 1))
    assert is_correlated(residuals, 1e-3) == [True, True]
    # Two equal sensors determine a mean no better than one does.
    assert covariance(jacobian, residuals, PAIR, correlated=True)[0, 0] == pytest.approx(1 / 5000, rel=0.1)
    assert covariance(jacobian, residuals, PAIR, correlated=False)[0, 0] == pytest.approx(1 / 10_000)


def test_white_residuals_pass_and_coloured_ones_do_not():
    rng = np.random.default_rng(3)
    passed = [is_correlated(rng.standard_normal((300, 2)), 1e-2) for _ in range(200)]
    assert np.mean(passed) < 0.06  # a sensor takes part in two tests of 1 %
    coloured = lfilter([1.0], [1.0, -0.5], rng.standard_normal((300, 1)), axis=0)
    assert is_correlated(np.hstack([coloured, rng.standard_normal((300, 1))]), 1e-3) == [True, False]
    assert is_correlated(np.full((300, 1), np.nan), 1e-3) == [False]
    assert is_correlated(np.zeros((300, 1)), 1e-3) == [False]


def test_a_parameter_without_effect_looks_uncertain():
    jacobian = np.zeros((50, 1, 2))
    jacobian[:, 0, 0] = 1.0
    result = covariance(jacobian, np.ones((50, 1)), np.zeros(1), correlated=True)
    assert np.isfinite(result).all()
    assert result[1, 1] > 1e10


def noise(pole, share, rows, rng):
    """White noise and an autoregression with this pole, so many times as large."""
    slow = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], rng.standard_normal(rows + 3000))[3000:]
    return rng.standard_normal(rows) + share * slow


@pytest.mark.parametrize(("pole", "zero"), [(0.99, -0.9), (0.8, 0.0), (-0.5, 0.3), (0.0, 0.0)])
def test_the_spectrum_of_noise_is_that_of_its_arma(pole, zero):
    series = lfilter([1.0, zero], [1.0, -pole], np.random.default_rng(6).standard_normal(20_000))
    found = arma(series, np.zeros(10_000))
    assert found == pytest.approx((pole, zero), abs=0.05)
    assert (found == (0.0, 0.0)) == (pole == zero)


def test_scores_keep_their_sum_for_any_filter():
    rng = np.random.default_rng(7)
    jacobian, residuals = rng.standard_normal((500, 2, 3)), np.column_stack([noise(0.99, 2.0, 500, rng)] * 2)
    scores = white_scores(jacobian, residuals, np.zeros_like(jacobian))
    np.testing.assert_allclose(scores.sum(axis=0), np.einsum("kcp,kc->p", jacobian, residuals), atol=1e-8)
    assert np.std(scores) < 0.9 * np.std(np.einsum("kcp,kc->kp", jacobian, residuals))  # the filter was one


@pytest.mark.parametrize(("pole", "share"), [(0.0, 0.0), (0.9, 1.0), (0.99, 1.0), (0.99, 3.0), (0.995, 0.3)])
def test_standard_errors_are_those_of_many_recordings(pole, share):
    """Two sensors share a slow error; a slow, a fast and an initial motion determine one parameter each."""
    z, rows = [], 3000
    for seed in range(60):
        rng = np.random.default_rng(seed)
        slow, fast = (np.repeat(rng.choice([-1.0, 1.0], rows // n), n) for n in (200, 40))
        shapes = [lfilter([0.01], [1, -0.99], slow), lfilter([0.1], [1, -0.9], fast), np.exp(-np.arange(rows) / 50)]
        jacobian = np.repeat(np.column_stack(shapes)[:, None], 2, axis=1)
        shared = noise(pole, share, rows, rng)
        errors = shared[:, None] + rng.standard_normal((rows, 2))
        flat = jacobian.reshape(-1, 3)
        estimate = np.linalg.lstsq(flat, errors.ravel(), rcond=None)[0]
        found = covariance(jacobian, errors - jacobian @ estimate, PAIR, correlated=True)
        z.append(estimate / np.sqrt(np.diag(found)))
    assert np.mean(np.abs(z) < 2) > 0.88  # of 180: 95.4 % of normal numbers; at least a fifth too small otherwise


@pytest.mark.parametrize("correlated", [False, True])
def test_a_parameter_without_effect_changes_no_other_standard_error(correlated):
    rng = np.random.default_rng(5)
    jacobian = rng.standard_normal((400, 2, 3)) + 1.0
    residuals = lfilter([1.0], [1.0, -0.8], rng.standard_normal((400, 2)), axis=0)
    jacobian[:, :, 1] = 0.0
    result = covariance(jacobian, residuals, PAIR, correlated=correlated)
    alone = covariance(jacobian[:, :, [0, 2]], residuals, PAIR, correlated=correlated)
    np.testing.assert_allclose(result[np.ix_([0, 2], [0, 2])], alone, rtol=1e-6)


def test_combinations_are_the_axes_of_the_covariance():
    axes = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    found = combinations(("a", "b", "c"), axes @ np.diag([1.0, 9.0, 4.0]) @ axes.T)
    assert [one.std for one in found] == pytest.approx([3.0, 2.0, 1.0])
    direction = np.array(list(found[0].direction.values()))
    assert abs(direction @ axes[:, 1]) == pytest.approx(1.0)
    assert max(direction, key=abs) > 0
