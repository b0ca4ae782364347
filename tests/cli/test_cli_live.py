"""``bayesftc live`` as a process: the shipped car in another one, the end by signals, a step that hangs, and mistakes."""

import json
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from brokers import until
from typer.testing import CliRunner

from bayesftc.cli import app
from bayesftc.cosim import live
from bayesftc.scenario._files import shipped_files

WIRES = shipped_files("wires")["car_by_udp"].read_text(encoding="utf-8")
SAFE = -1.5  # N; not a control by chance


@pytest.fixture
def port(tmp_path):
    """Write the shipped wires with four free ports in a row, of which the first is returned, and another safe value."""
    for first in range(47100, 48000, 4):
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
        try:
            for i, each in enumerate(sockets):
                each.bind(("127.0.0.1", first + i))
        except OSError:
            continue
        finally:
            for each in sockets:
                each.close()
        text = WIRES
        for i in range(4):
            text = text.replace(f"port = {47000 + i}", f"port = {first + i}")
        (tmp_path / "wires.toml").write_text(text.replace("safe = 0.0", f"safe = {SAFE}"), encoding="utf-8")
        return first
    pytest.fail("there are no free ports")


@pytest.fixture
def started(tmp_path):
    processes = []

    def start(module, *options):
        command = [sys.executable, "-m", module, *options]
        processes.append(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
        )
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()


class Actuator:
    """The forces that arrive at a port, with the time of their arrival."""

    def __init__(self, port):
        self.forces = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        while True:
            try:
                payload = self._socket.recv(100)
            except OSError:
                return
            self.forces.append((time.monotonic(), struct.unpack("<d", payload)[0]))

    def close(self):
        self._socket.close()

    def controls(self):
        return [force for _, force in self.forces if force != SAFE]


@pytest.fixture
def plant(port):
    """Send 20 m/s from two sensors at 50 Hz, and receive the forces."""
    actuator, ended = Actuator(port + 2), threading.Event()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send():
        rng = np.random.default_rng(0)
        k = 0
        while not ended.wait(0.02):
            k += 1
            for i in range(2):
                payload = struct.pack("<2d", 0.02 * k, 3.6 * (20.0 + rng.standard_normal()))
                sender.sendto(payload, ("127.0.0.1", port + i))

    thread = threading.Thread(target=send)
    thread.start()
    yield actuator
    ended.set()
    thread.join()
    sender.close()
    actuator.close()


@pytest.mark.slow
def test_alarms_of_actuators_are_printed(plant, started, tmp_path):
    text = shipped_files("scenario")["live_car"].read_text(encoding="utf-8")
    learner = 'kind = "SwitchingPrecision"\n'
    assert learner in text
    with_modes = text.replace(learner, f'{learner}actuator_modes = [{{ kind = "LostEffect" }}]\n')
    (tmp_path / "lost.toml").write_text(with_modes, encoding="utf-8")
    run = started("bayesftc", "live", "lost.toml", "--bridge", "wires.toml", "--duration", "8", "--json")
    printed, said = run.communicate(timeout=60)
    assert run.returncode == 0, said
    assert "actuator force: alarm, fault probability" in said  # the speed does not follow the force
    alarm = next(each for each in json.loads(printed)["alarms"] if "actuator" in each)
    assert (alarm["actuator"], alarm["kind"]) == ("force", "LostEffect")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_leaves_the_outputs_safe_and_the_recording_whole(plant, started, tmp_path, number):
    process = started("bayesftc", "live", "live_car", "--bridge", "wires.toml", "--record", "runs", "--json")
    until(lambda: process.poll() is None and len(plant.controls()) > 60, 120)
    process.send_signal(number)
    assert process.wait(60) == 0
    numbers = json.loads(process.stdout.read())
    until(lambda: plant.forces[-1][1] == SAFE)
    assert [force for _, force in plant.forces[:1]] == [SAFE]  # before the first control
    name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
    assert numbers["stopped"] == f"The run was stopped by {name}."
    assert numbers["lost_rows"] == 0
    result = live.read_recording(tmp_path / "runs")
    assert len(result.time) == numbers["steps"]
    sent = [force for force in result["controller.u"][:, 0].tolist() if np.isfinite(force)]
    assert plant.controls() == sent[: len(plant.controls())]
    assert np.isfinite(result["controller.y"]).any()


@pytest.mark.slow
def test_a_kill_loses_the_last_piece_only(plant, started, tmp_path):
    text = (tmp_path / "wires.toml").read_text() + "\n[recording]\nrows = 25\n"
    (tmp_path / "wires.toml").write_text(text)
    process = started("bayesftc", "live", "live_car", "--bridge", "wires.toml", "--record", "runs")
    until(lambda: process.poll() is None and len(list(tmp_path.glob("runs/*/0*.parquet"))) >= 3, 120)
    process.kill()
    process.wait()
    pieces = list(tmp_path.glob("runs/*/0*.parquet"))
    assert len(live.read_recording(tmp_path / "runs").time) == 25 * len(pieces)
    again = started("bayesftc", "live", "live_car", "--bridge", "wires.toml", "--record", "runs", "--duration", "1")
    assert again.wait(120) == 0
    assert len(live.read_recording(tmp_path / "runs").time) == 50  # the last run


