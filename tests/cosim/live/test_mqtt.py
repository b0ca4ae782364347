"""MQTT with real brokers: mosquitto if it is installed, and always a small one of sockets."""

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from brokers import NO_MOSQUITTO, Certificates, Mosquitto, SmallBroker, until
from paho.mqtt import client as paho

from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.live import MQTT, Inbox, Limits
from bayesftc.cosim.live.connections import broker as connections
from bayesftc.cosim.live.mqtt import WINDOW

BROKERS = [
    pytest.param(SmallBroker, id="small"),
    pytest.param(
        Mosquitto, id="mosquitto", marks=pytest.mark.skipif(NO_MOSQUITTO is not None, reason=str(NO_MOSQUITTO))
    ),
]


@pytest.fixture(params=BROKERS)
def make_broker(request, tmp_path):
    made = []

    def make(**settings):
        made.append(request.param(tmp_path, **settings).start())
        return made[-1]

    yield make
    for each in made:
        each.stop()


@pytest.fixture
def opened():
    bridges = []

    def opened(inbox=None, safe=None, **settings):
        bridge = MQTT(**settings)
        bridge.safe = safe
        bridges.append(bridge)
        bridge.open(inbox)
        return bridge

    yield opened
    for bridge in bridges:
        bridge.close()
    assert not connections._CONNECTIONS


@pytest.fixture
def other():
    """A foreign client."""
    clients = []

    def other(port, *topics, user=None):
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        client.messages, client.subscribed = [], 0
        client.on_message = lambda c, d, message: c.messages.append((message.payload, message.qos, message.retain))

        def count(c, *_):
            c.subscribed += 1

        client.on_subscribe = count
        if user:
            client.username_pw_set(*user)
        client.connect("127.0.0.1", port)
        client.loop_start()
        clients.append(client)
        until(client.is_connected)
        for topic in topics:
            client.subscribe(topic, 2)
        until(lambda: client.subscribed == len(topics))
        return client

    yield other
    for client in clients:
        client.disconnect()
        client.loop_stop()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    return Certificates(tmp_path_factory.mktemp("certificates"))


@pytest.mark.parametrize("qos", [0, 1, 2])
def test_samples_arrive(make_broker, opened, other, qos):
    port, box = make_broker().port, Inbox(2)
    reader = opened(box, topic="car/wheels", host="127.0.0.1", port=port, qos=qos)
    until(lambda: reader.connected)
    other(port).publish("car/wheels", '{"values": [1.5, 2.5], "time": 3.0}', qos)
    until(lambda: box.received)
    assert box.take().tolist() == [1.5, 2.5]


@pytest.mark.parametrize("qos", [0, 1, 2])
def test_controls_arrive(make_broker, opened, other, qos):
    port = make_broker().port
    listener = other(port, "car/force")
    writer = opened(topic="car/force", host="127.0.0.1", port=port, qos=qos)
    until(lambda: writer.connected)
    for k in range(5):
        writer.send([float(k)], 0.1 * k)
        until(lambda k=k: len(listener.messages) == k + 1)
    assert [json.loads(payload)["value"] for payload, *_ in listener.messages] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert writer.lost == 0


def test_what_was_sent_last_arrives_before_the_connection_ends(make_broker, opened, other):
    port = make_broker().port
    listener = other(port, "u")
    writer = opened(topic="u", host="127.0.0.1", port=port, qos=1, format="text")
    until(lambda: writer.connected)
    for k in range(200):
        writer.send([float(k)], 0.0)
    writer.close()
    until(lambda: listener.messages and listener.messages[-1][0] == b"199.0")
    assert len(listener.messages) + writer.lost == 200


