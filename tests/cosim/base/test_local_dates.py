"""Dates with day or month first are read where points, or a number above 12, show which is the day; others stay as they are."""

import re

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim, monitoring
from bayesftc.cosim.base.recordings.dates import ISO
from bayesftc.cosim.base.recordings.local_dates import day_first_date, iso_of, with_iso_dates
from bayesftc.cosim.base.recordings.split_times import joined_times
from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.cosim.errors import RecordingError


@pytest.mark.parametrize(
    ("given", "written"),
    [
        (["28.03.2026 08:00:00", "1.4.2026 9:05:00,5"], ["2026-03-28 08:00:00", "2026-04-01 09:05:00.5"]),
        (["01/03/2026T08:00", None, "13/03/2026T08:00"], ["2026-03-01 08:00", None, "2026-03-13 08:00"]),
        (
            ["01.03.2026 08:00", "2.3.2026 08:00"],
            ["2026-03-01 08:00", "2026-03-02 08:00"],
        ),  # with points the day is first
        (["01.03.26 08:00", "02.03.26 08:00"], ["2026-03-01 08:00", "2026-03-02 08:00"]),
        (["28-03-2026", "29-03-2026"], ["2026-03-28", "2026-03-29"]),
        (["28.03.2026 8:00 PM", "28.03.2026 12:05 am"], ["2026-03-28 20:00", "2026-03-28 00:05"]),
        (["28.03.26 8:00", "1.4.26 8:00"], ["2026-03-28 08:00", "2026-04-01 08:00"]),
        (["31.12.99 13:00 PM", "1.1.00 0:05 AM"], ["1999-12-31 13:00", "2000-01-01 00:05"]),
        (["28.03.68", "28.03.68"], ["2068-03-28", "2068-03-28"]),
        (["3/28/26 8:00", "3/28/26 9:00"], ["2026-03-28 08:00", "2026-03-28 09:00"]),
        (["2026-03-28 8:00:01 PM", "2026-03-28 12:05 am"], ["2026-03-28 20:00:01", "2026-03-28 00:05"]),
        (["2026/3/8 8:00", "2026/03/28 23:05"], ["2026-03-08 08:00", "2026-03-28 23:05"]),
        (["3/28/2026 12:30:01 PM", "4/1/2026 1:30 a.m."], ["2026-03-28 12:30:01", "2026-04-01 01:30"]),
    ],
)
def test_one_day_above_12_decides_for_all(given, written, caplog):
    caplog.set_level("INFO", "bayesftc")
    read = with_iso_dates(pd.Series(given), "column 'Zeit'")
    assert [None if pd.isna(cell) else cell for cell in read] == written
    which = "month" if given[0].startswith("3/") else "year" if given[0].startswith("2026") else "day"
    assert f"The dates in column 'Zeit' have the {which} first: {given[0]} is read as {written[0]}." in caplog.text


@pytest.mark.parametrize(
    "cells",
    [
        ["01/03/2026 08:00", "02/03/2026 08:00"],  # the second may be the day
        ["01-03-2026 08:00", "02-03-2026 08:00"],
        ["01.03.2026", "02/03/2026"],
        ["03/04/2026 08:00 AM", "03/05/2026 08:00 AM"],
        ["13.03.2026", "03.13.2026"],
        ["28.03.2026", "29.03.2026", "noon"],
        ["26.03.28", "26.03.29"],  # the year may be first
        ["28.03.26 8:00", "28.03.26 9:00"],
        ["31.12.25", "31.12.26"],
        ["28-03-26", "29-03-26"],
        ["28.03.2026 8:00 AM", "28.03.2026 13:00 AM"],
        ["2026-03-28 8:00 AM", "2026-13-28 8:00 AM"],
        ["28.03.2026 8:00 h", "28.03.2026 9:00 h"],
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
        ("13.11.26 11:30", "2026-11-13 11:30"),
        ("28.3.99", "1999-03-28"),
        ("03/04/2026 11:30", None),  # could be read in two ways
        ("04/13/2026", None),
        ("13.11.2026 11:30 PM", None),
        ("2026-11-13 11:30", None),
        ("12.5", None),
    ],
)
def test_one_date_with_the_day_first(text, date):
    assert day_first_date(text) == date


