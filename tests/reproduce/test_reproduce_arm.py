"""The arm experiment, small: what it computes, by other ways of computing it, and that it reaches what the paper reports."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesftc import controllers, reproduce
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import numbers
from bayesftc.reproduce import paper
from bayesftc.reproduce.experiments.arm import (
    figures as _arm_figures,
    loop as _arm_loop,
    run as _arm,
    tables as _arm_tables,
)
from bayesftc.reproduce.settings import Arm
from bayesftc.reproduce.shared.ensemble import Ensemble


@pytest.fixture(scope="module")
def report():
    return reproduce.arm(seed=5, jobs=2, runs=4, beyond=False)


def test_report_has_what_the_file_promises(report):
    assert {"settings", "mse", "paper", "grid", "trajectories", "detection"} <= set(report)
    assert tuple(report["mse"]) == tuple(paper.ARM) == _arm.NAMES
    for joints in report["mse"].values():
        assert set(joints) == {"faulty", "healthy"}
        for cell in joints.values():
            assert cell["ci"][0] < cell["mean"] < cell["ci"][1]
            assert cell["n"] == 4
    for name, value in vars(Arm(runs=4)).items():
        assert json.dumps(report["settings"][name]) == json.dumps(value)
        assert len(report["settings"]["why"][name]) > 5
    assert report["grid"] is None


def test_errors_are_those_of_the_paper_or_better(report):
    """No fault tolerance within a factor of 2; precision learning at most the paper's, and as good as being told."""
    mse = {name: {joint: cell["mean"] for joint, cell in joints.items()} for name, joints in report["mse"].items()}
    for joint in ("faulty", "healthy"):
        assert paper.ARM["none"][joint] / 2 < mse["none"][joint] < 2 * paper.ARM["none"][joint]
        for name in ("implicit", "explicit", "deterministic"):
            assert mse[name][joint] <= paper.ARM[name][joint]
        assert mse["implicit"][joint] <= paper.ARM["deterministic"][joint]
    (found,) = report["detection"].values()
    assert found["missed"] == 0
    assert 0.0 < found["delay_mean"] < 0.5
    assert found["healthy_share"] < report["settings"]["alpha"]


@pytest.mark.slow
def test_same_bits_for_any_number_of_jobs_and_other_bits_for_another_seed(report):
    assert reproduce.arm(seed=5, jobs=1, runs=4, beyond=False) == report
    assert reproduce.arm(seed=6, jobs=2, runs=4, beyond=False)["mse"] != report["mse"]


def test_intervals_are_students():
    errors = np.random.default_rng(0).exponential(size=(9, 2))
    for joint, cell in enumerate(_arm._summary(errors).values()):
        interval = stats.ttest_1samp(errors[:, joint], 0.0).confidence_interval(0.95)
        np.testing.assert_allclose(cell["ci"], interval, rtol=1e-12)


def acceleration(q, dq, torque):
    """The arm's equation of motion, with the numbers of the authors' public code."""
    i1, i2, m1, m2, l1, g1, g2, g = 1.0209, 1.0218, 2.1368, 2.2418, 1.0446, 0.5451, 0.5075, 9.81
    c2, s2, c1, c12 = np.cos(q[1]), np.sin(q[1]), np.cos(q[0]), np.cos(q[0] + q[1])
    coupling = i2 + m2 * (g2**2 + l1 * g2 * c2)
    M = [[i1 + i2 + g1**2 * m1 + m2 * (l1**2 + g2**2 + 2 * l1 * g2 * c2), coupling], [coupling, i2 + g2**2 * m2]]
    h = l1 * g2 * m2 * s2
    C = np.array([[-h * dq[1], -h * (dq[0] + dq[1])], [h * dq[0], 0.0]])
    G = g * np.array([m1 * g1 * c1 + m2 * (g2 * c12 + l1 * c1), m2 * g2 * c12])
    return np.linalg.solve(M, torque - C @ dq - np.array([101.519, 103.8566]) * dq - G)


def runge_kutta(x, torque, h):
    def f(x):
        return np.concatenate([x[2:], acceleration(x[:2], x[2:], torque)])

    a = f(x)
    b = f(x + h / 2 * a)
    c = f(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c))


def seen(x):
    """Where the camera sees the arm's end."""
    angles = np.array([x[0], x[0] + x[1]])
    p = np.array([1.0446, 1.0111]) @ np.column_stack([np.cos(angles), np.sin(angles)])
    r2 = p @ p
    return p * (1 - 1.5e-3 * r2 + 5e-6 * r2**2)


