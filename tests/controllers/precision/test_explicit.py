"""Explicit detection: the trigger and its release step by step, the wrapped learner started afresh, thresholds of both kinds."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers import (
    BayesianController,
    Calibration,
    ChebyshevThreshold,
    ExplicitDetection,
    FittedThreshold,
    FixedPrecision,
    GammaPrecision,
    UnbiasedActiveInference,
)
from bayesftc.cosim.errors import ModelError, StepSizeError
from bayesftc.examples.cruise_control.cruise_control import FREEZE, cruise_control

R = np.array([1.0, 4.0])
MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, R, 0.02)
HOLD = 10  # steps


def samples(steps=400):
    """Two sensors around 20: the first jumps by 8 twice, both drop out at times."""
    rng = np.random.default_rng(4)
    y = 20.0 + rng.normal(size=(steps, 2)) * np.sqrt(R)
    y[100:180, 0] += 8.0
    y[260:300, 0] -= 8.0
    y[rng.random((steps, 2)) < 0.05] = np.nan
    return y


def run(precision, y=None, **options):
    step = BayesianController(MODEL, precision=precision, initial_mean=20.0, **options).online(compiled=False)
    return [step(y=row, goal=[20.0]) for row in (samples() if y is None else y)]


def stacked(outs, name):
    return np.array([out[name] for out in outs])


def predicted_variance(outs):
    return np.concatenate([[1.0], 0.999**2 * stacked(outs, "P")[:-1, 0, 0] + 0.001])


def triggered(distance, bound, hold=HOLD):
    """The trigger of one group as a list of states, from its distances (NaN: a sample is missing)."""
    states, active, quiet = [], False, 0
    for d in distance:
        if d >= bound:
            active, quiet = True, 0
        elif d < bound:
            quiet += 1
            active = active and quiet < hold
        states.append(active)
    return np.array(states)


def gamma(e, learning, rho=0.9, a0=2.0):
    """Shape and rate of a gamma learner that begins anew while it is not learning; what it says at each sample."""
    a, b, before, said = np.full(2, a0), a0 * R, False, []
    for row, now in zip(e, learning, strict=True):
        if not before:
            a, b = np.full(2, a0), a0 * R
        present = np.isfinite(row)
        a = rho * a + (1 - rho) * a0 + 0.5 * present
        b = rho * b + (1 - rho) * a0 * R + np.where(present, 0.5 * row**2, 0.0)
        said.append((a, b))
        before = now
    return (np.array(v) for v in zip(*said, strict=True))


def test_triggered_by_each_sensors_innovation_and_released_after_the_hold():
    outs = run(ExplicitDetection(GammaPrecision(forgetting=0.9), threshold=3.5, hold=HOLD * 0.02))
    e = stacked(outs, "innovation")
    distance = np.abs(e) / np.sqrt(predicted_variance(outs)[:, None] + R)
    expected = np.column_stack([triggered(d, 3.5) for d in distance.T])
    np.testing.assert_array_equal(stacked(outs, "detected"), expected)
    assert expected[100:180, 0].mean() > 0.9
    assert not expected[:90].any()
    assert not expected[225:255].any()
    learning = expected.any(axis=1)
    a, b = gamma(e, learning)
    used = np.where(learning[:, None], b / a, R)
    np.testing.assert_allclose(np.diagonal(stacked(outs, "R"), axis1=1, axis2=2), used, rtol=1e-9)
    np.testing.assert_allclose(stacked(outs, "precision"), 1 / used, rtol=1e-9)
    np.testing.assert_allclose(stacked(outs, "beta"), b, rtol=1e-9)
    np.testing.assert_allclose(stacked(outs, "precision_rate"), b, rtol=1e-9)
    np.testing.assert_allclose(stacked(outs, "precision_shape"), a, rtol=1e-9)


def test_the_second_fault_finds_the_learner_as_the_first_did():
    """The same jump twice: after the release nothing of the first fault is left in the learner."""
    y = np.full((300, 2), 20.0)
    y[50:80, 0] += 9.0
    y[200:230, 0] += 9.0
    outs = run(ExplicitDetection(GammaPrecision(forgetting=None), threshold=4.0, hold=HOLD * 0.02), y)
    alone = run(GammaPrecision(forgetting=None), y)
    beta, detected = stacked(outs, "beta"), stacked(outs, "detected")
    np.testing.assert_array_equal(
        np.flatnonzero(detected[:, 0]), [*range(50, 80 + HOLD - 1), *range(200, 230 + HOLD - 1)]
    )
    np.testing.assert_allclose(beta[200:235], beta[50:85], rtol=1e-2)
    assert stacked(alone, "beta")[200, 0] > 1.9 * stacked(alone, "beta")[50, 0]


def test_a_threshold_that_nothing_reaches_leaves_a_kalman_filter():
    outs, plain = run(ExplicitDetection(GammaPrecision(), threshold=1e9)), run(FixedPrecision())
    for name in ("u", "x_hat", "P", "R", "precision"):
        np.testing.assert_array_equal(stacked(outs, name), stacked(plain, name))
    assert not stacked(outs, "detected").any()


def test_a_threshold_that_all_reach_is_implicit_detection():
    y = samples()
    y[np.isnan(y)] = 20.1
    outs, plain = run(ExplicitDetection(GammaPrecision(), threshold=1e-9), y), run(GammaPrecision(), y)
    for name in plain[0]:
        np.testing.assert_array_equal(stacked(outs, name), stacked(plain, name))
    assert stacked(outs, "detected").all()


def test_a_missing_sample_holds_the_state():
    y = np.full((60, 2), 20.0)
    y[10, 0] += 30.0
    y[11:40, 0] = np.nan
    detected = stacked(run(ExplicitDetection(threshold=5.0, hold=HOLD * 0.02), y), "detected")
    assert np.flatnonzero(detected[:, 0]).tolist() == list(range(10, 40 + HOLD - 1))
    assert not detected[:, 1].any()


def distances(e, mean, covariances, scale):
    """The distance of the sensors that delivered a sample, in units of their bound; NaN where none did."""
    found = []
    for row, S in zip(e - mean, covariances, strict=True):
        here = np.flatnonzero(np.isfinite(row))
        d = np.sqrt(row[here] @ np.linalg.solve(S[np.ix_(here, here)], row[here])) if len(here) else np.nan
        found.append(d * np.sqrt(len(row) / len(here)) if scale and len(here) else d)
    return np.array(found)


def test_groups_and_learned_moments():
    """Two sensors judged together, by a mean and a correlated covariance that are not the model's; also where one is missing."""
    threshold = FittedThreshold([0.5, -0.5], [[2.0, 1.2], [1.2, 5.0]], 3.0)
    y = samples()
    y[120:130] = np.nan
    outs = run(ExplicitDetection(GammaPrecision(), threshold, groups=[(1, 0)], hold=HOLD * 0.02), y)
    e = stacked(outs, "innovation")
    assert (np.isnan(e).sum(axis=1) == 1).sum() > 20
    covariances = [np.asarray(threshold.covariance)] * len(e)
    expected = triggered(distances(e[:, ::-1], threshold.mean, covariances, scale=True), 3.0)
    assert 0 < expected.sum() < 300
    assert not np.array_equal(expected, triggered(distances(e, threshold.mean, covariances, scale=True), 3.0))
    np.testing.assert_array_equal(stacked(outs, "detected"), np.column_stack([expected, expected]))


