"""Loads and errors of sensors as further states: in every order of the methods, about an operating point, with delays."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from bayesftc.controllers import FixedPrecision, LinearModel, StateEstimator, design
from bayesftc.controllers.models.disturbances import lagged_loads
from bayesftc.cosim.errors import ModelError

A = np.array([[0.9, 0.1], [-0.05, 0.8]])
B = np.array([[0.2, 0.0], [0.1, 0.3]])
C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
U = np.array([3.0, -1.0])
X = np.linalg.solve(np.eye(2) - A, B @ U)
Y = C @ X + [0.5, 0.5, -2.0]  # with an offset of the readings, as in a linearised plant
PLAIN = LinearModel(A, B, C, 1e-3, 0.01, dt=0.1)

CHANGES = {
    "load": lambda model: model.with_disturbance([1e-4, 1e-2]),
    "error": lambda model: model.with_sensor_errors(0.3, 5.0, sensors=[1]),
    "point": lambda model: model.about(X, U, Y),
    "delay": lambda model: model.with_delays(inputs=[2, 0], sensors=[0, 1, 0]),
}


def changed(order):
    model = PLAIN
    for change in order:
        model = CHANGES[change](model)
    return model


@pytest.mark.parametrize("order", list(permutations(CHANGES)), ids="-".join)
def test_the_order_of_the_methods_does_not_matter(order):
    model, usual = changed(order), changed(CHANGES)
    for name in ("A", "B", "C", "process_covariance", "sensor_covariance"):
        np.testing.assert_array_equal(model.matrix(name), usual.matrix(name))
    assert model.state_names == usual.state_names
    assert model.state_names[-4:] == ("disturbance[0]", "disturbance[1]", "sensor_error[1]", "constant")
    assert (model.disturbances, model.constant, model.operating_control) == (4, True, tuple(U))
    np.testing.assert_array_equal(model.delays.rest, usual.delays.rest)
    np.testing.assert_array_equal(model.quantities, usual.quantities)


@pytest.mark.parametrize("order", [("point", "load", "error"), ("delay", "point", "error", "load")])
def test_it_moves_as_the_plant_written_by_hand(order):
    """Loads act with the control, without its delay; the error adds to its sensor; all about the operating point."""
    model, late = changed(order), "delay" in order
    rng = np.random.default_rng(3)
    loads, error, moves = np.array([0.7, -0.4]), 0.25, rng.standard_normal((30, 2))
    x = StateEstimator(model, FixedPrecision(), initial_mean=X).initial_mean.copy()
    x[-4:-1] = *loads, error
    deviation, read = np.zeros(2), []
    for k in range(30):
        expected = Y + C @ deviation
        expected[1] += error * np.exp(-0.1 * k / 5.0)
        read.append(Y[1] + C[1] @ deviation)
        if late:
            expected[1] += (read[k - 1] if k else Y[1]) - read[k]
        np.testing.assert_allclose(model.matrix("C") @ x, expected, atol=1e-12)
        acting = moves[k].copy()
        if late:
            acting[0] = moves[k - 2, 0] if k >= 2 else 0.0
        x = model.matrix("A") @ x + model.matrix("B") @ (U + moves[k])
        deviation = A @ deviation + B @ (acting + loads)


def test_the_belief_finds_a_load_about_an_operating_point():
    model = changed(["point", "load"])
    step = StateEstimator(model, FixedPrecision(), initial_mean=X).online(compiled=False)
    deviation, load = np.zeros(2), np.array([1.0, -2.0])
    for _ in range(400):
        out = step(y=Y + C @ deviation, u=U)
        deviation = A @ deviation + B @ load
    np.testing.assert_allclose(out.x_hat, [*(X + deviation), *load, 1.0], atol=1e-2)


def test_design_adds_a_load_to_a_given_model():
    settings = {"precision": FixedPrecision(), "acceptable_error": 1.0}
    for goal in (
        [0, 2],
        np.hstack([C[[0, 2]], (Y - C @ X)[[0, 2], None]]),
    ):  # numbers of sensors; rows over the given states
        by_setting = design(changed(["point"]), goal=goal, disturbance=[1e-4, 1e-2], **settings)
        by_method = design(changed(["point", "load"]), goal=[0, 2], **settings)
        np.testing.assert_array_equal(by_setting.model.matrix("A"), by_method.model.matrix("A"))
        np.testing.assert_allclose(by_setting.goal_matrix, by_method.goal_matrix, atol=1e-12)
    assert "2 disturbances" in by_setting.describe()


def test_a_second_load_is_refused():
    with pytest.raises(ModelError, match="already estimates a disturbance of its controls"):
        changed(["load", "error", "point"]).with_disturbance()
    with pytest.raises(ModelError, match="already estimates"):
        design(changed(["load"]), goal=[0, 2], disturbance=1e-3)


def test_a_load_of_true_moves_by_a_share_of_the_acceptable_control_or_of_the_limits():
    model = changed(["point"])
    of_scale = design(
        model, goal=[0, 2], disturbance=True, acceptable_control=[2.0, 5.0], precision=FixedPrecision()
    ).model
    of_limits = design(model, goal=[0, 2], disturbance=True, u_min=-8.0, u_max=12.0, precision=FixedPrecision()).model
    for found, scale in ((of_scale, [2.0, 5.0]), (of_limits, [10.0, 10.0])):
        walks = np.diag(found.matrix("process_covariance"))[
            [found.state_names.index(f"disturbance[{j}]") for j in range(2)]
        ]
        np.testing.assert_allclose(walks, (0.01 * np.array(scale)) ** 2)
    assert (
        design(model, goal=[0, 2], disturbance=False, precision=FixedPrecision()).model.state_names == model.state_names
    )


def test_a_load_of_true_needs_a_scale_and_no_covariance_is_true():
    with pytest.raises(ModelError, match="disturbance=True takes the size of the load from acceptable_control"):
        design(changed(["point"]), goal=[0, 2], disturbance=True)
    for true in (True, np.True_):
        with pytest.raises(ModelError, match="The disturbance's covariance is True; it must be a number"):
            changed(["point"]).with_disturbance(true)
        with pytest.raises(ModelError, match="disturbance=True takes the size"):
            design(changed(["point"]), goal=[0, 2], disturbance=true)


@pytest.mark.parametrize(
    ("change", "loads"),
    [
        ({}, [2]),
        ({"decay": 0.5}, []),  # white noise, nearly
        ({"noise": 0.0}, []),
        ({"effect": 0.0}, []),
        ({"moved": 0.1}, []),  # another tank
        ({"control": 0.1}, []),
        ({"moved": 1e-17, "control": 1e-18}, [2]),  # rounding, as after c2d
        ({"read": 1.0}, []),
    ],
)
def test_a_lagged_load_is_a_state_that_only_its_noise_moves(change, loads):
    values = {"decay": 0.999, "noise": 0.1, "effect": 0.2, "moved": 0.0, "control": 0.0, "read": 0.0, **change}
    A = np.array([[0.9, 0.1, 0.0], [0.05, 0.8, values["effect"]], [values["moved"], 0.0, values["decay"]]])
    C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, values["read"]]])
    model = LinearModel(A, [[0.1], [0.0], [values["control"]]], C, np.diag([0.1, 0.1, values["noise"]]), 0.01, dt=0.1)
    for each in (model, model.with_disturbance(0.1), model.with_delays(inputs=3)):
        assert lagged_loads(each) == loads
        assert lagged_loads(each, measured=True) == ([2] if values["read"] else loads)
