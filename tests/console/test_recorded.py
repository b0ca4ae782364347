"""Downloads of a live run's signals: from the pieces of its recording, in bounded memory, while the run goes on."""

import csv
import http.client
import io
import re
import signal
import socket
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pandas
import pyarrow
import pytest
from served import get, until
from wired import LiveProcess, free_port

from bayesftc.console.desk.live import LiveRun, controller_lane
from bayesftc.console.web import recorded
from bayesftc.console.web.serving import Where, shown_beside
from bayesftc.cosim import live
from bayesftc.scenario.live import live_controller


def filled(folder, count, columns=8):
    """Return the folder of a recording with pieces of 1000 rows."""
    recorder = live.Recorder(live.Recording(folder, rows=1000), {"a": (), "b": (columns - 1,)}, 0.01)
    rows = np.random.default_rng(0).standard_normal((count, columns))
    rows[::7, 2] = np.nan
    for k in range(count):
        while not recorder.add(k, 0.01 * k, rows[k]):
            time.sleep(0.001)
    recorder.close()
    return recorder.folder


@contextmanager
def page_of(recording, folder):
    """Yield the address of the page of a live run, and the run."""
    controller, said = live_controller("live_car", ["controller.y[0]", "controller.y[1]"]), []
    with controller.stepper() as stepper:
        stepper.prepare()
        run = LiveRun("live_car", controller_lane(controller, stepper), {}, recording)
        with shown_beside(run, Where("127.0.0.1", 0), said.append):
            run.opened((), folder)
            yield re.search(r"http://\S+", said[-1])[0], run


def words_of(run):
    return [event.words for event in run.events.all()]


@pytest.mark.slow
def test_a_run_that_goes_on_is_downloaded(tmp_path):
    run = LiveProcess(tmp_path, free_port())
    try:
        until(lambda: get(run.address, "/download/signals.csv")[0] == 200)
        status, headers, body = get(run.address, "/download/signals.csv")
        assert status == 200
        assert headers["content-disposition"] == 'attachment; filename="live_car_signals.csv"'
        assert headers["content-security-policy"]
        table = pandas.read_csv(io.BytesIO(body))
        (tmp_path / "downloaded").mkdir()
        (tmp_path / "downloaded" / "0.parquet").write_bytes(get(run.address, "/download/signals.parquet")[2])
        assert get(run.address, "/download/figure.png")[0] == 404
        status, printed, is_left = run.end(signal.SIGTERM)
        assert (status, is_left) == (0, False), printed
        assert "Traceback" not in printed
    finally:
        run.close()
    whole, part = live.read_recording(tmp_path / "recording"), live.read_recording(tmp_path / "downloaded")
    assert 20 < len(table) <= len(part.time) < len(whole.time)
    assert part.units == whole.units
    for name in ("controller.x_hat", "controller.fault_probability", "controller.y"):
        assert np.array_equal(part[name], whole[name][: len(part.time)], equal_nan=True)
    assert np.array_equal(table["controller.x_hat[0]"], whole["controller.x_hat"][: len(table), 0])


def test_without_a_recording_or_a_piece_a_sentence_says_what_to_do(tmp_path):
    with page_of(None, None) as (address, _):
        status, _, body = get(address, "/download/signals.csv")
        assert (status, body.decode()) == (
            409, "The signals of this run are not recorded. Start it with --record DIR to download them.",
        )  # fmt: skip
    with page_of(live.Recording(tmp_path), tmp_path) as (address, _):
        status, _, body = get(address, "/download/signals.parquet")
        assert (status, body.decode()) == (
            409, "The recording has no complete piece yet. The first one is there after 10 s.",
        )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(recorded.SIGNALS))
def test_memory_is_bounded(tmp_path, monkeypatch, name):
    monkeypatch.setattr(recorded, "NUMBERS", 20_000)
    monkeypatch.setattr(recorded, "GROUP", 200_000)  # 1.6 MB
    folder = filled(tmp_path, 50_000, columns=20)  # 8 MB
    pool = pyarrow.default_memory_pool()
    before, most, size = pool.bytes_allocated(), 0, 0
    for part in recorded.signals_of(SimpleNamespace(recording=live.Recording(tmp_path), folder=folder), name):
        most, size = max(most, pool.bytes_allocated() - before + len(part)), size + len(part)
    assert size > 5e6
    assert most < 4e6


def test_a_damaged_piece_breaks_the_download_off(tmp_path):
    folder = filled(tmp_path, 5000)
    piece = folder / "000003.parquet"
    data = bytearray(piece.read_bytes())
    data[len(data) // 2] ^= 0xFF
    piece.write_bytes(data)
    with page_of(live.Recording(tmp_path), folder) as (address, run):
        for name in recorded.SIGNALS:
            with pytest.raises(http.client.IncompleteRead):
                get(address, f"/download/{name}")
        until(lambda: words_of(run) == 2 * [f"{piece} is damaged. Move it to another folder to download the others."])
        piece.unlink()
        table = pandas.read_csv(io.BytesIO(get(address, "/download/signals.csv")[2]))
        assert table["step"].tolist() == [*range(3000), *range(4000, 5000)]
        (folder / "000000.parquet").write_bytes(b"PAR1")
        status, _, body = get(address, "/download/signals.csv")
        assert status == 409
        assert b"000000.parquet is damaged." in body


@pytest.mark.slow
def test_those_who_do_not_read_hold_nobody_up(tmp_path, monkeypatch):
    monkeypatch.setattr(recorded, "UNREAD", 2.0)
    folder = filled(tmp_path, 100_000, columns=20)
    with page_of(live.Recording(tmp_path), folder) as (address, run):
        host = re.search(r"http://([^/]+)", address)[1]
        name, port = host.split(":")
        stuck = []
        for _ in range(2):
            stuck.append(socket.socket())
            stuck[-1].setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stuck[-1].connect((name, int(port)))
            stuck[-1].sendall(f"GET /download/signals.csv HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            assert stuck[-1].recv(100).startswith(b"HTTP/1.1 200")
        status, _, body = get(address, "/download/signals.csv")
        assert (status, body) == (503, b"There are already 2 downloads. Try again later.")
        until(lambda: len(words_of(run)) == 2)
        assert words_of(run) == 2 * ["A download has ended: nobody has read it for 2 s."]
        stuck[0].close()
        assert get(address, "/download/signals.parquet")[0] == 200
        events = [*csv.DictReader(get(address, "/download/events.csv")[2].decode().splitlines())]
        assert len(events) == 2
        stuck[1].close()


@pytest.mark.slow
def test_a_download_that_is_left_makes_room(tmp_path):
    folder = filled(tmp_path, 100_000, columns=20)
    with page_of(live.Recording(tmp_path), folder) as (address, _):
        for _ in range(3):  # one more than there may be
            host = re.search(r"http://([^/]+)", address)[1]
            connection = http.client.HTTPConnection(host, timeout=60)
            connection.request("GET", "/download/signals.csv")
            connection.getresponse().read(1000)
            connection.close()
            until(lambda: get(address, "/download/signals.parquet")[0] == 200)
