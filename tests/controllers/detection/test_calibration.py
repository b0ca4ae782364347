"""The logistic map from beta to a probability: fitted on one part of a run, honest on runs it has never seen."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.detection import calibration
from bayesftc.controllers.detection.calibration import (
    _default_amplitudes,
    judge,
    judge_own_probability,
    simulated_sizes,
)
from bayesftc.cosim.errors import ModelError

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, 0.02)
FAST = cosim.Sine(amplitude=20.0, period=2.0, offset=20.0)
PRECISION = controllers.GammaPrecision(forgetting=0.7)


def fit(seed, **options):
    return controllers.calibrate(
        MODEL,
        controllers.Hazards(2.8, 0.4),
        {"injection": 4.5, "drift": 7.5},
        precision=PRECISION,
        reference=FAST,
        seed=seed,
        initial_mean=20.0,
        **options,
    )


@pytest.fixture(scope="module")
def report():
    return fit(seed=1, steps=60_000)


def test_the_map_knows_more_than_the_base_rate(report):
    assert report.auc > 0.85
    assert report.brier < 0.75 * report.brier_of_constant
    assert report.fault_share == pytest.approx(0.4 / 3.2, abs=0.02)
    assert report.samples == 2 * (60_001 - 200 - int(0.8 * (60_001 - 200)))


def test_the_live_probability_is_calibrated_on_another_run(report):
    """Another seed, through the block itself: probability and labels as a user sees them."""
    precision = controllers.GammaPrecision(forgetting=0.7, calibration=report.calibration)
    faults = [
        cosim.RandomFaults(
            kinds=(cosim.Freeze(), cosim.Injection(magnitude=4.5), cosim.Drift(slope=7.5)), sensor=i, name=f"fault_{i}"
        )
        for i in range(2)
    ]
    import control

    plant = cosim.StateSpace(
        control.ss([[0.999]], [[2e-4]], [[1.0]], [[0.0]], 0.02, inputs=["force"], outputs=["v"]),
        process_noise=[[0.001]],
        initial=[20.0],
    )
    loop = cosim.closed_loop(
        plant=plant,
        controller=controllers.BayesianController(MODEL, precision=precision, initial_mean=20.0),
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=faults,
        reference=FAST,
    )
    result = loop.simulate(800.0, seed=99)
    p = result["controller.fault_probability"].ravel()
    faulty = np.column_stack([result["fault_0.active"], result["fault_1.active"]]).ravel() > 0.5
    assert abs(p.mean() - faulty.mean()) < 0.02
    assert np.mean((p - faulty) ** 2) < 0.8 * faulty.mean() * (1 - faulty.mean())
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 1.0)):
        chosen = (p >= low) & (p < high)
        assert abs(p[chosen].mean() - faulty[chosen].mean()) < 0.12


@pytest.mark.parametrize(
    "precision",
    [
        controllers.GammaPrecision(),
        controllers.WishartPrecision(),
        controllers.VariationalBayesKF(),
        controllers.VariationalBayesKF(covariance="full"),
    ],
    ids=repr,
)
def test_every_learner_with_a_rate_can_be_calibrated(precision):
    """The prior's rate is the one that the live probability is relative to."""
    from dataclasses import replace

    calibration = controllers.Calibration(1.5, -2.0)
    controller = controllers.BayesianController(MODEL, precision=replace(precision, calibration=calibration))
    out = controller.online(compiled=False)(y=[0.5, -4.0], goal=[0.0])
    expected = 1 / (1 + np.exp(-(1.5 * np.log(out.beta / precision.prior_rates(MODEL)) - 2.0)))
    np.testing.assert_allclose(out.fault_probability, expected, rtol=1e-12)
    why = precision.why_no_probability
    assert type(precision).__name__ in why
    assert "controllers.calibrate" in why


def test_a_map_of_pure_noise_is_found_out():
    rng = np.random.default_rng(0)
    report = judge(controllers.Calibration(5.0, 0.0), rng.normal(size=20_000), rng.random(20_000) < 0.1)
    assert report.auc == pytest.approx(0.5, abs=0.03)
    assert report.brier > report.brier_of_constant
    assert report.calibration_error > 0.2


