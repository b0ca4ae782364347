"""Sensors and stretches of a recording that a diagnosis leaves out, whatever the model."""

import numpy as np
import pytest

from bayesftc.controllers import LinearModel
from bayesftc.controllers.diagnosis.healthy_stretches import after_gaps, contradicted, healthy_stretches, shifted


def samples(sensors, faulty, size=1.0):
    """Return the model of one quantity and samples, of which some sensors drift from sample 100 on."""
    model = LinearModel([[1.0]], [[0.1]], np.ones((sensors, 1)), 1e-4, 0.01, dt=0.1)
    y = 0.1 * np.random.default_rng(0).standard_normal((400, sensors))
    for i in faulty:
        y[100:, i] += (1 + i) * size * np.linspace(0.0, 5.0, 300)
    return model, y


@pytest.mark.parametrize(
    ("sensors", "faulty", "left_out"),
    [
        (4, [0], (0,)),
        (4, [0, 2], (0, 2)),
        (3, [1], (1,)),
        (3, [], ()),
        (2, [0], ()),  # either of two may be faulty
        (3, [0, 1], ()),  # none of three agree
    ],
)
def test_a_sensor_that_others_contradict_for_long_is_left_out(sensors, faulty, left_out):
    assert contradicted(*samples(sensors, faulty)) == left_out


def test_a_short_disagreement_leaves_no_sensor_out():
    model, y = samples(4, [])
    y[100:150, 0] += 5.0
    assert contradicted(model, y) == ()


def test_the_state_is_unknown_after_long_gaps_only():
    y = np.zeros((600, 3))
    y[100:150, 0] = np.nan
    y[200:210, 1] = np.nan
    y[:, 2] = np.nan
    y[::10, 2] = 0.0  # a slow sensor, whose usual distances are no gaps
    assert after_gaps(y) == [150]
    y[310:600, 2] = np.nan
    y[590, 2] = 0.0
    assert after_gaps(y) == [150, 590]


@pytest.mark.parametrize(
    ("offset", "since", "expected"),
    [(1.0, 100, (0, 1)), (1.0, 0, ()), (0.0, 100, ()), (1.0, 300, ())],
    ids=["a jump early", "always off", "healthy", "a jump late"],
)
def test_sensors_that_differ_for_most_of_the_run_but_not_always_have_an_unknown_offset(offset, since, expected):
    """After a late jump the samples that count are those before it, in which the sensors agree."""
    model, y = samples(2, [])
    y[since:, 1] += offset
    assert shifted(model, y) == expected
    assert healthy_stretches(model, y).mean() > 0.5
