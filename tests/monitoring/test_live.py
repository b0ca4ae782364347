"""A monitor whose samples arrive step by step: it finds what it finds in a recording, and its alarms are the same."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from bayesftc.controllers import FixedPrecision, InputOffset, LostEffect, SwitchingPrecision
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.live import UDP, Wire
from bayesftc.cosim.live.wires import incoming
from bayesftc.monitoring import (
    ActuatorWatch,
    Alarm,
    AlarmWatch,
    ConstantRate,
    Input,
    Integrator,
    Monitor,
    MonitorStepper,
    RandomWalk,
    Sensor,
    Signal,
    align,
    default_precision,
)
from bayesftc.monitoring.gaps import GapWatch
from bayesftc.monitoring.live import FINDING, LONGEST
from bayesftc.monitoring.monitor import OPENING
from bayesftc.monitoring.rest import LEAST, RestWatch, at_rest, held, known

DT = 0.1
NAN = np.nan


def sensors(names="abc", **settings):
    return {name: Sensor(std=0.1, resolution=0.0, **settings) for name in names}


def rows(steps=400, seed=0):
    """Three sensors of a level, of which the third sends at every second step, and the second jumps at step 200."""
    rng = np.random.default_rng(seed)
    level = 5.0 + np.cumsum(0.02 * rng.standard_normal(steps))
    y = level[:, None] + 0.1 * rng.standard_normal((steps, 3))
    y[200:, 1] += 2.0
    y[1::2, 2] = NAN
    return y


def run(stepper, inputs):
    """Return the outputs over the steps by name."""
    stepper.prepare()
    outputs = np.array([stepper.advance(np.asarray(row, dtype=float)) for row in inputs])
    return {name: outputs[:, stepper.output_places(name)] for name in stepper.outputs}


def recorded(monitor, y, u=(), compiled=False):
    """Return what the monitor finds in a recording of the same samples."""
    t = DT * np.arange(len(y))
    signals = {name: Signal(t, column, resolution=0.0) for name, column in zip(monitor.sensors, y.T, strict=True)}
    given = {name: Signal(t, column) for name, column in zip(monitor.inputs, u, strict=True)}
    return monitor.run(align(signals, given, DT), compiled=compiled)


def watched(watch, signals, steps):
    """Return the alarms of a watch over all steps."""
    events = []
    for k in range(steps):
        events += [e for e, ended in watch.feed(DT * k, {n: s[k] for n, s in signals.items()}) if ended]
    return sorted([*events, *watch.close()], key=lambda event: event.start)


def close(a, b):
    """Compare two alarms."""
    assert type(a) is type(b)
    for name, value in vars(a).items():
        expected = getattr(b, name)
        assert value == (expected if isinstance(expected, str | None) else pytest.approx(expected)), name


def test_it_finds_what_is_in_the_recording_of_the_same_samples():
    monitor, y = Monitor(DT, RandomWalk(std=0.06), sensors()), rows()
    stepper = MonitorStepper(monitor, compiled=False)
    live, monitored = run(stepper, y), recorded(monitor, y)
    assert stepper.began == 0.0
    begin = 2 * (OPENING - 1)  # the slow sensor has sent nine samples by then
    assert np.isnan(live["fault_probability"][:begin]).all()
    for name, expected in (("x_hat", monitored.x_hat), ("fault_probability", monitored.fault_probability)):
        np.testing.assert_allclose(live[name][begin:], expected[begin:], rtol=1e-9, atol=1e-15)
    watch = AlarmWatch(list("abc"), stepper.estimator.precision.modes, stepper.step)
    (found,), (event,) = watched(watch, live, len(y)), monitored.events
    close(found, event)
    assert (found.sensor, found.kind) == ("b", "Offset")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_long_freeze_with_lost_samples_begins_with_its_first_repeat(seed):
    """The learner forgets the onset in the course of hours; in these 2400 steps by 1 to 4 steps."""
    rng, n, begin = np.random.default_rng(seed), 3200, 600
    y = 20 + np.cumsum(0.03 * rng.standard_normal(n))[:, None] + 0.1 * rng.standard_normal((n, 3))
    y[begin:3000, 0] = y[begin - 1, 0]
    y = np.where(rng.random(y.shape) < 0.1, NAN, y.round(2))
    y[:20] = 20.0 + 0.1 * rng.standard_normal((20, 3))
    monitor = Monitor(DT, RandomWalk(std=0.1), sensors(), joint=True)
    events = recorded(monitor, y, compiled=True).events
    stepper = MonitorStepper(monitor)
    live = run(stepper, y)
    found = watched(AlarmWatch(list("abc"), stepper.estimator.precision.modes, stepper.step), live, n)
    for event in (next(each for each in of if each.kind == "Frozen") for of in (events, found)):
        assert event.sensor == "a"
        assert abs(event.onset / DT - begin) < 0.9


@pytest.mark.slow
def test_an_angle_counts_on_as_in_a_recording():
    y = rows() - 4.0  # through 0
    monitor = Monitor(DT, RandomWalk(std=0.1), sensors(period=6.0))
    live, monitored = run(MonitorStepper(monitor, compiled=False), y % 6.0), recorded(monitor, y)
    begin = 2 * (OPENING - 1)  # the slow sensor has sent nine samples by then
    np.testing.assert_allclose(live["fault_probability"][begin:], monitored.fault_probability[begin:], atol=1e-6)
    assert {event.sensor for event in monitored.events} == {"b"}


def test_values_that_a_slower_sensor_repeats_are_no_samples():
    y, monitor = rows(), Monitor(DT, RandomWalk(std=0.06), sensors())
    repeated = np.column_stack([y[:, :2], np.repeat(y[::2, 2], 2)])
    slow = replace(monitor, sensors=sensors() | {"c": Sensor(std=0.1, resolution=0.0, held=True)})
    live, expected = (
        run(MonitorStepper(each, compiled=False), rows)["fault_probability"]
        for each, rows in ((slow, repeated), (monitor, y))
    )
    np.testing.assert_array_equal(live, expected)


@pytest.mark.parametrize("turn", [-12.0, 0.0, 6.0])
def test_the_belief_about_an_angle_begins_on_the_turn_of_its_samples(turn):
    y = rows()[:60]
    monitor = Monitor(DT, RandomWalk(std=0.1), sensors(period=6.0), initial_mean=float(y[0, 0]) + turn, initial_std=0.1)
    live = run(MonitorStepper(monitor, compiled=False), y)
    assert live["x_hat"][-1] == pytest.approx(y[-10:, 0].mean(), abs=0.3)
    assert np.nanmax(live["fault_probability"]) < 0.1


@pytest.mark.parametrize("name", ["laser", "laser [m]"])
def test_a_sample_of_a_sensor_is_used_once_whatever_its_name(name):
    """A name with a unit in brackets was taken for an element of an input: a silent sensor then seemed to be frozen."""
    stepper = MonitorStepper(Monitor(DT, RandomWalk(std=0.1), sensors(("a", name))))
    stepper.prepare()
    wire = incoming("wire", Wire(UDP(port=5001), to=name), stepper)
    assert wire.bears_missing
    assert not wire.inbox.limits.hold


def test_times_count_from_the_first_step_also_before_the_first_samples():
    monitor, y, silent = Monitor(DT, RandomWalk(std=0.06), sensors()), rows(), 57
    stepper = MonitorStepper(monitor, compiled=False)
    live = run(stepper, [*np.full((silent, 3), NAN), *y])
    assert stepper.began == pytest.approx(DT * silent)
    watch = AlarmWatch(list("abc"), stepper.estimator.precision.modes, stepper.step)
    (found,), (event,) = watched(watch, live, silent + len(y)), recorded(monitor, y).events
    assert found.start - event.start == pytest.approx(DT * silent)
    assert found.onset - event.onset == pytest.approx(DT * silent)


@pytest.mark.slow
def test_bias_and_values_for_no_sample_are_those_of_the_model_file():
    plain = Monitor(DT, RandomWalk(std=0.06), sensors())
    monitor = replace(plain, sensors={**sensors("a", bias=3.0), **sensors("bc")}, invalid=[-9999.0, "Bad Input"])
    y = rows()
    sent = np.where(np.isnan(y), -9999.0, y + np.array([3.0, 0.0, 0.0]))
    one, other = (run(MonitorStepper(m, compiled=False), s) for m, s in ((plain, y), (monitor, sent)))
    np.testing.assert_allclose(one["x_hat"], other["x_hat"], rtol=1e-12)


def test_the_gain_is_that_of_the_model_file():
    plain = Monitor(DT, RandomWalk(std=0.06), sensors())
    monitor = replace(plain, sensors={**sensors("a", bias=3.0, gain=2.0), **sensors("bc")})
    y = rows()[:40]
    sent = y * np.array([2.0, 1.0, 1.0]) + np.array([3.0, 0.0, 0.0])
    one, other = (run(MonitorStepper(m, compiled=False), s) for m, s in ((plain, y), (monitor, sent)))
    np.testing.assert_allclose(one["x_hat"], other["x_hat"], rtol=1e-12)


def test_an_input_acts_until_the_next_step_and_its_fault_is_an_alarm():
    rng, steps = np.random.default_rng(0), 300
    flow = np.sin(np.arange(steps) / 10)
    gain = 0.1 * flow * np.where(np.arange(steps) < 150, 1.0, 0.2)
    level = 5.0 + np.cumsum(gain) - gain
    y = level[:, None] + 0.02 * rng.standard_normal((steps, 2))
    modes = [LostEffect(), InputOffset()]
    monitor = Monitor(
        DT,
        Integrator(std=0.02),
        {name: Sensor(std=0.02, resolution=0.0) for name in "ab"},
        {"flow": Input()},
        precision=SwitchingPrecision(actuator_modes=modes),
    )
    stepper = MonitorStepper(monitor, compiled=True)
    live, monitored = run(stepper, np.column_stack([y, flow])), recorded(monitor, y, [flow], compiled=True)
    np.testing.assert_allclose(live["x_hat"][OPENING:], monitored.x_hat[OPENING:], rtol=1e-12)
    watch = ActuatorWatch(["flow"], modes, stepper.step)
    found = watched(watch, live, steps)
    assert found[0].kind == "LostEffect"
    for a, b in zip(found, monitored.actuator_events, strict=True):
        close(a, b)


def test_smooth_averages_the_last_values_of_an_input():
    monitor = Monitor(DT, Integrator(std=0.02), sensors("ab"), {"flow": Input(smooth=0.3), "other": Input()})
    with pytest.raises(ModelError, match="Integrator has 1 input"):
        MonitorStepper(monitor, compiled=False)
    flow = np.where(np.arange(60) < 30, 0.0, 3.0)
    plain, smooth = (
        run(
            MonitorStepper(Monitor(DT, Integrator(std=1e-6), sensors("ab"), {"flow": Input(smooth=s)}), compiled=False),
            np.column_stack([5.0 + 1e-6 * (np.arange(60)[:, None] % 2 + np.zeros(2)), flow]),  # no rest
        )["innovation"][:, 0]
        for s in (0.0, 0.3)
    )
    # The belief moves by 0.1 s of the input in each step: 3, or 1, 2 and then 3.
    assert plain[31] == pytest.approx(-0.3, abs=1e-3)
    assert smooth[31] == pytest.approx(-0.1, abs=1e-3)


def test_monitoring_begins_without_a_sensor_that_sends_nothing_and_blames_it():
    monitor, y = Monitor(DT, RandomWalk(std=0.06), sensors()), rows(LONGEST + 200)
    y[:, 2] = NAN
    stepper = MonitorStepper(monitor, compiled=False)
    stepper.prepare()
    for row in y[: LONGEST - 1]:
        stepper.advance(row)
    assert stepper.began is None
    assert stepper.silent == ["c"]
    live = run(stepper, y[LONGEST - 1 :])
    assert stepper.began == 0.0
    p = live["fault_probability"]
    assert p[-1, 2] > 0.99
    assert p[:, 0].max() < 0.5


def test_without_a_resolution_more_samples_are_waited_for():
    monitor = Monitor(DT, RandomWalk(std=0.06), {name: Sensor(std=0.1) for name in "ab"})
    stepper, rng = MonitorStepper(monitor, compiled=False), np.random.default_rng(0)
    live = run(stepper, np.round(rng.standard_normal((60, 2)) / 0.05) * 0.05)
    assert np.isnan(live["x_hat"][:, 0]).sum() == FINDING - 1
    assert stepper.estimator.precision.modes[0].resolution == pytest.approx((0.05, 0.05))


def test_sensors_that_determine_too_little_are_waited_for():
    position, speed = Sensor(std=0.1, resolution=0.0), Sensor(std=0.1, resolution=0.0, reads=[0.0, 1.0])
    plain = Monitor(DT, ConstantRate(std=0.1), {"position": position, "speed": speed})
    y = np.column_stack([np.zeros(LONGEST + 50), np.full(LONGEST + 50, NAN)])
    known = replace(plain, initial_mean=[0.0, 0.0], initial_std=[1.0, 1.0])
    for monitor, began, silent in ((plain, None, ["speed"]), (known, 0.0, [])):
        stepper = MonitorStepper(monitor, compiled=False)
        run(stepper, y)
        assert (stepper.began, stepper.silent) == (began, silent)


def test_a_delay_is_refused_and_names_are_those_of_the_file():
    monitor = Monitor(DT, RandomWalk(std=0.06), {**sensors("ab"), "gnss": Sensor(std=0.1, delay=0.15)})
    with pytest.raises(ModelError, match=r"'gnss' has delay = 0.15 s.*Remove"):
        MonitorStepper(monitor, compiled=False)
    stepper = MonitorStepper(Monitor(DT, RandomWalk(std=0.06), sensors()), compiled=False)
    stepper.prepare()
    with pytest.raises(UnknownNameError, match="There is no input 'd'"):
        stepper.input_places("d")


def test_a_learner_without_probabilities_has_none():
    monitor = Monitor(DT, RandomWalk(std=0.06), sensors(), precision=FixedPrecision())
    live = run(MonitorStepper(monitor, compiled=False), rows())
    assert np.isnan(live["fault_probability"]).all()
    assert np.isfinite(live["x_hat"][-1]).all()
    watch = AlarmWatch(list("abc"), (), Fraction(1, 10))
    assert not watched(watch, {"fault_probability": live["fault_probability"]}, 400)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_logger_that_repeats_its_last_row_blames_no_sensor(seed):
    """When it went on, all sensors had an offset for hours, although they agreed."""
    rng, steps = np.random.default_rng(seed), 1200
    level = 50.0 + 5.0 * np.sin(2 * np.pi * np.arange(steps) / 200)
    y = (level[:, None] + 0.08 * rng.standard_normal((steps, 3))).round(2)
    for begin in (320, 650, 930):
        y[begin : begin + 20] = y[begin]
    sensors = {name: Sensor(std=0.08, resolution=0.01) for name in "abc"}
    for plant, start in (RandomWalk(std=0.16), (50.0, 1.0)), (ConstantRate(std=0.01), ((50.0, 0.0), (1.0, 0.2))):
        monitor = Monitor(1.0, plant, sensors, joint=True, initial_mean=start[0], initial_std=start[1])
        ran = monitor.run({name: Signal(np.arange(float(steps)), y[:, i]) for i, name in enumerate("abc")})
        assert not ran.events
        live = run(MonitorStepper(monitor), y)
        assert np.nanmax(live["fault_probability"]) < 0.9  # of an alarm
        for belief in (ran.x_hat[:, 0], live["x_hat"][:, 0]):
            np.testing.assert_array_equal(belief[652:670], belief[652])
            assert np.abs(belief - level)[672:900].max() < 0.5


@pytest.mark.parametrize("seed", range(8))
def test_a_rest_is_that_of_a_recording_but_for_its_first_steps(seed):
    rng, steps = np.random.default_rng(seed), 300
    y = rng.integers(0, 3, (steps, 3)).astype(float)
    for begin in rng.integers(10, 280, 6):
        y[begin : begin + rng.integers(2, 20)] = y[begin]  # all repeat themselves
    y[rng.random((steps, 3)) < 0.2] = NAN
    p = rng.random((steps, 3))
    rest = at_rest(y)
    expected = held({"p": p}, ["p"], y, rest)["p"]
    watch = RestWatch(3)
    seen, live = zip(*((watch.see(y[k]), watch.hold({"p": p[k]})["p"]) for k in range(steps)), strict=True)
    np.testing.assert_array_equal(seen, known(rest))
    live = np.array(live)
    begins = np.flatnonzero(rest & ~np.roll(rest, 1))
    early = np.zeros(steps, dtype=bool)
    for begin in begins:
        early[begin : begin + LEAST - 1] = True
    assert rest.sum() > 20
    np.testing.assert_array_equal(live[~early], expected[~early])
    own = early[:, None] & (live == p)
    assert (own | (live == expected))[early].all()


def test_a_gap_is_that_of_a_recording_but_for_its_first_steps():
    """The third sensor sends at every second step; the first one is late after the gap."""
    monitor = Monitor(DT, RandomWalk(std=0.06), sensors())
    y = rows(300)
    y[240:280], y[280:282, 0] = NAN, NAN
    stepper = MonitorStepper(monitor, compiled=False)
    live = run(stepper, y)["fault_probability"]
    expected = recorded(monitor, y).fault_probability
    steps = np.r_[30:240, 246:300]
    np.testing.assert_allclose(live[steps], expected[steps], atol=0.02)
    assert live[246:282, 0].max() < 0.5  # no dropout
    assert live[246:280, 1].min() > 0.9  # the offset lasts
    stepper = MonitorStepper(monitor, compiled=False)
    run(stepper, y[:250])
    assert stepper.gap_since == pytest.approx(239 * DT)
    stepper.advance(y[282])
    assert stepper.gap_since is None


def test_an_alarm_lasts_as_in_a_recording():
    from bayesftc.cosim.judging.parts import alarms

    rng = np.random.default_rng(3)
    for hold in (0.0, 0.2, 0.5):
        p = np.repeat(rng.random(200), rng.integers(1, 6, 200))
        watch = AlarmWatch(["s"], (), Fraction(1, 10), Alarm(threshold=0.7, hold=hold))
        events = watched(watch, {"fault_probability": p[:, None]}, len(p))
        spans = [(round(event.start / DT), round(event.end / DT) + 1) for event in events]
        assert spans == alarms(p, 0.7, round(hold / DT))
        assert len(spans) > 5


def test_the_default_learner_is_that_of_recordings():
    stepper = MonitorStepper(Monitor(DT, RandomWalk(std=0.06), sensors()), compiled=False)
    run(stepper, rows())
    learner = stepper.estimator.precision
    expected = default_precision(learner.loss, (0.0, 0.0, 0.0), learner.modes[0].healthy_repeats)
    assert [type(mode) for mode in learner.modes] == [type(mode) for mode in expected.modes]
    assert learner.loss == pytest.approx((0.01, 0.01, 0.5))


def test_a_gap_of_a_stream_needs_the_usual_interval():
    """Two sensors send every tenth step; then nothing comes for 60 steps, and a third has never sent."""
    watch, since = GapWatch(3), []
    for k in range(160):
        y = np.full(3, np.nan)
        if k % 10 == 0 and not 60 <= k < 120:
            y[:2] = 1.0
        watch.feed(y, {"probability": np.zeros(3)})
        since.append(watch.since)
    gap = [k for k, begin in enumerate(since) if begin is not None]
    assert gap == list(range(80, 120))
    assert {since[k] for k in gap} == {50}


def test_a_step_by_hand_has_a_sample_or_none_of_each_sensor():
    sensors = {name: Sensor(std=0.1, resolution=0.0) for name in "abc"}
    stepper = MonitorStepper(Monitor(0.1, RandomWalk(std=0.1), sensors), compiled=False)
    with pytest.raises(ModelError, match=r"Call prepare\(\) before the first advance"):
        stepper.advance([1.0, 2.0, 3.0])
    stepper.prepare()
    with pytest.raises(ModelError, match=r"A step of the monitor has 3 samples \(a, b, c\), not 2"):
        stepper.advance([1.0, 2.0])
    with pytest.raises(ModelError, match=r"The sample of c is 1000.*\. Give a number"):
        stepper.advance([1.0, 2.0, 10**400])
    with pytest.raises(ModelError, match=r"The sample of b is .*'Bad'.*\. Give a number"):
        stepper.advance(np.array([1.0, "Bad", 2.0], dtype=object))
    with pytest.raises(ModelError, match=r"The sample of b is 'Bad'\. Give a number; NaN or None is a missing sample"):
        stepper.advance([1.0, "Bad", 2.0])
    for _ in range(30):
        out = stepper.advance([20.0, None, 20.1])
        out = stepper.advance([20.0, 20.1, 20.1])
    assert out[stepper.output_places("fault_probability")].max() < 0.5
