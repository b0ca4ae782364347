"""Recordings at evenly spaced steps: gaps, uneven times, held inputs."""

import warnings
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim
from bayesftc.cosim.base.recordings.dates import other_date
from bayesftc.cosim.errors import ModelError, RecordingError
from bayesftc.cosim.fitting.samples import sample

NAN = np.nan


def test_rows_go_to_the_nearest_step_and_nothing_is_interpolated():
    table = pd.DataFrame(
        {"time": [5.0, 5.11, 5.19, 5.21, 5.5], "u": [1.0, NAN, 2.0, NAN, 3.0], "y": [10.0, 11.0, 12.0, NAN, 15.0]}
    )
    with pytest.warns(UserWarning, match="25% of the rows are at the step of a later row, .* dt is 0.1 s"):
        samples = sample(table, {"in": "u"}, {"out": "y"}, "time", 0.1)
    assert samples.step == Fraction(1, 10)
    np.testing.assert_allclose(samples.time, 5.0 + 0.1 * np.arange(6))
    np.testing.assert_array_equal(samples.y[:, 0], [10, 11, 12, NAN, NAN, 15])  # the row at 5.21 s has no sample
    np.testing.assert_array_equal(samples.inputs["in"][:, 0], [1, 1, 2, 2, 2, 3])


def test_without_times_there_is_a_row_for_each_step():
    samples = sample(pd.DataFrame({"y": [1.0, 2.0]}), (), "y", None, "1/30")
    assert samples.step == Fraction(1, 30)
    assert samples.start == 0.0
    np.testing.assert_array_equal(samples.y, [[1], [2]])


def test_names_of_columns_need_no_unit():
    table = pd.DataFrame({"t": [0.0, 1.0], "q1 [m3/s]": [1.0, 2.0], "LT201 [m]": [3.0, 4.0], "LT202 [m]": [5.0, 6.0]})
    samples = sample(table, {"q": "q1"}, {"h": ["LT202", "LT201 [m]"]}, None, None)
    assert samples.inputs["q"].tolist() == [[1.0], [2.0]]
    assert samples.columns == ("LT202 [m]", "LT201 [m]")
    assert samples.unused == ()
    with pytest.raises(ModelError, match="twice"):
        sample(table, {"q": "q1"}, {"h": ["LT202", "LT202 [m]"]}, None, None)
    with pytest.raises(ModelError, match=r"'LT202 \[m\]' is given for the outputs twice"):
        sample(table, {"q": "q1"}, {"h": "LT202", "x": "LT202 [m]"}, None, None)
    with pytest.raises(RecordingError, match=r"'LT202' can be 'LT202 \[cm\]' or 'LT202 \[m\]'. Give the whole name"):
        sample(table.rename(columns={"LT201 [m]": "LT202 [cm]"}), {"q": "q1"}, {"h": "LT202"}, None, None)


def test_sensors_belong_to_their_outputs():
    table = pd.DataFrame({"time": [0.0, 0.5, 1.0], **{name: [1.0, 2.0, 3.0] for name in "abc"}})
    samples = sample(table, (), {"first": ["a", "b"], "second": "c"}, "time", None)
    assert samples.columns == ("a", "b", "c")
    np.testing.assert_array_equal(samples.output_of, [0, 0, 1])


@pytest.mark.parametrize(
    ("times", "dt", "error", "words"),
    [
        ([0.0, 0.1, 0.2, 0.35], None, cosim.StepSizeError, "not evenly spaced: .* Give dt=0.1, the usual step"),
        ([0.0, 0.2, 0.1], 0.1, cosim.StepSizeError, "do not increase .* or leave it out"),
        ([0.0, 0.2, 0.1], None, cosim.StepSizeError, "do not increase .* or give dt="),
        ([0.0, 0.1, NAN], 0.1, cosim.StepSizeError, "do not increase"),
        ([0.0, 1e9, 2e9], 1e-3, cosim.RecordingError, "in seconds"),
        ([0.0, 0.1, 0.2], 10.0, cosim.RecordingError, "smaller dt"),
    ],
)
def test_times_that_cannot_be_used_are_refused(times, dt, error, words):
    with pytest.raises(error, match=words):
        sample(pd.DataFrame({"time": times, "y": 1.0}), (), "y", "time", dt)


