"""``bayesftc live --serve``: a live run between wires on the page, which is only shown."""

import csv
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from browser import Page, axe, open_browser, violations
from served import Viewer, get, read_address

from bayesftc.console.desk.live import LiveLane, LiveRun
from bayesftc.console.shown.broadcast import Broadcast, Cursor
from bayesftc.console.shown.live import view_of_live
from bayesftc.cosim import live
from bayesftc.scenario import find_scenario
from bayesftc.scenario.live import live_controller

ENDS = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 0, signal.SIGINT: 0}


def test_rows_alarms_and_wires_are_shown():
    controller = live_controller("live_car", ["controller.y[0]", "controller.y[1]"])
    noise = np.random.default_rng(1).normal(size=(200, 2))
    with controller.stepper() as stepper:
        stepper.prepare()
        run = LiveRun(
            "live_car", LiveLane(controller, stepper), {"speed": live.Wire(live.UDP(port=0), to="controller.y")}
        )
        speed, inputs = 20.0, []
        for k in range(200):
            samples = speed + noise[k]
            if k >= 100:
                samples[1] += 15.0
            outputs = stepper.advance(samples)
            speed += 2e-4 * outputs[list(stepper.output_names).index("controller.u[0]")] - 1e-3 * speed
            run.feed(stepper.time, samples, outputs)
            inputs.append(samples)
        view = run.view = view_of_live(run)
        frame = Broadcast(run).frame(view, Cursor())
        rows = run.lane.rows
        assert (rows.first, rows.last) == (1, 200)
        assert np.array_equal(rows.values[:, :2], np.array(inputs))
        assert rows.newest[run.lane.place["controller.fault_probability[1]"]] > 0.9
        assert b"correcting sensor 1 by" in frame
        assert b"ensor 0 " not in frame.replace(b"using sensor 0", b"")
        assert [each["device"] for s in view.layout["strips"][:1] for each in s["series"] if "device" in each] == [
            "sensor:0", "sensor:1",
        ]  # fmt: skip
        assert run.wires()[0]["signals"] == "controller.y"
        assert view.layout["units"]["controller.y[0]"] == "m/s"
        words = [event.words for event in run.events.all()]
        assert words[0] == "sensor 1: alarm"
        assert 2.0 < run.events.all()[0].time < 2.5


def test_missing_samples_are_counted_by_wire_and_reason():
    """The numbers of the page are those of the summary, which the terminal prints."""
    controller = live_controller("live_car", ["controller.y[0]", "controller.y[1]"])
    wires = {
        f"speed{i}": live.Wire(live.UDP(port=0), to=f"controller.y[{i}]", low=0.0, high=60.0, stale_after=0.06)
        for i in range(2)
    }
    wires["force"] = live.Wire(live.UDP(port=free_port()), source="controller.u", safe=0.0)
    with controller.stepper() as stepper:
        stepper.prepare()
        run, stop = LiveRun("live_car", LiveLane(controller, stepper), wires), live.Stop()
        assert "missing" not in run.wires()[0]
        inboxes = {}

        def opened(incoming, folder):
            run.opened(incoming, folder)
            inboxes.update((each.name, each.inbox) for each in incoming if each.wire.is_input)
            assert folder is None

        def watch(time, inputs, outputs):
            run.feed(time, inputs, outputs)
            k = round(time / 0.02)
            if k == 20:
                stop.request("Enough.")
            inboxes["speed0"].put([20.0, np.nan, 200.0, 20.0][k % 4], sequence=0 if k % 4 == 3 else k)

        summary = live.run_live(stepper, wires, live.LiveSettings(watcher=watch, opened=opened), stop)
    first, second, force = run.wires()
    for shown, printed in ((first, summary.wires_in["speed0"]), (second, summary.wires_in["speed1"])):
        for name in ("missing", "missing_share", "rejected"):
            assert shown[name] == printed[name]
    assert first["missing"] == {"not a number": 5, "out of range": 5, "out of order": 5, "no message": 1}
    assert second["missing"] == {"no message": summary.steps}
    assert second["missing_share"] == 1.0
    assert (force["sent"], force["lost"]) == (summary.steps, 0)


def free_port():
    """Return the first of six UDP ports that are free."""
    for port in range(20_000 + os.getpid() % 10_000, 60_000, 7):
        with suppress(OSError):
            for each in range(port, port + 6):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("127.0.0.1", each))
            return port
    raise AssertionError("no port is free")


@contextmanager
def car(port, freeze):
    """Run the car of the example in another process; end it without a farewell."""
    command = [sys.executable, "-m", "bayesftc.examples.live_car.car", "--port", str(port), "--freeze", str(freeze)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "The car drives.\n"
        yield
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


class Cable:
    """Forwards the samples of the two sensors, unless it is cut."""

    def __init__(self, port):
        self.is_cut, self.over = False, threading.Event()
        self.threads = [threading.Thread(target=self.forward, args=(port + i, port + 4 + i)) for i in range(2)]

    def forward(self, source, target):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as cable:
            cable.bind(("127.0.0.1", source))
            cable.settimeout(0.1)
            while not self.over.is_set():
                with suppress(TimeoutError, ConnectionError):
                    packet = cable.recv(100)
                    if not self.is_cut:
                        cable.sendto(packet, ("127.0.0.1", target))

    def __enter__(self):
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *error):
        self.over.set()
        for thread in self.threads:
            thread.join()


