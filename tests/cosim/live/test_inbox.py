"""The inbox: which samples are used, and for which reasons others are missing. The clock is a number that the tests set."""

import threading

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live import Inbox, Limits
from bayesftc.cosim.live.inbox import BEHIND, CALM, REASONS, RESTART, STEADY


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def inbox(size=1, **limits):
    clock = Clock()
    return Inbox(size, Limits(**limits), clock), clock


def test_a_sample_is_used_once():
    box, _ = inbox()
    box.put(1.0)
    assert box.take().tolist() == [1.0]
    assert np.isnan(box.take()).all()
    assert dict(box.missing) == {"no message": 1}


def test_a_held_sample_is_used_until_it_is_stale():
    box, clock = inbox(hold=True, stale_after=0.5)
    box.put(1.0)
    taken = []
    for _ in range(4):
        taken.append(float(box.take()[0]))
        clock.now += 0.2
    assert taken[:3] == [1.0] * 3
    assert np.isnan(taken[3])
    assert dict(box.missing) == {"stale": 1}


def test_the_newest_of_several_samples_is_used():
    box, _ = inbox()
    for value in (1.0, 2.0, 3.0):
        box.put(value)
    assert box.take().tolist() == [3.0]
    assert (box.received, box.replaced) == (3, 2)


def test_messages_are_dropped_by_hand_for_some_time():
    box, clock = inbox()
    box.put(1.0)
    box.drop(2.0)
    assert box.take().tolist() == [1.0]  # it had come before
    for _ in range(4):
        clock.now += 0.5
        box.put(2.0)
        box.receive(b"hot", "json")
        box.take()
    assert dict(box.missing) == {"dropped by hand": 3}
    assert dict(box.rejected) == {"dropped by hand": 6, "not decodable": 1}
    box.drop(10.0)
    assert box.dropping == 10.0
    box.drop(0.0)
    box.put(3.0)
    assert box.take().tolist() == [3.0]
    for wrong in (-1.0, 3601.0, np.nan, np.inf):
        with pytest.raises(ModelError, match="from 0 to 3600 s"):
            box.drop(wrong)


def test_after_a_step_without_a_message_a_second_sample_waits():
    box, _ = inbox()
    box.take()
    box.put(1.0)
    box.put(2.0)
    assert [float(box.take()[0]) for _ in range(2)] == [1.0, 2.0]
    for value in range(5):
        box.put(float(value))
    assert [float(box.take()[0]) for _ in range(2)] == [3.0, 4.0]
    assert np.isnan(box.take()).all()
    assert (box.received, box.replaced) == (7, 3)


def test_when_each_step_has_had_a_message_for_long_the_newest_is_used():
    box, _ = inbox()
    box.take()
    box.put(-1.0)
    taken = []
    for value in range(CALM + 50):
        box.put(float(value))
        taken.append(float(box.take()[0]))
    first = taken[: CALM - 1]
    assert first == [*map(float, range(-1, CALM - 2))]  # the one before
    assert taken[CALM - 1 :] == [*map(float, range(CALM - 1, CALM + 50))]
    assert box.replaced == 1


def test_a_sample_that_is_stale_does_not_wait_before_a_fresh_one():
    box, clock = inbox(stale_after=0.5)
    box.take()
    box.put(1.0)
    clock.now += 0.4
    box.put(2.0)
    clock.now += 0.2
    assert box.take().tolist() == [2.0]


def test_samples_wait_for_steps_that_are_late():
    box, clock = inbox(stale_after=0.05)
    for value in range(12):
        box.put(float(value))
        clock.now += 0.01
    taken = [float(box.take(late=0.01 * behind, behind=behind)[0]) for behind in range(9, -1, -1)]
    assert taken[0] == 12 - 1 - BEHIND
    assert taken[:9] == [*map(float, range(3, 12))]
    assert box.replaced == 3


