"""A wrong model, which makes a monitor blame healthy sensors, is told from sensors that have failed."""

import re
from dataclasses import replace

import numpy as np
import pytest

from bayesftc.controllers.bayesian import recorded
from bayesftc.controllers.diagnosis.scatter import scatter
from bayesftc.monitoring import (
    ConstantRate,
    FaultEvent,
    Matrices,
    Monitor,
    RandomWalk,
    Sensor,
    Signal,
    align,
    doubtful_alarms,
    suspect_model,
)
from bayesftc.monitoring.fit import suspect

STEPS = 600


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    """Run compiled: each search runs the monitor several times."""
    monkeypatch.setattr(recorded, "SHORT", 0)


def samples(seed=0, sensors=3, walk=0.03, noise=0.1):
    """Return redundant samples of a random walk, one a second."""
    rng = np.random.default_rng(seed)
    level = 20.0 + np.cumsum(walk * rng.standard_normal(STEPS))
    return level[:, None] + noise * rng.standard_normal((STEPS, sensors))


def watched(y, plant=None, std=0.1, **options):
    """Return a monitor of these samples, and what it finds in them."""
    names = [f"T{i}" for i in range(y.shape[1])]
    signals = {name: Signal(np.arange(float(len(y))), y[:, i], unit="degC") for i, name in enumerate(names)}
    each = np.broadcast_to(std, len(names)).tolist()
    sensors = {name: Sensor(std=std, unit="degC") for name, std in zip(names, each, strict=True)}
    more = {"initial_mean": [20.0, 0.0], "initial_std": [1.0, 1e-3]} if isinstance(plant, ConstantRate) else {}
    monitor = Monitor(1, plant or RandomWalk(std=0.03), sensors, **more, **options)
    return monitor, monitor.run(align(signals, {}, 1))


def found(y, plant=None, std=0.1):
    """Return what a monitor of these samples finds, and what is suspected of it."""
    monitor, monitored = watched(y, plant, std)
    return monitored, suspect_model(monitor, monitored)


def test_two_sensors_that_fail_together_are_no_wrong_model_beside_a_healthy_third():
    y = samples()
    y[200:400, :2] += 2.0
    monitored, suspicion = found(y)
    assert {event.sensor for event in monitored.events} == {"T0", "T1"}
    assert suspicion is None


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (RandomWalk(std=0.003), r"std = 0\.0(09|15|3) in \[model\] instead of 0\.003, (3|5|10) times as large\."),
        (ConstantRate(std=1e-6), r"std = .* in \[model\] instead of 1e-06, .* times as large\."),
        (Matrices([[1.0]], [[9e-6]]), r"the process_covariance in \[model\] is (9|25|100) times as large\."),
    ],
)
def test_a_motion_that_is_too_small_is_named_with_what_it_needs(plant, words):
    monitored, suspicion = found(samples(), plant)
    assert len({event.sensor for event in monitored.events}) > 1
    assert (suspicion.setting, suspicion.ratio > 2) == ("motion", True)
    assert suspicion.sentence.startswith("Suspect the model, not the sensors: ")
    assert "agree with each other, but are blamed at the same time" in suspicion.sentence
    assert "then differs from its prediction by" in suspicion.sentence
    assert "degC (root mean square), but the model expects 0.1" in suspicion.sentence
    assert re.search(words, suspicion.sentence)
    assert (
        found(samples(), suspect._with(Monitor(1, plant, {"a": Sensor(std=1)}), "motion", suspicion.factor).plant)[1]
        is None
    )


def pumped(seed, noise, times):
    """Return samples of sensors with this noise while a pump runs for 15 s, once or several times."""
    y = samples(seed, len(noise), noise=noise)
    for begin in (3000, 6000)[:times]:
        y += 0.15 * np.clip(np.arange(9000.0) - begin, 0, 15)[:, None]
    return y


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
def test_alarms_of_some_sensors_that_agree_are_named_from_the_second_time_on(seed, monkeypatch):
    monkeypatch.setitem(globals(), "STEPS", 9000)
    noise = [0.1, 0.1, 2.0]  # the third one is too coarse to see the pump
    for times in (1, 2):
        monitored, suspicion = found(y := pumped(seed, noise, times), std=noise)
        assert {event.sensor for event in monitored.events} == {"T0", "T1"}
        assert (suspicion is None) == (times == 1)
    assert suspicion.share < suspect.LEAST_SHARE
    assert suspicion.setting == "motion"
    assert "agree with each other, but are blamed at the same time, 2 times." in suspicion.sentence
    assert suspect.SHARED not in suspicion.sentence  # the third one has not failed
    assert found(y, RandomWalk(std=0.03 * suspicion.factor), noise)[1] is None


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sensors", [2, 3])
def test_alarms_of_all_sensors_are_named_at_the_first_time_if_they_agree(seed, sensors, monkeypatch):
    monkeypatch.setitem(globals(), "STEPS", 9000)
    y = pumped(seed, [0.1] * sensors, 1)
    y[8000:, 0] += 2.0  # a fault of one, long after
    monitor, monitored = watched(y)
    suspicion = suspect_model(monitor, monitored)
    assert suspicion.share < suspect.LEAST_SHARE
    assert suspicion.sensors == tuple(monitored.recording.sensors)
    assert suspicion.setting == "motion"
    assert re.search(
        r"agree with each other, but are blamed at the same time, from 30\d+ to 3\d+ s\.", suspicion.sentence
    )
    assert suspect.SHARED in suspicion.sentence
    doubtful = doubtful_alarms(monitor, monitored)
    assert {event.sensor for event in doubtful} == set(suspicion.sensors)
    assert all((event.start < 3100) == (event in doubtful) for event in monitored.events)
    assert found(y, RandomWalk(std=0.03 * suspicion.factor))[1] is None


