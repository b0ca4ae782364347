"""The console: what the engine pays for being watched, and whether twenty viewers delay a loop of 100 Hz."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bayesftc.bench._figures import Figure, Section
from bayesftc.bench.measures.console.beside import live_page
from bayesftc.cosim.base.extras import why_missing

VIEWERS = 20
STEPS = 100_000
PIECE = 2_000
"""Most steps that the console computes at once. A run as fast as possible takes some such pieces in 20 ms."""


def measure(quick: bool) -> Section:
    """Return the cost of rows, states and alarms beside a bare session, and the late steps with and without viewers."""
    title = "Console: a loop that is watched"
    if reason := why_missing("starlette", "uvicorn", "websockets", purpose="This measurement", of="console"):
        return Section("console", title, (), reason=reason)
    steps, repetitions, seconds = (4_000, 2, 0.5) if quick else (STEPS, 21, 10.0)
    cost = [_watched(steps) / _bare(steps) for _ in range(repetitions)]
    alone, _ = asyncio.run(_late(0, seconds))
    late, frames = asyncio.run(_late(VIEWERS, seconds))
    note = f"{VIEWERS} viewers at 30 frames a second, a step of 10 ms, {seconds:g} s; without viewers {alone:.2f} ms"
    return Section(
        "console",
        title,
        (
            Figure(
                "watched",
                "processor time of a run with rows, saved states and alarms, over a bare one",
                "",
                cost,
                at_most=1.05,
            ),
            Figure("act", "a freeze by hand after 500 steps, two loops", "ms", _acts(1 if quick else 5)),
            Figure("jitter", "99th percentile of the delay of a step", "ms", [late], note=note),
            Figure("frames", "frames a second of each viewer", "1/s", [frames]),
            *live_page(quick),
        ),
    )


def _bare(steps: int) -> float:
    """Return the processor seconds of a session whose rows are kept, in the pieces in which the console advances it."""
    from bayesftc.scenario import load_scenario

    with load_scenario("cruise_control").loop().start(seed=1) as session:
        session.advance(0)
        began = time.process_time()
        kept = [session.advance(PIECE * 0.02) for _ in range(steps // PIECE)]  # as a run without a page keeps them
        taken = time.process_time() - began
        del kept
        return taken


def _watched(steps: int) -> float:
    """Return the processor seconds of the same with all that the console keeps."""
    from bayesftc.console.desk.desk import Desk

    with Desk("cruise_control", beside=()) as desk:
        began = time.process_time()
        for _ in range(steps // PIECE):
            desk.advance_to(desk.k + PIECE)
        return time.process_time() - began


def _acts(repetitions: int) -> list[float]:
    from bayesftc.console.desk.desk import Desk

    taken = []
    with Desk("cruise_control") as desk:
        desk.advance_to(500)
        desk.act("fault", "sensors", {"kind": "Freeze", "sensor": 1, "duration": 1.0})  # compiles
        for _ in range(repetitions):
            began = time.perf_counter()
            desk.act("fault", "sensors", {"kind": "Freeze", "sensor": 1, "duration": 1.0})
            taken.append(1e3 * (time.perf_counter() - began))
    return taken


async def _late(viewers: int, seconds: float) -> tuple[float, float]:
    """Return the 99th percentile of the delay of a step in milliseconds, and the frames a second of a viewer."""
    import numpy as np
    from websockets.asyncio.client import connect

    with _server() as (port, engine):
        address = f"ws://127.0.0.1:{port}/live"
        sockets = [await connect(address, origin=f"http://127.0.0.1:{port}", max_size=None) for _ in range(viewers)]  # type: ignore[arg-type]
        counts = [0] * viewers

        async def watch(i: int) -> None:
            async for message in sockets[i]:
                counts[i] += isinstance(message, bytes)

        tasks = [asyncio.create_task(watch(i)) for i in range(viewers)]
        while engine.desk is None:
            await asyncio.sleep(0.05)
        await asyncio.sleep(min(3.0, seconds))  # faults are compiled ahead meanwhile
        delays: list[float] = []
        await asyncio.wrap_future(engine.call(lambda desk: _noted(engine, desk, delays)))
        begun = list(counts)
        await asyncio.sleep(seconds)
        frames = [(b - a) / seconds for a, b in zip(begun, counts, strict=True)]
        await asyncio.wrap_future(engine.call(lambda _: engine.set_running(False)))
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for each in sockets:
            await each.close()
    return float(np.percentile(delays, 99)) if delays else 0.0, float(np.mean(frames)) if frames else 0.0


def _noted(engine: Any, desk: Any, delays: list[float]) -> None:
    """Let the desk run at twice its pace, 100 steps a second, and note how late each step is."""
    advance, began = desk.advance_to, time.perf_counter()
    first, pace = desk.k, 2.0

    def advance_to(k: int) -> None:
        delays.append(1e3 * max(time.perf_counter() - began - (k - first) * 0.02 / pace, 0.0))
        advance(k)

    desk.advance_to = advance_to
    engine.set_pace(pace)
    engine.set_running(True)


@contextmanager
def _server() -> Iterator[tuple[int, Any]]:
    """Yield the port and the engine of a console that is served from a thread of its own."""
    import socket

    import uvicorn

    from bayesftc.console.desk.desk import Desk
    from bayesftc.console.desk.engine import Engine
    from bayesftc.console.shown.broadcast import view_of
    from bayesftc.console.web.access import Access
    from bayesftc.console.web.server import Server

    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        engine = Engine(lambda events: Desk("cruise_control", events=events), view_of)
        server = Server(engine, Access("127.0.0.1", port, None))
        config = uvicorn.Config(
            server.app,
            log_level="error",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=2,
        )
        running = uvicorn.Server(config)
        thread = threading.Thread(target=running.run, kwargs={"sockets": [listener]}, daemon=True)
        listener.listen()
        thread.start()
        try:
            yield port, engine
        finally:
            server.close()
            running.should_exit = True
            thread.join(20.0)
