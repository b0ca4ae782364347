"""CSV files with other separators, decimal commas and dates, wherever a recording is read."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim, monitoring
from bayesftc.cosim.base.recordings.csv_form import CsvForm, form_of
from bayesftc.cosim.base.recordings.dates import date_at, seconds_of, span_text, time_text
from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.cosim.errors import RecordingError

TIMES = [0.0, 0.5, 1.0, 1.5]
LEFT = [1.25, 2.5, -0.75, 1e-3]
RIGHT = [1.0, 2.0, 3.0, 4.0]
DATES = ["2026-05-01T10:00:00", "2026-05-01T10:00:00.5", "2026-05-01T10:00:01", "2026-05-01T10:00:01.5"]


def write(path, separator=",", decimal=".", times=TIMES, names=("t", "left", "right")):
    rows = [map(str, row) for row in zip(times, LEFT, RIGHT, strict=True)]
    lines = [separator.join(names), *(separator.join(cell.replace(".", decimal) for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ","), ("|", ".")]
)
@pytest.mark.parametrize("times", [TIMES, DATES])
def test_every_reader_reads_every_form(separator, decimal, times, tmp_path):
    file = write(tmp_path / "drive.csv", separator, decimal, times)
    assert form_of(file) == CsvForm(separator, decimal)
    table = read_table_file(file)
    signals = monitoring.redundant_signals(str(file))[1]  # one path needs no list
    source = cosim.Table.read(file, "left")
    for found in (table["t"], signals["left"].time, source.times):
        np.testing.assert_array_equal(found, TIMES)
    for found in (table["left"], signals["left"].values, source.values):
        np.testing.assert_array_equal(found, LEFT)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("t,a;b\n0,1\n", CsvForm()),  # a name with a semicolon
        ("t;a\n0;1\n0,5;2\n", CsvForm(";", ",")),  # whole numbers first
        ("t;a\n0.5;1\n", CsvForm(";")),
        ("t;a,b\n0;1\n", CsvForm(";")),  # a name with a comma
        ("t;a\n", CsvForm(";")),
        ('"t";"a, in m"\n0;"1,5"\n', CsvForm(";", ",")),
        ("t,a\n0,1\n1\n", CsvForm()),  # a row that is too short
        ("t\n0\n", CsvForm()),
    ],
)
def test_the_form_is_found_from_all_rows(text, form, tmp_path):
    file = tmp_path / "drive.csv"
    file.write_text(text)
    assert form_of(file) == form


@pytest.mark.parametrize("separator", [",", ";"])
@pytest.mark.parametrize("above", ["# logger 3, robot 7\n", "# logger; 3\n\n#\n"])
def test_comments_may_stand_above_the_names(above, separator, tmp_path):
    file = write(tmp_path / "drive.csv", separator)
    file.write_text(above + file.read_text())
    assert form_of(file).separator == separator
    np.testing.assert_array_equal(read_table_file(file)["left"], LEFT)
    np.testing.assert_array_equal(cosim.Table.read(file, "left").values, LEFT)
    signals = monitoring.redundant_signals(file)[1]
    np.testing.assert_array_equal(signals["left"].time, TIMES)
    np.testing.assert_array_equal(signals["right"].values, RIGHT)


def test_names_may_begin_with_the_sign_of_a_comment(tmp_path):
    file = write(tmp_path / "drive.csv", names=("#t", "left", "right"))
    file.write_text("# logger 3\n" + file.read_text())
    assert list(read_table_file(file).columns) == ["#t", "left", "right"]


def test_other_lines_above_the_names_are_refused_with_the_remedy(tmp_path):
    file = write(tmp_path / "drive.csv")
    file.write_text("logger 3\n" + file.read_text())
    with pytest.raises(RecordingError, match="begin each with #, or delete it"):
        monitoring.redundant_signals(file)


def test_an_unusual_file_is_announced_once(tmp_path, caplog):
    file = write(tmp_path / "drive.csv", ";", ",", DATES)
    for _ in range(2):
        read_table_file(file)
    lines = [record.getMessage() for record in caplog.records]
    assert [line.replace(str(file), "drive.csv") for line in lines] == [
        "drive.csv is read with semicolons between its columns and decimal commas.",
        "The dates in column 't' of drive.csv are read as seconds from 2026-05-01 10:00:00.",
    ]
    read_table_file(write(tmp_path / "usual.csv"))
    assert len(caplog.records) == len(lines)


def test_files_with_dates_have_one_origin(tmp_path):
    first = write(tmp_path / "a.csv", times=DATES)
    later = write(tmp_path / "b.csv", times=[date.replace("T10:00", "T10:01") for date in DATES])
    signals = monitoring.redundant_signals([first, later])[1]  # the later rows follow the first
    assert set(signals) == {"left", "right"}
    time = np.asarray(signals["left"].time)
    assert time[len(DATES)] - time[0] == 60.0


@pytest.mark.parametrize(("zone", "hours"), [("", None), ("Z", 0), ("+02:00", 2), ("-0330", -3.5)])
def test_dates_keep_the_clock_of_the_first_one(tmp_path, zone, hours):
    dates = ["", *(date + zone for date in DATES)]  # a row without a date has no sample, either
    cells = [f"{date},{left},{left}" for date, left in zip(dates, ["", *LEFT], strict=True)]
    (tmp_path / "drive.csv").write_text("\n".join(["t,left,right", *cells]), encoding="utf-8")
    signals = monitoring.redundant_signals([tmp_path / "drive.csv"])[1]
    clock = None if hours is None else timezone(timedelta(hours=hours))
    assert signals["left"].origin == datetime(2026, 5, 1, 10, tzinfo=clock)
    assert signals["left"].origin.utcoffset() == (None if hours is None else timedelta(hours=hours))
    np.testing.assert_array_equal(signals["left"].time, TIMES)
    recording = monitoring.align(signals, {}, 0.5)
    assert recording.origin == signals["left"].origin


def test_seconds_become_dates_again_in_texts():
    origin = datetime(2026, 12, 31, 23, 59, 5, tzinfo=timezone(timedelta(hours=1)))
    assert time_text(12.5, None) == "12.5 s"
    assert time_text(12.5, None, 2) == "12.50 s"
    assert [time_text(t, origin) for t in (0.0, 0.816, 54.9999)] == [
        "2026-12-31 23:59:05",
        "2026-12-31 23:59:05.816",
        "2027-01-01 00:00:00",
    ]
    assert [time_text(0.999, origin, digits) for digits in (0, 2)] == ["2026-12-31 23:59:06", "2026-12-31 23:59:06.00"]
    assert span_text(0.0, 59.9, None) == "0 to 59.9 s"
    assert span_text(0.0, 4.25, origin) == "2026-12-31 23:59:05 to 23:59:09.25"
    assert span_text(0.25, 900.25, origin) == "2026-12-31 23:59:05 to 2027-01-01 00:14:05"
    for moment in (datetime(2027, 1, 1), datetime(2026, 12, 31, 23, tzinfo=UTC)):
        assert seconds_of(moment, origin) == 55.0
    assert date_at(origin, 55.0) == datetime(2027, 1, 1, tzinfo=origin.tzinfo)


def test_time_zones_and_a_column_of_another_name(tmp_path):
    dates = [
        "2026-05-01 10:00:00+02:00",
        "2026-05-01 08:00:00,5Z",
        "2026-05-01 10:00:01+02:00",
        "2026-05-01 08:00:01.5Z",
    ]
    file = write(tmp_path / "drive.csv", ";", times=dates, names=("Zeit", "left", "right"))
    np.testing.assert_array_equal(monitoring.redundant_signals([file])[1]["left"].time, TIMES)
    for time in (None, "Zeit"):
        assert cosim.Table.read(file, "left", time=time).times == tuple(TIMES)


def test_the_unit_in_the_name_of_a_column_of_dates_does_not_change_its_times(tmp_path):
    file = write(tmp_path / "drive.csv", times=DATES, names=("t_ms", "left", "right"))
    assert cosim.Table.read(file, "left").times == tuple(TIMES)
    np.testing.assert_array_equal(monitoring.redundant_signals([file])[1]["left"].time, TIMES)


def test_dates_of_pandas_in_a_parquet_file(tmp_path):
    pytest.importorskip("pyarrow")
    file = tmp_path / "drive.parquet"
    pd.DataFrame({"time": pd.to_datetime(DATES, format="ISO8601"), "left": LEFT}).to_parquet(file)
    np.testing.assert_array_equal(read_table_file(file)["time"], TIMES)


def test_a_date_that_is_none_is_named(tmp_path):
    file = write(tmp_path / "drive.csv", times=[*DATES[:3], "noon"])
    with pytest.raises(
        RecordingError, match=r"'noon' in line 5, column 't', is no number. Write times as .* or as dates"
    ):
        monitoring.redundant_signals([file])


@pytest.mark.parametrize("name", ["Zeit", "t"])
def test_dates_in_another_form_are_refused_with_the_right_one(name, tmp_path):
    dates = [f"03/29/2026 08:0{minute}:00 +01:00" for minute in range(4)]
    file = tmp_path / "drive.csv"
    rows = [f"{date};{left};{left}" for date, left in zip(dates, LEFT, strict=True)]
    file.write_text("\n".join([f"{name};left;right", *rows]))
    with pytest.raises(
        RecordingError, match=rf"column '{name}', such as '03/29.* ISO 8601. Write them as 2026-03-29 08:00:00"
    ):
        monitoring.redundant_signals([file])


@pytest.mark.parametrize(("separator", "decimal", "words"), [(",", ".", "point"), (";", ",", "comma")])
def test_a_text_among_numbers_is_named_with_the_sign_of_the_file(separator, decimal, words, tmp_path):
    file = write(tmp_path / "drive.csv", separator, decimal)
    file.write_text(file.read_text() + separator.join(["2", "Bad", "1"]) + "\n")
    match = rf"'Bad' in line 6, column 'left', is no number. An empty cell is a missing sample. .* decimal {words}"
    with pytest.raises(RecordingError, match=match):
        monitoring.redundant_signals([file])


@pytest.mark.parametrize("text", ["n.a.", "1.234,5", "1.5", "1.234"])
@pytest.mark.parametrize("column", [0, 1])
def test_the_wrong_cell_among_decimal_commas_is_named(text, column, tmp_path):
    rows = [[f"{t},5", "20,5", "1,25"] for t in range(20)]
    rows[7][column] = text
    file = tmp_path / "drive.csv"
    file.write_text("\n".join(["t;left;right", *(";".join(row) for row in rows)]))
    with pytest.raises(RecordingError, match=rf"'{text}' in line 9, column '{['t', 'left'][column]}', .* 12,5"):
        monitoring.redundant_signals([file])
