"""Stores of campaigns that are damaged: a sentence, or what was in them; never other numbers."""

import json
import shutil

import numpy as np
import pytest
from documents import LOOP
from mutations import damaged

from bayesftc.cosim.campaign.campaign import Campaign
from bayesftc.cosim.errors import StoreError

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
pytest.importorskip("jinja2", reason="reports need the extra 'campaign'")

from harness import Case

from bayesftc.cosim.campaign.store.folder import CampaignStore

pytestmark = pytest.mark.slow

FILE = """
scenario = "loop.toml"
seeds = 3
piece = 2
record = ["plant.y", "controller.x_hat"]
metrics = [{ kind = "rmse", signal = "plant.y", reference = "reference.y", name = "rmse" }]
[factors]
"faults[0].start" = [0.02, 0.1]
"""
ODD = (
    None,
    True,
    0,
    -1,
    1,
    7,
    10**30,
    1e300,
    "",
    "x",
    [],
    [0],
    [1, 1],
    {},
    "int64",
    "float32",
    "<f4",
    "zstd",
    "NaN",
    "gzip",
)


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Return the folders of a campaign that is whole, and of one of which two of three pieces are done."""
    from bayesftc.scenario.campaigns import described, load_campaign

    folder = tmp_path_factory.mktemp("stores")
    (folder / "loop.toml").write_text(LOOP)
    (folder / "file.toml").write_text(FILE)
    campaign: Campaign = load_campaign(folder / "file.toml")
    campaign.run(folder / "whole", description=described(folder / "file.toml", campaign))
    return folder


def read(path):
    """Return all numbers of a store as texts and arrays, as each of the ways to read it gives them."""
    store = CampaignStore.open(path)
    data = store.dataset().load()
    arrays = {name: np.asarray(data[name].values) for name in [*data.data_vars, *data.coords]}
    table = store.table()
    return arrays | {f"table {name}": table[name].to_numpy() for name in table}


def same(found, expected):
    """Return whether what was read of a store is right: of runs that it says to have, all numbers."""
    if found.keys() != expected.keys():
        return False
    done = found["status"] != "pending"
    for name, values in expected.items():
        whole = name == "time" or (name in found.keys() - {"status"} and name in ("run", "point", "seed"))
        rows = values if whole else values[done]
        other = found[name] if whole or name.startswith("table ") else found[name][done]
        if rows.shape != other.shape or (rows.astype(str) != other.astype(str)).any():
            return False
    return True


def odd_json(data, rng):
    """Return a JSON file in which one value is another, or is not there."""
    content, places = json.loads(data), []

    def collect(part):
        for key in list(part) if isinstance(part, dict) else range(len(part)):
            places.append((part, key))
            if isinstance(part[key], dict | list):
                collect(part[key])

    collect(content)
    part, key = places[int(rng.integers(len(places)))]
    if rng.random() < 0.3:
        del part[key]
    else:
        part[key] = ODD[int(rng.integers(len(ODD)))]
    return json.dumps(content).encode()


def damage(store, rng):
    """Damage one file of a store; return what was done."""
    files = sorted(path for path in store.rglob("*") if path.is_file())
    file = files[int(rng.integers(len(files)))]
    data, name = file.read_bytes(), str(file.relative_to(store))
    way = int(rng.integers(7))
    if file.suffix == ".json" and way < 4:
        file.write_bytes(odd_json(data, rng))
        return f"another value in {name}"
    if way == 0:
        file.unlink()
        return f"{name} is gone"
    if way == 1:
        file.write_bytes(data[: int(rng.integers(len(data) + 1))])
        return f"{name} is cut"
    if way == 2:
        file.unlink()
        file.mkdir()
        return f"{name} is a folder"
    if way == 3:
        file.write_bytes((store / "campaign.json").read_bytes()[:-1])
        return f"{name} is another file"
    if way == 4:
        flipped = bytearray(data)
        flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(flipped)
        return f"a bit of {name} is another"
    file.write_bytes(damaged(data, rng))
    return f"{name} has other bytes"


def trouble(line, store, expected):
    """Return what is wrong with how a damaged store is read and reported."""
    try:
        if not same(read(store), expected):
            return "other numbers"
    except StoreError as error:
        if str(error)[-1] not in ".?":
            return f"no sentence: {error}"
    except Exception as error:  # noqa: BLE001 - whatever it is
        return f"{type(error).__name__}: {error}"
    files = {str(path.relative_to(store)): path for path in store.rglob("*") if path.is_file()}
    outcome = line.run(Case(("report", str(store), "--out", "page.html"), leaves=("page.html",)))
    assert {str(path.relative_to(store)) for path in store.rglob("*") if path.is_file()} == files.keys()
    return outcome.wrong and f"{outcome.wrong}: {outcome.err[-800:]}"


@pytest.mark.parametrize("count", [1, pytest.param(150, marks=pytest.mark.slow)])
def test_damaged_stores(line, stores, chance, tmp_path, count):
    expected, found = read(stores / "whole"), []
    for i in range(count):
        store = tmp_path / f"store{i}"
        shutil.copytree(stores / "whole", store)
        what = damage(store, chance)
        wrong = trouble(line, store, expected)
        if wrong:
            found.append(f"{i}, {what}: {wrong}")
        shutil.rmtree(store)
    assert not found, "\n".join(found)
