"""The page of a live run: deadlines missed at 100 Hz, without viewers, with twenty, and with one that reads nothing."""

from __future__ import annotations

import asyncio
import json
import os
import re
import socket
import struct
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from bayesftc.bench._figures import Figure

VIEWERS = 20
PERIOD = 0.01
PACE = 2.0
"""The shipped controller has steps of 20 ms."""

CASES = {"alone": "without viewers", "viewers": f"with {VIEWERS} viewers", "unread": "with a viewer that reads nothing"}


class _Turn(NamedTuple):
    """Shares of the steps that missed their deadline, the 99th percentile of delays in ms, and frames a second of a viewer."""

    missed: float
    late: float
    frames: float


def live_page(quick: bool) -> list[Figure]:
    """Return the shares of deadlines missed by ``bayesftc live --serve``, in turns, so that all meet the same machine."""
    turns, seconds = (1, 1.0) if quick else (3, 10.0)
    found: dict[str, list[_Turn]] = {case: [] for case in CASES}
    for _ in range(turns):
        for case, each in found.items():
            each.append(asyncio.run(_turn(case, seconds)))
    return [
        Figure(
            f"live_missed_{case}",
            f"share of deadlines missed by a live run at 100 Hz {words}",
            "",
            [turn.missed for turn in found[case]],
            note=_note(found[case], seconds),
        )
        for case, words in CASES.items()
    ]


def _note(turns: list[_Turn], seconds: float) -> str:
    late = ", ".join(f"{turn.late:.2f}" for turn in turns)
    frames = min(turn.frames for turn in turns)
    shown = f", {frames:.3g} frames a second of each viewer" if frames else ""
    load = (
        f", load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores" if hasattr(os, "getloadavg") else ""
    )
    return f"turns of {seconds:g} s; 99 % of the delays below {late} ms{shown}{load}"


async def _turn(case: str, seconds: float) -> _Turn:
    ports = [_free_port() for _ in range(3)]
    with TemporaryDirectory() as folder:
        wires = Path(folder, "wires.toml")
        wires.write_text(_wires(ports), encoding="utf-8")
        command = ["-m", "bayesftc", "live", "live_car", "--bridge", str(wires), "--pace", str(PACE)]
        command += ["--duration", str(PACE * (seconds + 1.0)), "--serve", "--port", "0", "--json", "--quiet"]
        process = await asyncio.create_subprocess_exec(
            sys.executable, *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        assert process.stderr is not None
        said = (await process.stderr.readline()).decode()
        found = re.search(r"http://([\d.]+):(\d+)/", said)
        if found is None:
            raise RuntimeError(f"bayesftc live has not started: {said}{(await process.communicate())[1].decode()}")
        counts = [0] * (VIEWERS if case == "viewers" else 0)
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(_samples(ports[:2]))
            for i in range(len(counts)):
                await stack.enter_async_context(_viewer(found[0], found[2], counts, i))
            if case == "unread":
                stack.enter_context(_unread(found[1], int(found[2])))
            printed, _ = await process.communicate()
    deadlines: dict[str, Any] = json.loads(printed)["deadlines"]
    frames = sum(counts) / max(len(counts), 1) / (seconds + 1.0)
    return _Turn(deadlines["overruns"] / deadlines["steps"], 1e3 * deadlines["delay_0.99"], frames)


def _wires(ports: list[int]) -> str:
    sensors = [
        f'[bridge.speed{i}]\nkind = "UDP"\nport = {port}\nto = "controller.y[{i}]"\n'
        for i, port in enumerate(ports[:2])
    ]
    return "\n".join(
        [*sensors, f'[bridge.force]\nkind = "UDP"\nport = {ports[2]}\nfrom = "controller.u"\nsafe = 0.0\n']
    )


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as each:
        each.bind(("127.0.0.1", 0))
        return int(each.getsockname()[1])


@asynccontextmanager
async def _samples(ports: list[int]) -> AsyncIterator[None]:
    """Send samples of two sensors at the rate of the steps."""

    async def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            k = 0
            while True:
                k += 1
                for i, port in enumerate(ports):
                    sender.sendto(struct.pack("<d", 20.0 + ((7 * k + 3 * i) % 11 - 5) / 5), ("127.0.0.1", port))
                await asyncio.sleep(PERIOD)

    async with _task(send()):
        yield


@asynccontextmanager
async def _viewer(address: str, port: str, counts: list[int], number: int) -> AsyncIterator[None]:
    """Connect a viewer, and count its frames."""
    from websockets.asyncio.client import connect

    async def watch() -> None:
        async for message in viewer:
            counts[number] += isinstance(message, bytes)

    origin: Any = address.rstrip("/")
    viewer = await connect(f"ws://127.0.0.1:{port}/live", origin=origin, max_size=None)
    async with _task(watch()):
        yield
    await viewer.close()


@asynccontextmanager
async def _task(work: Any) -> AsyncIterator[None]:
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _unread(host: str, port: int) -> socket.socket:
    """Connect a viewer with a small buffer, which nobody empties."""
    viewer = socket.socket()
    viewer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    viewer.connect((host, port))
    viewer.sendall(
        f"GET /live HTTP/1.1\r\nHost: {host}:{port}\r\nOrigin: http://{host}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return viewer


__all__ = ["live_page"]
