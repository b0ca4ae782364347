"""Every source is its formula, in both engines."""

import math
import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc import cosim
from bayesftc.cosim.errors import RecordingError

T = np.arange(81) / 20


def signal(run_both, block, duration=4.0):
    diagram = cosim.Diagram(0.05)
    diagram.add(block, "s")
    return run_both(diagram, duration)["s.y"]


@pytest.mark.parametrize(
    ("block", "formula"),
    [
        (cosim.Constant(2.5), lambda t: 2.5),
        (cosim.Step(1.0, after=3.0), lambda t: 3.0 if t >= 1 else 0.0),
        (cosim.Step(1.01, after=3.0, before=-1.0), lambda t: 3.0 if t >= 1.01 else -1.0),
        (cosim.Step(-1.0, after=3.0), lambda t: 3.0),
        (cosim.Ramp(2.0), lambda t: 2.0 * t),
        (cosim.Ramp(-2.0, offset=1.0, start=1.5), lambda t: 1.0 - 2.0 * max(t - 1.5, 0.0)),
        (cosim.Sine(5.0, period=8.0, offset=20.0), lambda t: 20.0 + 5.0 * math.sin(2 * math.pi * t / 8)),
        (cosim.Sine(1.0, period=0.3, phase=0.7), lambda t: math.sin(2 * math.pi * t / 0.3 + 0.7)),
    ],
)
def test_formula(run_both, block, formula):
    np.testing.assert_allclose(signal(run_both, block), [formula(t) for t in T], rtol=0, atol=1e-13)


def test_step_falls_on_the_step_that_was_asked_for(run_both):
    diagram = cosim.Diagram("1/30")
    diagram.add(cosim.Step(7 / 30, after=1.0), "s")
    np.testing.assert_array_equal(run_both(diagram, 1)["s.y"], np.arange(31) >= 7)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    times=st.lists(st.integers(-20, 120), min_size=4, max_size=4, unique=True),
    values=st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4),
)
def test_table(run_both, times, values):
    times = np.sort(times) / 20
    np.testing.assert_allclose(
        signal(run_both, cosim.Table(times, values)), np.interp(T, times, values), atol=1e-8, rtol=1e-12
    )
    held = np.array(values)[np.maximum(np.searchsorted(times, T, side="right") - 1, 0)]
    np.testing.assert_array_equal(signal(run_both, cosim.Table(times, values, interpolate=False)), held)


def test_table_of_one_value(run_both):
    np.testing.assert_array_equal(signal(run_both, cosim.Table([1.0], [5.0])), np.full(81, 5.0))


def test_gaussian_has_its_moments(run_both):
    y = signal(run_both, cosim.Gaussian((0.5, 2.0), mean=3.0), 1000.0)
    assert y.shape == (20001, 2)
    assert (np.abs(y.mean(0) - 3.0) < 4 * np.array([0.5, 2.0]) / 141).all()
    np.testing.assert_allclose(y.std(0), [0.5, 2.0], rtol=0.02)
    assert abs(np.corrcoef(y.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(y[1:, 0], y[:-1, 0])[0, 1]) < 0.03


@pytest.mark.parametrize(
    ("std", "shape"), [(1, ()), (np.float32(1), ()), (np.array(1.0), ()), ([1.0], (1,)), (np.ones(3), (3,))]
)
def test_gaussian_shape(std, shape):
    assert cosim.Gaussian(std).port("y").shape == shape
    assert hash(cosim.Gaussian(std)) == hash(cosim.Gaussian(std))


@pytest.mark.parametrize(
    "make",
    [
        lambda: cosim.Constant(math.nan),
        lambda: cosim.Constant("a"),
        lambda: cosim.Constant([1.0, 2.0]),
        lambda: cosim.Constant(None),
        lambda: cosim.Step(math.inf, after=1.0),
        lambda: cosim.Ramp(math.nan),
        lambda: cosim.Sine(1.0, period=0.0),
        lambda: cosim.Sine(1.0, period=-1.0),
        lambda: cosim.Sine(math.inf, period=1.0),
        lambda: cosim.Table([], []),
        lambda: cosim.Table([0.0, 0.0], [1.0, 2.0]),
        lambda: cosim.Table([0.0, 1.0], [1.0]),
        lambda: cosim.Table([1.0, 0.0], [1.0, 2.0]),
        lambda: cosim.Table([0.0, 1.0], [1.0, math.nan]),
        lambda: cosim.Gaussian(-1.0),
        lambda: cosim.Gaussian([1.0, math.nan]),
        lambda: cosim.Gaussian([]),
        lambda: cosim.Gaussian([[1.0]]),
        lambda: cosim.Gaussian(1.0, mean=math.inf),
    ],
)
def test_refused_settings(make):
    with pytest.raises(cosim.ModelError, match=r"(Constant|Step|Ramp|Sine|Table|Gaussian) "):
        make()


@pytest.mark.parametrize(
    "block",
    [
        cosim.Constant(1.0, unit="m"),
        cosim.Sine(1.0, 2.0, unit="m"),
        cosim.Table([0.0], [1.0], unit="m"),
        cosim.Gaussian(1.0, unit="m"),
    ],
)
def test_unit_and_pickle(block):
    assert block.port("y").unit == "m"
    copy = pickle.loads(pickle.dumps(block))
    assert copy == block
    assert hash(copy) == hash(block)


def test_a_column_is_found_without_its_unit_which_the_output_has(tmp_path):
    (tmp_path / "weather.csv").write_text("time,outside [degC],sun [raw]\n0,1.0,2\n60,3.0,4\n")
    read = cosim.Table.read(tmp_path / "weather.csv", "outside")
    assert read == cosim.Table([0.0, 60.0], [1.0, 3.0], unit="degC")
    assert cosim.Table.read(tmp_path / "weather.csv", "outside [degC]", unit="K").unit == "K"
    assert cosim.Table.read(tmp_path / "weather.csv", "sun [raw]").unit is None


def test_a_table_is_read_from_a_file_and_searched(tmp_path, run_both):
    rng = np.random.default_rng(0)
    times, values = np.sort(rng.uniform(0.5, 7.5, 500)), rng.normal(size=500)
    rows = pd.DataFrame({"time": times, "v": np.where(np.arange(500) == 7, np.nan, values), "text": "x"})
    rows.to_csv(tmp_path / "drive.csv")
    rows.to_parquet(tmp_path / "drive.parquet")
    kept = np.delete(times, 7), np.delete(values, 7)
    for name in ("drive.csv", "drive.parquet"):
        read = cosim.Table.read(tmp_path / name, "v", unit="m/s")
        assert read == cosim.Table(*kept, unit="m/s")
        np.testing.assert_allclose(signal(run_both, read), np.interp(T, *kept), atol=1e-9)
    with pytest.raises(RecordingError, match=r"has no column 'w'; .* v\."):
        cosim.Table.read(tmp_path / "drive.csv", "w")
    with pytest.raises(RecordingError, match="has text in 'time' or 'text'"):
        cosim.Table.read(tmp_path / "drive.csv", "text")
    with pytest.raises(RecordingError, match=r"gone\.csv cannot be read: No such file"):
        cosim.Table.read(tmp_path / "gone.csv", "v")