def by_hand(s, seed, learns):
    """One run written out in NumPy: plant, sensors, frozen encoder, belief, precisions, PID; the belief's squared errors."""
    steps, h = round(s.duration / s.step), s.step
    noise = np.column_stack([numbers(seed, "sensors.noise", steps + 1, channel=i) for i in range(6)])
    std = np.array([s.encoder_std] * 4 + [s.camera_std] * 2)
    gain = np.array([s.encoder_precision] * 4 + [s.camera_precision] * 2)
    x = np.array([*s.start, 0.0, 0.0])
    mean, integral, trust, held, errors = x.copy(), np.zeros(2), np.ones(6), None, []
    for k in range(steps + 1):
        t = k * h
        y = np.concatenate([x, seen(x)]) + std * noise[k]
        if t < s.fault_start:
            held = y[0]
        y[0] = held
        error = y - np.concatenate([mean, seen(mean)])
        if learns:
            squared = (error / std) ** 2
            moved = trust * np.exp(-0.5 * s.learning_rate * (trust * squared - 1))
            moved = np.where(trust > 1 / squared, np.maximum(moved, 1 / squared), np.minimum(moved, 1 / squared))
            trust = np.clip(moved, s.lower_bound, 1.0)
        # The camera's derivative by the complex step.
        J = np.column_stack([seen(mean + 1e-30j * e).imag / 1e-30 for e in np.eye(4)])
        mean = mean + h * s.belief_rate * np.vstack([np.eye(4), J]).T @ (gain * trust * error)
        goal = np.array(s.second_goal if t >= s.switch else s.first_goal)
        torque = s.proportional * (goal - mean[:2]) - np.array(s.derivative) * mean[2:] + integral
        integral = np.clip(integral + h * s.integral * (goal - mean[:2]), -s.integral_limit, s.integral_limit)
        errors.append((mean[:2] - x[:2]) ** 2)
        x = runge_kutta(x, torque, h)
    return np.mean(errors, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("learns", [False, True])
def test_an_error_is_that_of_a_run_by_hand(learns):
    settings = replace(Arm(), duration=3.0, switch=1.5, fault_start=2.0, judged=(0.0, 3.0))
    learner = _arm_loop.learning(settings) if learns else controllers.FixedPrecision()
    ensemble = Ensemble(seed=1)
    (seed,) = ensemble.seeds("arm", 1)
    loop = _arm_loop.closed_loop(settings, _arm_loop.Case(learner))
    errors = _arm.squared_errors(settings, {"x": loop}, [seed], ensemble, "x")["x"][0]
    np.testing.assert_allclose(errors, by_hand(settings, seed, learns), rtol=1e-6)


def test_being_told_is_a_missing_encoder():
    settings = replace(Arm(), duration=2.0, switch=0.5, fault_start=1.0)
    loop = _arm_loop.closed_loop(settings, _arm_loop.Case(controllers.FixedPrecision(), drop_faulty=True))
    result = loop.simulate(2.0, seed=1, record=["controller.innovation"])["controller.innovation"]
    assert np.isnan(result[1000:, 0]).all()
    assert np.isfinite(np.delete(result, 0, axis=1)).all()
    assert np.isfinite(result[:1000]).all()


@pytest.mark.parametrize("modes", [{"fault_modes": ()}, {"further_modes": (("Frozen", "Melted"),)}], ids=str)
def test_fault_modes_are_the_packages(modes):
    with pytest.raises(ModelError, match=r"Choose among Frozen, .*DroppedOut"):
        Arm(**modes)


@pytest.mark.slow
def test_grid_tables_and_figure(printed):
    small = replace(
        Arm(),
        grid_runs=1,
        switches=(7.0, 7.4),
        camera_precisions=(0.52,),
        learning_rates=(1e-3,),
        lower_bounds=(1e-1, 1e-3),
        further_modes=(),
    )
    report = reproduce.arm(seed=2, jobs=1, runs=2, settings=small)
    ours = report["mse"]["switching"]
    assert ours["faulty"]["mean"] < 0.6e-5
    assert ours["healthy"]["mean"] < 0.4e-5
    found = report["detection"]["switching"]
    assert (found["missed"], found["delay_mean"] < 0.01, found["healthy_share"] < 0.01) == (0, True, True)
    none, implicit = report["grid"]["none"], report["grid"]["implicit"]
    assert none[0]["faulty"] < none[1]["faulty"]  # an arm that has arrived when its encoder freezes errs less
    assert implicit[0]["faulty"] > 100 * implicit[1]["faulty"]
    text = printed(_arm_tables.show(report))
    more = [{"fault_modes": ["Frozen", "Noisier"], "faulty": 600.0, "healthy": 90.0}]
    assert "Frozen, Noisier" in printed(_arm_tables.show({**report, "grid": {**report["grid"], "switching": more}}))
    for words in (
        "SwitchingPrecision (Frozen, DroppedOut;",
        "misses it in no run",
        "bound 0.001",
        "7.4 s",
        f"{1e6 * none[1]['faulty']:.0f} /",
    ):
        assert words in text
    figure = _arm_figures.trajectories(report)
    assert len(figure.axes) == 6
    for axis in figure.axes:
        assert [line.get_label() for line in axis.lines] == ["goal", "angle", "belief"]
