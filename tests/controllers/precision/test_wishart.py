"""The Wishart learner: conjugacy by numerical integration, moments by scipy, one dimension by the gamma learner, missing data."""

import numpy as np
import pytest
from scipy import stats

from bayesftc import controllers
from bayesftc.controllers import Calibration, GammaPrecision, WishartPrecision
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.cosim.errors import BayesFTCError

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*encountered in:RuntimeWarning"
)  # IEEE 754 arithmetic, as in the engines

NOMINAL = np.array([[1.0, 0.6, -0.2], [0.6, 2.0, 0.5], [-0.2, 0.5, 4.0]])


def model_of(nominal):
    m = len(nominal)
    return controllers.LinearModel([[0.999]], [[2e-4]], np.ones((m, 1)), 0.001, nominal, 0.02)


def learn(precision, nominal, errors, spread=None):
    """Feed innovations to the bare step function, as any controller does. Returns n, V^-1 and R after each sample."""
    learner, m = precision.learner(model_of(nominal)), len(nominal)
    memory, out = learner.memory.copy(), []
    R, used, weight, beta, p = np.zeros((m, m)), *np.zeros((4, m))
    for row in np.asarray(errors, float).reshape(-1, m):
        present = np.isfinite(row).astype(float)
        S = np.zeros((m, m)) if spread is None else spread
        learner.step(
            Sample(row, np.nan_to_num(row), present, S, np.asarray(nominal)),
            Trust(R, used, weight, beta, p),
            memory,
            learner.settings,
            np.zeros((learner.work, m, m)),
        )
        np.testing.assert_allclose(beta, np.diag(memory[1 : 1 + m * m].reshape(m, m)) / 2, rtol=1e-14)
        np.testing.assert_allclose(weight, 1 / np.diag(R), rtol=1e-14)
        out.append((memory[0], memory[1 : 1 + m * m].reshape(m, m).copy(), R.copy()))
    return out


def reported(precision, nominal, errors):
    """Return what the learner reports after these innovations, by name."""
    learner, m = precision.learner(model_of(nominal)), len(nominal)
    memory = learner.memory.copy()
    R, used, weight, beta, p = np.zeros((m, m)), *np.zeros((4, m))
    for e in errors:
        work = np.zeros((learner.work, m, m))
        learner.step(
            Sample(e, e, np.ones(m), R * 0, nominal), Trust(R, used, weight, beta, p), memory, learner.settings, work
        )
    outputs, found, at = np.zeros(sum(port.size for port in learner.ports)), {}, 0
    learner.report(memory, learner.settings, nominal, 0, outputs)
    for port in learner.ports:
        found[port.name] = outputs[at : at + port.size].reshape(port.shape)
        at += port.size
    return found


@pytest.mark.sampled(1)
@pytest.mark.parametrize("estimate", ["mean", "mode"])
@pytest.mark.parametrize("belief", [False, True])
@pytest.mark.parametrize("rho", [0.6, 0.95, None])
def test_in_one_dimension_it_is_the_gamma_learner(rho, belief, estimate):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]], 0.001, 2.5, 0.02)
    rng = np.random.default_rng(6)
    y = 20 + 1.6 * rng.normal(size=600)
    y[100:150] += 12.0
    y[rng.random(600) < 0.1] = np.nan
    y[300:450] = np.nan
    y[500] = 1e7  # beyond the cap
    shared = {
        "forgetting": rho,
        "belief_uncertainty": belief,
        "estimate": estimate,
        "calibration": Calibration(2.0, -3.0),
    }
    learners = GammaPrecision(prior_shape=2.25, **shared), WishartPrecision(degrees_of_freedom=4.5, **shared)
    steps = [
        controllers.BayesianController(model, precision=p, initial_mean=20.0).online(compiled=False) for p in learners
    ]
    for sample in y:
        gamma, wishart = (step(y=[sample], goal=[20.0]) for step in steps)
        for name in ("u", "x_hat", "P", "R", "precision", "beta", "fault_probability"):
            np.testing.assert_allclose(wishart[name], gamma[name], rtol=1e-12, err_msg=name)
        for name in ("mean", "mode", "variance"):
            np.testing.assert_allclose(
                np.ravel(wishart[f"precision_{name}"]), gamma[f"precision_{name}"], rtol=1e-12, err_msg=name
            )
        np.testing.assert_allclose(
            np.ravel(wishart.precision_degrees_of_freedom) / 2, gamma.precision_shape, rtol=1e-12
        )
        np.testing.assert_allclose(1 / (2 * np.ravel(wishart.precision_scale)), gamma.precision_rate, rtol=1e-12)


