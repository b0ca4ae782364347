"""Sensors that have moved away from the others: a step or a steady change to the end, and no error that wanders."""

import numpy as np
import pytest

from bayesftc.monitoring.fit.bias import Change, changes, gains, steady_gains, unmoved

NOISE = [1.0, 1.0, 2.5]
STEPS = 3200


def samples(seed):
    """Three sensors of a quantity that moves."""
    rng = np.random.default_rng(seed)
    return np.cumsum(0.1 * rng.standard_normal(STEPS))[:, None] + NOISE * rng.standard_normal((STEPS, 3))


def wandering(seed, std, time_constant):
    """Return a stationary error with this standard deviation, and a time constant in steps."""
    rng, decay, errors = np.random.default_rng(seed), np.exp(-1 / time_constant), [0.0]
    for _ in range(STEPS - 1):
        errors.append(decay * errors[-1] + std * np.sqrt(1 - decay * decay) * rng.standard_normal())
    return np.array(errors)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(301, 305))
@pytest.mark.parametrize(("sensor", "size"), [(0, -8.0), (2, 15.0)])
@pytest.mark.parametrize("sudden", [True, False])
def test_a_change_to_the_end_is_found(seed, sensor, size, sudden):
    y = samples(seed)
    y[1600:, sensor] += size if sudden else size * np.arange(1600) / 1600
    ((moved, change),) = changes(y, NOISE).items()
    assert (moved, change.sudden) == (sensor, sudden)
    assert change.size == pytest.approx(size, rel=0.2)
    assert change.begin == pytest.approx(1600, abs=0 if sudden and sensor == 0 else 300)


@pytest.mark.parametrize("seed", range(301, 305))
@pytest.mark.parametrize("begin", [400, 1600])
def test_another_sensor_that_fails_for_a_while_hides_no_change(seed, begin):
    """A frozen sensor was far from both others; the moved one got its bias from after the change, and was blamed before it."""
    y = samples(seed)
    y[begin:, 1] += 15.0
    y[2000:2250, 2] += 200.0
    ((moved, change),) = changes(y, NOISE).items()
    assert (moved, change.sudden) == (1, True)
    assert change.size == pytest.approx(15.0, rel=0.05)
    assert change.begin == pytest.approx(begin, abs=60)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(301, 305))
@pytest.mark.parametrize("share", [0.0, 0.025, 0.1, 0.2])
def test_an_error_that_wanders_is_no_change(seed, share):
    y = samples(seed)
    if share:
        y[:, 0] += wandering(seed, 4.0, share * STEPS)
    assert changes(y, NOISE) == {}


def test_what_shows_no_single_sensor_or_is_small_is_no_change():
    step = np.where(np.arange(STEPS) < 1600, 0.0, 8.0)
    y = samples(305)
    two = y[:, :2] + np.column_stack([step, 0 * step])
    assert changes(two, NOISE[:2]) == {}  # nobody knows which of two sensors has moved
    assert changes(y + np.outer(step, [1.0, 0.4, 0.0]), NOISE) == {}  # each differs from each
    assert changes(y + np.outer(step, [0.3, 0.0, 0.0]), NOISE) == {}  # 2.4 times its noise
    assert changes(y + np.outer(step, [1.0, 1.0, 1.0]), NOISE) == {}  # motion of the quantity
    ended = step * (np.arange(STEPS) < 2400)
    assert changes(y + np.outer(ended, [1.0, 0.0, 0.0]), NOISE) == {}


def test_the_size_of_a_change_does_not_contain_that_of_another_moved_sensor():
    """Two sensors that moved apart both had the whole distance between them."""
    y = np.random.default_rng(306).standard_normal((STEPS, 4))
    y[1600:] += [10.0, -10.0, 0.0, 0.0]
    found = changes(y, [1.0] * 4)
    assert found.keys() == {0, 1}
    assert found[0].size == pytest.approx(10.0, rel=0.1)
    assert found[1].size == pytest.approx(-10.0, rel=0.1)


@pytest.mark.parametrize(
    ("sudden", "stretch", "healthy"),
    [
        (True, slice(None), slice(0, 500)),
        (True, slice(0, 400), slice(0, 500)),
        (True, slice(600, 1000), slice(500, 1000)),  # a sensor that was cleaned
        (False, slice(600, 1000), slice(0, 1000)),  # the user says that it is healthy there
        (False, slice(480, 1000), slice(0, 1000)),  # too few samples before it in the stretch
    ],
)
def test_the_healthy_part_of_a_moved_sensor_is_that_of_the_stretch(sudden, stretch, healthy):
    y = np.zeros((1000, 3))
    kept = unmoved(y, {1: Change(5.0, 500, sudden)}, stretch)
    expected = np.full(1000, np.nan)
    expected[healthy] = 0.0
    np.testing.assert_array_equal(kept, np.column_stack([y[:, 0], expected, y[:, 2]]))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("begin", "length"), [(1000, 800), (1600, 600)])
def test_a_change_that_grows_and_then_stays_has_its_beginning(seed, begin, length):
    y = np.random.default_rng(seed).normal(size=(4000, 4)) * 0.3
    y[:, 0] += np.clip((np.arange(4000) - begin) / length, 0, 1) * 3.0
    ((moved, change),) = changes(y, [0.3] * 4).items()
    assert (moved, change.sudden) == (0, True)
    assert begin - 130 <= change.begin <= begin + 70  # parts have 62 samples
    assert begin + length - 190 <= change.reached <= begin + length + 130
    step = y.copy()
    step[:, 0] = np.random.default_rng(seed).normal(size=4000) * 0.3 + 3.0 * (np.arange(4000) >= begin)
    (change,) = changes(step, [0.3] * 4).values()
    assert change.reached is None
    assert change.begin == pytest.approx(begin, abs=70)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sensors", [2, 3, 4])
def test_a_gain_is_found_and_offsets_and_drifts_are_none(seed, sensors):
    rng, t = np.random.default_rng(seed), np.arange(20000)
    level = 12 + 2.5 * np.sin(2 * np.pi * t / 1440)
    y = level[:, None] + 0.1 * rng.normal(size=(len(t), sensors))
    noise = [0.1] * sensors
    assert gains(y, noise) == {}
    assert gains(y + np.outer(t / 20000, [0.3] + [0.0] * (sensors - 1)), noise) == {}
    y[19500:, 0] -= 0.8
    assert gains(y, noise) == {}
    y[:, 1] += 0.02 * level
    assert gains(y, noise) == {1: pytest.approx(0.02, rel=0.25)}


@pytest.mark.parametrize("sensors", [2, 3])
def test_a_gain_of_one_half_is_none(sensors):
    rng, t = np.random.default_rng(0), np.arange(20000)
    level = 12 + 2.5 * np.sin(2 * np.pi * t / 1440)
    y = level[:, None] + 0.1 * rng.normal(size=(len(t), sensors))
    noise = [0.1] * sensors
    y[:13000, 1] += 0.05 * level[:13000]
    assert gains(y, noise)
    assert steady_gains(y, noise) == {}
    y[13000:, 1] += 0.05 * level[13000:]
    assert steady_gains(y, noise) == {1: pytest.approx(0.05, rel=0.2)}