def test_a_bad_status_ends_what_waits():
    box, _ = inbox()
    box.put(1.0)
    box.fail("BadNoCommunication")
    assert np.isnan(box.take()).all()
    assert dict(box.missing) == {"bad status": 1}


def slips(ppm, jitter, steps=60_000, **limits):
    """Return the shares of steps without a sample, and of messages not used, and the ages of the samples in periods."""
    rng, clock = np.random.default_rng(1), Clock()
    box = Inbox(1, Limits(**limits), clock)
    begin = 100.0
    sent = begin + (0.5 + np.arange(steps + 100)) * (1 - ppm * 1e-6)  # a period is a second
    came, due = sent + jitter * rng.random(len(sent)), begin + np.arange(1, steps + 1)
    last, ages = 0, []
    for at in due:
        clock.now = at
        while came[last] <= at:
            box.put(float(last))
            last += 1
        value = float(box.take()[0])
        if value == value:
            ages.append(at - came[int(value)])
    return 1 - len(ages) / steps, box.replaced / steps, np.array(ages)


@pytest.mark.slow
@pytest.mark.parametrize("ppm", [50, -50, 0])
@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.6])
def test_clocks_that_drift_leave_few_gaps(ppm, jitter):
    """Three slips, or none: 50 parts in a million are a period in 20,000."""
    missing, unused, ages = slips(ppm, jitter)
    assert missing < 0.001
    assert unused < 0.001
    assert ages.max() <= 2.0
    slower = ppm < 0
    assert missing - unused == pytest.approx(5e-5 * (slower - (ppm > 0)), abs=2e-5)
    if jitter == 0.02:
        assert np.mean(ages > 1.0) < 0.06


def test_scale_and_offset_come_before_the_range():
    box, _ = inbox(scale=0.5, offset=1.0, low=0.0, high=10.0)
    box.put(4.0)
    assert box.take().tolist() == [3.0]
    box.put(30.0)
    assert np.isnan(box.take()).all()
    assert dict(box.missing) == {"out of range": 1}


def test_an_element_can_be_missing_alone():
    box, _ = inbox(3, high=10.0)
    box.put([1.0, np.nan, 11.0])
    assert box.take().tolist()[0] == 1.0
    assert dict(box.missing) == {"not a number": 1, "out of range": 1}


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9])
def test_a_held_sample_outlives_a_bad_one(bad):
    box, _ = inbox(hold=True, high=100.0)
    box.put(5.0)
    box.put(bad)
    assert box.take().tolist() == [5.0]
    assert sum(box.rejected.values()) == 1


def test_order_by_sequence_and_by_time():
    for key in ("sequence", "sent"):
        box, _ = inbox()
        for stamp in (1, 3, 2, 3, 4):
            box.put(float(stamp), **{key: stamp})
        assert box.take().tolist() == [4.0]
        assert dict(box.rejected) == {"out of order": 1, "duplicate": 1}


def test_a_sender_that_restarts_is_heard_again():
    box, _ = inbox()
    for stamp in range(1000, 1005):
        box.put(1.0, sequence=stamp)
    for stamp in range(RESTART + 3):
        box.put(2.0, sequence=stamp)
    assert box.take().tolist() == [2.0]
    assert box.rejected["out of order"] == RESTART - 1


@pytest.mark.parametrize("stop", [0.5, 30.0])
def test_a_sender_that_stood_still_is_heard_again(stop):
    """As a process that was stopped and goes on: its own clock lacks the time of the stop."""
    box, clock = inbox(stale_after=0.06)
    random = np.random.default_rng(0)
    heard = []
    for k in range(1000):
        clock.now += 0.02 + (stop if k == 500 else 0.0)
        box.put(1.0, sent=0.02 * k - random.uniform(0.0, 0.02))
        heard.append(np.isfinite(box.take()[0]))
    assert all(heard[:500])
    assert not any(heard[501 : 500 + int(0.9 * STEADY / 0.02)])
    assert all(heard[501 + int(STEADY / 0.02) + 1 :])


