"""The live run: wires in and out, safe values, the watchdog, the end by a signal, by an error and by a kill."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from dataclasses import dataclass

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim import live
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError, SimulationError, UnknownNameError
from bayesftc.cosim.live.deadlines import EDGES
from bayesftc.cosim.live.watchdog import Watchdog
from bayesftc.cosim.live.wires import Outgoing


def gain(factor=2.0, dt=0.005):
    return cosim.Gain(factor).online(dt=dt, compiled=False)


def in_thread(until, condition, *arguments):
    """Run until the condition holds; return the summary."""
    stop, results = live.Stop(), []
    thread = threading.Thread(target=lambda: results.append(live.run_live(*arguments, stop=stop)))
    thread.start()
    try:
        until(condition)
    finally:
        stop.request("enough")
        thread.join(30)
    return results[0]


def test_an_error_while_samples_are_collected_makes_them_missing(memory):
    source, sink = memory(), memory()

    def collect():
        raise OSError("the line is cut")

    source.collect = collect
    wires = {"in": live.Wire(source, to="u", start=4.0), "out": live.Wire(sink, source="y", safe=0.0)}
    summary = live.run_live(gain(), wires, live.LiveSettings(duration=0.05))
    assert summary.steps == 10
    assert summary.wires_in["in"]["problem"] == "OSError: the line is cut"
    assert summary.wires_in["in"]["missing"] == {"no message": 10}


@pytest.mark.slow
def test_old_objects_are_left_out_of_garbage_collections_until_the_last_run_ends(memory, until):
    times, frozen = {0.05: 0.02, 0.6: 0.5}, {}

    def run(seconds):
        def watcher(time, inputs, outputs):
            if time >= times[seconds] and seconds not in frozen:  # to count takes some milliseconds
                frozen[seconds] = gc.get_freeze_count() > 0

        wires = {"out": live.Wire(memory(), source="y", safe=0.0), "in": live.Wire(memory(), to="u", start=1.0)}
        live.run_live(gain(), wires, live.LiveSettings(duration=seconds, watcher=watcher))

    live.run_live(gain(), {"in": live.Wire(memory(), to="u", start=1.0)}, live.LiveSettings(duration=0.01))
    assert gc.get_freeze_count() > 0  # the tests have left out objects of their own
    gc.unfreeze()
    threads = [threading.Thread(target=run, args=(seconds,)) for seconds in (0.05, 0.6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert frozen == {0.05: True, 0.6: True}
    assert gc.get_freeze_count() == 0
    gc.freeze()


def test_samples_go_in_and_outputs_go_out(memory, until):
    source, sink = memory(), memory()
    wires = {
        "in": live.Wire(source, to="u", scale=10.0),
        "out": live.Wire(sink, source="y", safe=-1.0, scale=0.5, offset=100.0, high=120.0),
    }

    def feed():
        if source.inbox is not None:
            source.inbox.put(3.0)
        return [0.5 * 2 * 30.0 + 100.0] in [values for _, values in sink.sent] or [120.0] in [v for _, v in sink.sent]

    summary = in_thread(until, feed, gain(), wires)
    values = [values[0] for _, values in sink.sent]
    assert values[0] == -1.0  # before the first step
    assert values[-1] == -1.0  # at the end
    assert 120.0 in values  # 130, clipped
    assert summary.wires_out["out"]["clipped"] > 0
    assert summary.stopped == "enough"
    assert source.closed
    assert sink.closed


def test_no_control_is_sent_before_the_first_sample_of_a_held_input(memory):
    source, sink = memory(), memory()
    wires = {"in": live.Wire(source, to="u"), "out": live.Wire(sink, source="y", safe=-1.0)}
    summary = live.run_live(gain(), wires, live.LiveSettings(duration=0.05))
    assert summary.steps == 10
    assert {values[0] for _, values in sink.sent} == {-1.0}
    assert summary.wires_out["out"]["sent"] == 0


def test_a_sensor_without_a_wire_is_named_at_the_start(memory):
    model = controllers.LinearModel([[1.0]], [[1.0]], [[1.0], [1.0]], 0.01, 0.01, dt=0.005)
    wires = {"u": live.Wire(memory(), to="u", start=0.0), "left": live.Wire(memory(), to="y[0]")}

    def run(**more):
        step = controllers.StateEstimator(model).online(compiled=False)
        return live.run_live(step, {**wires, **more}, live.LiveSettings(duration=0.01))

    with pytest.warns(UserWarning, match=r"^No wire sets y\[1\], so there is no value .* to = 'y\[1\]'"):
        run()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(right=live.Wire(memory(), to="y[1]"))


def test_a_start_value_is_used_until_the_first_sample(memory):
    sink = memory()
    wires = {"in": live.Wire(memory(), to="u", start=4.0), "out": live.Wire(sink, source="y", safe="last")}
    live.run_live(gain(), wires, live.LiveSettings(duration=0.05))
    assert {values[0] for _, values in sink.sent} == {8.0}
    assert len(sink.sent) == 10


def test_a_control_that_is_no_number_is_not_sent(memory):
    sink = memory()
    wires = {"out": live.Wire(sink, source="u", safe=0.5)}

    class Odd(Block):
        inputs = ()
        outputs = (cosim.Port("u"),)

        def define(self, dt):
            def output(t, u):
                u[0] = np.nan if t > 0.02 else 1.0

            return Definition(output, compiled=False)

    patient = live.LiveSettings(duration=0.06, watchdog=1e4)  # on a busy machine it would send safe values between
    summary = live.run_live(Odd().online(dt=0.01, compiled=False), wires, patient)
    values = [values[0] for _, values in sink.sent]
    assert values[1:4] == [1.0, 1.0, 1.0]
    assert set(values[4:]) == {0.5}
    assert summary.wires_out["out"]["not_finite"] == 3


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("value", "clipped"), [(np.nan, 0), (3.0, 3), (0.5, 0), (-3.0, 3)])
def test_only_values_beyond_the_limits_count_as_clipped(memory, value, clipped):
    """One that is no number is sent as it is if there is no safe value."""
    sink = memory()
    wires = {"out": live.Wire(sink, source="y", low=-1.0, high=1.0)}

    class Constant(Block):
        inputs = ()
        outputs = (cosim.Port("y"),)

        def define(self, dt):
            def output(y):
                y[0] = value

            return Definition(output, compiled=False)

    constant = Constant().online(dt=0.01, compiled=False)
    summary = live.run_live(constant, wires, live.LiveSettings(duration=0.03))
    assert summary.wires_out["out"]["clipped"] == clipped
    assert np.array_equal(sink.sent[-1][1], [np.clip(value, -1.0, 1.0)], equal_nan=True)


@pytest.mark.filterwarnings("ignore:No wire sets")
def test_a_sample_of_a_session_feeds_one_step(memory, tmp_path):
    diagram = cosim.Diagram(dt=0.01)
    received = diagram.add(live.Received(2), "received")
    total = diagram.add(cosim.Gain([[1.0, 0.0], [0.0, 1.0]]), "gain")
    diagram.connect(received["y"], total["u"])
    source = memory()

    def feed(time, inputs, outputs):
        if 0.025 < time < 0.035:
            source.inbox.put(7.0)

    settings = live.LiveSettings(duration=0.1, recording=live.Recording(tmp_path), watcher=feed)
    with diagram.start(engine="interpreted") as session:
        summary = live.run_live(session, {"in": live.Wire(source, to="received.u[1]")}, settings)
    result = live.read_recording(tmp_path)
    seen = result["received.y"][:, 1]
    assert np.flatnonzero(np.isfinite(seen)).tolist() == [3]
    assert result.time.tolist() == pytest.approx(np.arange(1, 11) / 100)
    assert result.time[3] == 0.04
    assert summary.wires_in["in"]["missing"] == {"no message": 9}
    assert np.isnan(result["received.u"][:, 0]).all()


def test_late_steps_use_the_samples_that_came_while_the_process_had_stopped(memory, tmp_path):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(live.Received(1), "received")
    source = memory()

    def stall(now, inputs, outputs):
        if 0.19 < now < 0.21:
            time.sleep(0.11)  # five and a half periods
            for value in range(5):
                source.inbox.put(float(value))

    settings = live.LiveSettings(duration=0.5, recording=live.Recording(tmp_path), watcher=stall)
    with diagram.start(engine="interpreted") as session:
        summary = live.run_live(session, {"in": live.Wire(source, to="received.u")}, settings)
    seen = live.read_recording(tmp_path)["received.y"].ravel()
    assert np.flatnonzero(np.isfinite(seen)).tolist() == [10, 11, 12, 13, 14]
    assert seen[10:15].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert summary.wires_in["in"]["replaced"] == 0


def test_steps_that_always_take_too_long_use_new_samples(memory):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(live.Received(1), "received")
    source, lags, sent, ended = memory(), [], [0], threading.Event()

    def feed():
        while not ended.wait(0.02):
            sent[0] += 1
            if source.inbox is not None:
                source.inbox.put(float(sent[0]))

    def slow(now, inputs, outputs):
        lags.append(sent[0] - inputs[0])
        time.sleep(0.03)

    with diagram.start(engine="interpreted") as session:
        thread = threading.Thread(target=feed)
        thread.start()
        wires = {"in": live.Wire(source, to="received.u")}
        live.run_live(session, wires, live.LiveSettings(duration=0.8, watcher=slow))
        ended.set()
        thread.join()
    assert np.nanmedian(lags[-15:]) <= 3  # ten, if they waited for all late steps


def test_an_input_of_an_fmu_keeps_its_last_sample(memory):
    from bayesftc import fmus

    diagram = cosim.Diagram(dt=0.02)
    diagram.add(cosim.FMU(fmus.path("CruiseControl")), "car")
    source, sink = memory(), memory()

    def feed(time, inputs, outputs):
        if time < 0.03:
            source.inbox.put(500.0)
            source.inbox.put(float("nan"))

    wires = {"force": live.Wire(source, to="car.force", start=0.0), "v": live.Wire(sink, source="car.v")}
    with diagram.start(engine="interpreted") as session:
        summary = live.run_live(session, wires, live.LiveSettings(duration=0.2, watcher=feed))
    speeds = [values[0] for _, values in sink.sent]
    assert np.all(np.diff(speeds[2:]) > 0)
    assert summary.wires_in["force"]["rejected"] == {"not a number": 1}


def test_an_error_in_a_step_leaves_the_outputs_safe_and_the_recording_whole(memory, tmp_path):
    class Fails(live.Stepper):
        step = cosim.Integrator().online(dt=0.01, compiled=False).step
        inputs, outputs = {}, {"u": cosim.Port("u")}
        k = -1

        def _prepare(self):
            pass

        def bears_missing(self, name):
            return False

        def advance(self, inputs):
            self.k += 1
            if self.k == 5:
                raise SimulationError("The plant has failed.", None)
            return np.array([1.0])

    sink = memory()
    settings = live.LiveSettings(recording=live.Recording(tmp_path))
    with pytest.raises(SimulationError, match="failed"):
        live.run_live(Fails(), {"out": live.Wire(sink, source="u", safe=0.0)}, settings)
    assert sink.sent[-1][1] == [0.0]
    assert sink.closed
    assert len(live.read_recording(tmp_path)["u"]) == 5


def test_a_bridge_that_cannot_be_opened_closes_the_others(memory):
    class Refuses(memory):
        def open(self, inbox):
            raise ModelError("The port is used.")

    sink = memory()
    wires = {"out": live.Wire(sink, source="y", safe=0.0), "in": live.Wire(Refuses(), to="u")}
    with pytest.raises(ModelError, match="The wire 'in': The port is used"):
        live.run_live(gain(), wires)
    assert sink.closed


@pytest.mark.parametrize(
    ("wires", "error", "text"),
    [
        ({"w": {"to": "v"}}, UnknownNameError, "The wire 'w': There is no input 'v'"),
        ({"w": {"to": "y"}}, UnknownNameError, "'y' is not an input, but an output. Use from"),
        ({"w": {"source": "u", "safe": 0.0}}, UnknownNameError, "'u' is not an output, but an input. Use to"),
        ({"a": {"to": "u"}, "b": {"to": "u"}}, ModelError, "u is already set by the wire 'a'"),
        ({}, ModelError, "No wire sets the input 'u'"),
    ],
)
def test_wires_that_do_not_fit_are_refused(memory, wires, error, text):
    made = {name: live.Wire(memory(), **settings) for name, settings in wires.items()}
    with pytest.raises(error, match=text):
        live.run_live(gain(), made)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({}, "either to"),
        ({"to": "u", "source": "y"}, "either to"),
        ({"source": "controller.u[0]"}, "needs a safe value"),
        ({"source": "y", "stale_after": 1.0}, "stale_after has no effect"),
        ({"to": "u", "safe": 1.0}, "safe has no effect"),
        ({"source": "y", "safe": "zero"}, "safe is 'zero'"),
        ({"source": "y", "safe": np.inf}, "safe is inf"),
        ({"source": "y", "safe": 5.0, "low": -1.0, "high": 1.0}, "safe is 5.0; it must not be below low = -1"),
        ({"to": "u", "low": 2.0, "high": 1.0}, "low must be less"),
    ],
)
def test_wires_without_sense_are_refused(memory, settings, text):
    with pytest.raises(ModelError, match=text):
        live.Wire(memory(), **settings)


def test_settings_without_sense_are_refused(memory):
    for settings, text in (
        ({"pace": 0.0}, "pace is 0"),
        ({"watchdog": 0.0}, "watchdog"),
        ({"watchdog": np.inf}, "watchdog"),
        ({"duration": 0.0123}, "step"),
    ):
        with pytest.raises(Exception, match=text):
            live.run_live(cosim.Ramp(1.0).online(dt=0.01, compiled=False), {}, live.LiveSettings(**settings))
    with pytest.raises(ModelError, match="needs a session"):
        live.run_live(cosim.Ramp(1.0), {})


def test_the_watchdog_sends_the_safe_value_until_there_is_a_step(memory):
    class Clock:
        now = 0.0

        def __call__(self):
            return self.now

    clock, sink = Clock(), memory()
    wire = Outgoing("out", live.Wire(sink, source="u", safe=-5.0), [0])
    dog = Watchdog(0.1, [wire], clock)
    for now, count in ((0.05, 0), (0.11, 1), (0.2, 2)):
        clock.now = now
        dog.check()
        assert len(sink.sent) == count
    dog.feed()
    dog.check()
    clock.now = 0.4
    dog.check()
    assert dog.trips == 2
    assert sink.sent[-1][1] == [-5.0]


def test_a_bridge_that_raises_keeps_no_other_from_its_safe_value(memory):
    class Raises(type(memory())):
        def send(self, values, time):
            raise RuntimeError("no cable")

    broken, sink = Raises(), memory()
    wires = [Outgoing("broken", live.Wire(broken, source="u", safe=0.0), [0])]
    wires.append(Outgoing("out", live.Wire(sink, source="u", safe=-7.0), [0]))
    dog = Watchdog(0.1, wires, iter([0.0, 1.0]).__next__)
    dog.check()
    assert [values for _, values in sink.sent] == [[-7.0]]
    assert (broken.problem, broken.lost) == ("RuntimeError: no cable", 1)
    with pytest.raises(RuntimeError, match="no cable"):  # but the error of a step ends the run
        live.run_live(
            cosim.Ramp(1.0).online(dt=0.01, compiled=False),
            {
                "broken": live.Wire(Raises(), source="y", safe=0.0),
                "out": live.Wire(sink, source="y", safe=-8.0),
            },
            live.LiveSettings(duration=0.1),
        )
    assert sink.sent[-1][1] == [-8.0]


def test_a_connection_that_cannot_be_closed_is_made_anew(until):
    class Connection:
        def close(self):
            raise RuntimeError("closed already")

    @dataclass(eq=False)
    class Breaks(live.Reconnecting):
        made: int = 0

        def connect(self):
            self.made += 1
            return Connection()

        def read(self, connection):
            raise OSError("broken")

    bridge = Breaks()
    bridge.open(live.Inbox(1))
    until(lambda: bridge.made > 1)
    bridge.close()


def test_a_step_that_hangs_trips_the_watchdog(memory, until):
    hang, sink = threading.Event(), memory()

    class Hangs(live.Stepper):
        step = cosim.Integrator().online(dt=0.01, compiled=False).step
        inputs, outputs = {}, {"u": cosim.Port("u")}
        k = -1

        def _prepare(self):
            pass

        def bears_missing(self, name):
            return False

        def advance(self, inputs):
            self.k += 1
            if self.k == 3:
                hang.wait(30)
            return np.array([1.0])

    def tripped():
        values = [values[0] for _, values in sink.sent]
        if values[-3:] == [9.0] * 3 and 1.0 in values:
            hang.set()
        return hang.is_set() and values[-1] == 1.0

    settings = live.LiveSettings(watchdog=5)
    summary = in_thread(until, tripped, Hangs(), {"out": live.Wire(sink, source="u", safe=9.0)}, settings)
    assert summary.watchdog_trips >= 1


def test_a_long_stop_sets_the_clock_anew(monkeypatch, memory):
    monkeypatch.setattr("bayesftc.cosim.live.run.LOST_CLOCK", 0.05)

    def stall(t, inputs, outputs):
        if 0.015 < t < 0.025:
            time.sleep(0.3)

    summary = live.run_live(
        cosim.Ramp(1.0).online(dt=0.01, compiled=False), {}, live.LiveSettings(duration=0.1, watcher=stall)
    )
    assert summary.steps == 10
    assert summary.deadlines["skipped"] >= 20


def test_deadlines_are_counted():
    deadlines = live.Deadlines(0.01)
    for delay in (0.0, -1e-9, 5e-6, 3e-3, 0.5, 1e6):
        deadlines.add(delay, delay + 0.001)
    report = deadlines.report()
    assert sum(count for _, _, count in report["histogram"]) == 6
    assert report["histogram"][-1][:2] == (EDGES[-1], None)
    assert (report["overruns"], report["worst_delay"]) == (2, 1e6)
    assert deadlines.share_within(0.01) == pytest.approx(4 / 6)
    assert deadlines.quantile(0.5) <= 3e-3 * 1.13
    assert np.isnan(live.Deadlines(1.0).share_within(1.0))


PROGRAM = """
import signal, sys
for number in (signal.SIGHUP, signal.SIGQUIT):  # nohup, and shells in the background, have them ignored
    signal.signal(number, signal.SIG_DFL)
