"""Recordings at evenly spaced steps: gaps, uneven times, held inputs."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim
from bayesftc.cosim.fitting.samples import sample

NAN = np.nan


def test_rows_go_to_the_nearest_step_and_nothing_is_interpolated():
    table = pd.DataFrame(
        {"time": [5.0, 5.11, 5.19, 5.21, 5.5], "u": [1.0, NAN, 2.0, NAN, 3.0], "y": [10.0, 11.0, 12.0, NAN, 15.0]}
    )
    samples = sample(table, {"in": "u"}, {"out": "y"}, "time", 0.1)
    assert samples.step == Fraction(1, 10)
    np.testing.assert_allclose(samples.time, 5.0 + 0.1 * np.arange(6))
    np.testing.assert_array_equal(samples.y[:, 0], [10, 11, 12, NAN, NAN, 15])  # the row at 5.21 s has no sample
    np.testing.assert_array_equal(samples.inputs["in"][:, 0], [1, 1, 2, 2, 2, 3])


def test_without_times_there_is_a_row_for_each_step():
    samples = sample(pd.DataFrame({"y": [1.0, 2.0]}), (), "y", "time", "1/30")
    assert samples.step == Fraction(1, 30)
    assert samples.start == 0.0
    np.testing.assert_array_equal(samples.y, [[1], [2]])


def test_sensors_belong_to_their_outputs():
    table = pd.DataFrame({"time": [0.0, 0.5, 1.0], **{name: [1.0, 2.0, 3.0] for name in "abc"}})
    samples = sample(table, (), {"first": ["a", "b"], "second": "c"}, "time", None)
    assert samples.columns == ("a", "b", "c")
    np.testing.assert_array_equal(samples.output_of, [0, 0, 1])


@pytest.mark.parametrize(
    ("times", "dt", "error", "words"),
    [
        ([0.0, 0.1, 0.3], None, cosim.StepSizeError, "not evenly spaced"),
        ([0.0, 0.2, 0.1], 0.1, cosim.StepSizeError, "do not increase"),
        ([0.0, 0.1, NAN], 0.1, cosim.StepSizeError, "do not increase"),
        ([0.0, 1e9, 2e9], 1e-3, cosim.RecordingError, "in seconds"),
        ([0.0, 0.1, 0.2], 10.0, cosim.RecordingError, "smaller dt"),
    ],
)
def test_times_that_cannot_be_used_are_refused(times, dt, error, words):
    with pytest.raises(error, match=words):
        sample(pd.DataFrame({"time": times, "y": 1.0}), (), "y", "time", dt)
