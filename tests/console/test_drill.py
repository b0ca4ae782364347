"""A drill: an operator who does anything, viewers who come and vanish, and a server that is killed in the middle of it."""

import http.client
import io
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas
import pytest
from served import PATIENCE, Viewer, connect_without_reading, get, read_address
from websockets.exceptions import WebSocketException

from bayesftc.console.desk.desk import MOST_BRANCHES
from bayesftc.scenario import load_scenario

ENDS = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 0, signal.SIGINT: 0}


class Drill:
    """A served car in a group of processes of its own, with a folder of its own for temporary files."""

    def __init__(self, folder: Path, port: int = 0):
        self.temporary = folder / "temporary"
        self.temporary.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "bayesftc", "serve", "cruise_control", "--port", str(port)]
        self.process = subprocess.Popen(
            command,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, "TMPDIR": str(self.temporary)},
        )
        self.address = read_address(self.process)

    @property
    def port(self):
        return int(self.address.split(":")[2].split("/")[0])

    def end(self, how):
        """Send a signal; return the exit status, all that was printed, and whether a process is left."""
        self.process.send_signal(how)
        printed = self.process.communicate(timeout=20)[1]
        return self.process.returncode, printed, self.is_left()

    def is_left(self):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, 0)
            return True
        return False

    def close(self):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stderr.close()