from bayesftc import cosim
from bayesftc.cosim import live
ramp = cosim.Ramp(1.0, start=0.0).online(dt=0.01, compiled=False)
wires = {"out": live.Wire(live.File(sys.argv[1], columns=["y"]), source="y", safe=-1.0)}
print("ready", flush=True)
summary = live.run_live(ramp, wires, live.LiveSettings(recording=live.Recording(sys.argv[2], rows=20)))
print(summary.stopped)
print(summary.lost_rows)
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL])
def test_a_signal_leaves_the_outputs_safe_and_the_recording_whole(tmp_path, until, number):
    out, folder = tmp_path / "out.csv", tmp_path / "recording"
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(out), str(folder)], stdout=subprocess.PIPE, text=True
    )
    try:
        until(lambda: out.exists() and out.read_text().count("\n") > 60, 90)
        until(lambda: len(list(folder.rglob("0*.parquet"))) >= 2)
        process.send_signal(number)
        text, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    steps = len(live.read_recording(folder)["y"])
    rows = out.read_text().splitlines()
    if number == signal.SIGKILL:
        assert process.returncode == -9
        assert steps >= 40
        return
    assert process.returncode == 0
    name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
    assert f"The run was stopped by {name}." in text
    assert rows[-1].endswith(",-1.0")
    assert steps + int(text.split()[-1]) >= len(rows) - 3 > 50
    assert not list(folder.rglob(".*"))


