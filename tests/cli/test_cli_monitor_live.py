"""``bayesftc monitor --live``: samples by real UDP and MQTT, alarms as they begin and end, and the end by a signal."""

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from brokers import NO_MOSQUITTO, Mosquitto, SmallBroker, until
from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.cli.commands.recordings._monitor_live import _Watcher
from bayesftc.cli.live_report import Alarms
from bayesftc.cosim import live
from bayesftc.monitoring import Monitor, MonitorStepper, RandomWalk, Sensor

MODEL = """
dt = 0.02
[model]
kind = "RandomWalk"
std = 0.1
[sensors]
a = { std = 0.1, resolution = 0.0, unit = "m" }
b = { std = 0.1, resolution = 0.0, unit = "m" }
c = { std = 0.1, resolution = 0.0, unit = "m" }
"""


def wire(name, port, **more):
    keys = {"kind": "UDP", "port": port, "to": name, **more}
    return f"[bridge.{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items())


def free_ports():
    """Return three ports that no other program listens at."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "abc"]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def feed(bridges, samples_of, ended):
    """Send the samples of each step until the end, at the rate of the model."""
    began, k = time.monotonic(), 0
    while not ended.wait(max(began + 0.02 * k - time.monotonic(), 0.0)):
        for bridge, value in zip(bridges, samples_of(k), strict=True):
            bridge.send([float(value)], 0.02 * k)
        k += 1


@pytest.fixture
def sent():
    """Start a thread that sends samples by bridges."""
    ended, threads, opened = threading.Event(), [], []

    def start(bridges, samples_of):
        for bridge in bridges:
            bridge.open(None)
            opened.append(bridge)
        threads.append(threading.Thread(target=feed, args=(bridges, samples_of, ended)))
        threads[-1].start()

    yield start
    ended.set()
    for thread in threads:
        thread.join()
    for bridge in opened:
        bridge.close()


def level(fault=lambda k: False):
    rng = np.random.default_rng(0)

    def samples(k):
        values = 5.0 + 0.1 * rng.standard_normal(3)
        values[1] += 2.0 * fault(k)
        return values

    return samples


@pytest.fixture
def started(tmp_path):
    processes = []

    def start(*options):
        command = [sys.executable, "-m", "bayesftc", "monitor", "--model", str(tmp_path / "model.toml"), *options]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()


class Lines:
    """The lines of a stream, as they come."""

    def __init__(self, stream):
        self.lines = []
        self._thread = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def _read(self, stream):
        for line in stream:
            self.lines.append(line.rstrip())


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_alarm_by_udp_and_the_end_by_a_signal(tmp_path, started, sent, number):
    ports = free_ports()
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "wires.toml").write_text("".join(map(wire, "abc", ports)))
    faulty = threading.Event()
    sent([live.UDP(port) for port in ports], level(lambda k: faulty.is_set()))
    process = started("--live", str(tmp_path / "wires.toml"), "--record", str(tmp_path / "runs"))
    seen = Lines(process.stderr)

    def said(words):
        assert process.poll() is None, seen.lines
        return any(words in line for line in seen.lines)

    until(lambda: said("s: monitoring has begun"), 120)
    faulty.set()
    until(lambda: said("s: b: alarm, fault probability"))
    time.sleep(0.5)  # the kind settles
    faulty.clear()
    until(lambda: said("s: b: the alarm has ended (since"))
    process.send_signal(number)
    assert process.wait(60) == 0
    text = process.stdout.read()
    (fault,) = (line.split() for line in text.splitlines() if line.split()[:2] == ["b", "Offset"])
    assert fault[-1] == "m"
    assert float(fault[-2]) == pytest.approx(2.0, abs=0.3)
    name = "Ctrl-C" if number == signal.SIGINT else "SIGTERM"
    assert f"The run was stopped by {name}." in text
    result = live.read_recording(tmp_path / "runs")
    assert result["fault_probability"].shape[1] == 3
    assert np.nanmax(result["fault_probability"][:, 1]) > 0.99
    assert np.nanmax(result["fault_probability"][:, 0]) < 0.9
    assert np.isfinite(result["b"]).mean() > 0.5
    assert result.units["b"] == "m"


BROKERS = [
    pytest.param(SmallBroker, id="small"),
    pytest.param(
        Mosquitto, id="mosquitto", marks=pytest.mark.skipif(NO_MOSQUITTO is not None, reason=str(NO_MOSQUITTO))
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("kind", BROKERS)
def test_samples_and_probabilities_by_mqtt(tmp_path, sent, kind):
    broker = kind(tmp_path).start()
    shown = live.Inbox(3)
    reader = live.MQTT(topic="tank/faulty", host="127.0.0.1", port=broker.port)
    try:
        reader.open(shown)
        settings = {"kind": "MQTT", "host": "127.0.0.1"}
        text = "".join(wire(name, broker.port, **settings, topic=f"tank/{name}") for name in "abc")
        text += f'[bridge.out]\nkind = "MQTT"\nhost = "127.0.0.1"\nport = {broker.port}\ntopic = "tank/faulty"\n'
        (tmp_path / "wires.toml").write_text(text + 'from = "fault_probability"\n')
        (tmp_path / "model.toml").write_text(MODEL)
        topics = [live.MQTT(topic=f"tank/{name}", host="127.0.0.1", port=broker.port) for name in "abc"]
        sent(topics, level(lambda k: True))
        arguments = ["--model", str(tmp_path / "model.toml"), "--live", str(tmp_path / "wires.toml")]
        done = CliRunner().invoke(app, ["monitor", *arguments, "--duration", "4", "--json"])
        assert done.exit_code == 0, done.output
        numbers = json.loads(done.stdout)
        until(lambda: shown.received)
        assert numbers["stopped"] == "The run has ended after 3.98 s, as requested."
        assert numbers["steps"] == 200
        assert {row["connected"] for row in numbers["wires_in"].values()} == {True}
        assert all(0.5 * 200 < row["samples"] <= 200 for row in numbers["sensors"].values())
        assert numbers["began"] is not None
    finally:
        reader.close()
        broker.stop()


def test_a_short_run_by_udp(tmp_path, sent):
    """Quick: the plain run of a second, without waiting for an alarm."""
    ports = free_ports()
    (tmp_path / "model.toml").write_text(MODEL + '[precision]\nkind = "FixedPrecision"\n')
    (tmp_path / "wires.toml").write_text("".join(map(wire, "abc", ports)))
    sent([live.UDP(port) for port in ports], level())
    arguments = ["--model", str(tmp_path / "model.toml"), "--live", str(tmp_path / "wires.toml")]
    done = CliRunner().invoke(app, ["monitor", *arguments, "--duration", "1"])
    assert done.exit_code == 0, done.output
    date = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"
    assert re.search(date + r", \d\.\d\d s: monitoring has begun", done.stderr)
    assert re.search("Time 0 is " + date, done.stdout)
    assert "There is no fault probability: FixedPrecision does not infer faults." in done.stdout


def test_a_gap_is_noted_at_its_begin_and_at_its_end(capsys):
    monitor = Monitor(0.1, RandomWalk(std=0.06), {name: Sensor(std=0.1, resolution=0.0) for name in "ab"})
    stepper = MonitorStepper(monitor, compiled=False)
    stepper.prepare()
    watcher = _Watcher(stepper, monitor, Alarms([]))
    for k in range(40):
        samples = np.full(2, np.nan if 20 <= k < 30 else 5.0 + 0.1 * (-1) ** k)
        watcher.watch(0.1 * k, samples, stepper.advance(samples))
    assert watcher.gaps == [{"start": pytest.approx(1.9), "end": pytest.approx(3.0)}]
    begin, end = capsys.readouterr().err.splitlines()[1:]
    assert "2.20 s: a gap: no sensor has sent a sample since 1.90 s" in begin
    assert "3.00 s: the gap has ended (since 1.90 s)" in end


def test_sensors_with_too_few_samples_are_named(capsys):
    sensors = {"a": Sensor(std=0.1), "b": Sensor(std=0.1, resolution=0.0), "c": Sensor(std=0.1)}
    monitor = Monitor(1.0, RandomWalk(std=0.06), sensors)
    stepper = MonitorStepper(monitor, compiled=False)
    stepper.prepare()
    watcher = _Watcher(stepper, monitor, Alarms([]))
    assert stepper.waits_for == "no sample yet of a, b, c"
    for k in range(6):
        samples = np.array([5.0, 5.0 if k % 2 else np.nan, np.nan])
        watcher.watch(1.0 * k, samples, stepper.advance(samples))
    said = capsys.readouterr().err
    assert (
        "5.00 s: monitoring has not begun; no sample yet of c; a has sent 6 of the first 30 samples; b has sent 3"
        in said
    )
    for _ in range(30):
        stepper.advance(np.full(3, 5.0))
    assert stepper.waits_for == ""


@pytest.mark.slow
def test_sensors_that_are_silent_are_named(tmp_path, sent):
    ports = free_ports()
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "wires.toml").write_text("".join(map(wire, "abc", ports)))
    sent([live.UDP(port) for port in ports[:2]], lambda k: (5.0, 5.0))
    arguments = ["--model", str(tmp_path / "model.toml"), "--live", str(tmp_path / "wires.toml")]
    done = CliRunner().invoke(app, ["monitor", *arguments, "--duration", "5.2"])
    assert done.exit_code == 0, done.output
    assert "5.00 s: monitoring has not begun; no sample yet of c" in done.stderr
    assert "Monitoring has not begun" in done.stdout
    assert "No fault was found" not in done.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--live", "wires.toml", "data.csv", "--model", "model.toml"], "--live needs --model, and no recording"),
        (["--live", "wires.toml"], "--live needs --model"),
        (["--live", "wires.toml", "--model", "model.toml", "--out", "results"], "--record keeps"),
        (["data.csv", "--model", "model.toml", "--duration", "3"], "add --live"),
        (["data.csv", "--model", "model.toml", "--serve"], "add --live"),
        (["--live", "wires.toml", "--model", "model.toml", "--drops"], "add --serve"),
        (["--model", "model.toml"], "there is no recording"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, words):
    done = CliRunner().invoke(app, ["monitor", *options])
    assert done.exit_code == 2
    assert words in " ".join(done.output.replace("│", " ").split())


def test_a_negative_duration_is_refused_before_files_are_read():
    options = ["--live", "missing.toml", "--model", "missing.toml", "--duration", "-1"]
    done = CliRunner().invoke(app, ["monitor", *options])
    assert (done.exit_code, done.output) == (8, "Error: The duration is -1.0 s; it must not be negative.\n")


def test_a_wire_to_a_sensor_that_is_not_there_is_refused(tmp_path):
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "wires.toml").write_text(wire("a", 0) + wire("b", 0) + wire("left_c", 0))
    arguments = ["--model", str(tmp_path / "model.toml"), "--live", str(tmp_path / "wires.toml")]
    done = CliRunner().invoke(app, ["monitor", *arguments])
    assert done.exit_code == 5
    assert "The wire 'left_c': There is no input 'left_c'" in " ".join(done.output.split())
    (tmp_path / "wires.toml").write_text(wire("a", 0) + wire("b", 0))
    done = CliRunner().invoke(app, ["monitor", *arguments])
    assert done.exit_code == 9
    assert "No wire sets the input 'c'" in done.output
    done = CliRunner().invoke(app, ["monitor", *arguments, "--duration", "0.013"])
    assert done.exit_code == 8
    assert done.output.startswith("Error: The duration of 0.013 s is no whole number of steps")
