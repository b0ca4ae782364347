"""Recordings at their own times, the model file, the likelihood, and what a monitor finds."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from scipy import linalg, stats

from bayesftc.controllers import Burst, Drifting, FixedPrecision, LinearModel, Noisier, Offset, SwitchingPrecision
from bayesftc.cosim.errors import BayesFTCError, ModelError, RecordingError
from bayesftc.cosim.judging.parts import alarms
from bayesftc.monitoring import (
    ActuatorEvent,
    Alarm,
    AlarmWatch,
    ConstantRate,
    FaultEvent,
    Input,
    Integrator,
    Matrices,
    Monitor,
    RandomWalk,
    Recording,
    Sensor,
    Signal,
    align,
    load_monitor,
    log_likelihood,
    monitor as _monitor,
    monitor_recording,
    recorded,
    redundant_signals,
)
from bayesftc.monitoring.alarms import sensor_events
from bayesftc.monitoring.csv import Tables
from bayesftc.monitoring.rest import at_rest, held

DT = 0.05


def test_samples_go_to_the_nearest_step_and_nothing_is_interpolated():
    fast = Signal([0.0, 0.049, 0.1, 0.149, 0.152, 0.21], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    slow = Signal([0.06, 0.16, 0.26], [11.0, np.nan, 13.0], bias=1.0, delay=0.01)
    recording = align({"fast": fast, "slow": slow}, {}, DT)
    assert recording.start == pytest.approx(0.05)  # the step at which each sensor has begun
    np.testing.assert_allclose(recording.time, [0.05, 0.1, 0.15, 0.2, 0.25])
    nan = np.nan
    np.testing.assert_array_equal(recording.y, [[2, 10], [3, nan], [5, nan], [6, nan], [nan, 12]])
    assert recording.replaced == (1, 0)
    assert recording.loss == (0.01, 0.75)  # the slow one sends at every fourth step
    np.testing.assert_array_equal(recording.u, np.zeros((5, 1)))


def test_a_dead_time_behind_an_input_is_a_negative_delay():
    """A plant whose output is the valve's position 60 s before."""
    t = 5.0 * np.arange(200)
    valve, flow = (np.where(t >= start, 1.0, 0.0) for start in (300, 360))
    recording = align({"flow": Signal(t, flow)}, {"valve": Signal(t, valve, delay=-60.0)}, 5)
    known = np.isfinite(recording.u[:, 0])
    np.testing.assert_array_equal(recording.u[known], recording.y[known])


def test_inputs_hold_their_samples_and_are_averaged_up_to_the_next_step():
    times = np.arange(0.0, 1.0, 0.01) + 0.003
    values = np.random.default_rng(0).standard_normal(len(times))
    sensor = Signal([0.2, 0.95], [0.0, 0.0])
    signals = {"smooth": Signal(times, values, smooth=0.2), "step": Signal(times, values)}
    recording = align({"s": sensor}, {**signals, "slow": Signal([0.31, 0.62], [1, 2])}, DT)
    fine = np.arange(0.0005, 1.0, 0.001)  # within milliseconds, during which nothing changes
    course = values[np.searchsorted(times, fine) - 1]
    for k, t in enumerate(recording.time):
        for column, window in ((0, 0.2), (1, DT)):
            inside = (fine > t + DT - window) & (fine < t + DT)
            assert recording.u[k, column] == pytest.approx(course[inside].mean(), abs=1e-9)
    slow = np.where(recording.time < 0.26, np.nan, np.where(recording.time < 0.62, 1.0, 2.0))
    slow[np.isclose(recording.time, 0.6)] = 1.6  # the last 30 of 50 ms
    np.testing.assert_allclose(recording.u[:, 2], slow)


@pytest.mark.parametrize(
    ("every", "expected"), [(1, range(8)), (2, [0, 0, 2, 2, 4, 4, 6, 6]), (0.5, np.arange(8) + 0.25)]
)
def test_a_control_acts_from_its_time_stamp_on_at_any_rate(every, expected):
    """A control that is logged at t_k acts from t_k to t_k+1, as that of a controller with a hold."""
    t = 0.1 * np.arange(8)
    logged = np.arange(0, 8, every)
    recording = align({"s": Signal(t, t)}, {"u": Signal(0.1 * logged, logged)}, 0.1)
    np.testing.assert_allclose(recording.u[:, 0], expected, atol=1e-9)


@pytest.mark.parametrize("digits", [3, 9, 17])
@pytest.mark.parametrize("dt", [DT, 0.1, Fraction(1, 30), Fraction(1, 60)])
@pytest.mark.parametrize("start", [0.0, 12.7, 1.7e9])
def test_a_control_recorded_at_a_step_acts_from_that_step_on(start, dt, digits):
    """Whatever way a file rounds its times: one step too early, the monitor blames a late actuator."""
    times = np.array([float(f"{t:.{digits}f}") for t in start + np.arange(600) * float(dt)])
    y, u = np.random.default_rng(0).standard_normal((2, 600))
    recording = align({"a": Signal(times, y)}, {"u": Signal(times, u)}, dt)
    np.testing.assert_array_equal(recording.y[:, 0], y)
    np.testing.assert_allclose(recording.u[:, 0], u, atol=1e-10)


def test_numbers_of_a_file_are_read_to_the_last_bit(tmp_path):
    values = np.random.default_rng(0).standard_normal(1000)
    for sign in ("", "+"):  # pandas reads a column with +.5 as text
        cells = [f"{sign * (v > 0)}{v!r}".replace("+0.", "+.") for v in values.tolist()]
        (tmp_path / "data.csv").write_text("v\n" + "\n".join(cells), encoding="utf-8")
        np.testing.assert_array_equal(Tables([tmp_path]).column(tmp_path / "data.csv", "v", "it"), values)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Signal([0, 1], [1.0]), "one value per time"),
        (lambda: Signal([0, 2, 1], [1, 2, 3]), "1 s follows 2 s. Sort the recording"),
        (lambda: Signal([0, 1, 1], [1, 2, 3]), "different samples at 1 s: 2 and 3. Keep one row for each time"),
        (lambda: Signal([0, np.nan], [1, 2]), "without a time"),
        (lambda: Signal([0, 1], [np.nan, np.inf]), "no samples"),
        (lambda: Signal(pd.date_range("2026-03-01", periods=2, freq="5s"), [1, 2]), "seconds, not dates"),
        (lambda: Signal(["2026-03-01", "2026-03-02"], [1, 2]), "seconds, not dates"),
        (lambda: Signal([datetime(2026, 3, 1), datetime(2026, 3, 2)], [1, 2]), "seconds, not dates"),
        (lambda: Signal([0, 1], [1, 2], smooth=-1.0), "smooth=-1.0"),
        (lambda: Signal([0, 1], [1, 2], delay=np.nan), "delay=nan"),
        (lambda: align({}, {}, DT), "no sensor to monitor"),
        (lambda: align({"a": Signal([0, 1], [1, 2]), "b": Signal([1e9, 1e9 + 1], [1, 2])}, {}, DT), "'a' .* and 'b' .* overlap"),
        (lambda: align({"a": Signal([0, 1e9], [1, 2])}, {}, DT), "in seconds"),
        (lambda: align({"a": Signal([0, 1], [1, 2])}, {"u": Signal([2, 3], [1, 2])}, DT), "do not overlap"),
        (lambda: align({"a": Signal([0, 1], [1, 2])}, {}, 0.0), "sample time"),
        (lambda: align({"a": Signal([0, 1], [1, 2])}, {}, 2.0), "to 1 s is shorter than one step of 2 s. Give a smaller dt"),
    ],
)  # fmt: skip
def test_recordings_that_do_not_fit(make, words):
    with pytest.raises(BayesFTCError, match=words):
        make()