def test_the_signal_handlers_are_restored():
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    live.run_live(cosim.Ramp(1.0).online(dt=0.01, compiled=False), {}, live.LiveSettings(duration=0.02))
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux")
def test_an_hour_of_steps_needs_no_more_memory(memory, tmp_path):
    """At 100 Hz, speeded up: as fast as the machine can."""
    diagram = cosim.Diagram(dt=0.01)
    received = diagram.add(live.Received(2), "received")
    mean = diagram.add(cosim.Gain([[0.5, 0.5]]), "mean")
    diagram.connect(received["y"], mean["u"])
    source, sizes = memory(), []

    class Quiet(memory):
        def send(self, values, time):
            pass

    def feed(t, inputs, outputs):
        source.inbox.put([t, t])
        if round(100 * t) % 36_000 == 0:
            sizes.append(resident())

    wires = {"in": live.Wire(source, to="received.u"), "out": live.Wire(Quiet(), source="mean.y", safe=0.0)}
    recording = live.Recording(tmp_path, rows=10_000, keep=3)
    with diagram.start() as session:
        settings = live.LiveSettings(duration=3600.0, pace=1e5, recording=recording, watcher=feed)
        summary = live.run_live(session, wires, settings)
    # SIGTERM, as of a time limit around the tests, ends the run cleanly: then there are fewer sizes, and this says why.
    assert (summary.stopped, summary.steps) == ("The run has ended after 3600 s, as requested.", 360_000)
    assert len(sizes) == 10
    assert sizes[-1] - sizes[2] < 8e6
    assert len(list(tmp_path.rglob("*.parquet"))) == 3
