"""Executors: wherever the runs of a campaign are made, they have the same bits; what kills a process fails one run, no other."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim import Processes, Threads

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")


def car(path=None, dt=0.02, **options):
    """A car whose speed is measured by two sensors, one of which freezes, and kept by a plain law."""
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(cosim.FMU(path or fmus.path("CruiseControl"), **options), "plant")
    law, noise = diagram.add(cosim.Gain(-500.0, offset=10_000.0), "law"), diagram.add(cosim.Gaussian(std=0.03), "noise")
    freeze = diagram.add(cosim.Freeze(sensor=0, start=0.2, channels=1), "freeze")
    sensors = diagram.add(cosim.Sensors(count=1, std=0.5), "sensors")
    diagram.connect(plant["v"], sensors["u"])
    diagram.connect(sensors["y"], freeze["u"])
    diagram.connect(freeze["y"][0], law["u"])
    diagram.connect(law["y"], plant["force"])
    diagram.connect(noise["y"], plant["disturbance"])
    return diagram


def made(diagram, executor, points, *, seeds=3, duration=0.6, **options):
    record = options.pop("record", ["plant.v", "sensors.y"])
    return cosim.Campaign(
        diagram, duration=duration, grid=points, seeds=seeds, record=record, metrics=[cosim.RMSE("plant.v", name="size")],
        **options,
    ).run(executor=executor)  # fmt: skip


def living():
    """Return the numbers of the processes that descend from this one."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z":
                parents[int(entry.name)] = int(fields[1])
    mine, more = {os.getpid()}, True
    while more:
        more = {pid for pid, parent in parents.items() if parent in mine} - mine
        mine |= more
    return mine - {os.getpid()}


def test_processes_die_of_one_run_only(lying, same_bits):
    path, ways = lying("2.0")
    values = {"well": 50.0, "segfault": ways["SEGFAULT"], "exit": ways["EXIT"], "heavy": 60.0}
    before = living()
    result = made(car(path), Processes(2), {"plant.b": values}, seeds=2, piece=3)
    table = result.table
    assert table["status"].tolist() == ["ok", "ok", "failed", "failed", "failed", "failed", "ok", "ok"]
    reasons = table["reason"]
    assert (reasons[table["status"] == "ok"] == "").all()
    assert f"(seed {table['seed'][2]}, plant.b = {ways['SEGFAULT']})" in reasons[2]
    assert "segmentation fault (SIGSEGV)" in reasons[3]
    assert "exit code 3" in reasons[4]
    good = made(car(path), Threads(1), {"plant.b": [50.0, 60.0]}, seeds=2)
    for name in ("plant.v", "sensors.y"):
        same_bits(result.dataset[name].values[[0, 1, 6, 7]], good.dataset[name].values)
        assert np.isnan(result.dataset[name].values[2:6]).all()
    same_bits(table["size"].to_numpy()[[0, 1, 6, 7]], good.table["size"].to_numpy())
    assert living() <= before


def test_a_step_that_does_not_end_reaches_the_time_limit(lying):
    path, ways = lying("2.0")
    began = time.monotonic()
    points = {"plant.b": [50.0, ways["ENDLESS"]]}
    table = made(car(path), Processes(1), points, seeds=1, time_limit=0.5, piece=1).table
    assert table["status"].tolist() == ["ok", "failed"]
    assert "time limit of 0.5 s" in table["reason"][1]
    assert time.monotonic() - began < 60.0
