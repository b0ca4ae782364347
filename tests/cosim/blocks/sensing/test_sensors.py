"""Sensors: what they read, how they are disturbed, how they round."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bayesftc import cosim
from bayesftc.cosim.errors import ConnectionError, ModelError
from bayesftc.cosim.ops import cos, sin, square
from bayesftc.cosim.random import numbers

STEPS = 50


def camera(u, clean):
    """Two joint angles, seen as the position of the arm's end; a plain step function."""
    clean[0] = cos(u[0]) + cos(u[0] + u[1])
    clean[1] = sin(u[0]) + sin(u[0] + u[1])
    clean[2] = square(u[0])


def read(sensors, steps=STEPS, *, seed=1, engine="auto", dt=0.1, values=None, record=None):
    """Run the sensors on sines of different periods, or on constants."""
    diagram = cosim.Diagram(dt=dt)
    node = diagram.add(sensors)
    for i in range(sensors.signals):
        source = cosim.Constant(values[i]) if values is not None else cosim.Sine(1.0 + i, 2.0 + i, offset=3.0 * i)
        diagram.connect(diagram.add(source, name=f"signal_{i}")["y"], node["u"][i])
    return diagram.simulate(steps * dt, seed=seed, engine=engine, record=record)


def signals(result, count):
    return np.stack([result[f"signal_{i}.y"] for i in range(count)], axis=1)