def lasting(rng, steps, share=0.1):
    """Return logits and labels of two sensors with faults of 50 steps every 300, a share of them missed throughout."""
    logit, faulty = np.full((steps, 2), -6.0), np.zeros((steps, 2), dtype=bool)
    for sensor in range(2):
        at = rng.exponential(250.0)
        while at < steps:
            some = slice(int(at), int(at + 1.0 + rng.exponential(50.0)))
            faulty[some, sensor] = True
            logit[some, sensor] = -6.0 if rng.random() < share else 6.0
            at = some.stop + 1.0 + rng.exponential(250.0)
    return logit, faulty


@pytest.mark.sampled(1)
@pytest.mark.parametrize("cycles", [3, 10, 40])
def test_the_interval_contains_the_error_of_a_long_run(cycles):
    """However few faults a test has: many short tests have no missed fault, and twenty parts of them hardly scatter."""
    rng, same = np.random.default_rng(0), controllers.Calibration(1.0, 0.0)
    truth = judge(same, *lasting(rng, 1_000_000)).calibration_error
    found = [judge(same, *lasting(rng, 300 * cycles)) for _ in range(100)]
    intervals = np.array([report.calibration_error_interval for report in found])
    intervals = intervals[~np.isnan(intervals).any(axis=1)]
    assert len(intervals) > 70
    assert ((intervals[:, 0] <= truth) & (truth <= intervals[:, 1])).mean() >= 0.93
    if cycles == 40:  # it is no wider than it need be
        assert np.ptp(intervals, axis=1).mean() < 0.06


def test_faults_are_counted_by_their_onsets_in_the_test():
    faulty = np.array([[1, 0], [0, 0], [1, 1], [1, 0], [0, 1], [1, 1], *[[0, 0]] * 6], dtype=bool)
    report = judge(controllers.Calibration(1.0, 0.0), np.where(faulty, 2.0, -2.0), faulty)
    assert report.faults == 4
    faulty[1:, 0] = False  # the one of sensor 0 began before
    assert judge(controllers.Calibration(1.0, 0.0), np.where(faulty, 2.0, -2.0), faulty).faults == 2


@pytest.mark.parametrize(("most", "steps"), [(1_000_000, 105_200), (90_000, 90_000)])
def test_steps_follow_the_times_of_the_faults_up_to_a_bound(monkeypatch, most, steps):
    """30 cycles of 700 steps are a fifth of 105 000."""
    monkeypatch.setattr(calibration, "MOST_STEPS", most)
    report = controllers.calibrate(MODEL, controllers.Hazards(12.0, 2.0))
    assert report.samples == 2 * (steps + 1 - 200 - int(0.8 * (steps + 1 - 200)))
    if steps < most:
        assert report.faults >= 40


def test_a_slow_plant_is_calibrated_without_settings():
    """With samples of 5 s faults of 0.4 s are impossible; per sample, the defaults are those of 0.1 s."""
    slow, usual = (controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=dt) for dt in ("5", "0.1"))
    reports = [controllers.calibrate(model, steps=6_000) for model in (slow, usual)]
    assert reports[0].fault_share == reports[1].fault_share > 0.05
    assert reports[0].auc == pytest.approx(reports[1].auc, abs=1e-6)


def of_two_units(rows):
    """Return a model whose sensors measure the same, one in m (number 0) and the other in mm, in the given order."""
    scale = np.array([1.0, 1000.0])[rows]
    covariance = np.diag((np.array([0.1, 0.3])[rows] * scale) ** 2)
    return controllers.LinearModel([[0.95]], [[0.1]], scale[:, None], 1e-3, covariance, 0.1)


def test_sizes_are_those_of_the_noise_of_each_sensor_whatever_their_order():
    one, other = of_two_units([0, 1]), of_two_units([1, 0])
    assert simulated_sizes(one, {})["injection"] == pytest.approx([0.3, 900.0])
    assert simulated_sizes(other, {})["injection"] == pytest.approx([900.0, 0.3])
    assert simulated_sizes(one, {"drift": 2.0, "injection": [1.0, 7.0]}) == {
        "injection": [1.0, 7.0],
        "drift": [2.0, 2.0],
    }
    goals = np.array([[1.0]])
    assert _default_amplitudes(one, goals) == _default_amplitudes(other, goals) == pytest.approx([0.5])


