"""The server: frames and commands, who may connect, bounds, and viewers that do not read."""

import asyncio
import csv
import http.client
import io
import itertools
import json
import re
import socket
import subprocess
import sys
import threading
import time
import tomllib
from contextlib import ExitStack, suppress

import numpy as np
import pandas
import pytest
from served import PATIENCE, Viewer, connect_without_reading, get, served, until
from websockets.exceptions import ConnectionClosed, InvalidStatus

from bayesftc.console.desk.desk import Desk, Served
from bayesftc.console.desk.engine import Engine
from bayesftc.console.desk.history import Rows
from bayesftc.console.shown.broadcast import PAUSE
from bayesftc.console.shown.frames import thinned
from bayesftc.console.web import serving
from bayesftc.console.web.access import SOON, Access, Once
from bayesftc.console.web.server import BETWEEN, MOST_VIEWERS
from bayesftc.console.web.serving import MOST_CONNECTIONS, SILENT
from bayesftc.cosim.live.connections.credentials import is_loopback
from bayesftc.scenario import load_scenario


def test_run_break_go_back_and_download(address, tmp_path):
    with Viewer(address) as viewer:
        viewer.ready()
        viewer.claim()
        viewer.do(do="back", k=0)
        viewer.do(do="step", steps=200)
        viewer.until(lambda: viewer.header["k"] == 200)
        assert viewer.steps.tolist() == list(range(201))
        viewer.do(do="fault", target="sensors", settings={"kind": "Freeze", "sensor": 1})
        viewer.do(do="step", steps=50)
        viewer.until(lambda: viewer.header["k"] == 250 and viewer.header["epoch"] == viewer.layout["epoch"])
        card = viewer.header["cards"][1]
        assert card["p"] > 0.9
        assert card["kind"] == "frozen"
        assert card["present"] == ["freeze_1"]
        assert re.fullmatch(r"ignoring sensor 1 since 4.* s: frozen, probability \S+( \S+)?", card["words"])
        assert viewer.column("controller.fault_probability[1]")[-1] > 0.9
        status, headers, body = get(address, "/download/scenario.toml")
        assert status == 200
        assert "attachment" in headers["content-disposition"]
        (tmp_path / "by_hand.toml").write_bytes(body)
        result = load_scenario(tmp_path / "by_hand.toml").simulate()
        assert len(result.time) == 251
        assert np.array_equal(result["plant.v"].astype(np.float32), viewer.column("plant.v"))
        status, _, body = get(address, "/download/signals.csv")
        assert status == 200
        assert body.count(b"\n") == 252
        assert get(address, "/download/figure.png")[2].startswith(b"\x89PNG")
        viewer.do(do="back", k=100)
        viewer.until(lambda: viewer.header["k"] == 100)
        viewer.do(do="fault", target="force", settings={"kind": "GainFault", "factor": 0.5, "duration": 1.0})
        viewer.until(lambda: len(viewer.layout["branches"]) == 2)
        viewer.do(do="compare", name="first")
        viewer.until(lambda: len(viewer.layout["lanes"]) == 3)
        viewer.do(do="choose", name="first")
        viewer.do(do="remove", name="branch 2")
        viewer.until(lambda: len(viewer.layout["branches"]) == 1)


