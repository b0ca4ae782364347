"""Stored campaigns whose writer is killed at any moment, or whose disk is full: a piece is whole or not there."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from stored import DRILL, PLAN, SIGNALS, TIME, assert_piece, assert_whole, create, drilled, outcome, resume

from bayesftc.cosim import StoreError
from bayesftc.cosim.campaign.designs.plan import OK, Outcome, Piece, Plan
from bayesftc.cosim.campaign.store import durable
from bayesftc.cosim.campaign.store.folder import CampaignStore

# Damage


@pytest.mark.parametrize("finished", [False, True])
def test_damaged_pieces_are_made_again(tmp_path, finished):
    path = tmp_path / "s"
    with create(path) as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece, fail={1}))
        if finished:
            store.finish()
    chunk = path / "signals.zarr" / "plant.v" / "c.1.0"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    if not finished:
        part = path / "runs" / "part-000002.parquet"
        part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
        with pytest.raises(StoreError, match=r"part-000002.parquet of the campaign is damaged; resume"):
            CampaignStore.open(path).table()
    with pytest.warns(UserWarning, match=rf"{1 if finished else 2} of 3 pieces of the campaign .* were damaged"):
        store = resume(path)
    with store:
        assert store.done() == ({0, 2} if finished else {0})
        assert_piece(store, PLAN.pieces[0], outcome(PLAN.pieces[0], fail={1}))
        assert np.isnan(store.dataset()["plant.v"][3:6]).all()
        for piece in PLAN.pieces:
            store.write(outcome(piece))
        store.replace(outcome(Piece(0, 1, 2)))
        store.finish()
        assert_whole(store)


def test_a_damaged_table_of_all_runs_is_made_again(tmp_path):
    with create(tmp_path / "s") as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece, fail={1}))
        store.finish()
        store.replace(outcome(Piece(0, 1, 2)))  # which is a part again
    path = tmp_path / "s" / "runs.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.warns(UserWarning, match="2 of 3 pieces"):
        store = resume(tmp_path / "s")
    with store:
        assert store.done() == {0}
        for piece in PLAN.pieces:
            store.write(outcome(piece))
        assert_whole(store)


def flipped(path, at):
    """Flip a bit of a file."""
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def test_times_of_which_a_bit_has_flipped_are_no_times(tmp_path):
    with create(tmp_path / "s") as store:
        store.write(outcome(PLAN.pieces[0]))
    chunk, texts = tmp_path / "s" / "signals.zarr" / "time" / "c" / "0", []
    for at in range(chunk.stat().st_size):
        flipped(chunk, at)
        try:
            np.testing.assert_array_equal(CampaignStore.open(tmp_path / "s").dataset()["time"], TIME)
        except StoreError as error:
            texts.append(str(error))
        flipped(chunk, at)
    assert len(texts) > len(TIME)
    assert all("with the time of each row, is missing or damaged; use a backup of it" in text for text in texts)
    np.testing.assert_array_equal(CampaignStore.open(tmp_path / "s").time, TIME)


def test_a_description_of_which_a_digit_has_changed_is_damaged(tmp_path):
    create(tmp_path / "s").close()
    path = tmp_path / "s" / "campaign.json"
    text = path.read_text()
    assert '"a.b": 2.5' in text
    path.write_text(text.replace('"a.b": 2.5', '"a.b": 3.5'))
    with pytest.raises(StoreError, match="is damaged, or of another program"):
        CampaignStore.open(tmp_path / "s")


def test_what_the_group_says_to_other_programs_is_not_believed(tmp_path):
    """Nor how large a chunk says that it is."""
    with create(tmp_path / "s") as store:
        for piece in PLAN.pieces:
            store.write(outcome(piece))
    group = tmp_path / "s" / "signals.zarr"
    for path in group.rglob("zarr.json"):
        path.write_text("{")
    assert_whole(CampaignStore.open(tmp_path / "s"))
    chunk = group / "plant.v" / "c.1.0"
    huge = bytes([0x28, 0xB5, 0x2F, 0xFD, 0xE4, *(1 << 40).to_bytes(8, "little")])  # a frame of a terabyte
    chunk.write_bytes(huge + chunk.read_bytes()[5:])
    with pytest.raises(StoreError, match="its content has changed"):
        CampaignStore.open(tmp_path / "s").dataset()["plant.v"].load()


# Killed at any moment


class Killed(BaseException):
    """What a process meets in place of its `count`-th change of a file, and of each one after it."""


class Wrapped:
    """A file that is written to; how, its heirs say."""

    def __init__(self, file):
        self._file = file

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._file.close()

    def fileno(self):
        return self._file.fileno()


@contextmanager
def killed_at(count):
    """Let `count` changes of files happen, and no more: of the next one that writes only a part comes to be."""
    lock, made = threading.Lock(), [0]

    def alive():
        with lock:
            made[0] += 1
            return made[0] <= count

    def guarded(function):
        def call(*arguments, **options):
            if not alive():
                raise Killed
            return function(*arguments, **options)

        return call

    class File(Wrapped):
        def write(self, data):
            if not alive():
                self._file.write(data[: len(data) // 2])
                raise Killed
            return self._file.write(data)

    with ExitStack() as stack:
        for name in ("replace", "unlink", "rmdir", "mkdir", "fsync"):
            stack.enter_context(mock.patch.object(os, name, guarded(getattr(os, name))))
        opened = guarded(lambda *arguments, **options: File(open(*arguments, **options)))  # noqa: SIM115
        stack.enter_context(mock.patch.object(durable, "open", opened, create=True))
        yield made


def deaths(tmp_path, path, work, counts):
    """Do `work` with a copy of a store, killed after each of some changes; yield each copy, and at last the one that was not."""
    for count in counts:
        copy, dead = tmp_path / f"killed-{count}", False
        shutil.copytree(path, copy)
        with resume(copy) as store:
            try:
                with killed_at(count):
                    work(store)
            except Killed:
                dead = True
        yield copy
        if not dead:
            return


WORK = {
    "write": lambda store: store.write(outcome(PLAN.pieces[1])),
    "replace": lambda store: store.replace([outcome(Piece(0, 1, 2), salt=5), outcome(Piece(0, 3, 5), salt=5)]),
    "finish": lambda store: store.finish(),
}


@pytest.fixture
def unsynced(monkeypatch):
    """Do not wait for the disk: what was written is there for every process, if not after a power cut."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("every", [9, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("work", "before"),
    [
        ("write", ""),
        ("finish", "write"),
        ("replace", "write"),
        ("replace", "write finish"),
        ("finish", "write finish replace"),
    ],
)
def test_killed_at_any_change_of_a_file_a_store_has_each_piece_whole_or_not_at_all(
    tmp_path, unsynced, work, before, every
):
    path, counts = tmp_path / "s", range(random.randrange(every), 1000, every)
    with create(path) as store:
        for piece in (PLAN.pieces[0], PLAN.pieces[2]):
            store.write(outcome(piece, fail={1}))
        for name in before.split():
            WORK[name](store)

    def may_be(piece):
        old, new = outcome(piece, fail={1}), outcome(piece, fail={1})
        if "replace" in {*before.split(), work}:
            for run in {1, 3, 4} & set(range(piece.begin, piece.end)):
                own, row = outcome(Piece(0, run, run + 1), salt=5), run - piece.begin
                for name in SIGNALS:
                    new.signals[name][row] = own.signals[name][0]
                for name in own.metrics:
                    new.metrics[name][row] = own.metrics[name][0]
                new.steps[row] = own.steps[0]
                status, reasons = list(new.status), list(new.reasons)
                status[row], reasons[row] = OK, ""
                new = Outcome(piece, new.metrics, new.signals, tuple(status), tuple(reasons), new.steps, 0.25)
        return [new] if "replace" in before else [old, new]

    seen = 0
    for copy in deaths(tmp_path, path, WORK[work], counts):
        seen += 1
        store = CampaignStore.open(copy)  # before anything is put in order
        assert store.done() >= ({0, 1, 2} if before else {0, 2})
        for piece in PLAN.pieces:
            if piece.index in store.done():
                assert_piece(store, piece, *may_be(piece))
            else:
                assert np.isnan(store.dataset()["plant.v"][piece.begin : piece.end]).all()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # nothing is damaged
            store = resume(copy)
        with store:
            left = [p.name for p in copy.rglob("*") if p.name.endswith(".tmp") or p.name == "redo"]
            assert not left
            for piece in PLAN.pieces:
                if piece.index in store.done():
                    assert_piece(store, piece, *may_be(piece))
                store.write(outcome(piece, fail={1}))
            WORK["replace"](store)
            store.finish()
            assert store.table()["status"].tolist() == [OK] * PLAN.runs
            assert store.table()["run"].tolist() == list(range(PLAN.runs))
        shutil.rmtree(copy)
    assert seen > 0