def test_a_group_with_a_missing_member_is_not_blind():
    y = np.full((60, 2), 20.0)
    y[5:, 1] = np.nan
    y[20:30, 0] += 12.0
    for threshold in (4.0, FittedThreshold([0.0, 0.0], np.diag(R), 4.0)):
        outs = run(ExplicitDetection(threshold=threshold, groups=[(0, 1)], hold=HOLD * 0.02), y)
        assert np.flatnonzero(stacked(outs, "detected")[:, 0]).tolist() == list(range(20, 30 + HOLD - 1))


def test_a_number_for_a_group_is_a_bound_by_the_innovations_covariance():
    outs = run(ExplicitDetection(GammaPrecision(), 4.0, groups=[(0, 1)], hold=HOLD * 0.02))
    e, variance = stacked(outs, "innovation"), predicted_variance(outs)
    S = variance[:, None, None] + np.diag(R)
    expected = triggered(distances(e, np.zeros(2), S, scale=False), 4.0)
    assert 0 < expected.sum() < 300
    np.testing.assert_array_equal(stacked(outs, "detected")[:, 0], expected)


def test_each_group_has_its_own_threshold():
    outs = run(ExplicitDetection(threshold=[FittedThreshold(0.0, 1.0, 3.0), 1e9], hold=HOLD * 0.02))
    np.testing.assert_array_equal(
        stacked(outs, "detected"),
        np.column_stack([triggered(np.abs(stacked(outs, "innovation")[:, 0]), 3.0), np.zeros(400)]),
    )


