"""Serve a scenario until Ctrl-C: the socket, the token, and the signals that end the server."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EADDRNOTAVAIL
from functools import partial

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from bayesftc.console.desk.desk import Desk, Served
from bayesftc.console.desk.engine import Engine
from bayesftc.console.desk.live import LiveRun
from bayesftc.console.shown.broadcast import view_of
from bayesftc.console.shown.live import view_of_live
from bayesftc.console.web.access import Access, new_token
from bayesftc.console.web.commands import LONGEST
from bayesftc.console.web.server import Server
from bayesftc.cosim.errors import BayesFTCError, brief
from bayesftc.cosim.live.connections.credentials import is_loopback

PATIENCE = 2
"""Seconds that open connections have to end."""

LAST = 0.5
"""Seconds in which open pages still get the sentence of a scenario that cannot run."""

ANY = ("0.0.0.0", "::")
"""All addresses of this machine; none of them is the address of a page."""

MOST_CONNECTIONS = 100
"""Open connections beyond which new ones are closed: a live run needs file descriptors too."""

SILENT = 5.0
"""Seconds after which a connection is closed that has not asked for anything."""


class _Connection(H11Protocol):
    """A connection that is closed if there are too many, or if nothing is asked for."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection, or close it."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            transport.abort()
        else:
            self.loop.call_later(SILENT, self._close_if_silent)

    def _close_if_silent(self) -> None:
        if self.cycle is None and self.transport.get_protocol() is self:  # a WebSocket has a protocol of its own by now
            self.transport.abort()


class _Uvicorn(uvicorn.Server):
    """A server that leaves signals to `serve`."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


@dataclass(frozen=True)
class Where:
    """Where the page is: the address and the port to listen on, and whether to open it in a browser."""

    host: str
    port: int
    open_page: bool = False


def serve(served: Served, beside: Sequence[str], where: Where, say: Callable[[str], None]) -> None:
    """Serve the page of a scenario until the process gets SIGINT or SIGTERM.

    Parameters
    ----------
    served : Served
        The scenario.
    beside : sequence of str
        Precision learners to compare with; see `Desk`.
    where : Where
        Where to listen.
    say : callable
        Called with sentences for the user.

    Raises
    ------
    BayesFTCError
        If the address cannot be used, or the scenario cannot run.
    """
    with _listening(where.host, where.port) as listener:
        engine = Engine(lambda events: Desk(served, tuple(beside), events=events), view_of)
        server, access = _announced(engine, where, listener, say)
        asyncio.run(_serve(engine, server, listener, access.address_to_open if where.open_page else None))
    if engine.error is not None:
        raise engine.error
    say("The console has ended.")


@contextmanager
def shown_beside(run: LiveRun, where: Where, say: Callable[[str], None]) -> Iterator[None]:
    """Serve the page of a live run from another thread, as long as the run goes on.

    Parameters
    ----------
    run : LiveRun
        The run.
    where : Where
        Where to listen.
    say : callable
        Called with sentences for the user.

    Raises
    ------
    BayesFTCError
        If the address cannot be used.
    """
    with _listening(where.host, where.port) as listener:
        run.view = view_of_live(run)
        server, access = _announced(run, where, listener, say)
        running = _uvicorn(server)
        work = partial(asyncio.run, running.serve(sockets=[listener]))
        thread = threading.Thread(target=work, name="bayesftc-page", daemon=True)
        thread.start()
        if where.open_page:
            webbrowser.open(access.address_to_open())
        try:
            yield
        finally:
            running.should_exit = True
            server.close()
            thread.join(PATIENCE + 3.0)


def _announced(
    engine: Engine | LiveRun, where: Where, listener: socket.socket, say: Callable[[str], None]
) -> tuple[Server, Access]:
    """Return the server and its rules, after telling the user the address."""
    host, port = where.host, listener.getsockname()[1]
    access = Access(host, port, None if is_loopback(host) else new_token())
    if access.token is not None:
        say("Only who has this address can see and move the run. It is not encrypted.")
    shown = access.address("" if access.token is None else f"?token={access.token}")
    say(f"The console is at {shown} (Ctrl-C ends it)")
    if host in ANY:
        say(f"In a browser of another machine, write a name or address of this machine in place of {host}.")
    return Server(engine, access), access


def _uvicorn(server: Server) -> _Uvicorn:
    config = uvicorn.Config(
        server.app,
        http=_Connection,
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=2 * LONGEST,
        ws_per_message_deflate=False,  # it would cost more than it saves on most networks
        server_header=False,
        timeout_graceful_shutdown=PATIENCE,
    )
    return _Uvicorn(config)


async def _serve(engine: Engine, server: Server, listener: socket.socket, page: Callable[[], str] | None) -> None:
    running = _uvicorn(server)

    def end() -> None:
        running.should_exit = True
        server.close()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    if page is not None:
        loop.call_later(0.3, lambda: webbrowser.open(page()))
    watching = loop.create_task(_end_after_failure(engine, end))
    try:
        await running.serve(sockets=[listener])
    finally:
        watching.cancel()


async def _end_after_failure(engine: Engine, end: Callable[[], None]) -> None:
    """End the server of a scenario that cannot run: its page could do nothing but show the error."""
    while engine.desk is None and engine.error is None:
        await asyncio.sleep(0.1)
    if engine.error is not None:
        await asyncio.sleep(LAST)
        end()


@contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    """Return a socket that listens.

    Raises
    ------
    BayesFTCError
        If the address cannot be used.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise BayesFTCError(
            f"There is no address {brief(host)} ({why}). Choose a name or address of this machine with --host."
        ) from None
    try:
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(128)
    except OSError as error:
        why = error.strerror or str(error)
        is_elsewhere = error.errno == EADDRNOTAVAIL
        advice = (
            "Choose an address of this machine with --host."
            if is_elsewhere
            else "Choose another with --port, or --port 0 for a free one."
        )
        raise BayesFTCError(f"The address {host}:{port} cannot be used ({why}). {advice}") from None
    with listener:
        yield listener


__all__ = ["Where", "serve", "shown_beside"]
