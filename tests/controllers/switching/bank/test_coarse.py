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


def said(move, **settings):
    """Return the fault probabilities (samples x sensors) of `watched`."""
    return np.array([out.fault_probability for out in watched(move, **settings)])


def watched(
    move, *, noise=0.01, stated=COUNT / 12**0.5, count=COUNT, resolution=None, fault=None, sensors=2, process=0.02
):
    """Return the outputs of an estimator of encoders of an angle in 16 s; by default any motion is expected."""
    model = controllers.LinearModel(
        [[1.0, DT], [0.0, 1.0]], [[0.0], [0.0]], [[1.0, 0.0]] * sensors, np.diag([1e-12, process]), stated**2, dt=DT
    )
    learner = controllers.SwitchingPrecision()
    if resolution is not None:
        frozen = controllers.Frozen(resolution=resolution)
        learner = controllers.SwitchingPrecision([frozen, *learner.modes[1:]])
    step = controllers.StateEstimator(model, learner, initial_covariance=np.diag([1.0, 1.0])).online()
    rng, outs = np.random.default_rng(0), []
    truth = MOVES[move](DT * np.arange(1600))
    for k, x in enumerate(truth):
        y = np.round((x + noise * rng.normal(size=sensors)) / count) * count
        if fault is not None:
            fault(k, y)
        outs.append(step(y=y, u=[0.0]))
    return outs


@pytest.mark.parametrize("move", list(MOVES))
@pytest.mark.parametrize("resolution", [None, COUNT])
@pytest.mark.parametrize(
    ("noise", "stated", "most"),
    [(0.0, COUNT / 12**0.5, 0.005), (0.01, COUNT / 12**0.5, 0.005), (0.05, 0.06, 0.005), (0.01, COUNT, 0.02)],
)
def test_healthy_coarse_sensors_are_not_blamed(move, resolution, noise, stated, most):
    """Two encoders at rest counted as frozen for all of the time, and with their resolution given as well."""
    if (move, resolution, stated) == ("slow", None, COUNT):
        most = 0.06  # of all these cases the one of the page: noise stated as a whole step, whose size is not known
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


@pytest.mark.parametrize("beside", [3e-5, COUNT / 4, COUNT / 5, COUNT / 10, COUNT / 100])
def test_the_step_of_a_coarse_sensor_is_known_again_after_a_fault(beside):
    """One sample beside the grid made it a fine sensor for good."""

    def off(k, y):
        y[0] += beside * (k == 300)

    said_of = said("there and back", fault=off, sensors=3)
    assert (said_of[900:] > 0.5).mean() < 0.01


@pytest.mark.parametrize(
    "rounded", [lambda y: np.float32(y), lambda y: np.round(y, 3)], ids=["single precision", "decimals"]
)
def test_samples_on_a_grid_may_be_rounded_further(rounded):
    """An encoder of 1024 counts a turn, in degrees, with three decimals, was blamed for a fifth of the time."""
    count = 360 / 1024

    def round_again(k, y):
        y[:] = rounded(y)

    settings = {"noise": 0.1 * count, "stated": count / 12**0.5, "count": count, "process": 0.02 * (10 * count) ** 2}
    assert (said("there and back", fault=round_again, **settings) > 0.5).mean() < 0.005


@pytest.mark.parametrize(("count", "latest"), [(0.1, 20), (0.15, 30), (0.2, 60)])
def test_noise_of_half_a_step_shows_a_freeze_also_at_rest(count, latest):
    """A repetition was said to tell nothing of a freeze, and the healthy sensor was blamed instead."""
    settings = {"noise": 0.1, "stated": (0.01 + count**2 / 12) ** 0.5, "count": count}
    said_of = said("sine", fault=freeze, **settings)
    assert (said_of[:900] > 0.5).mean() < 0.005
    assert (said_of[900 + latest :, 0] > 0.5).all()
    assert (said_of[900:, 1] > 0.5).mean() < 0.05


def test_the_freeze_of_a_coarse_sensor_has_its_name():
    """It was `Unmodelled`: the hypothesis of a freeze came too late."""
    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 4e-4, [6e-5, 6e-5, 4e-4], dt=0.02)
    step = controllers.StateEstimator(model).online()
    rng, x, held, last = np.random.default_rng(1), 0.0, 0.0, None
    for k in range(1000):
        x += 0.02 * rng.normal()
        y = np.array([*np.round((x + 0.005 * rng.normal(size=2)) / 0.02) * 0.02, x + 0.02 * rng.normal()])
        held = y[0] if k < 600 else held
        y[0] = held
        last = step(y=y, u=[0.0])
    assert last.mode_probability[0, 1] > 0.99
    assert 595 < last.fault_onset[0] / 0.02 < 610
    assert (last.fault_probability[1:] < 0.1).all()


def test_encoders_at_rest_beside_a_fine_sensor_of_another_kind_are_not_blamed():
    """It had shown that it is fine; so they were no longer presumed to be coarse."""
    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-5, [3.4e-5, 3.4e-5, 1e-4], dt=0.02)
    blamed = 0
    for seed in range(20):
        step = controllers.StateEstimator(model).online()
        rng = np.random.default_rng(seed)
        for _ in range(100):
            out = step(y=[0.0, 0.0, 0.01 * rng.normal()], u=[0.0])
            blamed += (out.fault_probability[:2] > 0.5).sum()
    assert blamed == 0


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