@pytest.mark.slow
def test_downloads_are_whole(tmp_path):
    """They have all signals at all steps, of each controller, also where the file records fewer."""
    file = tmp_path / "sparse.toml"
    text = load_scenario("cruise_control").path.read_text()
    file.write_text(text.replace("[simulation]", '[simulation]\nrecord = ["plant.v"]\ndecimation = 10', 1))
    with served(str(file)) as (_, address), Viewer(address) as viewer:
        viewer.ready()
        viewer.do(do="step", steps=200)
        viewer.until(lambda: viewer.header["k"] == 200)
        with Viewer(address) as second:
            second.ready()
        for lane, name in enumerate(("sparse", "sparse_FixedPrecision")):
            status, headers, body = get(address, f"/download/signals.csv?lane={lane}")
            assert status == 200
            assert headers["content-disposition"] == f'attachment; filename="{name}_signals.csv"'
            table = pandas.read_csv(io.BytesIO(body))
            assert len(table) == 201
            assert {"controller.u[0]", "controller.precision[1]", "plant.v", "freeze_0.active"} <= {*table.columns}
            assert np.array_equal(table["plant.v"].astype(np.float32), viewer.column("plant.v", lane))
        table = pandas.read_parquet(io.BytesIO(get(address, "/download/signals.parquet")[2]))
        assert len(table) == 201
        content = tomllib.loads(get(address, "/download/scenario.toml?lane=1")[2].decode())
        assert content["controller"]["precision"] == {"kind": "FixedPrecision"}
        for wrong in ("2", "-1", "", "x", "9" * 5000):
            status, _, body = get(address, f"/download/signals.csv?lane={wrong}")
            assert status == 409
            assert body.startswith(b"There is no controller")
        events = [*csv.DictReader(get(address, "/download/events.csv")[2].decode().splitlines())]
        assert [(each["what"], each["event"]) for each in events if each["what"] != "alarm"] == [
            ("viewer", "connected, 1 now"), ("viewer", "takes the controls"), ("run", "200 steps"),
            ("viewer", "connected, 2 now"), ("viewer", "left, 1 now"),
        ]  # fmt: skip


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The address of a console of one car, of a file with HTML in its name."""
    file = tmp_path_factory.mktemp("alone") / "<b>car.toml"
    file.write_text(load_scenario("cruise_control").path.read_text())
    with served(str(file), "--alone") as (_, found):
        yield found


@pytest.mark.sampled(1)
def test_a_run_that_stops_is_downloaded_up_to_there(alone):
    with Viewer(alone) as viewer:
        viewer.ready()
        viewer.do(do="step", steps=10)
        viewer.do(do="fault", target="force", settings={"kind": "GainFault", "factor": 1e308})
        viewer.do(do="step", steps=50)
        viewer.until(lambda: viewer.header["stopped"][0])
        k = viewer.header["k"]
        assert k < 60
        status, _, body = get(alone, "/download/signals.csv")
        assert (status, body.count(b"\n")) == (200, k + 2)
        assert b"stopped: " in get(alone, "/download/events.csv")[2]


def test_run_by_the_clock(address):
    with Viewer(address) as viewer:
        viewer.ready()
        viewer.claim()
        viewer.do(do="pace", pace=10)
        viewer.do(do="run", on=True)
        first, began = viewer.header["t"], time.monotonic()
        viewer.until(lambda: viewer.header["t"] >= first + 10.0)
        assert 0.7 < time.monotonic() - began < 30.0
        viewer.do(do="pace", pace=None)
        first = viewer.header["t"]
        viewer.until(lambda: viewer.header["t"] > first + 100.0)
        viewer.do(do="run", on=False)
        viewer.do(do="pace", pace=1)
        viewer.do(do="back", k=200)
        assert viewer.ask(do="pace", pace=1000)["sentence"].startswith("The pace is 1000")


def test_frames_lose_no_spike():
    values = np.random.default_rng(0).normal(size=(1003, 3))
    values[517, 1], values[600, 2], values[700:720, 0] = 50.0, np.nan, np.nan
    steps, thin = thinned(Rows(values, 100), 100)
    assert len(thin) <= 100
    assert (np.diff(steps) > 0).all()
    assert 100 <= steps[0] <= steps[-1] <= 1102
    assert np.array_equal(np.nanmax(thin, axis=0), np.nanmax(values, axis=0))
    assert np.array_equal(np.nanmin(thin, axis=0), np.nanmin(values, axis=0))
    assert thinned(Rows(values, 0), 2000)[1] is values
    assert len(thinned(Rows(values[:5], 0), 2)[1]) == 2


@pytest.mark.parametrize(
    "message",
    [
        "", "no json", "[]", "{}", '{"do": 1}', '{"do": "explode"}', '{"do": "run"}', '{"do": "run", "on": "yes"}',
        '{"do": "pace", "pace": NaN}', '{"do": "pace", "pace": 1e999}', '{"do": "step", "steps": 1e9}',
        '{"do": "fault", "target": "sensors", "settings": {"kind": "Freeze", "sensor": 99}}',
        '{"do": "fault", "target": "sensors", "settings": {"kind": ["Freeze"]}}',
        '{"do": "fault", "target": "sensors", "settings": {"kind": "Stuck", "at": NaN}}',
        '{"do": "goal", "target": "-1", "value": 1}', '{"do": "back", "k": -1}', '{"do": "back", "k": 1e99}',
        '{"do": "show", "columns": "all"}', '{"do": "rename", "name": "first", "new": " "}', "[" * 8000, '{"a":' * 1500,
    ],
)  # fmt: skip
def test_wrong_commands_are_answered(address, message):
    with Viewer(address) as viewer:
        viewer.ready()
        k = viewer.header["k"]
        viewer.socket.send(message)
        sentence = None
        while sentence is None:
            sentence = viewer.receive().get("sentence")
        assert sentence.endswith(".")
        assert viewer.header["k"] == k


def test_long_messages_end_the_connection(address):
    with Viewer(address) as viewer:
        viewer.ready()
        viewer.socket.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            viewer.until(lambda: False)
    with Viewer(address) as viewer:
        viewer.ready()


def test_one_operator_and_many_viewers(address):
    with Viewer(address) as first:
        first.ready()
        first.claim()  # before there is the second, which would have them if the viewer of the test before leaves just then
        with Viewer(address) as second:
            second.ready()
            assert not second.layout["operator"]
            assert "controls" in second.ask(do="step")["sentence"]
            assert "controls" in second.ask(do="claim")["sentence"]
            first.socket.close()
            second.claim()
            assert second.ask(do="step")["type"] == "done"


def test_number_of_viewers_is_bounded(address):
    viewers = [Viewer(address) for _ in range(MOST_VIEWERS)]
    try:
        viewers[-1].ready()
        with Viewer(address) as more, pytest.raises(ConnectionClosed) as caught:
            more.ready()
        assert caught.value.rcvd.code == 1013
    finally:
        for viewer in viewers:
            viewer.socket.close()


@pytest.mark.slow
def test_idle_connections_are_bounded_and_closed(address):
    name, port = re.search(r"http://([^/]+)", address)[1].split(":")
    with ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection((name, int(port)))) for _ in range(MOST_CONNECTIONS + 50)]
        began = time.monotonic()
        for each in idle:
            each.settimeout(SILENT + 10.0)
            with suppress(ConnectionError):
                assert each.recv(1) == b""  # it has ended
        assert time.monotonic() - began < SILENT + 10.0
        with Viewer(address) as viewer:
            viewer.ready()
            time.sleep(SILENT + 1.0)  # a viewer that asks for nothing stays
            viewer.claim()
            assert viewer.ask(do="step")["type"] == "done"


@pytest.mark.slow
def test_an_operator_that_does_not_read_loses_the_controls():
    with served("cruise_control") as (_, address):
        stuck = connect_without_reading(address)
        assert stuck.recv(100).startswith(b"HTTP/1.1 101")  # and nothing more
        for command in ('{"do": "pace", "pace": 20}', '{"do": "run", "on": true}'):
            stuck.sendall(bytes([0x81, 0x80 | len(command), 0, 0, 0, 0]) + command.encode())
        with Viewer(address) as viewer:
            viewer.until(lambda: viewer.header is not None and viewer.header["t"] > 1.0)
            assert "controls" in viewer.ask(do="claim")["sentence"]
            end = time.monotonic() + 45.0
            while viewer.ask(do="claim")["type"] != "done":
                assert time.monotonic() < end
                time.sleep(0.2)
            assert viewer.ask(do="run", on=False)["type"] == "done"
        stuck.close()


@pytest.mark.slow
@pytest.mark.parametrize("columns", [[["controller.beta[0]"]], [["controller.beta[0]"], ["controller.beta[1]"]]])
def test_choices_of_signals_without_end_cost_little(address, columns):
    """The same signals change nothing, others are sent now and then, and commands are read one by one with a pause."""
    with Viewer(address) as viewer, suppress(ConnectionClosed):
        viewer.ready()
        first = columns[0]
        viewer.do(do="show", columns=first)
        viewer.until(lambda: (0, first[0]) in viewer.columns)
        texts = [json.dumps({"do": "show", "columns": each, "id": 7}) for each in columns]
        over = threading.Event()

        def flood():
            with suppress(ConnectionClosed):
                for text in itertools.cycle(texts):
                    if over.is_set():
                        return
                    viewer.socket.send(text)
                    time.sleep(0.0005)  # with a full buffer, this client could not receive either

        thread, began, resets, answers = threading.Thread(target=flood), time.monotonic(), 0, 0
        thread.start()
        try:
            while time.monotonic() < began + 2.0:
                message = viewer.receive()
                resets += bool(message.get("reset"))
                answers += message.get("id") == 7
            seconds = time.monotonic() - began
        finally:
            over.set()
            viewer.socket.close_socket()
            thread.join()
        assert 1 < answers <= seconds / BETWEEN + 1
        assert (len(columns) > 1) <= resets <= (len(columns) > 1) * (seconds / PAUSE + 1)


def test_a_viewer_that_does_not_read_delays_nobody(address):
    stuck = connect_without_reading(address)
    with Viewer(address) as viewer:
        viewer.ready()
        time.sleep(0.5)
        if not viewer.layout["operator"]:
            stuck.close()
            viewer.claim()
        viewer.do(do="pace", pace=10)
        viewer.do(do="run", on=True)
        first, frames, began = viewer.header["t"], 0, time.monotonic()
        while viewer.header["t"] < first + 20.0:
            viewer.receive()
            frames += 1
        assert frames > 5
        assert time.monotonic() - began < 30.0
        viewer.do(do="run", on=False)
        viewer.do(do="pace", pace=1)
    stuck.close()


def test_other_origins_and_hosts_are_refused(address):
    host = re.search(r"http://([^/]+)", address)[1]
    for options in ({"origin": "http://evil.example"}, {"origin": None}, {"origin": f"http://{host}.evil.example"}):
        with pytest.raises(InvalidStatus) as caught:
            Viewer(address, **options)
        assert caught.value.response.status_code == 403
    assert get(address, "/", Host="evil.example")[0] == 403  # a name that was bound to this address
    assert get(address, "/download/scenario.toml", Host="evil.example:80")[0] == 403
    for site in ("cross-site", "same-site"):  # a link or an image of another page
        assert get(address, "/download/scenario.toml", **{"Sec-Fetch-Site": site})[0] == 403
        assert get(address, "/", **{"Sec-Fetch-Site": site})[0] == 200
    connection = http.client.HTTPConnection(host, timeout=60)
    connection.request("POST", "/", body=b"do=run")
    assert connection.getresponse().status == 403


def test_page_has_a_policy_and_nothing_from_elsewhere(address):
    status, headers, body = get(address, "/")
    assert status == 200
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    text = body.decode()
    for name in re.findall(r'(?:src|href)="(/page/[^"]+)"', text):
        status, headers, body = get(address, name)
        assert status == 200
        assert headers["content-security-policy"]
        text += body.decode()
    assert not re.findall(r"https?://(?!www\.w3\.org/)", text.replace("https://github.com/leeoniya/uPlot", ""))
    assert "innerHTML" not in re.sub(r"(?s)/\*! https://github.com/leeoniya.*", "", text)
    for path in ("/page/../server.py", "/page/%2e%2e/server.py", "/etc/passwd", "/page/x", "/download/x"):
        assert get(address, path)[0] == 404


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """What a console for other machines prints first, its address, and the file with what its browser was started with."""
    folder = tmp_path_factory.mktemp("browser")
    browser, seen = folder / "browser", folder / "seen"
    browser.write_text(f'#!/bin/sh\necho "$@" > {seen}.part\nmv {seen}.part {seen}\n')
    browser.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BROWSER", f"{browser} %s")
        with served("cruise_control", "--alone", "--host", "0.0.0.0", "--open") as (process, shown):
            yield process.stderr.readline(), shown, seen


def test_other_addresses_need_the_token(elsewhere):
    said, shown, _ = elsewhere
    assert "write a name or address of this machine in place of 0.0.0.0" in said
    token = re.search(r"token=(\S+)", shown)[1]
    address = shown.replace("0.0.0.0", "127.0.0.1")
    assert len(token) > 30
    for path in (
        "/",
        "/page/console.js",
        "/download/scenario.toml",
        "/?token=",
        "/?token=wrong",
        "/?xtoken=1",
        "/?x=once=1",
    ):
        assert get(address, path)[0] == 403
    for cookie in ("", "token=x", f"other={token}", f"bayesftc-1={token}", ";;==", "a" * 5000):
        assert get(address, "/", Cookie=cookie)[0] in (400, 403)
        with pytest.raises(InvalidStatus):
            Viewer(address, additional_headers={"Cookie": cookie})
    status, headers, _ = get(address, f"/?token={token}")
    assert status == 303
    assert headers["location"] == "/"
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    cookie = cookie.split(";")[0]
    assert get(address, "/", Cookie=cookie)[0] == 200
    with pytest.raises(InvalidStatus):
        Viewer(address, origin="http://evil.example", additional_headers={"Cookie": cookie})
    with Viewer(address, additional_headers={"Cookie": cookie}) as viewer:
        viewer.ready()
        assert [lane["name"] for lane in viewer.layout["lanes"]] == ["SwitchingPrecision"]


def test_a_browser_is_opened_with_a_pass_for_one_use(elsewhere):
    """The arguments of a browser's process are in the list of processes: the token is not among them."""
    _, shown, seen = elsewhere
    token = re.search(r"token=(\S+)", shown)[1]
    until(seen.exists)
    opened = seen.read_text().strip()
    assert token not in opened
    address, query = re.fullmatch(r"(http://0\.0\.0\.0:\d+)/(\?once=\S{40,})", opened).groups()
    address = address.replace("0.0.0.0", "127.0.0.1")
    for wrong in ("/?once=", "/?once=x", f"/page/console.js{query}", f"/download/scenario.toml{query}"):
        assert get(address, wrong)[0] == 403
    status, headers, _ = get(address, f"/{query}")
    assert (status, headers["location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= {*headers["set-cookie"].split("; ")}
    cookie = headers["set-cookie"].split(";")[0]
    assert get(address, "/", Cookie=cookie)[0] == 200
    status, headers, body = get(address, f"/{query}")  # once more
    assert (status, body) == (
        403, b"This address does not count any more. Open the one with the token that has been printed.",
    )  # fmt: skip
    assert "set-cookie" not in headers


def test_a_pass_counts_once_and_soon():
    now = [100.0]
    once = Once(lambda: now[0])
    first, second, third = (once.issue() for _ in range(3))
    assert len({first, second, third}) == 3
    assert once.redeem(second)
    assert not once.redeem(second)
    assert not once.redeem("")
    now[0] += SOON - 1.0
    assert once.redeem(first)
    now[0] += 2.0
    assert not once.redeem(third)


def test_addresses_of_this_machine():
    assert all(map(is_loopback, ("127.0.0.1", "127.9.9.9", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.0.2", "::", "example.org")))
    access = Access("127.0.0.1", 80, None)
    assert access.knows_host([(b"host", b"localhost")])
    assert not access.knows_host([(b"host", b"localhost"), (b"host", b"evil.example")])
    assert not access.knows_host([])


def test_wrong_command_lines_end_with_a_sentence(tmp_path):
    from typer.testing import CliRunner

    from bayesftc.cli.application import app

    runner = CliRunner()
    assert "no shipped scenario" in runner.invoke(app, ["serve", "cruise_contrl"]).output
    assert "--beside" in runner.invoke(app, ["serve", "cruise_control", "--alone", "--beside", "EFFDI"]).output
    assert "did you mean 'EFFDI'" in " ".join(
        runner.invoke(app, ["serve", "cruise_control", "--beside", "EFDI"]).output.split()
    )
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        answer = runner.invoke(app, ["serve", "cruise_control", "--port", port])
    assert answer.exit_code != 0
    assert "cannot be used" in answer.output
    assert "--port 0" in answer.output
    for host in ("nowhere.invalid", "a..b", "192.0.2.1"):  # the last one is of no machine
        answer = runner.invoke(app, ["serve", "cruise_control", "--host", host, "--port", "0"])
        assert answer.exit_code != 0
        assert "with --host." in " ".join(answer.output.split())


def test_a_wrong_scenario_ends_the_console_with_its_sentence(tmp_path):
    file = tmp_path / "wrong.toml"
    file.write_text("[simulation]\nduration = 1.0\n")
    command = [sys.executable, "-m", "bayesftc", "serve", str(file), "--port", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == (
        f"Error: {file} lacks the section [plant]. A scenario needs [simulation], [plant], [reference], [controller]."
    )


def test_an_open_page_gets_the_sentence_before_the_console_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(serving, "LAST", 30.0)
    engine = Engine(lambda events: Desk(Served(tmp_path / "wrong.toml", {}, "wrong"), events=events), None)
    engine.start()
    engine._thread.join(PATIENCE)
    assert "lacks the section" in engine.failure
    ended = []

    async def watch():
        task = asyncio.create_task(serving._end_after_failure(engine, lambda: ended.append(True)))
        await asyncio.sleep(0.2)
        assert not task.done()
        task.cancel()

    asyncio.run(watch())
    assert not ended
    monkeypatch.setattr(serving, "LAST", 0.0)
    asyncio.run(serving._end_after_failure(engine, lambda: ended.append(True)))
    assert ended


def test_names_are_data(alone):
    """A name with HTML in it goes to the page as text; the page makes no HTML of texts."""
    with Viewer(alone) as viewer:
        viewer.ready()
        viewer.do(do="rename", name="first", new="<img src=x onerror=alert(1)>")
        assert viewer.layout["scenario"] == "<b>car"
        disposition = get(alone, "/download/scenario.toml")[1]["content-disposition"]
        assert disposition == 'attachment; filename="_b_car_scenario.toml"'
