"""A monitor's model from nothing but a recording: known parameters come back, faults and calm parts do no harm."""

from dataclasses import fields, replace
from fractions import Fraction
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc.cosim.errors import ModelError, RecordingError
from bayesftc.examples.redundant_speed_sensors import study
from bayesftc.monitoring import (
    Alarm,
    ConstantRate,
    Monitor,
    Place,
    RandomWalk,
    Signal,
    align,
    as_model_file,
    fit_model,
    load_monitor,
    recorded,
    redundant_signals,
    stretch_of,
)
from bayesftc.monitoring.fit import settings as _fit_settings
from bayesftc.monitoring.fit.bias import wander
from bayesftc.monitoring.fit.columns import sample_time
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.noise import decompose, groups, share_out

NEEDS_RECORDING = "the recorded drive is not here: BAYESFTC_DATA names no folder with comma2k19 in it"
FAULTS = ("none", "freeze", "injection", "drift", "noise")


def level(steps, std, dt, rng, still=0.0):
    """Return a random walk that stands still at first, for a share of the steps."""
    moves = std * np.sqrt(dt) * rng.standard_normal(steps)
    moves[: int(still * steps)] = 0.0
    return np.cumsum(moves)


def fault(samples, kind, std, rng, share=0.2):
    """Put a fault into a fifth of a sensor's samples."""
    first = int(rng.uniform(0.1, 0.7) * len(samples))
    span = slice(first, first + int(share * len(samples)))
    count = span.stop - span.start
    if kind == "freeze":
        samples[span] = samples[first]
    elif kind == "injection":
        samples[span] += 20 * std
    elif kind == "drift":
        samples[span] += 0.05 * std * np.arange(count)
    elif kind == "noise":
        samples[span] += 5 * std * rng.standard_normal(count)


def recording(y, dt):
    t = dt * np.arange(len(y))
    return recorded({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)})


def total(fitted, name):
    """Return the standard deviation of a sensor's own noise: white and lasting, without what wanders for minutes."""
    lasting = [e.std for e in fitted.errors if e.sensors == [name] and e.time_constant < 100 * 0.01]
    return float(np.sqrt(fitted.sensors[name].std ** 2 + np.sum(np.square(lasting))))


