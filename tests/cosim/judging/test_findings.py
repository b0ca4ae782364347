"""What a run shows of faults, by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesftc.cosim.judging.blame import advice_on, blamed_together
from bayesftc.cosim.judging.figures.fault_panels import draw_detection
from bayesftc.cosim.judging.findings import findings, numbers_of, onset_of_alarm
from bayesftc.cosim.judging.parts import HOLD, HOLD_SAMPLES, MOST_HOLD_SAMPLES, parts, usual_hold
from bayesftc.cosim.judging.signals import LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.run.summary import pauses

FROZEN, OFFSET, DRIFTING = np.eye(4)[1:]


def course(*stretches):
    """Return the probabilities of the modes, healthy first, from rows and the number of samples of each."""
    return np.concatenate([np.tile(row, (count, 1)) for row, count in stretches])


def loop(chances, onset=None, recorded=True):
    """Return the signals of a loop of one sensor from the probabilities of its modes at each second."""
    kind, n = chances.argmax(axis=1).astype(float), len(chances)
    sensor = SensorSignals(
        0, np.zeros(n), np.zeros(n, bool), np.ones(n), None, 1.0 - chances[:, 0], None, kind,
        ("Frozen", "Offset", "Drifting"), "m", kind, onset, ("unit",) * 3, (), chances if recorded else None,
    )  # fmt: skip
    return LoopSignals(np.arange(float(n)), (), (sensor,), {})


def rows(signals):
    return [(found.kind, found.start, found.end) for found in findings(signals)]


@pytest.mark.parametrize(
    ("onset", "earlier", "shown"),
    [(None, 8.0, None), (2.0, None, 2.0), (11.0, None, 10.0), (2.0, 8.0, 8.0), (9.0, 8.0, 9.0)],
)
def test_an_onset_is_between_the_earlier_alarm_and_its_own(onset, earlier, shown):
    assert onset_of_alarm(onset, 10.0, earlier) == shown


def test_the_alarms_of_a_run_do_not_begin_inside_the_one_before():
    blamed = np.isin(np.arange(40), [3, 4, 30, 31])
    sensor = SimpleNamespace(
        index=0, unit="m", probability=blamed.astype(float), kind=blamed.astype(int), kinds=("Offset",), sizes=("unit",),
        chances=None, onset=np.full(40, 2.0), size=np.full(40, 1.0),
    )  # fmt: skip
    run = SimpleNamespace(
        time=np.arange(40.0), sensors=[sensor], actuators=[], moved=None, sensor_name=lambda i: f"sensor {i}"
    )
    assert [(found.onset, found.start, found.end) for found in findings(run)] == [(2.0, 3.0, 4.0), (4.0, 30.0, 31.0)]


@pytest.mark.parametrize(
    ("stretches", "expected"),
    [
        ([(OFFSET, 60), (FROZEN, 60)], [(0, 60, 2), (60, 120, 1)]),
        ([(OFFSET, 12), (DRIFTING, 88)], [(0, 100, 3)]),  # an offset that grows
        ([(DRIFTING, 88), (OFFSET, 12)], [(0, 100, 3)]),  # not the last kind
        ([(OFFSET, 14), (DRIFTING, 86)], [(0, 14, 2), (14, 100, 3)]),
        ([(OFFSET, 9), (FROZEN, 10)], [(0, 19, 1)]),  # ten samples distinguish nothing
        ([(OFFSET, 4), (DRIFTING, 3)] * 20, [(0, 140, 2)]),  # flicker
        ([(OFFSET, 50), (FROZEN, 50), (OFFSET, 50)], [(0, 50, 2), (50, 100, 1), (100, 150, 2)]),
        (
            [(0.4 * OFFSET + 0.6 * DRIFTING, 60), (OFFSET, 40)],
            [(0, 100, 2)],
        ),  # the largest mean, with a small advantage before
        ([(0.0 * OFFSET, 30)], [(0, 30, 0)]),
    ],
)
def test_a_kind_that_changes_for_good_divides_an_alarm(stretches, expected):
    assert parts(course(*stretches)[:, 1:], 0, sum(n for _, n in stretches), 1.0) == expected


def test_a_kind_that_samples_show_by_themselves_begins_where_it_does():
    """A dropout was listed from the begin of the alarm on, while the sensor still had samples."""
    chances = course((OFFSET, 85), (FROZEN, 130))[:, 1:]
    assert parts(chances, 0, 215, 0.01) == [(0, 215, 1)]
    assert parts(chances, 0, 215, 0.01, plain=(0,)) == [(0, 85, 2), (85, 215, 1)]
    tail = course((OFFSET, 500), (FROZEN, 150), (OFFSET, 99))[:, 1:]
    assert parts(tail, 0, 749, 0.01, plain=(0,)) == [(0, 500, 2), (500, 650, 1), (650, 749, 2)]
    by_way = course((DRIFTING, 60), (FROZEN, 5), (OFFSET, 600))[:, 1:]
    assert parts(by_way, 0, 665, 1.0, plain=(0,)) == parts(by_way, 0, 665, 1.0) == [(0, 665, 2)]


@pytest.mark.parametrize("kind", [0.0, np.nan])
def test_an_alarm_of_a_controller_that_names_no_kind_has_none(kind):
    """It was an error of numpy: the maximum of an empty sequence."""
    signals = loop(course((OFFSET, 30)), recorded=False)
    sensor = replace(signals.sensors[0], kind=np.full(30, kind), kinds=(), sizes=())
    assert rows(replace(signals, sensors=(sensor,))) == [("", 0.0, 29.0)]


def test_each_kind_of_an_alarm_has_its_own_row_onset_and_bar():
    healthy = np.array([1.0, 0.0, 0.0, 0.0])
    chances = course((healthy, 20), (OFFSET, 60), (DRIFTING, 60), (healthy, 60))
    onset = np.where(np.arange(200) < 80, 15.0, np.where(np.arange(200) < 100, 60.0, 79.5))  # at first 20 s too early
    signals = loop(chances, onset)
    assert rows(signals) == [("Offset", 20.0, 79.0), ("Drifting", 80.0, 139.0)]
    assert rows(loop(chances, onset, recorded=False)) == rows(signals)
    assert [found.onset for found in findings(signals)] == [15.0, 79.5]
    assert [found.size for found in findings(signals)] == [2.0, 3.0]
    assert bars_of(signals) == [(20.0, 80.0), (80.0, 140.0)]


@pytest.mark.parametrize(("other", "size"), [(OFFSET, 199.0), (FROZEN, 189.0)])
def test_the_size_of_a_row_is_that_at_its_end(other, size):
    """A slow drift, Drifting and Ramping in turns, had the size of the last step with the kind of its row, hours before."""
    signals = loop(course((other, 10), (DRIFTING, 180), (other, 10)))
    sensor = replace(signals.sensors[0], size=np.arange(200.0))
    (found,) = findings(replace(signals, sensors=(sensor,)))
    assert (found.kind, found.size) == ("Drifting", size)


def test_a_freeze_keeps_the_onset_with_which_it_is_found():
    onset = 18.0 + np.where(np.arange(200) < 30, 0.0, 0.1 * np.arange(200))  # the learner forgets it
    (found,) = findings(loop(course((np.array([1.0, 0.0, 0.0, 0.0]), 20), (FROZEN, 120)), onset[:140]))
    assert (found.kind, found.onset) == ("Frozen", 18.0)


def test_the_bar_of_an_alarm_has_the_kind_of_its_row():
    signals = loop(course((OFFSET, 10), (DRIFTING, 180), (OFFSET, 10)))
    assert rows(signals) == [("Drifting", 0.0, 199.0)]
    assert bars_of(signals) == [(0.0, 199.0)]


def test_an_alarm_has_its_likeliest_kind_also_where_no_kind_is_more_probable_than_healthy():
    signals = loop(course(([0.4, 0.05, 0.3, 0.25], 30)))
    (found,) = findings(signals)
    assert (found.kind, found.onset, found.size) == (
        "Offset",
        None,
        None,
    )  # the learner's numbers are those of a healthy sensor


def drawn(signals):
    from matplotlib.figure import Figure

    axis = Figure().subplots()
    draw_detection(axis, signals=signals)
    return axis


def bars_of(signals):
    axis = drawn(signals)
    bars, *changes = axis.collections
    assert [x for line in changes for (x, _), _ in line.get_segments()] == [f.start for f in findings(signals)[1:]]
    return [tuple(path.get_extents().intervalx) for path in bars.get_paths()]


HEALTHY = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("pause", [1, 5, 10])
def test_a_pause_over_which_the_kind_changes_is_in_no_alarm(pause):
    chances = course((HEALTHY, 20), (OFFSET, 60), (HEALTHY, pause), (FROZEN, 60), (HEALTHY, 60))
    signals = loop(chances, np.where(np.arange(200 + pause) < 80, 15.0, 60.0))
    again = 80.0 + pause
    assert rows(signals) == [("Offset", 20.0, 79.0), ("Frozen", again, again + 59.0)]
    assert [found.onset for found in findings(signals)] == [15.0, 79.0]  # of the second: not inside the alarm before
    assert rows(loop(chances, recorded=False)) == rows(signals)
    axis = drawn(signals)
    assert [path.get_extents().x0 for path in axis.collections[0].get_paths()] == [20.0, again]
    assert len(axis.collections) == 1  # without the line of a change within an alarm


def test_the_tail_of_the_first_fault_in_a_pause_does_not_begin_an_alarm():
    tail, doubt = [0.7, 0.0, 0.3, 0.0], [0.6, 0.4, 0.0, 0.0]
    chances = course((OFFSET, 60), (tail, 3), (HEALTHY, 4), (doubt, 3), (FROZEN, 60))
    assert rows(loop(chances)) == [("Offset", 0.0, 59.0), ("Frozen", 70.0, 129.0)]


def test_the_first_samples_after_a_pause_do_not_have_the_kind_before_it():
    """A learner that does not yet know the kind of the second fault called it an offset, which then lasted over the pause."""
    chances = course((OFFSET, 60), (HEALTHY, 6), (OFFSET, 6), (DRIFTING, 60))
    assert rows(loop(chances)) == [("Offset", 0.0, 59.0), ("Drifting", 66.0, 131.0)]
    chances = course((OFFSET, 60), (HEALTHY, 6), (OFFSET, 30), (DRIFTING, 60))
    assert rows(loop(chances)) == [("Offset", 0.0, 95.0), ("Drifting", 96.0, 155.0)]


def test_a_brief_pause_does_not_end_an_alarm_of_one_kind():
    chances = course((OFFSET, 60), (HEALTHY, 10), (OFFSET, 60))
    assert rows(loop(chances)) == [("Offset", 0.0, 129.0)]


def test_the_text_below_the_list_names_the_longest_pause_within_an_alarm():
    for step, pause in (
        (0.1, HOLD),
        (0.02, HOLD),
        (300.0, 300.0 * HOLD_SAMPLES),
        (1e-5, 1e-5 * MOST_HOLD_SAMPLES),
    ):
        assert (
            pauses(usual_hold(step))
            == f"Alarms of one kind with a pause of up to {pause:g} s between them are one row."
        )


def two_sensors(alarm, faulty, missed):
    """Return a run of two sensors of a quantity: the second, healthy one has alarms; the first one may have a fault instead."""
    time = np.arange(100.0)
    first = SensorSignals(0, np.zeros(100), faulty, None, None, missed)
    second = SensorSignals(1, np.zeros(100), np.zeros(100, dtype=bool), None, None, alarm)
    quantity = QuantitySignals("v", None, (0, 1), np.zeros(100), None, np.zeros(100), False, True)
    return LoopSignals(time, (quantity,), (first, second), {})


def test_a_fault_that_is_missed_beside_a_sensor_that_is_blamed_is_the_reason():
    late = np.arange(100) >= 40
    advice = advice_on(two_sensors(late.astype(float), late, np.zeros(100)), 1)
    assert advice.startswith("Meanwhile sensor 0 has a fault and is not blamed.")
    seen = late & (np.arange(100) >= 91)
    advice = advice_on(two_sensors((late & ~seen).astype(float), late, seen.astype(float)), 1)
    assert advice.startswith("Meanwhile sensor 0 is blamed for only 15% of its fault. A slow fault")
    assert "Look at the model" in advice_on(two_sensors(late.astype(float), ~late, np.zeros(100)), 1)
    assert "Look at the model" in advice_on(two_sensors(late.astype(float), late, late.astype(float)), 1)


def test_all_sensors_whose_faults_are_missed_are_named():
    late = np.arange(100) >= 40
    run = two_sensors(late.astype(float), late, np.zeros(100))
    (quantity,) = run.quantities
    third = replace(run.sensors[0], index=2)
    run = replace(run, quantities=(replace(quantity, sensors=(0, 1, 2)),), sensors=(*run.sensors, third))
    start = "Meanwhile sensor 0 has a fault and is not blamed and sensor 2 has a fault and is not blamed."
    assert advice_on(run, 1).startswith(start)


@pytest.mark.parametrize("known", [True, False])
def test_sensors_that_agree_against_another_that_is_blamed_as_well_speak_against_the_model(known):
    """A frozen sensor, seen as such, was called the one that is believed."""
    rng, late = np.random.default_rng(0), np.arange(200) >= 80
    samples = [np.zeros(200), *(0.1 * rng.normal(size=(2, 200)))]
    sensors = tuple(
        SensorSignals(i, y, late if i == 0 else ~late & late, None, None, late * (1.0 if i or known else 0.0))
        for i, y in enumerate(samples)
    )
    quantity = QuantitySignals("v", None, (0, 1, 2), np.zeros(200), None, np.zeros(200), False, True)
    notes = blamed_together(LoopSignals(np.arange(200.0), (quantity,), sensors, {}))
    (note,) = notes["model" if known else "named"]
    assert note.startswith("sensors 1 and 2 of v agree but are blamed from t = 80 s")
    assert ("and sensor 0, which has a fault, is believed" in note) == (not known)


def test_a_missing_sample_is_no_false_alarm():
    """A dead time of 30 s of all sensors was 4 false alarms beside a share of 0 % of blamed samples."""
    signals = loop(
        course((FROZEN, 5), (np.eye(4)[0], 20), (FROZEN, 5), (np.eye(4)[0], 5), (FROZEN, 3), (np.eye(4)[0], 60))
    )
    (sensor,) = signals.sensors
    samples = np.zeros(98)
    samples[:5] = samples[25:30] = np.nan
    signals = replace(signals, sensors=(replace(sensor, samples=samples, faulty=np.zeros(98, bool)),))
    assert numbers_of(signals)["alarms"]["false_alarms"] == 1


def test_an_alarm_that_outlasts_a_dropout_is_not_false():
    """The first sample after the dropout was counted as an alarm of its own."""
    signals = loop(course((np.eye(4)[0], 20), (FROZEN, 11), (np.eye(4)[0], 60)))
    samples, faulty = np.zeros(91), np.zeros(91, bool)
    samples[20:30], faulty[20:30] = np.nan, True
    signals = replace(signals, sensors=(replace(signals.sensors[0], samples=samples, faulty=faulty),))
    assert numbers_of(signals)["alarms"]["false_alarms"] == 0
