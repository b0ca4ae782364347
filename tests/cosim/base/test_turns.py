"""Angles count on where their samples begin anew, and the faults of their sensors stay as they are."""

import numpy as np
import pytest

from bayesftc.cosim.base.recordings.turns import Turns, find_period


def headings(seed=0, steps=1200):
    """Return three compasses of a ship that turns through north four times, in degrees without a turn left out."""
    rng = np.random.default_rng(seed)
    heading = 60.0 * np.sin(2 * np.pi * np.arange(steps) / (steps / 2))
    return heading[:, None] + [0.3, 1.5, 0.5] * rng.standard_normal((steps, 3))


def placed(y, periods=(360.0, 360.0, 360.0)):
    turns = Turns(periods)
    return np.array([turns.place(row) for row in y])


def turn_of(counted, y):
    """Return by how many degrees all samples are off, which must be whole turns."""
    (off,) = np.unique(np.round(counted - y, 6)[np.isfinite(y)])
    assert off % 360 == 0
    return off


@pytest.mark.parametrize("unit", [1.0, np.pi / 180])
@pytest.mark.parametrize("half", [False, True])
def test_a_jump_by_a_full_turn_is_found(unit, half):
    wrapped = (headings() % 360) * unit
    if half:
        wrapped[:, 2] = (headings()[:, 2] + 180) % 360 * unit - 180 * unit  # from -180 to 180
    assert find_period(wrapped.T) == pytest.approx(360 * unit)
    wrapped[::7, 0] = np.nan
    assert find_period(wrapped.T) == pytest.approx(360 * unit)


def switched(steps=1200, to=350.0):
    rng = np.random.default_rng(0)
    return to * (np.arange(steps) // 100 % 2)[:, None] + rng.standard_normal((steps, 3))


def spiked():
    y = 10 + 0.1 * np.random.default_rng(0).standard_normal((1200, 3))
    y[600, 0] += 360.0
    return y


@pytest.mark.parametrize(
    "y",
    [
        headings(),
        1000 + headings(),
        switched(),
        np.random.default_rng(0).standard_normal((1200, 3)),  # noise that jumps by 2 pi at times
        np.random.default_rng(0).uniform(0, 360, (1200, 3)),
        spiked(),
    ],
    ids=["no jump", "far away", "on and off", "noise", "uniform", "a spike"],
)
def test_what_is_no_angle_stays(y):
    assert find_period(y.T) == 0.0


def test_samples_count_on_through_north_and_faults_stay():
    y = headings()
    y[700:, 0] += 8.0
    y[300:700, 1] = y[299, 1]
    y[400:900, 2] = np.nan
    counted = placed(y % 360)
    assert np.isnan(counted[400:900, 2]).all()
    turn_of(counted, y)


def test_sensors_that_begin_on_both_sides_of_north_agree():
    y = headings()
    half = np.array([0.0, 180.0, 0.0])
    counted = placed((y + half) % 360 - half)
    assert turn_of(counted, y) in (-360.0, 0.0, 360.0)


def test_a_frozen_sensor_repeats_its_sample_while_the_others_turn_round():
    y = 1.0 * np.arange(800)[:, None] + 0.3 * np.random.default_rng(0).standard_normal((800, 3))
    y[100:500, 1] = y[99, 1]
    counted = placed(y % 360)
    np.testing.assert_allclose(counted[:500] - counted[0] + y[0] - y[:500], 0.0, atol=1e-6)
    np.testing.assert_allclose(counted[500:, 1], counted[500:, 0], atol=3.0)  # it is back on the turn of the others


def test_other_quantities_stay():
    y = np.column_stack([headings()[:, 0] % 360, 500 * np.random.default_rng(0).standard_normal(1200)])
    np.testing.assert_array_equal(placed(y, (360.0, 0.0))[:, 1], y[:, 1])
    assert not Turns([0.0, 0.0]).needed
