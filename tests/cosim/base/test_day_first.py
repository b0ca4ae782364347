"""Dates with the day first are read where a day above 12 shows that it is one; all others stay as they are."""

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim, monitoring
from bayesftc.cosim.base.recordings.dates import ISO
from bayesftc.cosim.base.recordings.day_first import day_first_date, iso_of, with_iso_dates
from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.cosim.errors import RecordingError


@pytest.mark.parametrize(
    ("given", "written"),
    [
        (["28.03.2026 08:00:00", "1.4.2026 9:05:00,5"], ["2026-03-28 08:00:00", "2026-04-01 09:05:00.5"]),
        (["01/03/2026T08:00", None, "13/03/2026T08:00"], ["2026-03-01 08:00", None, "2026-03-13 08:00"]),
        (["28-03-2026", "29-03-2026"], ["2026-03-28", "2026-03-29"]),
    ],
)
def test_one_day_above_12_decides_for_all(given, written, caplog):
    caplog.set_level("INFO", "bayesftc")
    read = with_iso_dates(pd.Series(given), "column 'Zeit'")
    assert [None if pd.isna(cell) else cell for cell in read] == written
    assert f"The dates in column 'Zeit' have the day first: {given[0]} is read as {written[0]}." in caplog.text


@pytest.mark.parametrize(
    "cells",
    [
        ["01.03.2026 08:00", "02.03.2026 08:00"],  # the second may be the day
        ["03/28/2026 08:00", "03/29/2026 08:00"],
        ["13.03.2026", "03.13.2026"],
        ["28.03.2026", "29.03.2026", "noon"],
        ["28.03.26", "29.03.26"],
        ["28.03.2026 8:00 PM", "28.03.2026 9:00 PM"],
        ["2026-03-28", "2026-03-29"],
        [1.5, 2.5],
    ],
)
def test_what_can_be_read_in_two_ways_or_is_another_form_stays(cells, caplog):
    caplog.set_level("INFO", "bayesftc")
    given = pd.Series(cells)
    assert with_iso_dates(given, "a column") is given
    assert not caplog.text


@pytest.mark.parametrize("name", ["Zeit", "t"])
def test_files_of_the_monitor_and_of_a_fit_are_read(name, tmp_path):
    file = tmp_path / "tank.csv"
    file.write_text(
        f"{name};a;b\n29.03.2026 00:30:00;1,5;2,5\n29.03.2026 00:30:01;1,6;2,6\n29.03.2026 00:30:03;1,7;2,7\n"
    )
    signals = monitoring.redundant_signals([file])[1]
    np.testing.assert_array_equal(signals["a"].time, [0.0, 1.0, 3.0])
    np.testing.assert_array_equal(signals["a"].values, [1.5, 1.6, 1.7])
    assert str(signals["a"].origin) == "2026-03-29 00:30:00"
    assert cosim.Table.read(file, "b").times == (0.0, 1.0, 3.0)
    assert list(read_table_file(file).columns) == [name, "a", "b"]


@pytest.mark.parametrize(
    ("text", "date"),
    [
        ("13.11.2026 11:30", "2026-11-13 11:30"),
        (" 3.4.2026 1:05:07,5 ", "2026-04-03 01:05:07.5"),  # with points the day is always first
        ("13/11/2026", "2026-11-13"),
        ("03/04/2026 11:30", None),  # could be read in two ways
        ("04/13/2026", None),
        ("2026-11-13 11:30", None),
        ("12.5", None),
    ],
)
def test_one_date_with_the_day_first(text, date):
    assert day_first_date(text) == date


def test_a_refusal_has_the_users_own_date_where_it_is_certain(tmp_path):
    assert iso_of("03/29/2026 08:15 PM") == "2026-03-29 20:15:00"
    assert iso_of("29.03.2026 08:15") == "2026-03-29 08:15:00"
    assert iso_of("01.03.2026 08:15") == iso_of("28-Mär-2026") == iso_of("29.03.2026 08.15 noon") == ISO
    file = tmp_path / "tank.csv"
    file.write_text("t,a,b\n03/29/2026 00:30,1,2\n03/29/2026 00:31,1,2\n")
    with pytest.raises(RecordingError, match=r"Write them as 2026-03-29 00:30:00\."):
        monitoring.redundant_signals([file])