HANGS = """
import time as clock
from dataclasses import dataclass
from bayesftc.cosim.live import Bridge

@dataclass(eq=False)
class Hangs(Bridge):
    def open(self, inbox): ...
    def close(self): ...
    def send(self, values, time):
        if 1.0 <= time < 1.01:
            clock.sleep(1.5)
"""


@pytest.mark.slow
def test_a_step_that_hangs_trips_the_watchdog(plant, started, tmp_path):
    (tmp_path / "hangs.py").write_text(HANGS)
    wire = '\n[bridge.lamp]\nkind = "hangs.py:Hangs"\nfrom = "controller.beta"\n'
    (tmp_path / "wires.toml").write_text((tmp_path / "wires.toml").read_text() + wire)
    process = started("bayesftc", "live", "live_car", "--bridge", "wires.toml", "--duration", "4", "--json")
    assert process.wait(120) == 0
    numbers = json.loads(process.stdout.read())
    assert numbers["watchdog_trips"] >= 1
    assert numbers["deadlines"]["skipped"] >= 50
    controls = [at for at, force in plant.forces if force != SAFE]
    begin, end = max(pairwise(controls), key=lambda pair: pair[1] - pair[0])
    assert end - begin > 1.4
    safe = [at - begin for at, force in plant.forces if force == SAFE and begin < at < end]
    assert len(safe) >= 3  # each 50 ms, for more than a second
    assert 0.18 < safe[0] < 1.0  # after ten periods of 20 ms


@pytest.mark.slow
def test_the_shipped_car_is_kept_on_its_speed_while_a_sensor_is_frozen(port, started, tmp_path):
    car = started("bayesftc.examples.live_car.car", "--port", str(port), "--freeze", "6", "--duration", "60")
    assert car.stdout.readline() == "The car drives.\n"
    command = ("live", "live_car", "--bridge", "wires.toml", "--record", "runs", "--json", "--duration", "16")
    process = started("bayesftc", *command)
    text, alarms = process.communicate(timeout=180)
    assert process.returncode == 0, alarms
    numbers = json.loads(text)
    found = re.search(r"s: sensor 0: alarm, fault probability (\d\.\d+)", alarms)
    assert found
    assert 0.9 <= float(found[1]) <= 1.0
    found = [event for event in numbers["alarms"] if event["kind"] == "Frozen"]
    assert {event["sensor"] for event in found} == {"sensor 0"}
    for name in ("speed0", "speed1"):
        assert numbers["wires_in"][name]["missing_share"] < 0.2
    result = live.read_recording(tmp_path / "runs")
    error = result["controller.x_hat"][200:, 0] - result["reference.y"][200:].ravel()
    assert np.abs(error).max() < 2.0  # the speed swings by 5 m/s; the frozen sensor alone would be wrong by up to 10
    car.send_signal(signal.SIGTERM)
    assert car.wait(60) == 0
    assert re.search(r"The engine got \d+ forces in \d+ steps", car.stdout.read())


def test_the_example_runs_without_another_process(tmp_path, capsys, monkeypatch):
    """Quick: the car alone, for a fifth of a second."""
    from bayesftc.examples.live_car import car

    monkeypatch.setattr(sys, "argv", ["car", "--duration", "0.2", "--port", "47980"])
    car.main()
    assert "The engine got 0 forces in 10 steps." in capsys.readouterr().out


def test_its_wires_are_those_of_the_shipped_file():
    """The car and its controller meet at the same ports, with units that fit."""
    from bayesftc.examples.live_car.car import KMH, wires
    from bayesftc.scenario.live import load_wires

    theirs, ours = wires(47000), load_wires("car_by_udp").wires
    for name in ("speed0", "speed1", "force"):
        assert theirs[name].bridge.port == ours[name].bridge.port
        assert theirs[name].bridge.format == ours[name].bridge.format
        assert theirs[name].is_input != ours[name].is_input
    for name in ("speed0", "speed1"):
        assert theirs[name].scale * ours[name].scale == pytest.approx(1.0, rel=1e-5)
    assert theirs["speed0"].scale == KMH


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["live_car"], 2, "--bridge"),
        (["live_car", "--bridge", "nowhere.toml"], 3, "There is no file of wires nowhere.toml"),
        (["live_cra", "--bridge", "car_by_udp"], 3, "did you mean 'live_car'"),
        (["live_car", "--bridge", "wrong.toml"], 5, "wrong.toml: The wire 'speed': There is no input 'controller.z'"),
        (["live_car", "--bridge", "car_by_udp", "--pace", "0"], 9, "Error: pace is 0"),
        (["live_car", "--bridge", "car_by_udp", "--duration", "0.01"], 8, "Error: The duration of 0.01 s"),
        (["live_car", "--bridge", "car_by_udp", "--record", "wrong.toml"], 12, "Error: The folder wrong.toml/"),
    ],
)
def test_mistakes_end_with_a_sentence(options, code, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("wrong.toml").write_text('[bridge.speed]\nkind = "UDP"\nport = 0\nto = "controller.z"\n')
    done = CliRunner().invoke(app, ["live", *options])
    assert done.exit_code == code, done.output
    assert words in " ".join(done.output.replace("│", " ").split())


def test_drops_without_a_page_are_refused(tmp_path):
    done = CliRunner().invoke(app, ["live", "live_car", "--bridge", "car_by_udp", "--drops"])
    assert done.exit_code == 2
    assert "add --serve" in " ".join(done.output.replace("│", " ").split())
