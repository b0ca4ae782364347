"""Recordings: pieces that are readable while a run goes on, bounded memory, damaged and missing pieces."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bayesftc.cosim.errors import ModelError, ResultFileError
from bayesftc.cosim.live import Recorder, Recording, read_recording

pd = pytest.importorskip("pandas")
pytest.importorskip("pyarrow")

SIGNALS = {"car.v": (), "controller.u": (2,)}


def filled(folder, count, **settings):
    recorder = Recorder(Recording(folder, **settings), SIGNALS, 0.01, {"units": {"car.v": "m/s"}})
    for k in range(count):
        while not recorder.add(k, 0.01 * k, [k, 2 * k, 3 * k]):
            recorder.lost -= 1
            time.sleep(0.001)
    recorder.close()
    return recorder


def test_a_result_has_the_signals_with_their_shapes(tmp_path):
    recorder = filled(tmp_path, 250, rows=100)
    assert (recorder.pieces, recorder.lost) == (3, 0)
    for folder in (tmp_path, recorder.folder):
        result = read_recording(folder)
        assert result["car.v"].tolist() == list(range(250))
        assert result["controller.u"][-1].tolist() == [498, 747]
        assert result.units == {"car.v": "m/s"}
        assert result.time[-1] == 2.49
    assert abs(result["clock"][-1] - time.time()) < 3600
    assert len(pd.read_parquet(tmp_path)) == 250


def test_pieces_are_rotated_by_time(tmp_path):
    recorder = Recorder(Recording(tmp_path, seconds=0.05), SIGNALS, 0.01)
    for k in range(3):
        recorder.add(k, 0.01 * k, [0, 0, 0])
        time.sleep(0.06)
    recorder.close()
    assert recorder.pieces == 3


def test_it_is_readable_while_it_grows(tmp_path, until):
    recorder = Recorder(Recording(tmp_path, rows=10), SIGNALS, 0.01)
    for k in range(25):
        recorder.add(k, 0.01 * k, [k, k, k])
        time.sleep(0.001)
    until(lambda: recorder.pieces == 2)
    assert len(read_recording(tmp_path)["car.v"]) == 20
    assert len(pd.read_parquet(tmp_path)) == 20
    recorder.close()
    assert len(read_recording(tmp_path)["car.v"]) == 25


def test_rows_that_are_not_recorded_are_nan(tmp_path):
    recorder = Recorder(Recording(tmp_path), SIGNALS, 0.01)
    for k in (5, 6, 9):
        recorder.add(k, 0.01 * k, [k, k, k])
    recorder.close()
    result = read_recording(tmp_path)
    assert result.time.tolist() == [0.05, 0.06, 0.07, 0.08, 0.09]
    assert np.isnan(result["car.v"]).tolist() == [False, False, True, True, False]


def test_old_pieces_are_deleted_also_those_of_earlier_runs(tmp_path):
    filled(tmp_path, 30, rows=10)
    second = filled(tmp_path, 50, rows=10, keep=3)
    assert [p.name for p in sorted(tmp_path.rglob("*.parquet"))] == [f"{n:06d}.parquet" for n in (2, 3, 4)]
    assert list(tmp_path.iterdir()) == [second.folder]
    assert read_recording(tmp_path).time[0] == 0.2


def test_a_slow_disk_costs_rows_but_no_time_and_no_memory(tmp_path, monkeypatch):
    import threading

    go = threading.Event()
    recorder = Recorder(Recording(tmp_path, rows=10), SIGNALS, 0.01)
    monkeypatch.setattr(recorder, "_write", lambda piece: go.wait(30))
    kept = sum(recorder.add(k, 0.01 * k, [0, 0, 0]) for k in range(100))
    assert kept <= 60
    assert recorder.lost == 100 - kept
    go.set()
    recorder.close()


def test_only_pieces_of_runs_are_deleted(tmp_path):
    """Also if files of others sort before or after them, and if the clock was set back since an earlier run."""
    others = [
        tmp_path / name for name in ("runs.parquet", "00-study/000000.parquet", "9999-12-31T00-00-00/own.parquet")
    ]
    later = tmp_path / "9998-12-31T00-00-00" / "000000.parquet"
    for path in (*others, later):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"of others")
    recorder = filled(tmp_path, 50, rows=10, keep=3)
    assert all(path.exists() for path in others)
    assert not later.exists()
    assert len(list(recorder.folder.iterdir())) == 3


def test_the_order_of_pieces_is_that_of_their_numbers(tmp_path):
    recorder = Recorder(Recording(tmp_path, rows=10, keep=2), SIGNALS, 0.01)
    recorder.pieces = 999_998
    for k in range(40):
        while not recorder.add(k, 0.01 * k, [k, k, k]):
            recorder.lost -= 1
            time.sleep(0.001)
    recorder.close()
    assert sorted(path.stem for path in recorder.folder.iterdir()) == ["1000000", "1000001"]
    assert read_recording(tmp_path)["car.v"].tolist() == list(range(20, 40))


def test_a_full_disk_is_reported(tmp_path, monkeypatch):
    recorder = Recorder(Recording(tmp_path, rows=10), SIGNALS, 0.01)

    def full(piece):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder, "_write", full)
    for k in range(10):
        recorder.add(k, 0.01 * k, [0, 0, 0])
    recorder.close()
    assert (recorder.lost, recorder.problem) == (10, "No space left on device")


def test_any_error_is_reported_and_later_pieces_are_written(tmp_path, monkeypatch):
    recorder = Recorder(Recording(tmp_path, rows=10), SIGNALS, 0.01)
    write = recorder._write

    def fails_once(piece):
        monkeypatch.setattr(recorder, "_write", write)
        raise MemoryError("malloc of size 64 failed")

    monkeypatch.setattr(recorder, "_write", fails_once)
    for k in range(20):
        assert recorder.add(k, 0.01 * k, [k, 0, 0])
    recorder.close()
    assert (recorder.lost, recorder.problem) == (10, "MemoryError: malloc of size 64 failed")
    assert read_recording(tmp_path)["car.v"].tolist() == list(range(10, 20))


def test_errors_are_sentences(tmp_path):
    with pytest.raises(ResultFileError, match="has no piece"):
        read_recording(tmp_path)
    filled(tmp_path, 30, rows=10)
    piece = sorted(tmp_path.rglob("*.parquet"))[1]
    piece.write_bytes(piece.read_bytes()[:-20])
    with pytest.raises(ResultFileError, match=r"000001.parquet is damaged"):
        read_recording(tmp_path)
    pd.DataFrame({"x": [1.0]}).to_parquet(tmp_path / "other.parquet")
    with pytest.raises(ResultFileError, match="is no piece"):
        read_recording(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultFileError, match="Choose another"):
        Recorder(Recording(tmp_path / "file"), SIGNALS, 0.01)
    for wrong in ({"rows": 0}, {"keep": 0}, {"seconds": 0}):
        with pytest.raises(ModelError, match=next(iter(wrong))):
            Recording(tmp_path, **wrong)


ENDLESS = """
import sys, itertools
from bayesftc.cosim.live import Recorder, Recording
recorder = Recorder(Recording(sys.argv[1], rows=50), {"x": ()}, 0.001)
for k in itertools.count():
    recorder.add(k, 0.001 * k, [float(k)])
    if k % 50 == 0:
        import time
        time.sleep(0.002)
"""


def test_a_kill_costs_only_the_last_piece(tmp_path, until):
    process = subprocess.Popen([sys.executable, "-c", ENDLESS, str(tmp_path)])
    until(lambda: len(list(tmp_path.rglob("0*.parquet"))) >= 5, 60)
    process.send_signal(signal.SIGKILL)
    process.wait()
    pieces = [p for p in tmp_path.rglob("*.parquet") if not p.name.startswith(".")]
    result = read_recording(tmp_path)
    x = result["x"][np.isfinite(result["x"])]
    assert len(x) == 50 * len(pieces)
    assert (x == np.round(result.time[np.isfinite(result["x"])] / 0.001)).all()
    assert os.listdir(tmp_path)
