"""Stored campaigns: what is written is read again, by zarr and pandas too; what is no store, or another one, is said."""

import hashlib
import json
import os
import sys
import tempfile
import warnings
from contextlib import ExitStack
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings, strategies as st
from stored import PLAN, POINTS, SIGNALS, TIME, assert_piece, assert_whole, create, outcome, resume

from bayesftc.cosim import BayesFTCError, ModelError, StoreError, UnknownNameError
from bayesftc.cosim.campaign.designs.plan import FAILED, OK, Piece, Plan
from bayesftc.cosim.campaign.store import chunks
from bayesftc.cosim.campaign.store.folder import PENDING, CampaignStore


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


def test_what_is_read_of_it_may_be_changed_and_copied(tmp_path):
    with create(tmp_path / "s") as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece))
        data, copy = store.dataset(), store.dataset().copy(deep=True)
        data["plant.v"][4] = 0.0
        assert (data["plant.v"][4].values == 0.0).all()
        assert (data["plant.v"][3].values == outcome(PLAN.pieces[1]).signals["plant.v"][0]).all()
        np.testing.assert_array_equal(
            copy["plant.v"][3:6], store.dataset()["plant.v"][3:6]
        )  # what is stored is as it was


# Any campaign


VALUES = st.one_of(st.integers(-(2**70), 2**70), st.floats(), st.booleans(), st.text(max_size=5), st.none())
NAMES = st.text(st.sampled_from("ab_./% é[]:"), min_size=1, max_size=8).map(lambda text: f"x{text}")


@st.composite
def campaigns(draw):
    factors = draw(st.lists(NAMES, max_size=3, unique=True))
    points = draw(st.lists(st.fixed_dictionaries(dict.fromkeys(factors, VALUES)), min_size=1, max_size=4))
    seeds = [tuple(draw(st.lists(st.integers(0, 2**63 - 1), max_size=4))) for _ in points]
    plan = Plan(tuple(points), tuple(seeds), draw(st.integers(1, 5)))
    signals = draw(
        st.dictionaries(NAMES, st.tuples(st.lists(st.integers(1, 3), max_size=2).map(tuple), st.none()), max_size=3)
    )
    return (
        plan,
        signals,
        draw(st.integers(1, 6)),
        draw(st.randoms(use_true_random=False)),
        draw(st.sampled_from([64, 1 << 27])),
    )


@settings(max_examples=6, deadline=None)
@given(campaigns())
def test_any_campaign_in_any_order_and_any_number_of_sessions(campaign):
    plan, signals, rows, chance, largest = campaign

    def of(piece, salt=0):
        return outcome(piece, signals, rows, [run for run in range(plan.runs) if run % 3 == 1 and not salt], salt)

    own = {"signals": signals, "time": np.arange(rows) / 8}
    with ExitStack() as around:
        folder = around.enter_context(tempfile.TemporaryDirectory())
        around.enter_context(mock.patch.object(chunks, "LARGEST", largest))
        around.enter_context(mock.patch.object(os, "fsync"))  # which takes its time
        path = Path(folder) / "store"
        store, left, replaced = create(path, plan, **own), list(plan.pieces), set()
        chance.shuffle(left)
        while left:
            if chance.random() < 0.3:
                store.close()
                store = resume(path, plan, **own)
            store.write(of(left.pop()))
            assert store.done() == {p.index for p in plan.pieces} - {p.index for p in left}
        assert store.failed() == [run for run in range(plan.runs) if run % 3 == 1]
        with store:
            if chance.random() < 0.5:
                store.finish()
            for piece in plan.pieces:
                if chance.random() < 0.5:
                    store.replace([of(Piece(0, run, run + 1), salt=7) for run in range(piece.begin, piece.end)])
                    replaced.add(piece.index)
            store.finish()
        store = CampaignStore.open(path)
        assert not list((path / "runs").iterdir())
        assert_whole(store, plan, lambda piece: of(piece, 7 * (piece.index in replaced)))
        table, (points, seeds) = store.table(), plan.of_runs()
        assert table["point"].tolist() == points.tolist()
        assert table["seed"].tolist() == seeds.tolist()
        assert store.seconds == pytest.approx(0.25 * sum(1 + len(p) * (p.index in replaced) for p in plan.pieces))