def test_units_of_sensors_change_nothing():
    in_m = controllers.LinearModel([[0.95]], [[0.1]], [[1.0], [1.0]], 1e-3, np.diag([0.01, 0.09]), 0.1)
    reports = [controllers.calibrate(model, steps=6_000) for model in (in_m, of_two_units([0, 1]))]
    assert [r.auc for r in reports] == pytest.approx([reports[0].auc] * 2, abs=1e-6)
    assert [r.brier for r in reports] == pytest.approx([reports[0].brier] * 2, rel=1e-4)


def test_a_goal_that_no_sensor_measures_has_a_default_reference():
    model = controllers.LinearModel(
        np.eye(2), np.eye(2), [[2.0, 0.0], [-4.0, 0.0]], np.eye(2), np.diag([1.0, 9.0]), 0.1
    )
    assert _default_amplitudes(model, np.eye(2)) == pytest.approx(
        [2.5, 10.0]
    )  # 5 * 1 / 2, and 5 times the median of 1 and 3


def test_reproducible():
    assert fit(seed=2, steps=6_000) == fit(seed=2, steps=6_000)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"steps": 100}, "give at least 5000"),
        ({"precision": controllers.SERFDI()}, "SERFDI.* has no rate.*: GammaPrecision or .*VariationalBayesKF"),
        (
            {"magnitudes": {"injection": [1.0, 2.0, 3.0]}},
            r"has injection=\[1.0, 2.0, 3.0\] for 2 sensors; give one number, or",
        ),
        (
            {"magnitudes": {"drift": "fast"}},
            "has drift='fast' for 2 sensors; give one number, or one for each",
        ),
        ({"magnitudes": {"jump": 1.0}}, "has the unknown magnitude 'jump'"),
        ({"hazards": (2.8, 0.01)}, "mean_time_to_recovery=0.01, but a step of the model takes .* at least 0"),
        ({"hazards": (float("inf"), 0.4)}, "mean_time_to_fault=inf.* Give a finite number"),
    ],
)
def test_bad_settings(change, words):
    with pytest.raises(ModelError, match=words):
        controllers.calibrate(MODEL, **change)


def test_a_loop_is_no_model():
    with pytest.raises(ModelError, match=r"needs a LinearModel, such as controller\.model, not"):
        controllers.calibrate(cosim.Diagram(dt=0.1))


def test_an_unstable_loop_is_refused():
    servo = controllers.LinearModel([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], [[1.0, 0.0]], 1e-4, 1e-2, 0.1)
    with pytest.raises(ModelError, match="cannot simulate this loop"):
        controllers.calibrate(servo, goal_covariance=1e-4)


def leaning(**limits):
    """A plant that falls unless it is held, with an estimated load."""
    falling = control.ss(
        [[0.0, 1.0], [9.0, -0.5]], [[0.0], [1.0]], np.eye(2), 0, inputs=["u"], outputs=["angle", "rate"]
    )
    return controllers.design(
        falling,
        dt=0.01,
        goal="angle",
        sensors=[2, 2],
        sensor_std=[0.01, 0.02],
        disturbance=True,
        acceptable_control=5.0,
        **limits,
    )


def test_an_estimated_load_does_not_walk_beyond_the_limits():
    """The load walked for 400 s, an unstable plant was lost, and the learner was called unreliable."""
    report = judge_controller(leaning(u_min=-5.0, u_max=5.0))
    assert report.auc > 0.85
    assert report.brier < 0.7 * report.brier_of_constant


@pytest.mark.slow
def test_a_plant_that_its_limits_do_not_hold_is_said():
    weak = leaning(u_min=-0.1, u_max=0.1)
    with pytest.warns(
        UserWarning, match="a control is at its limits for 100% of the time, so the plant is hardly held"
    ):
        judge_controller(weak)
    with pytest.raises(ModelError, match=r"the simulated plant ran away after \d+.*: the controller does not hold it"):
        judge_controller(weak, steps=60_000)


def judge_controller(controller, steps=20_000):
    names = ("goal_covariance", "control_covariance", "initial_covariance", "u_min", "u_max")
    settings = {name: getattr(controller, name) for name in names}
    return judge_own_probability(
        controller.model,
        controllers.Hazards(2.8, 0.4),
        precision=controller.precision,
        steps=steps,
        kind=controllers.LQGController,
        goal_on=controller.goal_matrix,
        **settings,
    )
