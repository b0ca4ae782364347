"""Without what Windows, and in part macOS, lack: everything is imported, runs go on, and what cannot be is told in a sentence."""

import os
import subprocess
import sys

import pytest
import readme

from bayesftc import cosim, fmus
from bayesftc.cosim.base import processes as child

HIDDEN = """
import os, signal, sys
for name in ("fcntl", "resource", "grp", "pwd", "termios"):
    sys.modules[name] = None
for module, names in (
    (os, "fork register_at_fork getpgrp getpgid killpg setsid waitid memfd_create O_ASYNC sched_getaffinity "
         "sched_setaffinity sched_getcpu getloadavg"),
    (signal, "SIGKILL SIGALRM SIGHUP SIGUSR1 SIGSTOP pthread_kill pthread_sigmask setitimer alarm sigwait"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
if hasattr(os, "process_cpu_count"):  # from Python 3.13 on, which asks what was taken away
    os.process_cpu_count = os.cpu_count
"""
ALL = """
import importlib, pkgutil
import bayesftc
names = [m.name for m in pkgutil.walk_packages(bayesftc.__path__, "bayesftc.") if not m.name.endswith("__main__")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""


def hidden(text, tmp_path):
    """Run a text in a Python that lacks them, and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", HIDDEN + text],
        env={**os.environ, "MPLBACKEND": "agg"}, cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_all_modules_can_be_imported(tmp_path):
    assert int(hidden(ALL, tmp_path)) > 300


@pytest.mark.slow
def test_the_first_example_of_the_readme_runs(tmp_path):
    text = next(block.text for block in readme.blocks() if block.language == "python")
    shown = hidden(text + "\nresult.save('run.npz')\nprint(len(result.time))", tmp_path)
    assert shown.splitlines()[-1] == "1001"
    assert (tmp_path / "run.npz").is_file()


@pytest.mark.slow
def test_a_campaign_runs_and_is_kept(tmp_path):
    pytest.importorskip("zarr", reason="needs the package zarr")
    text = """
from bayesftc import cosim
diagram = cosim.Diagram(dt=0.1)
diagram.add(cosim.Gaussian(std=1.0), "noise")
campaign = cosim.Campaign(diagram, duration=1.0, seeds=6, record=["noise.y"], metrics=[cosim.Mean("noise.y")])
print(set(campaign.run("kept").table["status"]))
"""
    assert hidden(text, tmp_path) == "{'ok'}"
    assert {path.name for path in tmp_path.iterdir()} == {"kept"}


@pytest.mark.parametrize(
    ("what", "sentence"),
    [
        (lambda run: run(cosim.Processes(1)), r"Worker processes need Linux or macOS .*use executor=Threads\(\)"),
        (
            lambda run: run(cosim.DaskCluster()),
            r"A Dask cluster on this machine needs Linux or macOS .*Threads\(\), or give",
        ),
        (
            lambda run: car(isolate=True).simulate(0.1),
            r"isolate=True needs Linux .*Leave it out to run the FMU in this",
        ),
    ],
    ids=["processes", "cluster", "isolation"],
)
def test_what_needs_processes_says_so_where_none_can_be_started(monkeypatch, what, sentence):
    monkeypatch.setattr(child.sys, "executable", "")
    campaign = cosim.Campaign(car(), duration=0.1, record=["car.v"])
    with pytest.raises(cosim.BayesFTCError, match=sentence):
        what(lambda executor: campaign.run(executor=executor))


def car(**options):
    diagram = cosim.Diagram(0.02)
    diagram.add(cosim.FMU(fmus.path("CruiseControl"), **options), "car")
    return diagram