@pytest.mark.sampled(3)
@pytest.mark.parametrize("count", [0, 1, 2, 5, 9, 20, 60])
def test_killed_while_it_is_made_a_store_is_not_there(tmp_path, unsynced, count):
    with killed_at(count), pytest.raises(Killed):
        create(tmp_path / "s")
    assert not (tmp_path / "s").exists()
    create(tmp_path / "s").close()


# A full disk


@contextmanager
def full_after(size):
    """Let `size` bytes be written, and no more, as on a full disk."""
    left, lock = [size], threading.Lock()

    class Full(Wrapped):
        def write(self, data):
            with lock:
                some = min(len(data), left[0])
                left[0] -= some
            if not some:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self._file.write(data[:some])

    with mock.patch.object(
        durable, "open", lambda *arguments, **options: Full(open(*arguments, **options)), create=True
    ):
        yield left


@pytest.mark.slow
def test_a_disk_that_is_full_at_any_byte_leaves_what_was_done(tmp_path, unsynced):
    with create(tmp_path / "s") as store:
        store.write(outcome(PLAN.pieces[0], fail={1}))
        with full_after(10**6) as left:
            store.write(outcome(PLAN.pieces[2]))
        needed = 10**6 - left[0]
        for size in [*range(0, needed, 97), needed - 1]:
            with full_after(size), pytest.raises(StoreError, match=r"No space left on device.*Finished runs are kept"):
                store.write(outcome(PLAN.pieces[1]))
            assert store.done() == {0, 2}
            with full_after(size), pytest.raises(StoreError, match="No space left on device"):
                store.replace(outcome(Piece(0, 1, 2)))
            assert store.failed() == [1]
            assert not list((tmp_path / "s").rglob("*.tmp"))
        assert_piece(store, PLAN.pieces[0], outcome(PLAN.pieces[0], fail={1}))
        store.write(outcome(PLAN.pieces[1]))  # when there is space again
        with full_after(300), pytest.raises(StoreError, match="No space left on device"):
            store.finish()
        store.replace(outcome(Piece(0, 1, 2)))
        store.finish()
        assert_whole(store)


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
def test_a_disk_that_is_really_full(tmp_path):
    """A file system of 400 kB in memory."""
    disk = tmp_path / "disk"
    disk.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k", "none", str(disk)], capture_output=True)
    if done.returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        rows, plan = 1000, Plan(({},), (tuple(range(60)),), 5)
        times, noise = np.arange(rows) / 8, np.random.default_rng(1).standard_normal((60, rows))

        def of(piece):
            made = outcome(piece, {"a.v": ((), None)}, rows)
            made.signals["a.v"][:] = noise[piece.begin : piece.end]
            return made

        own = {"plan": plan, "signals": {"a.v": ((), None)}, "time": times}
        with create(disk / "s", **own) as store, pytest.raises(StoreError, match="No space left on device"):
            list(map(store.write, map(of, plan.pieces)))
        done = store.done()
        assert 3 < len(done) < 12
        for index in done:
            assert_piece(CampaignStore.open(disk / "s"), plan.pieces[index], of(plan.pieces[index]))
        subprocess.run(["mount", "-o", "remount,size=4m", str(disk)], check=True)
        with resume(disk / "s", **own) as store:
            assert store.done() == done
            for piece in plan.pieces:
                store.write(of(piece))
            store.finish()
            assert_whole(store, plan, of)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def start(name, *arguments):
    """Run a function of stored.py in a process of its own; return it when it has said that it is ready."""
    command = [sys.executable, str(Path(__file__).with_name("stored.py")), name, *map(str, arguments)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    )
    line = process.stdout.readline()
    assert line == "ready\n", line + process.stderr.read()
    return process