@pytest.mark.parametrize("forget_to", ["prior", "zero"])
@pytest.mark.parametrize("belief", [False, True])
def test_the_update_rule(forget_to, belief):
    rng, rho, n0, m = np.random.default_rng(1), 0.9, 7.5, 3
    errors, spread = rng.normal(size=(50, m)) * 2, 0.3 + np.diag([0.1, 0.2, 0.3])
    estimate = "mode" if forget_to == "zero" else "mean"
    precision = WishartPrecision(rho, n0, forget_to, belief, estimate)
    n, inverse = n0, n0 * NOMINAL
    for e, (degrees, found, R) in zip(errors, learn(precision, NOMINAL, errors, spread), strict=True):
        T = np.outer(e, e) + belief * spread
        if forget_to == "prior":
            n, inverse = rho * n + (1 - rho) * n0 + 1, rho * inverse + (1 - rho) * n0 * NOMINAL + T
        else:  # Sarkka and Hartikainen
            n, inverse = rho * (n - m - 1) + m + 1 + 1, rho * inverse + T
        assert degrees == pytest.approx(n, rel=1e-13)
        np.testing.assert_allclose(found, inverse, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(R, inverse / (n - (m + 1 if estimate == "mode" else 0)), rtol=1e-9, atol=1e-9)


def test_the_moments_are_scipys():
    errors = np.random.default_rng(2).normal(size=(5, 3))
    found = reported(WishartPrecision(), NOMINAL, errors)
    n, inverse, _ = learn(WishartPrecision(), NOMINAL, errors)[-1]
    distribution = stats.wishart(n, np.linalg.inv(inverse))
    assert found["precision_degrees_of_freedom"] == n
    np.testing.assert_allclose(found["precision_scale"], np.linalg.inv(inverse), rtol=1e-10)
    for name in ("mean", "mode"):
        np.testing.assert_allclose(found[f"precision_{name}"], getattr(distribution, name)(), rtol=1e-10)
    np.testing.assert_allclose(found["precision_variance"], distribution.var(), rtol=1e-10)


def test_it_is_conjugate():
    """Log prior plus log likelihood less log posterior is the same at any precision matrix."""
    rng = np.random.default_rng(3)
    e = np.array([1.0, -2.0, 0.5])
    n, inverse, _ = learn(WishartPrecision(forgetting=None, degrees_of_freedom=6.5), NOMINAL, [e])[-1]
    prior, posterior = stats.wishart(6.5, np.linalg.inv(6.5 * NOMINAL)), stats.wishart(n, np.linalg.inv(inverse))
    evidence = []
    for precision in prior.rvs(200, random_state=rng):
        likelihood = stats.multivariate_normal(np.zeros(3), np.linalg.inv(precision)).logpdf(e)
        evidence.append(prior.logpdf(precision) + likelihood - posterior.logpdf(precision))
    np.testing.assert_allclose(evidence, evidence[0], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_its_moments_are_those_of_prior_times_likelihood_by_numerical_integration():
    """Two dimensions: all positive definite matrices L L' with a lower triangular L, by Gauss and Legendre's rule."""
    nominal, n0, e = NOMINAL[:2, :2], 6.0, np.array([1.5, -1.0])
    found = reported(WishartPrecision(forgetting=None, degrees_of_freedom=n0), nominal, [e])
    x, weight = np.polynomial.legendre.leggauss(44)
    a, c, b = np.meshgrid(2.25 * (x + 1), 2.25 * (x + 1), 4.5 * x, indexing="ij")
    volume = np.einsum("i,j,k->ijk", weight, weight, weight) * 4 * a**2 * c
    matrices = np.array([[a * a, a * b], [a * b, b * b + c * c]]).reshape(2, 2, -1)
    V = np.linalg.inv(n0 * nominal)
    squared = np.einsum("i,ijn,j->n", e, matrices, e)
    likelihood = a.ravel() * c.ravel() * np.exp(-squared / 2)  # |precision|^(1/2), up to a constant
    density = stats.wishart(n0, V).pdf(matrices) * likelihood * volume.ravel()
    total = density.sum()
    mean = (matrices * density).sum(axis=-1) / total
    variance = (matrices**2 * density).sum(axis=-1) / total - mean**2
    np.testing.assert_allclose(found["precision_mean"], mean, rtol=1e-5)
    np.testing.assert_allclose(found["precision_variance"], variance, rtol=1e-4)


def test_missing_sensors_are_regressed_on_the_present_ones():
    rho, n0, seen, lost = 0.9, 6.0, [0, 2], [1]
    errors = np.random.default_rng(5).normal(size=(20, 3))
    before = learn(WishartPrecision(rho, n0), NOMINAL, errors)[-1]
    e = np.array([1.2, np.nan, -3.0])
    n, inverse, R = learn(WishartPrecision(rho, n0), NOMINAL, [*errors, e])[-1]
    decayed_n = rho * before[0] + (1 - rho) * n0
    decayed = rho * before[1] + (1 - rho) * n0 * NOMINAL
    expected = decayed / decayed_n
    # The present sensors learn what they would have learned without the other one.
    alone = decayed[np.ix_(seen, seen)] + np.outer(e[seen], e[seen])
    np.testing.assert_allclose(inverse[np.ix_(seen, seen)], alone, rtol=1e-10)
    assert n == pytest.approx(decayed_n + 1)

    def given_the_present(S):
        G = S[np.ix_(lost, seen)] @ np.linalg.inv(S[np.ix_(seen, seen)])
        return G, S[np.ix_(lost, lost)] - G @ S[np.ix_(seen, lost)]

    # What the lost one is, given them, stays.
    for after, earlier in zip(given_the_present(R), given_the_present(expected), strict=True):
        np.testing.assert_allclose(after, earlier, rtol=1e-9)


def test_without_any_sample_it_forgets_or_waits():
    errors = [[3.0, -2.0, 1.0]] * 5 + [[np.nan] * 3] * 400
    n, _, R = learn(WishartPrecision(0.9), NOMINAL, errors)[-1]
    assert n == pytest.approx(6.0)
    np.testing.assert_allclose(R, NOMINAL, rtol=1e-9)
    waiting = learn(WishartPrecision(0.9, forget_to="zero", estimate="mode"), NOMINAL, errors)
    assert waiting[-1][0] == waiting[4][0]
    np.testing.assert_allclose(waiting[-1][1], waiting[4][1], rtol=1e-9)


@pytest.mark.slow
def test_correlated_noise_is_learned_and_the_models_correlation_is_used():
    nominal, truth = np.diag([1.0, 1.0]), np.array([[2.0, 1.5], [1.5, 3.0]])
    errors = np.random.default_rng(8).multivariate_normal([0, 0], truth, size=4000)
    R = learn(WishartPrecision(forgetting=0.999), nominal, errors)[-1][2]
    np.testing.assert_allclose(R, truth, atol=0.25)
    R = learn(WishartPrecision(), NOMINAL, [[np.nan] * 3])[-1][2]
    np.testing.assert_allclose(R, NOMINAL, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("forget_to", ["prior", "zero"])
@pytest.mark.parametrize("rho", [0.5, 0.95, 1.0])
def test_it_stays_positive_definite_in_the_worst_directions(rho, forget_to):
    """Errors of 1e300 and equal ones for thousands of steps, with sensors missing in between; three sensors."""
    rng = np.random.default_rng(9)
    errors = np.repeat(rng.normal(size=(3000, 1)), 3, axis=1)
    errors[200:260] = [1e300, 1e300, -1e300]
    errors[500:2000] = 0.0
    errors[2500, 0] = 1e9
    errors[rng.random(errors.shape) < 0.1] = np.nan
    precision = WishartPrecision(rho, forget_to=forget_to, belief_uncertainty=True)
    for n, inverse, R in learn(precision, NOMINAL, errors, np.ones((3, 3))):
        assert n > 2
        np.linalg.cholesky(R)
        np.linalg.cholesky(inverse)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"forgetting": 0.0}, "above 0 and at most 1"),
        ({"forgetting": 1.01}, "above 0 and at most 1"),
        ({"degrees_of_freedom": 2.0}, "For 3 sensors and the mean .* above 2"),
        ({"degrees_of_freedom": 4.0, "estimate": "mode"}, "For 3 sensors and the mode .* above 4"),
        ({"estimate": "median"}, "'mean' or 'mode'"),
        ({"forget_to": "one"}, "'prior' or 'zero'"),
    ],
)
def test_bad_settings(options, words):
    with pytest.raises(BayesFTCError, match=words):
        controllers.BayesianController(model_of(NOMINAL), precision=WishartPrecision(**options))


def test_the_probability_is_a_map_of_beta():
    model = model_of(NOMINAL)
    precision = WishartPrecision(calibration=Calibration(1.5, -2.0))
    step = controllers.BayesianController(model, precision=precision, initial_mean=20.0).online(compiled=True)
    for _ in range(20):
        out = step(y=[28.0, 20.0, np.nan], goal=[20.0])
    ratio = out.beta / (0.5 * 6.0 * np.diag(NOMINAL))
    expected = 1 / (1 + np.exp(-(1.5 * np.log(ratio) - 2.0)))
    np.testing.assert_allclose(out.fault_probability, [*expected[:2], np.nan], rtol=1e-12)
    assert precision.why_no_probability is None
    assert "calibration" in str(WishartPrecision().why_no_probability)
