"""Every kind of bridge as source and as sink: of a session, of a controller alone, and of a monitor."""

import os
import socket
import threading
import time
from contextlib import ExitStack, contextmanager
from select import select

import numpy as np
import pytest
from brokers import SmallBroker

from bayesftc import controllers, monitoring
from bayesftc.cosim import live
from bayesftc.scenario.live import live_controller

VALUE = 20.0


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def a_session(stack):
    return (
        stack.enter_context(live_controller("live_car", ["controller.y"]).stepper()),
        "controller.y",
        "controller.x_hat",
    )


def a_controller(stack):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, dt=0.02)
    controller = controllers.BayesianController(model, initial_mean=VALUE, u_min=-4000.0, u_max=4000.0)
    return controller.online(), "y", "x_hat"


def a_monitor(stack):
    sensors = {name: monitoring.Sensor(std=1.0, resolution=0.0) for name in "ab"}
    return (
        monitoring.MonitorStepper(monitoring.Monitor(0.02, monitoring.RandomWalk(std=0.1), sensors)),
        ["a", "b"],
        "x_hat",
    )


@contextmanager
def udp(folder):
    ports = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    yield [(live.UDP(port), live.UDP(port)) for port in ports]


@contextmanager
def json_udp(folder):
    ports = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    yield [(live.UDP(port, format="json"), live.UDP(port, format="json")) for port in ports]


@contextmanager
def mqtt(folder):
    pytest.importorskip("paho.mqtt")
    broker = SmallBroker(folder).start()
    where = {"host": "127.0.0.1", "port": broker.port}
    try:
        yield [(live.MQTT(topic, **where), live.MQTT(topic, **where)) for topic in ("to", "from")]
    finally:
        broker.stop()


@contextmanager
def opcua(folder):
    """Our server has both nodes; the other side is our client."""
    pytest.importorskip("asyncua")
    url = f"opc.tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    server = [live.OPCUAServer(node, url=url) for node in ("to", "from")]
    client = [live.OPCUA(url, f"nsu=urn:bayesftc:live;s={node}", period=0.01) for node in ("to", "from")]
    yield [(client[0], server[0]), (server[1], client[1])]


@contextmanager
def opcua_client(folder):
    """The other side is our server; the client is the bridge of the run."""
    with opcua(folder) as ((client, server), (source, sink)):
        yield [(server, client), (sink, source)]


@contextmanager
def serial(folder):
    pytest.importorskip("serial")
    pairs = [os.openpty() for _ in range(2)]
    names = [os.ttyname(port) for _, port in pairs]
    yield [(Wired(pairs[0][0]), live.Serial(names[0])), (live.Serial(names[1]), Wired(pairs[1][0]))]
    for descriptor in sum(pairs, ()):
        os.close(descriptor)


@contextmanager
def file(folder):
    paths = [str(folder / f"{name}.csv") for name in ("to", "from")]
    yield [
        (live.File(paths[0], columns=["a", "b"]), live.File(paths[0], columns=["a", "b"], poll=0.005)),
        (live.File(paths[1], columns=["x"]), live.File(paths[1], columns=["x"], poll=0.005)),
    ]


class Wired(live.Bridge):
    """The device at the other end of a serial line."""

    def __init__(self, descriptor):
        self.descriptor, self.inbox = descriptor, None

    def open(self, inbox):
        self.inbox, self.connected = inbox, True
        if inbox is not None:
            self.thread = threading.Thread(target=self._read, daemon=True)
            self.thread.start()

    def _read(self):
        rest = b""
        while self.connected:
            if not select([self.descriptor], [], [], 0.05)[0]:
                continue
            *lines, rest = (rest + os.read(self.descriptor, 4096)).split(b"\n")
            for line in lines:
                self.inbox.receive(line.strip(), "text")

    def send(self, values, time):
        os.write(self.descriptor, (" ".join(map(repr, values)) + "\n").encode())

    def close(self):
        self.connected = False
        if self.inbox is not None:
            self.thread.join()


class Sender:
    """Sends two samples every 20 ms, until the end."""

    def __init__(self, bridge):
        self.bridge, self.ends, self.sent = bridge, threading.Event(), set()
        self.thread = threading.Thread(target=self._run)

    def __enter__(self):
        self.bridge.open(None)
        self.thread.start()
        return self

    def _run(self):
        k, noise = 0, np.random.default_rng(0)
        while not self.ends.wait(0.02):
            samples = (VALUE + noise.standard_normal(2)).tolist()
            self.sent.update(samples)
            self.bridge.send(samples, 0.02 * k)
            k += 1

    def __exit__(self, *error):
        self.ends.set()
        self.thread.join()
        self.bridge.close()


KINDS = [udp, json_udp, mqtt, serial, file, *(pytest.param(k, marks=pytest.mark.slow) for k in (opcua, opcua_client))]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("target", [a_session, a_controller, a_monitor])
@pytest.mark.parametrize("kind", KINDS)
def test_samples_come_in_and_the_belief_goes_out(tmp_path, kind, target):
    with ExitStack() as stack:
        runs, to, source = target(stack)
        if isinstance(runs, live.Stepper):
            runs.prepare()
        (outside, into), (out, receiver) = stack.enter_context(kind(tmp_path))
        box, stop, got = live.Inbox(1), live.Stop(), []
        took, made = set(), set()
        wires = {"in": live.Wire(into, to=to), "out": live.Wire(out, source=source)}
        if target is a_controller:
            wires["goal"] = live.Wire(live.UDP(0), to="goal", start=VALUE)
        end = time.monotonic() + 60.0

        def watch(now, inputs, outputs):
            took.update(inputs[np.isfinite(inputs)])
            made.update(outputs)
            got.extend(value for value in box.take() if np.isfinite(value))
            if (len(got) > 5 and len(took & sender.sent) > 5) or time.monotonic() > end:
                stop.request("enough")

        # Our own server opens before its client, which would wait for its next attempt otherwise.
        receiver.open(box)
        stack.callback(receiver.close)
        sender = stack.enter_context(Sender(outside))
        summary = live.run_live(runs, wires, live.LiveSettings(watcher=watch), stop)
    assert len(got) > 5
    assert len(took & sender.sent) > 5
    assert took <= sender.sent | {VALUE}  # the goal of a controller alone
    assert set(got) <= made
    assert summary.wires_in["in"]["received"] > 2  # messages of two samples
    rejected = summary.wires_in["in"]["rejected"]
    assert rejected in ({}, {"late": 1})  # the first value of an OPC UA node may be old
    assert summary.wires_out["out"]["sent"] > 5