def test_a_refusal_has_the_users_own_date_where_it_is_certain(tmp_path):
    assert iso_of("03/29/2026 08:15 PM") == "2026-03-29 20:15:00"
    assert iso_of("29.03.2026 08:15") == "2026-03-29 08:15:00"
    assert iso_of("01.03.2026 08:15") == "2026-03-01 08:15:00"
    assert iso_of("01/03/2026 08:15") == iso_of("28-Mär-2026") == iso_of("29.03.2026 08.15 noon") == ISO
    file = tmp_path / "tank.csv"
    file.write_text("t,a,b\n03/29/2026 00:30 +01:00,1,2\n03/29/2026 00:31 +01:00,1,2\n")
    with pytest.raises(
        RecordingError, match=r"of ISO 8601. Write them as 2026-03-29 00:30:00, for example with pandas"
    ):
        monitoring.redundant_signals([file])


def test_a_refusal_says_that_no_number_shows_the_day(tmp_path):
    file = tmp_path / "tank.csv"
    rows = "".join(f"03/0{k}/2026 00:30,{k},2\n" for k in range(1, 9))
    file.write_text(f"t,a,b\n{rows}")
    why = "such as '03/01/2026 00:30', are not in the form of ISO 8601, and no number above 12 shows whether the day or the month"
    with pytest.raises(RecordingError, match=re.escape(why)):
        monitoring.redundant_signals([file])
    file.write_text(f"t,a,b\n{rows}03/13/2026 00:30,9,2\n")
    assert str(monitoring.redundant_signals([file])[1]["a"].origin) == "2026-03-01 00:30:00"


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        ("Date,Time,a,b", ["2026-03-29,08:00:0{0},1.{0},2"]),
        ("Time,Date,a,b", ["08:00:0{0},2026-03-29,1.{0},2"]),
        ("Datum;Uhrzeit;a;b", ["29.03.2026;8:00:0{0};1,{0};2,0"]),
        ("day,clock,a,b", ["3/29/2026,8:00:0{0} AM,1.{0},2"]),
    ],
)
def test_a_date_and_a_time_of_the_day_in_two_columns_are_one_time(names, rows, tmp_path, caplog):
    caplog.set_level("INFO", "bayesftc")
    file = tmp_path / "log.csv"
    file.write_text("\n".join([names, *(row.format(k) for k in range(5) for row in rows)]) + "\n")
    signals = monitoring.redundant_signals([file])[1]
    np.testing.assert_array_equal(signals["a"].time, range(5))
    np.testing.assert_allclose(signals["a"].values, 1 + 0.1 * np.arange(5))
    assert str(signals["a"].origin) == "2026-03-29 08:00:00"
    assert set(signals) == {"a", "b"}
    assert "are read together as dates with times of the day" in caplog.text
    assert len(read_table_file(file).columns) == 3


def test_a_time_of_the_day_without_a_date_or_beside_whole_dates_is_left_alone(tmp_path):
    whole = pd.DataFrame({"when": ["2026-03-29 08:00", "2026-03-29 08:01"], "start": ["07:00", "07:00"]})
    none = pd.DataFrame({"clock": ["08:00", "08:01"], "a": [1.0, 2.0]})
    for table in (whole, none):
        assert joined_times(table, list(table.columns), "a file")[1] == [0, 1]


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "utf-16", "utf-16-be", "utf-8", "utf-8-sig"])
def test_files_of_loggers_have_other_encodings(encoding, tmp_path, caplog):
    caplog.set_level("INFO", "bayesftc")
    file = tmp_path / "log.csv"
    text = "time,Außen [°C],Küche [°C]\n" + "".join(f"{k},20.{k},21.{k}\n" for k in range(5))
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    file.write_bytes(mark + text.encode(encoding))
    signals = monitoring.redundant_signals([file])[1]
    assert list(signals) == ["Außen [°C]", "Küche [°C]"]
    assert signals["Außen [°C]"].unit == "°C"
    assert list(read_table_file(file).columns) == ["time", "Außen [°C]", "Küche [°C]"]
    assert ("is read as Windows-1252" in caplog.text) == (encoding in {"latin-1", "cp1252"})


@pytest.mark.parametrize(
    "content", [b"time,a\n0,1\n\x00\x81", b"\xff\xfe\x00", b"time,a\n0,\x81\n", b"PK\x03\x04\x00\xff"]
)
def test_what_is_no_text_is_refused(content, tmp_path):
    file = tmp_path / "log.csv"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"log\.csv"):
        monitoring.redundant_signals([file])
    with pytest.raises(RecordingError, match=r"log\.csv"):
        read_table_file(file)
