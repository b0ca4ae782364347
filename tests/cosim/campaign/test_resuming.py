"""Campaigns in stores go on where they stopped, and make failed runs again where that is asked for."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Threads
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.cosim.errors import ModelError, StoreError

pytest.importorskip("zarr", reason="needs the package zarr")


@pytest.fixture
def campaign(car):
    """Return a function that returns a campaign of 36 runs, 12 of which are refused by the plant."""

    def campaign(**options):
        points = {"plant.b": [50.0, np.nan, 60.0], "freeze.start": [0.2, 0.4]}
        settings = {"duration": 0.6, "seeds": 6, "metrics": [cosim.RMSE("plant.v", name="size")], "piece": 4}
        return cosim.Campaign(car(), grid=points, record=["plant.v"], **settings | options)

    return campaign


def same(result, other, same_bits):
    a, b = result.table, other.table
    for name in a:
        if a[name].dtype == np.float64:
            same_bits(a[name].to_numpy(), b[name].to_numpy(), name)
        else:
            assert a[name].tolist() == b[name].tolist(), name
    same_bits(result.dataset["plant.v"].values, other.dataset["plant.v"].values)


class Enough(Exception):
    pass


def until(runs, told):
    def progress(*counts):
        told.append(counts)
        if counts[0] >= runs:
            raise Enough

    return progress


def test_a_store_holds_what_memory_would(campaign, tmp_path, same_bits):
    stored = campaign().run(tmp_path / "store")
    same(campaign().run(), stored, same_bits)
    assert stored.metadata["executor"].startswith("Threads: ")
    told = []
    again = campaign().run(tmp_path / "store", progress=lambda *counts: told.append(counts))
    assert told == [(36, 36, 12)]
    same(stored, again, same_bits)
    assert "executor" not in again.metadata  # nothing was to be done
    assert CampaignStore.open(tmp_path / "store").metadata.description["blocks"]["law"].startswith("Gain(")


def test_it_goes_on_where_it_stopped(campaign, tmp_path, same_bits):
    begun, rest = [], []
    with pytest.raises(Enough):
        campaign().run(tmp_path / "store", executor=Threads(1), progress=until(12, begun))
    assert begun == [(0, 36, 0), (4, 36, 0), (8, 36, 0), (12, 36, 0)]
    result = campaign(time_limit=60.0).run(
        tmp_path / "store", executor=Threads(1), progress=lambda *told: rest.append(told)
    )
    assert rest[0] == (12, 36, 0)
    assert rest[-1] == (36, 36, 12)
    assert len(rest) == 7
    same(campaign().run(), result, same_bits)


def test_failed_runs_are_made_again(car, tmp_path, same_bits):
    allowed = tmp_path / "allowed"

    def flaky(mass):
        diagram = car(parameters={"m": mass, "b": 50.0 if allowed.exists() or mass < 100.0 else np.nan})
        return diagram

    def campaign():
        return cosim.Campaign(
            flaky, duration=0.6, grid={"mass": [90.0, 110.0]}, seeds=5, record=["plant.v"], piece=4,
            metrics=[cosim.RMSE("plant.v", name="size")],
        )  # fmt: skip

    begun, told = [], []
    with pytest.raises(Enough):
        campaign().run(tmp_path / "store", executor=Threads(1), progress=until(8, begun))
    assert begun[-1] == (8, 10, 3)
    allowed.touch()
    result = campaign().run(tmp_path / "store", progress=lambda *counts: told.append(counts), retry_failed=True)
    assert told[0] == (5, 10, 0)
    assert told[-1] == (10, 10, 0)
    assert set(result.table["status"]) == {"ok"}
    same(campaign().run(), result, same_bits)
    with pytest.raises(ModelError, match="retry_failed=True needs a store"):
        campaign().run(retry_failed=True)


def test_another_campaign_is_refused(campaign, tmp_path, car):
    campaign().run(tmp_path / "store")
    with pytest.raises(StoreError, match=r"another one: description.duration is '3/5 s' in the store and '2/5 s' now"):
        campaign(duration=0.4).run(tmp_path / "store")
    with pytest.raises(StoreError, match="has seeds=6, not seeds=7"):
        campaign(seeds=7).run(tmp_path / "store")
    with pytest.raises(StoreError, match=r"another one: description\.question"):
        campaign().run(tmp_path / "store", description={"question": "which?"})


FULL = """
import pickle, resource, signal, sys
from bayesftc import cosim
campaign, store, room = pickle.load(open(sys.argv[1], "rb"))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a file that may not grow is what a full disk is to a writer
resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
try:
    campaign.run(store, executor=cosim.Threads(1))
except cosim.StoreError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
def test_a_full_disk_stops_it_with_a_sentence(car, tmp_path, same_bits):
    campaign = cosim.Campaign(car(), duration=8.0, seeds=300, record=["plant.v"], piece=100)
    (tmp_path / "work").write_bytes(pickle.dumps((campaign, tmp_path / "store", 150_000)))
    command = [sys.executable, "-c", FULL, str(tmp_path / "work")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=os.environ, check=True)
    assert "Nothing more can be written to the campaign" in done.stdout
    assert "resume it" in done.stdout
    result = campaign.run(tmp_path / "store")
    same(campaign.run(), result, same_bits)
