"""The unit of a column of times, from its name, wherever a recording is read."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim
from bayesftc.controllers import LinearModel
from bayesftc.cosim.base.recordings.table_files import in_seconds, since_1970, time_column, time_unit
from bayesftc.cosim.errors import RecordingError, StepSizeError
from bayesftc.cosim.fitting.samples import sample

SECOND = ("t", "time", "timestamp", "time_s", "t [s]", "time (s since start)", "time_local", "s", "h", "min", "x[0]", 0)
MILLI = (
    "t_ms",
    "time_ms",
    "timestamp_ms",
    "t [ms]",
    "t(ms)",
    "Time/ms",
    "timeMs",
    "time in ms",
    "ms",
    "millis",
    "T_MS",
)


@pytest.mark.parametrize(
    ("names", "unit"),
    [(SECOND, 1.0), (MILLI, 1e-3), (("t_us", "t [µs]"), 1e-6), (("t_ns",), 1e-9), (("t_min", "hours_min"), 60.0)],
)
def test_the_end_of_a_name_is_its_unit(names, unit):
    assert {float(time_unit(name)) for name in names} == {unit}


def test_an_unknown_unit_is_refused_with_names_that_are_right():
    with pytest.raises(RecordingError, match=r"'t \[ticks\]' is in 'ticks', .* Call it 't \[s\]', 't \[ms\]'"):
        time_unit("t [ticks]")


def test_times_are_the_nearest_numbers():
    assert in_seconds("t_ms", np.arange(1000)).tolist() == [float(f"{k / 1000:.3f}") for k in range(1000)]


@pytest.mark.parametrize("digits", [0, 3, 6, 9])
def test_times_since_1970_are_known_from_their_size(digits):
    seconds = np.array([1_777_885_920, 1_777_885_921])
    for name in ("header.stamp", "t"):
        assert in_seconds(name, seconds * 10**digits).tolist() == seconds.tolist()
    assert since_1970(seconds)


def test_other_times_are_seconds_and_a_unit_in_the_name_goes_first():
    for times in ([0.0, 1e12], [5e8, 6e8], [0.0, 1.0]):
        assert in_seconds("t", np.array(times)).tolist() == times
    assert in_seconds("t_ms", np.array([1.7e9])).tolist() == [1.7e6]
    assert not since_1970([0.0, 1.7e9])
    assert not since_1970([np.nan])


def test_recordings_in_milliseconds_are_those_in_seconds(tmp_path):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(400)
    y = np.convolve(u, np.append(0.0, 0.5 ** np.arange(1, 30)))[:400] + 0.01 * rng.standard_normal(400)
    tables = [
        pd.DataFrame({name: 20 * np.arange(400) * unit, "u": u, "y": y}) for name, unit in (("t", 1e-3), ("t_ms", 1))
    ]
    found = [LinearModel.identify(table, inputs="u", outputs="y", time=table.columns[0]) for table in tables]
    assert [float(each.model.step) for each in found] == [0.02, 0.02]
    tables[1].to_csv(tmp_path / "run.csv", index=False)
    assert cosim.Table.read(tmp_path / "run.csv", "u", time="t_ms").times == tuple(k / 1000 for k in range(0, 8000, 20))


@pytest.mark.parametrize("name", ["t", "T_ms", "Time [ms]", "timestamp", "time_s"])
def test_a_column_of_times_is_found_by_its_name(name, tmp_path):
    assert time_column(["u", "t_outside", name, "time"]) == name
    unit = 1 / float(time_unit(name))
    rng = np.random.default_rng(1)
    u, y = np.repeat(rng.standard_normal(80), 5), rng.standard_normal(400)
    table = pd.DataFrame({"u": u, name: np.arange(400) * 0.02 * unit, "y": y})
    table.to_csv(tmp_path / "run.csv", index=False)
    assert LinearModel.identify(table, inputs="u", outputs="y", order=1).model.step == Fraction(1, 50)
    assert sample(table, "u", "y", None, None).step == Fraction(1, 50)
    assert np.allclose(cosim.Table.read(tmp_path / "run.csv", "u").times, np.arange(400) * 0.02)


def test_a_signal_is_no_column_of_times():
    assert time_column(["u", "t_outside", "times_open", "speed"]) is None
    table = pd.DataFrame({"t": np.arange(5.0), "y": np.arange(5.0)})
    assert sample(table, {"voltage": "t"}, "y", None, "0.1").step == Fraction(1, 10)
    with pytest.raises(
        StepSizeError, match=r"no column of times: none is called t, time, timestamp; .*time=.*columns: t, y"
    ):
        sample(table, {"voltage": "t"}, "y", None, None)