def test_absurd_errors_are_detected():
    y = np.full((30, 2), 20.0)
    y[10] = [1e300, -1e300]
    y[20] = [1e200, 20.0]
    for groups in (None, [(0, 1)]):
        outs = run(ExplicitDetection(threshold=5.0, groups=groups, hold=0.02), y)
        detected = stacked(outs, "detected")
        assert not detected[:10].any()
        assert detected[10].all()
        assert detected[20, 0]
        assert not detected[29].any()
        assert np.isfinite(stacked(outs, "P")).all()


def test_learned_on_a_healthy_run_of_the_shipped_car():
    """The whole way: a healthy run, a threshold for each sensor, a faulty run that is seen and survived."""
    never = replace(FREEZE, start=1000.0, stop=1001.0)
    healthy = cruise_control(FixedPrecision(), fault=never).simulate(20.0, seed=7)
    thresholds = [ChebyshevThreshold(0.05).fit(healthy["controller.innovation"][:, i]) for i in range(2)]
    errors = {}
    for precision in (
        FixedPrecision(),
        ExplicitDetection(GammaPrecision(calibration=Calibration(2.0, -3.0)), thresholds),
    ):
        result = cruise_control(precision).simulate(20.0, seed=3)
        errors[type(precision)] = np.sqrt(np.mean((result["plant.v"] - result["reference.y"])[300:700] ** 2))
    detected = result["controller.detected"] > 0.5
    assert not detected[:300].any()
    assert detected[300:700, 0].mean() > 0.5
    assert not detected[850:].any()
    assert errors[ExplicitDetection] < 0.5 * errors[FixedPrecision]
    assert (result["controller.R"][~detected.any(axis=1)] == np.eye(2)).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ExplicitDetection(GammaPrecision), "must be a precision learner"),
        (lambda: ExplicitDetection(ExplicitDetection()), "must be a precision learner"),
        (lambda: ExplicitDetection(threshold=0.0), "must be a number above 0"),
        (lambda: ExplicitDetection(threshold=[3.0, float("nan")]), "must be a number above 0"),
        (lambda: ExplicitDetection(threshold="3"), "threshold='3'; it must be a number above 0"),
        (lambda: ExplicitDetection(threshold=["3", 3.0]), "threshold='3'; it must be a number above 0"),
        (lambda: ExplicitDetection(threshold=None), "threshold=None; it must be a number above 0"),
        (
            lambda: ExplicitDetection(threshold=ChebyshevThreshold()),
            r"is not fitted; give Cheb.*\.fit\(residuals\)",
        ),
        (lambda: ExplicitDetection(hold=0.0), "finite number above 0"),
        (lambda: ExplicitDetection(hold="0.4"), "hold='0.4'; it must be a finite number above 0"),
        (lambda: ExplicitDetection(hold=None), "hold=None; it must be a finite number above 0"),
        (lambda: ExplicitDetection(hold=0.03).learner(MODEL), "use 0.02 s or 0.04 s"),
        (lambda: ExplicitDetection(hold=0.011).learner(MODEL), r"no whole number of steps of 0\.02 s; use 0\.02 s\.$"),
        (lambda: ExplicitDetection(threshold=np.array(4.0)), "it must be a number above 0"),
        (
            lambda: ExplicitDetection(
                controllers.SwitchingPrecision(actuator_modes=[controllers.LostEffect()])
            ).learner(MODEL),
            "cannot be inferred; leave out ExplicitDetection, or leave the actuator modes out",
        ),
        (lambda: ExplicitDetection(groups=[]), "give a list of groups"),
        (lambda: ExplicitDetection(groups=[0, 1]), "each a list of sensors by their numbers"),
        (lambda: ExplicitDetection(groups="01"), "each a list of sensors by their numbers"),
        (lambda: ExplicitDetection(groups=["01"]), "each a list of sensors by their numbers"),
        (lambda: ExplicitDetection(groups=[[0.5]]), "each a list of sensors by their numbers"),
        (lambda: ExplicitDetection(groups=3), "each a list of sensors by their numbers"),
        (lambda: ExplicitDetection(threshold=[3.0]).learner(MODEL), "1 thresholds for 2 groups"),
        (lambda: ExplicitDetection(groups=[(0, 2)]).learner(MODEL), r"group \(0, 2\)"),
        (lambda: ExplicitDetection(groups=[(0, 0)]).learner(MODEL), "each once"),
        (lambda: ExplicitDetection(groups=[()]).learner(MODEL), "must name some"),
        (
            lambda: ExplicitDetection(threshold=FittedThreshold([0, 0], 1.0, 3.0)).learner(MODEL),
            "but the group",
        ),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ValueError, match=words) as caught:
        make()
    assert isinstance(caught.value, ModelError | StepSizeError)


