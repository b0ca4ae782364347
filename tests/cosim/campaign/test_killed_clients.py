"""A client that is killed at any moment leaves no process; what it leaves of folders the next one sweeps."""

import importlib.util
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bayesftc.cosim import DaskCluster, Processes
from bayesftc.cosim.base.temporary import temporary_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
DISTRIBUTED = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="needs the package distributed"
)
EXECUTORS = [
    pytest.param(Processes(3), id="Processes"),
    pytest.param(DaskCluster(workers=3), id="DaskCluster", marks=DISTRIBUTED),
]
DEADLINE = 10.0
"""Seconds in which all must be gone."""

CLIENT = """
import sys
from bayesftc import cosim
diagram = cosim.Diagram(dt="1/1000")
diagram.add(cosim.Gaussian(std=1.0), "noise")
seeds, duration = int(sys.argv[2]), float(sys.argv[3])
campaign = cosim.Campaign(diagram, duration=duration, seeds=seeds, metrics=[cosim.Mean("noise.y")], piece=1)
campaign.run(executor=eval("cosim." + sys.argv[1]), progress=lambda *counts: print(*counts, flush=True))
"""


def started(executor, environment, seeds, duration):
    return subprocess.Popen(
        [sys.executable, "-c", CLIENT, repr(executor), str(seeds), str(duration)],
        env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def kill_while_it_begins(executor, environment, living, random):
    """Kill a client as soon as it has started some of its processes, or a moment later."""
    with started(executor, environment, 10_000, 2000.0) as client:
        while len(living()) < random.choice([2, 3, 4]):
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 1.0))
        client.kill()
    return living()


def kill_while_it_runs(executor, environment, living, random):
    """Kill a client once it has its first outcomes, while all workers have runs that take long."""
    with started(executor, environment, 10_000, 2000.0) as client:
        while int(next(client.stdout).split()[0]) < 2:
            pass
        assert len(living()) > 3
        time.sleep(random.uniform(0.0, 0.3))
        client.kill()
    return living()


def drill(executor, marked, kills):
    environment, living = marked
    folder = Path(environment["TMPDIR"])
    for number in range(kills):
        drawn = random.Random(number)
        kill = kill_while_it_runs if number % 2 else kill_while_it_begins
        kill(executor, environment, living, drawn)
        end = time.monotonic() + DEADLINE
        while left := living():
            assert time.monotonic() < end, (
                number,
                kill.__name__,
                [Path(f"/proc/{p}/cmdline").read_bytes() for p in left],
            )
            time.sleep(0.05)
        assert len(list(folder.iterdir())) <= 1, "what the kill before has left was not swept"
    with started(executor, environment, 2, 0.1) as client:
        assert client.stdout.readlines()[-1].split() == ["2", "2", "0"]
    assert client.returncode == 0
    assert not living()
    assert not list(folder.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("executor", EXECUTORS)
def test_a_killed_client_leaves_nothing(executor, marked):
    drill(executor, marked, kills=2)


@pytest.mark.slow
@pytest.mark.parametrize("executor", EXECUTORS)
def test_twenty_killed_clients_leave_nothing(executor, marked):
    drill(executor, marked, kills=20)


HOLDER = """
import sys, time
from pathlib import Path
from bayesftc.cosim.base.temporary import temporary_folder
with temporary_folder("bayesftc-drill-", Path(sys.argv[1])) as folder:
    (folder / "in it").mkdir()
    print(folder, flush=True)
    time.sleep(600)
"""


def test_only_folders_of_dead_processes_are_swept(tmp_path):
    (tmp_path / "bayesftc-drill-of-a-user").mkdir()  # as long a name as no temporary folder has
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "bayesftc-drill-abcdefgh").symlink_to(tmp_path / "elsewhere")
    kept = set(tmp_path.iterdir())
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as one:
        first = Path(one.stdout.readline().strip())
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
            second = Path(other.stdout.readline().strip())
            assert {first, second} == set(tmp_path.iterdir()) - kept
            one.kill()
            one.wait()
            with temporary_folder("bayesftc-drill-", tmp_path) as third:
                assert third.stat().st_mode & 0o777 == 0o700
                assert {second, third} == set(tmp_path.iterdir()) - kept
            other.kill()
    with temporary_folder("bayesftc-drill-", tmp_path):
        pass
    assert set(tmp_path.iterdir()) == kept


FORKING = """
import os, socket, time
from bayesftc.cosim.base.processes import start
ours, theirs = socket.socketpair()
process, _ = start("bayesftc.cosim.campaign.executors.child:main", [theirs.fileno()])
theirs.close()
if os.fork():
    print(process.pid, flush=True)
time.sleep(600)
"""


def test_a_fork_of_the_client_keeps_no_process_alive(marked):
    """It has copies of all that the client has open, the other end of what the processes listen to among them."""
    environment, living = marked
    command = [sys.executable, "-c", FORKING]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as client:
        worker = int(client.stdout.readline())
        forked = living() - {worker, client.pid}
        assert len(forked) == 1
        client.kill()
        end = time.monotonic() + DEADLINE
        while worker in living():
            assert time.monotonic() < end
            time.sleep(0.02)
        assert living() == forked
        os.kill(*forked, signal.SIGKILL)