def drive(seconds=12.0, seed=0, truth=lambda t: 10.0 + 3.0 * np.sin(t / 2)):
    """Return the columns of a made-up drive: two wheels of a coarse resolution, a slow third sensor, the acceleration."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    columns = {"t": t}
    for name in ("left", "right"):
        columns[name] = np.round((truth(t) + 0.2 * rng.standard_normal(len(t))) / 0.05) * 0.05
    columns["gnss"] = np.where(np.arange(len(t)) % 4 == 2, truth(t) + 0.3 * rng.standard_normal(len(t)), np.nan)
    columns["accel"] = np.gradient(truth(t), t) + 0.5 + 0.2 * rng.standard_normal(len(t))
    return columns


MODEL = """
dt = 0.05
[model]
kind = "Integrator"
std = 0.05
[inputs.accel]
error_std = 1.0
error_walk = 0.02
[sensors.left]
std = 0.2
resolution = 0.05
unit = "m/s"
[sensors.right]
std = 0.2
resolution = 0.05
unit = "m/s"
[sensors.gnss]
std = 0.3
unit = "m/s"
[[errors]]
sensors = ["left", "right"]
std = 0.1
time_constant = 20.0
common = true
"""


def write(folder, columns, model=MODEL):
    """Write the recording and the model file, and return both paths."""
    names = list(columns)
    rows = zip(*columns.values(), strict=True)
    text = "\n".join([",".join(names), *(",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in rows)])
    (folder / "data.csv").write_text(text + "\n", encoding="utf-8")
    (folder / "model.toml").write_text(model, encoding="utf-8")
    return folder / "data.csv", folder / "model.toml"


def test_the_model_of_a_file_is_the_one_by_hand(tmp_path):
    data, file = write(tmp_path, drive())
    monitor = load_monitor(file)
    by_hand = (
        LinearModel([[1.0]], [[DT]], [[1.0]] * 3, 0.05**2 * DT, [0.04, 0.04, 0.09], DT)
        .with_disturbance(0.02**2 * DT)
        .with_sensor_errors(0.1, 20.0, (0, 1), common=True)
    )
    for name in ("A", "B", "C", "process_covariance", "sensor_covariance"):
        np.testing.assert_allclose(monitor.model.matrix(name), by_hand.matrix(name), rtol=1e-12, err_msg=name)
    recording = monitor.read([data])
    mean, covariance = monitor.start(recording, monitor.model)
    first = drive()["gnss"][2], drive()["left"][2], drive()["right"][2]
    assert mean == pytest.approx((np.mean(first),))
    errors = (0.04 + 0.04 + 0.09 + 4 * 0.01) / 9
    np.testing.assert_allclose(covariance, np.diag([100 * errors, 1.0, 0.01]), rtol=1e-9)
    assert recording.sensors == ("left", "right", "gnss")
    assert recording.resolution == (0.05, 0.05, 0.0)
    assert recording.loss == pytest.approx((0.01, 0.01, 0.75))


def test_named_models_are_what_the_theory_says():
    A, B, Q = ConstantRate(0.3).matrices(0.2)
    van_loan = linalg.expm(np.array([[0, -1, 0, 0], [0, 0, 0, 0.09], [0, 0, 0, 0], [0, 0, 1, 0]]) * 0.2)
    np.testing.assert_allclose(A, linalg.expm(np.array([[0, 0.2], [0, 0]])))
    np.testing.assert_allclose(Q, van_loan[2:, 2:].T @ van_loan[:2, 2:], atol=1e-15)
    assert B is None
    assert RandomWalk(2.0).matrices(0.25)[2] == pytest.approx(1.0)
    assert Integrator(2.0).matrices(0.25)[1] == pytest.approx(0.25)
    A, B, Q = Matrices([[1.0, 0.1], [0.0, 0.9]], [0.0, 1e-3], [[0.0], [0.1]]).matrices(0.1)
    assert A.shape == Q.shape == (2, 2)
    assert B.shape == (2, 1)


@pytest.mark.parametrize(("std", "change"), [(1e200, "smaller"), (1e-150, "larger")])
def test_numbers_whose_squares_are_beyond_all_floats(std, change):
    for setting, make in (("RandomWalk has std", RandomWalk), ("Offset has jump", lambda jump: Offset(jump=jump))):
        with pytest.raises(ModelError, match=rf"{setting}={re.escape(repr(std))}; its size .* in which it is {change}"):
            make(std)


def test_the_likelihood_is_that_of_all_samples_together():
    model = LinearModel([[0.9]], [[1.0]], [[1.0], [2.0]], 0.3, [[0.5, 0.1], [0.1, 0.4]], 1.0).with_sensor_errors(
        0.7, 3.0
    )
    y = np.array([[1.0, 0.3], [np.nan, 1.2], [0.1, -0.4], [np.nan, np.nan], [2.0, 0.6]])
    u = np.array([[0.5], [-0.2], [0.1], [0.7], [0.0]])
    A, B, C, Q, R = (model.matrix(name) for name in ("A", "B", "C", "process_covariance", "sensor_covariance"))
    start = np.diag([2.0, 0.49, 0.49])
    mean, covariances, m = [np.zeros(3)], {(0, 0): start}, np.zeros(3)
    for k in range(4):
        m = A @ m + B @ u[k]
        mean.append(m)
        covariances[k + 1, k + 1] = A @ covariances[k, k] @ A.T + Q
    for i in range(5):
        for j in range(i):
            covariances[i, j] = np.linalg.matrix_power(A, i - j) @ covariances[j, j]
            covariances[j, i] = covariances[i, j].T
    joint = np.block([[C @ covariances[i, j] @ C.T + (R if i == j else 0 * R) for j in range(5)] for i in range(5)])
    there = np.isfinite(y).ravel()
    expected = stats.multivariate_normal((np.array(mean) @ C.T).ravel()[there], joint[np.ix_(there, there)])
    signal = Signal([0.0], [0.0])
    recording = align({"a": signal, "b": signal}, {}, 1.0)
    recording = type(recording)(**{**vars(recording), "y": y, "u": u})
    found = log_likelihood(model, recording, initial_covariance=[2.0, 0.49, 0.49], compiled=False)
    assert found == pytest.approx(expected.logpdf(y.ravel()[there]), rel=1e-10)


def found_in(folder, columns, model=MODEL):
    data, file = write(folder, columns, model)
    monitor = load_monitor(file)
    return monitor.run(monitor.read([data]), compiled=False)


def test_a_healthy_recording_has_no_alarm(tmp_path):
    """Coarse wheels repeat themselves, the third sensor is silent three times out of four: neither is a fault."""
    columns = drive()
    assert (np.diff(columns["left"]) == 0).mean() > 0.04
    found = found_in(tmp_path, columns)
    assert found.events == ()
    assert found.fault_probability.max() < 0.5
    assert np.isfinite(found.fault_probability).all()
    assert found.kinds == ("healthy", "Frozen", "Offset", "Drifting", "Noisier", "DroppedOut", "Burst")
    np.testing.assert_allclose(found.mode_probability.sum(axis=2), 1.0, atol=1e-9)


def broken(fault):
    """Return the drive with a fault from 6 to 10 s."""
    columns = drive()
    t, rng = columns["t"], np.random.default_rng(9)
    during = (t >= 6.0) & (t < 10.0)
    if fault == "Frozen":
        columns["left"][during] = columns["left"][during][0]
    if fault == "Offset":
        columns["right"][during] += 2.0
    if fault == "Drifting":
        columns["left"][during] += 1.0 * (t[during] - 6.0)
    if fault == "Noisier":
        columns["left"][during] += 1.5 * rng.standard_normal(during.sum())
    if fault == "DroppedOut":
        columns["gnss"][during] = np.nan
    return columns


SENSORS = {"Frozen": "left", "Offset": "right", "Drifting": "left", "Noisier": "left", "DroppedOut": "gnss"}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fault", SENSORS)
def test_a_fault_is_found_with_its_kind_onset_and_size(fault, tmp_path):
    found = found_in(tmp_path, broken(fault))
    event, *others = found.events
    assert not others
    assert (event.sensor, event.kind) == (SENSORS[fault], fault)
    late = 3.2 if fault in {"DroppedOut", "Noisier"} else 1.5  # a silence, or a burst, must last before it is a fault
    assert 6.0 <= event.start < 6.0 + late
    assert event.onset == pytest.approx(6.0, abs=1.0)
    assert 9.9 <= event.end < 11.0
    sizes = {"Offset": 2.0, "Drifting": 4.0}
    if fault in sizes:
        assert event.size == pytest.approx(sizes[fault], abs=0.4)
    table = found.to_pandas()
    assert list(table.columns) == ["t", *(f"{s}{end}" for s in found.recording.sensors for end in ("", "_kind"))]
    assert (table.loc[(table.t > 8) & (table.t < 9.8), f"{event.sensor}_kind"] == fault).mean() > 0.8


def test_a_burst_is_no_fault_and_the_same_noise_for_long_is():
    still = LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-6, 0.01, 0.02)
    rng = np.random.default_rng(4)
    y = 0.1 * rng.standard_normal((600, 3))
    modes = (Noisier(600.0, 20.0, scale=5.0), Burst(scale=5.0))
    spans = {"bump": slice(100, 115), "fault": slice(300, 500)}
    for span in spans.values():
        y[span, 1] *= 6.0
    signals = {name: Signal(np.arange(600) * 0.02, column) for name, column in zip("abc", y.T, strict=True)}
    found = monitor_recording(align(signals, {}, 0.02), still, SwitchingPrecision(modes), compiled=False)
    assert [(e.sensor, e.kind) for e in found.events] == [("b", "Noisier")]
    assert found.events[0].start > 6.0
    assert found.mode_probability[105:115, 1, 2].mean() > 0.9
    assert found.fault_probability[105:115, 1].max() < 0.5


def test_without_a_probability_there_is_a_reason_and_no_alarm(tmp_path):
    found = found_in(tmp_path, drive(1.0), MODEL + '[precision]\nkind = "FixedPrecision"\n')
    assert found.events == ()
    assert found.kinds == ()
    assert found.why_no_probability == FixedPrecision().why_no_probability


def test_an_alarm_holds_over_short_gaps():
    p = np.array([0, 1, 0, 1, 0, 0, 0, 1, 1])
    assert alarms(p, 0.5, 1) == [(1, 4), (7, 9)]
    assert alarms(p, 0.5, 0) == [(1, 2), (3, 4), (7, 9)]
    assert alarms(p, 0.5, 3) == [(1, 9)]
    assert alarms(0 * p, 0.5, 3) == []


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_lasting_fault_is_known_after_a_gap(seed):
    """The level swings on during the gap, so that only what was known before it tells which sensor has the offset."""
    rng, t = np.random.default_rng(seed), np.arange(700)
    level = 1.0 + 0.09 * np.sin(2 * np.pi * (t - 250) / 400)
    y = level[:, np.newaxis] + rng.normal(size=(700, 3)) * [0.01, 0.01, 0.03]
    y[200:, 0] += 0.06
    y[400:460] = np.nan
    signals = {name: Signal(t, column, resolution=1e-5) for name, column in zip("abc", y.T, strict=True)}
    A, _, Q = ConstantRate(std=1.5e-4).matrices(1.0)
    model = LinearModel(A, [[0.0], [0.0]], [[1.0, 0.0]] * 3, Q, [1e-4, 1e-4, 9e-4], 1.0)
    recording = replace(align(signals, {}, 1.0), u=np.zeros((700, 1)))
    found = monitor_recording(recording, model, initial_mean=(1.0, 0.0), initial_covariance=np.diag([0.04, 4e-6]))
    blamed = found.fault_probability > 0.5
    assert blamed[350:400].mean(axis=0).tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_allclose(blamed[470:].mean(axis=0), [1.0, 0.0, 0.0], atol=0.02)


@pytest.mark.parametrize(
    ("dt", "alarm", "gap"),
    [("1/100", Alarm(), 100), ("1/10", Alarm(), 10), (30, Alarm(), 10), (30, Alarm(hold=1.0), 0)],
)
def test_an_alarm_holds_for_some_samples_where_they_are_far_apart(dt, alarm, gap):
    """Default: a second, and at least ten samples; a time that was given is what counts."""
    steps = 2 * gap + 10
    recording = Recording(
        0.0, Fraction(dt), ("a",), np.zeros((steps, 1)), np.zeros((steps, 1)), (0.01,), (0.0,), (0,), ("m",)
    )
    for below, events in ((gap, 1), (gap + 1, 2)):
        p = np.zeros((steps, 1))
        p[[2, 2 + below + 1]] = 1.0
        assert len(list(sensor_events(recording, {"fault_probability": p}, (), alarm))) == events


def test_an_onset_is_never_after_the_alarm_whose_kind_has_changed():
    """First an offset, then, from the sixth step on, a drift, whose own onset is the sixth step."""
    n = 10
    recording = Recording(5.0, Fraction(1), ("a",), np.zeros((n, 1)), np.zeros((n, 1)), (0.01,), (0.0,), (0,), ("m",))
    drifts = np.arange(n) >= 6
    signals = {
        "fault_probability": (np.arange(n) >= 3)[:, None].astype(float),
        "mode_probability": np.stack([np.zeros(n), ~drifts, drifts], axis=1)[:, None].astype(float),
        "fault_size": np.full((n, 1), 2.0),
        "fault_onset": np.where(drifts, 6.0, 2.0)[:, None],
    }
    (event,) = sensor_events(recording, signals, (Offset(), Drifting()), Alarm())
    assert (event.kind, event.start, event.onset) == ("Drifting", 8.0, 8.0)
    signals["fault_onset"][:] = 2.0
    (event,) = sensor_events(recording, signals, (Offset(), Drifting()), Alarm())
    assert event.onset == 7.0


def test_an_alarm_whose_kind_changes_has_an_event_for_each_kind_live_as_well():
    """An offset is followed by a drift; neither flickers of a few samples nor a gap of the alarm make further events."""
    n, modes = 120, (Offset(), Drifting())
    recording = Recording(5.0, Fraction(1), ("a",), np.zeros((n, 1)), np.zeros((n, 1)), (0.01,), (0.0,), (0,), ("m",))
    drifts = (np.arange(n) >= 60) ^ np.isin(np.arange(n), [20, 21, 80, 81, 119])
    blamed = ((np.arange(n) >= 10) & ~np.isin(np.arange(n), [30, 31])).astype(float)
    signals = {
        "fault_probability": blamed[:, None],
        "mode_probability": np.stack([1 - blamed, blamed * ~drifts, blamed * drifts], axis=1)[:, None],
        "fault_size": (1.0 + np.arange(n))[:, None],
        "fault_onset": np.where(drifts, 58.0, 8.0)[:, None],
    }
    first, second = events = list(sensor_events(recording, signals, modes, Alarm()))
    assert (first.kind, first.start, first.end, first.onset, first.size) == ("Offset", 15.0, 64.0, 13.0, 60.0)
    assert (second.kind, second.start, second.end, second.onset, second.size) == (
        "Drifting",
        65.0,
        124.0,
        63.0,
        120.0,
    )  # the size of the offset of the last step
    assert (first.continued, second.continued) == (False, True)
    watch = AlarmWatch(["a"], modes, Fraction(1), Alarm())
    rows = [{name: signals[name][k] for name in AlarmWatch.signals} for k in range(n)]
    begun = [event for k, row in enumerate(rows) for event, ended in watch.feed(float(k), row) if not ended]
    assert [event.start for event in begun] == [10.0]
    later = {"start": 5.0, "end": 5.0, "onset": 5.0}  # the recording begins at 5 s
    moved = [replace(each, **{name: getattr(each, name) + s for name, s in later.items()}) for each in watch.close()]
    assert moved == events


def test_a_live_alarm_that_flickers_for_a_long_time_needs_little_memory(monkeypatch):
    monkeypatch.setattr("bayesftc.monitoring.watching.MOST_STRETCHES", 20)
    watch = AlarmWatch(["a"], (Offset(), Drifting()), Fraction(1), Alarm())
    for k in range(600):
        drifts = (k >= 300) ^ (k % 5 == 0)
        row = {
            "fault_probability": [1.0],
            "mode_probability": [[0.0, not drifts, drifts]],
            "fault_size": [k],
            "fault_onset": [0.0],
        }
        list(watch.feed(float(k), {name: np.array(values, dtype=float) for name, values in row.items()}))
    first, second = watch.close()
    assert (first.kind, second.kind, second.size) == ("Offset", "Drifting", 599.0)
    assert first.end == pytest.approx(300, abs=60)  # with 20 stretches, each has a tenth of the alarm or more


@pytest.mark.parametrize(("name", "unit"), [("header.stamp", 10**9), ("stamp", 1)])
def test_times_since_1970_are_dates(tmp_path, name, unit):
    start = 1_777_885_920
    rows = "".join(f"{(start + k) * unit},{k % 3}\n" for k in range(50))
    (tmp_path / "log.csv").write_text(f"{name},a\n{rows}")
    (tmp_path / "dates.csv").write_text("time,b\n2026-05-04T09:12:00Z,1\n2026-05-04T09:12:03Z,2\n")
    tables = Tables(tmp_path)
    dated = tables.times(tmp_path / "dates.csv", "time")
    np.testing.assert_array_equal(dated, [0.0, 3.0])
    np.testing.assert_array_equal(tables.times(tmp_path / "log.csv", name), np.arange(50.0))
    alone = Tables(tmp_path / "log.csv")
    np.testing.assert_array_equal(alone.times(tmp_path / "log.csv", name), start + np.arange(50.0))
    assert alone.origin == datetime(1970, 1, 1, tzinfo=UTC)


def test_the_onset_of_an_alarm_is_not_inside_the_one_before():
    """The learner dates the second fault to the time of the first one, between which the sensor was healthy."""
    n, modes = 12, (Offset(), Drifting())
    recording = Recording(5.0, Fraction(1), ("a",), np.zeros((n, 1)), np.zeros((n, 1)), (0.01,), (0.0,), (0,), ("m",))
    blamed = np.isin(np.arange(n), [3, 4, 9, 10]).astype(float)
    signals = {
        "fault_probability": blamed[:, None],
        "mode_probability": np.stack([1 - blamed, blamed, np.zeros(n)], axis=1)[:, None],
        "fault_size": np.full((n, 1), 2.0),
        "fault_onset": np.full((n, 1), 3.0),
    }
    first, second = sensor_events(recording, signals, modes, Alarm(hold=1.0))
    assert (first.onset, first.end, second.onset, second.start) == (8.0, 9.0, 9.0, 14.0)
    watch = AlarmWatch(["a"], modes, Fraction(1), Alarm(hold=1.0))
    rows = [{name: signals[name][k] for name in AlarmWatch.signals} for k in range(n)]
    live = [event for k, row in enumerate(rows) for event, ended in watch.feed(float(k), row) if not ended]
    assert [event.onset for event in live] == [3.0, 4.0]


def test_names_of_alarms_say_whose_and_do_not_overlap(tmp_path):
    found = found_in(tmp_path, drive(2.0))
    spans = [("left", 0.4, 1.0), ("right", 0.5, 0.9), ("gnss", 1.8, 2.0)]
    events = tuple(FaultEvent(sensor, begin, end, 1.0, "Offset") for sensor, begin, end in spans)
    figure = replace(
        found, events=events, actuator_events=(ActuatorEvent("accel", 0.3, 0.9, 1.0, "InputOffset"),)
    ).plot()
    figure.draw_without_rendering()
    names = figure.axes[0].texts
    assert {t.get_text() for t in names} == {"left: Offset", "right: Offset", "gnss: Offset", "accel: InputOffset"}
    boxes = [t.get_window_extent() for t in names]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert max(box.x1 for box in boxes) <= figure.axes[0].get_window_extent().x1 + 1


def test_samples_are_divided_by_the_gain_after_the_bias():
    signal = Signal([0.0, 0.1], [21.0, 23.0], bias=1.0, gain=2.0, resolution=1.0)
    assert signal.corrected[1].tolist() == [10.0, 11.0]
    recording = align({"a": signal}, {}, dt=0.1)
    assert (recording.y.ravel().tolist(), recording.resolution) == ([10.0, 11.0], (0.5,))
    with pytest.raises(ModelError, match="Signal has gain=0; it must be a number above 0, or below 0 where"):
        replace(signal, gain=0.0)
    with pytest.raises(ModelError, match="Input has gain"):
        Input(gain=np.inf)
    with pytest.raises(ModelError, match=r"period = 360 and gain = 1.1\. .* Remove one of the two\."):
        Sensor(std=1.0, period=360.0, gain=1.1)


def test_each_of_several_beliefs_says_which_sensor_reads_it():
    t, rng = 0.1 * np.arange(40), np.random.default_rng(0)
    sensors = {"baro": "m", "lidar": "m", "vz": "m/s"}
    signals = {name: Signal(t, rng.standard_normal(40), unit=unit) for name, unit in sensors.items()}
    model = LinearModel([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.0]], [[1, 0], [1, 0], [0, 1]], 0.01, 1.0, dt=0.1)
    axes = monitor_recording(align(signals, {}, dt=0.1), model, initial_mean=(0.0, 0.0)).plot().axes
    assert {axis.get_ylabel() for axis in axes[:2]} == {
        "belief of what\nbaro reads (m)",
        "belief of what\nvz reads (m/s)",
    }


def test_a_sensor_may_read_the_other_way():
    """An altitude of a floor at 40 m beside a depth: it moves by -1, and votes with it."""
    t, rng = 0.1 * np.arange(400), np.random.default_rng(0)
    depth = 15.0 + np.cumsum(0.02 * rng.standard_normal(400))
    noise = 0.1 * rng.standard_normal((400, 3))
    noise[200:, 0] += 2.0
    table = pd.DataFrame({"p": depth + noise[:, 0], "q": depth + noise[:, 1], "h": 40.0 - depth + noise[:, 2]}, index=t)
    upwards = Sensor(std=0.1, gain=-1.0, bias=40.0, resolution=0.2)
    sensors = {"p": Sensor(std=0.1), "q": Sensor(std=0.1), "h": upwards}
    found = Monitor(0.1, RandomWalk(std=0.06), sensors).run(table, compiled=False)
    assert found.recording.resolution[2] == 0.2
    np.testing.assert_allclose(found.recording.y[:, 2], 40.0 - table["h"])
    np.testing.assert_allclose(found.recording.as_read(2, found.recording.y[:, 2]), table["h"])
    assert {event.sensor for event in found.events} == {"p"}


def test_the_belief_in_the_figure_contains_the_operating_point():
    t, rng = 0.1 * np.arange(40), np.random.default_rng(0)
    signals = {name: Signal(t, 2.0 + 0.1 * rng.standard_normal(40)) for name in "ab"}
    model = LinearModel([[0.9]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1).about([0.0], [0.0], [2.0, 2.0])
    axes = monitor_recording(align(signals, {}, dt=0.1), model, initial_mean=(0.0, 1.0)).plot().axes
    assert len(axes) == 4  # one belief, two sensors, the probabilities
    belief, *residuals = (axis.lines[0].get_ydata() for axis in axes[:3])
    assert belief.mean() == pytest.approx(2.0, abs=0.1)
    assert [values.mean() for values in residuals] == pytest.approx([0.0, 0.0], abs=0.1)


def test_the_figure_shows_from_which_probability_on_there_is_an_alarm(tmp_path):
    found = found_in(tmp_path, drive(2.0))
    for alarm, label in ((found.alarm, "alarm from 0.9"), (Alarm(threshold=0.99), "alarm from 0.99")):
        line = replace(found, alarm=alarm).plot().axes[-1].lines[-1]
        assert (line.get_label(), line.get_ydata()[0]) == (label, alarm.threshold)


def test_long_names_of_sensors_do_not_run_into_each_other(tmp_path):
    found = found_in(tmp_path, drive(2.0))
    names = ("LT201 ultrasonic, upper", "LT202_ultrasonic_lower", "LT203 pressure at the outlet")
    figure = replace(found, recording=replace(found.recording, sensors=names)).plot()
    figure.draw_without_rendering()
    boxes = [axis.yaxis.label.get_window_extent() for axis in figure.axes]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert [axis.get_ylabel().split("\n")[0] for axis in figure.axes[1:4]] == ["LT201", "LT202_", "LT203"]


@pytest.mark.parametrize("noisy", ["covariance", "effect"])
def test_an_input_whose_faults_cannot_be_told_is_called_by_its_name(noisy, tmp_path):
    B, Q = ("[[0.05]]", "[[0.0]]") if noisy == "covariance" else ("[[0.0]]", "[[1e-4]]")
    text = MODEL.replace(
        'kind = "Integrator"\nstd = 0.05', f'kind = "Matrices"\nA = [[1.0]]\nB = {B}\nprocess_covariance = {Q}'
    )
    text = text.replace("error_std = 1.0\nerror_walk = 0.02\n", "")
    text += '[precision]\nkind = "SwitchingPrecision"\nactuator_modes = [{ kind = "InputOffset" }]\n'
    _, file = write(tmp_path, drive(1.0), text)
    with pytest.raises(ModelError, match="the input 'accel' moves"):
        load_monitor(file)


def test_own_modes_and_losses_of_the_file(tmp_path):
    precision = (
        'kind = "SwitchingPrecision"\nloss = 0.2\nmodes = [{kind = "Offset"}, {kind = "Burst"}]\nprocess_modes = []\n'
    )
    _, file = write(tmp_path, drive(1.0), f"{MODEL}[precision]\n{precision}")
    monitor = load_monitor(file)
    assert monitor.precision.loss == 0.2
    assert monitor.precision.process_modes == ()
    assert not monitor.own_loss
    found = monitor.run(monitor.read([tmp_path / "data.csv"]), compiled=False)
    assert found.kinds == ("healthy", "Offset", "Burst")


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("", (0.2, 0.001, 0.001)),
        ('[precision]\nkind = "SwitchingPrecision"\njoint = false\n', (0.2, 0.001, 0.001)),
        ('[precision]\nkind = "SwitchingPrecision"\nmodes = [{ kind = "Frozen", healthy_repeats = 0.3 }]\n', 0.3),
    ],
)
def test_the_learner_knows_how_often_each_sensor_repeats_itself(section, expected, tmp_path, monkeypatch):
    """From the file's sensors, unless the mode has a share of its own."""
    told = MODEL.replace("resolution = 0.05", "resolution = 0.05\nrepeats = 0.2", 1)
    _, file = write(tmp_path, drive(1.0), told + section)
    used = []
    monkeypatch.setattr(_monitor, "monitor_recording", lambda recording, model, precision, **_: used.append(precision))
    monitor = load_monitor(file)
    monitor.run(monitor.read([tmp_path / "data.csv"]))
    frozen = used[0].modes[0]
    assert (frozen.healthy_repeats, frozen.resolution) == (expected, (0.05, 0.05, monitor_resolution(tmp_path)))


