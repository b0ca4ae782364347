"""What several tests of campaigns share."""

import os
import signal
import uuid
from pathlib import Path

import pytest

from bayesftc import cosim, fmus


@pytest.fixture(scope="session")
def car():
    """Return a function that returns a car whose speed is kept by a law, by the word of a sensor that freezes."""

    def car(path=None, dt=0.02, **options):
        diagram = cosim.Diagram(dt=dt)
        plant = diagram.add(cosim.FMU(path or fmus.path("CruiseControl"), **options), "plant")
        law, noise = (
            diagram.add(cosim.Gain(-500.0, offset=10_000.0), "law"),
            diagram.add(cosim.Gaussian(std=0.03), "noise"),
        )
        freeze = diagram.add(cosim.Freeze(sensor=0, start=0.2, channels=1), "freeze")
        sensors = diagram.add(cosim.Sensors(count=1, std=0.5), "sensors")
        diagram.connect(plant["v"], sensors["u"])
        diagram.connect(sensors["y"], freeze["u"])
        diagram.connect(freeze["y"][0], law["u"])
        diagram.connect(law["y"], plant["force"])
        diagram.connect(noise["y"], plant["disturbance"])
        return diagram

    return car


@pytest.fixture(scope="session")
def living():
    """Return a function that returns the numbers of the processes that this one has started, and of those that they have."""

    def found():
        parents = {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
                    command = (entry / "cmdline").read_bytes()
                except OSError:
                    continue
                if state != "Z" and b"resource_tracker" not in command:  # Python's own, which stays
                    parents[int(entry.name)] = int(parent)
        mine, more = {os.getpid()}, True
        while more:
            more = {pid for pid, parent in parents.items() if parent in mine} - mine
            mine |= more
        return mine - {os.getpid()}

    return found


@pytest.fixture
def marked(tmp_path):
    """Return an environment with folders of its own, and a function that returns the processes that have it and live."""
    mark = f"BAYESFTC_MARK={uuid.uuid4().hex}"
    folder = tmp_path / "temporary"
    folder.mkdir()
    name, value = mark.split("=")

    def found():
        pids = set()
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit() and mark.encode() in (entry / "environ").read_bytes():
                    pids.add(int(entry.name))
            except OSError:  # it has ended meanwhile, or is a zombie, which has no environment
                continue
        return pids

    yield {**os.environ, name: value, "TMPDIR": str(folder)}, found
    for pid in found():
        os.kill(pid, signal.SIGKILL)