@settings(max_examples=12, deadline=None)
@given(
    ratio=st.sampled_from([0.03, 0.1, 1.0, 10.0]),
    dt=st.sampled_from([0.001, 0.01, 0.1, 30.0]),
    sensors=st.integers(2, 5),
    kind=st.sampled_from(FAULTS),
    unit=st.sampled_from([1e-6, 1.0, 1e5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_known_parameters_come_back(ratio, dt, sensors, kind, unit, seed):
    rng = np.random.default_rng(seed)
    std = unit
    walk = std * np.sqrt(ratio / dt)
    y = level(8000, walk, dt, rng)[:, None] + std * rng.standard_normal((8000, sensors))
    fault(y[:, 0], kind, std, rng)
    fitted = fit_model(recording(y, dt))
    assert isinstance(fitted.plant, RandomWalk)
    assert 1 / 1.3 < fitted.plant.std / walk < 1.3
    healthy = [fitted.sensors[f"s{i}"].std / std for i in range(1, sensors)]
    if sensors > 2 or ratio <= 1:  # of two sensors the walk hides whose noise is whose
        assert 1 / 1.3 < min(healthy) <= max(healthy) < 1.3, healthy


def test_unequal_noise_is_told_apart():
    rng = np.random.default_rng(0)
    stds = np.array([1.0, 0.5, 2.0, 1.0])
    y = level(10000, 3.0, 0.01, rng)[:, None] + stds * rng.standard_normal((10000, 4))
    fitted = fit_model(recording(y, 0.01))
    np.testing.assert_allclose([s.std for s in fitted.sensors.values()], stds, rtol=0.15)
    assert fitted.errors == ()


def hovering(seed, steps=6000):
    """Return the height of a drone that follows steps and a sine, every 0.1 s."""
    rng, (z, v, gust) = np.random.default_rng(seed), (10.0, 0.0, 0.0)
    goal = 10 + 5 * np.sin(2 * np.pi * np.arange(steps) / 600) + 3 * (np.arange(steps) // 450 % 2)
    heights = np.empty(steps)
    for k in range(steps):
        heights[k] = z
        gust = 0.95 * gust + 0.4 * rng.standard_normal()
        v += 0.1 * (1.3 * (goal[k] - z) - 2.4 * v + gust / 6)
        z += 0.1 * v
    return heights


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("every", [2, 5, 10])
def test_a_sparse_sensor_changes_the_noise_of_no_other(every, seed):
    """The steps without its samples show the noise of two sensors only: their difference tells nothing about each."""
    stds, steps = np.array([0.4, 0.04, 0.4]), np.arange(6000)
    y = hovering(seed)[:, None] + stds * np.random.default_rng(seed).standard_normal((6000, 3))
    for sparse, phase in ((2, 0), (2, every // 2), (0, 1)):
        thin = y.copy()
        thin[steps % every != phase, sparse] = np.nan
        fitted = fit_model(recording(thin, 0.1))
        found = [s.std for s in fitted.sensors.values()]
        # The noise of the precise sensor is a tenth of that of the others, and less than the motion between two samples.
        assert (np.abs(found / stds - 1) < [0.15, 0.25, 0.15]).all(), (found, sparse, phase)
        assert fitted.errors == ()


def test_sparse_sensors_take_turns():
    stds, steps = np.array([0.4, 0.4, 0.4]), np.arange(6000)
    y = hovering(0)[:, None] + stds * np.random.default_rng(0).standard_normal((6000, 3))
    y[steps % 5 != 1, 0] = np.nan
    y[steps % 5 != 3, 2] = np.nan  # the first and the last have no common step
    fitted = fit_model(recording(y, 0.1))
    np.testing.assert_allclose([s.std for s in fitted.sensors.values()], stds, rtol=0.15)
    assert fitted.errors == ()


def test_a_sensor_may_have_samples_in_few_steps():
    y = hovering(0)[:, None] + 0.4 * np.random.default_rng(0).standard_normal((6000, 3))
    y[np.arange(6000) % 25 != 0, 2] = np.nan
    fitted = fit_model(recording(y, 0.1))
    np.testing.assert_allclose([s.std for s in fitted.sensors.values()], 0.4, rtol=0.2)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("still", [0.1, 0.5, 0.9])
def test_a_calm_part_does_not_count(still):
    rng = np.random.default_rng(1)
    y = level(20000, 1.0, 0.01, rng, still)[:, None] + 0.1 * rng.standard_normal((20000, 3))
    rec = recording(y, 0.01)
    for stretch in (slice(None), slice(0, 500)):  # the first is a whole recording, the second five calm seconds
        fitted = fit_model(rec, stretch)
        assert 1 / 1.3 < fitted.plant.std < 1.3
        np.testing.assert_allclose([s.std for s in fitted.sensors.values()], 0.1, rtol=0.2)


def test_sensors_that_are_silent_while_nothing_moves_do_not_hide_their_noise():
    rng = np.random.default_rng(2)
    y = level(20000, 1.0, 0.01, rng, 0.7)[:, None] + 0.1 * rng.standard_normal((20000, 3))
    y[:14000] = 0.0  # a parked car
    fitted = fit_model(recording(y, 0.01), slice(0, 15000))
    np.testing.assert_allclose([s.std for s in fitted.sensors.values()], 0.1, rtol=0.2)
    with pytest.raises(RecordingError, match="No sensor changes"):
        fit_model(recording(y, 0.01), slice(0, 5000))


def test_motion_that_is_hidden_in_the_noise_is_not_ruled_out():
    rng = np.random.default_rng(3)
    y = np.full((5000, 1), 7.0) + rng.standard_normal((5000, 3))
    fitted = fit_model(recording(y, 0.01))
    assert not fitted.moves
    assert 0 < fitted.plant.std * np.sqrt(0.01) < 0.05  # far below the noise


@pytest.mark.parametrize("rate", [0.3, 3.0])
def test_smooth_motion_has_a_rate(rate):
    rng = np.random.default_rng(4)
    speed = np.cumsum(rate * np.sqrt(0.01) * rng.standard_normal(20000))
    y = np.cumsum(0.01 * speed)[:, None] + 0.05 * rng.standard_normal((20000, 3))
    fitted = fit_model(recording(y, 0.01))
    assert isinstance(fitted.plant, ConstantRate)
    assert 1 / 1.5 < fitted.plant.std / rate < 1.5
    np.testing.assert_allclose([s.std for s in fitted.sensors.values()], 0.05, rtol=0.1)


def turning(seed):
    """Return a ship's heading (20 min, five courses) as three compasses measure it, once a second."""
    rng, heading, rate, y = np.random.default_rng(seed), 40.0, 0.0, []
    for course in np.repeat([40.0, 70.0, 55.0, 120.0, 90.0], [200, 300, 200, 300, 200]):
        rudder = np.clip(0.5 * (course - heading) - 8.0 * rate, -15.0, 15.0) + 0.5 * rng.standard_normal()
        rate += (0.12 * rudder - rate) / 12.0
        heading += rate
        y.append(heading)
    return np.array(y)[:, None] + [0.3, 1.5, 0.5] * rng.standard_normal((1200, 3))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(201, 209))
def test_turns_are_no_faults(seed):
    """Over lags as long as a turn, a heading seems a random walk; the drift of a compass then explains each turn as well."""
    y = turning(seed)
    t = 1.0 * np.arange(len(y))
    found, fitted = watched({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)})
    assert isinstance(fitted.plant, ConstantRate)
    assert 0.08 < fitted.plant.std < 0.3  # the rate changes by 0.15 a second as a turn begins
    assert not found.events
    y[720:, 2] += 3.0  # in a turn
    found, _ = watched({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)}, (0.0, 700.0))
    assert {event.sensor for event in found.events} == {"s2"}
    assert 0.0 <= found.events[0].start - 720.0 < 60.0


def test_biases_resolution_repeats_and_gaps_are_found():
    rng = np.random.default_rng(5)
    y = level(6000, 1.0, 0.01, rng)[:, None] + 0.1 * rng.standard_normal((6000, 3)) + [0.0, 0.5, -1.0]
    y = np.round(y / 0.02) * 0.02
    again = np.flatnonzero(rng.random(6000) < 0.3)[1:]
    for k in again:
        y[k, 1] = y[k - 1, 1]
    y[rng.random(6000) < 0.1, 2] = np.nan
    y[3000:4000, 0] = y[2999, 0]  # a frozen part is no healthy repeat
    fitted = fit_model(recording(y, 0.01))
    one, two, three = fitted.sensors.values()
    np.testing.assert_allclose([one.bias, two.bias, three.bias], [0.0, 0.5, -1.0], atol=0.02)
    np.testing.assert_allclose([s.resolution for s in (one, two, three)], 0.02, rtol=1e-6)
    assert one.repeats < 0.12
    assert 0.25 < two.repeats < 0.45
    assert (one.missing, two.missing) == (0.0, 0.0)
    assert three.missing == pytest.approx(0.1, abs=0.03)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("share", [0.001, 0.005, 0.02, 0.1, 0.6])
@pytest.mark.parametrize("frozen", [0.0, 0.1, 0.25, 0.4])
def test_repeats_and_missing_samples_are_counted_without_a_freeze_and_a_gap(frozen, share):
    """The share was that of the median of 64 parts: of 44 samples none or one repeats."""
    steps, seed = 2880, round(1000 * share + 100 * frozen)
    rng = np.random.default_rng([5, seed])
    y = level(steps, 1.0, 0.01, rng)[:, None] + 0.1 * rng.standard_normal((steps, 3))
    hold(y[:, 0], share, rng)
    y[rng.random(steps) < share, 1] = np.nan
    first = int(rng.uniform(0.1, 0.9 - frozen) * steps)
    healthy = np.ones(steps, dtype=bool)
    if frozen:
        part = slice(first, first + int(frozen * steps))
        y[part, 0], y[part, 1], healthy[part.start : part.stop + 1] = y[first - 1, 0], np.nan, False
    repeats = (np.diff(y[:, 0], prepend=np.nan) == 0)[healthy].mean()
    missing = np.isnan(y[:, 1])[healthy].mean()
    fitted = fit_model(recording(y, 0.01)).sensors
    off = (3.0 if frozen else 0.1) * np.sqrt(share * (1 - share) / healthy.sum())  # in standard errors of a count
    assert fitted["s0"].repeats == pytest.approx(max(repeats, 0.001), abs=off)
    assert fitted["s1"].missing == pytest.approx(missing, abs=off)


def test_lasting_and_shared_errors_are_found():
    rng = np.random.default_rng(6)
    decay = np.exp(-1 / 5.0)

    def coloured(std):
        e = np.empty(20000)
        e[0] = 0.0
        for k in range(1, 20000):
            e[k] = decay * e[k - 1] + std * np.sqrt(1 - decay**2) * rng.standard_normal()
        return e

    front, rear = coloured(0.1), coloured(0.1)
    own = np.column_stack([coloured(0.1) for _ in range(4)]) + 0.05 * rng.standard_normal((20000, 4))
    y = level(20000, 1.0, 0.01, rng)[:, None] + own + np.column_stack([front, front, rear, rear])
    fitted = fit_model(recording(y, 0.01))
    shared = {tuple(e.sensors): e for e in fitted.errors if e.common}
    assert set(shared) == {("s0", "s1"), ("s2", "s3")}
    for errors in shared.values():
        assert errors.std == pytest.approx(0.1, rel=0.3)
        assert 0.02 < errors.time_constant < 0.12
    for name in fitted.sensors:
        assert total(fitted, name) == pytest.approx(np.hypot(0.1, 0.05), rel=0.25)


def hold(samples, share, rng):
    """Let a sensor repeat a share of its samples."""
    for k in np.flatnonzero(rng.random(len(samples)) < share):
        samples[k] = samples[max(k - 1, 0)]


@pytest.mark.parametrize(("begins", "lasts", "expected"), [(4000, 1900, False), (0, 700, True)])
def test_a_slow_error_of_one_sensor_counts_if_it_recurs_and_not_if_it_is_a_fault(begins, lasts, expected):
    """An offset of three days in thirty became a lasting error, and the drift of another sensor was blamed on a third one."""
    rng, t = np.random.default_rng(1), 10.0 * np.arange(20_000)
    y = 20.0 + np.cumsum(0.02 * rng.standard_normal(20_000))[:, None] + 0.1 * rng.standard_normal((20_000, 3))
    wrong = (np.arange(20_000) % 2000 < lasts) if expected else (np.arange(20_000) // lasts == begins // lasts)
    y[:, 2] += 0.6 * wrong
    fitted = fit_model(recorded({name: Signal(t, y[:, i]) for i, name in enumerate("abc")}))
    assert any("c" in errors.sensors for errors in fitted.errors) == expected


def test_the_monitor_of_a_fit_is_that_of_the_file_that_it_writes():
    """In Python there was no way from a fit to its monitor but by a file."""
    rng, t = np.random.default_rng(3), 0.1 * np.arange(2000)
    quantity = 20.0 + np.cumsum(0.05 * rng.standard_normal(2000))
    y = quantity[:, None] + 0.1 * rng.standard_normal((2000, 3)) + [0.0, 0.4, -0.2]
    y[1500:, 1] += 1.0
    signals = {name: Signal(t, y[:, i]) for i, name in enumerate("abc")}
    by_file, _ = watched(signals)
    monitor, corrected = Monitor.fit(recorded(signals))
    found = monitor.run(corrected)
    np.testing.assert_allclose(
        found.fault_probability, by_file.fault_probability, atol=0.02
    )  # the file has five digits
    assert (
        [(e.sensor, e.kind) for e in found.events] == [(e.sensor, e.kind) for e in by_file.events] == [("b", "Offset")]
    )
    assert Monitor.fit(recorded(signals), alarm=Alarm(threshold=0.5))[0].alarm.threshold == 0.5
    with pytest.raises(ModelError, match=r"'a' of Monitor is FittedSensor.*Monitor\.fit makes"):
        Monitor(0.1, monitor.plant, fit_model(recorded(signals)).sensors)


def three_of_a_level(steps=400):
    rng, t = np.random.default_rng(5), 0.5 * np.arange(steps)
    level = 3.0 + np.cumsum(0.01 * rng.standard_normal(steps))
    y = (level[:, None] + 0.05 * rng.standard_normal((steps, 3))).round(4)
    y[30:40, 2] = np.nan  # no samples
    return t, y


@pytest.mark.parametrize("kind", ["seconds", "dates", "zone", "durations", "column", "file"])
def test_a_table_and_its_file_are_recordings(kind, tmp_path):
    t, y = three_of_a_level()
    usual = recorded({name: Signal(t, y[:, i]) for i, name in enumerate("abc")})
    table = pd.DataFrame(y, columns=list("abc"), index=pd.Index(t, name="time (s)"))
    start = pd.Timestamp("2026-05-01 08:00", tz="Europe/Berlin" if kind == "zone" else None)
    if kind in {"dates", "zone", "durations"}:
        table.index = pd.to_timedelta(t, unit="s") + (pd.Timedelta(0) if kind == "durations" else start)
    if kind == "column":
        table = table.reset_index()
    if kind == "file":
        table.to_csv(tmp_path / "level.csv")
    recording = recorded(tmp_path / "level.csv" if kind == "file" else table)
    assert recording.sensors == ("a", "b", "c")
    assert recording.origin == (start if kind in {"dates", "zone"} else None)
    np.testing.assert_array_equal(recording.y, usual.y)
    assert recording.dt == usual.dt


def test_a_stretch_is_steps_or_times():
    t, y = three_of_a_level(800)
    table = pd.DataFrame(y, columns=list("abc"), index=t)
    by_steps = Monitor.fit(table, slice(0, 501))[0]
    by_times = Monitor.fit(table, (0.0, 250.0))[0]
    table.index = pd.Timestamp("2026-05-01 08:00") + pd.to_timedelta(t, unit="s")
    by_dates = Monitor.fit(table, (None, "2026-05-01 08:04:10"))[0]
    assert by_steps.sensors == by_times.sensors == by_dates.sensors
    assert by_steps.plant == by_times.plant == by_dates.plant


def thermometers(rng, steps=6000):
    """Two thermometers outdoors, and one in a shelter that lags; the second is off for a part of the second half."""
    t = 60.0 * np.arange(steps)
    air = 12 + 6 * np.sin(2 * np.pi * t / 86400) + np.cumsum(0.02 * rng.standard_normal(steps))
    shelter = air.copy()
    for k in range(1, steps):
        shelter[k] = shelter[k - 1] + (air[k] - shelter[k - 1]) / 10
    y = np.stack([air, air, shelter], axis=1) + 0.1 * rng.standard_normal((steps, 3))
    y[3600:4800, 1] += 1.0
    return pd.DataFrame(y, columns=["north", "roof", "shelter"], index=t)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_fault_outside_of_a_long_stretch_does_not_count(seed):
    """With the noise and lasting errors of the whole recording healthy sensors had 11 to 42 alarms in ten days."""
    table = thermometers(np.random.default_rng(seed))
    monitor, corrected = Monitor.fit(table, slice(0, 3000))
    assert {event.sensor for event in monitor.run(corrected).events} == {"roof"}
    alone = fit_model(recorded(table[:3000]))
    part = fit_model(recorded(table), slice(0, 3000))
    assert not part.borrows
    for name, sensor in part.sensors.items():
        assert sensor.std == pytest.approx(alone.sensors[name].std)
    assert fit_model(recorded(table), slice(0, 500)).borrows


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("start", "size"), [(0.2, 0.6), (0.4, 3.0), (0.8, 0.6)])
def test_two_sensors_that_part_do_not_teach_the_model_to_expect_it(start, size):
    """A drift of one of two was taken for lasting errors of both: no fault was found, without a word, up to 60 sd."""
    rng = np.random.default_rng(round(10 * start))
    level = 20.0 + np.cumsum(0.01 * rng.standard_normal(6000))
    y = level[:, None] + 0.05 * rng.standard_normal((6000, 2))
    first = round(6000 * start)
    y[first:, 0] += np.linspace(0.0, size, 6000 - first)
    table = pd.DataFrame(y, columns=["a", "b"], index=5.0 * np.arange(6000))
    fitted = fit_model(recorded(table))
    assert abs(fitted.parted.begin - first) < 600
    assert fitted.parted.size == pytest.approx(size, rel=0.2)
    assert not fitted.errors
    monitor, corrected = Monitor.fit(table)
    found = monitor.run(corrected)
    assert found.events or found.disagreements  # which one is wrong two sensors do not show
    assert min([event.start for event in found.events], default=np.inf) > 5.0 * first


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_gain_error_of_one_of_two_is_no_parting(seed):
    """While the quantity rises, it lets them part, and the healthy one had alarms."""
    rng = np.random.default_rng(seed)
    level = np.linspace(20.0, 80.0, 6000)
    y = np.stack([level, 1.02 * level], axis=1) + 0.1 * rng.standard_normal((6000, 2))
    table = pd.DataFrame(y, columns=["a", "b"], index=1.0 * np.arange(6000))
    fitted = fit_model(recorded(table))
    assert fitted.parted is None
    assert fitted.sensors["b"].gain == pytest.approx(1.02, abs=0.002)
    monitor, corrected = Monitor.fit(table)
    assert not monitor.run(corrected).events


@pytest.mark.parametrize("given", [{"bias": 5.0}, {"gain": 2.0}, {"bias": -3.0, "gain": 0.5}])
def test_a_fit_adds_to_the_biases_and_gains_that_are_known(given):
    t, y = three_of_a_level(1000)
    raw = y.copy()
    raw[:, 0] = raw[:, 0] * given.get("gain", 1.0) + given.get("bias", 0.0)
    signals = {name: Signal(t, raw[:, i], **(given if i == 0 else {})) for i, name in enumerate("abc")}
    monitor, corrected = Monitor.fit(recorded(signals))
    usual, usually = Monitor.fit(pd.DataFrame(y, columns=list("abc"), index=t))
    np.testing.assert_allclose(corrected.y, usually.y, atol=1e-9)
    for run in (monitor.run(corrected), usual.run(usually)):
        assert [(event.sensor, event.kind) for event in run.events] == [("c", "DroppedOut")]
    raw_table = pd.DataFrame(raw, columns=list("abc"), index=t)
    np.testing.assert_allclose(monitor.recording(recorded(raw_table)).y, usually.y, atol=1e-9)
    as_before = Monitor.fit(corrected)[1]
    np.testing.assert_allclose(as_before.y, corrected.y, atol=1e-3)


def test_sensors_in_another_order_are_put_into_that_of_the_monitor():
    t, y = three_of_a_level(1000)
    monitor, corrected = Monitor.fit(pd.DataFrame(y, columns=list("abc"), index=t))
    turned = {name: Signal(t, y[:, "abc".index(name)]) for name in "bca"}
    np.testing.assert_array_equal(monitor.recording(turned).y, monitor.recording(recorded(turned)).y)
    np.testing.assert_allclose(monitor.recording(turned).y, corrected.y)


def test_an_angle_stays_one_in_later_signals():
    rng, t = np.random.default_rng(2), 1.0 * np.arange(2000)
    heading = (np.cumsum(rng.choice([2.0, 3.0], 2000)))[:, None] + rng.standard_normal((2000, 2))
    signals = {name: Signal(t, heading[:, i] % 360.0, period=360.0) for i, name in enumerate("ab")}
    monitor, _ = Monitor.fit(recorded(signals), gains=False)
    monitor = replace(monitor, sensors={n: replace(s, period=360.0) for n, s in monitor.sensors.items()})
    plain = {name: Signal(t, heading[:, i] % 360.0) for i, name in enumerate("ab")}
    np.testing.assert_array_equal(monitor.recording(plain).y, monitor.recording(signals).y)
    assert Monitor.fit(signals, gains=False)[0].sensors["a"].period == 360.0


def test_times_in_a_column_of_a_table_that_was_filtered():
    t, y = three_of_a_level()
    table = pd.DataFrame(y, columns=list("abc"))
    table.insert(0, "time", 10.0 * t)
    assert recorded(table.drop(index=[5])).dt == 5
    assert recorded(table.drop(columns="time").set_axis(range(0, 10 * len(t), 10))).dt == 10


@pytest.mark.parametrize("seed", range(3))
def test_two_sensors_that_wander_about_each_other_have_not_parted(seed):
    rng = np.random.default_rng(seed)
    y = 20.0 + np.cumsum(0.02 * rng.standard_normal(6000))[:, None] + 0.1 * rng.standard_normal((6000, 2))
    errors, last = np.zeros((6000, 2)), np.zeros(2)
    for k in range(6000):  # errors of 0.2 that last 200 samples
        last = last * (1 - 1 / 200) + 0.2 * np.sqrt(2 / 200) * rng.standard_normal(2)
        errors[k] = last
    table = pd.DataFrame(y + errors, columns=["a", "b"], index=1.0 * np.arange(6000))
    assert fit_model(recorded(table)).parted is None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", ["signals", "recorded", "align", "table", "dates", "file"])
def test_a_fitted_monitor_judges_later_recordings(kind, tmp_path):
    """Their biases were not subtracted, so that healthy sensors had alarms to the end."""

    def data(seed):
        rng = np.random.default_rng(seed)
        level = 2.0 + np.cumsum(0.003 * rng.standard_normal(2000))
        y = level[:, None] + 0.01 * rng.standard_normal((2000, 3)) + [0.0, 0.05, -0.04]
        return pd.DataFrame(y, columns=list("abc"), index=pd.Index(10.0 * np.arange(2000), name="time"))

    monitor, corrected = Monitor.fit(data(1))
    assert abs(monitor.sensors["b"].bias - monitor.sensors["a"].bias) == pytest.approx(0.05, abs=0.005)
    later = data(2)
    later.loc[10_000.0:, "c"] += 0.2
    signals = {name: Signal(later.index, later[name]) for name in later}
    given = {"signals": signals, "recorded": recorded(signals), "table": later, "file": tmp_path / "later.csv"}
    given["align"] = align(signals, {}, 10.0)
    later.to_csv(given["file"])
    given["dates"] = later.set_index(pd.Timestamp("2026-05-01") + pd.to_timedelta(later.index, unit="s"))
    found = monitor.run(given[kind])
    assert [event.sensor for event in found.events] == ["c"]
    assert (found.recording.origin is not None) == (kind == "dates")
    assert monitor.recording(corrected) is corrected
    np.testing.assert_array_equal(monitor.run(data(1)).fault_probability, monitor.run(corrected).fault_probability)
    with pytest.raises(ModelError, match="The recording has the sensors 'x', 'y', but the monitor has 'a', 'b', 'c'"):
        monitor.run(recorded({"x": signals["a"], "y": signals["b"]}))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (({"a": [1.0, 2.0]},), "A recording is made of signals by name"),
        (([1.0, 2.0],), "a pandas table or a CSV file, not of"),
        (({},), "There is no sensor to monitor"),
        ((pd.DataFrame({"a": [1.0, 0.5, 2.0], "b": 0.0}),), "The table has no column of times"),
        ((None, "day 1"), "stretch is 'day 1'; give a slice of steps, or the first and the last time"),
        ((None, ("noon", None)), "The start .--from. is 'noon'; give a number of seconds, or a date"),
        ((None, (0.0, [1])), "The stretch has the end .--to.=.1.; it must be a finite number"),
        ((None, (9.0, 2.0)), "The start .--from. is later than the end .--to."),
        ((None, (0.0, "2026-05-01")), "The end .--to. is a date, but the times of the recording are 0 to 199"),
    ],
)
def test_what_is_no_recording_or_stretch_is_refused(arguments, sentence):
    t, y = three_of_a_level()
    first = pd.DataFrame(y, columns=list("abc"), index=t) if arguments[0] is None else arguments[0]
    with pytest.raises((RecordingError, ModelError), match=sentence):
        Monitor.fit(first, *arguments[1:])
    with pytest.raises(ModelError, match="gains is 'no'; it must be True or False"):
        Monitor.fit(pd.DataFrame(y, columns=list("abc"), index=t), gains="no")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("decimals", [2, 9])
@pytest.mark.parametrize("share", [0.2, 0.4])
def test_slow_data_that_repeat_are_healthy(share, decimals):
    """Their shares of repeated samples are in the fitted model, with and without a resolution; what fails is found as before."""
    rng = np.random.default_rng(7)
    t = 30.0 * np.arange(3000)
    truth = 20.0 + 3.0 * np.sin(2 * np.pi * t / 86400.0)
    y = truth[:, None] + 0.05 * rng.standard_normal((3000, 3)) + [0.0, 0.3, -0.2]
    for column in y.T:
        hold(column, share, rng)
    y = np.round(y, decimals)
    found, fitted = watched({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)})
    assert share - 0.05 < fitted.sensors["s0"].repeats < share + 0.1
    assert (found.fault_probability > 0.5).mean() < 0.001
    assert len(found.events) <= 1
    y[2000:2100, 1] += 2.0
    y[2500:2560, 2] = y[2499, 2]
    found, _ = watched({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)})
    by_kind = {event.kind: event for event in found.events}
    assert (by_kind["Offset"].sensor, by_kind["Frozen"].sensor) == ("s1", "s2")
    assert 0 <= by_kind["Offset"].start - 60000.0 < 300.0
    assert 0 <= by_kind["Frozen"].start - 75000.0 < 900.0
    assert len(found.events) <= 3


