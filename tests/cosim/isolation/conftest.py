"""Plants in processes of their own, and what must not be left of them."""

import gc
import os
import tempfile
import time
from pathlib import Path

import pytest

from bayesftc import cosim, fmus


@pytest.fixture(scope="session")
def car():
    """Return a function that returns the shipped car, isolated."""

    def car(fmi="2.0", isolate=True, **options):
        return cosim.FMU(fmus.path("CruiseControl", fmi=fmi), isolate=isolate, **options)

    return car


@pytest.fixture(scope="session")
def cruise():
    """Return a function that returns the diagram of a controller that keeps a car's speed."""

    def cruise(block, dt=0.02, every=1):
        diagram = cosim.Diagram(dt=dt)
        plant = diagram.add(block, "car", every=every)
        controller = diagram.add(cosim.Gain(-500.0, offset=10_000.0))
        noise = diagram.add(cosim.Gaussian(std=0.03), "noise")
        diagram.connect(plant["v"], controller["u"])
        diagram.connect(controller["y"], plant["force"])
        diagram.connect(noise["y"], plant["disturbance"])
        return diagram

    return cruise


@pytest.fixture(scope="session")
def until():
    """Return a function that waits until something is so."""

    def until(condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.01)

    return until


@pytest.fixture(scope="session")
def children():
    """Return a function that returns the processes that this one has started and that are not gone, zombies among them."""

    def found():
        processes = set()
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    fields = (entry / "stat").read_text().rpartition(")")[2].split()
                except OSError:
                    continue
                if int(fields[1]) == os.getpid():
                    processes.add(int(entry.name))
        return processes

    return found


@pytest.fixture
def nothing_left(tmp_path, monkeypatch, children):
    """Check that a test leaves no process, no descriptor, no shared memory and no temporary file behind."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))

    def held():
        gc.collect()  # an error that was caught holds on to what it has passed through
        return children(), len(os.listdir("/proc/self/fd"))

    before = held()
    yield
    assert held() == before
    assert not list(folder.iterdir())
    assert not [name for name in os.listdir("/dev/shm") if "bayesftc" in name]
