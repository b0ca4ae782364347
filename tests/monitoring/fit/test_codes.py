"""Values in place of samples: found where a sensor sends them, and nowhere else."""

import numpy as np
import pytest

from bayesftc.monitoring import Signal, fit_model, recorded
from bayesftc.monitoring.fit.codes import codes

N = 3000


def altitude(seed, sensors=4):
    """Three altimeters, or more, of a vehicle that goes up and down; the last one has the least noise."""
    rng, t = np.random.default_rng(seed), 0.1 * np.arange(N)
    level = 6 + 2.5 * np.sin(2 * np.pi * t / 50) + np.sin(2 * np.pi * t / 17)
    return level[:, None] + rng.standard_normal((N, sensors)) * [*[0.3] * (sensors - 2), 0.8, 0.03]


def recording(y):
    return recorded({f"s{i}": Signal(0.1 * np.arange(N), column.round(3)) for i, column in enumerate(y.T)})


@pytest.mark.sampled(6)
@pytest.mark.parametrize("code", [0.0, -1.0, 65535.0])
@pytest.mark.parametrize("sensors", [2, 3, 4])
@pytest.mark.parametrize("seed", range(3))
def test_a_value_out_of_range_is_found_and_does_not_count_as_noise(seed, sensors, code):
    y = altitude(seed, sensors)
    y[y[:, -1] > 8, -1] = code
    share = np.mean(y[:, -1] == code)
    found = codes(recording(y))
    assert list(found) == [f"s{sensors - 1}"]
    assert found[f"s{sensors - 1}"] == (code, pytest.approx(share, abs=0.01))
    missing = np.where(y == code, np.nan, y)
    expected = [sensor.std for sensor in fit_model(recording(missing)).sensors.values()]
    np.testing.assert_allclose([sensor.std for sensor in fit_model(recording(y)).sensors.values()], expected, rtol=1e-6)


@pytest.mark.parametrize("share", [0.004, 0.01, 0.04])
def test_a_rare_value_that_no_other_sample_is_near_is_a_code(share):
    """As 85.0 of a DS18B20 of hot water: it lies outside by some spans only, and other values of .1 K are more frequent."""
    rng = np.random.default_rng(4)
    y = (50 + altitude(1)).round(1)
    y[rng.random(N) < share, 1] = 85.0
    found = codes(recording(y))
    assert found == {"s1": (85.0, pytest.approx(np.mean(y[:, 1] == 85.0)))}
    wild = np.where(y == 85.0, rng.choice(np.arange(700, 1000), y.shape) / 10, y)  # outliers of any size
    assert codes(recording(wild)) == {}


def frozen(y):
    y[500:900, 0] = y[500, 0]


def coarse(y):
    y[:, 0] = np.round(y[:, 0])


def parked(y):
    y[1000:2500] = 0.0


def drifting(y):
    y[500:, 0] += 0.01 * np.arange(N - 500)


def saturated_once(y):
    y[600:700, 0] = 12.0


@pytest.mark.parametrize("change", [lambda y: None, frozen, coarse, parked, drifting, saturated_once])
def test_what_repeats_otherwise_is_no_code(change):
    for seed in range(5):
        y = altitude(seed)
        change(y)
        assert codes(recording(y)) == {}


@pytest.mark.slow
def test_a_freeze_is_no_code_where_its_value_comes_by_chance_as_well():
    """The quantity jumps up and down while a sensor is frozen; it sends this value at some other times, too, as is usual."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        level = 6 + 2.0 * np.sign(np.sin(2 * np.pi * (np.arange(N) + 0.5) / 1000))
        healthy = level[:, None] + rng.standard_normal((N, 3)) * 0.03
        frozen_, coded = healthy.copy(), healthy.copy()
        frozen_[1495:1800, 0] = frozen_[1494, 0]
        assert np.sum(frozen_[:1400, 0].round(3) == frozen_[1494, 0].round(3)) >= 3
        for share in (1.0, 0.8):  # with or without gaps
            y = np.where(rng.random(frozen_.shape) < share, frozen_, np.nan)
            assert codes(recording(y)) == {}
            assert fit_model(recording(y), slice(0, 1000)).joint
        for begin in (500, 1500, 2500):
            coded[begin : begin + 130, 0] = frozen_[100, 0]  # a value that healthy samples have
        assert list(codes(recording(coded))) == ["s0"]
        assert not fit_model(recording(coded)).joint


@pytest.mark.sampled(1)
@pytest.mark.parametrize("code", [-9999.0, 65535.0, 850.0])
@pytest.mark.parametrize("steps", [slice(900, 910), slice(40, None, 400)])
def test_a_rare_value_far_outside_all_others_is_found_even_once(code, steps):
    for seed in range(3):
        y = altitude(seed)
        clean = fit_model(recording(y)).sensors["s0"].std
        y[steps, 0] = code
        y[2500, 0] = 3 * code  # another outlier is no reason to overlook it
        assert codes(recording(y)) == {"s0": (code, pytest.approx(np.mean(y[:, 0] == code)))}
        assert fit_model(recording(y)).sensors["s0"].std == pytest.approx(clean, rel=0.05)


def shocks(y):
    """All sensors are at rest but for a shock, which the first one clips."""
    y[:] = np.random.default_rng(1).normal(0, 0.01, y.shape)
    y[1000:1060] += 30 * np.sin(np.pi * np.arange(60) / 60)[:, None]
    y[:, 0] = np.minimum(y[:, 0], 16.0)


def stuck_at_the_end(y):
    y[2900:, 0] = 20.0


def one_spike(y):
    y[1500, 0] = -9999.0


@pytest.mark.parametrize("change", [shocks, stuck_at_the_end, one_spike])
def test_clipped_stuck_or_single_values_are_no_code(change):
    y = altitude(1)
    change(y)
    assert codes(recording(y)) == {}