@pytest.mark.skipif(study.recorded() is None, reason=NEEDS_RECORDING)
@pytest.mark.parametrize("share", [0.2, 0.5])
def test_real_wheels_that_repeat_are_healthy(share):
    """Recorded wheel speeds, of which a logger holds some samples; at most one alarm more than without (of a real bump)."""
    _, signals = redundant_signals([study.recorded() / "wheel_speed.csv"])
    rng, held = np.random.default_rng(0), {}
    for name, signal in signals.items():
        values = np.array(signal.values)
        hold(values, share, rng)
        held[name] = Signal(signal.time, values)
    found, _ = watched(held)
    frozen = found.mode_probability[..., found.kinds.index("Frozen")]
    assert (frozen > 0.5).mean() < 0.002
    assert (found.fault_probability > 0.5).mean() < 0.02


def watched(signals, stretch=(None, None), file=None):
    """Return what a monitor finds with the model that was fitted to the same signals, and the model."""
    rec = recorded(signals)
    fitted = fit_model(rec, stretch_of(rec, *stretch))
    names = fitted.sensors
    known = {
        name: replace(signal, bias=names[name].bias, resolution=names[name].resolution)
        for name, signal in signals.items()
    }
    monitor = monitor_of(fitted, rec, file or {name: Place("a.csv", name, "t") for name in names})
    return monitor.run(align(known, {}, monitor.dt)), fitted


