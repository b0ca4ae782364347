"""Sensors that do not follow the others are named, healthy and faulty ones are not."""

import numpy as np
import pytest

from bayesftc.monitoring import Signal, fit_model, recorded
from bayesftc.monitoring.fit.following import strangers

N = 6000
T = 0.1 * np.arange(N)
LEVEL = 6 + 2.5 * np.sin(2 * np.pi * T / 50) + np.sin(2 * np.pi * T / 17)


def wandering(rng, std, time_constant):
    """Return a first-order Gauss-Markov process."""
    keep = np.exp(-0.1 / time_constant)
    w, e = np.zeros(N), std * np.sqrt(1 - keep**2) * rng.standard_normal(N)
    for k in range(1, N):
        w[k] = keep * w[k - 1] + e[k]
    return w


def flight(rng, level=LEVEL):
    """Return two barometers, a lidar with a short range, and GNSS, with a drift, a dropout, a jump and a freeze."""
    y = level[:, None] + rng.standard_normal((N, 4)) * [0.3, 0.3, 0.03, 0.8]
    for i in (0, 1):
        y[:, i] += wandering(rng, 0.2, 40)
    y[3000:, 0] += 0.05 * (T[3000:] - 300)
    y[(level > 8) | (np.abs(T - 157) < 7), 2] = np.nan
    y[2200:2250, 3] += 6.0
    y[4500:4700, 3] = y[4499, 3]
    return y


STRANGE = {
    "walk": lambda rng: 6 + np.cumsum(0.1 * rng.standard_normal(N)),
    "noise": lambda rng: 5 * rng.standard_normal(N),
    "another level": lambda rng: 3 + 0.5 * rng.standard_normal(N),
}
SEEDS = [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 25))]


def test_another_factor_shows_where_the_quantity_rests_most_of_the_time():
    """Hot water: short draws and heating, and long rests in which no two thermometers move together."""
    rng, n = np.random.default_rng(2), 12000
    level, t = np.full(n, 55.0), np.arange(n)
    for start in rng.integers(0, n - 300, 12):
        level += 4 * np.clip((t - start - 150) / 150, 0, 1) - 4 * np.clip((t - start) / 100, 0, 1)
    y = level[:, None] * [1.0, 1.0, 1.8] + 0.08 * rng.standard_normal((n, 3)) + [0, 0, 32]
    assert strangers(y.round(1)) == {2: pytest.approx(1.8, rel=0.02)}
    y[:, 2] = (y[:, 2] - 32) / 1.8
    y[4000:8000, 2] *= 1.8  # for a third of the recording
    assert strangers(y.round(1)) == {}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", [LEVEL, np.full(N, 6.0)])
def test_healthy_sensors_with_faults_follow(seed, level):
    y = flight(np.random.default_rng(seed), level)
    for kept in ([0, 1, 2, 3], [0, 2, 3], [0, 2], [1, 0], [2, 3]):
        assert strangers(y[:, kept]) == {}
        assert strangers(y[:, kept], slice(0, 2700)) == {}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", list(STRANGE))
def test_a_sensor_that_does_not_follow_is_named(seed, kind):
    rng = np.random.default_rng(seed)
    y = np.column_stack([flight(rng), STRANGE[kind](rng)])
    for stretch in (slice(None), slice(0, 2700)):
        (found,) = strangers(y, stretch).items()
        assert found == (4, pytest.approx(0.0, abs=0.3))
    assert list(strangers(y[:, [1, 4]])) == [0, 1]  # of two sensors nobody knows which one is wrong


def test_slow_sensors_and_other_gains_follow():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = np.cumsum(0.3 * rng.standard_normal(N))
        slow = x.copy()
        for k in range(1, N):
            slow[k] = 0.95 * slow[k - 1] + 0.05 * x[k]
        y = np.column_stack([x, x, slow, 0.7 * x]) + 0.1 * rng.standard_normal((N, 4))
        assert strangers(y) == {}


def test_a_sensor_that_fails_after_the_stretch_is_not_named():
    rng = np.random.default_rng(0)
    y = LEVEL[:, None] + 0.3 * rng.standard_normal((N, 3))
    y[2500:, 1] = 3 + 0.3 * rng.standard_normal(N - 2500)
    assert list(strangers(y)) == [1]
    assert strangers(y, slice(0, 2500)) == {}


