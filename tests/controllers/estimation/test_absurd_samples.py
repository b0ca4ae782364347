"""Samples that no fault explains: what comes after them, what is said of them, and beliefs that are wrong themselves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc import controllers
from bayesftc.controllers import (
    Calibration,
    ExplicitDetection,
    FixedPrecision,
    GammaPrecision,
    Proportional,
    StateEstimator,
    SwitchingPrecision,
)

STD = np.array([1.0, 2.0])
MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, STD**2, 0.02)
HOLD = 100.0
"""The input that holds the speed of 20."""

LEARNERS = [
    *(cls() for cls in controllers.LEARNERS),
    SwitchingPrecision(joint=False),
    GammaPrecision(window=20),
    GammaPrecision(forgetting=None, calibration=Calibration(2.0, -3.0)),
]
CONTROLLERS = [
    controllers.BayesianController(MODEL, GammaPrecision(), initial_mean=20.0),
    controllers.BayesianController(MODEL, GammaPrecision(), belief="joint", initial_mean=20.0),
    controllers.LQGController(MODEL, controllers.FixedPrecision(), initial_mean=20.0),
    controllers.NonlinearBayesianController(MODEL, GammaPrecision(), initial_mean=20.0, iterations=5),
    controllers.UnbiasedActiveInference(
        model=MODEL,
        law=Proportional(1.0),
        control="law",
        state_prior="kalman",
        precision=GammaPrecision(),
        initial_mean=20.0,
    ),
]
VALUES = [(1e20, 2147483647.0, 3.4e38, -1e300), (-2147483648.0, 1e300, 2147483647.0, -1e20)]


def test_every_controller_and_learner_is_among_them():
    assert {type(block) for block in CONTROLLERS} == set(controllers.CONTROLLERS)
    assert {type(learner) for learner in LEARNERS} == set(controllers.LEARNERS)


def samples(steps=160, seed=0):
    return 20.0 + np.random.default_rng(seed).normal(size=(steps, 2)) * STD


def run(block, y, compiled=False):
    step = block.online(compiled=compiled)
    other = {"goal": 20.0} if "goal" in {port.name for port in block.inputs} else {"u": HOLD}
    return [step(y=row, **other) for row in y]


def estimates(outs):
    return np.array([out.x_hat[0] for out in outs])


def probabilities(outs):
    return np.array([out.fault_probability for out in outs])


def spoilt(y, values, rng):
    """Return samples with absurd ones: one of one sensor, one of each, five in a row of one, and of each; and where they are."""
    times, z = np.sort(rng.choice(np.arange(20, 80, 12), 4, replace=False)), y.copy()
    for at, value, sensors, length in zip(times, values, ([0], [0, 1], [1], [0, 1]), (1, 1, 5, 5), strict=True):
        z[at : at + length, sensors] = value
    return z, z != y


def same_but_for_the_fault(got, expected, absurd, probability):
    """See that samples have the effect of missing ones on everything but what is said of their sensors."""
    for k, (out, other) in enumerate(zip(got, expected, strict=True)):
        for name in other:
            values = np.array(other[name])
            if name == "fault_probability":
                values[absurd[k]] = probability
            elif name == "detected":
                values[absurd[k]] = 1.0
            np.testing.assert_array_equal(out[name], values, err_msg=f"{name} at {k}")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("precision", LEARNERS, ids=repr)
def test_every_learner_takes_them_as_missing_and_faulty_and_is_back_within_a_second(precision, values):
    y, rng = samples(), np.random.default_rng(1)
    z, absurd = spoilt(y, values, rng)
    block = StateEstimator(MODEL, precision, initial_mean=20.0)
    outs, certain = run(block, z), np.nan if precision.why_no_probability else 1.0
    same_but_for_the_fault(outs, run(block, np.where(absurd, np.nan, y)), absurd, certain)
    healthy, last = run(block, y), np.flatnonzero(absurd.any(axis=1))[-1]
    assert np.abs(estimates(outs) - estimates(healthy))[last + 50 :].max() < 0.1 * STD[0]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("block", CONTROLLERS, ids=lambda block: type(block).__name__)
def test_every_controller_takes_them_as_missing_and_is_back_within_a_second(block, values):
    y = samples()
    z, absurd = spoilt(y, values, np.random.default_rng(2))
    outs = run(block, z)
    same_but_for_the_fault(outs, run(block, np.where(absurd, np.nan, y)), absurd, np.nan)
    last = np.flatnonzero(absurd.any(axis=1))[-1]
    assert np.abs(estimates(outs) - estimates(run(block, y)))[last + 50 :].max() < 0.1 * STD[0]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "block",
    [
        *CONTROLLERS,
        *(StateEstimator(MODEL, learner, initial_mean=20.0) for learner in (SwitchingPrecision(), ExplicitDetection())),
    ],
    ids=lambda block: f"{type(block).__name__}-{type(block.precision).__name__}",
)
def test_compiled_and_plain_agree_to_the_last_bit(block):
    y, _ = spoilt(samples(), VALUES[0], np.random.default_rng(3))
    y[100:] += 1e9  # the belief is lost, and found again
    for out, other in zip(run(block, y), run(block, y, compiled=True), strict=True):
        for name in out:
            np.testing.assert_array_equal(out[name], other[name], err_msg=name)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.floats(1e7, 1.7e308) | st.floats(-1.7e308, -1e7),
    st.integers(0, 39),
    st.sets(st.integers(0, 1), min_size=1),
    st.integers(1, 9),
)
def test_any_absurd_value_at_any_time_is_a_missing_sample(value, at, sensors, length):
    y, absurd = samples(50), np.zeros((50, 2), dtype=bool)
    absurd[at : at + length, list(sensors)] = True
    block = StateEstimator(MODEL, GammaPrecision(calibration=Calibration(2.0, -3.0)), initial_mean=20.0)
    outs = run(block, np.where(absurd, value, y))
    same_but_for_the_fault(outs, run(block, np.where(absurd, np.nan, y)), absurd, 1.0)


def test_the_bound_is_a_million_standard_deviations_of_the_innovation():
    """Of a belief that is uncertain itself far larger samples are taken in."""
    for variance in (1e-6, 1.0, 1e12):
        sd = np.sqrt(variance + 1.0)
        for factor, known in ((0.999e6, 0.0), (1.001e6, 1.0)):
            block = StateEstimator(MODEL, controllers.SERFDI(threshold=1e7), initial_covariance=variance)
            out = run(block, [[factor * sd, np.nan]])[0]
            assert out.fault_probability[0] == known
            assert np.isnan(out.innovation[0]) == bool(known)


def test_a_sensor_that_stays_absurd_is_a_faulty_one_for_ever():
    """The other one carries on; and with both gone, the model, until they are back."""
    y = samples(1500)
    for value, sensors in ((2147483647.0, [0]), (-1e20, [0]), (3.4e38, [0, 1]), (65535.0 * 1e4, [0, 1])):
        z = y.copy()
        z[100:1000, sensors] = value
        outs = run(StateEstimator(MODEL, SwitchingPrecision(joint=False), initial_mean=20.0), z, compiled=True)
        assert (probabilities(outs)[100:1000][:, sensors] == 1.0).all()
        assert np.abs(estimates(outs) - 20.0).max() < 1.5
        assert probabilities(outs)[-1].max() < 0.05


@pytest.mark.sampled(5)
@pytest.mark.parametrize("precision", LEARNERS, ids=repr)
@pytest.mark.parametrize("case", ["start", "rest", "jump", "stuck"])
def test_no_estimator_is_deaf_for_ever(precision, case):
    """The belief is wrong by millions of standard deviations, from the first sample on or after a jump of the plant."""
    y = 8e6 + samples(200)
    x = np.full(200, 8e6 + 20.0)
    if case == "rest":  # a healthy sensor that repeats itself
        y[:] = x[0]
    if case == "stuck":
        y[:, 1] = 2147483647.0
    if case == "jump":
        y[100:] += 3e7
        x[100:] += 3e7
    u = np.append(x[1:] - 0.999 * x[:-1], 0.001 * x[-1]) / 2e-4
    u[99:100] = u[98]
    step = StateEstimator(MODEL, precision, initial_mean=x[0] if case == "jump" else 0.0).online(compiled=False)
    errors = [abs(step(y=row, u=now).x_hat[0] - truth) for row, now, truth in zip(y, u, x, strict=True)]
    begin = 100 if case == "jump" else 0
    assert max(errors[begin : begin + 25]) > 1e6
    assert max(errors[begin + (55 if case == "rest" else 30) :]) < 4.0


def test_the_state_is_found_again_and_disturbances_do_not_take_part_in_it():
    """A servo whose position was wrong by 1e7 encoder units: its speed and the encoders' own errors stay what they are."""
    servo = controllers.LinearModel(
        [[1, 0.01], [0, 0.99]], [[0], [0.01]], [[1, 0], [1, 0], [0, 1]], [1e-4, 1e-2], [1.0, 1.0, 0.01], 0.01
    ).with_sensor_errors(0.5, 10.0, sensors=[0, 1])
    rng = np.random.default_rng(4)
    x = np.stack([1e7 + 3.0 * np.arange(300) * 0.01, np.full(300, 3.0)], axis=1)
    y = x @ np.array([[1, 1, 0], [0, 0, 1]]) + rng.normal(size=(300, 3)) * [1.0, 1.0, 0.1]
    step = StateEstimator(servo, FixedPrecision(), initial_mean=[0.0, 3.0]).online(compiled=False)
    outs = [step(y=row, u=3.0) for row in y]
    found = np.array([out.x_hat for out in outs])
    assert np.abs(found[60:, 0] - x[60:, 0]).max() < 4.0
    assert np.abs(found[60:, 1] - 3.0).max() < 1.5
    assert np.abs(found[60:, 2:]).max() < 3.0