def test_a_fault_that_all_sensors_share_is_named_beside_the_model(monkeypatch):
    monkeypatch.setitem(globals(), "STEPS", 9000)
    y = samples()
    y[5000:5100] += 3.0
    monitored, suspicion = found(y)
    assert {event.sensor for event in monitored.events} == {"T0", "T1", "T2"}
    assert suspect.SHARED in suspicion.sentence


def test_two_failures_from_one_cause_are_no_reason_to_suspect_the_model():
    y = samples()
    for begin in (100, 250, 400):
        y[begin : begin + 8, :2] += 1.0  # the third sensor disagrees
    assert found(y)[1] is None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [0, 1, 2, 4])
@pytest.mark.parametrize("walk", [0.05, 0.02])
def test_sensors_that_agree_after_one_of_two_has_failed_are_no_reason_to_suspect_the_model(seed, walk):
    """One of two drifts by 2 degC and recovers at once: the belief has followed it, so that then both are blamed, and agree."""
    rng, n = np.random.default_rng(seed), 4000
    level = 18.0 + np.cumsum(walk * rng.standard_normal(n))
    y = (level[:, None] + 0.2 * rng.standard_normal((n, 2))).round(1)
    drift = slice(1800, 2640)
    y[drift, 0] += np.linspace(0.0, 2.1, 840).round(1)
    signals = {name: Signal(60.0 * np.arange(n), y[:, i]) for i, name in enumerate("ab")}
    monitor, recording = Monitor.fit(signals)
    monitored = monitor.run(recording)
    assert suspect_model(monitor, monitored) is None
    assert doubtful_alarms(monitor, monitored) == ()
    blamed = monitored.fault_probability[drift.stop :].min(axis=1) > monitor.alarm.threshold
    notes = [*suspect.failed_before(monitor, monitored)]
    assert len(notes) == (blamed.sum() > suspect.LEAST_SAMPLES)
    for note in notes:
        begin, end = map(float, re.findall(r"from about (\S+) to (\S+) s", note)[0])
        assert 60.0 * drift.start < begin < 60.0 * drift.stop
        assert end == pytest.approx(60.0 * drift.stop, abs=60.0 * 30)


def test_a_wrong_model_is_suspected_although_a_sensor_fails_elsewhere():
    y = samples()
    y[500:, 0] += 2.0
    suspicion = found(y, RandomWalk(std=0.003))[1]
    assert suspicion.setting == "motion"
    assert suspicion.sentence.startswith("Suspect the model, not the sensors: ")


@pytest.mark.parametrize("third", [True, False])
def test_sensors_without_samples_at_the_same_steps_are_no_evidence(third, monkeypatch):
    monkeypatch.setitem(globals(), "STEPS", 9000)
    y, steps = samples(sensors=2 + third), np.arange(9000)
    for begin in (2000, 5000, 8000):
        y[begin : begin + 30, :2] += [3.0, 3.0] if third else [6.0, -6.0]
    if third:
        y[steps % 200 > 0, 2] = np.nan  # it is healthy, and has a sample at the begin of each fault at most
    else:
        y[steps % 2 == 0, 0] = y[steps % 2 == 1, 1] = np.nan
    monitored, suspicion = found(y)
    assert {event.sensor for event in monitored.events} == {"T0", "T1"}
    assert suspicion is None


@pytest.mark.parametrize("sensors", [2, 3])
def test_noise_that_is_too_small_is_named_with_what_it_needs(sensors):
    _, suspicion = found(samples(sensors=sensors), std=0.02)
    assert suspicion.setting == "noise"
    assert suspicion.factor == pytest.approx(5.0, rel=0.15)
    assert suspicion.sentence.startswith("The model may be wrong instead of the sensors: ")
    assert re.search(
        "T0 and T1 differ from each other by 0.1[34].* degC .*expects 0.0283 degC: from the std", suspicion.sentence
    )
    assert found(samples(sensors=sensors), std=0.02 * suspicion.factor)[1] is None


