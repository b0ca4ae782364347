"""Stored campaigns: what is written is read again, by zarr and pandas too; a piece is there whole or not at all."""

import warnings

import numpy as np
import pandas as pd
import xarray as xr

from bayesftc.cosim._campaign.plan import FAILED, OK, Outcome, Plan
from bayesftc.cosim._campaign.store import PENDING, CampaignStore

TIME = np.arange(5) * 0.1
SIGNALS = {"plant.v": ((), "m/s"), "filter.x/y": ((2,), None), "filter.P": ((2, 3), None)}
POINTS = (
    {"a.b": 1.5, "kind": "none", "on": True, "n": 1, "seed": None},
    {"a.b": np.float64(2.5), "kind": "bias", "on": False, "n": np.int64(2), "seed": 3},
)
PLAN = Plan(POINTS, ((1, 2, 3), (1, 2, 3, 4)), 3)


def outcome(piece, signals=SIGNALS, rows=5, fail=(), salt=0, metrics=("m.1", "m.2")):
    """Return numbers that say of themselves which run, row and element they are; those of failed runs end with NaN."""
    runs = np.arange(piece.begin, piece.end)
    failed = np.isin(runs, list(fail))
    values = {}
    for k, (name, (shape, _)) in enumerate(signals.items()):
        row = np.arange(rows)[None, :] / 64 + runs[:, None] + 1000 * (k + 1 + salt)
        element = np.arange(np.prod(shape, dtype=int)).reshape(shape) * 1e6
        values[name] = row.reshape(*row.shape, *(1 for _ in shape)) + element
        values[name][failed, rows // 2 :] = np.nan
    numbers = {name: np.where(failed, np.nan, runs / (k + 3) + salt) for k, name in enumerate(metrics)}
    status = tuple(FAILED if f else OK for f in failed)
    reasons = tuple("the plant gave NaN" if f else "" for f in failed)
    return Outcome(piece, numbers, values, status, reasons, np.where(failed, rows // 2 - 1, rows - 1), 0.25)


def create(path, plan=PLAN, **changes):
    arguments = {"description": {"scenario": "car"}, "signals": SIGNALS, "time": TIME, "metrics": ("m.1", "m.2")}
    return CampaignStore.create(path, plan=plan, **(arguments | changes))


def resume(path, plan=PLAN, **changes):
    arguments = {"description": {"scenario": "car"}, "signals": SIGNALS, "time": TIME, "metrics": ("m.1", "m.2")}
    return CampaignStore.resume(path, plan=plan, **(arguments | changes))


def test_what_is_written_is_read_again(tmp_path):
    with create(tmp_path / "s") as store:
        for piece in (PLAN.pieces[2], PLAN.pieces[0]):
            store.write(outcome(piece, fail={1}))
        assert store.done() == {0, 2}
        assert store.failed() == [1]
        assert not store.whole
    store = CampaignStore.open(tmp_path / "s")
    table = store.table()
    assert table.columns.tolist() == [
        *("run", "point", "seed", "a.b", "kind", "on", "n", "factor:seed", "status", "reason", "steps", "m.1", "m.2")
    ]
    assert table["run"].tolist() == [0, 1, 2, 6]
    assert table["point"].tolist() == [0, 0, 0, 1]
    assert table["seed"].tolist() == [1, 2, 3, 4]
    assert table["kind"].tolist() == ["none"] * 3 + ["bias"]
    assert table["n"].tolist() == [1, 1, 1, 2]
    assert table["on"].dtype == bool
    assert table["a.b"].tolist() == [1.5, 1.5, 1.5, 2.5]
    assert table["status"].tolist() == [OK, FAILED, OK, OK]
    assert table["steps"].tolist() == [4, 1, 4, 4]
    assert table["reason"].tolist() == ["", "the plant gave NaN", "", ""]
    np.testing.assert_array_equal(table["m.2"], [0, np.nan, 2 / 4, 6 / 4])
    np.testing.assert_array_equal(table["factor:seed"], [np.nan] * 3 + [3])
    data = store.dataset()
    assert data["status"].values.tolist() == [OK, FAILED, OK, PENDING, PENDING, PENDING, OK]
    assert data["plant.v"].attrs == {"units": "m/s"}
    assert data["time"].attrs == {"units": "s"}
    np.testing.assert_array_equal(data["time"], TIME)
    for piece, signals in store.pieces_of_signals():
        for name, expected in outcome(piece, fail={1}).signals.items():
            np.testing.assert_array_equal(signals[name], expected)
            np.testing.assert_array_equal(data[name][piece.begin : piece.end], expected)
    for name in SIGNALS:
        assert np.isnan(data[name][3:6]).all()


def test_other_programs_read_it(tmp_path):
    with create(tmp_path / "s") as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece))
        store.finish()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        raw = xr.open_zarr(tmp_path / "s" / "signals.zarr", chunks=None)
    np.testing.assert_array_equal(raw["plant.v"][3:6], outcome(PLAN.pieces[1]).signals["plant.v"])
    assert raw["kind"].values.tolist() == ["none"] * 3 + ["bias"] * 4
    assert {"run", "time", "point", "seed", "a.b", "kind", "on", "n", "factor:seed"} == set(raw.coords)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "s" / "runs.parquet"), store.table())
