"""Campaigns on a Dask cluster of real processes: what is killed in the middle, workers or the client, changes no number."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim import DaskCluster, Threads
from bayesftc.cosim.base.announcing import SENTENCE
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.cosim.errors import BayesFTCError, ModelError

pytest.importorskip("distributed", reason="needs the package distributed")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
HOST = "127.0.0.1"


def started(*command, cache):
    environment = {**os.environ, "BAYESFTC_CACHE": str(cache), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "distributed.cli." + command[0], *command[1:]],
        env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


class Cluster:
    """A scheduler and workers, each a process of its own, with a cache of their own as on another machine."""

    def __init__(self, folder):
        self._folder, self._file = folder, folder / f"{uuid.uuid4().hex}.json"
        self.scheduler = started(
            "dask_scheduler", "--host", HOST, "--port", "0", "--no-dashboard", "--dashboard-address", f"{HOST}:0",
            "--scheduler-file", str(self._file), cache=folder,
        )  # fmt: skip
        end = time.monotonic() + 60
        while not self._file.exists() or not self._file.read_text().endswith("}"):
            assert time.monotonic() < end
            time.sleep(0.05)
        self.address = json.loads(self._file.read_text())["address"]
        self.workers = [self.worker(i) for i in range(2)]

    def worker(self, number):
        return started(
            "dask_worker", self.address, "--host", HOST, "--nthreads", "1", "--no-dashboard", "--no-nanny",
            "--memory-limit", "0", "--local-directory", str(self._folder / f"worker{number}"), cache=self._folder / "cache",
        )  # fmt: skip

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of the cluster; the cache has compiled code, as compiling takes longest, but no FMU."""
    folder = tmp_path_factory.mktemp("cluster")
    (folder / "cache").mkdir()
    (folder / "cache" / "compiled").symlink_to(cosim_cache("compiled"))
    return folder


def cosim_cache(kind):
    from bayesftc.cosim.base.cache import cache_directory

    return cache_directory(kind)


@pytest.fixture
def cluster(folder):
    cluster = Cluster(folder)
    yield cluster
    cluster.close()


@pytest.mark.slow
def test_workers_need_no_file_of_the_clients(cluster, folder, car, tmp_path, same_bits):
    own = tmp_path / "own.fmu"
    shutil.copyfile(fmus.path("CruiseControl"), own)
    other = shutil.copyfile(fmus.path("CruiseControl", fmi="3.0"), tmp_path / "other.fmu")

    def loop(path, isolate):
        return car(path, isolate=isolate)

    points = cosim.Points([{"path": str(own), "isolate": True}, {"path": str(other), "isolate": False}])
    campaign = cosim.Campaign(loop, duration=0.4, grid=points, seeds=2, record=["plant.v"], piece=3)
    by_blocks = cosim.Campaign(car(own), duration=0.4, grid={"plant.b": [50.0, 60.0]}, record=["plant.v"])
    expected = [c.run(executor=Threads(1)).dataset["plant.v"].values for c in (campaign, by_blocks)]
    hidden = tmp_path / "hidden"
    executor = DaskCluster(cluster.address)
    parcels = (
        executor.run(campaign.job, campaign.job.plan.pieces),
        executor.run(by_blocks.job, by_blocks.job.plan.pieces),
    )
    for outcomes, values in zip(parcels, expected, strict=True):
        first = next(outcomes)  # by now all is on its way
        for path in (own, other):
            path.rename(hidden.with_suffix(path.suffix + path.name))
        found = {o.piece.begin: o for o in (first, *outcomes)}
        for path in (own, other):
            hidden.with_suffix(path.suffix + path.name).rename(path)
        assert all(status == "ok" for o in found.values() for status in o.status), found
        same_bits(np.concatenate([found[begin].signals["plant.v"] for begin in sorted(found)]), values)
    assert {path.name for path in (folder / "cache" / "shipped").glob("*/*")} == {"own.fmu", "other.fmu"}


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_run(cluster, car, living, same_bits):
    campaign = cosim.Campaign(car(), duration=20.0, seeds=80, record=["plant.v"], piece=4)

    def kill(done, of, failed):
        if done == 12:
            cluster.workers[0].kill()

    result = campaign.run(executor=DaskCluster(cluster.address), progress=kill)
    assert set(result.table["status"]) == {"ok"}
    same_bits(result.dataset["plant.v"].values, campaign.run(executor=Threads(1)).dataset["plant.v"].values)
    cluster.workers[1].kill()
    cluster.workers[1].wait()
    end = time.monotonic() + 10
    while living() - {cluster.scheduler.pid}:  # the processes that the workers have started
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.slow
def test_a_run_that_takes_its_workers_down_has_failed(cluster, car):
    """Such as one that needs more memory than a machine has."""

    points = {"law.offset": [10_000.0, 90_000.0]}
    slow, fast = (
        cosim.Campaign(car(), duration=0.4, grid=points, record=["plant.v"]).run().dataset["plant.v"].values[:, -1]
    )
    limit = float(slow + fast) / 2

    def greedy(result):
        if result["plant.v"][-1] > limit:  # as the system does: not its own process, but the one that has started it
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(60)
        return 1.0

    campaign = cosim.Campaign(car(), duration=0.4, grid=points, seeds=2, record=["plant.v"], metrics=[greedy], piece=4)
    stopped = False

    def tend():
        while not stopped:
            for i, worker in enumerate(cluster.workers):
                if worker.poll() is not None:
                    cluster.workers[i] = cluster.worker(i)
            time.sleep(0.1)

    thread = threading.Thread(target=tend)
    thread.start()
    try:
        table = campaign.run(executor=DaskCluster(cluster.address)).table
    finally:
        stopped = True
        thread.join()
    assert table["status"].tolist() == ["ok", "ok", "failed", "failed"]
    assert "has ended several workers of the Dask cluster" in table["reason"][2]


