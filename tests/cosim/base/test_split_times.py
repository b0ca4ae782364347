"""Times in columns of seconds and nanoseconds become one column, wherever a table is read."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from bayesftc import monitoring
from bayesftc.cosim.base.recordings.split_times import joined_times
from bayesftc.cosim.base.recordings.table_files import find_times, read_table_file, times_in


@given(whole=st.lists(st.integers(0, 2**31), min_size=1, max_size=20), rest=st.integers(0, 10**9 - 1))
def test_the_nanoseconds_are_added_to_the_seconds(whole, rest):
    table = pd.DataFrame({"x": 0.0, "stamp.nanosec": rest, "stamp.sec": whole})
    joined, kept = joined_times(table, list(table.columns), "a file")
    assert list(joined.columns) == ["x", "stamp.sec"]
    assert kept == [0, 2]
    np.testing.assert_allclose(joined["stamp.sec"], np.array(whole) + rest * 1e-9, rtol=1e-15)
    assert table["stamp.sec"].tolist() == whole


@pytest.mark.parametrize(
    ("whole", "rest"),
    [("secs", "nsecs"), ("header.stamp.sec", "header.stamp.nanosec"), ("tv_sec", "tv_usec"), ("Sec", "NanoSec")],
)
def test_the_usual_pairs_of_names_are_known(whole, rest):
    table = pd.DataFrame({whole: [1, 2], rest: [5, 6]})
    assert list(joined_times(table, list(table.columns), "a file")[0].columns) == [whole]


@pytest.mark.parametrize(
    ("names", "rest"),
    [
        (("a.sec", "b.nanosec"), [5, 6]),  # of two messages
        (("sec", "nanosec"), [5, 10**9]),  # no part of a second
        (("sec", "nanosec"), ["5", "x"]),
        (("sec", "nanosec"), [5, np.nan]),
        (("sec", "msec"), [5, 6]),
    ],
)
def test_other_columns_stay_as_they_are(names, rest):
    table = pd.DataFrame(dict(zip(names, ([1, 2], rest), strict=True)))
    joined, kept = joined_times(table, names, "a file")
    pd.testing.assert_frame_equal(joined, table)
    assert kept == [0, 1]


def test_rows_without_a_message_have_no_time():
    """As in a table of several messages, each with its own times: the rest of the second was left out of all rows."""
    table = pd.DataFrame({"a.sec": [1.0, np.nan, 2.0], "a.nanosec": [250_000_000, np.nan, 500_000_000]})
    joined, _ = joined_times(table, list(table.columns), "a file")
    np.testing.assert_array_equal(joined["a.sec"], [1.25, np.nan, 2.5])


@pytest.mark.parametrize(("sec", "nanosec"), [("sec", "nanosec"), ("secs", "nsecs")], ids=["ROS 2", "ROS 1"])
def test_a_log_of_ros_is_read_by_recordings_and_tables_alike(tmp_path, sec, nanosec):
    file = tmp_path / "log.csv"
    file.write_text(f"baro,header.stamp.{sec},header.stamp.{nanosec},lidar\n" + "".join(
        f"{k % 3},{1_700_000_000 + k // 4},{k % 4 * 250_000_000},{k % 5}\n" for k in range(20)
    ))  # fmt: skip
    expected = 1.7e9 + 0.25 * np.arange(20)
    _, signals = monitoring.redundant_signals(file)
    assert sorted(signals) == ["baro", "lidar"]
    np.testing.assert_array_equal(signals["lidar"].time, expected)
    table = read_table_file(file)
    name = find_times(table)
    assert name == f"header.stamp.{sec}"
    np.testing.assert_array_equal(times_in(table, name), expected)
