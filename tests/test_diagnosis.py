"""Wrong models are noticed: the online check, the diagnosis of a run, and the comparison of step responses before it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers._consistency import MEAN_LIMIT, PRODUCT_LIMIT, WINDOW
from bayesftc.controllers._explanations import delayed, faster
from bayesftc.controllers._observers import observers
from bayesftc.reproduce.wrong_models import LEARNERS, Case, cases, loop, parts, run

WORDS = {
    "sign": "sign of B",
    "dt": "Is dt right?",
    "heavier": "mass",
    "lighter": "mass",
    "far": "far from where the model was linearised",
    "limit": "limit that the controller does not know",
    "late": "arrives late",
}
"""What the sentence must say of each way of being wrong."""


def told(case, learner, seed):
    """Return the finding of a run, and whether `model_suspect` was raised in it."""
    controller = parts(case, LEARNERS[learner])[1]
    (result,) = run(case, LEARNERS[learner], [seed])
    return controllers.diagnose(result, controller), result["controller.model_suspect"].max() >= 0.5


@pytest.mark.parametrize("wrong", WORDS)
def test_a_wrong_model_of_the_car_is_named(wrong):
    case = next(c for c in cases() if c.name == f"car: {wrong}")
    finding, _ = told(case, "gamma", 3)
    assert finding.kind in case.named
    assert WORDS[wrong] in finding.sentence
    assert finding.evidence > 10


@pytest.mark.parametrize("case", [c for c in cases() if c.plant == "car" and not c.named], ids=lambda c: c.name)
def test_a_right_model_is_not_blamed_whatever_one_sensor_does(case):
    finding, suspect = told(case, "fixed", 3)
    assert finding is None
    assert not suspect


def test_numbers_of_findings_are_those_of_the_plant():
    def values(wrong):
        return told(next(c for c in cases() if c.name == f"car: {wrong}"), "gamma", 4)[0].values

    assert values("sign")[0] == pytest.approx(-1.0, abs=0.02)
    assert values("dt")[0] == pytest.approx(2.5, rel=0.1)
    assert values("heavier")[0] == pytest.approx(1 / 1.4, rel=0.15)
    assert values("late")[0] == pytest.approx(0.2, abs=0.06)
    assert values("limit")[:2] == pytest.approx((-400, 400), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("case", [c for c in cases() if c.named], ids=lambda c: c.name)
def test_wrong_models_are_named_in_95_of_100_runs(case, learner):
    controller = parts(case, LEARNERS[learner])[1]
    right = 0
    for result in run(case, LEARNERS[learner], range(100)):
        finding = controllers.diagnose(result, controller)
        right += finding is not None and bool({finding.kind, *finding.others} & case.named)
    assert right >= 95


@pytest.mark.slow
@pytest.mark.parametrize("case", [c for c in cases() if not c.named], ids=lambda c: c.name)
def test_right_models_are_blamed_in_under_1_of_100_runs(case):
    controller = parts(case, LEARNERS["fixed"])[1]
    results = run(case, LEARNERS["fixed"], range(100))
    assert sum(controllers.diagnose(result, controller) is not None for result in results) <= 1
    assert sum(result["controller.model_suspect"].max() >= 0.5 for result in results) <= 1


def by_numpy(model, y, u, mean):
    """Return `model_suspect` of two sensors of one quantity, by the text's formulas in plain NumPy."""
    A, B, C, Q, R = (model.matrix(name) for name in ("A", "B", "C", "process_covariance", "sensor_covariance"))
    rest, disagreements = observers(model).rest, []
    for i in range(2):
        c, r = C[i : i + 1], R[i : i + 1, i : i + 1]
        P = solve_discrete_are(A.T, c.T, Q, r)
        S = (c @ P @ c.T + r).item()
        K, x, last = P @ c.T / S, np.array(mean, float).reshape(-1, 1), 0.0
        average, square, product = 0.0, 1.0, 0.0
        over = []
        for k in range(len(y)):
            e = (y[k, i] - c @ x).item()
            w = e / S**0.5
            if k >= rest:
                average += (w - average) / WINDOW
                square += (w * w - square) / WINDOW
                product += (w * last - product) / WINDOW
            last = w
            count = 2 * WINDOW - 1
            over.append(
                max(
                    count * average**2 / square / MEAN_LIMIT,
                    count * max(product / square, 0.0) ** 2 / PRODUCT_LIMIT,
                )
            )
            x = A @ (x + K * e) + B @ u[k].reshape(-1, 1)
        disagreements.append(over)
    least = np.min(disagreements, axis=0)
    return least / (1 + least)


@pytest.mark.parametrize("wrong", ["right", "heavier", "right, Freeze"])
def test_model_suspect_is_what_numpy_makes_of_the_samples(wrong):
    case = next(c for c in cases() if c.name == f"car: {wrong}")
    (result,) = run(case, LEARNERS["gamma"], [5])
    model = parts(case, LEARNERS["gamma"])[1].model
    expected = by_numpy(model, result["controller.y"], result["controller.u"].reshape(-1, 1), [20.0])
    np.testing.assert_allclose(result["controller.model_suspect"].ravel(), expected, rtol=1e-6, atol=1e-9)