@pytest.mark.slow
def test_the_connection_to_the_scheduler(cluster, car, monkeypatch):
    monkeypatch.setattr("bayesftc.cosim.campaign.executors.dask.CONNECTING", 2)
    campaign = cosim.Campaign(car(), duration=20.0, seeds=2000, record=["plant.v"], piece=4)
    with pytest.raises(BayesFTCError, match=r"connection to the Dask scheduler was lost .* resume the campaign"):
        campaign.run(executor=DaskCluster(cluster.address), progress=lambda done, *_: done and cluster.scheduler.kill())
    with pytest.raises(BayesFTCError, match=r"There is no Dask scheduler at '.*start one with: dask scheduler"):
        campaign.run(executor=DaskCluster(cluster.address))
    with pytest.raises(ModelError, match="workers= is for a cluster on this machine"):
        DaskCluster(cluster.address, workers=2)


@pytest.mark.parametrize("address", ["127.0.0.1", "", "tcp://10.0.0.1", "tcp://", "a b:1"])
def test_an_address_without_a_port_is_refused_at_once(address):
    with pytest.raises(ModelError, match=r"address is '.*with its port, such as tcp://10\.0\.0\.1:8786"):
        DaskCluster(address)


NO_KIND = """
from bayesftc import cosim
diagram = cosim.Diagram(dt=0.1)
diagram.add(cosim.Sine(amplitude=1.0, period=1.0), "sine")
try:
    cosim.Campaign(diagram, duration=0.1).run(executor=cosim.DaskCluster("nonsense://x:1"))
except cosim.BayesFTCError as error:
    print(error)
"""


@pytest.mark.slow
def test_an_address_of_no_kind_that_dask_knows_leaves_no_client_behind():
    """One that is half made is closed when Python ends: after 20 seconds, with a traceback."""
    done = subprocess.run([sys.executable, "-c", NO_KIND], capture_output=True, text=True, timeout=100, check=True)
    assert "There is no Dask scheduler at 'nonsense://x:1' (unknown address scheme 'nonsense'" in done.stdout
    said = [line for line in done.stderr.splitlines() if not line.startswith("Making 1 run.")]  # on a busy machine
    assert said in ([], [SENTENCE])  # the first run on a machine compiles, and says so


CLIENT = """
import pickle, sys
from bayesftc import cosim
campaign, store, address = pickle.load(open(sys.argv[1], "rb"))
campaign.run(store, executor=cosim.DaskCluster(address), progress=lambda *counts: print(*counts, flush=True))
"""


@pytest.mark.slow
def test_the_drill(cluster, car, lying, tmp_path, same_bits):
    """One worker is killed in the middle, then the client: started again, that fills the store as an undisturbed run does."""
    pytest.importorskip("zarr", reason="needs the package zarr")
    path, ways = lying("2.0")
    points = {
        "plant.b": {"well": 50.0, "error": ways["ERROR"], "infinite": -1e30, "heavy": 60.0},
        "freeze.start": [0.2, 5.0],
    }
    metrics = [cosim.RMSE("plant.v", name="size")]
    campaign = cosim.Campaign(
        car(path),
        duration=4.0,
        grid=points,
        seeds=10,
        record=["plant.v", "law.y"],
        metrics=metrics,
        piece=4,
    )
    campaign.run(tmp_path / "undisturbed", executor=Threads(2))
    (tmp_path / "work").write_bytes(pickle.dumps((campaign, tmp_path / "store", cluster.address)))
    command = [sys.executable, "-c", CLIENT, str(tmp_path / "work")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
        for line in client.stdout:
            done = int(line.split()[0])
            if done == 8:
                cluster.workers[0].kill()
            if done >= 24:
                client.kill()
    assert client.wait() == -signal.SIGKILL
    kept = 4 * len(CampaignStore.open(tmp_path / "store").done())
    assert 24 <= kept < campaign.runs == 80
    again = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    told = [[int(count) for count in line.split()] for line in again.stdout.splitlines()]
    assert told[0][0] == kept
    assert told[-1] == [80, 80, 40]
    one, other = (CampaignStore.open(tmp_path / name) for name in ("undisturbed", "store"))
    a, b = one.table(), other.table()
    assert list(a) == list(b)
    for name in a:
        if a[name].dtype == np.float64:
            same_bits(a[name].to_numpy(), b[name].to_numpy(), name)
        else:
            assert a[name].tolist() == b[name].tolist(), name
    assert a["run"].tolist() == list(range(80))
    assert one.dataset().identical(other.dataset())
    for name in ("plant.v", "law.y"):
        same_bits(one.dataset()[name].values, other.dataset()[name].values, name)
    assert {p.name for p in (tmp_path / "store").iterdir()} == {p.name for p in (tmp_path / "undisturbed").iterdir()}
