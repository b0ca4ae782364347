"""A log that is faster than a sensor repeats its last value; other repetitions are samples."""

import numpy as np
import pytest

from bayesftc.cosim.base.recordings.held import HeldValues, is_held, least_change, without_held
from bayesftc.monitoring import Signal

ROWS = 3000


def held(ratio, seed=0, resolution=0.0, jitter=0.0):
    """Return times and values of a noisy sensor whose last value stands in about `ratio` rows of .02 s."""
    rng = np.random.default_rng(seed)
    rows = np.arange(ROWS) + jitter * rng.uniform(-1, 1, ROWS)
    values = np.sin(np.arange(ROWS) / 200) + 0.1 * rng.standard_normal(ROWS)
    values = values[((np.arange(ROWS) + rng.uniform()) // ratio).astype(int)]
    return 0.02 * rows, np.round(values / resolution) * resolution if resolution else values


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ratio", [2, 2.5, 3.3, 5, 10, 17])
def test_a_slower_sensor_is_recognised(ratio, seed):
    for more in ({}, {"resolution": 0.1}, {"jitter": 0.1}, {"jitter": 0.7}):
        time, values = held(ratio, seed, **more)
        order = np.argsort(time)
        assert is_held(time[order], values, more.get("resolution", 0.0)), more


def test_lost_rows_and_faults_do_not_hide_it():
    time, values = held(10)
    values[1000:1300] = values[999]  # frozen
    values[2000:2200] += 3.0
    there = np.random.default_rng(0).random(ROWS) > 0.05
    assert is_held(time[there], values[there], 0.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])
def test_samples_that_repeat_at_random_are_no_held_ones(share, seed):
    rng = np.random.default_rng(seed)
    fresh = np.flatnonzero((rng.random(ROWS) >= share) | (np.arange(ROWS) == 0))
    values = rng.standard_normal(ROWS)[np.repeat(fresh, np.diff(np.append(fresh, ROWS)))]
    assert not is_held(0.02 * np.arange(ROWS), values, 0.0)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1, 0.3])
def test_a_coarse_sensor_that_repeats_by_chance_is_no_held_one(noise):
    """Without noise the steps of a ramp come at regular intervals."""
    rng = np.random.default_rng(0)
    values = np.round(np.arange(ROWS) / 100 + noise * rng.standard_normal(ROWS))
    assert not is_held(0.02 * np.arange(ROWS), values, 1.0)


def test_few_changes_show_nothing():
    time, values = held(10)
    assert not is_held(time[:150], values[:150], 0.0)
    assert not is_held(time[:1], values[:1], 0.0)
    assert not is_held(time, np.zeros(ROWS), 0.0)


def test_repeated_values_are_left_out_of_a_recording_and_row_by_row_alike():
    values = np.array([1.0, 1.0, 2.0, np.nan, 2.0, 1.0, 1.0])
    watch = HeldValues([True, False])
    again = np.array([watch.repeated(np.array([value, value])) for value in values])
    assert again.tolist() == [[k in (1, 4, 6), False] for k in range(7)]
    there = np.isfinite(values)
    time, fresh = without_held(np.arange(7.0)[there], values[there])
    assert (time.tolist(), fresh.tolist()) == ([0.0, 2.0, 5.0], [1.0, 2.0, 1.0])
    signal = Signal(np.arange(7.0), values, held=True)
    assert [each.tolist() for each in signal.corrected] == [[0.0, 2.0, 5.0], [1.0, 2.0, 1.0]]


def only_changes(values, deadband):
    """Return the values where they differ from the last one kept by more than a deadband, else NaN."""
    kept, last = np.full(len(values), np.nan), np.nan
    for k, value in enumerate(values):
        if not abs(value - last) <= deadband:
            kept[k] = last = value
    return kept


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("resolution", "deadband"), [(0.1, 0.0), (0.1, 0.05), (0.1, 0.25), (0.0, 0.2), (0.001, 0.1)])
def test_a_log_of_changes_is_recognised(seed, resolution, deadband):
    _, values = held(1, seed, resolution)
    found = least_change(np.round(only_changes(values, deadband), 9))
    assert 0.999 * deadband <= found <= 2.0 * max(deadband, resolution)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("resolution", [0.0, 0.001, 0.05, 0.1, 0.2])
@pytest.mark.parametrize("lost", [0.0, 0.1, 0.6])
def test_samples_lost_at_random_are_no_log_of_changes(seed, resolution, lost):
    _, values = held(1, seed, resolution)
    gone = np.random.default_rng(seed).uniform(size=ROWS) < lost
    assert least_change(np.where(gone, np.nan, values)) is None


@pytest.mark.parametrize("ratio", [2, 5, 10])
def test_a_slow_sensor_with_empty_cells_is_no_log_of_changes(ratio):
    for resolution in (0.0, 0.1):
        _, values = held(1, 0, resolution)
        assert least_change(np.where(np.arange(ROWS) % ratio, np.nan, values)) is None
    assert least_change(np.where(np.arange(ROWS) % ratio, np.nan, np.arange(ROWS) * 0.1)) is None  # a clean ramp


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.5])
def test_a_signal_that_moves_in_one_direction_is_no_log_of_changes(noise):
    """A tank that fills, and a counter: they never repeat a value, however many samples are lost."""
    rng = np.random.default_rng(0)
    for steps in (
        np.ones(ROWS),
        1.0 + noise * rng.standard_normal(ROWS),
        rng.integers(1, 4, ROWS),
        np.exp(-np.arange(ROWS) / 500),
    ):
        values = np.cumsum(np.maximum(steps, 0.01))
        assert least_change(np.where(rng.uniform(size=ROWS) < 0.08, np.nan, values)) is None