def monitor_resolution(folder):
    """Return the resolution of GNSS, which the file leaves to be found."""
    return load_monitor(folder / "model.toml").read([folder / "data.csv"]).resolution[2]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("std = 0.3", "std = 0.3\nrepeats = 1.0"), "'sensors.gnss'.*repeats=1.0"),
        (("dt = 0.05", ""), "lacks 'dt'"),
        (("dt = 0.05", "dt = 0.0"), "must be positive"),
        (("[model]", "[modell]"), r"unknown section 'modell'; did you mean 'model'"),
        (('kind = "Integrator"', 'kind = "Walk"'), r"'model.kind' is 'Walk'.*RandomWalk"),
        (("std = 0.05\n[inputs", "stdd = 0.05\n[inputs"), "did you mean 'std'"),
        (("error_std = 1.0", "error_std = -1.0"), "'inputs.accel'.*error_std=-1.0"),
        (("std = 0.3", ""), "'sensors.gnss' lacks 'std'"),
        (("std = 0.3", "std = 0"), "'sensors.gnss'.*std=0"),
        (("std = 0.3", "std = 0.3\nreads = [1.0, 0.0]"), "'reads' of the sensor 'gnss' has the shape"),
        (('["left", "right"]', '["left", "wrong"]'), r"'errors\[0\]' has the unknown sensor 'wrong'"),
        (("time_constant = 20.0", "time_constant = 0.0"), "time_constant=0.0"),
        (("[[errors]]", "[errors]"), "two brackets"),
        (("dt = 0.05", 'dt = 0.05\nprecision = {kind = "Nothing"}'), "'precision.kind' is 'Nothing'"),
        (("dt = 0.05", 'dt = 0.05\nprecision = {kind = "SwitchingPrecision", loss = [0.1, 0.1]}'), "vector of 3"),
        (("dt = 0.05", "dt = 0.05\nalarm = {threshold = 2.0}"), "'alarm'.*threshold=2.0"),
        (("dt = 0.05", "dt = = 0.05"), "no valid TOML"),
        (
            ("[inputs.accel]", '[inputs.gyro]\nfile = "x.csv"\n[inputs.accel]'),
            "has 1 input, but .* names 'gyro', 'accel'",
        ),
        (
            ("[inputs.accel]\nerror_std = 1.0\nerror_walk = 0.02\n", ""),
            "Integrator has 1 input, but .* names none. Name each",
        ),
        (('"Integrator"', '"RandomWalk"'), "RandomWalk has no inputs, but .* names 'accel'. Remove"),
        (
            (
                "dt = 0.05",
                'dt = 0.05\nprecision = {kind = "SwitchingPrecision", actuator_modes = {kind = "LostEffect"}}',
            ),
            r"'precision.actuator_modes' is .* must be a list of tables such as \[{ kind = \"LostEffect\" }\]",
        ),
        (
            ("dt = 0.05", 'dt = 0.05\nprecision = {kind = "SwitchingPrecision", modes = {kind = "Burst"}}'),
            r"'precision.modes' is .* must be a list of tables such as \[{ kind = \"Burst\" }\]",
        ),
        (
            (
                "dt = 0.05",
                'dt = 0.05\nprecision = {kind = "SwitchingPrecision", process_modes = [{kind = "NoiserProcess"}]}',
            ),
            r"'precision.process_modes\[0\].kind' is 'NoiserProcess'.* did you mean 'NoisierProcess'",
        ),
        ((MODEL, "dt = 1.0\n[model]\nkind = 'RandomWalk'\nstd = 1.0\n[sensors]\n"), "has no sensor"),
        (
            (MODEL, f"joint = true\n{MODEL}[precision]\nkind = 'SwitchingPrecision'\n"),
            r"joint.* without \[precision\] only",
        ),
    ],
)
def test_mistakes_in_the_file_are_named_with_their_place(change, words, tmp_path):
    _, file = write(tmp_path, drive(1.0), MODEL.replace(*change))
    with pytest.raises(BayesFTCError, match=words) as caught:
        load_monitor(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("joint", [False, True])
def test_two_sensors_that_agree_outvote_a_more_precise_one_if_judged_together(joint, tmp_path):
    rng, t = np.random.default_rng(0), 1.0 * np.arange(600)
    y = np.cumsum(0.2 * rng.standard_normal(600))[:, None] + [0.2, 0.5, 0.5] * rng.standard_normal((600, 3))
    y[200:, 0] += 0.01 * (t[200:] - 200.0)  # the most precise one drifts slowly
    pd.DataFrame({"t": t, **dict(zip("abc", y.T, strict=True))}).to_csv(tmp_path / "data.csv", index=False)
    sensors = "".join(f"[sensors.{name}]\nstd = {0.2 if name == 'a' else 0.5}\n" for name in "abc")
    model = "[model]\nkind = 'RandomWalk'\nstd = 0.2\n"
    (tmp_path / "model.toml").write_text(
        f"dt = 1.0\n{'joint = true' if joint else ''}\n{model}{sensors}", encoding="utf-8"
    )
    monitor = load_monitor(tmp_path / "model.toml")
    found = monitor.run(monitor.read([tmp_path / "data.csv"]))
    assert ("a" in {event.sensor for event in found.events}) == joint


@pytest.mark.parametrize("seed", [0, 1])
def test_two_sensors_that_agree_outvote_one_that_lags(seed):
    """Its course is no offset, drift or noise; the two healthy ones were blamed with it, and the estimate was metres off."""
    rng, t = np.random.default_rng(seed), 0.1 * np.arange(4000)
    depth = 10.0 + sum(0.3 * (-1) ** i * np.clip(t - 60.0 * i, 0.0, 20.0) for i in range(1, 6))
    late = depth.copy()
    for k in range(1000, len(t)):
        late[k] = late[k - 1] + (depth[k] - late[k - 1]) / 80.0
    y = np.column_stack([late, depth, depth]) + 0.02 * rng.standard_normal((len(t), 3))
    recording = recorded({name: Signal(t, y[:, i]) for i, name in enumerate("abc")})
    sensors = {name: Sensor(std=0.02) for name in "abc"}
    monitor = Monitor(0.1, ConstantRate(0.2), sensors, joint=True, initial_mean=(10.0, 0.0), initial_std=(1.0, 1.0))
    found = monitor.run(recording)
    blamed = (np.nan_to_num(found.fault_probability) > 0.5).mean(axis=0)
    assert blamed[0] > 0.3
    assert max(blamed[1:]) < 0.01
    assert np.abs(found.x_hat[:, 0] - depth).max() < 0.2


def test_states_that_no_sensor_reads_need_a_beginning(tmp_path):
    text = 'dt = 0.05\n[model]\nkind = "ConstantRate"\nstd = 1.0\n{}\n[sensors.left]\nstd = 0.2\n'
    data, file = write(tmp_path, drive(2.0), text.format(""))
    monitor = load_monitor(file)
    with pytest.raises(ModelError, match="initial_mean and initial_std"):
        monitor.run(monitor.read([data]), compiled=False)
    write(tmp_path, drive(2.0), text.format("initial_mean = [10.0, 0.0]\ninitial_std = [1.0, 2.0]"))
    monitor = load_monitor(file)
    found = monitor.run(monitor.read([data]), compiled=False)
    assert found.x_hat[-1] == pytest.approx([10 + 3 * np.sin(1), 1.5 * np.cos(1)], abs=1.0)


def test_absurd_values_are_named_and_count_as_missing(tmp_path, caplog):
    """Their squares are no numbers, so that a fit had a standard deviation of NaN."""
    file, times = tmp_path / "data.csv", np.arange(100) * 0.1
    left, right = 1e150 * np.cos(times), np.cos(times)
    right[::10] = -1e200
    rows = "".join(f"{t:g},{a!r},{b!r}\n" for t, a, b in zip(times, left.tolist(), right.tolist(), strict=True))
    file.write_text("t,left,right\n" + rows)
    right_signal = redundant_signals([file], ["right"])[1]["right"]
    assert len(right_signal.values) == 90
    assert "column 'right', has 10 values above 1e+50 in size, such as -1e+200" in caplog.text
    with pytest.raises(RecordingError, match=r"column 'left': A signal has no samples but .* Use a larger unit"):
        redundant_signals([file], ["left"])


def test_a_model_of_another_size_is_refused():
    recording = align({"a": Signal([0, 1], [1, 2])}, {}, 1.0)
    with pytest.raises(ModelError, match=r"2 sensors, 1 .* and steps of 1 s, but the recording has 1"):
        monitor_recording(recording, LinearModel([[1]], [[1]], [[1], [1]], 1.0, 1.0, 1.0))
    with pytest.raises(ModelError, match=r"threshold=1\.5"):
        monitor_recording(recording, LinearModel([[1]], [[1]], [[1]], 1.0, 1.0, 1.0), alarm=Alarm(1.5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,left,right,gnss,accel\n0,1,x,1,1\n", "'x' in line 2, column 'right', is no number"),
        ("t,left,right,gnss,accel\n\n0,1,1,1,1\n1,1,true,1,1\n", "'true' in line 4, column 'right', is no number"),
        ("t,left,rigth,gnss,accel\n0,1,1,1,1\n", "no column 'right' for the sensor 'right'; did you mean 'rigth'"),
        ("time,left,right,gnss,accel\n0,1,1,1,1\n", "no column 't' for the times of the sensor 'left'"),
        ("t,left,right,gnss\n0,1,1,1\n", "no column 'accel' for the input 'accel'"),
        ("t,left,right,gnss,accel\n1,1,1,1,1\n0,1,1,1,1\n", "the sensor 'left': .* Sort the recording"),
        ("t,left,right,gnss,accel\n0,1,1,,1\n", "the sensor 'gnss': .* no samples"),
        ("", "data.csv is empty"),
        ("\n \n", "data.csv is empty"),
        ("t,left,right,gnss,accel\n", "no row of samples"),
        ("0,1,1,1,1\n1,1,1,1,1\n", "begins with numbers"),
        ("t;left;right;gnss;accel\n0;1,5;1;1;1\n1;1.5;1;1;1\n", "'1.5' in line 3, column 'left', is no number"),
        ("t;left;right;gnss;accel\n0;1;1;1\n", "line 2 has 1 cell.* the first row has 1 name|no column"),
        (
            "t,left,left,right,gnss,accel\n0,1,1,1,1,1\n",
            "2 columns 'left': the first is number 2, the last number 3",
        ),
        ("t,left,right,gnss,accel\n0,1,1,1,1\n1,1,1\n", "line 3 has 3 cell.* the first row has 5 name"),
        ("t,left,right,gnss,accel\n0,1,1,1,1,\n1,1,1,1,1,\n", "line 2 has 6 cell.* the first row has 5 name"),
        ("a drive\nt,left,right,gnss,accel\n0,1,1,1,1\n", "line 2 has 5 cell.* the first row has 1 name"),
        ('t,left\n0,"1\n', "no CSV table"),
        (b"\xff\xfe\x00", "no text in UTF-8"),
    ],
)
def test_tables_that_cannot_be_used(text, words, tmp_path):
    data, file = write(tmp_path, drive(1.0))
    data.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(RecordingError, match=words):
        load_monitor(file).read([data])


def test_several_files_and_folders(tmp_path):
    columns = drive(2.0)
    (tmp_path / "slow").mkdir()
    wheels = {name: columns[name] for name in ("t", "left", "right", "accel")}
    _, file = write(
        tmp_path, wheels, MODEL.replace("[sensors.gnss]", '[sensors.gnss]\nfile = "gnss.csv"\ntime = "stamp"')
    )
    monitor = load_monitor(file)
    with pytest.raises(RecordingError, match=r"'gnss' is in 'gnss.csv', which is not among the files"):
        monitor.read([tmp_path / "data.csv"])
    known = np.isfinite(columns["gnss"])
    rows = zip(columns["t"][known] + 0.003, columns["gnss"][known], strict=True)
    text = "stamp,gnss\n" + "".join(f"{t},{v}\n" for t, v in rows)
    (tmp_path / "slow" / "gnss.csv").write_text(text, encoding="utf-8")
    alone = monitor.read([tmp_path / "data.csv", tmp_path / "slow"])  # each column is in one file only
    text = file.read_text(encoding="utf-8")
    for name in ("[inputs.accel]", "[sensors.left]", "[sensors.right]"):
        text = text.replace(name, f'{name}\nfile = "data.csv"')
    file.write_text(text, encoding="utf-8")
    recording = load_monitor(file).read([tmp_path / "data.csv", tmp_path / "slow"])
    np.testing.assert_array_equal(np.isfinite(recording.y[:, 2]), known[2:])
    np.testing.assert_array_equal(alone.y, recording.y)
    with pytest.raises(RecordingError, match="does not exist"):
        load_monitor(file).read([tmp_path / "gone" / "data.csv", tmp_path / "slow"])
    with pytest.raises(RecordingError, match="at least one CSV file"):
        load_monitor(file).read([])


@pytest.mark.slow
def test_many_bursts_have_a_note_and_a_notebook_shows_what_was_found():
    """They are no fault, but a sensor of which a tenth of the samples was wrong had not a word."""
    rng, t = np.random.default_rng(0), 0.1 * np.arange(2000)
    y = 5.0 + np.cumsum(0.02 * rng.standard_normal(2000))[:, None] + 0.1 * rng.standard_normal((2000, 3))
    spikes = rng.random(1000) < 0.1
    y[500:1500, 1] += 5.0 * spikes * rng.choice([-1, 1], 1000)
    sensors = {name: Sensor(std=0.1, resolution=0.0) for name in "abc"}
    monitor = Monitor(0.1, RandomWalk(std=0.06), sensors)
    found = monitor.run(pd.DataFrame(y, columns=list("abc"), index=t), compiled=False)
    assert found.bursts["b"] == pytest.approx(spikes.sum() / 2000, abs=0.01)
    assert max(found.bursts["a"], found.bursts["c"]) < 0.01
    (note,) = found.burst_notes()
    assert re.match(r"b has \d+ bursts \([345]\.\d% of its samples\), \d+ of them from \d+\.\d* to 1[34]\d", note)
    shown = re.search(r"has (\d+) bursts .* (\d+) of them from ([\d.]+) to ([\d.]+) s", note).groups()
    count, most, first, last = map(float, shown)
    assert 0.8 * count <= most < 0.8 * count + 1
    assert last - first < 0.81 * 100.0
    assert repr(found) == f"<Monitored: 3 sensors, 2000 steps of 0.1 s, {len(found.events)} alarms>"
    html = found._repr_html_()
    assert "No fault was found" in html or "<b>Faults</b>" in html
    assert note in html
    assert repr(monitor) == "<Monitor: 3 sensors, steps of 0.1 s, RandomWalk(std=0.06)>"
    assert "<td" in monitor._repr_html_()
    assert f"{np.mean(y[:, 0]):.5g}" in found.recording._repr_html_()
    assert monitor.run(pd.DataFrame(y[:400], columns=list("abc"), index=t[:400]), compiled=False).burst_notes() == []
    bumps = np.repeat(rng.random(200) < 0.1, 10)[:, None]  # all sensors are disturbed at once
    y = (
        5.0
        + np.cumsum(0.02 * rng.standard_normal(2000))[:, None]
        + np.where(bumps, 0.8, 0.1) * rng.standard_normal((2000, 3))
    )
    bumpy = monitor.run(pd.DataFrame(y, columns=list("abc"), index=t), compiled=False)
    assert max(bumpy.bursts.values()) > 0.01
    assert bumpy.burst_notes() == []


def test_files_of_days_follow_each_other(tmp_path):
    """As one file with all rows; files of the same time have sensors of the same name."""
    rng, t = np.random.default_rng(0), 10.0 * np.arange(3000)
    y = 20.0 + np.cumsum(0.02 * rng.standard_normal(3000))[:, None] + 0.1 * rng.standard_normal((3000, 3))
    y[2200:, 1] += 2.0
    table = pd.DataFrame(y.round(3), columns=["a", "b", "c"], index=pd.Index(t, name="time"))
    (tmp_path / "days").mkdir()
    for day, rows in (("2", slice(1000, 2000)), ("1", slice(0, 1000)), ("3", slice(2000, 3000))):
        table[rows].to_csv(tmp_path / "days" / f"{'b' if day == '1' else 'a'}{day}.csv")  # names say nothing
    table.to_csv(tmp_path / "whole.csv")
    whole, days = recorded(tmp_path / "whole.csv"), recorded(tmp_path / "days")
    assert days.sensors == ("a", "b", "c")
    np.testing.assert_array_equal(days.y, whole.y)
    monitor, _ = Monitor.fit(tmp_path / "days")
    events = monitor.run(monitor.read(tmp_path / "days")).events
    assert [(event.sensor, event.kind) for event in events] == [("b", "Offset")]
    table[:1000].to_csv(tmp_path / "days" / "again.csv")
    both = redundant_signals([tmp_path / "days" / "b1.csv", tmp_path / "days" / "again.csv"])[1]
    assert set(both) == {"a", "b", "c", "again_a", "again_b", "again_c"}
    with pytest.raises(
        RecordingError, match=r"The sensor 'a' is in 4 files whose times overlap. Add file = 'name.csv'"
    ):
        monitor.read(tmp_path / "days")


def test_a_monitor_learns_from_recordings_how_often_faults_come(tmp_path):
    """In a drive with a freeze, freezes get as frequent as they are, and faults that do not show rare."""
    data, file = write(tmp_path, broken("Frozen"))
    monitor = load_monitor(file)
    recording = monitor.read([data])
    learned = monitor.learn([recording], iterations=3, compiled=False)
    onsets = dict(zip((type(mode).__name__ for mode in learned.precision.modes), learned.onsets, strict=True))
    assert onsets["Frozen"] == pytest.approx(1.0, abs=0.1)
    assert max(onsets[name] for name in ("Offset", "Drifting", "Noisier")) < 0.5
    assert learned.precision.modes[0].resolution == recording.resolution
    assert learned.precision.loss == recording.loss
    found = replace(monitor, precision=learned.precision).run(recording, compiled=False)
    assert [(event.sensor, event.kind) for event in found.events] == [("left", "Frozen")]
    with pytest.raises(ModelError, match="no recording"):
        monitor.learn([])
    with pytest.raises(ModelError, match="modes of a SwitchingPrecision"):
        replace(monitor, precision=FixedPrecision()).learn([recording])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("decimals", [2, 3])
def test_few_decimals_are_no_freeze(decimals):
    """What a file's decimals make equal has not been repeated by a sensor: the resolution is found in the samples."""
    rng = np.random.default_rng(decimals)
    time = np.arange(1000) / 10.0
    samples = np.round(20.0 + 0.1 * rng.normal(size=(1000, 3)), decimals)
    sensors = {name: Signal(time, samples[:, i]) for i, name in enumerate("abc")}
    recording = align(sensors, {}, 0.1)
    assert recording.resolution == pytest.approx([10.0**-decimals] * 3)
    model = LinearModel([[1.0]], [[0.0]], np.ones((3, 1)), 1e-6, 0.01, 0.1)
    found = monitor_recording(recording, model, initial_mean=20.0, compiled=False)
    assert not found.events


def test_a_table_with_a_byte_order_mark_spaces_quotes_and_empty_lines_is_read(tmp_path):
    _, file = write(tmp_path, drive(1.0))
    text = 't, left ,"right",gnss,accel,x,x\n\n0,1,2,3,4,5,6\n \n0.05, 1 ,,"3",4,5,6\n'
    (tmp_path / "data.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    monitor = load_monitor(file)
    recording = monitor.read([tmp_path / "data.csv"])
    np.testing.assert_array_equal(recording.y, [[1.0, 2.0, 3.0], [1.0, np.nan, 3.0]])
    assert recording.inputs == ("accel",)


def parked(steps=3000, rest=slice(1000, 2000)):
    """Return speeds of three wheels of a car that stops, stands, where all send 0, and drives on."""
    rng = np.random.default_rng(3)
    time = 0.05 * np.arange(steps)
    speed = 8.0 + 2.0 * np.sin(time / 3)
    speed *= np.clip(np.maximum(rest.start - np.arange(steps), np.arange(steps) - rest.stop) / 100, 0.0, 1.0)
    wheels = np.maximum(speed[:, None] + 0.04 * rng.standard_normal((steps, 3)), 0.0)
    wheels[rest] = 0.0
    return time, np.round(wheels, 2)


def watch(time, wheels):
    recording = align({f"w{i}": Signal(time, column) for i, column in enumerate(wheels.T)}, {}, 0.05)
    walk = RandomWalk(2.0).linear(Fraction(1, 20), 0, np.ones((3, 1)), 0.04**2 * np.eye(3))
    return monitor_recording(recording, walk, initial_mean=8.0)


def test_wheels_of_a_parked_car_are_not_frozen():
    """They all repeat themselves at once; one that goes on with it when the car moves is frozen."""
    time, wheels = parked()
    found = watch(time, wheels)
    assert found.rest[1004:2000].all()
    assert not found.rest[:900].any()
    assert not found.rest[2100:].any()
    assert not found.events
    assert found.fault_probability[1000:2100].max() < 0.5
    wheels[2000:2500, 1] = 0.0
    (event,) = watch(time, wheels).events
    assert (event.sensor, event.kind) == ("w1", "Frozen")
    assert 100.0 <= event.start < 104.0


def test_a_fault_before_a_rest_goes_on_in_it():
    time, wheels = parked()
    wheels[600:1200, 1] = wheels[599, 1]
    found = watch(time, wheels)
    assert found.fault_probability[700:1200, 1].min() > 0.9
    assert found.fault_probability[1000:2100, [0, 2]].max() < 0.5


def test_a_rest_is_of_all_sensors_and_of_several_steps():
    """Sensors have rates of their own; a single one is never at rest."""
    y = np.array(
        [[1, 2], [1, np.nan], [1, 2], [1, np.nan], [1, 2], [1, 3], [1, 3], [1, 3], [2, 3], [2, 3], [2, 3]], float
    )
    assert at_rest(y).tolist() == [k in (2, 3, 4) for k in range(11)]
    assert not at_rest(y[:, :1]).any()
    assert not at_rest(np.column_stack([y, np.full(11, np.nan)])).any()
    held_back = held({"p": np.column_stack([np.arange(11.0)] * 2)}, ["p"], y, at_rest(y))["p"]
    assert held_back[:, 0].tolist() == [0, 1, 1, 1, 1, 1, 1, 1, 8, 9, 10]
    assert held_back[:, 1].tolist() == [0, 1, 1, 1, 1, 1, 1, 1, 8, 9, 10]


@pytest.mark.slow
def test_samples_half_a_minute_apart_are_watched_with_what_nobody_gave():
    rng = np.random.default_rng(0)
    t = 30.0 * np.arange(2000)
    y = 20.0 + 0.1 * rng.standard_normal((2000, 3))
    y[1500:, 1] += 2.0
    recording = align({f"s{i}": Signal(t, column) for i, column in enumerate(y.T)}, {}, 30)
    model = LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, 30)
    found = monitor_recording(recording, model, initial_mean=20.0)
    assert [(e.sensor, e.kind) for e in found.events] == [("s1", "Offset")]
    assert found.events[0].onset == pytest.approx(45000.0, abs=60.0)
    with pytest.raises(ModelError, match=r"Offset has time_to_recovery=20.0, .* 30 s"):
        monitor_recording(recording, model, SwitchingPrecision([Offset(time_to_recovery=20.0)]), initial_mean=20.0)


def test_a_short_alarm_is_shaded_wide_enough_to_see():
    t, noise = 1.0 * np.arange(3000), 0.1 * np.random.default_rng(0).standard_normal((3000, 3))
    noise[1500:1506, 1] += 2.0
    recording = align({n: Signal(t, noise[:, i]) for i, n in enumerate("abc")}, {}, dt=1)
    model = LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=1)
    (event,) = (monitored := monitor_recording(recording, model)).events
    assert event.end - event.start < 8.9
    widths = [patch.get_width() for patch in monitored.plot().axes[0].patches]
    assert any(abs(width - 0.003 * 2999) < 0.1 for width in widths)