MATRIX = ((1.0, 0.0), (0.5, 2.0), (0.0, -1.0))
COVARIANCE = ((1.0, 0.3, 0.0), (0.3, 0.5, -0.2), (0.0, -0.2, 0.25))
DIFFERENT = {"bias": (1.0, 0.0, -1.0), "std": (0.1, 0.0, 2.0)}
VARIANTS = {
    "one": cosim.Sensors(),
    "same signal": cosim.Sensors(3, **DIFFERENT),
    "one to one": cosim.Sensors(3, signals=3, **DIFFERENT, resolution=(0.0, 0.25, 0.1)),
    "in turn": cosim.Sensors(4, 0.5, signals=2),
    "some of each": cosim.Sensors((1, 3), (0.5, 2.0), bias=(0.0, 0.1, 0.2, 0.3)),
    "matrix": cosim.Sensors(3, signals=2, matrix=MATRIX, covariance=COVARIANCE),
    "function": cosim.Sensors(3, 0.5, signals=2, function=camera, resolution=0.125),
}
CLEAN = {
    "one": lambda u: u,
    "same signal": lambda u: u[:, [0, 0, 0]],
    "one to one": lambda u: u,
    "in turn": lambda u: u[:, [0, 1, 0, 1]],
    "some of each": lambda u: u[:, [0, 1, 1, 1]],
    "matrix": lambda u: u @ np.array(MATRIX).T,
    "function": lambda u: np.stack(
        [np.cos(u[:, 0]) + np.cos(u.sum(axis=1)), np.sin(u[:, 0]) + np.sin(u.sum(axis=1)), u[:, 0] ** 2], axis=1
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_readings_and_both_engines(name):
    sensors = VARIANTS[name]
    compiled = read(sensors, engine="compiled")
    assert_array_equal(
        compiled["sensors.y"].view(np.uint64), read(sensors, engine="interpreted")["sensors.y"].view(np.uint64)
    )
    noise = np.stack([numbers(1, "sensors.noise", STEPS + 1, channel=i) for i in range(sensors.count)], axis=1)
    factor = np.diag(np.broadcast_to(sensors.std, sensors.count))
    if sensors.covariance is not None:
        factor = np.linalg.cholesky(np.array(sensors.covariance))
    expected = CLEAN[name](signals(compiled, sensors.signals)) + np.asarray(sensors.bias) + noise @ factor.T
    resolution = np.broadcast_to(sensors.resolution, expected.shape)
    rounded = resolution > 0
    expected[rounded] = np.floor(expected[rounded] / resolution[rounded] + 0.5) * resolution[rounded]
    assert compiled["sensors.y"].shape == (STEPS + 1, sensors.count)
    assert_allclose(compiled["sensors.y"], expected, rtol=1e-12, atol=1e-12)


def test_mean_and_standard_deviation():
    count = 200_000
    y = read(replace(VARIANTS["same signal"], std=(0.1, 1.0, 2.0)), count, values=[5.0], record=["sensors.y"])[
        "sensors.y"
    ]
    std = np.array([0.1, 1.0, 2.0])
    assert (np.abs(y.mean(axis=0) - (5.0 + np.array([1.0, 0.0, -1.0]))) < 4 * std / np.sqrt(count)).all()
    assert (np.abs(y.std(axis=0) / std - 1) < 4 / np.sqrt(2 * count)).all()
    assert (np.abs(np.corrcoef(y.T)[np.triu_indices(3, 1)]) < 4 / np.sqrt(count)).all()


def test_covariance():
    count = 200_000
    y = read(VARIANTS["matrix"], count, values=[1.0, 2.0], record=["sensors.y"])["sensors.y"]
    wanted = np.array(COVARIANCE)
    spread = np.sqrt((np.outer(wanted.diagonal(), wanted.diagonal()) + wanted**2) / count)
    assert (np.abs(np.cov(y.T) - wanted) < 4 * spread).all()


def test_a_singular_covariance():
    together = cosim.Sensors(3, covariance=((1e-6, 2e-3, 0.0), (2e-3, 4.0, 0.0), (0.0, 0.0, 0.0)))
    y = read(together, values=[0.0])["sensors.y"]
    assert_allclose(y[:, 1], 2000 * y[:, 0], rtol=1e-6)
    assert y[:, 0].std() > 5e-4
    assert not y[:, 2].any()


def test_rounding_to_exact_multiples():
    result = read(cosim.Sensors(3, 1.0, resolution=(0.25, 2.0, 0.1)), 500)
    for channel, step in enumerate((0.25, 2.0, 0.1)):
        y = result["sensors.y"][:, channel]
        assert_array_equal(y, np.round(y / step) * step)
        assert len(np.unique(y)) > 3


@pytest.mark.parametrize(
    ("value", "rounded"), [(0.125, 0.25), (-0.125, 0.0), (0.12, 0.0), (-0.13, -0.25), (0.375, 0.5)]
)
def test_halves_go_up(value, rounded):
    y = read(cosim.Sensors(3, resolution=0.25), 1, values=[value])["sensors.y"]
    assert_array_equal(y, np.full((2, 3), rounded))
    assert not (np.signbit(y) & (y == 0)).any()


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_missing_signal_is_missed_only_where_it_is_read(engine):
    expected = {"matrix": [True, True, False], "in turn": [True, False, True, False], "function": [True] * 3}
    for name, missing in expected.items():
        diagram = cosim.Diagram(dt=0.1)
        node = diagram.add(VARIANTS[name])
        lost = diagram.add(cosim.Dropout(channels=1))
        diagram.connect(diagram.add(cosim.Constant(1.0))["y"], lost["u"])
        diagram.connect([lost["y"], diagram.add(cosim.Constant(2.0), name="other")["y"]], node["u"])
        assert_array_equal(np.isnan(diagram.simulate(0.1, engine=engine)["sensors.y"][1]), missing)


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
@pytest.mark.parametrize("every", [(1, 3, 10), 4])
def test_a_slow_sensor_has_the_samples_of_a_fast_one_in_every_nth_step(every, engine):
    slow, fast = (read(cosim.Sensors(3, **DIFFERENT, every=n), engine=engine)["sensors.y"] for n in (every, 1))
    due = np.arange(len(fast))[:, np.newaxis] % np.broadcast_to(every, 3) == 0
    assert_array_equal(slow, np.where(due, fast, np.nan))


def test_rates_of_each_signal():
    assert cosim.Sensors((1, 2), every=(1, 5)).rates == (1, 5, 5)


def test_another_sensor_leaves_the_noise_of_the_others():
    three = read(cosim.Sensors(3, (0.1, 0.0, 2.0), signals=1))["sensors.y"]
    four = read(cosim.Sensors(4, (0.1, 0.0, 2.0, 1.0), signals=1))["sensors.y"]
    assert_array_equal(four[:, :3], three)
    larger = np.eye(4)
    larger[:3, :3] = COVARIANCE
    three = read(cosim.Sensors(3, covariance=COVARIANCE))["sensors.y"]
    assert_array_equal(read(cosim.Sensors(4, covariance=larger))["sensors.y"][:, :3], three)


def test_the_same_noise_for_the_same_seed():
    first = read(VARIANTS["in turn"], seed=5)["sensors.y"]
    assert_array_equal(first, read(VARIANTS["in turn"], seed=5)["sensors.y"])
    assert (first != read(VARIANTS["in turn"], seed=6)["sensors.y"]).any()


def test_plain_settings():
    parsed = cosim.Sensors(**{"count": 2, "std": [1, 0.5], "matrix": [[1], [2]]})
    assert parsed == cosim.Sensors(2, np.array([1.0, 0.5]), matrix=np.array([[1.0], [2.0]]))
    assert hash(parsed) == hash(replace(parsed))
    assert pickle.loads(pickle.dumps(VARIANTS["function"])) == VARIANTS["function"]
    with pytest.raises(TypeError, match="sd"):
        cosim.Sensors(**{"sd": 1.0})


def test_each_signal_may_have_a_unit_of_its_own():
    sensors = cosim.Sensors((3, 1), unit=["m", "degC"])
    assert (sensors.port("u").units, sensors.port("y").units) == (("m", "degC"), ("m", "m", "m", "degC"))
    assert sensors.port("y").unit is None
    in_turn = cosim.Sensors(4, unit=("m", "degC"))
    assert (in_turn.signals, in_turn.port("y").units) == (2, ("m", "degC", "m", "degC"))
    assert cosim.Sensors((3, 1), unit=("m", "m")).port("y").unit == "m"
    mixed = cosim.Sensors(3, signals=2, matrix=MATRIX, unit=("m", "degC"))
    assert mixed.port("y").units == ("m", None, None)
    with pytest.raises(ModelError, match=r"unit=\('m', 'degC', 'K'\), 3 units for 2 signals; give one for each signal"):
        cosim.Sensors((3, 1), unit=("m", "degC", "K"))
    with pytest.raises(ModelError, match="unit=3; it must be a text, or a text for each signal"):
        cosim.Sensors(2, unit=3)
    with pytest.raises(ModelError, match=r"units=\('m',\), but 2 elements; give a unit for each element"):
        cosim.Port("x", (2,), units=("m",))


def test_units_are_those_of_the_signal():
    diagram = cosim.Diagram(dt=0.1)
    speed = diagram.add(cosim.Constant(1.0, unit="m/s"))
    node = diagram.add(cosim.Sensors(unit="rad"))
    with pytest.raises(ConnectionError, match="m/s"):
        diagram.connect(speed["y"], node["u"])
    assert node["y"].port.unit == "rad"
    assert node["u"].port.shape == ()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"count": 0}, "count=0"),
        ({"count": 2.0}, "whole number"),
        ({"signals": 0}, "signals=0"),
        ({"std": -1.0}, "not negative"),
        ({"std": np.nan}, "finite"),
        ({"count": 2, "std": (1.0, 1.0, 1.0)}, "one number, or one for each"),
        ({"count": 2, "bias": (1.0,)}, "one number, or one for each"),
        ({"bias": np.inf}, "finite"),
        ({"resolution": -0.1}, "not negative"),
        ({"every": 0}, "every=0 for 1 sensor; give a whole number of steps from 1"),
        ({"count": 2, "every": (1, 2.5)}, "whole number of steps"),
        ({"count": 2, "every": (1, 2, 3)}, r"every=\(1, 2, 3\) for 2 sensors"),
        ({"every": "ten"}, "whole number of steps"),
        ({"count": 2, "signals": 3}, "2 sensors cannot share 3 signals"),
        ({"count": 3, "signals": 2}, r"3 sensors cannot share 2 signals evenly; .* count=\(1, 2\)"),
        ({"count": (1, 0)}, "count=0"),
        ({"count": ()}, "count=0"),
        ({"count": (1, 2), "signals": 3}, r"count=\(1, 2\), 2 numbers for 3 signals"),
        ({"count": (2,), "signals": 2}, r"count=\(2,\), 1 number for 2 signals; give one for each signal"),
        ({"count": (1, 1), "matrix": ((1.0, 0.0), (0.0, 1.0))}, "does not go with a matrix"),
        ({"count": 2, "signals": 2, "matrix": ((1.0, 0.0),)}, "a row of 2 finite numbers"),
        ({"count": 2, "matrix": ((1.0,), (1.0, 2.0))}, "a row of 1 finite numbers"),
        ({"matrix": ((np.nan,),)}, "finite"),
        ({"matrix": ((1.0,),), "function": camera}, "a matrix and a function"),
        ({"function": np.sin}, "plain Python function of two arguments"),
        ({"function": lambda u: u}, "plain Python function of two arguments"),
        ({"std": 1.0, "covariance": ((1.0,),)}, "both std and covariance"),
        ({"count": 2, "covariance": ((1.0,),)}, "a row of 2 finite numbers"),
        ({"count": 2, "covariance": ((1.0, 0.5), (0.4, 1.0))}, "symmetric"),
        ({"count": 2, "covariance": ((1.0, 1.1), (1.1, 1.0))}, "no negative eigenvalue"),
        ({"covariance": ((-1.0,),)}, "no negative eigenvalue"),
    ],
)
def test_bad_settings(settings, sentence):
    with pytest.raises(ModelError, match=sentence):
        cosim.Sensors(**settings)