def monitor_of(fitted, rec, places):
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.toml")
        file.write_text(as_model_file(fitted, rec, places), encoding="utf-8")
        return load_monitor(file)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), missing=st.floats(0.0, 1.0))
def test_the_median_is_numpys(seed, missing):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((7, 9, 3))
    values[rng.random(values.shape) < missing] = np.nan
    for axis in range(3):
        ours, none = median(values, axis), np.isnan(values).all(axis=axis, keepdims=True)
        np.testing.assert_array_equal(np.isnan(ours), none.squeeze(axis))
        theirs = np.nanmedian(np.where(none, 0.0, values), axis=axis)
        np.testing.assert_allclose(ours, np.where(none.squeeze(axis), np.nan, theirs))


def test_the_three_cornered_hat_adds_up():
    own, shared = np.array([1.0, 4.0, 2.0, 0.5]), {(0, 1): 6.0, (2, 3): 6.0}
    pairs = list(combinations(range(4), 2))
    apart = np.array([own[i] + own[j] + sum(v for g, v in shared.items() if (i in g) != (j in g)) for i, j in pairs])
    windows = np.tile(apart, (5, 1))
    assert groups(apart, 4) == [(0, 1), (2, 3)]
    unknown = np.full((5, 4), np.nan)
    np.testing.assert_allclose(share_out(windows, unknown, [(0, 1), (2, 3)])[0], [*own, 6.0, 6.0], rtol=1e-9)
    alone = np.array([own[i] + own[j] for i, j in pairs])
    np.testing.assert_allclose(share_out(np.tile(alone, (5, 1)), unknown, [])[0], own, rtol=1e-9)