def test_columns_have_one_type_and_missing_values(tmp_path):
    points = (
        {"label": "fixed", "number": 1, "big": 2**63, "either": True, "none": None},
        {"label": None, "number": None, "big": 1, "either": 0.5, "none": None},
        {"number": np.float32(0.5), "big": 1, "either": "off", "none": None},
    )
    plan = Plan(points, ((1,),) * 3, 2)
    with create(tmp_path / "s", plan, signals={}, metrics=()) as store:
        for piece in plan.pieces:
            store.write(outcome(piece, {}, metrics=()))
        table = store.table()
        assert table["label"].isna().tolist() == [False, True, True]
        np.testing.assert_array_equal(table["number"], [1, np.nan, 0.5])
        assert table["big"].tolist() == [2.0**63, 1, 1]
        assert table["either"].tolist() == ["True", "0.5", "off"]
        assert table["none"].isna().all()
        assert store.dataset()["status"].values.tolist() == [OK] * 3
        assert not (tmp_path / "s" / "signals.zarr").exists()
    with pytest.raises(ModelError, match=r"'f' has the value \(1, 2\), which a table cannot hold; give it a label"):
        create(tmp_path / "t", Plan(({"f": (1, 2)},), ((1,),), 1))
    store = create(tmp_path / "t", Plan(({"f": (1, 2)},), ((1,),), 1), labels=[{"f": "both"}])
    assert store.plan.points == ({"f": "both"},)
    store.close()


def test_names_that_every_campaign_has_are_refused_and_factors_make_way(tmp_path):
    with pytest.raises(StoreError, match="metric cannot be called 'status'"):
        create(tmp_path / "s", metrics=("status",))
    with pytest.raises(StoreError, match="signal cannot be called 'time'"):
        create(tmp_path / "s", signals={"time": ((), None)})
    plan = Plan(({"plant.v": 1.0, "m.1": 2.0},), ((1,),), 1)
    with create(tmp_path / "s", plan) as store:
        store.write(outcome(plan.pieces[0]))
        assert store.table()["factor:m.1"].tolist() == [2.0]
        assert store.dataset()["factor:plant.v"].item() == 1.0


# What is no store


def test_folders_that_are_no_store_say_so(tmp_path):
    with pytest.raises(StoreError, match="There is no campaign"):
        CampaignStore.open(tmp_path / "none")
    with pytest.raises(StoreError, match=r"is not a stored campaign, because it has no campaign.json"):
        CampaignStore.open(tmp_path)
    create(tmp_path / "s").close()
    with pytest.raises(StoreError, match=r"There is already a campaign in .*; resume it"):
        create(tmp_path / "s")
    with pytest.raises(StoreError, match="is not empty; choose another folder"):
        create(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="is a file; choose another folder"):
        create(tmp_path / "file")
    with pytest.raises(StoreError, match=r"cannot be stored in .* \((File exists|Not a directory)\)"):
        create(tmp_path / "file" / "s")
    (tmp_path / "empty").mkdir()
    create(tmp_path / "empty").close()
    create(tmp_path / "new" / "folders").close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "file", "new", "s"]  # nothing that was begun


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"format": "other"}', '{"format": "bayesftc-campaign", "version": 1}']
)
def test_damaged_metadata_is_said(tmp_path, text):
    create(tmp_path / "s").close()
    (tmp_path / "s" / "campaign.json").write_text(text)
    with pytest.raises(StoreError, match="is damaged, or of another program"):
        CampaignStore.open(tmp_path / "s")