class Operator:
    """Who does anything that the page offers, also what cannot be done at present."""

    def __init__(self, viewer, seed):
        self.viewer, self.random = viewer, random.Random(seed)
        self.done = self.refused = 0

    def act(self):
        do = self.random.choices(
            ["fault", "repair", "goal", "back", "step", "run", "pace", "branch", "rename", "show"],
            [8, 3, 2, 3, 6, 4, 2, 4, 1, 1],
        )[0]
        answer = self.viewer.ask(**getattr(self, do)())
        if answer["type"] == "done":
            self.done += 1
        else:
            self.refused += 1
            assert answer["sentence"].endswith((".", "?")), answer

    def fault(self):
        device = self.random.choice(self.viewer.layout["devices"])
        plan = self.random.choice([each for each in self.viewer.layout["kinds"] if each["kind"] in device["kinds"]])
        settings = {"kind": plan["kind"], "sensor": device["channel"]}
        for each in plan["settings"]:
            if each["type"] == "number" and (each["required"] or self.random.random() < 0.3):
                settings[each["name"]] = self.random.choice([0.5, 1.0, 2.0])
        if self.random.random() < 0.6:
            settings["duration"] = self.random.choice([0.1, 1.0])
        if self.random.random() < 0.3:
            settings["start"] = self.random.choice([self.viewer.header["t"] + 1.0, "plant.v > 19", "plant.v >", 0.0])
        return {"do": "fault", "target": device["target"], "settings": settings}

    def repair(self):
        names = [each["name"] for each in self.viewer.layout["faults"]] or ["freeze_99"]
        return {"do": "repair", "name": self.random.choice(names)}

    def goal(self):
        return {"do": "goal", "target": "0", "value": self.random.uniform(15.0, 25.0)}

    def back(self):
        return {"do": "back", "k": self.random.randint(0, self.viewer.header["furthest"] // 2 + 10)}

    def step(self):
        return {"do": "step", "steps": self.random.choice([1, 50, 200])}

    def run(self):
        return {"do": "run", "on": self.random.random() < 0.6}

    def pace(self):
        return {"do": "pace", "pace": self.random.choice([0.1, 1, 10, 30, 1000])}

    def branch(self):
        names = [each["name"] for each in self.viewer.layout["branches"]]
        do = self.random.choice(["choose", "compare", "remove"])
        return {"do": do, "name": self.random.choice([*names, None])}

    def rename(self):
        names = [each["name"] for each in self.viewer.layout["branches"]]
        return {"do": "rename", "name": self.random.choice(names), "new": f"try {self.random.randint(1, 5)}"}

    def show(self):
        return {"do": "show", "columns": self.random.sample(self.viewer.layout["lanes"][0]["columns"], 5)}


class Crowd:
    """Viewers who come, and leave politely, or vanish, or read nothing; in a thread of their own."""

    def __init__(self, address, seed):
        self.address, self.random, self.over, self.count = address, random.Random(seed), threading.Event(), 0
        self.thread = threading.Thread(target=self.work)
        self.error = None
        self.thread.start()

    def work(self):
        stuck = []
        try:
            while not self.over.wait(self.random.uniform(0.0, 0.1)):
                how = self.random.choice(["leaves", "vanishes", "reads nothing"])
                if how == "reads nothing":
                    stuck.append(connect_without_reading(self.address))
                    if len(stuck) > 5:
                        stuck.pop(0).close()
                    continue
                viewer = Viewer(self.address)
                for _ in range(self.random.randint(0, 4)):
                    viewer.receive()
                if how == "leaves":
                    viewer.socket.close()
                else:  # without a farewell
                    viewer.socket.socket.shutdown(socket.SHUT_RDWR)
                self.count += 1
        except (WebSocketException, OSError, EOFError) as error:  # right after the server's end, wrong before
            self.error = error

    def end(self):
        self.over.set()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()


def read_all(address, path):
    """Return the body of a download, or None if the server ends: what looks whole is whole."""
    try:
        status, headers, body = get(address, path)
    except (http.client.HTTPException, OSError):
        return None
    if status == 503:
        assert body == b"The console has ended."
        return None
    assert (status, len(body)) == (200, int(headers.get("content-length", -1))), (headers, body[:500])
    return body


def same_as_downloaded(viewer, folder):
    """Compare what the page has at the present step with a run of the file that it offers."""
    viewer.do(do="run", on=False)
    others = [each["name"] for each in viewer.layout["branches"] if not each["active"]]
    if len(others) == MOST_BRANCHES - 1:  # the next step may make a branch
        viewer.do(do="remove", name=others[0])
    viewer.do(do="step", steps=1)
    k = viewer.header["k"]
    viewer.until(lambda: viewer.header["k"] >= k and viewer.header["epoch"] == viewer.layout["epoch"])
    file = folder / "by_hand.toml"
    file.write_bytes(read_all(viewer.address, "/download/scenario.toml"))
    result = load_scenario(file).simulate()
    viewer.until(lambda: viewer.header["k"] == len(result.time) - 1)
    for name in ("plant.v", "controller.u[0]", "controller.fault_probability[1]"):
        signal_, _, element = name.partition("[")
        values = result[signal_] if not element else result[signal_][:, int(element[:-1])]
        assert np.array_equal(values.astype(np.float32)[viewer.steps.astype(int)][-1], viewer.column(name)[-1])
    table = pandas.read_csv(io.BytesIO(read_all(viewer.address, "/download/signals.csv")))
    assert len(table) == len(result.time)
    return len(result.time)


@pytest.mark.slow
def test_some_actions_then_the_server_is_ended(tmp_path):
    perform(tmp_path, signal.SIGTERM, actions=5)


@pytest.mark.slow
@pytest.mark.parametrize("how", ENDS, ids=lambda how: how.name)
def test_two_hundred_actions_then_the_server_is_killed(tmp_path, how):
    port = perform(tmp_path, how, actions=200)
    again = Drill(tmp_path, port)  # the same port is free at once
    try:
        with Viewer(again.address) as viewer:
            viewer.ready()
            viewer.claim()
            viewer.do(do="step", steps=100)
            assert same_as_downloaded(viewer, tmp_path) == 102
        status, printed, is_left = again.end(signal.SIGTERM)
        assert (status, is_left) == (0, False), printed
    finally:
        again.close()


def perform(tmp_path, how, actions):
    """Let an operator and a crowd act, and end the server by a signal; return its port."""
    drill = Drill(tmp_path)
    try:
        viewer = Viewer(drill.address).ready()
        viewer.claim()
        operator, crowd = Operator(viewer, seed=int(how)), Crowd(drill.address, seed=int(how))
        for number in range(actions):
            operator.act()
            if number % 50 == 49:
                assert len(read_all(drill.address, "/download/events.csv").splitlines()) > number // 2
        assert crowd.error is None
        assert operator.done > actions // 2
        assert same_as_downloaded(viewer, tmp_path) > 1
        viewer.ask(do="run", on=True)
        bodies = []
        loading = threading.Thread(target=lambda: bodies.append(read_all(drill.address, "/download/figure.png")))
        loading.start()
        time.sleep(0.2)
        began = time.monotonic()
        status, printed, is_left = drill.end(how)
        assert time.monotonic() - began < 15.0
        assert (status, is_left) == (ENDS[how], False), printed
        assert "Traceback" not in printed, printed
        crowd.end()
        loading.join(PATIENCE)
        assert not loading.is_alive()
        assert bodies[0] is None or bodies[0].endswith(b"IEND\xaeB`\x82")
        assert crowd.count > actions // 20
        if how != signal.SIGKILL:
            assert "The console has ended." in printed
            assert [*drill.temporary.iterdir()] == []
    finally:
        drill.close()
    return drill.port