@pytest.mark.parametrize(
    ("limits", "stamp", "used"),
    [
        ({}, None, False),
        ({}, 0.0, False),
        ({"hold": True}, None, True),
        ({"stale_after": 60.0}, None, False),
        ({"stale_after": 60.0}, 0.0, True),
        ({"stale_after": 60.0}, 100.0, False),
        ({"stale_after": 60.0}, -3600.0, False),  # in the future
        ({"stale_after": 60.0}, 1.7e9, False),  # seconds since the start of the sender
        ({"stale_after": 60.0, "hold": True}, None, False),
    ],
)
def test_a_retained_sample_is_as_old_as_it_is(make_broker, opened, other, limits, stamp, used):
    port, box = make_broker().port, Inbox(1, Limits(**limits))
    content = {"value": 7.0} | ({} if stamp is None else {"time": time.time() - stamp})
    other(port).publish("goal", json.dumps(content), qos=1, retain=True).wait_for_publish(30.0)
    opened(box, topic="goal", host="127.0.0.1", port=port)
    until(lambda: box.received)
    assert (box.take().tolist() == [7.0]) is used
    assert box.rejected["late"] == (not used)


def test_a_retained_control_waits_for_those_who_come_later(make_broker, opened, other):
    port = make_broker().port
    writer = opened(topic="u", host="127.0.0.1", port=port, qos=1, retained=True, format="text")
    until(lambda: writer.connected)
    writer.send([3.0], 0.0)
    writer.close()
    late = other(port, "u")
    until(lambda: late.messages)
    assert late.messages[0][0] == b"3.0"
    assert late.messages[0][2]


def test_a_broker_that_stops_and_starts(make_broker, opened, other):
    broker, box = make_broker(), Inbox(1)
    reader = opened(box, topic="y", host="127.0.0.1", port=broker.port, format="text")
    writer = opened(topic="u", host="127.0.0.1", port=broker.port, format="text", qos=1)
    until(lambda: reader.connected and writer.connected)
    broker.stop()
    until(lambda: not (reader.connected or writer.connected))
    assert "has closed the connection" in reader.problem or "cannot be reached" in reader.problem
    writer.send([1.0], 0.0)
    assert writer.lost == 1
    until(lambda: "cannot be reached" in writer.problem)
    broker.start()
    until(lambda: reader.connected and writer.connected)
    assert reader.problem == ""
    client = other(broker.port, "u")
    writer.send([2.0], 0.1)
    until(lambda: client.messages)
    assert [payload for payload, *_ in client.messages] == [b"2.0"]  # not the old one
    client.publish("y", "5.0")
    until(lambda: box.received)
    assert box.take().tolist() == [5.0]


def test_a_broker_that_comes_late(opened, other):
    broker, box = SmallBroker(), Inbox(1)
    reader = opened(box, topic="y", host="127.0.0.1", port=broker.port, format="text")
    until(lambda: "cannot be reached" in reader.problem)
    broker.start()
    until(lambda: reader.connected)
    broker.stop()


def test_wires_share_a_connection(opened, other):
    broker = SmallBroker().start()
    boxes = [Inbox(1) for _ in range(4)]
    readers = [opened(box, topic=f"y{k // 2}", host="127.0.0.1", port=broker.port) for k, box in enumerate(boxes)]
    until(lambda: all(reader.connected for reader in readers))
    late = opened(Inbox(1), topic="y9", host="127.0.0.1", port=broker.port)
    until(lambda: late.connected)
    assert broker.clients == 1
    client = other(broker.port)
    client.publish("y0", "1")
    client.publish("y1", "2")
    until(lambda: all(box.received for box in boxes))
    assert [box.take().tolist() for box in boxes] == [[1.0], [1.0], [2.0], [2.0]]
    readers[0].close()
    client.publish("y0", "3")
    until(lambda: boxes[1].received == 2)
    assert boxes[0].received == 1
    writer = opened(topic="u", host="127.0.0.1", port=broker.port, safe=[0.0])
    until(lambda: writer.connected)
    assert broker.clients == 3  # a safe value has a connection of its own
    broker.stop()


