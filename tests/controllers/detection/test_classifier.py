"""The fault classifier: scikit-learn's own checks, and the same probabilities live in the loop."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.ensemble import GradientBoostingClassifier, RandomForestClassifier
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, MinMaxScaler, StandardScaler
from sklearn.svm import LinearSVC
from sklearn.utils.estimator_checks import parametrize_with_checks

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import FaultClassifier, GammaPrecision, UntrainedClassifierError, residual_features
from bayesftc.cosim.errors import BayesFTCError, ConnectionError, ModelError, UnknownNameError
from bayesftc.cosim.judging.metrics import auc

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)
KINDS = (cosim.Freeze(), cosim.Injection(magnitude=4.0), cosim.Drift(slope=6.0), cosim.Dropout())
BOTH = ("beta", "innovation")


def forest():
    return RandomForestClassifier(n_estimators=5, max_depth=4, random_state=0)


def log_logistic():
    return make_pipeline(FunctionTransformer(np.log), StandardScaler(), LogisticRegression())


@parametrize_with_checks([FaultClassifier(), FaultClassifier(forest())])
def test_scikit_learns_own_checks(estimator, check):
    check(estimator)


@pytest.mark.slow
@parametrize_with_checks(
    [
        FaultClassifier(make_pipeline(StandardScaler(), LogisticRegression())),
        FaultClassifier(GradientBoostingClassifier(n_estimators=5, random_state=0)),
    ]
)
def test_scikit_learns_own_checks_of_others(estimator, check):
    check(estimator)


def car_loop(**options):
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(MODEL, precision=GammaPrecision(forgetting=0.8), initial_mean=20.0),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=0.001**0.5)},
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.RandomFaults(kinds=KINDS, sensor=i, name=f"fault_{i}") for i in range(2)],
        reference=cosim.Sine(amplitude=20.0, period=2.0, offset=20.0),
        **options,
    )


def rows(result, features):
    """Features and labels of all sensors, with NaN rows where a sample is missing."""
    labels = np.column_stack([result["fault_0.active"], result["fault_1.active"]]) > 0.5
    return residual_features(result, features).reshape(-1, len(features)), labels.ravel()


@pytest.fixture(scope="module")
def training():
    return car_loop().simulate(200.0, seed=1)


def trained(training, features, estimator=None, threshold=0.5):
    X, y = rows(training, features)
    known = np.isfinite(X).all(axis=1)
    assert 0 < known.mean() < 1
    return FaultClassifier(estimator, threshold).fit(X[known], y[known])


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("features", "make", "compiled"),
    [
        (("beta",), lambda: None, True),
        (("innovation",), lambda: None, True),
        (BOTH, lambda: None, True),
        (BOTH, lambda: make_pipeline(StandardScaler(), StandardScaler(with_mean=False), LogisticRegression()), True),
        (BOTH, log_logistic, True),
        ((*BOTH, "precision_variance"), lambda: make_pipeline("passthrough", LogisticRegression()), True),
        (BOTH, lambda: make_pipeline(MinMaxScaler(), LogisticRegression()), False),
        (BOTH, lambda: make_pipeline(StandardScaler(), FunctionTransformer(np.tanh), LogisticRegression()), False),
        (("beta",), forest, False),
        (BOTH, forest, False),
    ],
)
def test_the_live_probability_is_scikit_learns(training, features, make, compiled, run_both):
    classifier = trained(training, features, make(), threshold=0.3)
    loop = car_loop(monitors={"detector": classifier.block(2, features)})
    assert loop.schedule.compiled is compiled
    result = run_both(loop, 10.0, seed=5) if compiled else loop.simulate(10.0, seed=5)
    X, _ = rows(result, features)
    known = np.isfinite(X).all(axis=1)
    assert 0 < known.sum() < known.size
    p, fault = (result[f"detector.{name}"].ravel() for name in ("fault_probability", "fault"))
    np.testing.assert_allclose(p[known], classifier.predict_proba(X[known])[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fault[known], classifier.predict(X[known]))
    assert np.isnan(p[~known]).all()
    assert np.isnan(fault[~known]).all()
    assert 0 < fault[known].mean() < 1


def test_monitors_leave_the_loop_as_it_was(training, same_bits):
    classifier = trained(training, ("beta",))
    with_it = car_loop(monitors={"detector": classifier.block(2)}).simulate(5.0, seed=4)
    without = car_loop().simulate(5.0, seed=4)
    for name in without:
        same_bits(with_it[name], without[name], name)


def test_it_knows_more_than_chance_on_another_run(training):
    classifier = trained(training, ("beta",), log_logistic())
    X, y = rows(car_loop().simulate(200.0, seed=2), ("beta",))
    known = np.isfinite(X).all(axis=1)
    p = classifier.predict_proba(X[known])[:, 1]
    assert auc(y[known], p) > 0.8
    assert p.mean() == pytest.approx(y[known].mean(), abs=0.03)
    assert classifier.score(X[known], y[known]) > 1 - y[known].mean()


def test_the_decision_threshold_is_used_by_predict_and_score():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(500, 1)), rng.random(500) < 0.3
    p = FaultClassifier().fit(X, y).predict_proba(X)[:, 1]
    for threshold in (0.2, 0.3, 0.6):
        classifier = FaultClassifier(threshold=threshold).fit(X, y)
        np.testing.assert_array_equal(classifier.predict(X), p > threshold)
        assert classifier.score(X, y) == np.mean((p > threshold) == y)


def test_the_default_does_not_depend_on_units():
    rng = np.random.default_rng(0)
    X = np.abs(rng.normal(size=(1000, 1)))
    y = rng.random(1000) < X[:, 0] / 4
    p = [FaultClassifier().fit(s * X, y).predict_proba(s * X)[:, 1] for s in (1.0, 1e-3)]
    np.testing.assert_allclose(p[0], p[1], atol=1e-3)


def test_it_is_searched_cloned_and_pickled(training):
    X, y = rows(training, ("beta",))
    known = np.isfinite(X).all(axis=1)
    search = GridSearchCV(FaultClassifier(log_logistic()), {"estimator__logisticregression__C": [0.1, 10.0]}, cv=3)
    best = search.fit(X[known], y[known]).best_estimator_
    again = pickle.loads(pickle.dumps(best))
    np.testing.assert_array_equal(again.predict_proba(X[known]), best.predict_proba(X[known]))
    assert not hasattr(clone(best), "estimator_")
    block = pickle.loads(pickle.dumps(again.block(2)))
    assert block.online(0.02)(beta=[2.0, 9.0]).fault_probability == pytest.approx(
        best.predict_proba([[2.0], [9.0]])[:, 1], abs=1e-12
    )


def test_one_feature_may_be_named_without_a_list(training):
    classifier = trained(training, ("beta",))
    assert classifier.block(2, "beta").features == ("beta",)
    np.testing.assert_array_equal(residual_features(training, "beta"), residual_features(training, ("beta",)))


def test_a_block_keeps_what_was_learned_before(training):
    for estimator in (None, forest()):
        classifier = trained(training, ("beta",), estimator)
        block, before = classifier.block(1), classifier.predict_proba([[3.0]])[0, 1]
        X, y = rows(training, ("beta",))
        known = np.isfinite(X).all(axis=1)
        classifier.fit(X[known], ~y[known])
        assert block.online(0.02)(beta=[3.0]).fault_probability[0] == pytest.approx(before, abs=1e-12)


def test_a_missing_sample_is_seen_by_the_innovation_although_beta_is_a_number(training):
    for estimator in (None, forest()):
        step = trained(training, ("beta",), estimator).block(2).online(0.02)
        out = step(beta=[2.0, 2.0], innovation=[float("nan"), 0.3])
        assert np.isnan(out.fault_probability).tolist() == [True, False]
        assert np.isnan(out.fault).tolist() == [True, False]
        assert np.isfinite(step(beta=[2.0, 2.0]).fault_probability).all()


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("make", [lambda: None, log_logistic])
def test_inside_the_controller_as_a_calibration(training, make, relative):
    """Trained on beta or on beta / b0: the controller's own output is then the classifier's probability."""
    from dataclasses import replace

    X, y = rows(training, ("beta",))
    known = np.isfinite(X).all(axis=1)
    b0 = 2.0
    classifier = FaultClassifier(make()).fit(X[known] / (b0 if relative else 1.0), y[known])
    calibration = classifier.calibration() if relative else classifier.calibration(prior_rate=b0)
    assert calibration.feature == ("linear" if make() is None else "log")
    controller = controllers.BayesianController(
        MODEL, precision=replace(GammaPrecision(forgetting=0.8), calibration=calibration), initial_mean=20.0
    )
    step, rng = controller.online(compiled=False), np.random.default_rng(1)
    for _ in range(50):
        out = step(y=20.0 + 3 * rng.normal(size=2), goal=[20.0])
        expected = classifier.predict_proba(out.beta[:, None] / (b0 if relative else 1.0))[:, 1]
        np.testing.assert_allclose(out.fault_probability, expected, rtol=0, atol=1e-12)


X, Y = [[0.1], [0.9], [2.0], [0.4]], [0, 1, 1, 0]


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: FaultClassifier().fit(X, [1, 1, 1, 1]), ModelError, "All 4 labels are of one class, 1; give"),
        (lambda: FaultClassifier().fit(X, ["no"] * 4), ModelError, "All 4 labels are of one class, 'no'; give"),
        (lambda: FaultClassifier().fit(X, [0, 1, 2, 1]), ModelError, "healthy and faulty"),
        (lambda: FaultClassifier().fit([[0.1], [np.nan], [2.0], [0.4]], Y), ModelError, "the first at index 1; leave"),
        (lambda: FaultClassifier().fit(X, Y).predict([[np.inf]]), ModelError, "NaN or inf"),
        (lambda: FaultClassifier(threshold=1.0).fit(X, Y), ModelError, "above 0 and below 1"),
        (lambda: FaultClassifier(threshold="0.5").fit(X, Y), ModelError, "threshold='0.5'; it must be a finite number"),
        (lambda: FaultClassifier().fit(X, Y).calibration("1"), ModelError, "prior_rate='1'; it must be"),
        (lambda: FaultClassifier().fit(X, Y).block(2, None), ModelError, "has no names of residuals"),
        (lambda: FaultClassifier().fit(X, Y).block("2"), ModelError, "sensors='2'; it must be a whole number"),
        (lambda: FaultClassifier(LinearSVC()).fit(X, Y), ModelError, "has no predict_proba"),
        (lambda: FaultClassifier().predict(X), UntrainedClassifierError, "has not been trained; call fit"),
        (lambda: FaultClassifier().block(2), UntrainedClassifierError, "has not been trained; call fit"),
        (lambda: FaultClassifier().calibration(), NotFittedError, "has not been trained; call fit"),
        (lambda: FaultClassifier().fit(X, Y).block(2, BOTH), ModelError, "was trained on 1 residuals"),
        (lambda: FaultClassifier().fit(X, Y).block(0), ModelError, "at least 1"),
        (lambda: FaultClassifier(forest()).fit(X, Y).calibration(), ModelError, "Only a logistic regression"),
        (lambda: FaultClassifier().fit(np.repeat(X, 2, 1), Y).block(2, ("beta", "beta")), ModelError, "each once"),
        (lambda: car_loop(monitors={"d": FaultClassifier().fit(X, Y)}), ModelError, r"call the method block\(\)"),
        (lambda: car_loop(monitors={"d": FaultClassifier().fit(X, Y).block(3)}), ConnectionError, "sizes differ"),
        (
            lambda: car_loop(monitors={"d": FaultClassifier().fit(X, Y).block(2, ["betta"])}),
            UnknownNameError,
            "did you mean 'beta'",
        ),
    ],
)
def test_one_clear_sentence(make, error, words):
    with pytest.raises(error, match=words) as caught:
        make()
    assert isinstance(caught.value, BayesFTCError)


def test_any_block_can_watch_the_controller_at_its_own_rate(make_block, run_both):
    """Outputs by name, what feeds its y and goal, a start value where there is nothing; at the controller's rate."""

    def watch(y, goal, u, spare, seen):
        seen[0] = y[0] + 10.0 * goal[0] + 100.0 * u[0] + spare[0]

    ports = [cosim.Port("y", (2,)), cosim.Port("goal", (1,)), cosim.Port("u", (1,)), cosim.Port("spare", default=0.5)]
    watcher = make_block(inputs=ports, outputs=[cosim.Port("seen")], output=watch, sample_time=MODEL.step)
    result = run_both(car_loop(monitors={"watcher": watcher}, dt=0.01), 1.0, seed=3)
    y = result["fault_1.y"][:, 0]
    expected = y + 10 * result["reference.y"] + 100 * result["controller.u"][:, 0] + 0.5
    np.testing.assert_allclose(result["watcher.seen"][::2], expected[::2], rtol=1e-12)
    np.testing.assert_array_equal(result["watcher.seen"][1::2], result["watcher.seen"][:-1:2])
