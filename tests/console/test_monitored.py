"""``bayesftc monitor --live --serve``: a live monitor on the page."""

import csv
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from browser import Page, axe, open_browser, violations
from served import Viewer, get, read_address, until

from bayesftc import monitoring
from bayesftc.console.desk.live import LiveRun
from bayesftc.console.desk.monitored import monitor_lane
from bayesftc.console.shown.broadcast import Broadcast, Cursor
from bayesftc.console.shown.live import view_of_live

MODEL = """
dt = 0.02
[model]
kind = "RandomWalk"
std = 0.1
[sensors]
left = { std = 0.1, resolution = 0.0, unit = "m" }
middle = { std = 0.1, resolution = 0.0, unit = "m" }
right = { std = 0.1, resolution = 0.0, unit = "m" }
"""
NAMES = ("left", "middle", "right")


def test_what_the_monitor_infers_is_shown():
    sensors = {name: monitoring.Sensor(std=0.1, resolution=0.0, unit="m") for name in NAMES}
    monitor = monitoring.Monitor(0.02, monitoring.RandomWalk(std=0.1), sensors)
    stepper = monitoring.MonitorStepper(monitor)
    stepper.prepare()
    run = LiveRun("tank", monitor_lane(monitor, stepper), {})
    view, noise = view_of_live(run), np.random.default_rng(0).normal(size=(300, 3))
    words = []
    for k in range(300):
        samples = 5.0 + 0.1 * noise[k] + [0.0, 2.0 * (k >= 150), 0.0]
        run.feed(0.02 * k, samples, stepper.advance(samples))
        frame = Broadcast(run).frame(view, Cursor())
        words.append((b"nothing is inferred yet" in frame, b"ignoring middle since" in frame))
    began = [early for early, _ in words].index(False)
    assert began == round(stepper.began / 0.02) + 8
    assert not any(late for _, late in words[:150])
    assert words[-1] == (False, True)
    assert [event.words for event in run.events.all()] == ["middle: alarm"]
    (quantity, chances) = view.layout["strips"]
    assert (quantity["title"], quantity["unit"]) == ("measured quantity", "m")
    assert [each["label"] for each in quantity["series"]] == [*NAMES, "belief"]
    assert [each["column"] for each in chances["series"]] == [f"monitor.fault_probability[{i}]" for i in range(3)]
    assert [each["name"] for each in view.layout["devices"]] == [*NAMES]


def test_sensors_of_other_states_are_other_quantities():
    sensors = {
        "position": monitoring.Sensor(std=0.1, unit="m"),
        "speed": monitoring.Sensor(std=0.1, reads=(0.0, 1.0), unit="m/s"),
        "tape": monitoring.Sensor(std=0.1, unit="m"),
    }
    errors = (monitoring.SensorErrors(std=0.1, time_constant=10.0),)
    monitor = monitoring.Monitor(0.1, monitoring.ConstantRate(std=0.1), sensors, errors=errors)
    stepper = monitoring.MonitorStepper(monitor)
    stepper.prepare()
    first, second = monitor_lane(monitor, stepper).roles.quantities
    assert (first.name, first.unit, first.sensors) == ("position, tape", "m", (0, 2))
    assert (second.name, second.unit, second.sensors) == ("speed", "m/s", (1,))
    assert second.belief == (0.0, 1.0, *(0.0,) * monitor.model.disturbances)


class Sensors:
    """Sends samples by UDP from a thread, until the end."""

    def __init__(self, ports):
        self.is_faulty, self.over = False, threading.Event()
        self.thread = threading.Thread(target=self.send, args=(ports,))

    def send(self, ports):
        rng, began, k = np.random.default_rng(0), time.monotonic(), 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self.over.wait(max(began + 0.02 * k - time.monotonic(), 0.0)):
                k += 1
                for port, error in zip(ports, (0.0, 2.0 * self.is_faulty, 0.0), strict=True):
                    value = 5.0 + error + 0.1 * rng.standard_normal()
                    sender.sendto(struct.pack("<d", value), ("127.0.0.1", port))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.over.set()
        self.thread.join()


@contextmanager
def monitored(folder):
    """Yield the process, the address of its page, and the sensors."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in NAMES]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    (folder / "tank.toml").write_text(MODEL)
    tables = [f'[bridge.{n}]\nkind = "UDP"\nport = {p}\nto = "{n}"\n' for n, p in zip(NAMES, ports, strict=True)]
    (folder / "wires.toml").write_text("\n".join([*tables, "[recording]\nseconds = 0.5\n"]))
    command = [sys.executable, "-m", "bayesftc", "monitor", "--model", str(folder / "tank.toml")]
    command += ["--live", str(folder / "wires.toml"), "--record", str(folder / "runs"), "--serve", "--drops"]
    process = subprocess.Popen([*command, "--port", "0", "-q"], stderr=subprocess.PIPE, text=True)
    try:
        address = read_address(process)
        with Sensors(ports) as sensors:
            yield process, address, sensors
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_monitor_is_served(tmp_path):
    with monitored(tmp_path) as (process, address, sensors), Viewer(address) as viewer:
        viewer.ready().claim()
        viewer.until(lambda: viewer.header["cards"] and viewer.header["cards"][0]["state"] == "healthy")
        sensors.is_faulty = True
        viewer.until(lambda: viewer.header["cards"][1]["state"] == "faulty" and viewer.header["cards"][1]["kind"])
        assert "middle" in viewer.header["cards"][1]["words"]
        sensors.is_faulty = False
        viewer.until(lambda: viewer.header["cards"][1]["state"] == "healthy")
        viewer.do(do="drop", wire="left", seconds=0.5)
        viewer.until(lambda: viewer.header["wires"][0]["missing"].get("dropped by hand", 0) > 5)
        until(lambda: get(address, "/download/signals.csv")[0] == 200)
        rows = [*csv.DictReader(get(address, "/download/signals.csv")[2].decode().splitlines())]
        assert float(rows[-1]["right"]) == pytest.approx(5.0, abs=1.0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


@pytest.mark.slow
def test_the_page_of_a_monitor(tmp_path, tmp_path_factory):
    text, browser = axe(tmp_path_factory), open_browser(tmp_path)
    try:
        with monitored(tmp_path) as (_, address, sensors):
            page = Page(browser, address)
            sensors.is_faulty = True
            page.until(lambda: "middle: alarm" in page.text("#log"))
            page.until(lambda: page.all("[aria-label='middle'].faulty"))
            assert not page.one("#loop").is_displayed()
            assert page.text("#strips h3") == "measured quantity in m"
            for width, dark in ((1280, False), (1280, True), (390, False), (390, True)):
                page.look(width, dark=dark)
                assert violations(browser, text) == []
                inner, outer = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
                assert inner <= outer
            assert [e["message"] for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.quit()