def test_a_pause_over_which_the_kind_changes_separates_two_alarms_live_as_well():
    """It was one alarm, whose later part began in the pause; without a change of kind it still is one."""
    n, modes = 90, (Offset(), Drifting())
    recording = Recording(0.0, Fraction(1), ("a",), np.zeros((n, 1)), np.zeros((n, 1)), (0.01,), (0.0,), (0,), ("m",))
    steps = np.arange(n)
    blamed = np.where((steps >= 10) & ~np.isin(steps, [20, 21, 40, 41, 42]), 1.0, 0.0)
    blamed[40] = 0.4  # the end of the offset
    drifts = steps >= 42
    signals = {
        "fault_probability": blamed[:, None],
        "mode_probability": np.stack([1 - blamed, blamed * ~drifts, blamed * drifts], axis=1)[:, None],
        "fault_size": (1.0 + steps)[:, None],
        "fault_onset": np.where(drifts, 30.0, 8.0)[:, None],
    }
    first, second = events = list(sensor_events(recording, signals, modes, Alarm(hold=5.0)))
    assert (first.kind, first.start, first.end, first.onset, first.size) == ("Offset", 10.0, 39.0, 8.0, 40.0)
    assert (second.kind, second.start, second.end, second.onset) == ("Drifting", 43.0, 89.0, 39.0)
    assert not first.continued
    assert not second.continued
    watch = AlarmWatch(["a"], modes, Fraction(1), Alarm(hold=5.0))
    live = []
    for k in range(n + 7):
        row = {name: signals[name][k] if k < n else 0.0 * signals[name][0] for name in AlarmWatch.signals}
        live += [(event.start, ended) for event, ended in watch.feed(float(k), row)]
    assert live == [(10.0, False), (10.0, True), (43.0, True)]
    watch = AlarmWatch(["a"], modes, Fraction(1), Alarm(hold=5.0))
    for k in range(n):
        list(watch.feed(float(k), {name: signals[name][k] for name in AlarmWatch.signals}))
    assert list(watch.close()) == events


