"""The server of the console: one page, its files, downloads, and a WebSocket of frames and commands."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from bayesftc.console.desk.engine import Engine
from bayesftc.console.desk.live import LiveRun
from bayesftc.console.shown.broadcast import MOST_EXTRA, Broadcast, Cursor, View
from bayesftc.console.web.access import Access, Guard
from bayesftc.console.web.commands import COMMANDS, LIVE_COMMANDS, LONGEST, carry_out, read_command
from bayesftc.console.web.downloads import DOWNLOADS, EVENTS, Kept, file_name, kept_of
from bayesftc.console.web.recorded import SIGNALS, Streamed, signals_of
from bayesftc.cosim.errors import BayesFTCError, ModelError

FRAMES = 30
"""Frames a second."""
UNREAD = 10.0
"""Seconds after which a connection ends whose page reads nothing."""
BETWEEN = 0.02
"""Seconds between two commands of a viewer: one that sends them without end must not cost the engine."""
CLOSING = 1.0
"""Seconds for the end of a connection to be sent."""
MOST_VIEWERS = 32
MOST_STREAMS = 2
"""Most downloads of a live run at a time."""
PAGE = Path(__file__).parent.parent / "page"
FILES = {
    "console.js": "text/javascript",
    "drawing.js": "text/javascript",
    "elements.js": "text/javascript",
    "strips.js": "text/javascript",
    "wires.js": "text/javascript",
    "console.css": "text/css",
    "uPlot.iife.min.js": "text/javascript",
    "uPlot.min.css": "text/css",
}


class Server:
    """The application of one console.

    Parameters
    ----------
    engine : Engine
        The engine. It starts and ends with the application.
    access : Access
        Who may connect.
    """

    def __init__(self, engine: Engine | LiveRun, access: Access):
        self._engine, self._access = engine, access
        self._broadcast = Broadcast(engine)
        self._viewers: dict[WebSocket, asyncio.Lock] = {}
        self._operator: WebSocket | None = None
        self._closing = False
        self._downloads, self._streams = asyncio.Semaphore(1), asyncio.Semaphore(MOST_STREAMS)
        routes = [
            Route("/", self._page),
            Route("/page/{name}", self._file),
            Route("/download/{name}", self._download),
            WebSocketRoute("/live", self._live),
        ]
        self.app = Guard(Starlette(routes=routes, lifespan=self._lifespan), access)

    def close(self) -> None:
        """Let all connections end."""
        self._closing = True

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._engine.start()
        try:
            yield
        finally:
            self._closing = True
            await asyncio.to_thread(self._engine.stop)

    async def _page(self, request: Request) -> Response:
        let_in = self._access.lets_in(request.query_params)
        if let_in is None:
            return FileResponse(PAGE / "index.html", media_type="text/html")
        if not let_in:
            sentence = "This address does not count any more. Open the one with the token that has been printed."
            return PlainTextResponse(sentence, status_code=403)
        answer = RedirectResponse("/", status_code=303)
        if self._access.token is not None:
            answer.set_cookie(self._access.cookie, self._access.token, httponly=True, samesite="strict", path="/")
        return answer

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in FILES:
            return PlainTextResponse("There is no such file.", status_code=404)
        return FileResponse(PAGE / name, media_type=FILES[name])

    async def _download(self, request: Request) -> Response:
        name = request.path_params["name"]
        if isinstance(self._engine, LiveRun) and name in SIGNALS:
            return await self._signals(self._engine, name)
        if name not in DOWNLOADS or (self._engine.desk is None and name != EVENTS):
            return PlainTextResponse("There is no such file.", status_code=404)
        lane = request.query_params.get("lane", "0")
        kind, make = DOWNLOADS[name]
        try:
            async with self._downloads:
                kept = await self._kept(lane)
                data = await asyncio.to_thread(make, kept)
        except BayesFTCError as error:
            return PlainTextResponse(str(error), status_code=503 if self._closing else 409)
        except asyncio.CancelledError:
            if not self._closing:
                raise
            return PlainTextResponse("The console has ended.", status_code=503)
        return Response(data, media_type=kind, headers=_kept_as(kept.name, name))

    async def _signals(self, run: LiveRun, name: str) -> Response:
        if self._streams.locked():
            return PlainTextResponse(f"There are already {MOST_STREAMS} downloads. Try again later.", status_code=503)
        await self._streams.acquire()
        try:
            parts = await asyncio.to_thread(signals_of, run, name)
        except BaseException as error:
            self._streams.release()
            if not isinstance(error, BayesFTCError):
                raise
            return PlainTextResponse(str(error), status_code=409)

        def ended(sentence: str) -> None:
            self._streams.release()
            if sentence:
                self._note(sentence)

        return Streamed(parts, ended, media_type=DOWNLOADS[name][0], headers=_kept_as(run.name, name))

    def _is_closing(self) -> bool:
        return self._closing

    async def _kept(self, lane: str) -> Kept:
        if isinstance(self._engine, LiveRun):
            return Kept(self._engine.name, {}, Path(), self._engine.events.all(), self._is_closing)
        return await asyncio.wrap_future(self._engine.call(lambda desk: kept_of(desk, lane, self._is_closing)))

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        if len(self._viewers) >= MOST_VIEWERS:
            await socket.close(1013, f"There are already {MOST_VIEWERS} viewers.")
            return
        self._viewers[socket] = asyncio.Lock()
        cursor = Cursor()
        self._note(f"connected, {len(self._viewers)} now")
        if self._operator is None and not self._engine.only_shows:
            self._operate(socket)
        sender = asyncio.create_task(self._send_frames(socket, cursor))
        reader = asyncio.create_task(self._read(socket, cursor))
        try:
            await asyncio.wait({sender, reader}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._viewers[socket]
            self._note(f"left, {len(self._viewers)} now{', with the controls' if self._operator is socket else ''}")
            if self._operator is socket:
                self._operator = None
            for task in (sender, reader):
                task.cancel()
            with suppress(Exception):
                await asyncio.gather(sender, reader, return_exceptions=True)
            with suppress(Exception):
                await asyncio.wait_for(socket.close(1001 if self._closing else 1000), CLOSING)

    def _operate(self, socket: WebSocket) -> None:
        if self._operator is not socket:
            self._operator = socket
            self._note("takes the controls")

    def _note(self, words: str) -> None:
        desk = self._engine.desk
        if desk is None:
            self._engine.events.add("viewer", words)
        else:
            desk.note("viewer", words)

    async def _send_frames(self, socket: WebSocket, cursor: Cursor) -> None:
        """Send what is new, up to `FRAMES` times a second; a slow viewer gets fewer and coarser frames."""
        sent: Any = None
        due = time.perf_counter()
        while not self._closing:
            view: View | None = self._engine.view
            if view is None:
                text = {"type": "loading", "failure": self._engine.failure}
                await self._send(socket, text)
                await asyncio.sleep(0.1 if self._engine.failure is None else 1.0)
                continue
            may, free = socket is self._operator, self._operator is None
            if sent != (view.epoch, may, free):
                sent = view.epoch, may, free
                await self._send(socket, {**view.layout, "operator": may, "free": free, "viewers": len(self._viewers)})
            frame = self._broadcast.frame(view, cursor)
            if frame is not None:
                await self._sent(socket, socket.send_bytes, frame)
            due = max(due + 1.0 / FRAMES, time.perf_counter())
            await asyncio.sleep(max(due - time.perf_counter(), 0.001))

    async def _read(self, socket: WebSocket, cursor: Cursor) -> None:
        """Carry out the commands of one viewer, one after the other."""
        with suppress(WebSocketDisconnect):
            while True:
                message = await socket.receive()
                if message["type"] != "websocket.receive":
                    return
                text = message.get("text")
                await self._send(socket, await self._answer(socket, cursor, text))
                await asyncio.sleep(BETWEEN)

    async def _answer(self, socket: WebSocket, cursor: Cursor, text: str | None) -> dict[str, Any]:
        number: Any = None
        try:
            if text is None or len(text) > LONGEST:
                raise ModelError(f"A command is a text of at most {LONGEST} bytes.")
            try:
                content = json.loads(text)
            except (ValueError, RecursionError):
                raise ModelError("A command must be JSON.") from None
            if not isinstance(content, dict):
                raise ModelError("A command must be an object.")
            number = content.pop("id", None)
            number = number if isinstance(number, int) else None
            if self._engine.only_shows and content.get("do") != "show":
                raise ModelError("A live run is only shown: it has no controls.")
            if content.get("do") == "claim":
                if self._operator not in (None, socket):
                    raise ModelError("Another page has the controls. Close it first.")
                self._operate(socket)
            elif content.get("do") == "show":
                self._show(cursor, content.get("columns"))
            elif socket is not self._operator:
                raise ModelError("This page only watches: another one has the controls.")
            elif isinstance(self._engine, Engine):
                began = time.perf_counter()
                command = read_command(content, COMMANDS)
                await asyncio.wrap_future(self._engine.call(carry_out(self._engine, command)))
                seconds = round(time.perf_counter() - began, 3)
                return {"type": "done", "id": number, "seconds": seconds, "running": self._engine.running}
            else:
                drop = read_command(content, LIVE_COMMANDS)
                self._engine.drop(drop.wire, drop.seconds)
        except BayesFTCError as error:
            return {"type": "error", "id": number, "sentence": str(error)}
        return {"type": "done", "id": number}

    def _show(self, cursor: Cursor, columns: Any) -> None:
        view: View | None = self._engine.view
        if not isinstance(columns, list) or len(columns) > MOST_EXTRA or view is None:
            raise ModelError(f"Choose at most {MOST_EXTRA} further signals.")
        known = {name for lane in view.lanes for name in lane.columns}
        cursor.wanted = tuple(dict.fromkeys(name for name in columns if isinstance(name, str) and name in known))

    async def _send(self, socket: WebSocket, content: dict[str, Any]) -> None:
        await self._sent(socket, socket.send_text, json.dumps(content, separators=(",", ":")))

    async def _sent(self, socket: WebSocket, send: Callable[[Any], Awaitable[None]], content: Any) -> None:
        """Send, or raise a TimeoutError: a page that reads nothing for so long loses its connection, and its controls."""
        async with self._viewers[socket]:
            await asyncio.wait_for(send(content), UNREAD)


def _kept_as(name: str, of: str) -> dict[str, str]:
    return {"content-disposition": f'attachment; filename="{file_name(name, of)}"'}


__all__ = ["MOST_VIEWERS", "Server"]