def test_messages_that_come_later_and_later_stay_late():
    """As those of a sender whose messages wait in a queue that grows."""
    box, clock = inbox(stale_after=0.06)
    box.put(1.0, sent=clock.now)
    assert box.take().tolist() == [1.0]
    for delay in np.linspace(0.1, 3.0, 1000):
        clock.now += 0.02
        box.put(1.0, sent=clock.now - delay)
        assert np.isnan(box.take()[0])
    assert set(box.rejected) == {"late", "out of order"}
    assert box.rejected["out of order"] < 10


def test_old_messages_in_any_order_are_no_restart():
    box, _ = inbox()
    box.put(1.0, sequence=1000)
    for stamp in [5, 4, 3, 2, 1] * 10:
        box.put(2.0, sequence=stamp)
    assert box.take().tolist() == [1.0]


def test_a_message_that_was_long_on_its_way_is_late_though_the_clocks_differ():
    box, clock = inbox(stale_after=0.1)
    for k in range(5):  # the sender's clock is 7000 s behind; messages need 20 ms
        clock.now += 0.05
        box.put(float(k), sent=clock.now - 7000.02)
    clock.now += 0.05
    box.put(9.0, sent=clock.now - 7000.3)  # and this one 300 ms
    assert box.rejected["out of order"] == 1
    clock.now += 1.0
    box.put(10.0, sent=clock.now - 7000.2)
    assert box.rejected["late"] == 1
    assert np.isnan(box.take()).all()


def test_clocks_of_different_rates_do_not_make_messages_late():
    box, clock = inbox(stale_after=0.05)
    began = clock.now
    for k in range(1000):  # an hour and a half, with a clock that is slow by 100 parts in a million
        clock.now += 5.0
        box.put(float(k), sent=(clock.now - began) * (1 - 1e-4))
        assert box.take().tolist() == [float(k)]


def test_a_message_of_another_size_is_refused():
    box, _ = inbox(2)
    box.put([1.0])
    assert np.isnan(box.take()).all()
    assert box.last_reason == "wrong size: 1 instead of 2"
    assert dict(box.missing) == {"wrong size": 2}


def test_what_cannot_be_decoded_is_counted():
    box, _ = inbox()
    box.receive(b"warm", "text")
    assert box.last_reason == "not decodable: not a number"
    assert dict(box.rejected) == {"not decodable": 1}


@pytest.mark.parametrize(
    "limits",
    [{"stale_after": 0.0}, {"stale_after": np.nan}, {"scale": 0.0}, {"offset": np.inf}, {"low": 1.0, "high": 1.0}],
)
def test_limits_without_sense_are_refused(limits):
    with pytest.raises(ModelError, match=next(iter(limits))):
        Limits(**limits)


stamps = st.none() | st.floats(allow_nan=False, allow_infinity=False) | st.integers(-5, 50).map(float)


@given(st.lists(st.tuples(st.floats(), stamps, st.floats(0, 1), st.booleans()), max_size=60), st.booleans())
def test_every_message_and_every_step_is_counted(events, hold):
    box, clock = inbox(hold=hold, stale_after=0.5, low=-1e6, high=1e6)
    steps = present = 0
    for value, stamp, pause, take in events:
        clock.now += pause
        box.put(value, stamp)
        if take:
            steps += 1
            taken = box.take()
            present += bool(np.isfinite(taken).all())
            assert np.isnan(taken).all() or -1e6 <= taken[0] <= 1e6
    assert present + sum(box.missing.values()) == steps
    assert box.received == len(events)
    assert {*box.missing, *box.rejected} <= set(REASONS)


def test_many_threads_lose_no_message():
    box, _ = inbox()
    threads = [threading.Thread(target=lambda: [box.put(1.0) for _ in range(500)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    taken = sum(bool(np.isfinite(box.take()).all()) for _ in range(500))
    for thread in threads:
        thread.join()
    while np.isfinite(box.take()).all():
        taken += 1
    assert box.received == 2000
    assert taken + box.replaced == 2000