def test_model_suspect_does_not_depend_on_the_learner_but_by_the_control():
    """A recording judged by estimators with different learners: the same numbers, to the last bit."""
    case = next(c for c in cases() if c.name == "car: right, Injection")
    (result,) = run(case, LEARNERS["gamma"], [6])
    model = parts(case, LEARNERS["gamma"])[1].model
    seen = []
    for learner in LEARNERS.values():
        step = controllers.StateEstimator(model, learner, initial_mean=20.0).online()
        rows = zip(result["controller.y"], np.append(0.0, result["controller.u"].ravel()), strict=False)
        seen.append([float(step(y=y, u=[u]).model_suspect) for y, u in rows])
    for other in seen[1:]:
        np.testing.assert_array_equal(seen[0], other)


def test_a_model_that_no_observer_can_follow_is_not_checked():
    model = controllers.LinearModel([[1.02, 0], [0, 0.9]], [[0.0], [1.0]], [[0, 1]], [1e-3, 1e-3], 1.0, dt=0.1)
    assert observers(model) is None
    step = controllers.StateEstimator(model, controllers.FixedPrecision()).online()
    assert np.isnan(step(y=[0.0], u=[0.0]).model_suspect)


def test_a_missing_and_an_absurd_sample_raise_nothing():
    case = Case("car", "right")
    model = parts(case, LEARNERS["fixed"])[1].model
    step = controllers.StateEstimator(model, controllers.FixedPrecision(), initial_mean=20.0).online()
    draws = np.random.default_rng(1).normal(20.0, 1.0, (600, 2))
    draws[300:320] = np.nan
    draws[400] = 1e20
    assert max(float(step(y=y, u=[100.0]).model_suspect) for y in draws) < 0.5


def test_the_time_scale_of_a_model_is_that_of_python_control_and_two_halves_are_one():
    control = pytest.importorskip("control")
    whole, half = (control.c2d(control.ss([[0, 1], [-4, -0.3]], [[0], [2]], [[1, 0]], 0), dt) for dt in (0.1, 0.05))
    model = controllers.LinearModel(half.A, half.B, half.C, [1e-6, 1e-6], 1e-2, dt=0.05)
    np.testing.assert_allclose(faster(model, 2.0).A, whole.A, atol=1e-12)
    np.testing.assert_allclose(faster(model, 2.0).B, whole.B, atol=1e-12)


def test_delayed_controls_come_later():
    np.testing.assert_array_equal(delayed(np.array([[1.0], [2.0], [3.0]]), 2), [[0.0], [0.0], [1.0]])


CAR = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})
MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], 0.001, 1.0, dt=0.02)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"B": [[-2e-4]]}, "the other way"),
        ({"B": [[4e-4]]}, "0.5 times as far"),
        ({"dt": 0.05}, "times as far"),
    ],
)
def test_a_step_response_that_differs_is_said(change, said):
    with pytest.warns(controllers.ModelMismatchWarning, match=said):
        found = controllers.compare_with_plant(replace(MODEL, **change), CAR, control="force", measured="v", at=20.0)
    assert len(found) == 1


def test_a_step_response_that_agrees_is_not():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert controllers.compare_with_plant(MODEL, CAR, control="force", measured="v", at=20.0) == ()


def test_a_late_plant_is_said_to_be_late():
    from bayesftc.reproduce._models_car import TrueCar

    with pytest.warns(controllers.ModelMismatchWarning, match="0.2 s later"):
        (found,) = controllers.compare_with_plant(
            MODEL, TrueCar(20.0, 100.0, 5.0, delay=10), control="force", measured="v", at=20.0
        )
    assert found.delay == 10


def test_a_diagnosis_says_what_it_lacks():
    case = Case("car", "right")
    controller = parts(case, LEARNERS["fixed"])[1]
    result = loop(case, LEARNERS["fixed"]).simulate(1.0)
    with pytest.raises(cosim.UnknownNameError, match=r"controller\.y"):
        controllers.diagnose(result, controller)
    with pytest.raises(cosim.ModelError, match="every step"):
        controllers.diagnose(loop(case, LEARNERS["fixed"]).simulate(1.0, decimation=2), controller, y="sensors.y")


WRONG_SIGN = ("B = [[2e-4]]", "B = [[-2e-4]]")


def test_bayesftc_run_warns_before_and_says_after_what_is_wrong(tmp_path, capsys):
    from bayesftc.cli.run import run_scenario
    from bayesftc.scenario._files import find_scenario

    text = find_scenario("cruise_control").read_text(encoding="utf-8")
    assert WRONG_SIGN[0] in text
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text.replace(*WRONG_SIGN), encoding="utf-8")
    with pytest.warns(controllers.ModelMismatchWarning, match="the other way"):
        run_scenario(str(wrong), None, {}, check_kalman=False, json=False, quiet=False)
    assert "Is the sign of B right?" in " ".join(capsys.readouterr().out.split())


def test_bayesftc_run_says_nothing_of_a_right_model(capsys):
    from bayesftc.cli.run import run_scenario

    with warnings.catch_warnings():
        warnings.simplefilter("error", controllers.ModelMismatchWarning)
        run_scenario("cruise_control", None, {}, check_kalman=False, json=True, quiet=False)
    assert '"model": null' in capsys.readouterr().out


def test_the_comparison_before_a_run_leaves_its_bits():
    case = Case("car", "right")
    before = loop(case, LEARNERS["gamma"]).simulate(2.0, seed=1)
    controllers.compare_with_plant(MODEL, CAR, control="force", measured="v", at=20.0)
    after = loop(case, LEARNERS["gamma"]).simulate(2.0, seed=1)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name])
