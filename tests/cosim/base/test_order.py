"""Times out of order: what is wrong, and what to do."""

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest

from bayesftc.cosim.base.recordings.order import IN_UTC, without_repeats, wrong_order

LOCAL = datetime(2026, 10, 25)


def autumn(minutes):
    """Local times, in seconds of the day, of the night in which clocks are set back from 3:00 to 2:00."""
    clock = pd.date_range("2026-10-24 23:00", periods=240 // minutes, freq=f"{minutes}min", tz="UTC")
    local = clock.tz_convert("Europe/Berlin").tz_localize(None)
    return np.asarray((local - pd.Timestamp(LOCAL)).total_seconds()), clock


@pytest.mark.parametrize("minutes", [1, 10, 30])
def test_a_clock_that_is_set_back_is_told_and_the_named_line_of_pandas_helps(minutes):
    time, clock = autumn(minutes)
    text = wrong_order(time, np.arange(len(time)), LOCAL)
    assert text.startswith("A signal's times go back by an hour: 2026-10-25 02:00:00 follows 2026-10-25 02:")
    assert IN_UTC in text
    assert "Sort" not in text
    table = pd.DataFrame({"Time": (LOCAL + pd.to_timedelta(time, unit="s")).astype(str)})
    assert list(eval(IN_UTC, {"pd": pd, "times": table["Time"]})) == list(clock)


@pytest.mark.parametrize("minutes", [1, 30, 60])
def test_after_sorting_the_hour_that_comes_twice_is_still_told(minutes):
    time = np.sort(autumn(minutes)[0])
    text = wrong_order(time, np.arange(len(time)), LOCAL)
    assert text.startswith("A signal has different samples at 2026-10-25 02:00:00: ")
    assert "the hour that comes twice" in text
    assert IN_UTC in text


@pytest.mark.parametrize("origin", [None, datetime(2026, 10, 25, tzinfo=UTC)])
def test_only_dates_without_an_offset_have_such_an_hour(origin):
    time, _ = autumn(10)
    assert "Sort the recording" in wrong_order(time, np.arange(len(time)), origin)
    assert "hour" not in wrong_order(np.sort(time), np.arange(len(time)), origin)


def test_seconds_made_from_local_times_are_told_if_samples_are_frequent():
    time, _ = autumn(1)
    assert wrong_order(time, time, None).startswith("A signal's times go back by an hour: 7200 s follows 10740 s.")


def test_another_jump_back_is_to_be_sorted():
    time = np.array([0.0, 60.0, 120.0, 60.5, 180.0])
    text = "A signal's times do not increase: 2026-10-25 00:01:00.5 follows 2026-10-25 00:02:00. Sort the recording by time."
    assert wrong_order(time, time, LOCAL) == text
    assert wrong_order(np.arange(5.0), np.zeros(5), LOCAL) == ""


def test_rows_that_are_written_twice_are_told_from_rows_out_of_order():
    time = np.array([0.0, 60.0, 120.0, 180.0, 60.0, 120.0, 180.0, 240.0])
    again = np.array([1.0, 2.0, 3.0, 4.0, 2.0, 3.0, 4.0, 5.0])
    assert wrong_order(time, again, None) == (
        "A signal's rows are written twice: 60 s follows 180 s, with the same samples as before. Leave out the second ones, in "
        "pandas by table.drop_duplicates()."
    )
    assert wrong_order(time[:-1], again[:-1], None) == wrong_order(time, again, None)
    different = np.where(np.arange(8) == 5, 9.0, again)
    assert wrong_order(time, different, None).endswith("Sort the recording by time.")


def test_repeated_samples_count_once_and_different_ones_are_named():
    time, values = np.array([0.0, 1.0, 1.0, 1.0, 2.0]), np.array([5.0, 6.0, 6.0, 6.0, 7.0])
    kept = without_repeats(time, values)
    assert [of.tolist() for of in kept] == [[0.0, 1.0, 2.0], [5.0, 6.0, 7.0], [1.0, 1.0]]
    values[2] = 6.5
    text = wrong_order(*without_repeats(time, values)[:2], None)
    assert text.startswith("A signal has different samples at 1 s: 6 and 6.5. Keep one row for each time")
