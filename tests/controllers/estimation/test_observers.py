"""Observers of a model at the limits of rounding."""

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import solve_discrete_are

from bayesftc import controllers, cosim
from bayesftc.controllers.estimation import observers as observer_module
from bayesftc.controllers.estimation.observers import observers


@pytest.mark.parametrize("pole", [0.999, 1.5, 1e6, 1e9, 1e18, 1e30])
def test_a_pole_of_any_size_gives_finite_observers_or_none(pole):
    model = controllers.LinearModel(
        [[pole]], [[2e-4]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
    )
    found = observers(model)
    if found is None:
        assert pole > 1e6
    else:
        assert np.isfinite(found.gain).all()
        assert np.abs(np.linalg.eigvals(model.matrix("A") - found.gain[0] @ model.matrix("C"))).max() < 1.0


def test_a_noise_that_rounding_loses_gives_none():
    """Two equal sensors: of their innovations' covariance P [[1, 1], [1, 1]] + R only the first part is left."""
    model = controllers.LinearModel(
        [[1e18]], [[2e-4]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
    )
    assert observers(model, ((0, 1),)) is None


def test_an_unseen_slow_mode_does_not_dull_what_is_seen():
    """No noise helps an observer to forget a mode that its sensors do not see; its innovations still have variance 1."""
    A = np.array([[0.99, 0.1, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.9999]])
    model = controllers.LinearModel(
        A, np.zeros((3, 1)), [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], np.diag([0, 1e-4, 1e-6]), 0.01, 0.1
    )
    bank = observer_module.observers(model, ((0,), (1,)))
    assert observer_module._remembers(model.matrix("A"), model.matrix("C")[:1])
    assert not observer_module._remembers(model.matrix("A"), model.matrix("C")[1:])
    np.testing.assert_array_equal(bank.noise[0], model.matrix("process_covariance"))
    assert bank.settling > observer_module.LONGEST_REST
    rng, x, z, white = np.random.default_rng(0), np.zeros(3), np.zeros(3), []
    for _ in range(4000):
        e = (x[0] + 0.1 * rng.standard_normal() - z[0]) * np.array([1.0, 0.0])
        white.append((bank.whiten[0] @ e)[0])
        z = A @ z + bank.gain[0] @ e
        x = A @ x + np.array([0.0, 1e-2, 1e-3]) * rng.standard_normal(3)
    assert np.var(white) == pytest.approx(1.0, abs=0.1)


@settings(max_examples=20)
@given(length=st.floats(-6.0, 6.0), speed=st.floats(-6.0, 6.0), driven=st.booleans())
def test_the_units_of_states_and_sensors_change_nothing(length, speed, driven):
    """A slide that nothing but its control disturbs, by precise encoders: noise of one size for all states hid all errors."""
    A, B = np.array([[1.0, 0.02], [0.0, 0.999]]), np.array([[0.0], [0.02]])
    Q = 1e-16 * B @ B.T if driven else np.zeros((2, 2))
    there = np.diag([10.0**length, 10.0**speed])
    back, R = np.linalg.inv(there), 1e-10
    C = np.array([[1.0, 0.0], [1.0, 0.0]])
    plain = observers(controllers.LinearModel(A, B, C, Q, R, dt=0.02))
    size = there[0, 0]
    in_units = observers(
        controllers.LinearModel(there @ A @ back, there @ B, size * C @ back, there @ Q @ there, R * size**2, dt=0.02)
    )
    assert plain.settling <= observer_module.LONGEST_REST
    assert abs(in_units.settling - plain.settling) <= 1
    np.testing.assert_allclose(in_units.whiten * size, plain.whiten, rtol=1e-4)
    np.testing.assert_allclose(back @ in_units.noise @ back, plain.noise, rtol=1e-2, atol=1e-3 * plain.noise.max())
    assert 0.9 < plain.whiten[0, 0, 0] * 1e-5 <= 1.0  # the innovations hardly exceed the sensors' own noise


def test_a_fading_memory_is_an_ordinary_filter_with_more_noise():
    model = controllers.LinearModel([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], [[1.0, 0.0]], 1e-14, 0.01, dt=0.1)
    bank = observers(model)
    P = solve_discrete_are(model.A.T, model.C.T, bank.noise[0], model.matrix("sensor_covariance"))
    S = model.C @ P @ model.C.T + 0.01
    np.testing.assert_allclose(bank.gain[0], model.A @ P @ model.C.T / S, rtol=1e-6)
    np.testing.assert_allclose(bank.whiten[0], 1.0 / np.sqrt(S), rtol=1e-6)


def test_sensors_that_read_a_multiple_of_the_same_are_divided_among_the_sets():
    """An altitude of a floor is the depth but for its sign and a constant: a third vote on it."""
    A, B, C = np.array([[1.0, 0.1], [0.0, 0.9]]), [[0.0], [0.1]], [[1.0, 0.0], [1.0, 0.0], [-2.0, 0.0], [0.0, 1.0]]
    model = controllers.LinearModel(A, B, C, 1e-4, 0.01, dt=0.1)
    assert model.alike == ((0, 1), (2,), (3,))
    assert model.proportional == ((0, 1, 2), (3,))
    placed = model.about([5.0, 0.0], [0.0], [5.0, 5.0, 30.0, 0.0])
    assert placed.proportional == model.proportional
    assert [set(chosen) & {0, 1, 2} for chosen in observers(placed).sensors] == [{0}, {1}, {2}]
    delayed = model.with_delays([0], [0, 0, 3, 0])
    assert delayed.proportional == model.proportional


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e3, 1e5, 1e7])
def test_the_units_of_states_do_not_decide_what_is_proportional(unit):
    row = np.array([0.37, 0.91 * unit])
    C = [row, -2.3 * row, 3.0 * row, row * [1.0, 1.01], [0.0, unit]]
    model = controllers.LinearModel(np.eye(2) * 0.9, [[1.0], [0.0]], C, 1e-4, 0.01, dt=0.1)
    assert model.proportional == ((0, 1, 2), (3,), (4,))
    blind = controllers.LinearModel(np.eye(2) * 0.9, [[1.0], [0.0]], [row, [0.0, 0.0]], 1e-4, 0.01, dt=0.1)
    assert blind.proportional == ((0,), (1,))


@pytest.mark.parametrize("factor", [1.0, -1.0, 2.0])
def test_two_faults_beside_a_proportional_sensor_are_no_wrong_model(factor):
    std, measured = [0.05, 0.1, 0.2, 0.01, 0.02], ["depth", "altitude", "rate"]
    C = [[1, 0], [factor, 0], [0, 1]]
    plant = control.ss([[0, 1], [0, -0.5]], [[0], [1]], C, 0, inputs=["push"], outputs=measured)
    controller = controllers.design(
        plant, dt=0.1, measured=measured, actuated="push", sensors=[2, 1, 2], sensor_std=std, goal="depth",
        acceptable_error=0.5, acceptable_control=0.2,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="push", measured=measured, sensors=cosim.Sensors([2, 1, 2], std),
        faults=[cosim.Drift(sensor=0, start=20.0, slope=0.05), cosim.Freeze(sensor=1, start=30.0)],
        reference=cosim.Sine(2.0, 40.0),
    )  # fmt: skip
    run = loop.simulate(60.0, seed=1)
    assert (run["controller.fault_probability"][-1] > 0.9).tolist() == [True, True, False, False, False]
    assert run["controller.model_suspect"].max() < 0.2