PROGRAM = """
import sys, time
from bayesftc.cosim.live import MQTT
bridge = MQTT(topic="u", host="127.0.0.1", port=int(sys.argv[1]), qos=1)
bridge.safe = [-1.0]
bridge.open(None)
while not bridge.connected:
    time.sleep(0.01)
bridge.send([1.0], 0.0)
while not bridge._under_way[0].is_published():
    time.sleep(0.01)
print("sent", flush=True)
if sys.argv[2] == "close":
    bridge.close()
else:
    time.sleep(600)
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", ["kill", "close"])
def test_the_broker_publishes_the_safe_value_of_a_killed_process_only(make_broker, other, end):
    port = make_broker().port
    listener = other(port, "u")
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(port), end], stdout=subprocess.PIPE, text=True, env={**os.environ}
    )
    assert process.stdout.readline() == "sent\n"
    if end == "kill":
        process.send_signal(signal.SIGKILL)
    process.wait(60)
    process.stdout.close()
    if end == "close":
        other(port).publish("u", "end", qos=1)
    until(lambda: len(listener.messages) == 2)
    first, second = (payload for payload, *_ in listener.messages)
    assert json.loads(first) == {"time": 0.0, "value": 1.0}
    assert second == (b'{"value": -1.0}' if end == "kill" else b"end")


def test_a_connection_that_breaks_publishes_the_safe_value(opened, other):
    broker = SmallBroker().start()
    listener = other(broker.port, "u")
    writer = opened(topic="u", host="127.0.0.1", port=broker.port, safe=[-1.0, 2.0])
    until(lambda: writer.connected)
    writer._connection.client.socket().close()  # as at a kill
    until(lambda: listener.messages)
    assert json.loads(listener.messages[0][0]) == {"values": [-1.0, 2.0]}
    broker.stop()


def test_user_and_password(make_broker, opened, monkeypatch, tmp_path):
    port = make_broker(users={"car": "secret"}).port
    wrong = opened(Inbox(1), topic="y", host="127.0.0.1", port=port, user="car", password="guess")
    nobody = opened(Inbox(1), topic="y", host="127.0.0.1", port=port)
    until(lambda: wrong.problem and nobody.problem)
    assert wrong.problem == (
        f"The broker 127.0.0.1:{port} refuses the connection (not authorized). Check user, password and client_id."
    )
    monkeypatch.setenv("BROKER_PASSWORD", "secret")
    (tmp_path / "secret").write_text("secret\n")
    for way in (
        {"password_env": "BROKER_PASSWORD"},
        {"password_file": str(tmp_path / "secret")},
        {"password": "secret"},
    ):
        right = opened(Inbox(1), topic="y", host="127.0.0.1", port=port, user="car", **way)
        until(lambda right=right: right.connected)
        assert "secret" not in repr(right) or "file" in repr(right)
    assert not wrong.connected


def test_tls(make_broker, opened, certificates):
    port = make_broker(tls=certificates).port
    settings = {"topic": "y", "host": "localhost", "port": port}
    certificate, key = certificates.client
    box = Inbox(1)
    right = opened(box, **settings, ca_file=certificates.authority, certificate=certificate, key=key)
    until(lambda: right.connected)
    writer = opened(**settings, ca_file=certificates.authority, certificate=certificate, key=key)
    until(lambda: writer.connected)
    writer.send([4.0], 0.0)
    until(lambda: box.received)
    assert box.take().tolist() == [4.0]
    stranger = opened(Inbox(1), **settings, ca_file=certificates.stranger, certificate=certificate, key=key)
    until(lambda: stranger.problem)
    assert "Give the certificate of its authority as ca_file" in stranger.problem
    plain = opened(Inbox(1), **settings)
    unknown = opened(Inbox(1), **settings, ca_file=certificates.authority)
    until(lambda: plain.problem and unknown.problem)
    assert not any(each.connected for each in (stranger, plain, unknown))


def test_a_topic_that_the_broker_refuses(opened):
    broker = SmallBroker(denied=["secret/y"]).start()
    reader = opened(Inbox(1), topic="secret/y", host="127.0.0.1", port=broker.port)
    until(lambda: reader.problem)
    assert "refuses the topic 'secret/y'" in reader.problem
    assert not reader.connected
    broker.stop()


def test_a_broker_that_does_not_acknowledge_gets_no_old_controls(opened, other):
    broker = SmallBroker().start()
    broker.acknowledges = False
    listener = other(broker.port, "u")
    writer = opened(topic="u", host="127.0.0.1", port=broker.port, qos=1, format="text")
    until(lambda: writer.connected)
    for k in range(100):
        writer.send([float(k)], 0.0)
    until(lambda: len(listener.messages) == WINDOW)
    assert writer.lost == 100 - WINDOW
    broker.stop()
    until(lambda: not writer.connected)
    broker.acknowledges = True
    broker.start()
    until(lambda: writer.connected)
    listener = other(broker.port, "u")
    writer.send([100.0], 1.0)
    until(lambda: listener.messages)
    assert [payload for payload, *_ in listener.messages] == [b"100.0"]
    assert writer.lost == 100


def test_a_server_that_is_no_broker(opened, monkeypatch):
    monkeypatch.setattr(connections, "ANSWER", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        reader = opened(Inbox(1), topic="y", host="127.0.0.1", port=silent.getsockname()[1])
        until(lambda: "does not answer" in reader.problem)
        reader.close()


def test_messages_that_are_no_samples(opened, other):
    broker, box = SmallBroker().start(), Inbox(1)
    reader = opened(box, topic="y", host="127.0.0.1", port=broker.port)
    until(lambda: reader.connected)
    client = other(broker.port)
    for payload in (b"", b"warm", b"{}", b"[1, 2]", b"\xff" * 1000, b"NaN"):
        client.publish("y", payload)
    client.publish("y", "7")
    until(lambda: box.received == 7)
    assert box.take().tolist() == [7.0]
    broker.stop()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"topic": ""}, "A wire needs one topic"),
        ({"topic": "car/+/speed"}, "without the wildcards"),
        ({"topic": "car/#"}, "Make a wire for each one"),
        ({"topic": "y", "host": ""}, "empty host"),
        ({"topic": "y", "port": 0}, "from 1 to 65535"),
        ({"topic": "y", "qos": 3}, "it must be 0, 1 or 2"),
        ({"topic": "y", "keepalive": 0}, "whole number of seconds"),
        ({"topic": "y", "key": "k.pem"}, "a key without a certificate"),
        ({"topic": "y", "password": "x"}, "a password without a user"),
        ({"topic": "y", "user": "a", "password": "x", "password_env": "X"}, "more than one password"),
    ],
)
def test_wrong_settings_are_refused(settings, sentence):
    with pytest.raises(ModelError, match=sentence):
        MQTT(**settings)


def test_settings_that_cannot_be_read_are_refused_at_the_opening(tmp_path, certificates):
    empty = tmp_path / "empty"
    empty.touch()
    for settings, sentence in (
        ({"user": "a", "password_env": "NO_SUCH_VARIABLE"}, "NO_SUCH_VARIABLE, which is not set"),
        ({"user": "a", "password_file": str(tmp_path / "no")}, "cannot be read"),
        ({"user": "a", "password_file": str(empty)}, "its first line is empty"),
        ({"ca_file": str(tmp_path / "no")}, "ca_file"),
        ({"ca_file": str(empty)}, "must be PEM files"),
        ({"certificate": certificates.client[0], "key": certificates.server[1]}, "the private key of the certificate"),
    ):
        with pytest.raises(ModelError, match=sentence):
            MQTT(topic="y", **settings).open(Inbox(1))
    bridge = MQTT(topic="u", format="stamped doubles")
    bridge.safe = [0.0]
    with pytest.raises(ModelError, match="which has no time stamp"):
        bridge.open(None)
    assert not connections._CONNECTIONS


def test_two_connections_need_two_names(opened):
    broker = SmallBroker().start()
    opened(Inbox(1), topic="y", host="127.0.0.1", port=broker.port, client_id="car")
    opened(Inbox(1), topic="z", host="127.0.0.1", port=broker.port, client_id="car")
    bridge = MQTT(topic="u", host="127.0.0.1", port=broker.port, client_id="car")
    bridge.safe = [0.0]
    with pytest.raises(ModelError, match="Give each its own client_id"):
        bridge.open(None)
    broker.stop()


def test_without_the_package_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    with pytest.raises(BayesFTCError, match=r"MQTT needs the package paho.*pip install 'bayesftc\[live\]'"):
        MQTT(topic="y").open(Inbox(1))
    assert not connections._CONNECTIONS


def test_closing_twice_and_before_opening_is_allowed():
    bridge = MQTT(topic="u", host="127.0.0.1", port=9)
    bridge.close()
    bridge.send([1.0], 0.0)
    assert bridge.lost == 1
    bridge.open(None)
    bridge.close()
    bridge.close()
    assert not np.isfinite(Inbox(1).take()).any()