@pytest.mark.sampled(1)
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX")
@pytest.mark.parametrize("forks", [0, 1])
def test_one_process_writes_at_a_time_and_a_killed_one_no_more(tmp_path, forks):
    if forks and int(version("filelock").split(".")[0]) < 4:
        pytest.skip("the forked children of a killed writer keep its lock before filelock 4")
    process = start("hold", tmp_path / "s", forks)
    forked = int(process.stdout.readline())  # lives on, and has the lock's file open
    try:
        with pytest.raises(StoreError, match=r"Another process is writing the campaign in .*; wait until it has ended"):
            resume(tmp_path / "s")
        assert CampaignStore.open(tmp_path / "s").done() == set()
    finally:
        process.kill()
        process.wait()
    with resume(tmp_path / "s"), pytest.raises(StoreError, match="Another process"):  # in one process as well
        resume(tmp_path / "s")
    resume(tmp_path / "s").close()
    if forked:
        os.kill(forked, signal.SIGKILL)
    process.communicate()


def drill(path, kills, chance):
    """Kill a writer again and again at any moment, and look each time whether what is there is in order."""
    done, expected = set(), {piece.index: drilled(piece) for piece in DRILL.pieces}
    for kill in range(kills):
        process = start("write_all", path, kill)
        time.sleep(chance.uniform(0, 0.3 if kill < kills // 2 else 1.5))
        process.kill()
        process.communicate()
        store = CampaignStore.open(path)
        assert store.done() >= done
        done = store.done()
        table = store.table()
        assert table["run"].tolist() == [
            run for i in sorted(done) for run in range(DRILL.pieces[i].begin, DRILL.pieces[i].end)
        ]
        for piece, signals in store.pieces_of_signals():
            rows, own = table[table["run"].between(piece.begin, piece.end - 1)], expected[piece.index]
            assert rows["status"].tolist() == list(own.status)
            for name, values in own.metrics.items():
                np.testing.assert_array_equal(rows[name], values)
            for name, values in own.signals.items():
                np.testing.assert_array_equal(signals[name], values)
        data = store.dataset()["plant.v"].to_numpy()
        pending = ~np.isin(np.arange(DRILL.runs), table["run"])
        assert np.isnan(data[pending]).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        store = resume(path, DRILL)
    with store:
        for piece in DRILL.pieces:
            store.write(drilled(piece))
        store.finish()
    undisturbed = path.with_name("undisturbed")
    with create(undisturbed, DRILL) as other:
        for piece in DRILL.pieces:
            other.write(drilled(piece))
        other.finish()
    pd.testing.assert_frame_equal(store.table(), other.table())
    xr.testing.assert_identical(store.dataset().load(), other.dataset().load())
    return done


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX")
def test_kill_9_at_any_moment(tmp_path):
    drill(tmp_path / "s", 3, random.Random(os.getpid()))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX")
def test_kill_9_at_many_moments(tmp_path):
    drill(tmp_path / "s", 60, random.Random(os.getpid()))


@pytest.mark.parametrize("seconds", [0.3, pytest.param(3.0, marks=pytest.mark.slow)])
def test_whoever_reads_while_it_is_written_sees_whole_pieces(tmp_path, seconds):
    process = start("write_all", tmp_path / "s", 0)
    expected = {piece.index: drilled(piece) for piece in DRILL.pieces}
    try:
        store, seen, began = CampaignStore.open(tmp_path / "s"), 0, time.monotonic()
        while time.monotonic() < began + (seconds if seen else 60):  # a busy machine takes its time for the first piece
            runs = store.table()["run"].to_numpy()
            assert len(runs) >= seen
            assert (np.diff(runs) > 0).all()
            seen = len(runs)
            data = store.dataset()["plant.v"].to_numpy()
            for index in np.unique(runs // DRILL.size):
                piece = DRILL.pieces[index]
                np.testing.assert_array_equal(data[piece.begin : piece.end], expected[index].signals["plant.v"])
        assert seen > 0
        assert process.poll() is None
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