def test_noise_is_taken_apart_by_its_time_constant():
    lags = 2.0 ** np.arange(6)
    noise = decompose(lags, 2 * (0.5 + 2.0 * (1 - np.exp(-lags / 4.0))), white=True)
    assert noise.white == pytest.approx(0.5, rel=1e-6)
    ((variance, constant),) = noise.lasting
    assert (variance, constant) == pytest.approx((2.0, 4.0), rel=1e-6)
    assert decompose(lags, np.full(6, 3.0), white=True).lasting == ()
    assert decompose(lags, np.full(6, np.nan), white=True).variance == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_frozen_part_is_no_bias(seed):
    rng = np.random.default_rng(seed)
    y = level(3000, 0.2, 0.02, rng)[:, None] + [0.5, 0.7] * rng.standard_normal((3000, 2))
    y[2000:2600, 0] = y[1999, 0] + 1.0
    one, two = fit_model(recording(y, 0.02)).sensors.values()
    np.testing.assert_allclose([one.bias, two.bias], 0.0, atol=0.05)


def test_a_bias_that_wanders_is_told_from_noise():
    rng = np.random.default_rng(8)
    y = 0.1 * rng.standard_normal((8000, 4))
    variance, _ = wander(y, 0.75)
    np.testing.assert_array_equal(variance, 0.0)
    y[:, 2] += np.repeat(0.3 * rng.standard_normal(32), 250)
    y[:, 0] += np.repeat(0.3 * rng.standard_normal(32), 250)
    variance, times = wander(y, 0.75)
    assert 0.1 < np.sqrt(variance[2]) < 0.6
    assert 100 < times[2] < 1000


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda y: y[:, :1], "two or more sensors"),
        (lambda y: y[:150], "150 samples .* 200"),
        (lambda y: np.ones_like(y), "No sensor changes"),
        (lambda y: np.column_stack([y[:, 0], y[:, 1], np.full(len(y), 5.0)]), "'s2' does not change"),
        (lambda y: y[:, [0, 1, 1]], "'s1' and 's2' have the same"),
        (lambda y: np.column_stack([y[:, 0], y[:, 1], np.arange(len(y))]), "'s2' does not follow"),
        (lambda y: np.where(np.arange(len(y))[:, None] % 2 == [0, 0, 1], y, np.nan), "'s2' cannot be compared"),
    ],
)
def test_what_cannot_be_fitted_is_named(change, words):
    rng = np.random.default_rng(9)
    y = level(1000, 1.0, 0.01, rng)[:, None] + 0.1 * rng.standard_normal((1000, 3))
    changed = change(y)
    t = 0.01 * np.arange(len(changed))
    rec = align({f"s{i}": Signal(t, column) for i, column in enumerate(changed.T)}, {}, 0.01)
    with pytest.raises(RecordingError, match=words):
        fit_model(rec)