def test_a_row_that_is_written_twice_counts_once(caplog):
    signal = Signal([0.0, 1.0, 1.0, 2.0], [5.0, 6.0, 6.0, 7.0])
    assert [np.asarray(of).tolist() for of in (signal.time, signal.values)] == [[0.0, 1.0, 2.0], [5.0, 6.0, 7.0]]
    assert "A sample at 1 s repeats the time and the value of the one before. It counts once." in caplog.text
    with pytest.raises(RecordingError, match=r"different samples at 1 s: 6 and 6\.5"):
        Signal([0.0, 1.0, 1.0, 2.0], [5.0, 6.0, 6.5, 7.0])


@pytest.mark.parametrize(("count", "slope"), [(2, 0.0), (2, 0.01), (2, 0.002), (3, 0.01)])
def test_two_sensors_of_which_one_drifts_disagree(count, slope):
    """It is open which one, unless a third one tells; healthy ones do not disagree."""
    t, noise = 0.1 * np.arange(400), 0.1 * np.random.default_rng(0).standard_normal((400, count))
    noise[200:, 1] += slope * np.arange(200)
    signals = {name: Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("abc"[:count])}
    model = LinearModel([[1.0]], [[0.0]], [[1.0]] * count, 1.0, 0.01, dt=0.1)
    learner = SwitchingPrecision(joint=True)
    monitored = monitor_recording(align(signals, {}, dt=0.1), model, learner, initial_mean=20.0)
    if count == 3 or not slope:
        assert not monitored.disagreements
        return
    (found,) = monitored.disagreements
    assert found.sensors == ("a", "b")
    assert 20.0 < found.start < 25.0
    assert found.end == pytest.approx(39.9)