def pull(x_hat, goal, u):
    u[0] = goal[0] - x_hat[0]


def test_it_serves_active_inference_as_well():
    """The same trigger on another controller's errors."""
    model = controllers.LinearModel([[1.0]], [[0.1]], [[1.0], [1.0]], 0.001, R, 0.02)
    controller = UnbiasedActiveInference(
        law=pull,
        model=model,
        belief_rate=10.0,
        control="law",
        precision=ExplicitDetection(GammaPrecision(forgetting=0.9), threshold=3.5, hold=HOLD * 0.02),
        initial_mean=20.0,
        sizes=(1, 1, 1),
    )
    step = controller.online(compiled=False)
    outs = [step(y=row, goal=[20.0]) for row in samples()]
    e = stacked(outs, "innovation")
    expected = np.column_stack([triggered(d, 3.5) for d in (np.abs(e) / np.sqrt(R)).T])
    assert 0 < expected.any(axis=1).sum() < 350
    np.testing.assert_array_equal(stacked(outs, "detected"), expected)
    learning = expected.any(axis=1)
    a, b = gamma(e, learning)
    np.testing.assert_allclose(
        np.diagonal(stacked(outs, "R"), axis1=1, axis2=2), np.where(learning[:, None], b / a, R), rtol=1e-9
    )


def test_in_a_scenario_file(tmp_path):
    """A number, or the fitted values as tables; the wrapped learner as a table of its own."""
    from bayesftc.scenario import load_scenario

    text = """
[simulation]
duration = 1
[plant]
fmu = "CruiseControl"
control = "force"
measured = "v"
[sensors]
count = 2
[reference]
kind = "Constant"
value = 20
[model]
A = [[0.999]]
B = [[2e-4]]
C = [[1.0], [1.0]]
process_covariance = 0.001
sensor_covariance = 1.0
dt = 0.02
[controller]
kind = "BayesianController"
[controller.precision]
kind = "ExplicitDetection"
learning = { kind = "GammaPrecision", forgetting = 0.8 }
"""
    said = {
        "threshold = 4": 4.0,
        "threshold = [4, 5.5]": (4.0, 5.5),
        "threshold = { mean = [0.1], covariance = [[2.0]], bound = 5 }": FittedThreshold([0.1], [[2.0]], 5.0),
        "threshold = [{ mean = [0], covariance = [[2]], bound = 5 }, { mean = [1], covariance = [[3]], bound = 6 }]": (
            FittedThreshold([0.0], [[2.0]], 5.0),
            FittedThreshold([1.0], [[3.0]], 6.0),
        ),
        "threshold = 4\ngroups = [[0, 1]]\nhold = 0.2": 4.0,
    }
    for line, threshold in said.items():
        file = tmp_path / "car.toml"
        file.write_text(text + line)
        scenario = load_scenario(file)
        assert scenario.controller.precision.threshold == threshold
        assert scenario.controller.precision.learning == GammaPrecision(forgetting=0.8)
        assert "controller.detected" in scenario.simulate(engine="interpreted", duration=0.1)
    assert scenario.controller.precision.groups == ((0, 1),)