def test_biases_that_the_model_lacks_are_named():
    _, suspicion = found(samples() + np.array([1.0, -0.7, 0.0]))
    assert suspicion.setting == ""
    assert suspicion.sentence.startswith("The model may be wrong instead of the sensors: T0 and T1 are blamed")
    assert "T0 and T1 differ by 1." in suspicion.sentence
    assert "give the bias of each sensor" in suspicion.sentence


def jump(y):
    y[60:, 1] += 2.0


def drift(y):
    y[60:, 1] += 0.02 * np.arange(STEPS - 60)


def freeze(y):
    y[60:, :-1] = y[60, 0]  # of three sensors two, which then agree


def silence(y):
    y[60:, :-1] = np.nan


def noisier(y):
    y[60:, 0] += 0.5 * np.random.default_rng(5).standard_normal(STEPS - 60)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sensors", [2, 3])
@pytest.mark.parametrize("fault", [None, jump, drift, freeze, silence, noisier])
def test_a_right_model_is_not_suspected_if_sensors_fail(fault, sensors, seed):
    y = samples(seed, sensors)
    if fault:
        fault(y)
    monitored, suspicion = found(y)
    assert bool(monitored.events) == bool(fault)
    assert suspicion is None


def test_a_long_recording_is_searched_where_the_blame_is(monkeypatch):
    monkeypatch.setattr(suspect, "MOST_STEPS", 200)
    y = samples()
    y[:300] = 20.0 + (y[:300] - y[:300].mean(axis=1, keepdims=True))  # at rest at first
    lengths = []
    run = Monitor.run
    monkeypatch.setattr(
        Monitor, "run", lambda self, recording: (lengths.append(len(recording.y)), run(self, recording))[1]
    )
    _, suspicion = found(y, RandomWalk(std=0.003))
    assert suspicion.setting == "motion"
    assert set(lengths[1:-1]) == {200}  # what ends the blame there is tried once on all of it
    assert lengths[-1] == 600


def test_errors_are_compared_with_what_is_expected():
    errors = np.array([3.0, -3.0, np.nan])
    assert scatter(errors, 1.0, "m", "It differs", "its std") == (
        "It differs by 3 m (root mean square), but the model expects 1 m: its std."
    )
    assert scatter(errors, 2.9, None, "It differs", "its std") == ""
    assert scatter(np.array([np.nan]), 1.0, "m", "It differs", "its std") == ""


def moving(step, drift=0.0):
    """Return samples of two sensors of a quantity that moves by a step at the start; the second one may drift."""
    t, rng = np.arange(1000.0), np.random.default_rng(0)
    level = 20.0 + step * ((t > 0) + 0.16 * (t > 1) - 0.57 * (1.0 - np.exp(-t / 60.0)))
    return level[:, None] + 0.1 * rng.standard_normal((1000, 2)) - np.outer(np.maximum(t - 500.0, 0.0), [0.0, drift])


def test_two_sensors_that_agree_and_are_both_noisier_have_not_seen_motion():
    """Of flows from differential pressures, noisier at low flow: a motion 30 times as large was to end it, and did not."""
    monitor, monitored = watched(moving(4.4), RandomWalk(std=0.1), joint=True)
    (when,) = suspect.both_blamed(monitor, monitored)
    louder = [FaultEvent(name, when.start, when.end, 0.99, kind="Noisier", size=2.0) for name in when.sensors]
    for events, said in (
        (louder, "they have more noise than in the model"),
        (louder[:1], "the quantity has moved"),
        ([*louder, replace(louder[0], kind="Offset")], "the quantity has moved"),
    ):
        (sentence,) = suspect.moved(monitor, replace(monitored, events=tuple(events)), [when])
        assert said in sentence


def test_two_sensors_that_agree_while_the_quantity_moves_are_not_open():
    """A sentence said that one of them was faulty, and that a third sensor would tell which one."""
    monitor, monitored = watched(moving(4.4), RandomWalk(std=0.1), joint=True)
    assert not monitored.events
    both = suspect.both_blamed(monitor, monitored)
    assert len(both) == len(monitored.disagreements) == 1
    (sentence,) = suspect.moved(monitor, monitored, both)
    assert "T0 and T1 agree, but by the model both are probably faulty: the quantity has moved more" in sentence
    (std,) = re.findall(r"This ends with std = (\S+) in", sentence)
    monitor, monitored = watched(moving(4.4), RandomWalk(std=float(std)), joint=True)
    assert not monitored.disagreements
    assert not suspect.both_blamed(monitor, monitored)


def test_it_is_open_which_of_two_sensors_drifts():
    monitor, monitored = watched(moving(0.0, drift=0.004), RandomWalk(std=0.1), joint=True)
    assert monitored.disagreements
    assert not suspect.both_blamed(monitor, monitored)
