"""Gain, sum, unit delay, saturation."""

import math
import pickle

import numpy as np
import pytest

from bayesftc import cosim


def through(run_both, block, values, name="y"):
    """Feed columns of values, one row a second, and return the output."""
    values = np.asarray(values, dtype=float)
    diagram = cosim.Diagram(1)
    columns = values.reshape(len(values), -1).T
    feeds = [
        diagram.add(cosim.Table(range(len(values)), column, interpolate=False), f"s{i}") if np.isfinite(column).all()
        else diagram.add(_Odd(tuple(column)), f"s{i}")
        for i, column in enumerate(columns)
    ]  # fmt: skip
    node = diagram.add(block, "b")
    diagram.connect([f["y"] for f in feeds], node["u"])
    return run_both(diagram, len(values) - 1)[f"b.{name}"]


def odd(k, values, y):
    y[0] = values[k]


class _Odd(cosim.Block):
    outputs = (cosim.Port("y"),)

    def __init__(self, values):
        self.values = values

    def define(self, step):
        return cosim.Definition(odd, parameters={"values": self.values})


def test_gain(run_both):
    u = [[1.0, 2.0], [3.0, -4.0], [0.0, 0.5]]
    matrix = [[1.0, 2.0], [0.0, -1.0], [5.0, 0.0]]
    np.testing.assert_array_equal(
        through(run_both, cosim.Gain(matrix, offset=0.5), u), np.array(u) @ np.transpose(matrix) + 0.5
    )
    np.testing.assert_array_equal(through(run_both, cosim.Gain(-3.0), [1.0, 2.0]), [-3.0, -6.0])
    assert cosim.Gain([[1.0, 2.0]]).port("u").shape == (2,)
    assert cosim.Gain(np.array(2.0)) == cosim.Gain(2.0)


def test_sum(run_both):
    u = [[1.0, 2.0, 4.0], [math.inf, 1.0, 1.0], [1.0, math.inf, 2.0], [math.inf, math.inf, 1.0], [math.nan, 1.0, 1.0]]
    np.testing.assert_array_equal(
        through(run_both, cosim.Sum("+-+"), u), [3.0, math.inf, -math.inf, math.nan, math.nan]
    )
    np.testing.assert_array_equal(through(run_both, cosim.Sum("-"), [1.0, 2.0]), [-1.0, -2.0])


def test_unit_delay_is_exactly_one_step(run_both):
    np.testing.assert_array_equal(through(run_both, cosim.UnitDelay(initial=9.0), [1.0, 2.0, 3.0]), [9.0, 1.0, 2.0])
    np.testing.assert_array_equal(
        through(run_both, cosim.UnitDelay(2), [[1, 2], [3, 4], [5, 6]]), [[0, 0], [1, 2], [3, 4]]
    )


def test_slow_unit_delay_is_one_of_its_own_steps(run_both):
    diagram = cosim.Diagram(1)
    ramp, delay = diagram.add(cosim.Ramp(1.0)), diagram.add(cosim.UnitDelay(initial=-1.0), "delay", every=3)
    diagram.connect(ramp["y"], delay["u"])
    result = run_both(diagram, 10, record=["delay.*", "delay.u"])
    np.testing.assert_array_equal(result["delay.y"], [-1, -1, -1, 0, 0, 0, 3, 3, 3, 6, 6])
    np.testing.assert_array_equal(result["delay.u"], [0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9])


def test_saturation_keeps_a_missing_sample_missing(run_both):
    u = [-5.0, -1.0, 0.0, 2.0, 2.5, math.nan, math.inf, -math.inf]
    np.testing.assert_array_equal(through(run_both, cosim.Saturation(-1.0, 2.0), u), [-1, -1, 0, 2, 2, math.nan, 2, -1])
    free = cosim.Saturation(-math.inf, math.inf)
    np.testing.assert_array_equal(through(run_both, free, u), u)
    vector = through(run_both, cosim.Saturation(0.0, 1.0, size=2), [[-1.0, 0.5], [math.nan, 3.0]])
    np.testing.assert_array_equal(vector, [[0.0, 0.5], [math.nan, 1.0]])


@pytest.mark.parametrize(
    "make",
    [
        lambda: cosim.Gain(math.nan),
        lambda: cosim.Gain([1.0, 2.0]),
        lambda: cosim.Gain([[1.0], [2.0, 3.0]]),
        lambda: cosim.Gain([[]]),
        lambda: cosim.Gain("a"),
        lambda: cosim.Gain(None),
        lambda: cosim.Gain(1.0, offset=math.nan),
        lambda: cosim.Sum(""),
        lambda: cosim.Sum("+*"),
        lambda: cosim.UnitDelay(0),
        lambda: cosim.UnitDelay(1.5),
        lambda: cosim.UnitDelay(True),
        lambda: cosim.Saturation(2.0, 1.0),
        lambda: cosim.Saturation(math.nan, 1.0),
        lambda: cosim.Saturation(0.0, 1.0, size=-1),
    ],
)
def test_refused_settings(make):
    with pytest.raises(cosim.ModelError, match=r"^(Gain|Sum|UnitDelay|Saturation) (is|has) "):
        make()


@pytest.mark.parametrize(
    "block", [cosim.Gain([[1.0, 2.0]]), cosim.Gain(3), cosim.Sum("+-"), cosim.UnitDelay(2), cosim.Saturation(0.0, 1.0)]
)
def test_pickle_and_hash(block):
    copy = pickle.loads(pickle.dumps(block))
    assert copy == block
    assert hash(copy) == hash(block)