def test_only_two_sensors_of_which_each_may_be_the_faulty_one_disagree():
    """Not one that is nearly certain beside others that share the rest, and not if judged one by one."""
    from bayesftc.monitoring.alarms import disagreements

    t = 0.1 * np.arange(200)
    recording = align({name: Signal(t, np.sin(t) + 0.01 * i) for i, name in enumerate("abc")}, {}, dt=0.1)
    for threshold, row, count in (
        (0.9, [0.5, 0.5, 0.0], 1), (0.9, [0.88, 0.08, 0.08], 0), (0.99, [0.02, 0.01, 0.95], 0), (0.9, [0.3, 0.3, 0.3], 0),
    ):  # fmt: skip
        found = list(disagreements(recording, np.tile(row, (len(recording.y), 1)), Alarm(threshold=threshold)))
        assert len(found) == count


def test_a_sensor_finds_its_column_without_the_unit(tmp_path):
    monitor = Monitor(
        0.1, Integrator(std=0.2), {"a": Sensor(std=0.1), "b": Sensor(std=0.1, unit="m")},
        {"v": Input(column="speed")},
    )  # fmt: skip
    log = tmp_path / "log.csv"
    log.write_text("t,a [m],b [cm],speed [m/s]\n0.0,1.0,200.0,3.0\n0.1,1.5,250.0,3.5\n", encoding="utf-8")
    sensors, inputs = monitor.signals(log)
    assert [values.tolist() for values in (sensors["a"].values, sensors["b"].values)] == [[1.0, 1.5], [2.0, 2.5]]
    assert sensors["a"].unit == "m"
    assert inputs["v"].values.tolist() == [3.0, 3.5]
    log.write_text("t,a [m],a [km],b,speed\n0.0,1.0,1.0,2.0,3.0\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"'a' can be 'a \[km\]' or 'a \[m\]'"):
        monitor.signals(log)