@pytest.mark.parametrize("share", [0.03, 0.1, 0.3])
def test_missing_samples_do_not_lengthen_the_steps(share):
    rng = np.random.default_rng(11)
    times = 0.1 * np.arange(600) + rng.uniform(-0.005, 0.005, 600)
    signals = {}
    for name in "abc":
        values = np.where(rng.random(600) < share, np.nan, rng.standard_normal(600))
        signals[name] = Signal(times, values, resolution=0.0)
    dt = float(sample_time(signals))
    assert dt == pytest.approx(0.1, rel=5e-4)
    assert align(signals, {}, dt).replaced == (0, 0, 0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("interval", "missing"), [(60.0, 0.08), (60.005, 0.08), (0.1, 0.3), (1 / 30, 0.0), (59.99, 0.0)]
)
def test_no_sample_is_lost_to_a_rounded_step(interval, missing):
    """Time stamps jitter by a fifteenth of the interval: a step that is off by a ten-thousandth loses samples of a long log."""
    for seed in range(20):
        rng, n = np.random.default_rng(seed), 20_000
        times = interval * (np.arange(n) + rng.uniform(-0.07, 0.07, n))
        signals = {name: Signal(times, np.where(rng.random(n) < missing, np.nan, 0.0), resolution=0.0) for name in "ab"}
        dt = float(sample_time(signals))
        assert dt == pytest.approx(interval, rel=1e-4)
        assert sum(align(signals, {}, dt).replaced) <= 2e-3 * 2 * n
        if interval in (60.0, 0.1):
            assert dt == interval


def test_the_interval_of_a_sensor_does_not_depend_on_the_step_or_on_what_is_missing():
    rng, n = np.random.default_rng(0), 2000
    times = np.round(60.0 * np.arange(n) + rng.uniform(-4, 4, n))
    times[1500:] += 12_345.0  # the logger was off
    signals = {
        "a": Signal(times, np.where(rng.random(n) < 0.1, np.nan, 0.0), resolution=0.0),
        "b": Signal(times[::10], np.zeros(n // 10), resolution=0.0),
        "c": Signal(times[:1], [0.0], resolution=0.0),
    }
    for dt in (17.0, 50.0, 60.0, 600.0):
        assert align(signals, {}, dt).interval == pytest.approx((60.0, 600.0, np.inf), rel=1e-3)
        assert align(signals, {}, dt).of_sensors([1]).interval == pytest.approx((600.0,), rel=1e-3)


def test_a_better_step_is_counted():
    """Two samples in each step of 10 s; time stamps jitter by a fifth of their interval, and some samples are lost."""
    rng = np.random.default_rng(0)
    times = 5.0 * np.arange(1000) + rng.uniform(-1, 1, 1000)
    signals = {n: Signal(times, np.where(rng.random(1000) < 0.05, np.nan, 0.0), resolution=0.0) for n in "ab"}
    found = align(signals, {}, 10)
    assert sum(found.replaced) > 800
    assert (found.better, found.left_out) == (5, 0)
    assert align(signals, {}, 5).better is None


def test_times_that_jitter_get_shorter_steps():
    even = Signal(np.arange(1000) / 30, np.zeros(1000), resolution=0.0)
    assert float(sample_time({"a": even})) == pytest.approx(1 / 30, rel=1e-4)
    assert str(sample_time({"a": Signal(0.01 * np.arange(1000), np.zeros(1000), resolution=0.0)})) == "1/100"
    rng = np.random.default_rng(10)
    times = np.cumsum(rng.uniform(0.001, 0.019, 1000))
    uneven = Signal(times, np.zeros(1000), resolution=0.0)
    dt = float(sample_time({"a": uneven}))
    assert 0.004 < dt < 0.01
    assert align({"a": uneven}, {}, dt).replaced[0] <= 0.12 * 1000


@pytest.mark.skipif(study.recorded() is None, reason=NEEDS_RECORDING)
@pytest.mark.parametrize("stretch", [(None, None), (0.0, 20.0), (40.0, 60.0), (14.0, 19.0)])
def test_a_wheel_that_fails_while_braking_casts_no_blame_on_others(stretch, tmp_path):
    places, signals = redundant_signals([study.recorded() / "wheel_speed.csv"])
    rec = recorded(signals)
    fitted = fit_model(rec, stretch_of(rec, *stretch))
    assert isinstance(fitted.plant, ConstantRate)
    monitor = monitor_of(fitted, rec, places)
    sensors, _ = monitor.signals([study.recorded() / "wheel_speed.csv"])
    healthy = monitor.run(align(sensors, {}, monitor.dt))
    assert (healthy.fault_probability > 0.5).mean() < 0.015
    others, found = [], []
    for kind, size in (("freeze", 0.0), ("injection", 0.5), ("drift", 1.0), ("noise", 5.0)):
        for i, name in enumerate(sensors):
            rng = np.random.default_rng(i)
            broken = study.broken(sensors[name], kind, size, 0.04, (31.5, 34.5), rng)
            part = study.until(align({**sensors, name: broken}, {}, monitor.dt), 36.0)
            run = monitor.run(part)
            after, during = run.time >= 31.5, (run.time >= 31.5) & (run.time < 34.5)
            blamed = run.fault_probability > 0.5
            others.append(blamed[after][:, [j for j in range(4) if j != i]].mean())
            found.append(blamed[during, i].mean())
    assert np.mean(others) < 0.01
    assert np.mean(found) > 0.6


def test_every_choice_of_the_fit_has_a_reason_and_is_made_somewhere():
    folder = Path(_fit_settings.__file__).parent
    text = "".join(file.read_text(encoding="utf-8") for file in folder.glob("*.py"))
    for choice in fields(_fit_settings.FitSettings):
        assert len(choice.metadata["why"]) > 20
        assert f"FIT.{choice.name}" in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "t,a,b\n01-Mar-2026 12:00,1,1\n",
            r"column 't', such as '01-Mar-2026 12:00', are not in the form of ISO 8601. Write them as 2026-03-28 08:00:00",
        ),
        ("Zeit,a,b\n12:00,1,1\n12:01,2,2\n", r"the first, 'Zeit', has no number. Name the column of times 't'"),
        ("Zeit,a,b\n1,1,1\n1,2,2\n", r"the first, 'Zeit', does not increase"),
        ("t,a,b\n0,1,1\n1,x,1\n2,1,1\n", r"^[^:]*data.csv: 'x' in line 3, column 'a', is no number"),
    ],
)
def test_times_that_are_no_seconds_are_named(text, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("data.csv").write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match=words):
        redundant_signals(["data.csv"])