def test_a_store_of_a_later_version_is_refused(tmp_path):
    create(tmp_path / "s").close()
    path = tmp_path / "s" / "campaign.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 2, "points": {"other": "form"}}))
    with pytest.raises(StoreError, match=r"by a later version of bayesftc .*; update bayesftc to read it"):
        CampaignStore.open(tmp_path / "s")


@pytest.mark.parametrize(
    ("module", "signals"), [("pyarrow", {}), ("zarr", SIGNALS), ("numcodecs", SIGNALS), ("pyarrow.parquet", {})]
)
def test_packages_that_are_missing_are_named_before_anything_is_made(tmp_path, monkeypatch, module, signals):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(BayesFTCError, match=r"not installed: pip install 'bayesftc\[campaign\]'"):
        create(tmp_path / "s", signals=signals)
    assert not list(tmp_path.iterdir())


# Resuming


def test_another_campaign_is_refused_and_what_differs_is_said(tmp_path):
    path, more = tmp_path / "s", {"description": {"scenario": "car", "grid": {"a.b": [1.5, 2.5]}, "nan": np.nan}}
    create(path, **more).close()
    resume(path, **more).close()
    other = {"description": {"scenario": "car", "grid": {"a.b": [1.5, 2.6]}, "nan": np.nan}}
    with pytest.raises(
        StoreError, match=r"another one: description.grid.a.b\[1\] is 2.5 in the store and 2.6 now. Choose"
    ):
        resume(path, **other)
    with pytest.raises(StoreError, match=r"description.grid is .* in the store and absent now; description.nan"):
        resume(path)
    for changes, words in (
        ({"plan": Plan(POINTS, ((1, 2, 3), (1, 2, 3, 5)), 3)}, r"seeds\[1\]\[3\] is 4 in the store and 5 now"),
        ({"plan": Plan(POINTS[:1], ((1, 2, 3),), 3)}, r"points is \[.* in the store"),
        ({"metrics": ["m.1", "m.3"]}, r"metrics\[1\] is 'm.2' in the store and 'm.3' now"),
        ({"time": TIME + 1e-9}, "times is"),
        (
            {"signals": {**SIGNALS, "plant.v": ((), "km/h")}},
            "signals.plant.v.unit is 'm/s' in the store and 'km/h' now",
        ),
        ({"fmus": {"00": "car.fmu"}}, "fmus.00 is absent in the store and 'car.fmu' now"),
        (
            {"plan": Plan(tuple({**point, "m": 1.0} for point in POINTS), PLAN.seeds, 3)},
            r"it varies m only now\. Choose",
        ),
    ):
        with pytest.raises(StoreError, match=words):
            resume(path, **(more | changes))
    long, longer = ({"description": {"controller": "x" * 300 + end}} for end in ("1.0)", "2.0)"))
    create(tmp_path / "long", **long).close()
    with pytest.raises(StoreError, match=r"controller is \.\.\.'xx+1\.0\)' in the store and \.\.\.'xx+2\.0\)' now"):
        resume(tmp_path / "long", **longer)
    finer = resume(path, Plan(POINTS, PLAN.seeds, 2), **more)  # how the runs are cut is the store's to say
    assert finer.plan.pieces == PLAN.pieces
    finer.close()


def test_another_machine_is_a_warning_and_is_noted(tmp_path):
    create(tmp_path / "s").close()
    path = tmp_path / "s" / "campaign.json"
    text = json.loads(path.read_text())
    assert set(text["environment"]["versions"]) == {"python", "bayesftc", "numpy", "scipy", "numba", "fmpy"}
    del text["sha256"]  # as of a store of before there was one
    text["environment"]["libc"], text["environment"]["processor"] = "glibc 1.0", "abacus"
    path.write_text(json.dumps(text))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # these compute the same digits
        resume(tmp_path / "s").close()
    text["environment"]["versions"]["numba"] = "0.1"
    text["environment"]["digits"]["functions"] = "0"
    path.write_text(json.dumps(text))
    here = (
        r"\(.*numba 0.1 before, [^;]* now; other last digits of functions \(C library glibc 1.0 before, [^;]* now\)\)"
    )
    with pytest.warns(UserWarning, match=here):
        store = resume(tmp_path / "s")
    store.write(outcome(PLAN.pieces[0]))
    store.close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the same environment as last time
        resume(tmp_path / "s").close()
    (resumed,) = CampaignStore.open(tmp_path / "s").metadata.resumed
    assert resumed["done"] == 0
    assert resumed["environment"]["libc"] != "glibc 1.0"


