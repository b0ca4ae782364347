"""``bayesftc live --serve``: a live run between wires on the page, which is only shown."""

import csv
import re
import signal
import socket
import struct

import numpy as np
import pytest
from browser import Page, axe, open_browser, violations
from served import Viewer, get
from wired import Cable, LiveProcess, car, free_port

from bayesftc.console.desk.live import LiveRun, controller_lane
from bayesftc.console.shown.broadcast import Broadcast, Cursor
from bayesftc.console.shown.live import view_of_live
from bayesftc.cosim import live
from bayesftc.cosim.errors import UnknownNameError
from bayesftc.scenario.live import live_controller

ENDS = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 0, signal.SIGINT: 0}


def test_rows_alarms_and_wires_are_shown():
    controller = live_controller("live_car", ["controller.y[0]", "controller.y[1]"])
    noise = np.random.default_rng(1).normal(size=(200, 2))
    with controller.stepper() as stepper:
        stepper.prepare()
        run = LiveRun(
            "live_car", controller_lane(controller, stepper), {"speed": live.Wire(live.UDP(port=0), to="controller.y")}
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
        run, stop = LiveRun("live_car", controller_lane(controller, stepper), wires), live.Stop()
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


def test_samples_of_a_wire_are_dropped_by_hand():
    """Over real UDP: they are counted by reason, and the action is in the log."""
    controller = live_controller("live_car", ["controller.y[0]", "controller.y[1]"])
    wires = {f"speed{i}": live.Wire(live.UDP(port=0), to=f"controller.y[{i}]") for i in range(2)}
    wires["force"] = live.Wire(live.UDP(port=free_port()), source="controller.u", safe=0.0)
    with controller.stepper() as stepper, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        stepper.prepare()
        run, stop = LiveRun("live_car", controller_lane(controller, stepper), wires, drops=True), live.Stop()
        with pytest.raises(UnknownNameError, match=r"No open wire 'speed0' brings samples"):
            run.drop("speed0", 1.0)

        def watch(time, inputs, outputs):
            run.feed(time, inputs, outputs)
            k = round(time / 0.02)
            if k == 20:
                run.drop("speed0", 0.5)
            if k > 20 and not run.wires()[0]["dropping"] and np.isfinite(inputs[0]):  # samples are used again
                stop.request("Enough.")
            for i in range(2):
                sender.sendto(struct.pack("<d", 20.0), ("127.0.0.1", wires[f"speed{i}"].bridge.port_number))

        summary = live.run_live(stepper, wires, live.LiveSettings(watcher=watch, opened=run.opened), stop)
    dropped = [summary.wires_in[f"speed{i}"]["missing"].get("dropped by hand", 0) for i in range(2)]
    assert 0 < dropped[0] < summary.steps - 20
    assert dropped[1] == 0
    first = run.wires()[0]
    assert first["missing"]["dropped by hand"] == dropped[0]
    assert first["rejected"]["dropped by hand"] >= dropped[0]
    assert first["dropping"] == 0.0
    words = "drop the samples of speed0 for 0.5 s"
    assert run.actions() == [{"t": 0.4, "words": words}]
    assert ("action", words) in [(each.what, each.words) for each in run.events.all()]
    for wrong, sentence in (("force", "brings samples"), ("sped0", "did you mean 'speed0'")):
        with pytest.raises(UnknownNameError, match=sentence):
            run.drop(wrong, 1.0)


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
            assert get(run.address, "/download/figure.png")[0] == 404
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
def test_only_the_operator_drops_samples_and_only_with_drops(tmp_path):
    port = free_port()
    run = LiveProcess(tmp_path, port, "--drops")
    try:
        with car(port, freeze=60.0), Cable(port), Viewer(run.address) as viewer, Viewer(run.address) as second:
            viewer.ready().claim()
            viewer.until(lambda: has_samples(viewer))
            second.ready()
            drop = {"do": "drop", "wire": "speed0", "seconds": 1.0}
            assert second.ask(**drop)["sentence"] == "This page only watches: another one has the controls."
            assert second.ask(do="claim")["sentence"] == "Another page has the controls. Close it first."
            for wrong in ({"wire": "speed9"}, {"wire": "force"}, {"seconds": -1.0}, {"seconds": 1e4}, {"seconds": "1"}):
                assert viewer.ask(**{**drop, **wrong})["type"] == "error"
            for do in ("run", "fault", "goal", "step"):
                assert viewer.ask(do=do)["type"] == "error"
            assert viewer.do(**drop)
            viewer.until(lambda: not has_samples(viewer))
            assert 0.0 < viewer.header["wires"][0]["dropping"] <= 1.0
            viewer.until(lambda: has_samples(viewer))
            assert viewer.header["wires"][0]["missing"]["dropped by hand"] > 20
            assert "dropped by hand" not in viewer.header["wires"][1]["missing"]
            assert [each["words"] for each in viewer.header["actions"]] == ["drop the samples of speed0 for 1 s"]
            events = [*csv.DictReader(get(run.address, "/download/events.csv")[2].decode().splitlines())]
            assert ["action", "drop the samples of speed0 for 1 s"] in [[e["what"], e["event"]] for e in events]
            status, printed, is_left = run.end(signal.SIGTERM)
        assert (status, is_left) == (0, False), printed
    finally:
        run.close()


@pytest.mark.slow
def test_samples_are_dropped_on_the_page(tmp_path, tmp_path_factory):
    text, port = axe(tmp_path_factory), free_port()
    browser, run = open_browser(tmp_path), LiveProcess(tmp_path, port, "--drops")
    try:
        with car(port, freeze=60.0), Cable(port):
            page = Page(browser, run.address)
            page.set("#wire-list li:first-child input", "0.5")
            page.click("[aria-label='Drop samples of speed0']")
            page.until(lambda: "dropped by hand" in page.text("#wire-list li:first-child .numbers"))
            page.until(lambda: "by hand: drop the samples of speed0 for 0.5 s" in page.text("#log"))
            assert not page.all("#wire-list li:last-child form")
            assert "start the run with --record DIR" in page.text("#recorded")
            shown = [each.text for each in page.all("button, .links a") if each.is_displayed()]
            assert shown == ["drop samples", "drop samples", "Events of this session (CSV)"]
            for width, dark in ((1280, False), (1280, True), (390, False), (390, True)):
                page.look(width, dark=dark)
                assert violations(browser, text) == []
                inner, outer = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
                assert inner <= outer
            assert [e["message"] for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.quit()
        run.close()


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
            assert shown == ["Signals (CSV)", "Signals (Parquet)", "Events of this session (CSV)"]
            for width, dark in ((1280, False), (390, True)):
                page.look(width, dark=dark)
                assert violations(browser, text) == []
                inner, outer = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
                assert inner <= outer
            assert [e["message"] for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.quit()
        run.close()