@pytest.mark.parametrize(
    ("first", "second", "refused"),
    [
        ("T_1 (degC)", "T_2 (kPa)", True),
        ("T_1_degC", "T_2_degF", True),
        ("x [mm]", "y_cm", True),
        ("T_1 [degC]", "T_2 (degC)", False),
        ("T_1 [degC]", "T_2", False),
        ("rate [rpm]", "rate (front)", False),
        ("T_a", "T_b", False),
        ("v_min", "v_max", False),
        ("p_top", "p_bar", False),  # a bar, but no word beside it is a unit
        ("T_in", "T_bar", False),  # an inch and a bar: words that happen to be units
    ],
)
def test_columns_with_different_units_are_not_one_quantity(first, second, refused, tmp_path):
    rng = np.random.default_rng(0)
    level = 20.0 + np.cumsum(0.05 * rng.standard_normal(200))
    rows = (f"{0.1 * k},{x},{x + 0.1}" for k, x in enumerate(level))
    (tmp_path / "run.csv").write_text("\n".join([f"t,{first},{second}", *rows]))
    if refused:
        with pytest.raises(RecordingError, match=r"different units.*--sensor"):
            redundant_signals([tmp_path / "run.csv"])
        places, signals = redundant_signals([tmp_path / "run.csv"], [first])
        assert list(signals) == [first]
        return
    places, signals = redundant_signals([tmp_path / "run.csv"])
    samples = recorded(signals)
    (tmp_path / "model.toml").write_text(as_model_file(fit_model(samples), samples, places))
    units = tuple(sensor.unit for sensor in load_monitor(tmp_path / "model.toml").sensors.values())
    assert units == tuple(signal.unit for signal in signals.values())
    assert units == tuple(
        name[-5:-1] if name[-5:-1] == "degC" else "rpm" if "rpm" in name else "" for name in (first, second)
    )


def test_a_fit_that_takes_another_quantity_for_a_sensor_gives_a_model_that_can_be_read(tmp_path):
    """Three encoders, of which one freezes, and the voltage: a lasting error of one of them came out as zero."""
    rng, t = np.random.default_rng(0), 0.01 * np.arange(3000)
    voltage = 5 * np.sign(np.sin(0.7 * t)) + 2 * np.sin(3 * t)
    y = np.cumsum(0.02 * voltage)[:, None] + rng.normal(size=(3000, 3)) * [0.001, 0.005, 0.02]
    y[1500:, 0] = y[1500, 0]
    columns = {"a": y[:, 0], "b": y[:, 1], "c": y[:, 2], "voltage": voltage}
    fitted = fit_model(align({name: Signal(t, x.round(5)) for name, x in columns.items()}, {}, 0.01))
    assert all(errors.std > 0 for errors in fitted.errors)


@pytest.mark.parametrize("name", ["t_ms", "time [ms]", "Elapsed_ms"])
def test_times_in_milliseconds_are_known_from_their_name(tmp_path, name):
    rng = np.random.default_rng(0)
    rows = "".join(f"{20 * k},{a:.3f},{b:.3f}\n" for k, (a, b) in enumerate(rng.standard_normal((50, 2))))
    (tmp_path / "run.csv").write_text(f"{name},a,b\n{rows}")
    places, signals = redundant_signals([tmp_path / "run.csv"])
    assert places["a"].time == name
    assert signals["b"].time[-1] == 0.98
    assert recorded(signals).dt == Fraction("0.02")


@pytest.mark.parametrize(("unit", "factor", "offset"), [("cm", 100.0, 0.0), ("degF", 1.8, 32.0)])
def test_samples_in_another_unit_are_converted(unit, factor, offset, tmp_path):
    """One of three sensors is logged in another unit; the fitted model file reads its column in the unit of the first one."""
    first = {"cm": "m", "degF": "degC"}[unit]
    y = 20.0 + np.random.default_rng(0).standard_normal((200, 3)).round(2)
    rows = (f"{k},{a},{b},{c * factor + offset:.6g}" for k, (a, b, c) in enumerate(y))
    (tmp_path / "run.csv").write_text("\n".join([f"t,x_1 [{first}],x_2,x_3 [{unit}]", *rows]))
    places, signals = redundant_signals([tmp_path / "run.csv"])
    samples = recorded(signals)
    np.testing.assert_allclose(samples.y, y, rtol=1e-9)
    assert samples.units == (first, "", first)
    (tmp_path / "model.toml").write_text(as_model_file(fit_model(samples), samples, places))
    monitor = load_monitor(tmp_path / "model.toml")
    bias = [sensor.bias for sensor in monitor.sensors.values()]
    np.testing.assert_allclose(monitor.read([tmp_path / "run.csv"]).y + bias, samples.y, rtol=1e-9)
    logged = (tmp_path / "run.csv").read_text().splitlines()[1].split(",")[-1]
    without = replace(monitor, invalid=[float(logged)])  # as the column has it
    assert np.isnan(without.read([tmp_path / "run.csv"]).y).any()


def test_dates_of_a_clock_that_is_set_back_are_times_in_a_column_of_any_name(tmp_path):
    dates = [f"2026-10-25 02:{minute:02}:00" for minute in (0, 20, 40, 0, 20, 40)]
    (tmp_path / "plant.csv").write_text("Zeit,a,b\n" + "".join(f"{date},{i},{i}\n" for i, date in enumerate(dates)))
    with pytest.raises(RecordingError, match="times go back by an hour"):
        redundant_signals(tmp_path / "plant.csv")


