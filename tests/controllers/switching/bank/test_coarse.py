"""Coarse sensors, as encoders: they repeat their samples while the plant is at rest, and a freeze shows once it has moved."""

import numpy as np
import pytest

from bayesftc import controllers

DT, COUNT = 0.01, 0.1
MOVES = {
    "rest": lambda t: 0.0 * t + 0.037,
    "there and back": lambda t: 1.0 + np.tanh(4.0 * np.sin(0.8 * t)) + 0.012,
    "slow": lambda t: 0.05 * t,
    "sine": lambda t: np.sin(t),
}


def said(move, *, noise=0.01, stated=COUNT / 12**0.5, resolution=None, fault=None, sensors=2, process=0.02):
    """Return the fault probabilities (samples x sensors) of encoders of an angle in 16 s; by default any motion is expected."""
    model = controllers.LinearModel(
        [[1.0, DT], [0.0, 1.0]], [[0.0], [0.0]], [[1.0, 0.0]] * sensors, np.diag([1e-12, process]), stated**2, dt=DT
    )
    learner = controllers.SwitchingPrecision()
    if resolution is not None:
        frozen = controllers.Frozen(resolution=resolution)
        learner = controllers.SwitchingPrecision([frozen, *learner.modes[1:]])
    step = controllers.StateEstimator(model, learner, initial_covariance=np.diag([1.0, 1.0])).online()
    rng, probabilities = np.random.default_rng(0), []
    truth = MOVES[move](DT * np.arange(1600))
    for k, x in enumerate(truth):
        y = np.round((x + noise * rng.normal(size=sensors)) / COUNT) * COUNT
        if fault is not None:
            fault(k, y)
        probabilities.append(step(y=y, u=[0.0]).fault_probability)
    return np.array(probabilities)


@pytest.mark.parametrize("move", list(MOVES))
@pytest.mark.parametrize("resolution", [None, COUNT])
@pytest.mark.parametrize(
    ("noise", "stated", "most"),
    [(0.0, COUNT / 12**0.5, 0.005), (0.01, COUNT / 12**0.5, 0.03), (0.05, 0.06, 0.005), (0.01, COUNT, 0.02)],
)
def test_healthy_coarse_sensors_are_not_blamed(move, resolution, noise, stated, most):
    """Two encoders at rest counted as frozen for all of the time, and with their resolution given as well."""
    assert (said(move, noise=noise, stated=stated, resolution=resolution) > 0.5).mean() < most


def test_a_sensor_that_never_changes_beside_a_fine_one_is_frozen():
    """It is not presumed to be coarse, as two encoders at rest are."""
    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=DT)
    step = controllers.StateEstimator(model).online()
    y = 0.1 * np.random.default_rng(0).standard_normal((30, 2))
    y[:, 0] = 0.05
    found = np.array([step(y=sample, u=[0.0]).fault_probability for sample in y])
    assert (found[15:, 0] > 0.95).all()
    assert (found[:, 1] < 0.5).all()


def freeze(k, y, held=[]):  # noqa: B006 - the value at the onset
    if k == 900:
        held[:] = [y[0]]
    if k >= 900:
        y[0] = held[0]


@pytest.mark.parametrize(("sensors", "resolution", "process"), [(2, None, 5e-4), (3, None, 0.02), (3, COUNT, 0.02)])
def test_a_freeze_is_found_once_the_plant_has_moved_by_more_than_a_step(sensors, resolution, process):
    said_of = said("sine", fault=freeze, sensors=sensors, resolution=resolution, process=process)
    moved = np.abs(np.sin(DT * np.arange(900, 1600)) - np.sin(9.0))
    a_step, two_steps = (int(np.argmax(moved > count * COUNT)) for count in (1, 2))
    assert (said_of[:900] > 0.5).mean() < 0.005
    assert (said_of[900 : 900 + a_step // 2, 0] < 0.5).all()
    assert (said_of[900 + two_steps : 1100, 0] > 0.9).all()
    assert (said_of[:, 1:] > 0.5).mean() < 0.05


def test_at_rest_a_jump_is_that_of_the_sensor_that_jumps():
    def jump(k, y):
        y[0] += 0.5 * (k >= 900)

    said_of = said("rest", fault=jump)
    assert (said_of[910:, 0] > 0.9).mean() > 0.95
    assert (said_of[:, 1] > 0.5).mean() < 0.05


@pytest.mark.parametrize("sensors", [1, 2])
def test_a_fine_sensor_that_freezes_in_fast_motion_is_found(sensors):
    """The smallest of its last changes was larger than its noise, so that it counted as a coarse one."""
    model = controllers.LinearModel(
        [[1.0, DT], [0.0, 1.0]], [[0.0], [0.0]], [[1.0, 0.0]] * sensors, np.diag([1e-12, 30.0]), 0.01, dt=DT
    )
    step = controllers.StateEstimator(model, initial_covariance=np.diag([1.0, 1e4])).online()
    rng, held, found = np.random.default_rng(0), 0.0, []
    for k in range(1000):
        y = 100.0 * np.sin(DT * k) + 0.1 * rng.normal(size=sensors)
        held = y[0] if k <= 628 else held
        y[0] = held
        found.append(step(y=y, u=[0.0]).fault_probability)
    found = np.array(found)
    assert (found[:628] > 0.5).mean() < 0.02
    assert (found[635:, 0] > 0.9).all()
    assert (found[:, 1:] > 0.5).sum() < 20


def test_the_step_of_a_coarse_sensor_is_known_again_after_a_fault():
    """One sample of 3e-5 beside the grid made it a fine sensor for good."""

    def off(k, y):
        y[0] += 3e-5 * (k == 300)

    said_of = said("there and back", fault=off, sensors=3)
    assert (said_of[900:] > 0.5).mean() < 0.01


def test_a_sensor_that_is_said_never_to_repeat_itself_is_no_coarse_one():
    """Neither is one whose noise changes its samples at rest, too: this one is frozen there."""
    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-6, 0.01, dt=DT)
    for frozen in (controllers.Frozen(healthy_repeats=0.0), controllers.Frozen()):
        learner = controllers.SwitchingPrecision([frozen, controllers.Offset(), controllers.Unmodelled()])
        step = controllers.StateEstimator(model, learner).online()
        y = 0.1 * np.random.default_rng(0).standard_normal((200, 2))
        y[100:, 0] = y[100, 0]
        last = [step(y=sample, u=[0.0]) for sample in y][-1]
        assert last.fault_probability[0] > 0.99 > 0.5 > last.fault_probability[1]
