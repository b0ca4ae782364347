"""The Chebyshev threshold: its moments and distances against SciPy, its promise by Monte Carlo, what it refuses."""

import pickle

import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis

from bayesftc.controllers import ChebyshevThreshold, FittedThreshold
from bayesftc.cosim.errors import ModelError

NOISE = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "student_t3": lambda rng, shape: rng.standard_t(3, size=shape),
    "laplace": lambda rng, shape: rng.laplace(size=shape),
}


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("alpha", [0.2, 0.05, 0.01])
def test_false_alarms_are_rarer_than_alpha(noise, n, alpha):
    rng = np.random.default_rng(17)
    mixing, offset = np.tril(rng.normal(size=(n, n))) + 2 * np.eye(n), rng.normal(size=n)
    rates = []
    for _ in range(20):
        fitted = ChebyshevThreshold(alpha).fit(NOISE[noise](rng, (3000, n)) @ mixing.T + offset)
        new = NOISE[noise](rng, (20_000, n)) @ mixing.T + offset
        rates.append(fitted.exceeds(new).mean())
    assert np.mean(rates) < alpha
    if alpha == 0.2:  # the bound is loose, but it is no threshold that nothing ever reaches
        assert np.mean(rates) > 0.0


def test_the_bound_is_tight_for_the_distribution_that_attains_it():
    """Chebyshev's own worst case: alpha / 2 at each of +-1 / sqrt(alpha), the rest at zero."""
    alpha = 0.1
    rng = np.random.default_rng(3)
    values = rng.choice([-1.0, 0.0, 1.0], size=400_000, p=[alpha / 2, 1 - alpha, alpha / 2]) / np.sqrt(alpha)
    fitted = ChebyshevThreshold(alpha).fit(values)
    assert (fitted.distance(values) > 0.98 * fitted.bound).mean() == pytest.approx(alpha, rel=0.02)


def test_moments_and_distance():
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(500, 3)) @ rng.normal(size=(3, 3)) + [1.0, -2.0, 30.0]
    fitted = ChebyshevThreshold(0.05).fit(samples)
    np.testing.assert_allclose(fitted.mean, samples.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(fitted.covariance, np.cov(samples.T), rtol=1e-12)
    inverse = np.linalg.inv(np.cov(samples.T))
    new = rng.normal(size=(4, 5, 3)) * 10
    expected = [[mahalanobis(r, samples.mean(axis=0), inverse) for r in row] for row in new]
    np.testing.assert_allclose(fitted.distance(new), expected, rtol=1e-9)
    np.testing.assert_array_equal(fitted.exceeds(new), np.array(expected) >= fitted.bound)
    assert pickle.loads(pickle.dumps(fitted)) == fitted
    assert len({fitted, fitted}) == 1


def test_both_forms():
    samples = np.random.default_rng(1).normal(size=(5000, 2))
    assert ChebyshevThreshold(0.01).fit(samples).bound == pytest.approx(np.sqrt(2 / 0.01))
    assert ChebyshevThreshold(0.01, form="printed").fit(samples).bound == pytest.approx(2 / 0.01)


def test_one_residual_may_be_given_without_its_axis():
    fitted = FittedThreshold(2.0, 9.0, 4.0)
    assert fitted.distance(8.0) == 2.0
    np.testing.assert_array_equal(fitted.distance([8.0, -1.0, np.nan]), [2.0, 1.0, np.nan])
    np.testing.assert_array_equal(fitted.distance([[8.0], [-1.0]]), [2.0, 1.0])
    np.testing.assert_array_equal(fitted.distance([[8.0, 2.0], [-1.0, 2.0]]), [[2.0, 0.0], [1.0, 0.0]])
    np.testing.assert_array_equal(fitted.exceeds([14.0, 13.9, np.nan]), [True, False, False])


def frozen(samples):
    samples[300:320, 1] = samples[300, 1]
    return samples


def jumped(samples):
    samples[400:440, 0] += 60.0
    return samples


def healthy(shape=(1000, 2)):
    return np.random.default_rng(5).normal(size=shape)


@pytest.mark.parametrize(
    ("samples", "faulty", "words"),
    [
        (healthy((100, 1)), None, "needs at least 101 healthy samples, but there are 100"),
        (healthy((200, 2)), None, "needs at least 201 healthy samples"),
        (np.where(np.arange(2000).reshape(1000, 2) == 801, np.nan, healthy()), None, "the first at index 400"),
        (np.where(np.arange(2000).reshape(1000, 2) == 801, np.inf, healthy()), None, "NaN or infinite"),
        (healthy() @ [[1.0, 2.0], [0.0, 0.0]], None, "singular"),
        (np.full(1000, 3.0), None, "singular"),
        (frozen(healthy()), None, "Residual 1 has the same value 20 times in a row from sample 300 on"),
        (jumped(healthy()), None, "40 of 1000 samples of residual 0, from sample 400 on"),
        (healthy(), np.arange(1000) == 7, "1 of the 1000 samples are labelled faulty"),
        (healthy(), [False], "one label for each of 1000 samples"),
        (healthy((10, 10, 10)), None, "a row for each sample"),
    ],
)
def test_what_cannot_be_learned_from(samples, faulty, words):
    with pytest.raises(ModelError, match=words):
        ChebyshevThreshold(0.01).fit(samples, faulty)


@pytest.mark.parametrize("alpha", [0.2, 0.05, 0.01])
def test_healthy_samples_of_many_kinds_are_accepted(alpha):
    """Heavy tails, skew, quantised values, one bit, chance repeats: none of them is a fault."""
    rng = np.random.default_rng(8)
    kinds = [draw(rng, 2000) for draw in NOISE.values()]
    kinds += [rng.exponential(size=2000), rng.lognormal(size=2000), rng.normal(size=2000) ** 2]
    kinds += [np.round(rng.normal(size=2000)), rng.integers(0, 2, size=2000), np.repeat(rng.normal(size=1000), 2)]
    for samples in kinds:
        assert ChebyshevThreshold(alpha).fit(samples, faulty=np.zeros(2000, bool)).size == 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ChebyshevThreshold(0.0), "between 0 and 1"),
        (lambda: ChebyshevThreshold(1.0), "between 0 and 1"),
        (lambda: ChebyshevThreshold(form="loose"), "'robust' or 'printed'"),
        (lambda: FittedThreshold([0.0], [[-1.0]], 3.0), "covariance is not positive definite"),
        (lambda: FittedThreshold([0.0], [[1.0]], 0.0), "must be positive"),
        (lambda: FittedThreshold([0.0, 0.0], 1.0, 3.0).distance([1.0, 2.0, 3.0]), "learned for 2 elements"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()