def wires_file(folder, port):
    """Write the wires of the example with other ports: the samples come through the cable."""
    text = find_scenario("car_by_udp", "wires").read_text()
    for i, other in enumerate((port + 4, port + 5, port + 2, port + 3)):
        text = text.replace(f"port = {47000 + i}\n", f"port = {other}\n")
    file = folder / "wires.toml"
    file.write_text(f"{text}\n[recording]\nseconds = 0.5\n")
    return file


class LiveProcess:
    """``bayesftc live --serve`` in a group of processes of its own."""

    def __init__(self, folder, port):
        command = [sys.executable, "-m", "bayesftc", "live", "live_car", "--bridge", str(wires_file(folder, port))]
        command += ["--record", str(folder / "recording"), "--serve", "--port", "0", "-q"]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        self.address = read_address(self.process)

    def end(self, how):
        """Send a signal; return the exit status, all that was printed, and whether a process is left."""
        self.process.send_signal(how)
        printed = self.process.communicate(timeout=10)[1]
        try:
            os.killpg(self.process.pid, 0)
        except ProcessLookupError:
            return self.process.returncode, printed, False
        return self.process.returncode, printed, True

    def close(self):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stderr.close()


def has_samples(viewer):
    return np.isfinite(viewer.column("controller.y[0]")[-20:]).any()


def drive(viewer, cable):
    """Let the car drive, cut its wires for a second, and wait for its fault; return the time of the cut."""
    viewer.until(lambda: viewer.header["t"] > 1.0 and has_samples(viewer))
    cable.is_cut = True
    cut = viewer.header["t"]
    viewer.until(lambda: viewer.header["t"] > cut + 1.0)
    assert not has_samples(viewer)
    cable.is_cut = False
    viewer.until(lambda: has_samples(viewer))
    viewer.until(lambda: viewer.header["cards"][0]["kind"] == "frozen")
    return cut


def refused(viewer, **command):
    return viewer.ask(**command)["sentence"] == "A live run is only shown: it has no controls."


@pytest.mark.slow
@pytest.mark.parametrize("how", ENDS, ids=lambda how: how.name)
def test_wires_are_cut_and_restored_and_the_run_is_killed(tmp_path, how):
    port = free_port()
    run = LiveProcess(tmp_path, port)
    try:
        with car(port, freeze=4.0), Cable(port) as cable, Viewer(run.address) as viewer:
            cut = drive(viewer.ready(), cable)
            assert viewer.layout["only_shown"]
            assert all(wire["connected"] for wire in viewer.header["wires"])
            assert refused(viewer, do="run", on=False)
            assert refused(viewer, do="claim")
            assert refused(viewer, do="fault", target="sensors", settings={"kind": "Freeze"})
            assert viewer.ask(do="show", columns=["controller.beta[0]"])["type"] == "done"
            events = [*csv.DictReader(get(run.address, "/download/events.csv")[2].decode().splitlines())]
            assert "sensor 0: alarm" in [each["event"] for each in events]
            assert get(run.address, "/download/signals.csv")[0] == 404
            reached = viewer.header["t"]
            status, printed, is_left = run.end(how)
        assert (status, is_left) == (ENDS[how], False), printed
        assert "Traceback" not in printed
    finally:
        run.close()
    recorded = live.read_recording(tmp_path / "recording")
    assert recorded.time[-1] >= reached - (1.5 if how == signal.SIGKILL else 0.0)  # but for the last piece
    assert np.isnan(recorded["controller.y"][int((cut + 0.5) * 50)]).all()
    again = LiveProcess(tmp_path, port)
    try:
        with car(port, freeze=60.0), Cable(port), Viewer(again.address) as viewer:
            viewer.ready().until(lambda: has_samples(viewer))
        status, printed, is_left = again.end(signal.SIGTERM)
        assert (status, is_left) == (0, False), printed
    finally:
        again.close()
    assert live.read_recording(tmp_path / "recording").time[-1] > 0.0


@pytest.mark.slow
def test_the_page_only_shows(tmp_path, tmp_path_factory):
    text, port = axe(tmp_path_factory), free_port()
    browser, run = open_browser(tmp_path), LiveProcess(tmp_path, port)
    try:
        with car(port, freeze=3.0), Cable(port):
            page = Page(browser, run.address, status="A live run")
            page.until(lambda: "frozen" in page.text("[aria-label='sensor 0'] .words"))
            spans = [each.text for each in page.all("#wire-list li:first-child span")]
            assert spans == ["speed0: to controller.y[0]", "connected"]
            shown = page.text("#wire-list li:first-child .numbers")
            assert re.fullmatch(r"\d+ messages, \d+\.\d % of the samples missing: .*no message \d+.*", shown)
            assert re.fullmatch(r"\d+ sent, 0 lost, \d+ safe values", page.text("#wire-list li:last-child .numbers"))
            shown = [each.text for each in page.all("button, .links a") if each.is_displayed()]
            assert shown == ["Events of this session (CSV)"]
            for width, dark in ((1280, False), (390, True)):
                page.look(width, dark=dark)
                assert violations(browser, text) == []
                inner, outer = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
                assert inner <= outer
            assert [e["message"] for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.quit()
        run.close()
