"""The weights of samples: low from the onset of a fault to its end, high elsewhere."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesftc.monitoring.healthy import healthy

DT, ROWS = 0.1, 600
MOVING = 10.0 * np.sin(0.05 * np.arange(ROWS))
FAULT = slice(200, 400)


def speeds(sensors, colour=0.0, seed=0):
    noise = np.random.default_rng(seed).standard_normal((sensors, ROWS))
    return MOVING[:, None] + 0.5 * lfilter([np.sqrt(1 - colour**2)], [1, -colour], noise).T


FAULTS = {
    "offset": lambda y: y + 3.0,
    "frozen": lambda y: np.full_like(y, y[0]),
    "noisier": lambda y: y + 5.0 * np.random.default_rng(9).standard_normal(len(y)),
    "drift": lambda y: y + 0.1 * np.arange(len(y)),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("kind", "sensors"),
    # The drift of an only sensor looks like an error of the model, whose walk is as large.
    [(kind, sensors) for kind in FAULTS for sensors in (1, 2, 3) if (kind, sensors) != ("drift", 1)],
)
def test_a_fault_takes_the_weight_of_its_sensor_only(kind, sensors):
    y = speeds(sensors)
    y[FAULT, 0] = FAULTS[kind](y[FAULT, 0])
    weights = healthy(y, MOVING, DT)
    late = slice(FAULT.start + 20, FAULT.stop) if kind == "drift" else FAULT
    assert weights[late, 0].mean() < 0.1
    assert weights[: FAULT.start - 20, 0].mean() > 0.95  # the estimated onset of a drift may be early
    assert weights[FAULT.stop + 10 :, 0].mean() > 0.9
    assert weights[:, 1:].mean() > 0.95 if sensors > 1 else True


@pytest.mark.slow
def test_a_long_fault_is_not_taken_for_a_lasting_error():
    y = speeds(3)
    y[FAULT, 0] += 6.0  # a third of the recording
    assert healthy(y, MOVING, DT)[FAULT, 0].max() < 0.1


def test_coloured_noise_is_no_fault():
    assert healthy(speeds(2, colour=0.8), MOVING, DT).mean() > 0.95


def test_an_error_of_the_model_that_all_sensors_share_is_no_fault():
    walk = 0.1 * np.cumsum(np.random.default_rng(5).standard_normal(ROWS))
    assert healthy(speeds(3) + walk[:, None], MOVING, DT).mean() > 0.95


def test_missing_samples_have_no_weight_and_few_samples_all_of_it():
    y = speeds(3)
    y[100:200, 0] = np.nan
    y[:, 1] = np.nan
    y[:-5, 2] = np.nan
    weights = healthy(y, MOVING, DT)
    np.testing.assert_array_equal(weights[100:200, 0], 0.0)
    np.testing.assert_array_equal(weights[:, 1], 0.0)
    np.testing.assert_array_equal(weights[:, 2], np.isfinite(y[:, 2]))
    assert weights[200:, 0].mean() > 0.9


def test_recordings_without_noise_keep_their_weights():
    assert healthy(np.column_stack([MOVING, MOVING]), MOVING, DT).mean() > 0.9
    assert healthy(np.zeros((ROWS, 1)), np.zeros(ROWS), DT).shape == (ROWS, 1)


def test_a_lasting_fault_has_no_weight_after_a_gap_either():
    rng, rows, gap = np.random.default_rng(1), 1500, slice(300, 600)
    predicted = 10.0 * np.sin(0.05 * np.arange(rows))
    y = predicted[:, None] + 0.5 * rng.standard_normal((rows, 3)) + 0.02 * np.cumsum(rng.standard_normal(rows))[:, None]
    y[FAULT.start :, 0] += 3.0
    y[gap] = np.nan
    weights = healthy(y, predicted, DT)
    assert weights[gap.stop :, 0].mean() < 0.1
    assert weights[gap.stop :, 1:].mean() > 0.9


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(1, 4))
def test_three_sensors_that_agree_are_healthy_though_the_model_wanders_slowly(seed):
    """The walk is far below the noise from step to step, as of a furnace: it is visible over long times alone."""
    rng, rows, fault = np.random.default_rng(seed), 4000, slice(1000, 2000)
    predicted = 10.0 * np.sin(0.005 * np.arange(rows))
    error = lfilter([0.06], [1.0, -0.997], rng.standard_normal(rows))
    y = (predicted + error)[:, None] + rng.standard_normal((rows, 3))
    assert (healthy(y, predicted, DT) < 0.5).mean() < 0.01
    for kind in ("offset", "frozen"):
        faulty = y.copy()
        faulty[fault, 0] = FAULTS[kind](y[fault, 0]) + (kind == "offset")
        weights = healthy(faulty, predicted, DT)
        assert weights[fault, 0].mean() < 0.1
        assert weights[:, 1:].mean() > 0.95