def test_a_name_that_the_recording_does_not_have_is_refused_also_with_dt():
    with pytest.raises(cosim.StepSizeError, match="no column 'tme'"):
        sample(pd.DataFrame({"time": [0.0, 1.0], "y": 1.0}), (), "y", "tme", 1)


DATES = pd.date_range("2026-03-28T08:00", periods=8, freq="60s").delete([3, 4])


@pytest.mark.parametrize("dt", [None, 60])
@pytest.mark.parametrize("time", [None, "Zeit"])
@pytest.mark.parametrize("form", [None, "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M+01:00"])
def test_dates_are_times_and_a_gap_has_its_steps(dt, time, form, tmp_path):
    dates = DATES if form is None else DATES.strftime(form)
    table = pd.DataFrame({"y": np.arange(6.0), "Zeit": dates})
    table.to_csv(tmp_path / "plant.csv", sep=";", decimal=",", index=False)
    for recording in (table, tmp_path / "plant.csv"):
        samples = sample(recording, (), "y", time, dt)
        assert samples.step == 60
        assert samples.start == 0.0
        np.testing.assert_array_equal(samples.y[:, 0], [0, 1, 2, NAN, NAN, 3, 4, 5])


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p", "%d-%b-%Y %H:%M"])
def test_dates_in_another_form_are_named(form):
    table = pd.DataFrame({"Zeit": DATES.strftime(form), "y": np.arange(6.0)})
    with pytest.warns(UserWarning, match="'Zeit' do not count: each row .*such as '.*', .* as 2026-03-28 08:00:00"):
        assert len(sample(table, (), "y", None, 60).y) == 6
    for time, dt in ((None, None), ("Zeit", None), ("Zeit", 60)):
        with pytest.raises(
            cosim.StepSizeError, match=r"not in the form of ISO 8601. Write them as 2026-03-28 08:00:00"
        ):
            sample(table, (), "y", time, dt)


NO_DATES = [
    "1-2-3",
    "1.2.3",
    "10.5.1",
    "12/24/36 V",
    "13.13.2026",
    "0.5.2026",
    "40-Mai-2026",
    "1.2.2026 rev",
    "10.5.123",
]


@pytest.mark.parametrize("text", NO_DATES)
def test_texts_that_are_no_dates_are_taken_for_none(text):
    table = pd.DataFrame({"lot": text, "y": np.arange(6.0)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(sample(table, (), "y", None, 60).y) == 6
    with pytest.raises(cosim.StepSizeError, match="has no column of times"):
        sample(table, (), "y", None, None)


@pytest.mark.parametrize(
    "text",
    ["28.03.2026", "3/28/26 8:00 PM", "2026/3/28 08:00:00,5", "28-Mär-2026", "2026-3-28 8:00:00", "28.3.26 8.00"],
)
@pytest.mark.parametrize(("others", "dates"), [(0, True), (2, True), (3, False)])
def test_a_column_has_dates_if_most_of_its_texts_are(text, others, dates):
    cells = pd.Series([*["none"] * others, *[text] * (6 - others), None])
    assert other_date(cells) == (text if dates else None)


def test_a_text_among_dates_is_named():
    table = pd.DataFrame({"Zeit": [*DATES.astype(str)[:5], "noon"], "y": np.arange(6.0)})
    with pytest.raises(cosim.RecordingError, match="'noon' in the column of times 'Zeit', row 6, is no date"):
        sample(table, (), "y", None, None)


def test_a_long_recording_keeps_its_rows_although_its_step_is_rounded():
    times = np.delete(np.arange(1_000_000) / 30, [5])
    samples = sample(pd.DataFrame({"t": times, "y": 1.0}), (), "y", None, None)
    assert np.flatnonzero(np.isnan(samples.y[:, 0])).tolist() == [5]


def test_rows_may_be_missing_among_rounded_times():
    times = np.round(np.delete(np.arange(3000) / 30, [4, 5, 900]), 4)
    samples = sample(pd.DataFrame({"t": times, "y": times}), (), "y", None, None)
    assert len(samples.y) == 3000
    assert float(samples.step) == pytest.approx(1 / 30, rel=1e-5)