def recording(y):
    there = np.isfinite(y)
    return recorded({f"s{i}": Signal(T[there[:, i]], y[there[:, i], i].round(3)) for i in range(y.shape[1])})


@pytest.mark.sampled(1)
@pytest.mark.parametrize("kind", list(STRANGE))
def test_the_fit_of_the_others_is_as_without_it(kind):
    rng = np.random.default_rng(0)
    y, stretch = flight(rng), slice(0, 2700)
    alone = fit_model(recording(y), stretch)
    strange = STRANGE[kind](rng)
    fitted = fit_model(recording(np.column_stack([y, strange])), stretch)
    assert list(fitted.strangers) == ["s4"]
    assert (fitted.plant, fitted.errors) == (alone.plant, alone.errors)
    own = fitted.sensors["s4"]
    assert {name: sensor for name, sensor in fitted.sensors.items() if name != "s4"} == alone.sensors
    assert own.std == pytest.approx(np.std(strange - LEVEL), rel=0.2)


def temperatures(seed, sensors=4, noise=0.3):
    """Thermometers of a quantity that moves by 60 degrees."""
    rng, t = np.random.default_rng(seed), np.arange(6000)
    level = 120 + 30 * np.sin(2 * np.pi * t / 500) + 8 * np.sin(2 * np.pi * t / 137)
    return level[:, None] + noise * rng.standard_normal((len(t), sensors))


@pytest.mark.parametrize("sensors", [2, 3, 4, 6])
@pytest.mark.parametrize(("factor", "offset"), [(1.8, 32.0), (1 / 1.8, -17.8)])
def test_a_column_in_another_unit_is_named_with_its_factor(sensors, factor, offset):
    for seed in range(3):
        y = temperatures(seed, sensors)
        y[:, 1] = factor * y[:, 1] + offset
        found = strangers(y)
        assert list(found) == ([0, 1] if sensors == 2 else [1])
        assert found[1] == pytest.approx(factor, rel=0.02)


def gain_of_a_tenth(y):
    y[:, 1] *= 1.1


def slow(y):
    for k in range(1, len(y)):
        y[k, 1] = y[k - 1, 1] + (y[k, 1] - y[k - 1, 1]) / 80


def fast(y):
    for column in (0, 2, 3):
        for k in range(1, len(y)):
            y[k, column] = y[k - 1, column] + (y[k, column] - y[k - 1, column]) / 80


def wrong_gain_for_a_third(y):
    y[2000:4000, 1] *= 1.5


@pytest.mark.parametrize("change", [gain_of_a_tenth, slow, fast, wrong_gain_for_a_third])
def test_other_factors_are_not(change):
    y = temperatures(0)
    change(y)
    assert strangers(y) == {}


def test_a_column_at_another_place_is_named_though_no_motion_is_visible():
    """Three good frequency meters at 50 Hz, whose noise hides the motion, and a control near 0."""
    rng = np.random.default_rng(0)
    y = 50 + 0.003 * np.sin(T / 5)[:, None] + 0.01 * rng.standard_normal((N, 3))
    control = 0.004 * rng.standard_normal(N)
    assert strangers(y) == {}
    assert strangers(y + np.array([0.0, 0.4, 0.0])) == {}  # a bias, if large
    assert strangers(np.column_stack([y, control])) == {3: pytest.approx(np.nan, nan_ok=True)}
    assert list(strangers(np.column_stack([y[:, 0], control]))) == [0, 1]
    assert strangers(np.column_stack([y, 50 + control])) == {}
    fitted = fit_model(
        recorded({n: Signal(T, v) for n, v in zip("abcu", np.column_stack([y, control]).T, strict=True)})
    )
    alone = fit_model(recorded({n: Signal(T, v) for n, v in zip("abc", y.T, strict=True)}))
    assert fitted.plant == alone.plant


def test_most_sensors_show_the_quantity_though_two_others_agree_best():
    """Four probes, each with noise as large as its motion, and two precise meters of the current that moves the other way."""
    rng = np.random.default_rng(1)
    motion = np.sin(2 * np.pi * T)
    probes = motion[:, None] + 0.7 * rng.standard_normal((N, 4))
    currents = -4 * motion[:, None] + 0.5 * rng.standard_normal((N, 2))
    assert strangers(probes) == {}
    found = strangers(np.column_stack([probes, currents]))
    assert found == {4: pytest.approx(-4, abs=0.2), 5: pytest.approx(-4, abs=0.2)}