def test_active_inference_finds_a_state_that_it_was_wrong_of():
    """Encoders of a millionth, a belief wrong by 3: it has no covariance to widen, and so goes back to the samples."""
    model = replace(MODEL, sensor_covariance=[1e-12, 4e-12])
    block = controllers.UnbiasedActiveInference(
        model=model, law=Proportional(0.0), control="law", belief_rate=10.0, state_prior="random walk"
    )
    outs = run(block, 3.0 + np.random.default_rng(5).normal(size=(200, 2)) * [1e-6, 2e-6])
    assert abs(estimates(outs)[20]) < 1e-3
    assert abs(estimates(outs)[-1] - 3.0) < 1e-3


@pytest.mark.parametrize(("value", "steps"), [(1e20, 100), (1e300, 600)])
def test_an_absurd_input_does_not_make_an_estimator_deaf(value, steps):
    """The plant did not follow it, and the belief did: one and a half dozen digits come back with each half second."""
    servo = controllers.LinearModel(
        [[1, 0.02], [0, 0.99]], [[0], [0.02]], [[1, 0], [1, 0], [0, 1]], [1e-6, 1e-4], [0.01, 0.04, 0.01], 0.02
    )
    step, rng = StateEstimator(servo, FixedPrecision()).online(compiled=False), np.random.default_rng(6)
    errors = [
        np.abs(step(y=0.1 * rng.normal(size=3), u=value if k == 20 else 0.0).x_hat).max() for k in range(steps + 21)
    ]
    assert max(errors) > 1e15
    assert errors[-1] < 1.0


def test_time_to_listen_is_half_a_second_but_at_least_ten_samples():
    for dt, steps in ((0.02, 25), (0.001, 500), (30.0, 10)):
        model = replace(MODEL, dt=dt)
        step = StateEstimator(model, FixedPrecision()).online(compiled=False)
        y = 1e8 + samples(steps + 10)
        deaf = sum(np.isnan(step(y=row, u=5e8).innovation[0]) for row in y)
        assert deaf == steps + 1
