"""UDP on real sockets: loss, reordering, duplication, and packets that are no samples."""

import copy
import random
import socket
import struct
import time

import numpy as np
import pytest

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live import UDP, Inbox, udp


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing has come"
        time.sleep(0.005)


@pytest.fixture
def listener():
    bridge = UDP(port=0, format="stamped doubles")
    yield bridge
    bridge.close()


@pytest.fixture
def raw():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        yield sender


@pytest.mark.slow
def test_loss_reordering_and_duplication(listener, raw):
    box = Inbox(1)
    listener.open(box)
    order = random.Random(1)
    sent = list(range(1, 201))
    packets = [k for k in sent if order.random() > 0.2]  # a fifth is lost
    packets += [k for k in packets if order.random() < 0.1]  # a tenth comes twice
    packets.sort(key=lambda k: k + order.uniform(0, 5))
    used = []
    for n, k in enumerate(packets, 1):
        raw.sendto(struct.pack("<2d", 0.01 * k, float(k)), ("127.0.0.1", listener.port_number))
        until(lambda n=n: box.received == n)
        value = float(box.take()[0])
        if value == value:
            used.append(value)
    assert used == sorted(set(used))
    assert len(used) + box.rejected["out of order"] + box.rejected["duplicate"] == len(packets)
    assert box.rejected["out of order"] > 5


def test_packets_that_are_no_samples(listener, raw):
    box = Inbox(1)
    listener.open(box)
    for payload in (
        b"",
        b"x",
        b"0" * 16,
        struct.pack("<2d", np.nan, 1.0),
        struct.pack("<3d", 1.0, 1.0, 1.0),
        b"y" * 60_000,
    ):
        raw.sendto(payload, ("127.0.0.1", listener.port_number))
    raw.sendto(struct.pack("<2d", 5.0, 7.0), ("127.0.0.1", listener.port_number))
    until(lambda: box.received == 7)
    assert box.take().tolist() == [7.0]


def test_the_age_of_a_packet_counts_from_its_arrival(listener, raw, monkeypatch):
    monkeypatch.setattr(udp, "OFTEN", 1.0)  # the thread does not look
    box = Inbox(1)
    listener.open(box)
    raw.sendto(struct.pack("<2d", 5.0, 7.0), ("127.0.0.1", listener.port_number))
    time.sleep(0.2)
    listener.collect()
    assert box.received == 1
    assert 0.15 < box.age() < 1.0
    monkeypatch.setattr(time, "time", lambda: 4e9)  # the clock of the kernel's times has been set
    raw.sendto(struct.pack("<2d", 5.1, 8.0), ("127.0.0.1", listener.port_number))
    until(lambda: (listener.collect(), box.received == 2)[1])
    assert box.age() < 1.0


def test_packets_that_come_while_no_step_is_made_are_collected(listener, raw):
    box = Inbox(1)
    listener.open(box)
    for k in range(1, 1001):
        raw.sendto(struct.pack("<2d", 0.01 * k, float(k)), ("127.0.0.1", listener.port_number))
        if k % 100 == 0:
            until(lambda k=k: box.received == k)
    assert box.take(behind=8).tolist() == [992.0]
    assert box.replaced == 991


def test_of_a_flood_only_the_newest_are_decoded(listener, raw, monkeypatch):
    monkeypatch.setattr(udp, "OFTEN", 1.0)
    monkeypatch.setattr(udp, "MOST", 100)
    box, decoded = Inbox(1), []
    monkeypatch.setattr(
        box, "receive", lambda *given, usual=box.receive, **named: decoded.append(usual(*given, **named))
    )
    listener.open(box)
    for k in range(1, 151):
        raw.sendto(struct.pack("<2d", 0.01 * k, float(k)), ("127.0.0.1", listener.port_number))
    time.sleep(0.1)
    listener.collect()
    assert (box.received, len(decoded), box.replaced) == (100, 10, 90)
    listener.collect()
    assert box.take().tolist() == [150.0]
    assert (box.received, len(decoded), box.replaced) == (150, 20, 149)


@pytest.mark.parametrize("option", [None, 12_345])  # a system without times of arrival, and one that refuses the option
def test_without_times_of_arrival_each_packet_is_taken_at_once(listener, raw, monkeypatch, option):
    monkeypatch.setattr(udp, "ARRIVAL", option)
    box = Inbox(1)
    listener.open(box)
    for k in range(1, 11):
        raw.sendto(struct.pack("<2d", 0.01 * k, float(k)), ("127.0.0.1", listener.port_number))
        until(lambda k=k: box.received == k)
    assert box.take(behind=8).tolist() == [2.0]
    assert copy.deepcopy(UDP(port=0)) is not None


def test_a_sender_without_listener_goes_on(raw):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bridge = UDP(port=port)
    bridge.open(None)
    for k in range(10):
        bridge.send([1.0], 0.1 * k)
    bridge.close()
    bridge.send([1.0], 1.0)
    assert bridge.lost == 1


def test_only_the_named_sender_is_heard(raw):
    bridge, box = UDP(port=0, sender="192.0.2.1"), Inbox(1)
    bridge.open(box)
    raw.sendto(struct.pack("<d", 1.0), ("127.0.0.1", bridge.port_number))
    until(lambda: box.received)
    assert box.last_reason == "not decodable: from 127.0.0.1"
    bridge.close()


def test_a_used_port_is_refused(listener):
    listener.open(Inbox(1))
    with pytest.raises(ModelError, match=r"cannot listen at 127.0.0.1, port"):
        UDP(port=listener.port_number).open(Inbox(1))
    with pytest.raises(ModelError, match=r"cannot send to no.such.host.invalid"):
        UDP(port=1, address="no.such.host.invalid").open(None)


def test_closing_twice_and_before_opening_is_allowed():
    bridge = UDP(port=0)
    bridge.close()
    bridge.open(Inbox(1))
    bridge.close()
    bridge.close()
