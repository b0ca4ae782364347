"""The Chebyshev threshold: its moments and distances against SciPy, its promise by Monte Carlo, what it refuses."""

import pickle

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.distance import mahalanobis

from bayesftc import cosim
from bayesftc.controllers import ChebyshevThreshold, FittedThreshold, FixedPrecision
from bayesftc.cosim.errors import ModelError
from bayesftc.examples.cruise_control.cruise_control import cruise_control

NOISE = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "student_t3": lambda rng, shape: rng.standard_t(3, size=shape),
    "laplace": lambda rng, shape: rng.laplace(size=shape),
}


@pytest.mark.sampled(2)
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
        (np.where(np.arange(2000).reshape(1000, 2) == 801, np.inf, healthy()), None, "NaN or inf"),
        (healthy() @ [[1.0, 2.0], [0.0, 0.0]], None, "singular"),
        (np.full(1000, 3.0), None, "singular"),
        (frozen(healthy()), None, "Number 1 has the same value 20 times in a row from sample 300 on"),
        (jumped(healthy()), None, "Number 0 has 40 of 1000 samples, from sample 400 on"),
        (healthy(), np.arange(1000) == 7, "1 of the 1000 samples are labelled faulty"),
        (healthy(), [False], "one label for each of the 1000 samples"),
        (healthy((10, 10, 10)), None, "a row for each sample"),
        (["a", "b"], None, "they must be numbers, a row for each sample"),
    ],
)
def test_what_cannot_be_learned_from(samples, faulty, words):
    with pytest.raises(ModelError, match=words):
        ChebyshevThreshold(0.01).fit(samples, faulty)


KINDS = (
    cosim.Freeze(),
    cosim.Injection(magnitude=5.0),
    cosim.Injection(magnitude=20.0),
    cosim.Drift(slope=5.0),
    cosim.NoiseIncrease(std=10.0),
)


def car(reference, share=0.0, kind=0):
    """Innovations of the shipped car's two sensors over 2000 steps; one structure, so compiled once for all tests."""
    start, length = (12.0, 40.0 * share) if share else (1e6, 1.0)
    weights = [float(i == kind) for i in range(len(KINDS))]
    always = {"mean_time_to_fault": None, "mean_time_to_recovery": None, "start": start, "stop": start + length}
    fault = cosim.RandomFaults(kinds=KINDS, weights=weights, **always)
    return cruise_control(FixedPrecision(), fault=fault, reference=reference)


REFERENCES = [
    cosim.Sine(amplitude=0.0, period=8.0, offset=20.0),
    cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
    cosim.Sine(amplitude=20.0, period=2.0, offset=20.0),
]


def innovations(loop, seed):
    return loop.simulate(39.98, seed=seed, record=["controller.innovation"])["controller.innovation"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("alpha", [0.2, 0.01])
@pytest.mark.parametrize("reference", REFERENCES, ids=["constant", "slow", "fast"])
def test_faults_in_a_loop_are_refused_at_any_alpha_and_healthy_runs_are_not(reference, alpha):
    for seed in range(3):
        both = innovations(car(reference), seed)
        ChebyshevThreshold(alpha).fit(both)
        for kind in range(len(KINDS)):
            for share in (0.15, 0.4, 0.6):
                faulty = innovations(car(reference, share, kind), seed)
                for residuals in (faulty, faulty[:, 0]):
                    with pytest.raises(ModelError, match=r"is not uniform in time|robust standard|in a row"):
                        ChebyshevThreshold(alpha).fit(residuals)


def coloured(rng, count, decay, square=False):
    noise = rng.normal(size=count + 1000) ** (2 if square else 1)
    return lfilter([1.0], [1.0, -decay], noise)[1000:]


@pytest.mark.slow
def test_coloured_residuals_are_no_fault():
    """Correlated noise, rates that forget, and a lag that swings with the reference."""
    rng = np.random.default_rng(6)
    for count in (400, 1000, 3000):
        for decay in (0.3, 0.7, 0.9):
            for square in (False, True):
                for _ in range(20):
                    ChebyshevThreshold(0.1).fit(coloured(rng, count, decay, square))
    swing = np.sin(2 * np.pi * np.arange(3000) / 400)
    for amplitude in (0.5, 1.0, 3.0, 10.0):
        for _ in range(10):
            ChebyshevThreshold(0.1).fit(rng.normal(size=3000) + amplitude * swing)


def test_a_fault_that_lasts_for_the_whole_record_is_not_seen():
    """What nothing in the record can show."""
    assert ChebyshevThreshold(0.05).fit(healthy((1000, 1)) + 50.0).mean == pytest.approx([50.0], abs=0.1)


@pytest.mark.parametrize("alpha", [0.2, 0.05, 0.01])
def test_healthy_samples_of_many_kinds_are_accepted(alpha):
    """Heavy tails, skew, quantised values, one bit, chance repeats: none of them is a fault."""
    rng = np.random.default_rng(8)
    kinds = [draw(rng, 2000) for draw in NOISE.values()]
    kinds += [rng.exponential(size=2000), rng.lognormal(size=2000), rng.normal(size=2000) ** 2]
    kinds += [np.round(rng.normal(size=2000)), rng.integers(0, 2, size=2000), np.repeat(rng.normal(size=1000), 2)]
    for samples in kinds:
        assert ChebyshevThreshold(alpha).fit(samples, faulty=np.zeros(2000, bool)).size == 1
    for _ in range(50):  # few samples on few levels: their quartiles fall between two
        assert ChebyshevThreshold(alpha).fit(np.round(rng.normal(size=120))).size == 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ChebyshevThreshold(0.0), "above 0 and below 1"),
        (lambda: ChebyshevThreshold(1.0), "above 0 and below 1"),
        (lambda: ChebyshevThreshold("0.1"), "above 0 and below 1"),
        (lambda: ChebyshevThreshold(form="loose"), "'robust' or 'printed'"),
        (lambda: FittedThreshold([0.0], [[-1.0]], 3.0), "covariance is not positive definite"),
        (lambda: FittedThreshold([0.0], [[1.0]], 0.0), "must be a number above 0"),
        (lambda: FittedThreshold("a", [[1.0]], 1.0), "mean is 'a'; it must be"),
        (lambda: FittedThreshold([0.0, 0.0], 1.0, 3.0).distance([1.0, 2.0, 3.0]), "is for 2 elements"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()