def encoders(seed, sensors=3):
    """Position sensors of an axis that moves to and fro, of which the first is by far the best."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(3000)
    position = 0.1 - 0.1 * np.cos(np.pi * t / 2)
    return t, position[:, None] + rng.standard_normal((3000, sensors)) * [5e-6, 2e-5, 6e-5][:sensors]


def fitted_file(t, y, **settings):
    """Return a fitted model, and the text of its file."""
    names = [f"s{i}" for i in range(y.shape[1])]
    recording = recorded({name: Signal(t, column, resolution=0.0) for name, column in zip(names, y.T, strict=True)})
    fitted = replace(fit_model(recording), **settings)
    return fitted, as_model_file(fitted, recording, {name: Place("x.csv", name, "t") for name in names})


@pytest.mark.parametrize("seed", [5, 6])
def test_an_offset_of_the_best_of_three_sensors_is_no_fault_of_the_others(tmp_path, seed):
    t, y = encoders(seed)
    y[1500:1550, 0] += 5e-5
    np.savetxt(tmp_path / "x.csv", np.column_stack([t, y]), delimiter=",", header="t,s0,s1,s2", comments="")
    fitted, text = fitted_file(t, y)
    assert not fitted.errors
    (tmp_path / "model.toml").write_text(text)
    monitor = load_monitor(tmp_path / "model.toml")
    assert monitor.joint
    assert {event.sensor for event in monitor.run(monitor.read(tmp_path / "x.csv")).events} == {"s0"}


def lasting(seed, sensors):
    """Samples, once a minute, of sensors with lasting errors, of a quantity that changes in steps."""
    rng, decay, errors = np.random.default_rng(seed), np.exp(-1 / 60), np.zeros((4000, sensors))
    for k in range(1, 4000):
        errors[k] = decay * errors[k - 1] + 0.15 * np.sqrt(1 - decay**2) * rng.standard_normal(sensors)
    level = np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], 10), 400) + 0.01 * rng.standard_normal(4000)
    return 60.0 * np.arange(4000), level[:, None] + errors + 0.1 * rng.standard_normal((4000, sensors))


@pytest.mark.parametrize("sensors", [2, 3])
def test_sensors_with_lasting_errors_are_judged_together(tmp_path, sensors):
    t, y = lasting(0, sensors)
    names = ",".join(f"s{i}" for i in range(sensors))
    np.savetxt(tmp_path / "x.csv", np.column_stack([t, y]), delimiter=",", header=f"t,{names}", comments="")
    fitted, text = fitted_file(t, y)
    assert fitted.errors
    (tmp_path / "model.toml").write_text(text)
    monitor = load_monitor(tmp_path / "model.toml")
    assert monitor.joint
    recording = monitor.read(tmp_path / "x.csv")
    assert not monitor.run(recording).events
    if sensors == 2:  # one by one, steps of the quantity look like faults
        assert replace(monitor, joint=False).run(recording).events


def test_sensors_that_do_not_follow_or_have_codes_are_judged_one_by_one():
    assert "joint = true" in fitted_file(*encoders(5, 2))[1]
    assert "joint" not in fitted_file(*encoders(5), strangers={"s0": 0.1})[1]
    t, y = encoders(5)
    y[600:900:50, 0] = -9999.0
    fitted, text = fitted_file(t, y)
    assert fitted.coded
    assert "joint" not in text


def flows(seed, sensors, gain):
    """Flow meters with a rhythm of a day, once a minute for a week, of which the second has a gain."""
    rng, t = np.random.default_rng(seed), np.arange(10000)
    wander = np.zeros(len(t))
    for k in range(1, len(t)):
        wander[k] = 0.99 * wander[k - 1] + 0.05 * rng.standard_normal()
    y = (12 + wander + 2.5 * np.sin(2 * np.pi * t / 1440))[:, None] * np.array([1.0, gain, 1.0])[:sensors]
    return 60.0 * t, (y + rng.standard_normal(y.shape) * [0.08, 0.1, 0.12][:sensors]).round(3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sensors", [2, 3])
def test_a_gain_error_is_divided_out(seed, sensors, tmp_path):
    t, y = flows(seed, sensors, 1.02)
    fitted, text = fitted_file(t, y)
    assert [round(sensor.gain, 2) for sensor in fitted.sensors.values()] == [1.0, 1.02, 1.0][:sensors]
    np.testing.assert_allclose(
        [sensor.std for sensor in fitted.sensors.values()], [0.08, 0.1, 0.12][:sensors], rtol=0.1
    )
    np.savetxt(
        tmp_path / "x.csv", np.column_stack([t, y]), delimiter=",", header="t,s0,s1,s2"[: 1 + 3 * sensors], comments=""
    )
    (tmp_path / "model.toml").write_text(text)
    monitor = load_monitor(tmp_path / "model.toml")
    corrected = monitor.read(tmp_path / "x.csv").y
    apart = (corrected[:, 1] - corrected[:, 0])[: 10000 // 1440 * 1440]
    assert (
        abs(apart @ np.sin(2 * np.pi * np.arange(len(apart)) / 1440)) / (len(apart) / 2) < 0.01
    )  # 0.05 with the gain error
    assert abs(np.median(apart)) < 0.01
    assert (
        fit_model(recorded({f"s{i}": Signal(t, y[:, i]) for i in range(sensors)}), gains=False).sensors["s1"].gain
        == 1.0
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("sensors", [2, 3])
def test_sensors_without_a_gain_error_get_no_gain(seed, sensors):
    fitted, text = fitted_file(*flows(seed, sensors, 1.0))
    assert all(sensor.gain == 1.0 for sensor in fitted.sensors.values())
    assert "gain" not in text


@pytest.mark.sampled(2)
@pytest.mark.parametrize("count", [0.2, 0.5])
@pytest.mark.parametrize("fault", ["none", "drift", "offset"])
def test_rounding_errors_last_until_the_quantity_has_moved_by_a_step(count, fault):
    """Healthy thermometers with coarse steps had an alarm every few minutes."""
    rng, n = np.random.default_rng(0), 8000
    level = 20.0 + np.cumsum(0.016 * rng.standard_normal(n))
    y = level[:, None] + [0.05, 0.08, 0.12] * rng.standard_normal((n, 3))
    y[5000:, 1] += {"none": 0.0, "drift": 0.002 * np.arange(n - 5000), "offset": 2.0}[fault]
    y = np.round(y / count) * count
    signals = {name: Signal(np.arange(float(n)), y[:, i]) for i, name in enumerate("abc")}
    monitor, corrected = Monitor.fit(recorded(signals))
    events = monitor.run(corrected).events
    assert {event.sensor for event in events} == (set() if fault == "none" else {"b"})
    assert all(event.start >= 5000 for event in events)
    rounding = [error for error in monitor.errors if error.sensors == ["a"]]
    assert rounding[0].std == pytest.approx(count / 12**0.5)


@pytest.mark.parametrize("quality", [False, True])
def test_a_table_with_a_row_for_each_value_is_named_with_the_remedy(quality, tmp_path):
    """As historians export it; sorted by time or by tag, its times come again for each tag."""
    rng, times = np.random.default_rng(0), np.arange(400) * 0.5
    rows = pd.concat(
        [pd.DataFrame({"t": times, "Tag": tag, "Value": 20.0 + 0.1 * rng.standard_normal(400)}) for tag in ("T1", "T2")]
    )
    if quality:
        rows.insert(1, "Quality", rng.choice(["Good", "Bad", "Uncertain"], len(rows)))
    for order in ("Tag", "t"):
        rows.sort_values(order, kind="stable").to_csv(tmp_path / "long.csv", index=False)
        with pytest.raises(RecordingError, match=r"its column 'Tag' says of what \(T1, T2\)\. Give each a column"):
            recorded(tmp_path / "long.csv")
    set_back = rows[rows["Tag"] == "T1"].assign(Tag=np.repeat(["Good", "Bad"], 200))
    set_back["t"] -= np.where(set_back["t"] > 150.0, 60.0, 0.0)  # a clock, beside a column of good and bad values
    set_back.to_csv(tmp_path / "one.csv", index=False)
    with pytest.raises(RecordingError, match="do not increase"):
        recorded(tmp_path / "one.csv")
    rows.pivot(index="t", columns="Tag", values="Value").to_csv(tmp_path / "wide.csv")
    assert list(recorded(tmp_path / "wide.csv").sensors) == ["T1", "T2"]


def test_a_drift_by_more_than_the_quantity_moves_is_fitted():
    """A thermocouple that drifted from 4000 of 14400 s on was refused as a column of another quantity; a ramp is one."""
    rng, t = np.random.default_rng(0), 5.0 * np.arange(2880)
    level = 8.0 * np.sin(2 * np.pi * t / 7000)[:, None] + rng.normal(size=(2880, 3))

    def fitted(start):
        drifting = level + np.outer(0.003 * np.clip(t - start, 0, None), [0, 1, 0])
        return fit_model(align({name: Signal(t, y) for name, y in zip("abc", drifting.T, strict=True)}, {}, dt=5))

    found = fitted(4000.0)
    assert found.changes["b"].begin * 5 == pytest.approx(4000, abs=500)
    assert found.sensors["b"].std == pytest.approx(1.0, rel=0.1)
    with pytest.raises(RecordingError, match="'b' does not follow the others"):
        fitted(0.0)