def test_fmus_are_copied_by_their_hash(tmp_path):
    (tmp_path / "car.fmu").write_bytes(b"an FMU")
    digest = hashlib.sha256(b"an FMU").hexdigest()
    with create(tmp_path / "s", fmus={digest: tmp_path / "car.fmu"}) as store:
        assert store.fmu(digest).read_bytes() == b"an FMU"
        assert store.metadata.fmus == {digest: "car.fmu"}
        with pytest.raises(StoreError, match="has no FMU"):
            store.fmu("0")
        store.fmu(digest).write_bytes(b"an FMu")
        with pytest.raises(StoreError, match=r"the copy of car.fmu, is missing or damaged"):
            store.fmu(digest)
    (tmp_path / "car.fmu").write_bytes(b"another")
    with pytest.raises(StoreError, match="has changed since"):
        create(tmp_path / "t", fmus={digest: tmp_path / "car.fmu"})
    assert not (tmp_path / "t").exists()


# What does not fit


def test_outcomes_that_do_not_fit_are_refused(tmp_path):
    piece = PLAN.pieces[0]
    with create(tmp_path / "s") as store:
        with pytest.raises(StoreError, match="is not a piece of the campaign"):
            store.write(outcome(Piece(0, 0, 2)))
        with pytest.raises(StoreError, match="does not fit"):
            store.write(outcome(piece, rows=6))
        with pytest.raises(StoreError, match="does not fit"):
            store.write(outcome(piece, metrics=("m.1",)))
        with pytest.raises(StoreError, match="not complete: 0 of 3 pieces"):
            store.finish()
        with pytest.raises(StoreError, match="Only finished runs"):
            store.replace(outcome(piece))
        assert not store.done()
        store.write(outcome(piece))
        store.write(outcome(piece, salt=3))  # as from a worker that was thought to be lost
        assert_piece(store, piece, outcome(piece))
        with pytest.raises(UnknownNameError, match=r"no signal 'plant.w'; did you mean 'plant.v'\?"):
            next(store.pieces_of_signals(["plant.w"]))
    store = CampaignStore.open(tmp_path / "s")
    for change in (lambda: store.write(outcome(piece)), lambda: store.replace(outcome(piece)), store.finish):
        with pytest.raises(StoreError, match="open for reading only"):
            change()


def test_only_what_is_asked_for_is_read(tmp_path):
    with create(tmp_path / "s") as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece))
    for path in (tmp_path / "s" / "signals.zarr" / "filter.P").glob("c.*"):
        path.write_bytes(b"no chunk")
    (tmp_path / "s" / "signals.zarr" / "plant.v" / "c.1.0").unlink()
    data = store.dataset()
    np.testing.assert_array_equal(data["plant.v"][0], outcome(PLAN.pieces[0]).signals["plant.v"][0])
    assert [p.index for p, _ in store.pieces_of_signals(["filter.x/y"])] == [0, 1, 2]
    with pytest.raises(StoreError, match=r"plant.v/c.1.0 .* is missing or damaged"):
        data["plant.v"].to_numpy()
    with pytest.raises(StoreError, match=r"with 'plant.v' of runs 3 to 5, is missing or damaged"):
        list(store.pieces_of_signals(["plant.v"]))
    with pytest.raises(StoreError, match="its content has changed"):
        data["filter.P"].to_numpy()
