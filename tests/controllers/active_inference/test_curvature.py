"""How far a step of the descent on the free energy may go: bounds on the curvature, against eigenvalues."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import linalg

from bayesftc.controllers.active_inference import curvature as _curvature, descent as _descent


def random_covariance(rng, n, scale):
    M = rng.normal(size=(n, n))
    return scale * (M @ M.T + n * np.eye(n)) / (2 * n)


def random_curvature(seed):
    """Matrices of the free energy of every size and scale, and the rates of the descent along it."""
    rng = np.random.default_rng(seed)
    m, n, p = rng.integers(1, 6, 3)
    G, P = rng.normal(size=(m, n)) * np.exp(rng.normal(size=n)), random_covariance(rng, m, np.exp(3 * rng.normal()))
    D, Pu = rng.normal(size=(p, n)) * np.exp(rng.normal(size=n)), random_covariance(rng, p, np.exp(rng.normal()))
    Px = random_covariance(rng, n, np.exp(rng.normal()))
    return G, P, Px, D, Pu, np.exp(2 * rng.normal(size=n + p))


@given(seed=st.integers(0, 2**32 - 1), squarings=st.integers(0, 6))
@settings(max_examples=200, deadline=None)
def test_a_shortened_step_is_stable(seed, squarings):
    G, P, Px, D, Pu, rates = random_curvature(seed)
    n, p = G.shape[1], len(Pu)
    curvature, scratch = np.full((n + p, n + p), np.nan), [np.empty((n + p, n + p)) for _ in range(2)]
    _curvature.curvature_of_belief(G, P, Px, np.empty_like(G), curvature)
    _curvature.curvature_of_control(D, Pu, np.empty_like(D), curvature)
    errors = np.block([[G, np.zeros((len(G), p))], [np.eye(n), np.zeros((n, p))], [-D, np.eye(p)]])  # by (mu, mu_u)
    np.testing.assert_allclose(curvature, errors.T @ linalg.block_diag(P, Px, Pu) @ errors, rtol=1e-9, atol=1e-12)
    spectral = linalg.eigvals(rates[:, np.newaxis] * curvature).real.max()
    bound = _curvature.bound_on_eigenvalues(curvature, np.sqrt(rates), squarings, *scratch)
    assert spectral * (1 - 1e-9) <= bound <= spectral * (n + p) ** (0.5 / 2**squarings) * (1 + 1e-9)
    fraction = _curvature.shortening(curvature, np.sqrt(rates), np.array([1.9]), squarings, *scratch)
    assert fraction == (1.0 if bound <= 1.9 else pytest.approx(1 / bound, rel=1e-12))
    step = np.eye(n + p) - fraction * rates[:, np.newaxis] * curvature
    assert np.abs(linalg.eigvals(step)).max() <= 1 + 1e-9


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_the_largest_step_is_just_what_a_nominal_setting_needs(seed):
    G, P, Px, *_, rates = random_curvature(seed)
    n = G.shape[1]
    curvature, rates = G.T @ P @ G + Px, rates[:n]
    rates = rates * 1.99 / linalg.eigvals(rates[:, np.newaxis] * curvature).real.max()
    largest, squarings = _curvature.largest_step(curvature, rates)
    bound = _curvature.bound_on_eigenvalues(curvature, np.sqrt(rates), squarings, *np.empty((2, n, n)))
    assert bound <= largest < 2.0  # so that any step within the limit is stable


def test_the_bound_holds_for_a_prior_that_turns():
    """The Kalman prediction's part is not symmetric; magnitudes bound complex eigenvalues as well."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        M = rng.normal(size=(4, 4))
        spectral = np.abs(linalg.eigvals(M)).max()
        bounds = [
            _curvature.bound_on_eigenvalues(M, np.ones(4), squarings, *np.empty((2, 4, 4))) for squarings in range(8)
        ]
        assert min(bounds) >= spectral * (1 - 1e-9)
        assert bounds[-1] <= 1.2 * spectral


def test_a_curvature_that_is_no_number_moves_nothing():
    curvature = np.array([[1.0, np.inf], [np.inf, 1.0]])
    for squarings in (0, 3):
        with np.errstate(all="ignore"):
            fraction = _curvature.shortening(curvature, np.ones(2), np.array([1.9]), squarings, *np.empty((2, 2, 2)))
        mean = np.array([0.3, 0.4])
        _descent.descend(fraction, np.ones(2), np.array([0.1, 0.1]), mean)
        assert mean.tolist() == [0.3, 0.4]
